"""Faces of the cone -> the (alpha, acceleration) polygon of one state: half-planes, static region, lower boundary.

The half-planes are stored, (rows, lanes), before anything is reduced over them: XLA's CPU code for a reduction is fast on
arrays in memory and ten times slower where it has to compute them on the way.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxcap.boundary import MAX_PIECES, Boundary, End, Pieces
from jaxcap.cone import CentroidalCone
from jaxcap.numerics import ratio, tolerances
from jaxcap.wrench_line import wrench_line


class Survey(NamedTuple):
    """The static region, and the polygon at alpha = 0."""

    s_min: Float[Array, "*n"]
    """Zero acceleration is feasible for alpha from here ... [m]"""
    s_max: Float[Array, "*n"]
    """... to here [m]; infinite where nothing bounds them."""
    standing: Bool[Array, "*n"]
    """The static region is not empty."""
    lowest: Float[Array, "*n"]
    """Smallest acceleration at alpha = 0 [m/s^2], perhaps minus infinity."""
    highest: Float[Array, "*n"]
    """Largest acceleration at alpha = 0 [m/s^2], perhaps infinity."""
    feasible: Bool[Array, "*n"]
    """Some acceleration keeps the contacts at alpha = 0."""


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
    top: tuple[Float[Array, "*n"], Float[Array, "*n"]]
    """The largest that the two coefficients can be."""
    size: Float[Array, "*n"]
    """Scale of alpha [m]: size of the stance plus the CoM's distance from it."""

    def flipped(self) -> "Polygon":
        """With the acceleration's sign turned: its lower boundary is minus the upper boundary of this one."""
        return _stored(self._replace(on_acceleration=-self.on_acceleration))

    def seen_from(self, start: Float[Array, "*n"], heading) -> "Polygon":
        """With alpha counted from `start`, onwards (heading +1) or back (-1); so is the acceleration."""
        return _stored(
            self._replace(
                on_acceleration=heading * self.on_acceleration,
                on_alpha=heading * self.on_alpha,
                bound=self.bound - self.on_alpha * start,
            )
        )

    def survey(self) -> Survey:
        """Static region, and polygon at alpha = 0."""
        on_acceleration, on_alpha, bound = self[:3]
        static, values = ratio(bound, on_alpha), ratio(bound, on_acceleration)
        s_min = jnp.max(jnp.where(on_alpha < 0, static, -jnp.inf), axis=0)
        s_max = jnp.min(jnp.where(on_alpha > 0, static, jnp.inf), axis=0)
        lowest = jnp.max(jnp.where(on_acceleration < 0, values, -jnp.inf), axis=0)
        highest = jnp.min(jnp.where(on_acceleration > 0, values, jnp.inf), axis=0)
        # Rows without a coefficient hold or they do not.
        static_holds = jnp.min(jnp.where(on_alpha == 0, bound, 0), axis=0) >= 0
        start_holds = jnp.min(jnp.where(on_acceleration == 0, bound, 0), axis=0) >= 0
        return Survey(
            s_min=s_min,
            s_max=s_max,
            standing=static_holds & (s_min <= s_max),
            lowest=lowest,
            highest=highest,
            feasible=start_holds & (lowest <= highest),
        )

    def boundary(self, limit: Float[Array, "*n"], rising: bool = False) -> Boundary:
        """The lower boundary from alpha = 0, where the polygon must be feasible, to where it turns non-negative while
        rising (C1; not with `rising`), to the polygon's right end (C2), or a little beyond `limit` at most.

        Lanes whose limit is not positive are not walked.
        """
        return _boundary(self, jax.lax.stop_gradient(limit).astype(self.bound.dtype), rising)


def polygon(
    cone: CentroidalCone, com: Float[Array, "3 *n"], along: Float[Array, "3 *n"], gravity: Float[Array, "3"]
) -> Polygon:
    """The polygon of a CoM that moves on the line com + alpha * along, Section III-A.

    com: [m]. along: unit vectors (zero: every row bounds nothing, or forbids everything). gravity: [m/s^2].
    """
    bounds = tolerances(com.dtype)
    faces = jnp.asarray(cone.padded(1).faces, com.dtype)   # a cone that is all of space has no face
    line = wrench_line(cone.origin, cone.length, com, along, gravity)
    wrenches = jnp.stack([line.per_acceleration, line.per_alpha, line.at_rest], axis=1)
    rows = jnp.tensordot(faces, wrenches, axes=1, precision=jax.lax.Precision.HIGHEST)
    top = line.reach, line.weight / line.length
    return _stored(
        Polygon(
            on_acceleration=_without_noise(rows[:, 0], bounds.zero_coefficient * top[0]),
            on_alpha=_without_noise(rows[:, 1], bounds.zero_coefficient * top[1]),
            bound=rows[:, 2] + bounds.slack * line.weight * line.reach,
            top=top,
            size=line.length * line.reach,
        )
    )


