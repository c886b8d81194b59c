"""Faces of the cone -> the (alpha, acceleration) polygon of one state: half-planes, static region, lower boundary.

The half-planes are stored, (rows, lanes), before anything is reduced over them: XLA's CPU code for a reduction is fast on
arrays in memory and ten times slower where it has to compute them on the way.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxcap.contacts.cone import CentroidalCone, EffortFaces
from jaxcap.numerics.guarded import greater, greatest_of, least_of, lesser, ratio, snapped
from jaxcap.one_state.boundary import Boundary
from jaxcap.one_state.polygon import Survey
from jaxcap.one_state.walk import Affine, Next, moved, walk
from jaxcap.one_state.wrench_line import WrenchLine, wrench_line


class Polygon(NamedTuple):
    """All (alpha, acceleration) with on_acceleration * (acceleration - fall) + on_alpha * alpha <= beyond, row by row, (11).

    alpha is the distance along the line of travel from the start [m], acceleration is along the line [m/s^2].
    """

    on_acceleration: Float[Array, "m *n"]
    """[-]; a row < 0 bounds the acceleration from below, > 0 from above, = 0 bounds alpha alone."""
    on_alpha: Float[Array, "m *n"]
    """[1/s^2]"""
    beyond: Float[Array, "m *n"]
    """[m/s^2]; of the force beyond free fall: zero where nothing of gravity is across the line, but for spin and offsets."""
    fall: Float[Array, "*n"]
    """`WrenchLine.fall` [m/s^2]."""
    line: WrenchLine
    """What the rows were made of."""
    top: tuple[Float[Array, "*n"], Float[Array, "*n"]]
    """The largest that the two coefficients can be."""
    size: Float[Array, "*n"]
    """Scale of alpha [m]: size of the stance plus the CoM's distance from it."""
    effort: Float[Array, "*n"] | None = None
    """Of holding still where the CoM was when the polygon was made; None without the robot's limits."""
    start: tuple[Float[Array, "*n"], ...] = ()
    """What the survey knows of the walk: the smallest acceleration at alpha = 0, and where a polygon without one ends."""

    @property
    def bound(self) -> Float[Array, "m *n"]:
        """Of `on_acceleration * acceleration + on_alpha * alpha` [m/s^2]."""
        return snapped(self.beyond + self.on_acceleration * self.fall, self.line.slack * self.line.weight)

    def values(self) -> Float[Array, "m *n"]:
        """The acceleration at alpha = 0 that each row bounds [m/s^2]: zero where that is all slack."""
        value = ratio(self.beyond, self.on_acceleration) + self.fall
        return snapped(value, ratio(self.line.slack * self.line.weight, jnp.abs(self.on_acceleration)))

    def seen(
        self, start: Float[Array, "*n"], heading: int | Float[Array, ""], acceleration: int | Float[Array, ""]
    ) -> "Polygon":
        """As `Producer` has it."""
        return _stored(
            self._replace(
                on_acceleration=acceleration * self.on_acceleration,
                on_alpha=heading * self.on_alpha,
                beyond=self.beyond - self.on_alpha * start,
                fall=acceleration * self.fall,
                start=(),
            )
        )

    def knowing(self, survey: Survey) -> "Polygon":
        """The same, with what its survey has found: ready to be walked."""
        return self._replace(start=survey.start)

    def survey(self, near: Any = None) -> Survey:
        """Static region, and polygon at alpha = 0. near: not used, faces are surveyed as fast from anywhere."""
        on_acceleration, on_alpha, bound = self.on_acceleration, self.on_alpha, self.bound
        force = ratio(self.beyond, on_acceleration)
        static, force, values = jax.lax.optimization_barrier((ratio(bound, on_alpha), force, self.values()))
        behind = greatest_of(jnp.where(on_alpha < 0, static, -jnp.inf))
        # The end ahead, by what makes it: a row that bounds the acceleration from above, or another.
        above, other = (on_alpha > 0) & (on_acceleration > 0), (on_alpha > 0) & (on_acceleration <= 0)
        s_above, s_other = (least_of(jnp.where(rows, static, jnp.inf)) for rows in (above, other))
        ahead = lesser(s_above, s_other)
        lowest = jnp.max(jnp.where(on_acceleration < 0, values, -jnp.inf), axis=0)
        lowest_force = jnp.max(jnp.where(on_acceleration < 0, force, -jnp.inf), axis=0)
        highest_force = jnp.min(jnp.where(on_acceleration > 0, force, jnp.inf), axis=0)
        # Ends that meet, but for rounding, are one place. Whether they do all rows say, those without a coefficient too.
        place, force = _between(behind, ahead), _between(lowest_force, highest_force)
        missed = lambda coefficient, value, bound, slack: jnp.any(coefficient * value > bound + slack, axis=0)
        standing = ~missed(on_alpha, place, bound, self.line.slack_at(-self.fall))
        feasible = ~missed(on_acceleration, force, self.beyond, self.line.slack_at(force))
        return Survey(
            s_min=lesser(behind, place),
            s_max=greater(ahead, place),
            standing=standing,
            feasible=feasible,
            pulled_back=jnp.maximum(lowest, highest_force + self.fall) < 0,
            known=jnp.ones(standing.shape, bool),
            hangs=(s_above <= ahead) & (ahead < jnp.inf),
            start=(lowest, s_other),  # without a lowest, no other rows are left but walls
            effort=self.effort,
        )

    def boundary(
        self,
        limit: Float[Array, "*n"],
        rising: bool | Bool[Array, ""] = False,
        most: int | None = None,
        enough: Float[Array, "*n"] | None = None,
    ) -> Boundary:
        """The lower boundary, as `Producer` has it."""
        return _boundary(self, *jax.lax.stop_gradient((limit.astype(self.beyond.dtype), enough)), jnp.asarray(rising), most)


