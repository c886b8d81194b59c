"""The state after a time of the manoeuvre by which the robot would stop, or of the hardest braking that it has.

The walk's lower boundary is followed, in time. It goes on where the acceleration is no longer negative: a robot that cannot
stop (C1) keeps its contacts and is carried along its line. One that would stop too early, and has a way to where it can
stand (C3.2.1), takes that: so what is capturable stays so.

Angular momentum keeps its proportion to the CoM's speed all the way, L = l alphadot: only so are all later states on the
line and in the polygon of the first, and to go on from one of them, or to score it, is to go on with the same manoeuvre.
In a fall no torque acts about the CoM, and it stays as it is.
"""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int8, Num

from jaxcap.contacts.actuation import ActuatedRays
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import ArrayLike, FloatArray
from jaxcap.numerics.guarded import ratio, select, tolerances
from jaxcap.one_state.boundary import End
from jaxcap.one_state.decision import stands_here
from jaxcap.one_state.line import FASTEST, Cone, Line, motion_of_lanes
from jaxcap.one_state.polygon import Survey
from jaxcap.one_state.reach import switch_of
from jaxcap.one_state.result import Status
from jaxcap.one_state.timed_ride import TimedRide, ride_on


class Progress(IntEnum):
    """How far a robot has come when the time is up."""

    UNDECIDED = -1
    """No answer was found; `Status` says why."""
    ON_THE_WAY = 0
    """It moves on along its line, and keeps its contacts."""
    RESTS = 1
    """It has come to rest where it can stand, and stays there."""
    TURNS = 2
    """It has come to rest where it cannot stand, and would fall or swing back: not followed, the state is that at rest."""
    LEAVES = 3
    """No acceleration along its line keeps the contacts any longer (C2): the state is that where they are lost."""
    FLIES = 4
    """There is no contact: free fall."""


class Advanced(NamedTuple):
    """The state after a time, or as far as it could be followed; arrays with one leading axis for many.

    Differentiable in state, duration, gravity and, by rays, contacts, away from kinks. Figures of states that are undecided
    are NaN.
    """

    com: Float[FloatArray, "*n 3"]
    """[m], in the contacts' frame."""
    com_velocity: Float[Array, "*n 3"]
    """[m/s]"""
    displacement: Float[Array, "*n 3"]
    """From the CoM that was given [m]: not rounded by where the origin is."""
    time: Float[Array, "*n"]
    """That was followed [s]: less than the duration where it RESTS, TURNS or LEAVES before."""
    progress: Int8[Array, "*n"]
    """A `Progress`."""
    status: Int8[Array, "*n"]
    """A `Status`."""
    specific_angular_momentum: Float[Array, "*n 3"] | None = None
    """About the CoM, over the mass [m^2/s]: what was given, times the share of the speed that is left; unchanged in free
    fall, and where there was no speed, for then it does not count. None where none was given."""


class Moved(NamedTuple):
    """`Advanced` without the place that it counts from, lanes last."""

    com_velocity: Float[Array, "3 *n"]
    displacement: Float[Array, "3 *n"]
    time: Float[Array, "*n"]
    progress: Int8[Array, "*n"]
    status: Int8[Array, "*n"]
    specific_angular_momentum: Float[Array, "3 *n"] | None = None