def _without_noise(values, noise):
    return jnp.where(jnp.abs(values) > noise, values, 0)


def _stored(rows: Polygon) -> Polygon:
    """The same, in memory."""
    return jax.lax.optimization_barrier(rows)


class WalkState(NamedTuple):
    """Where the walk along the lower boundary stands."""

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
    # Rows that do not bound the acceleration from below get an infinite slope: a walk that meets them is at its end.
    slopes = jnp.where(lower, -ratio(rows.on_alpha, rows.on_acceleration), jnp.inf)
    values = jnp.where(lower, ratio(rows.bound, rows.on_acceleration), -jnp.inf)
    slopes, values = jax.lax.optimization_barrier((slopes, values))
    value = jnp.max(values, axis=0)
    slope = jnp.max(jnp.where(values == value, slopes, -jnp.inf), axis=0)
    floorless = value == -jnp.inf
    wall = (rows.on_acceleration == 0) & (rows.on_alpha > 0)
    wall = jnp.min(jnp.where(wall, ratio(rows.bound, rows.on_alpha), jnp.inf), axis=0)
    nothing = jnp.zeros((MAX_PIECES, *limit.shape), limit.dtype)
    found = Boundary(
        pieces=Pieces(nothing, nothing, nothing, nothing),
        count=jnp.zeros((), jnp.int32),
        end=jnp.where(floorless, wall, jnp.inf),
        ending=jnp.where(floorless, End.FLOORLESS, End.LIMIT).astype(jnp.int8),
    )
    first = WalkState(
        alpha=jnp.zeros_like(limit),
        intercept=jnp.where(floorless, 0, value),
        slope=jnp.where(floorless, 0, slope),
        running=(limit > 0) & ~floorless,
        found=found,
    )
    last = jax.lax.while_loop(
        lambda state: jnp.any(state.running) & (state.found.count < MAX_PIECES),
        lambda state: _next_piece(rows, slopes, limit, rising, state),
        first,
    )
    ending = jnp.where(last.running, End.MAX_PIECES, last.found.ending)
    return last.found._replace(ending=ending.astype(jnp.int8))


def _crossings(rows: Polygon, intercept, slope):
    """Where each row ends a line (m, *n): on it, a row allows alpha <= (bound - on_acceleration intercept) / rate.

    Infinity where it does not: where the rate is zero, or no more than rounding error.
    """
    rate = rows.on_acceleration * slope + rows.on_alpha
    crosses = rate > tolerances(slope.dtype).parallel * (rows.top[1] + rows.top[0] * jnp.abs(slope))
    return jnp.where(crosses, (rows.bound - rows.on_acceleration * intercept) / jnp.where(crosses, rate, 1), jnp.inf)


