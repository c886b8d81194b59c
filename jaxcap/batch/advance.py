"""The state after a time, of one state or of many."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Num

from jaxcap.batch.blocks import BLOCK, RAYS_BLOCK, Block, over_blocks, over_chunks, own_or_common
from jaxcap.contacts.actuation import ActuatedRays, Actuation, with_limits
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, checked_gravity
from jaxcap.contacts.scoring_input import as_given, check_cone, relative, rounded, unless_zero
from jaxcap.one_state.advance import Advanced, Moved, advance_of_lanes
from jaxcap.one_state.line import Cone


class _Rows(NamedTuple):
    """What differs from state to state."""

    coms: Num[Array, "n 3"]
    com_velocities: Num[Array, "n 3"]
    durations: Num[Array, "n"]
    cones: ConeRays | ActuatedRays | None
    momenta: Num[Array, "n 3"] | None


def advance(
    cone: CentroidalCone | ConeRays,
    com: ArrayLike,
    com_velocity: ArrayLike,
    duration: ArrayLike,
    gravity: ArrayLike = GRAVITY,
    *,
    specific_angular_momentum: ArrayLike | None = None,
    actuation: Actuation | None = None,
    momentum_box: ArrayLike = 0.0,
) -> Advanced:
    """Where the robot is after some time of braking as hard as its contacts allow, along its own velocity.

    It does what `capturability` says it should: brake hardest, but no more than brings it to where it can stand (so what is
    capturable stays so). Where it cannot stop it is carried along its line, until the contacts are lost; without contacts it
    falls freely. One state or many; pure: works under jit, vmap, jacfwd, jacrev and grad. Never raises for the
    values of a state: see `Advanced.status`.

    Args:
        cone: from `centroidal_cone` or `cone_rays`; rays may be those of one contact set, or of each of n states.
        com: (3,), or (n, 3) for many states [m], in the contacts' frame, z up.
        com_velocity: (3,), or (n, 3) [m/s].
        duration: one number, or (n,) [s], >= 0. At zero the state is the same to the bit.
        gravity: (3,) [m/s^2].
        specific_angular_momentum: (3,), or (n, 3) about the CoM, over the mass, in the contacts' frame [m^2/s]; None for
            zero, the paper's model. It brakes, or grows, in proportion to the CoM's speed, as `capturability` has it: the
            state that comes back goes on by the same manoeuvre.
        actuation: what the robot's joints can bear, in one posture or in one for each state; with rays only.
        momentum_box: how much the rate of angular momentum per unit mass may differ from what braking brings about, in each
            component [m^2/s^2]: one number, or (n,); with rays only: `centroidal_cone` takes one for faces.

    Returns:
        The state then, and how it came there. NumPy's positions come back as NumPy's, in their own precision.

    Raises:
        TypeError: for wrong shapes, contacts in place of a cone, or an actuation of other contacts.
        ValueError: for a duration or a box that is negative or not finite.

    Source: Section III: (12) and the accelerations of (25)-(29); time on a piece in closed form, as (19)-(24).
    """
    check_cone(cone)
    checked_gravity(gravity, finite=False)
    start, velocity, given = map(as_given, (com, com_velocity, specific_angular_momentum))
    _check_shapes(cone, start, velocity, given)
    many = start.ndim == 2
    duration = checked_times("duration", duration, (len(start),) if many else ())
    near, position = relative(cone, start)
    limited = with_limits(near, actuation, momentum_box, len(start) if many else None)
    states, momenta = (position, rounded(velocity), rounded(duration)), unless_zero(rounded(given))
    one = advance_of_lanes if not many else _of_rows
    found = one(limited, *states, gravity, momenta)
    if given is not None and momenta is None:
        found = found._replace(specific_angular_momentum=0 * found.com_velocity)  # NaN where undecided
    # Positions far from the origin keep their precision: it is the difference that was computed.
    traced = any(isinstance(x, jax.core.Tracer) for x in (start, found.displacement))
    there = start + found.displacement if traced or isinstance(start, jax.Array) else start + np.asarray(found.displacement)
    return Advanced(com=there, **found._asdict())


def checked_times(name: str, times: Any, shape: tuple[int, ...]) -> Any:
    """Times as an array of this shape.

    Args:
        name: for messages.
        times: one number, or what broadcasts to `shape` [s].
        shape: wanted.

    Raises:
        TypeError: for what does not broadcast.
        ValueError: for a time that is negative or not finite. Values under a JAX transformation are not checked.
    """
    if not isinstance(times, jax.Array):
        times = np.asarray(times)
        if times.dtype.kind not in "iuf":
            raise TypeError(f"{name}: {times.dtype} (expected numbers of seconds)")
    sizes = f"one number, or {shape}" if shape else "one number"
    try:
        fits = np.broadcast_shapes(np.shape(times), shape) == shape
    except ValueError:
        fits = False
    if not fits:
        raise TypeError(f"{name} has shape {np.shape(times)} (expected {sizes})")
    if not isinstance(times, jax.core.Tracer):
        values = np.asarray(times)
        for index in np.argwhere(~(np.isfinite(values) & (values >= 0)))[:1]:
            place = f"[{', '.join(map(str, index))}]" if values.ndim else ""
            raise ValueError(f"{name}{place} = {values[tuple(index)]} (expected a finite number of seconds, not negative)")
    return (np if isinstance(times, np.ndarray) else jnp).broadcast_to(times, shape)


def _check_shapes(cone: CentroidalCone | ConeRays, com: Any, velocity: Any, momentum: Any) -> None:
    """Raises TypeError."""
    if com.ndim not in (1, 2) or com.shape[-1] != 3:
        raise TypeError(f"com has shape {com.shape} (expected (3,), or (n, 3) for many states)")
    if velocity.shape != com.shape:
        raise TypeError(f"com_velocity has shape {velocity.shape} (expected {com.shape}, as com)")
    if momentum is not None and momentum.shape != com.shape:
        raise TypeError(f"specific_angular_momentum has shape {momentum.shape} (expected {com.shape}, as com)")
    if isinstance(cone, ConeRays) and cone.batched and (com.ndim == 1 or len(cone.rays) != len(com)):
        count = "one state" if com.ndim == 1 else f"{len(com)} states"
        raise TypeError(f"cone has rays of {len(cone.rays)} contact sets (expected one, or one for each of {count})")


def _of_rows(cone: Cone, coms: Any, velocities: Any, durations: Any, gravity: ArrayLike, momenta: Any) -> Moved:
    own, common = own_or_common(cone)
    rows = _Rows(coms, velocities, durations, own, momenta)
    pull = jnp.asarray(gravity, jnp.result_type(coms, jnp.float32))
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((rows, common, pull))):
        return _block(common, Block(rows, None), pull)
    return over_blocks(lambda block: _block(common, block, pull), rows, len(coms), BLOCK if own is None else RAYS_BLOCK)


@jax.jit
def _block(common: Cone | None, block: Block, gravity: Num[Array, "3"]) -> Moved:
    def of_lanes(lanes: _Rows) -> Moved:
        cone = common if lanes.cones is None else lanes.cones
        assert cone is not None, "states without contacts"
        return advance_of_lanes(cone, lanes.coms, lanes.com_velocities, lanes.durations, gravity, lanes.momenta)

    return over_chunks(of_lanes, block.rows, filled=block.filled)
