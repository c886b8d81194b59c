"""Many states: blocks for the cores and the devices."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Num

from jaxcap.batch.blocks import BLOCK, RAYS_BLOCK, block_of, over_blocks, padded_cone
from jaxcap.batch.devices import Spread, spread_over
from jaxcap.batch.rounds import Shared, States, scored_block
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, FloatArray
from jaxcap.contacts.scoring_input import check_cone, check_gravity, relative
from jaxcap.one_state.result import Capturability


def score(
    cone: CentroidalCone | ConeRays,
    coms: Num[FloatArray, "n 3"],
    com_velocities: Num[FloatArray, "n 3"],
    gravity: ArrayLike = GRAVITY,
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
    check_cone(cone)
    check_gravity(gravity)
    _check_shapes(cone, coms, com_velocities)
    cone, coms = relative(cone, coms)
    coms, com_velocities = jnp.asarray(coms), jnp.asarray(com_velocities)
    own = cone if isinstance(cone, ConeRays) and cone.batched else None
    states = States(coms, com_velocities, own)
    shared = Shared(jnp.asarray(gravity, jnp.result_type(coms, jnp.float32)), None if own else padded_cone(cone))
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((states, shared.cone))):
        return scored_block(shared, states, neighbours)
    devices = spread_over((states, shared))
    shares = max(len(devices), 1)
    block, n = shares * (RAYS_BLOCK if own else BLOCK), len(coms)
    if shares == 1:
        return over_blocks(lambda start: _compiled(shared, block_of(states, n, start, block), neighbours), n, block)
    spread = _spread(devices, neighbours)
    everywhere = spread.everywhere(shared)
    return over_blocks(lambda start: spread(everywhere, block_of(states, n, start, block, shares)), n, block)


def _check_shapes(cone: CentroidalCone | ConeRays, coms, com_velocities) -> None:
    """Raises TypeError."""
    for name, value in (("coms", coms), ("com_velocities", com_velocities)):
        if np.ndim(value) != 2 or np.shape(value)[1] != 3:
            raise TypeError(f"{name} has shape {np.shape(value)} (expected (n, 3))")
    n = len(coms)
    if n != len(com_velocities):
        raise TypeError(f"coms has {n} rows and com_velocities {len(com_velocities)} (expected as many)")
    if isinstance(cone, ConeRays) and cone.batched and len(cone.rays) != n:
        raise TypeError(f"cone has rays of {len(cone.rays)} contact sets (expected one, or one for each of {n} states)")


_compiled = jax.jit(scored_block, static_argnames="neighbours")


@cache
def _spread(devices: tuple[jax.Device, ...], neighbours: bool) -> Spread:
    """A program for one block on each of the devices."""
    return Spread(lambda shared, states: scored_block(shared, states, neighbours), devices)
