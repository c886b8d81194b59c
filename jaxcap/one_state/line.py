"""A state's line of travel: the polygon cut along it, its survey, and the walk along its boundaries.

Everything here is independent of the speed. Arrays carry their lanes last.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int8, Num

from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.numerics.guarded import direction, tolerances
from jaxcap.one_state.boundary import Boundary, End
from jaxcap.one_state.face_polygon import polygon
from jaxcap.one_state.polygon import Producer, Survey
from jaxcap.one_state.ray_polygon import ray_polygon

QUICK = 2
"""Pieces of the lower boundary that the quick round walks: all there are for two states of three."""

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
    left: Int8[Array, "*n"]
    """What a quick look has left out: bits for the lower boundary's end, the way ahead, the way back; zero for nothing."""


def travel_of_lanes(
    cone: CentroidalCone | ConeRays,
    com: Num[Array, "3 *n"],
    com_velocity: Num[Array, "3 *n"],
    gravity,
    survey: Survey | None = None,
    quick: bool = False,
) -> tuple[Line, Float[Array, "*n"], Bool[Array, "*n"]]:
    """Lines of travel side by side, lanes last; the speed along each, and whether the state is finite.

    survey: from `survey_of_lanes`, if it is known. quick: only what most states need; `Line.left` says which need more.
    """
    polygon, speed, finite = _polygon(cone, com, com_velocity, gravity)
    look = _glance if quick else _line
    return look(polygon, polygon.survey() if survey is None else survey), speed, finite


@jax.jit
def survey_of_lanes(
    cone: CentroidalCone | ConeRays, com: Num[Array, "3 *n"], com_velocity: Num[Array, "3 *n"], gravity, near=None
) -> Survey:
    """The first part of `travel_of_lanes`, which every state needs. near: `Survey.near` of similar states."""
    return _polygon(cone, com, com_velocity, gravity)[0].survey(near)


def _polygon(cone, com, com_velocity, gravity):
    """Polygon, speed, and whether the state is finite."""
    dtype = jnp.promote_types(jnp.result_type(com, com_velocity), jnp.float32)
    com, com_velocity = com.astype(dtype), com_velocity.astype(dtype)
    finite = jnp.all(jnp.isfinite(com) & jnp.isfinite(com_velocity), axis=0)
    if isinstance(cone, ConeRays):
        finite &= jnp.all(jnp.isfinite(cone.rays), axis=(0, 1))
    along, speed = direction(jnp.where(finite, com_velocity, 0))
    cut = ray_polygon if isinstance(cone, ConeRays) else polygon
    return cut(cone, jnp.where(finite, com, 0), along, jnp.asarray(gravity, dtype)), speed, finite


def _line(polygon: Producer, survey: Survey) -> Line:
    polygon = polygon.knowing(survey)
    standing = survey.standing & survey.feasible
    lower = polygon.boundary(jnp.where(survey.feasible, jnp.inf, 0))
    ahead = standing & (survey.s_min > 0) & survey.pulled_back
    skip = lambda polygon, limit: jax.tree.map(jnp.zeros_like, lower)
    walk_up = lambda polygon, limit: polygon.flipped().boundary(limit)
    upper = jax.lax.cond(jnp.any(ahead), walk_up, skip, polygon, jnp.where(ahead, survey.s_min, 0))
    same_alpha = tolerances(survey.s_max.dtype).same_alpha * polygon.size
    hanging = standing & (lower.ending != End.DIVERGES) & (survey.s_max < lower.end - same_alpha)
    return Line(polygon, survey, ahead, hanging, lower, upper, jnp.zeros(ahead.shape, jnp.int8))


def _glance(polygon: Producer, survey: Survey) -> Line:
    """The line without what only some states need: a lower boundary of more than a few pieces, an upper one, swings."""
    polygon = polygon.knowing(survey)
    standing = survey.standing & survey.feasible
    lower = polygon.boundary(jnp.where(survey.feasible, jnp.inf, 0), most=QUICK)
    unfinished = lower.ending == End.MAX_PIECES
    same_alpha = tolerances(survey.s_max.dtype).same_alpha * polygon.size
    ahead = standing & (survey.s_min > 0) & survey.pulled_back
    hanging = standing & (lower.ending != End.DIVERGES) & (survey.s_max < lower.end - same_alpha)
    hanging = jnp.where(unfinished, standing & survey.hangs, hanging)
    left = (unfinished + 2 * ahead + 4 * hanging).astype(jnp.int8)
    nowhere, none = jax.tree.map(jnp.zeros_like, lower), jnp.zeros_like(ahead)
    return Line(polygon, survey, none, none, lower, nowhere, left)
