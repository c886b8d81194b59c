"""Faces -> the (alpha, acceleration) polygon of one state: half-planes, static region, lower boundary.

Every array carries its lanes last, after rows: a single state has no lanes, a chunk of a batch has one axis of them, so that
the state index is the vectorised axis and a reduction over rows is a sum of vectors.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxcap.boundary import Boundary, End
from jaxcap.cone import CentroidalCone
from jaxcap.numerics import ratio, tolerances

MAX_PIECES = 24
"""Most pieces of a boundary that are walked. Seen: up to 11 for four rectangles with 16 sides."""


class Polygon(NamedTuple):
    """All (alpha, acceleration) with `on_acceleration * acceleration + on_alpha * alpha <= bound`, row by row, (11).

    alpha is the distance along the line of travel from the start [m], acceleration is along the line [m/s^2].
    """

    on_acceleration: Float[Array, "m *n"]
    """[-]; a row < 0 bounds the acceleration from below, > 0 from above, = 0 bounds alpha alone."""
    on_alpha: Float[Array, "m *n"]
    """[1/s^2]"""
    bound: Float[Array, "m *n"]
    """[m/s^2]"""
    size: Float[Array, "*n"]
    """Scale of alpha [m]: size of the stance plus distance of the CoM from it."""

    def flipped(self) -> "Polygon":
        """With the acceleration's sign turned: its lower boundary is minus the upper boundary of this one."""
        return self._replace(on_acceleration=-self.on_acceleration)

    def seen_from(self, start: Float[Array, "*n"], heading: Float[Array, "*n"]) -> "Polygon":
        """With alpha counted from `start`, onwards (heading +1) or back (-1); so is the acceleration."""
        return self._replace(
            on_acceleration=heading * self.on_acceleration,
            on_alpha=heading * self.on_alpha,
            bound=self.bound - self.on_alpha * start,
        )

    def static_region(self) -> tuple[Float[Array, "*n"], Float[Array, "*n"], Bool[Array, "*n"]]:
        """The alphas at which zero acceleration is feasible: s_min, s_max (perhaps infinite), and whether there are any."""
        at = ratio(self.bound, self.on_alpha)
        s_min = jnp.max(jnp.where(self.on_alpha < 0, at, -jnp.inf), axis=0)
        s_max = jnp.min(jnp.where(self.on_alpha > 0, at, jnp.inf), axis=0)
        barred = jnp.any((self.on_alpha == 0) & (self.bound < 0), axis=0)
        return s_min, s_max, ~barred & (s_min <= s_max)

    def start(self) -> tuple[Float[Array, "*n"], Float[Array, "*n"], Bool[Array, "*n"]]:
        """At alpha = 0: smallest and largest acceleration (perhaps infinite), and whether any is feasible."""
        at = ratio(self.bound, self.on_acceleration)
        low = jnp.max(jnp.where(self.on_acceleration < 0, at, -jnp.inf), axis=0)
        high = jnp.min(jnp.where(self.on_acceleration > 0, at, jnp.inf), axis=0)
        barred = jnp.any((self.on_acceleration == 0) & (self.bound < 0), axis=0)
        return low, high, ~barred & (low <= high)

    def boundary(self, limit: Float[Array, "*n"], rising: bool = False) -> Boundary:
        """The lower boundary from alpha = 0, where the polygon must be feasible, to where it turns non-negative while
        rising (C1; not with `rising`), to the polygon's right end (C2), or a little beyond `limit` at most. Lanes whose
        limit is not positive are not walked.
        """
        return _boundary(self, jax.lax.stop_gradient(limit), rising)


def polygon(
    cone: CentroidalCone, com: Float[Array, "3 *n"], along: Float[Array, "3 *n"], gravity: Float[Array, "3"]
) -> Polygon:
    """Half-planes (11) of a CoM that moves on the line com + alpha * along.

    com: [m]. along: unit vectors (zero: every row then bounds nothing or everything). gravity: [m/s^2].
    """
    dtype, lanes = com.dtype, com.ndim - 1
    bounds = tolerances(dtype)
    faces = jnp.asarray(cone.padded(1).faces, dtype)   # a cone that is all of space has no face, a reduction needs a row
    faces = faces.reshape(*faces.shape, *[1] * lanes)
    force, torque = (faces[:, 0], faces[:, 1], faces[:, 2]), (faces[:, 3], faces[:, 4], faces[:, 5])
    length = jnp.asarray(cone.length, dtype)
    arm = com - jnp.asarray(cone.origin, dtype).reshape(3, *[1] * lanes)
    gravity = jnp.asarray(gravity, dtype).reshape(3, *[1] * lanes)
    # Hf.x + Ht.(c x x) = (Hf + Ht x c).x: one vector a row serves v and g
    at_com = tuple(f + t for f, t in zip(force, _cross(torque, arm), strict=True))
    on_acceleration = _dot(at_com, along)
    on_alpha = _dot(torque, _cross(gravity, along))
    weight = jnp.sqrt(_dot(gravity, gravity))
    reach = 1 + jnp.sqrt(jax.lax.stop_gradient(_dot(arm, arm))) / length
    bound = _dot(at_com, gravity) + bounds.slack * weight * reach
    return Polygon(
        on_acceleration=_without_noise(on_acceleration, bounds.zero_coefficient * reach),
        on_alpha=_without_noise(on_alpha, bounds.zero_coefficient * weight / length),
        bound=bound,
        size=length * reach,
    )


