"""The entry: one state in, one answer out; verdict, case, margins, distance, time. Arrays carry their lanes last."""

import jax
from jaxtyping import Array, Num

from jaxcap.contacts.actuation import Actuation, with_limits
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, checked_gravity
from jaxcap.contacts.scoring_input import as_given, check_cone, relative, rounded, unless_zero
from jaxcap.one_state.decision import capturability_at
from jaxcap.one_state.line import Cone, motion_of_lanes
from jaxcap.one_state.result import Capturability


def capturability(
    cone: CentroidalCone | ConeRays,
    com: ArrayLike,
    com_velocity: ArrayLike,
    gravity: ArrayLike = GRAVITY,
    *,
    specific_angular_momentum: ArrayLike | None = None,
    actuation: Actuation | None = None,
    momentum_box: ArrayLike = 0.0,
) -> Capturability:
    """Can the robot come to rest without moving a contact, its CoM decelerating along its own velocity?

    One state, pure: works under jit, vmap, jacfwd, jacrev and grad; `score` is much faster for many. Compiled at the first
    call for each number of faces or rays. Never raises for the values of a state: see `Status`.

    Args:
        cone: from `centroidal_cone` or `cone_rays`; with rays, the answer is also differentiable in the contacts.
        com: (3,) [m], in the contacts' frame, z up. Its dtype decides the precision; NumPy's positions far from the origin
            lose nothing, for the contacts' centroid is subtracted before they are rounded.
        com_velocity: (3,) [m/s].
        gravity: (3,) [m/s^2].
        specific_angular_momentum: (3,) the robot's angular momentum about its CoM, over its mass, in the frame of the
            contacts [m^2/s]; None for zero, the paper's model. It comes to rest in proportion to the CoM's speed (and turns
            with the CoM where that swings back), so speeds and margin are those of a robot that has more or less of both.
            At zero velocity it does not count: the answer says whether the robot can stand where it is.
        actuation: what the robot's joints can bear in its posture; with rays only. The answer is differentiable in it too.
        momentum_box: how much the rate of angular momentum per unit mass may differ from what braking brings about, in each
            component, >= 0 [m^2/s^2]. Other than zero with rays only; faces have it from `centroidal_cone`.

    Returns:
        The verdict, how it ends, margins [m/s], and the way to the stop.

    Raises:
        TypeError: for a wrong shape, contacts in place of a cone, or an actuation of other contacts.
        ValueError: for a momentum box that is negative or not finite.

    Source: Section III, Algorithms 1 and 2, with the energy in place of time; C3.3, which the paper leaves open, by swings.
    """
    check_cone(cone)
    checked_gravity(gravity, finite=False)
    position, velocity, momentum = map(as_given, (com, com_velocity, specific_angular_momentum))
    for name, value in (("com", position), ("com_velocity", velocity), ("specific_angular_momentum", momentum)):
        if value is not None and value.shape != (3,):
            raise TypeError(f"{name} has shape {value.shape} (expected (3,); `score` takes many states)")
    cone, position = relative(cone, position)
    limited = with_limits(cone, actuation, momentum_box)
    return capturability_of_lanes(limited, position, rounded(velocity), gravity, unless_zero(rounded(momentum)))


@jax.jit
def capturability_of_lanes(
    cone: Cone,
    com: Num[Array, "3 *n"],
    com_velocity: Num[Array, "3 *n"],
    gravity: ArrayLike,
    specific_angular_momentum: Num[Array, "3 *n"] | None = None,
) -> Capturability:
    """`capturability` of states side by side, lanes last."""
    return capturability_at(
        motion_of_lanes(cone, com, com_velocity, gravity, specific_angular_momentum=specific_angular_momentum)
    )