def _next_piece(rows: Polygon, slopes, limit, rising: bool, state: WalkState) -> WalkState:
    """Record the current line and find the row that ends it; go on along that row, or stop. A pivot of the dual simplex."""
    alpha, intercept, slope, running, found = state
    at = jax.lax.optimization_barrier(_crossings(rows, intercept, slope))
    end = jnp.maximum(alpha, jnp.min(at, axis=0))
    next_slope = jnp.max(jnp.where(at <= end, slopes, -jnp.inf), axis=0)   # of several rows, the steepest

    # Where the line rises through zero; a line that is nowhere negative ends the walk at once.
    zero = jnp.where(slope > 0, -ratio(intercept, slope), jnp.where((slope == 0) & (intercept >= 0), alpha, jnp.inf))
    zero = jnp.maximum(zero, alpha)
    diverges = running & (zero <= end) & (zero < jnp.inf) & (not rising)
    never = running & ~diverges & (end == jnp.inf)
    leaves = running & ~diverges & ~never & (next_slope == jnp.inf)
    goes_on = running & ~(diverges | never | leaves | (end >= limit))
    ending = jnp.select([diverges, never, leaves], [End.DIVERGES, End.NEVER, End.POLYGON], found.ending)
    # The last line goes on without end, so that what lies beyond its end is still well defined.
    piece = Pieces(left=alpha, right=jnp.where(goes_on, end, jnp.inf), intercept=intercept, slope=slope)
    put = lambda fields, value: fields.at[found.count].set(jnp.where(running, value, 0))
    found = Boundary(
        pieces=jax.tree.map(put, found.pieces, piece),
        count=found.count + 1,
        end=jnp.where(diverges, zero, jnp.where(leaves, end, found.end)),
        ending=ending.astype(jnp.int8),
    )
    return WalkState(
        alpha=jnp.where(goes_on, end, alpha),
        intercept=jnp.where(goes_on, intercept + (slope - next_slope) * end, intercept),
        slope=jnp.where(goes_on, next_slope, slope),
        running=goes_on,
        found=found,
    )


@_boundary.defjvp
def _boundary_jvp(rising, primals, tangents):
    """The search for the active faces is not differentiated; their lines are, which is exact: pieces join where they meet,
    so to move a knot changes no integral to first order.
    """
    (rows, limit), (moved, _) = primals, tangents
    found = _boundary(rows, limit, rising)
    pieces = found.pieces
    lower = rows.on_acceleration < 0
    row_slopes, row_values = -ratio(rows.on_alpha, rows.on_acceleration), ratio(rows.bound, rows.on_acceleration)

    def active_row(line):
        """Index of the row with this slope and intercept."""
        difference = jnp.abs(row_slopes - line[0]) * rows.size + jnp.abs(row_values - line[1])
        return jnp.argmin(jnp.where(lower, difference, jnp.inf), axis=0)

    # one piece after the other: all at once would be a large array
    active = jax.lax.map(active_row, (pieces.slope, pieces.intercept))
    at_active = lambda values: jnp.take_along_axis(values, active, axis=0)
    real = pieces.right > pieces.left
    change = lambda amount: jnp.where(real, ratio(amount, at_active(rows.on_acceleration)), 0)
    intercepts = change(at_active(moved.bound) - pieces.intercept * at_active(moved.on_acceleration))
    slopes = change(-at_active(moved.on_alpha) - pieces.slope * at_active(moved.on_acceleration))

    # The end: the last line's zero; or, where that line is nowhere negative, the knot where it begins; or its crossing
    # with the row that ends the polygon.
    final = jnp.isinf(pieces.right)
    before = jnp.roll(final, -1, axis=0).at[-1].set(False)
    end = jnp.where(jnp.isfinite(found.end), found.end, 0)
    pick = lambda which, values: jnp.sum(jnp.where(which, values, 0), axis=0)
    intercept, slope = pick(final, pieces.intercept), pick(final, pieces.slope)
    rise = pick(final, intercepts + slopes * end)
    steeper = jnp.where(before.any(axis=0), slope - pick(before, pieces.slope), 0)
    at_knot = ratio(pick(before, intercepts + slopes * end) - rise, steeper)
    at_zero = jnp.where(pick(final, pieces.left) < end, -ratio(rise, slope), at_knot)
    at = jnp.where(lower, jnp.inf, _crossings(rows, intercept, slope))
    wall = jnp.argmin(jnp.abs(at - end), axis=0)[None]
    at_wall = lambda values: jnp.take_along_axis(values, wall, axis=0)[0]
    past = at_wall(moved.bound) - at_wall(moved.on_acceleration) * (intercept + slope * end) - at_wall(moved.on_alpha) * end
    past -= at_wall(rows.on_acceleration) * rise
    rate = at_wall(rows.on_acceleration) * slope + at_wall(rows.on_alpha)
    at_leaving = jnp.where(found.ending == End.POLYGON, ratio(past, rate), 0)
    ends = jnp.where(found.ending == End.DIVERGES, at_zero, at_leaving)

    zero = jnp.zeros_like(pieces.left)
    integer = lambda x: np.zeros(x.shape, jax.dtypes.float0)
    return found, Boundary(Pieces(zero, zero, intercepts, slopes), integer(found.count), ends, integer(found.ending))