def polygon(
    cone: CentroidalCone,
    com: Float[Array, "3 *n"],
    along: Float[Array, "3 *n"],
    gravity: Float[Array, "3"],
    spin: Float[Array, "3 *n"] | None = None,
) -> Polygon:
    """The polygon of a CoM that moves on the line com + alpha * along, Section III-A.

    com: [m]. along: unit vectors (zero: every row bounds nothing, or forbids everything). gravity: [m/s^2]. spin: of
    `wrench_line` [m].
    """
    faces = jnp.asarray(cone.padded(1).faces, com.dtype)  # a cone that is all of space has no face
    line = wrench_line(cone.origin, cone.length, com, along, gravity, spin)
    wrenches = jnp.stack([line.per_acceleration, line.per_alpha, line.across], axis=1)
    rows = jnp.tensordot(faces, wrenches, axes=1, precision=jax.lax.Precision.HIGHEST)
    # What a CoM moved by the slack, or a velocity turned by it, could make zero, is zero. A deceleration that is all slack
    # would stop the robot in the end, however far away.
    on_acceleration = snapped(rows[:, 0], line.slack_of_acceleration)
    steepest = line.weight / line.length
    return _stored(
        Polygon(
            on_acceleration=on_acceleration,
            on_alpha=snapped(rows[:, 1], line.slack * steepest),
            beyond=_with_offsets(snapped(rows[:, 2], line.slack * line.sideways), cone),
            fall=line.fall,
            line=line,
            top=(line.largest, steepest),
            size=line.length * line.remoteness,
            effort=None if cone.effort is None else _effort(cone.effort, line),
        )
    )


def _effort(faces: EffortFaces, line: WrenchLine) -> Float[Array, "*n"]:
    """Share of the limits that holding still at alpha = 0 takes; infinite where no torques do."""
    to_exert, dtype = -line.at_rest, line.fall.dtype
    product = lambda rows: jnp.tensordot(jnp.asarray(rows, dtype), to_exert, axes=1, precision=jax.lax.Precision.HIGHEST)
    column = lambda values: jnp.asarray(values, dtype).reshape(-1, *[1] * line.fall.ndim)
    held = jnp.all(product(faces.held) <= column(faces.room) + line.slack * line.weight, axis=0)
    return jnp.where(
        held, greater(greatest_of(product(faces.per_wrench) + column(faces.constant)), jnp.zeros_like(line.fall)), jnp.inf
    )


def _with_offsets(beyond: Float[Array, "m *n"], cone: CentroidalCone) -> Float[Array, "m *n"]:
    """What rows of a cone allow, and how far out they are by the momentum box and the joints."""
    if cone.offsets is None:
        return beyond
    offsets = jnp.asarray(cone.padded(1).offsets, beyond.dtype)
    return beyond + offsets.reshape(-1, *[1] * (beyond.ndim - 1))


