"""Many states: blocks for the cores and the devices."""

from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxcap.batch.blocks import BLOCK, RAYS_BLOCK, Block, over_blocks, own_or_common
from jaxcap.batch.devices import Spread, spread_over
from jaxcap.batch.kept_executables import Kept
from jaxcap.batch.rounds import Shared, States, scored_block
from jaxcap.batch.second_opinion import decided
from jaxcap.contacts.actuation import Actuation, with_limits
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, checked_gravity
from jaxcap.contacts.scoring_input import as_given, check_cone, relative, rounded, unless_zero
from jaxcap.one_state.result import CODES, Capturability


def score(
    cone: CentroidalCone | ConeRays,
    coms: ArrayLike,
    com_velocities: ArrayLike,
    gravity: ArrayLike = GRAVITY,
    neighbours: bool = False,
    *,
    specific_angular_momentum: ArrayLike | None = None,
    actuation: Actuation | None = None,
    momentum_box: ArrayLike = 0.0,
) -> Capturability:
    """`capturability` of many states.

    Several devices of a process share the states, and the answers, the same to the bit, come to the default device. Only
    some: place an argument there (`jax.device_put` with a device or a sharding), or set `jax.default_device`.

    Args:
        cone: from `centroidal_cone` or `cone_rays`; rays may be those of one contact set, or have a leading axis of n: a
            contact set for each state.
        coms: (n, 3) [m], in the contacts' frame, z up; n may be 0. NumPy's positions far from the origin lose nothing, for
            the contacts' centroid is subtracted before they are rounded.
        com_velocities: (n, 3) [m/s].
        gravity: (3,) [m/s^2].
        neighbours: rows that follow each other are similar states, as along a trajectory or on a grid, and rays start each
            from the one before (a warm start); the answers are the same but for rounding.
        specific_angular_momentum: (n, 3) the robot's angular momentum about its CoM, over its mass, in the frame of the
            contacts [m^2/s]; None for zero, the paper's model. See `capturability`.
        actuation: what the robot's joints can bear, in one posture or in one for each state; with rays only.
        momentum_box: how much the rate of angular momentum per unit mass may differ from what braking brings about, in each
            component, >= 0 [m^2/s^2]; one number, or (n,). Other than zero with rays only.

    Returns:
        Every field has shape (n,). The inputs' dtype decides the precision, as far as JAX's x64 switch allows. A state with
        NaN or infinity gets `Status.NONFINITE` and leaves the others alone. What rays leave undecided (1 state in 10,000 of
        contacts next to flat) is answered by faces on the host, for 1,000 states of a call at most, outside transformations.

    Raises:
        TypeError: for wrong shapes, contacts in place of a cone, or an actuation of other contacts.
        ValueError: for a momentum box that is negative or not finite.

    Source: Section III, as `capturability`.
    """
    check_cone(cone)
    checked_gravity(gravity, finite=False)
    _check_shapes(cone, coms, com_velocities, specific_angular_momentum)
    cone, arms = relative(cone, coms)
    positions, velocities, momenta = (rounded(as_given(x)) for x in (arms, com_velocities, specific_angular_momentum))
    limited = with_limits(cone, actuation, momentum_box, len(positions))
    own, common = own_or_common(limited)
    states = States(positions, velocities, own, unless_zero(momenta))
    xp: Any = jnp if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(gravity)) else np
    shared = Shared(xp.asarray(gravity, jnp.result_type(positions, jnp.float32)), common)
    if len(positions) == 0:
        return _of_no_state(jnp.promote_types(jnp.result_type(positions, velocities), jnp.float32))
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((states, shared.cone))):
        return scored_block(shared, states, neighbours)
    found = _over_devices(shared, states, neighbours)
    return decided(limited, states, gravity, found) if isinstance(limited, ConeRays) else found


def _of_no_state(dtype: DTypeLike) -> Capturability:
    """No answers, for which nothing is compiled."""
    return Capturability(*(jax.device_put(np.zeros(0, CODES.get(name, dtype))) for name in Capturability._fields))


def _over_devices(shared: Shared, states: States, neighbours: bool) -> Capturability:
    devices = spread_over((states, shared))
    shares = max(len(devices), 1)
    block, n = shares * (BLOCK if states.cones is None else RAYS_BLOCK), len(states.coms)
    if shares == 1:
        return over_blocks(lambda one: _one_block(shared, one, neighbours), states, n, block)
    spread = _spread(devices, neighbours)
    everywhere = spread.everywhere(shared)
    return over_blocks(lambda one: spread(everywhere, one.rows), states, n, block, shares)


def _one_block(shared: Shared, block: Block, neighbours: bool) -> Capturability:
    return _compiled(shared._replace(filled=block.filled), block.rows, neighbours=neighbours)


def _check_shapes(cone: CentroidalCone | ConeRays, coms: Any, com_velocities: Any, momenta: Any) -> None:
    """Raises TypeError."""
    given = {"coms": coms, "com_velocities": com_velocities, "specific_angular_momentum": momenta}
    vectors = {name: value for name, value in given.items() if name != "specific_angular_momentum" or value is not None}
    for name, value in vectors.items():
        if np.ndim(value) != 2 or np.shape(value)[1] != 3:
            raise TypeError(f"{name} has shape {np.shape(value)} (expected (n, 3))")
    n = len(coms)
    for name, value in vectors.items():
        if len(value) != n:
            raise TypeError(f"coms has {n} rows and {name} {len(value)} (expected as many)")
    if isinstance(cone, ConeRays) and cone.batched and len(cone.rays) != n:
        raise TypeError(f"cone has rays of {len(cone.rays)} contact sets (expected one, or one for each of {n} states)")


_compiled = Kept(scored_block, "neighbours")


@cache
def _spread(devices: tuple[jax.Device, ...], neighbours: bool) -> Spread:
    """A program for one block on each of the devices."""
    return Spread(lambda shared, states: scored_block(shared, states, neighbours), devices)
