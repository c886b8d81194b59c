"""Verdict and margins of a line of travel at a speed.

The capturable speeds along a direction are one interval, and every decision of Algorithms 1 and 2 is a comparison of the
speed with an energy integral (see `boundary`).
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Num

from jaxcap.numerics.guarded import greater, lesser, root, select
from jaxcap.one_state.boundary import End
from jaxcap.one_state.line import Line, Motion
from jaxcap.one_state.polygon import Survey
from jaxcap.one_state.reach import reach_time
from jaxcap.one_state.result import Capturability, Case, Status
from jaxcap.one_state.swings import swing

LIMITS = ("min_speed", "max_speed")
"""The capturable speeds of a direction."""
AT_ANY_SPEED = (*LIMITS, "effort")
"""Fields that do not depend on the speed; the effort does not on the direction either."""
UNHELD = 0.5
"""Margin of a posture that cannot be held, for each part of the torque limits that it lacks [m/s]: it only orders states."""
WALKED = ("status", "paper_margin", "distance", "time", "residual_speed")
"""Fields for which the motion itself is followed; the others are comparisons of the speed with a few numbers."""


class Speeds(NamedTuple):
    """Where case and verdict change with the speed along a line [m/s]; infinite where they do not."""

    smallest: Float[Array, "*n"]
    """Below it the static region ahead cannot be reached."""
    stops_before: Float[Array, "*n"]
    """Below it maximum deceleration stops before the static region."""
    stops_inside: Float[Array, "*n"]
    """Up to it maximum deceleration stops before the far end of the static region."""
    largest: Float[Array, "*n"]
    """Up to it the robot comes to rest in the static region, perhaps after swings."""
    stops: Float[Array, "*n"]
    """Up to it maximum deceleration stops anywhere."""
    known: Bool[Array, "*n"]
    """False where a boundary has more pieces than are walked."""


def capturability_at(motion: Motion) -> Capturability:
    """`capturability` of motions side by side, lanes last."""
    return _answer(motion, _speeds(motion.line))


def capturability_along(motion: Motion, speeds: Num[Array, "k"], fields: tuple[str, ...]) -> dict[str, Array]:
    """Fields of `capturability` on lines of travel side by side, lanes last, at every one of k speeds [m/s], >= 0.

    motion: its speed does not matter. Fields `AT_ANY_SPEED` have shape (*n), the others (k, *n). Polygon, survey and walk
    are made once for all speeds. At speed zero the answer is that of a zero velocity, but for `LIMITS`, which are those of
    the direction.
    """
    line, finite = motion.line, motion.finite
    limits = _speeds(line)

    def at(speed):
        known = finite & jnp.isfinite(speed)
        speed = jnp.where(known, speed, 0)
        rests = known & (speed == 0)
        moving = _answer(Motion(line, speed, known), limits)
        answer = jax.tree.map(functools.partial(jnp.where, rests), _still(line), moving)
        return {name: getattr(answer, name) for name in fields if name not in AT_ANY_SPEED}

    # Where each speed has loops of its own, side by side all would take as long as the slowest, and skip nothing.
    answers = jax.lax.map(at, speeds) if set(fields) & set(WALKED) else jax.vmap(at)(speeds)
    of_line = {"min_speed": limits.smallest, "max_speed": limits.largest, "effort": _effort(line.survey)}
    known = lambda value: jnp.where(finite & limits.known, value, jnp.nan)
    return answers | {name: known(value) for name, value in of_line.items() if name in fields}


def _speeds(line: Line) -> Speeds:
    """By the energy integrals: to stop within alpha is to have no more energy than deceleration takes until there."""
    lower, s_min, s_max = line.lower, line.survey.s_min, line.survey.s_max

    def stops_within(alpha):
        endless = (alpha == jnp.inf) | (lower.ending == End.FLOORLESS)
        return jnp.where(alpha < 0, 0, jnp.where(endless, jnp.inf, root(-2 * lower.gain(jnp.maximum(alpha, 0)))))

    stops = jnp.where(line.survey.feasible, stops_within(lower.end), 0)
    some = line.survey.standing & line.survey.feasible
    if line.quick:
        none, known = jnp.zeros_like(stops), line.survey.known & (lower.ending != End.MAX_PIECES)
        return Speeds(none, none, stops, jnp.where(some, stops, 0), stops, known)
    inside = jnp.where(line.hanging, stops_within(s_max), stops)
    largest = jnp.where(line.hanging, greater(stops_within(line.farthest.alpha), inside), stops)
    before = jnp.where(line.ahead, lesser(stops_within(s_min), inside), 0)
    smallest = jnp.where(line.ahead, lesser(root(2 * line.upper.gain(s_min)), before), 0)
    walked = (lower.ending != End.MAX_PIECES) & (line.upper.ending != End.MAX_PIECES) & line.farthest.known
    known = line.survey.known & walked
    return Speeds(jnp.where(some, smallest, 0), before, inside, jnp.where(some, largest, 0), stops, known)


def _case(line: Line, speeds: Speeds, speed: Array) -> Array:
    """The leaf of the decision tree (Fig. 3)."""
    return select(
        [
            ~line.survey.standing,
            ~line.survey.feasible,
            speed > speeds.stops,
            line.ahead & (speed < speeds.smallest),
            line.ahead & (speed < speeds.stops_before),
            line.hanging & (speed > speeds.stops_inside),
        ],
        [
            Case.EMPTY,
            Case.C2,
            jnp.where(line.lower.ending == End.DIVERGES, Case.C1, Case.C2),
            Case.C3_2_2,
            Case.C3_2_1,
            Case.C3_3,
        ],
        Case.C3_1,
    )


def _still(line: Line) -> Capturability:
    """The answer at speed zero: the static region of any line through the CoM says whether it can stand where it is."""
    survey = line.survey
    stands = survey.known & survey.standing & survey.feasible & stands_here(survey)
    none = jnp.full_like(survey.s_min, jnp.nan)
    case = jnp.where(stands, Case.C3_1, jnp.where(survey.known, Case.EMPTY, Case.UNDECIDED))
    return Capturability(
        capturable=stands,
        case=case.astype(jnp.int8),
        status=jnp.where(survey.known, Status.NO_DIRECTION, Status.MAX_STEPS).astype(jnp.int8),
        margin=none,
        min_speed=none,
        max_speed=none,
        paper_margin=none,
        distance=jnp.where(stands, 0, none),
        time=jnp.where(stands, 0, none),
        residual_speed=jnp.where(survey.known, 0, none),
        effort=jnp.where(survey.known, _effort(survey), none),
    )


def _effort(survey: Survey) -> Array:
    """NaN without the robot's limits."""
    return jnp.full_like(survey.s_min, jnp.nan) if survey.effort is None else survey.effort