def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _without_noise(values, noise):
    return jnp.where(jnp.abs(values) > noise, values, 0)


class WalkState(NamedTuple):
    """Where the walk along the lower boundary stands."""

    piece: Int[Array, ""]
    """Number of pieces found, the same in all lanes."""
    alpha: Float[Array, "*n"]
    """Where the current piece begins [m]."""
    intercept: Float[Array, "*n"]
    """Of the current line, at alpha = 0 [m/s^2]."""
    slope: Float[Array, "*n"]
    """Of the current line [1/s^2]."""
    running: Bool[Array, "*n"]
    """Lanes that have not come to an end."""
    found: Boundary
    """The pieces so far."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(2,))
def _boundary(rows: Polygon, limit: Float[Array, "*n"], rising: bool) -> Boundary:
    lower = rows.on_acceleration < 0
    values = jnp.where(lower, ratio(rows.bound, rows.on_acceleration), -jnp.inf)
    slopes = jnp.where(lower, -ratio(rows.on_alpha, rows.on_acceleration), -jnp.inf)
    value = jnp.max(values, axis=0)
    slope = jnp.max(jnp.where(values == value, slopes, -jnp.inf), axis=0)
    floorless = value == -jnp.inf
    walls = jnp.where((rows.on_acceleration == 0) & (rows.on_alpha > 0), ratio(rows.bound, rows.on_alpha), jnp.inf)
    walls = jnp.min(walls, axis=0)
    noise = _Noise(
        tolerances(value.dtype).parallel * jnp.max(jnp.abs(rows.on_alpha), axis=0),
        tolerances(value.dtype).parallel * jnp.max(jnp.abs(rows.on_acceleration), axis=0),
    )
    lanes = value.shape
    found = Boundary(
        knots=jnp.full((MAX_PIECES + 1, *lanes), jnp.inf, value.dtype).at[0].set(0),
        intercepts=jnp.zeros((MAX_PIECES, *lanes), value.dtype),
        slopes=jnp.zeros((MAX_PIECES, *lanes), value.dtype),
        end=jnp.where(floorless, walls, jnp.inf),
        ending=jnp.where(floorless, End.FLOORLESS, End.LIMIT).astype(jnp.int8),
    )
    first = WalkState(
        piece=jnp.zeros((), jnp.int32),
        alpha=jnp.zeros(lanes, value.dtype),
        intercept=jnp.where(floorless, 0, value),
        slope=jnp.where(floorless, 0, slope),
        running=(limit > 0) & ~floorless,
        found=found,
    )
    last = jax.lax.while_loop(
        lambda state: jnp.any(state.running) & (state.piece < MAX_PIECES),
        lambda state: _next_piece(rows, slopes, noise, limit, rising, state),
        first,
    )
    ending = jnp.where(last.running, End.MAX_PIECES, last.found.ending)
    return last.found._replace(ending=ending.astype(jnp.int8))


class _Noise(NamedTuple):
    """Below `on_alpha + on_acceleration * |slope|`, the rate at which a line nears a row is rounding error."""

    on_alpha: Float[Array, "*n"]
    on_acceleration: Float[Array, "*n"]


def _crossings(rows: Polygon, noise: _Noise, intercept, slope):
    """Where each row ends a line (m, *n); infinity where it does not."""
    rate = rows.on_acceleration * slope + rows.on_alpha
    crosses = rate > noise.on_alpha + noise.on_acceleration * jnp.abs(slope)
    return jnp.where(crosses, (rows.bound - rows.on_acceleration * intercept) / jnp.where(crosses, rate, 1), jnp.inf)


def _next_piece(rows: Polygon, slopes, noise: _Noise, limit, rising: bool, state: WalkState) -> WalkState:
    """Record the current line and find the row that ends it; go on along that row, or stop. A pivot of the dual simplex."""
    k, alpha, intercept, slope, running, found = state
    at = _crossings(rows, noise, intercept, slope)
    end = jnp.maximum(alpha, jnp.min(at, axis=0))
    blocks = at <= end
    next_slope = jnp.max(jnp.where(blocks, slopes, -jnp.inf), axis=0)
    leaves = jnp.any(blocks & (rows.on_acceleration >= 0), axis=0)

    # Where the line rises through zero; a line that is nowhere negative ends the walk at once.
    zero = jnp.where(slope > 0, -ratio(intercept, slope), jnp.where((slope == 0) & (intercept >= 0), alpha, jnp.inf))
    zero = jnp.maximum(zero, alpha)
    diverges = running & (zero <= end) & (zero < jnp.inf) & (not rising)
    never = running & ~diverges & (end == jnp.inf)
    leaves = running & ~diverges & ~never & leaves
    goes_on = running & ~(diverges | never | leaves | (end >= limit))
    ending = jnp.select([diverges, never, leaves], [End.DIVERGES, End.NEVER, End.POLYGON], found.ending)
    found = Boundary(
        # The last line goes on without end, so that what lies beyond its end is still well defined.
        knots=found.knots.at[k + 1].set(jnp.where(goes_on, end, jnp.inf)),
        intercepts=found.intercepts.at[k].set(jnp.where(running, intercept, 0)),
        slopes=found.slopes.at[k].set(jnp.where(running, slope, 0)),
        end=jnp.where(diverges, zero, jnp.where(leaves, end, found.end)),
        ending=ending.astype(jnp.int8),
    )
    return WalkState(
        piece=k + 1,
        alpha=jnp.where(goes_on, end, alpha),
        intercept=jnp.where(goes_on, intercept + (slope - next_slope) * end, intercept),
        slope=jnp.where(goes_on, next_slope, slope),
        running=goes_on,
        found=found,
    )


@_boundary.defjvp
def _boundary_jvp(rising, primals, tangents):
    """The search for the active rows is not differentiated: their lines are, which is exact, since knots only join lines
    where they meet (to move a knot changes no integral to first order).
    """
    (rows, limit), (moved, _) = primals, tangents
    found = _boundary(rows, limit, rising)
    ends = jnp.where(found.ending == End.LIMIT, limit, found.end)
    left = jnp.where(jnp.isfinite(found.knots[:-1]), found.knots[:-1], 0)
    right = jnp.minimum(found.knots[1:], ends)
    middle = jnp.where(jnp.isfinite(right), (left + right) / 2, left + rows.size)

    lower = rows.on_acceleration < 0
    values = ratio(rows.bound - rows.on_alpha * middle[:, None], rows.on_acceleration)
    active = jnp.argmax(jnp.where(lower, values, -jnp.inf), axis=1)
    at_active = lambda values: jnp.take_along_axis(values, active, axis=0)
    real = jnp.isfinite(found.knots[:-1]) & (found.ending != End.FLOORLESS) & (limit > 0)
    on_acceleration = at_active(rows.on_acceleration)
    change = lambda amount: jnp.where(real, ratio(amount, on_acceleration), 0)
    intercepts = change(at_active(moved.bound) - found.intercepts * at_active(moved.on_acceleration))
    slopes = change(-at_active(moved.on_alpha) - found.slopes * at_active(moved.on_acceleration))

    # The end: a zero of the last line, or its crossing with the row that ends the polygon.
    final = real & ~jnp.isfinite(found.knots[1:])
    of_last = lambda values: jnp.sum(jnp.where(final, values, 0), axis=0)
    intercept, slope = of_last(found.intercepts), of_last(found.slopes)
    rate = rows.on_acceleration * slope + rows.on_alpha
    at = jnp.where(~lower & (rate > 0), ratio(rows.bound - rows.on_acceleration * intercept, rate), jnp.inf)
    end = jnp.where(jnp.isfinite(found.end), found.end, 0)
    wall = jnp.argmin(jnp.abs(at - end), axis=0)[None]
    at_wall = lambda values: jnp.take_along_axis(values, wall, axis=0)[0]
    acceleration = intercept + slope * end
    rise = of_last(intercepts) + of_last(slopes) * end
    past = at_wall(moved.bound) - at_wall(moved.on_acceleration) * acceleration - at_wall(moved.on_alpha) * end
    ends = jnp.where(
        found.ending == End.DIVERGES,
        -ratio(rise, slope),
        jnp.where(found.ending == End.POLYGON, ratio(past - at_wall(rows.on_acceleration) * rise, at_wall(rate)), 0),
    )
    still = jax.tree.map(lambda x: jnp.zeros(x.shape, jax.dtypes.float0 if x.dtype == jnp.int8 else x.dtype), found)
    return found, still._replace(intercepts=intercepts, slopes=slopes, end=ends)
