"""A state's line of travel: the polygon cut along it, its survey, and the walk along its boundaries.

Everything here but the speed itself is independent of the speed. Arrays carry their lanes last.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int8, Num

from jaxcap.contacts.actuation import ActuatedRays
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import GRAVITY, ArrayLike
from jaxcap.numerics.guarded import direction, tolerances
from jaxcap.one_state.actuated_polygon import ActuatedPolygon, actuated_polygon
from jaxcap.one_state.boundary import Boundary, End
from jaxcap.one_state.face_polygon import polygon
from jaxcap.one_state.polygon import Producer, Survey
from jaxcap.one_state.ray_polygon import ray_polygon
from jaxcap.one_state.swings import Farthest, farthest_rest
from jaxcap.one_state.ways import ways

Cone = CentroidalCone | ConeRays | ActuatedRays
"""What a state may be scored by."""
QUICK = 2
"""Pieces of the lower boundary that the quick round walks: all there are for two states of three."""


FASTEST = 3e8
"""A state that is faster [m/s] is none of a robot, and its energy is beyond what the precision holds."""
FARTHEST = 0.1
"""A CoM is too far from the contacts where rounding of its weight's torque is worth more than this part of their size."""


class Line(NamedTuple):
    """The line of travel and the walk along it: everything that does not depend on the speed."""

    polygon: Producer
    survey: Survey
    ahead: Bool[Array, "*n"]
    """The static region lies ahead, and gravity pulls away from it."""
    hanging: Bool[Array, "*n"]
    """The polygon goes on beyond the static region, and gravity pulls back into it."""
    lower: Boundary
    """Smallest acceleration, to its end."""
    upper: Boundary
    """Minus the largest acceleration, to s_min, where the static region is `ahead`."""
    farthest: Farthest
    """Place of rest from which the robot is captured, where it is `hanging`."""
    skipped: Int8[Array, "*n"] | None = None
    """What a quick look left out: bits for the lower boundary's end, the way ahead, the way back; zero for nothing. None: it
    was no quick look."""

    @property
    def quick(self) -> bool:
        """No lane is `ahead` or `hanging` here, and nothing that only those need has to be compiled."""
        return self.skipped is not None


class Motion(NamedTuple):
    """A CoM on its line of travel."""

    line: Line
    speed: Float[Array, "*n"]
    """[m/s], >= 0."""
    finite: Bool[Array, "*n"]
    """False where the state, its contacts or gravity hold NaN or infinity, or what the precision cannot hold; the line is
    then that of another state."""


class _Cut(NamedTuple):
    """A state's polygon along its velocity."""

    polygon: Producer
    speed: Float[Array, "*n"]
    finite: Bool[Array, "*n"]


def motion_of_lanes(
    cone: Cone,
    com: Num[Array, "3 *n"],
    com_velocity: Num[Array, "3 *n"],
    gravity: ArrayLike,
    survey: Survey | None = None,
    quick: bool = False,
    specific_angular_momentum: Num[Array, "3 *n"] | None = None,
    rising: bool = False,
) -> Motion:
    """States side by side, lanes last, on their lines of travel.

    survey: from `survey_of_lanes`, if it is known. quick: only what most states need; `Line.skipped` says which need more.
    specific_angular_momentum: as `capturability` has it [m^2/s]. rising: the lower boundary goes on where the acceleration
    is not negative, to the polygon's end; no decision is made by such a line, which has no C1.
    """
    cut = _cut(cone, com, com_velocity, gravity, specific_angular_momentum)
    line = _line(cut.polygon, cut.polygon.survey() if survey is None else survey, quick, rising)
    return Motion(line, cut.speed, cut.finite)


@jax.jit
def survey_of_lanes(
    cone: Cone,
    com: Num[Array, "3 *n"],
    com_velocity: Num[Array, "3 *n"],
    gravity: ArrayLike,
    near: Any = None,
    specific_angular_momentum: Num[Array, "3 *n"] | None = None,
) -> Survey:
    """The first part of `motion_of_lanes`, which every state needs. near: `Survey.near` of similar states."""
    return _cut(cone, com, com_velocity, gravity, specific_angular_momentum).polygon.survey(near)


def _cut(cone: Cone, com: Array, com_velocity: Array, gravity: ArrayLike, momentum: Array | None) -> _Cut:
    dtype = jnp.promote_types(jnp.result_type(com, com_velocity), jnp.float32)
    known = _finite_cone(cone)
    if isinstance(cone, ActuatedRays):
        cone = cone.without_what_is_not_finite()
    com, com_velocity, pull = com.astype(dtype), com_velocity.astype(dtype), jnp.asarray(gravity, dtype)
    pulls = jnp.all(jnp.isfinite(pull))
    finite = jnp.all(jnp.isfinite(com) & jnp.isfinite(com_velocity), axis=0) & pulls & known
    if momentum is not None:
        momentum = momentum.astype(dtype)
        finite &= jnp.all(jnp.isfinite(momentum), axis=0)
    along, speed = direction(jnp.where(finite, com_velocity, 0))
    spin = None
    if momentum is not None:
        along, speed, spin = _spun(along, speed, jnp.where(finite, momentum, 0), jnp.asarray(cone.length, dtype))
    cut = _producer(cone)
    # What is not finite gives way to numbers, of which the walk can make sense.
    found = cut(cone, jnp.where(finite, com, 0), along, jnp.where(pulls, pull, jnp.asarray(GRAVITY, dtype)), spin)
    near = tolerances(dtype).slack * found.size <= FARTHEST * jnp.asarray(cone.length, dtype)
    return _Cut(found, speed, finite & near & (speed <= FASTEST))


