"""Many states: chunks for the cache, blocks for the cores."""

import os
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
from jaxtyping import Num

from jaxcap.capturability import GRAVITY, capturability_of_lanes, survey_of_lanes
from jaxcap.cone import CentroidalCone, ConeRays
from jaxcap.contacts import FloatArray
from jaxcap.result import Capturability

LANES = 64
"""States of a chunk, computed side by side: rows x lanes numbers should fit the cache."""
BLOCK = 1 << 13
"""States of a block, one call of the compiled program; several run at a time."""
RAYS_BLOCK = 1 << 12
"""The same where every state has its own contacts: it takes longer, and both cores should have work."""
ROWS = 16
"""Faces are padded to a multiple of this, so that not every contact set is compiled anew."""


def score(
    cone: CentroidalCone | ConeRays,
    coms: Num[FloatArray, "n 3"],
    com_velocities: Num[FloatArray, "n 3"],
    gravity=GRAVITY,
    neighbours: bool = False,
) -> Capturability:
    """`capturability` of many states.

    cone: from `centroidal_cone` or `cone_rays`; rays may be those of one contact set, or have a leading axis of n: a
    contact set for each state. coms: (n, 3) [m], com_velocities: (n, 3) [m/s], gravity: (3,) [m/s^2], all in the contacts'
    frame, z up. neighbours: rows that follow each other are similar states, as along a trajectory or on a grid, and rays
    start each from the one before (a warm start); the answers are the same but for rounding. The inputs' dtype decides the
    precision, as far as JAX's x64 switch allows. Every field of the result has shape (n,). A state with NaN or infinity
    gets `Status.NONFINITE` and leaves the others alone; n may be 0.

    Raises TypeError for wrong shapes.
    """
    coms, com_velocities = jnp.asarray(coms), jnp.asarray(com_velocities)
    for name, value in (("coms", coms), ("com_velocities", com_velocities)):
        if value.ndim != 2 or value.shape[1] != 3:
            raise TypeError(f"{name} has shape {value.shape} (expected (n, 3))")
    n = len(coms)
    if n != len(com_velocities):
        raise TypeError(f"coms has {n} rows and com_velocities {len(com_velocities)} (expected as many)")
    own = isinstance(cone, ConeRays) and cone.rays.ndim == 3
    if own and len(cone.rays) != n:
        raise TypeError(f"cone has rays of {len(cone.rays)} contact sets (expected one, or one for each of {n} states)")
    cone = padded_cone(cone)
    gravity = jnp.asarray(gravity, jnp.result_type(coms, jnp.float32))
    per_state, common = ((coms, com_velocities, cone), None) if own else ((coms, com_velocities), cone)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((coms, com_velocities, cone))):
        return answer_block(common, per_state, gravity, neighbours)
    block = RAYS_BLOCK if own else BLOCK
    run = lambda start: _compiled(common, _block(per_state, n, start, block), gravity, neighbours)
    first, *starts = range(0, max(n, 1), block)
    parts = [run(first), *side_by_side(run, starts)]
    return jax.tree.map(lambda *fields: jnp.concatenate(fields)[:n], *parts)


def padded_cone(cone: CentroidalCone | ConeRays) -> CentroidalCone | ConeRays:
    """The same, faces padded to a multiple of ROWS."""
    return cone.padded(-(-max(len(cone.faces), 1) // ROWS) * ROWS) if isinstance(cone, CentroidalCone) else cone


def side_by_side(run, items: Iterable, ahead: int | None = None) -> Iterator:
    """The results of run(item), in order, from one thread a core: on a CPU, JAX runs what one thread asks for in sequence.

    ahead: how many items at most are begun beyond the one whose result is waited for; None for all. Called when the program
    is compiled.
    """
    x64 = jax.config.jax_enable_x64

    def in_thread(item):
        with jax.enable_x64(x64):   # the switch belongs to a thread
            return jax.block_until_ready(run(item))

    waiting = deque()
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as threads:
        try:
            for item in items:
                waiting.append(threads.submit(in_thread, item))
                if ahead is not None and len(waiting) > ahead:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def _block(per_state, n: int, start: int, block: int):
    """One block of n states, padded to the next of a few sizes, each of which is compiled once."""
    rows = min(block, n - start)
    size = block if start else min(block, max(LANES, 1 << max(rows - 1, 0).bit_length()))
    return _padded(jax.tree.map(lambda leaf: leaf[start : start + block], per_state), size)


def _padded(per_state, size: int):
    """With rows of zeros, up to this number."""
    return jax.tree.map(lambda x: jnp.pad(x, ((0, size - len(x)), *[(0, 0)] * (x.ndim - 1))), per_state)


def answer_block(common, per_state, gravity, neighbours: bool = False, answer=capturability_of_lanes):
    """The answers for one block. answer: of (cone, CoM, velocity, gravity, survey if it is known), all with lanes last."""
    if isinstance(common, CentroidalCone):
        return _over_chunks(lambda states: answer(common, *states, gravity), per_state)
    surveys = _surveys(common, per_state, gravity, neighbours)
    # A chunk takes as long as its slowest lane: states with the same kind of way ahead of them go together.
    standing = surveys.standing & surveys.feasible
    kind = 1 * surveys.feasible + standing + 2 * (standing & surveys.pulled_back) + 4 * (standing & surveys.near.hangs)
    order = jnp.argsort(kind, stable=True)
    surveys = surveys._replace(near=())
    one = lambda arguments: answer(*_arguments(common, arguments[0]), gravity, arguments[1])
    answers = _over_chunks(one, jax.tree.map(lambda x: x[order], (per_state, surveys)))
    return jax.tree.map(lambda x: jnp.zeros_like(x).at[order].set(x), answers)


def _surveys(common, per_state, gravity, neighbours: bool):
    """All surveys of a block. Neighbours share a lane, and each begins where the one before has ended."""
    one = lambda states, near=None: survey_of_lanes(*_arguments(common, states), gravity, near)
    lean = lambda survey: survey._replace(near=survey.near._replace(start=(), least=(), most=()))
    if not neighbours:
        return _over_chunks(lambda states: lean(one(states)), per_state)
    n, steps = len(per_state[0]), -(-len(per_state[0]) // LANES)
    to_steps = lambda x: jnp.moveaxis(x.reshape(LANES, steps, *x.shape[1:]), 0, -1)
    states = jax.tree.map(to_steps, _padded(per_state, steps * LANES))

    def step(near, states):
        survey = one(states, near)
        return survey.near, lean(survey)

    first = one(jax.tree.map(lambda x: x[0], states))
    surveys = jax.lax.scan(step, first.near, states)[1]
    return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0).reshape(-1, *x.shape[1:-1])[:n], surveys)


def _over_chunks(one, rows):
    """`one` of all rows, a chunk at a time, a row a lane."""
    n = len(jax.tree.leaves(rows)[0])
    chunks = -(-n // LANES)
    to_chunks = lambda x: jnp.moveaxis(x.reshape(chunks, LANES, *x.shape[1:]), 1, -1)
    answers = jax.lax.map(one, jax.tree.map(to_chunks, _padded(rows, chunks * LANES)))
    return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 1).reshape(chunks * LANES, *x.shape[1:-1])[:n], answers)


def _arguments(common, states):
    """Cone, CoM and velocity of a chunk; the cone is common, or every state's own."""
    com, com_velocity, *own = states
    return (*own, com, com_velocity) if own else (common, com, com_velocity)


_compiled = jax.jit(answer_block, static_argnames="neighbours")