def stands_here(survey: Survey) -> Bool[Array, "*n"]:
    """The CoM may stay where it is."""
    return (survey.s_min <= 0) & (survey.s_max >= 0) if survey.effort is None else survey.effort <= 1


def _unheld(survey: Survey) -> Array:
    """Torques hold the posture, but not within their limits.

    Where none at all do, no torque is what is missing: the walk alone decides, as without limits.
    """
    return (_effort(survey) > 1) & jnp.isfinite(_effort(survey))


class _Way(NamedTuple):
    """How the CoM comes to rest, or does not."""

    stop: Float[Array, "*n"]
    """Length of the path to the stop [m]."""
    duration: Float[Array, "*n"]
    """[s]"""
    deceleration: Float[Array, "*n"]
    """The largest at the stop of maximum deceleration [m/s^2]."""
    residual: Float[Array, "*n"]
    """Speed that is left where there is no stop [m/s]."""
    swinging: Bool[Array, "*n"]
    """It still swings at the bound on swings."""


def _way(line: Line, speeds: Speeds, speed: Array, case: Array) -> _Way:
    """The motion itself, followed to its end."""
    lower, energy = line.lower, speed * speed / 2
    at_once = lower.ending == End.FLOORLESS
    ride = lower.ride(jnp.where(at_once, 0, energy))
    gain, stops = lower.gain(lower.end), jnp.where(jnp.isfinite(speeds.stops), speeds.stops, speed)
    # speed^2 + 2 gain, in the form without cancellation where the walk nearly stops
    excess = jnp.where(gain > 0, speed * speed + 2 * gain, (speed - stops) * (speed + stops))
    residual = jnp.where(line.survey.feasible, root(excess), speed)
    deceleration = jnp.where(at_once, jnp.inf, -lower.at(ride.alpha))
    if line.quick:
        return _Way(ride.alpha, ride.time, deceleration, residual, jnp.zeros_like(at_once))
    reaching, swung = case == Case.C3_2_1, case == Case.C3_3
    reached = reach_time(lower, line.upper, line.survey.s_min, energy, reaching)
    swings = swing(line.polygon, line.survey.s_min, line.survey.s_max, ride, swung & (speed > 0))
    return _Way(
        stop=jnp.where(swung, swings.distance, jnp.where(reaching, line.survey.s_min, ride.alpha)),
        duration=jnp.where(swung, swings.time, jnp.where(reaching, reached, ride.time)),
        deceleration=deceleration,
        residual=jnp.where(swung, swings.residual_speed, residual),
        swinging=swings.swinging,
    )


def _answer(motion: Motion, speeds: Speeds) -> Capturability:
    line, speed, finite = motion
    case, moving = _case(line, speeds, speed), speed > 0
    # Where no speed is capturable the margin is minus the whole speed: `largest` is zero.
    margin = lesser(speeds.largest - speed, jnp.where(line.ahead, speed - speeds.smallest, jnp.inf))
    effort, unheld = _effort(line.survey), _unheld(line.survey)
    lacking = UNHELD * (1 - jnp.where(unheld, effort, 1))
    margin = jnp.where(unheld, lesser(margin, lacking), margin)
    way = _way(line, speeds, speed, case)
    status = select(
        [~finite, ~speeds.known, ~moving, way.swinging],
        [Status.NONFINITE, Status.MAX_STEPS, Status.NO_DIRECTION, Status.MAX_SWINGS],
        Status.OK,
    )
    decided = finite & speeds.known
    capturable = jnp.where(moving, (margin >= 0) & ~unheld, line.survey.standing & stands_here(line.survey)) & decided
    stopped = capturable & (status != Status.MAX_SWINGS)
    figure = lambda known, value: jnp.where(decided & known, value, jnp.nan)
    return Capturability(
        capturable=capturable,
        case=jnp.where(decided, case, Case.UNDECIDED).astype(jnp.int8),
        status=status.astype(jnp.int8),
        margin=figure(moving, margin),
        min_speed=figure(moving, speeds.smallest),
        max_speed=figure(moving, speeds.largest),
        # 0 - residual: minus zero would show in a file
        paper_margin=figure(moving, jnp.where(capturable, way.deceleration, 0 - way.residual)),
        distance=figure(stopped, way.stop),
        time=figure(stopped, way.duration),
        residual_speed=figure(True, jnp.where(capturable, 0, way.residual)),
        effort=figure(True, effort),
    )
