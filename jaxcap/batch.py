"""Many states: chunks for the cache, blocks for the cores."""

import os
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
from jaxtyping import Num

from jaxcap.capturability import GRAVITY, capturability_of_lanes
from jaxcap.cone import CentroidalCone
from jaxcap.contacts import FloatArray
from jaxcap.result import Capturability

LANES = 64
"""States of a chunk, computed side by side: rows x lanes numbers should fit the cache."""
BLOCK = 1 << 13
"""States of a block, one call of the compiled program; several run at a time."""
ROWS = 16
"""Faces are padded to a multiple of this, so that not every contact set is compiled anew."""


def score(
    cone: CentroidalCone, coms: Num[FloatArray, "n 3"], com_velocities: Num[FloatArray, "n 3"], gravity=GRAVITY
) -> Capturability:
    """`capturability` of many states.

    cone: from `centroidal_cone`. coms: (n, 3) [m], com_velocities: (n, 3) [m/s], gravity: (3,) [m/s^2], all in the
    contacts' frame, z up. The inputs' dtype decides the precision, as far as JAX's x64 switch allows. Every field of the
    result has shape (n,). A state with NaN or infinity gets `Status.NONFINITE` and leaves the others alone; n may be 0.
    Raises TypeError for wrong shapes.
    """
    coms, com_velocities = jnp.asarray(coms), jnp.asarray(com_velocities)
    for name, value in (("coms", coms), ("com_velocities", com_velocities)):
        if value.ndim != 2 or value.shape[1] != 3:
            raise TypeError(f"{name} has shape {value.shape} (expected (n, 3))")
    if len(coms) != len(com_velocities):
        raise TypeError(f"coms has {len(coms)} rows and com_velocities {len(com_velocities)} (expected as many)")
    cone = cone.padded(-(-max(len(cone.faces), 1) // ROWS) * ROWS)
    gravity = jnp.asarray(gravity, jnp.result_type(coms, jnp.float32))
    if isinstance(coms, jax.core.Tracer) or isinstance(com_velocities, jax.core.Tracer):
        return _score_block(cone, coms, com_velocities, gravity)
    n = len(coms)
    run = lambda start: _compiled(cone, _block(coms, start), _block(com_velocities, start), gravity)
    first, *starts = range(0, max(n, 1), BLOCK)
    parts = [run(first), *_side_by_side(run, starts)]
    return jax.tree.map(lambda *fields: jnp.concatenate(fields)[:n], *parts)


def _side_by_side(run, starts):
    """The results of run(start), in order, from one thread a core: on a CPU, JAX runs what one thread asks for in sequence.

    Called after a first run, which has compiled the program.
    """
    x64 = jax.config.jax_enable_x64

    def in_thread(start):
        with jax.enable_x64(x64):   # the switch belongs to a thread
            return jax.block_until_ready(run(start))

    with ThreadPoolExecutor(max_workers=os.cpu_count()) as threads:
        return list(threads.map(in_thread, starts))


def _block(states, start):
    """One block of states (m, 3), padded to the next of a few sizes, each of which is compiled once."""
    block = states[start : start + BLOCK]
    size = BLOCK if start else min(BLOCK, max(LANES, 1 << max(len(block) - 1, 0).bit_length()))
    return jnp.pad(block, ((0, size - len(block)), (0, 0)))


def _score_block(cone, coms, com_velocities, gravity):
    n = len(coms)
    chunks = -(-n // LANES)

    def to_chunks(states):
        return jnp.pad(states, ((0, chunks * LANES - n), (0, 0))).reshape(chunks, LANES, 3).swapaxes(1, 2)

    one = lambda chunk: capturability_of_lanes(cone, *chunk, gravity)
    answers = jax.lax.map(one, (to_chunks(coms), to_chunks(com_velocities)))
    return jax.tree.map(lambda field: field.reshape(-1)[:n], answers)


_compiled = jax.jit(_score_block)
