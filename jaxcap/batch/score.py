"""Many states: blocks for the cores and the devices."""

from functools import cache, partial

import jax
import jax.numpy as jnp
from jaxtyping import Num

from jaxcap.batch.blocks import BLOCK, RAYS_BLOCK, block_of, padded_cone, side_by_side
from jaxcap.batch.devices import Spread, spread_over
from jaxcap.batch.rounds import answers
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import GRAVITY, FloatArray
from jaxcap.one_state.result import Capturability


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

    Several devices of a process share the states, and the answers, the same to the bit, come to the default device. Only
    some: place an argument there (`jax.device_put` with a device or a sharding), or set `jax.default_device`.

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
        return answers(common, per_state, gravity, neighbours)
    devices = spread_over((per_state, common, gravity))
    shares = max(len(devices), 1)
    block = shares * (RAYS_BLOCK if own else BLOCK)
    if shares == 1:
        answer = lambda states: _compiled(common, states, gravity, neighbours)
    else:
        spread = _spread(devices, neighbours)
        answer = partial(spread, spread.everywhere((common, gravity)))
    run = lambda start: answer(block_of(per_state, n, start, block, shares))
    first, *starts = range(0, max(n, 1), block)
    parts = [run(first), *side_by_side(run, starts)]
    return jax.tree.map(lambda *fields: jnp.concatenate(fields)[:n], *parts)


_compiled = jax.jit(answers, static_argnames="neighbours")


@cache
def _spread(devices: tuple[jax.Device, ...], neighbours: bool) -> Spread:
    """A program for one block on each of the devices."""
    return Spread(lambda common, states: answers(common[0], states, common[1], neighbours), devices)