def _between(low: Float[Array, "*n"], high: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Of low <= high the one nearest to zero; where they overlap the wrong way round, the middle."""
    return jnp.where(low <= high, jnp.clip(0, low, high), (low + high) / 2)


def _stored(rows: Polygon) -> Polygon:
    """The same, in memory."""
    return jax.lax.optimization_barrier(rows)


@functools.partial(jax.custom_jvp, nondiff_argnums=(4,))
def _boundary(rows: Polygon, limit: Float[Array, "*n"], enough: Array | None, rising: Array, most: int | None) -> Boundary:
    lower = rows.on_acceleration < 0
    # Rows that do not bound the acceleration from below get an infinite slope: a walk that meets them is at its end.
    slopes = jnp.where(lower, -ratio(rows.on_alpha, rows.on_acceleration), jnp.inf)
    values = jnp.where(lower, rows.values(), -jnp.inf)
    slopes, values = jax.lax.optimization_barrier((slopes, values))
    value, wall = rows.start if rows.start else (jnp.max(values, axis=0), _wall(rows))
    slope = jnp.max(jnp.where(values == value, slopes, -jnp.inf), axis=0)
    follow = lambda alpha, line, _: _follow(rows, slopes, alpha, line)
    return walk(follow, Affine(value, slope), (), value == -jnp.inf, wall, limit, rising, most, enough)[0]


def _wall(rows: Polygon) -> Float[Array, "*n"]:
    """Where the polygon ends, as far as rows on alpha alone say."""
    walls = (rows.on_acceleration == 0) & (rows.on_alpha > 0)
    return jnp.min(jnp.where(walls, ratio(rows.bound, rows.on_alpha), jnp.inf), axis=0)


def _crossings(rows: Polygon, intercept: Array, slope: Array) -> Float[Array, "m *n"]:
    """Where each row ends a line (m, *n): on it, a row allows alpha <= (bound - on_acceleration intercept) / rate.

    Infinity where it does not: where the rate is zero, or no more than rounding error.
    """
    rate = rows.on_acceleration * slope + rows.on_alpha
    crosses = rate > rows.line.slack * (rows.top[1] + rows.top[0] * jnp.abs(slope))
    return jnp.where(
        crosses, (rows.beyond - rows.on_acceleration * (intercept - rows.fall)) / jnp.where(crosses, rate, 1), jnp.inf
    )


def _follow(rows: Polygon, slopes: Array, alpha: Array, line: Affine) -> Next:
    """The row that ends a line, and the line of that row. A pivot of the dual simplex."""
    at = jax.lax.optimization_barrier(_crossings(rows, *line))
    end = jnp.maximum(alpha, jnp.min(at, axis=0))
    slope = jnp.max(jnp.where(at <= end, slopes, -jnp.inf), axis=0)  # of several rows, the steepest
    return Next(end, slope == jnp.inf, Affine(line.intercept + (line.slope - slope) * end, slope), ())


@_boundary.defjvp
def _boundary_jvp(most, primals, tangents):
    """The search for the active faces is not differentiated; their lines are."""
    (rows, limit, enough, rising), (change, *_) = primals, tangents
    found = _boundary(rows, limit, enough, rising, most)
    pieces = found.pieces
    lower = rows.on_acceleration < 0
    row_slopes, row_values = -ratio(rows.on_alpha, rows.on_acceleration), rows.values()

    def active_row(line):
        """Index of the row with this slope and intercept."""
        difference = jnp.abs(row_slopes - line[0]) * rows.size + jnp.abs(row_values - line[1])
        return jnp.argmin(jnp.where(lower, difference, jnp.inf), axis=0)

    # one piece after the other: all at once would be a large array
    active = jax.lax.map(active_row, (pieces.slope, pieces.intercept))
    at_active = lambda values: jnp.take_along_axis(values, active, axis=0)
    real = pieces.right > pieces.left
    per_row = lambda amount: jnp.where(real, ratio(amount, at_active(rows.on_acceleration)), 0)
    lines = Affine(
        intercept=per_row(at_active(change.beyond) - (pieces.intercept - rows.fall) * at_active(change.on_acceleration))
        + jnp.where(real, change.fall, 0),
        slope=per_row(-at_active(change.on_alpha) - pieces.slope * at_active(change.on_acceleration)),
    )

    # The wall: the last line's crossing with the row that ends the polygon.
    final = jnp.isinf(pieces.right)
    end = jnp.where(jnp.isfinite(found.end), found.end, 0)
    pick = lambda values: jnp.sum(jnp.where(final, values, 0), axis=0)
    intercept, slope = pick(pieces.intercept), pick(pieces.slope)
    apart = jnp.abs(jnp.where(lower, jnp.inf, _crossings(rows, intercept, slope)) - end)
    # Where several rows meet there, but for rounding, the first: rounding, which differs between processors, has no say.
    nearest = jnp.min(apart, axis=0)
    row = jnp.argmax(apart <= nearest + rows.line.slack * rows.size, axis=0)[None]
    at_wall = lambda values: jnp.take_along_axis(values, row, axis=0)[0]
    acceleration, rise = intercept + slope * end, pick(lines.intercept + lines.slope * end)
    past = at_wall(change.beyond) - at_wall(change.on_acceleration) * (acceleration - rows.fall)
    past -= at_wall(change.on_alpha) * end + at_wall(rows.on_acceleration) * (rise - change.fall)
    wall = ratio(past, at_wall(rows.on_acceleration) * slope + at_wall(rows.on_alpha))
    return found, moved(found, lines, wall)