class _Spun(NamedTuple):
    """A CoM's motion, and the angular momentum that goes with it."""

    along: Float[Array, "3 *n"]
    speed: Float[Array, "*n"]
    spin: Float[Array, "3 *n"]
    """Angular momentum over mass and speed [m], see `wrench_line`."""


def _spun(
    along: Float[Array, "3 *n"], speed: Float[Array, "*n"], momentum: Float[Array, "3 *n"], length: Float[Array, "*#n"]
) -> _Spun:
    """The spin of a state. A CoM may be so slow that its momentum is lost in the rounding of the angular momentum: it then
    counts as at rest, where the spin is zero.

    That is the limit: the slower the CoM, the shorter the way on which it takes the angular momentum along to rest, and what
    is left to ask is whether it can stand where it is.
    """
    size = jnp.sqrt(jax.lax.stop_gradient(jnp.sum(momentum * momentum, axis=0)))
    moving = (speed > 0) & (speed * length * (FARTHEST / tolerances(speed.dtype).slack) >= size)
    at_rest = lambda vector: jnp.where(moving, vector, 0)
    return _Spun(at_rest(along), at_rest(speed), at_rest(momentum / jnp.where(moving, speed, 1)))


def _producer(cone: Cone) -> Any:
    """What makes a polygon of it."""
    if isinstance(cone, ActuatedRays):
        return actuated_polygon
    return ray_polygon if isinstance(cone, ConeRays) else polygon


def _finite_cone(cone: Cone) -> Bool[Array, "*n"]:
    """Whether faces or rays, and what the robot can do with them, are numbers, lane by lane."""
    if isinstance(cone, ActuatedRays):
        return _finite_cone(cone.rays) & cone.finite
    rows = cone.rays if isinstance(cone, ConeRays) else jnp.asarray(cone.faces)
    finite = jnp.all(jnp.isfinite(rows), axis=(0, 1)) & jnp.all(jnp.isfinite(jnp.asarray(cone.origin)), axis=0)
    if isinstance(cone, CentroidalCone) and cone.offsets is not None:
        finite &= jnp.all(jnp.isfinite(jnp.asarray(cone.offsets)), axis=0)
    if isinstance(cone, CentroidalCone) and cone.effort is not None:
        for part in cone.effort:
            finite &= jnp.all(jnp.isfinite(jnp.asarray(part)))
    return finite


def _line(polygon: Producer, survey: Survey, quick: bool, rising: bool) -> Line:
    """quick: without what only some states need, a lower boundary of more than a few pieces, an upper one, swings."""
    polygon = polygon.knowing(survey)
    lower = polygon.boundary(jnp.where(survey.feasible, jnp.inf, 0), rising, most=QUICK if quick else None)
    if isinstance(polygon, ActuatedPolygon) and not quick:
        survey = polygon.completed(survey, lower.ending != End.DIVERGES)
    standing = survey.standing & survey.feasible
    ahead = standing & (survey.s_min > 0) & survey.pulled_back
    same_alpha = tolerances(survey.s_max.dtype).same_alpha * polygon.size
    hanging = standing & (lower.ending != End.DIVERGES) & (survey.s_max < lower.end - same_alpha)
    if quick:
        unfinished = lower.ending == End.MAX_PIECES
        # Without the end of the lower boundary, what ends the static region says whether the polygon may go on beyond it.
        hanging = jnp.where(unfinished, standing & survey.hangs, hanging)
        if isinstance(polygon, ActuatedPolygon):  # its static region is not known yet
            hanging = ~survey.standing | survey.feasible & (lower.ending != End.DIVERGES)
        skipped = (unfinished + 2 * ahead + 4 * hanging).astype(jnp.int8)
        none = jnp.zeros_like(ahead)
        farthest = Farthest(survey.s_max, jnp.ones_like(ahead))
        return Line(polygon, survey, none, none, lower, jax.tree.map(jnp.zeros_like, lower), farthest, skipped)
    # A static region without length takes no energy.
    beyond = hanging & (survey.s_max - survey.s_min > same_alpha) & (not rising)
    upper, outwards, back = ways(polygon, survey, ahead, beyond, lower)
    farthest = farthest_rest(outwards, back, survey.s_max, beyond)
    return Line(polygon, survey, ahead, hanging, lower, upper, farthest)