@jax.jit
def advance_of_lanes(
    cone: Cone,
    com: Num[Array, "3 *n"],
    com_velocity: Num[Array, "3 *n"],
    duration: Num[Array, "*#n"],
    gravity: ArrayLike,
    specific_angular_momentum: Num[Array, "3 *n"] | None = None,
) -> Moved:
    """`advance` of states side by side, lanes last.

    cone: of all lanes, or of each. com: [m]. com_velocity: [m/s]. duration: [s]. gravity: (3,) [m/s^2].
    specific_angular_momentum: [m^2/s].
    """
    momentum = specific_angular_momentum
    motion = motion_of_lanes(cone, com, com_velocity, gravity, specific_angular_momentum=momentum, rising=True)
    line, speed, finite = motion
    dtype = speed.dtype
    duration = jnp.broadcast_to(jnp.asarray(duration, dtype), speed.shape)
    finite &= jnp.isfinite(duration) & (duration >= 0)
    duration = jnp.where(finite, duration, 0)
    ride = _ride(line, speed, duration)
    flies = ~_touching(cone)
    left = (ride.time_left > 0) & (ride.rested == 0)
    unknown = ~line.survey.known | (line.upper.ending == End.MAX_PIECES)
    unknown |= left & (line.lower.ending == End.MAX_PIECES) & line.survey.feasible
    finite &= ride.speed <= FASTEST
    decided = finite & (flies | ~unknown)
    moving = speed > 0
    progress = select(
        [~decided, flies, ride.rested > 0, left & moving],
        [Progress.UNDECIDED, Progress.FLIES, _at_rest(line, ride.alpha), Progress.LEAVES],
        jnp.where(moving, Progress.ON_THE_WAY, jnp.where(_stands(line.survey), Progress.RESTS, Progress.TURNS)),
    )
    status = select(
        [~finite, ~decided, ~moving & ~flies], [Status.NONFINITE, Status.MAX_STEPS, Status.NO_DIRECTION], Status.OK
    )
    velocity, pull = com_velocity.astype(dtype), _column(gravity, com_velocity.astype(dtype))
    # A velocity that stays as it is stays so to the bit.
    along = velocity * ratio(ride.alpha, speed)
    left_of_it = ratio(ride.speed, speed, 1.0)
    figure = lambda value: jnp.where(decided, value, jnp.nan)
    return Moved(
        com_velocity=figure(jnp.where(flies, velocity + pull * duration, velocity * left_of_it)),
        displacement=figure(jnp.where(flies, velocity * duration + pull * (duration * duration / 2), along)),
        time=figure(jnp.where(flies, duration, jnp.where(moving, duration - ride.time_left, 0))),
        progress=progress.astype(jnp.int8),
        status=status.astype(jnp.int8),
        specific_angular_momentum=None
        if momentum is None
        else figure(jnp.where(flies, 1, left_of_it) * momentum.astype(dtype)),
    )


def _ride(line: Line, speed: Array, duration: Array) -> TimedRide:
    """Along the lower boundary; where that stops too early and there is a way to S, first along the upper one."""
    lower, s_min, energy, none = line.lower, line.survey.s_min, speed * speed / 2, jnp.zeros_like(speed)
    target = jnp.where(line.ahead, s_min, 0)
    floorless = lower.ending == End.FLOORLESS
    reaching = line.ahead & (energy >= line.upper.gain(target)) & (floorless | (energy < -lower.gain(target)))
    target = jnp.where(reaching, target, 0)
    switch = jnp.where(reaching, switch_of(lower, line.upper, target, energy), 0)
    ride = TimedRide(none, speed, duration, none)
    ride = ride_on(line.upper.negated(), switch, ride)
    # Forces without limit stop the CoM at once, where it stands or where it has come to.
    at_once = floorless & (ride.time_left > 0)
    halted = ride._replace(speed=jnp.where(at_once, 0, ride.speed), rested=jnp.where(at_once, 1, ride.rested))
    end = jnp.where(lower.ending == End.POLYGON, lower.end, jnp.inf)
    ride = ride_on(lower, end, halted)
    return ride._replace(alpha=jnp.where(reaching & (ride.rested > 0), target, ride.alpha))


def _at_rest(line: Line, alpha: Array) -> Array:
    """Progress of a CoM that has come to rest there."""
    survey = line.survey
    near = tolerances(alpha.dtype).same_alpha * line.polygon.size
    inside = survey.standing & (survey.s_min - near <= alpha) & (alpha <= survey.s_max + near)
    return jnp.where(inside, Progress.RESTS, Progress.TURNS)


def _stands(survey: Survey) -> Array:
    """Whether a CoM at rest stays where it is."""
    return survey.standing & survey.feasible & stands_here(survey)


def _touching(cone: Cone) -> Bool[Array, "*n"]:
    """Whether there is a contact at all. Faces are never of none."""
    if isinstance(cone, CentroidalCone):
        return jnp.ones((), bool)
    rays: ConeRays = cone.rays if isinstance(cone, ActuatedRays) else cone
    return jnp.any(jnp.asarray(rays.mask), axis=0)


def _column(gravity: ArrayLike, like: Array) -> Array:
    return jnp.asarray(gravity, like.dtype).reshape(3, *[1] * (like.ndim - 1))
