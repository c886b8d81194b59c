"""Rays of the cone -> the (alpha, acceleration) polygon of one state, without ever forming its faces.

A vertex of the polygon's dual is an optimal basis of (25); its weights and their rates give the line, the ratio test its
end, and one pivot of the dual simplex the next line, which is (27)-(29) without forming K again.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxcap.contacts.cone import ConeRays
from jaxcap.numerics import simplex
from jaxcap.numerics.guarded import ratio, tolerances
from jaxcap.numerics.simplex import FREE, UNIT, Basis, Outcome, Program
from jaxcap.one_state.boundary import Boundary, End
from jaxcap.one_state.polygon import Survey
from jaxcap.one_state.walk import Affine, Next, moved, walk
from jaxcap.one_state.wrench_line import wrench_line


class Bases(NamedTuple):
    """What a survey has found out on the way."""

    start: Basis
    """Of the smallest acceleration at alpha = 0."""
    least: Basis
    """Of s_min."""
    most: Basis
    """Of s_max."""
    pivots: Int[Array, "*n"]
    """That the three programs took."""


class RayPolygon(NamedTuple):
    """All (alpha, acceleration) whose wrench is a sum of rays with weights >= 0.

    alpha is the distance along the line of travel from the start [m], acceleration is along the line [m/s^2]. Wrenches are
    force over torque divided by the size of the stance, per unit mass.
    """

    rays: Float[Array, "6 r *#n"]
    per_acceleration: Float[Array, "6 *n"]
    per_alpha: Float[Array, "6 *n"]
    target: Float[Array, "6 *n"]
    """What the rays have to add up to at alpha = 0 without acceleration: against gravity, and a little into the cone."""
    scale: Float[Array, "*n"]
    """Size of that [m/s^2]."""
    steepest: Float[Array, "*n"]
    """The largest that a coefficient of alpha can be [1/s^2]."""
    size: Float[Array, "*n"]
    """Scale of alpha [m]: size of the stance plus the CoM's distance from it."""
    start: Basis | None = None
    """Of the smallest acceleration at alpha = 0, or of a place nearby."""

    @property
    def ready(self) -> Basis:
        """`start`, of a polygon that knows its survey: only such a one is walked, turned or moved."""
        assert self.start is not None, "the polygon is used before it knows its survey"
        return self.start

    def knowing(self, survey: Survey) -> "RayPolygon":
        """The same, with a basis to start from."""
        return self._replace(start=survey.start)

    def flipped(self) -> "RayPolygon":
        """With the acceleration's sign turned: its lower boundary is minus the upper boundary of this one."""
        return self._replace(per_acceleration=-self.per_acceleration, start=_turned(self.ready))

    def seen_from(self, start: Float[Array, "*n"], heading: int | Float[Array, ""]) -> "RayPolygon":
        """With alpha counted from `start`, onwards (heading +1) or back (-1); so is the acceleration."""
        turned = _turned(self.ready)
        inverse = jnp.where(jnp.asarray(heading) > 0, self.ready.inverse, turned.inverse)
        return self._replace(
            per_acceleration=heading * self.per_acceleration,
            per_alpha=heading * self.per_alpha,
            target=self.target + self.per_alpha * start,
            start=Basis(self.ready.chosen, inverse),
        )

    def survey(self, near: "Bases | None" = None) -> Survey:
        """Static region, and polygon at alpha = 0. near: `Survey.near` of a similar state."""
        fixed = jax.tree.map(jax.lax.stop_gradient, self)
        lowest, least, most = fixed.at_start(), fixed.at_rest(-1), fixed.at_rest(1)
        everywhere = jnp.ones(self.scale.shape, bool)
        unit = simplex.identity(self.scale.shape, self.scale.dtype)
        begin = simplex.freed(lowest, unit) if near is None else simplex.renewed(lowest, near.start)
        start = simplex.solve(lowest, begin, everywhere)
        feasible = start.outcome != Outcome.INFEASIBLE
        begin = simplex.freed(least, start.basis) if near is None else simplex.renewed(least, near.least)
        first = simplex.solve(least, begin, everywhere)
        standing = first.outcome != Outcome.INFEASIBLE
        begin = _turned(first.basis) if near is None else simplex.renewed(most, near.most)
        second = simplex.solve(most, begin, standing & feasible)
        bounded = lambda program, found: jnp.where(
            (found.outcome == Outcome.OPTIMAL) & jnp.any(found.basis.chosen == FREE, axis=0),
            _value(program, found.basis),
            -jnp.inf,
        )
        s_min, s_max = bounded(self.at_rest(-1), first), -bounded(self.at_rest(1), second)
        undecided = (start.outcome == Outcome.UNDECIDED) | (first.outcome == Outcome.UNDECIDED)
        undecided |= standing & feasible & (second.outcome == Outcome.UNDECIDED)
        face = _normal(second.basis)
        hangs = standing & feasible & (jnp.sum(face * self.per_acceleration, axis=0) > 0)
        pivots = start.pivots + first.pivots + second.pivots
        return Survey(
            s_min=s_min,
            s_max=jnp.maximum(s_min, s_max),
            standing=standing,
            feasible=feasible,
            pulled_back=feasible & (s_min > 0) & ((start.outcome != Outcome.OPTIMAL) | (_value(lowest, start.basis) <= 0)),
            known=~undecided,
            hangs=hangs,
            near=Bases(start.basis, first.basis, second.basis, pivots),
            start=simplex.improved(lowest, start.basis),
        )

    def boundary(
        self,
        limit: Float[Array, "*n"],
        rising: bool = False,
        most: int | None = None,
        enough: Float[Array, "*n"] | None = None,
    ) -> Boundary:
        """The lower boundary, as `Producer` has it."""
        return _boundary(self, *jax.lax.stop_gradient((limit.astype(self.target.dtype), enough)), rising, most)

    def at_start(self) -> Program:
        """The program of the smallest acceleration at alpha = 0, (25)."""
        return Program(self.rays, -self.per_acceleration, self.target, self.scale)

    def at_rest(self, sign: int) -> Program:
        """The program of the smallest (-1) alpha at which zero acceleration is feasible, or of minus the largest (+1)."""
        return Program(self.rays, sign * self.per_alpha, self.target, self.scale)


def ray_polygon(
    rays: ConeRays, com: Float[Array, "3 *n"], along: Float[Array, "3 *n"], gravity: Float[Array, "3"]
) -> RayPolygon:
    """The polygon of a CoM that moves on the line com + alpha * along, Section III-A.

    rays: with lanes last, or none. com: [m]. along: unit vectors, or zero. gravity: [m/s^2].
    """
    bounds = tolerances(com.dtype)
    line = wrench_line(rays.origin, rays.length, com, along, gravity)
    scaled = lambda wrench: jnp.concatenate([wrench[:3], wrench[3:] / line.length])
    columns = jnp.swapaxes(jnp.asarray(rays.rays, com.dtype), 0, 1)
    columns = columns.reshape(*columns.shape, *[1] * (com.ndim + 1 - columns.ndim))  # one set for all lanes
    columns = jax.lax.optimization_barrier(scaled(columns))
    scale, steepest = line.weight * line.remoteness, line.weight / line.length
    return RayPolygon(
        rays=columns,
        per_acceleration=scaled(line.per_acceleration),
        per_alpha=_without_noise(scaled(line.per_alpha), bounds.zero_coefficient * steepest),
        target=bounds.slack * scale * simplex.mixture(columns) - scaled(line.at_rest),
        scale=scale,
        steepest=steepest,
        size=line.length * line.remoteness,
    )


def _without_noise(vector, noise):
    return jnp.where(jnp.max(jnp.abs(vector), axis=0) > noise, vector, 0)


def _turned(basis: Basis) -> Basis:
    """The basis with the free variable's column turned round."""
    return basis._replace(inverse=jnp.where((basis.chosen == FREE)[:, None], -basis.inverse, basis.inverse))


def _normal(basis: Basis) -> Float[Array, "6 *n"]:
    """Of the face through the basis, pointing outwards, scaled such that its product with the free column is 1."""
    return simplex.combination((basis.chosen == FREE).astype(basis.inverse.dtype), basis.inverse)


def _value(program: Program, basis: Basis) -> Float[Array, "*n"]:
    """The free variable where the basis meets the target."""
    held = simplex.weights(basis.inverse, simplex.columns(program, basis.chosen), program.target)
    return jnp.sum(jnp.where(basis.chosen == FREE, held, 0), axis=0)


@functools.partial(jax.custom_jvp, nondiff_argnums=(3, 4))
def _boundary(
    polygon: RayPolygon, limit: Float[Array, "*n"], enough: Array | None, rising: bool, most: int | None
) -> Boundary:
    return _search(polygon, limit, enough, rising, most, lambda basis: ())[0]


def _search(
    polygon: RayPolygon, limit: Array, enough: Array | None, rising: bool, most: int | None, mark: Callable[[Basis], Any]
) -> tuple[Boundary, Any]:
    """The boundary, and the marks of its pieces' bases."""
    program = polygon.at_start()
    walked = limit > 0
    found = simplex.solve(program, polygon.ready, walked)
    free = found.basis.chosen == FREE
    floorless = walked & ((found.outcome == Outcome.UNBOUNDED) | ~jnp.any(free, axis=0))
    lost = walked & ((found.outcome == Outcome.UNDECIDED) | (found.outcome == Outcome.INFEASIBLE))
    wall = jax.lax.cond(jnp.any(floorless), _wall, lambda polygon, _: jnp.full_like(limit, jnp.inf), polygon, floorless)
    follow = lambda alpha, line, basis: _follow(polygon, alpha, basis)
    first = _line(polygon, found.basis)
    limit = jnp.where(lost, 0, limit)
    boundary, marks = walk(follow, first, found.basis, floorless, wall, limit, rising, most, enough, mark)
    return boundary._replace(ending=jnp.where(lost, End.MAX_PIECES, boundary.ending).astype(jnp.int8)), marks


def _line(polygon: RayPolygon, basis: Basis) -> Affine:
    """The free variable over alpha."""
    normal = _normal(basis)
    along = lambda vector: jnp.sum(normal * vector, axis=0)
    slope = along(polygon.per_alpha)
    noise = tolerances(slope.dtype).zero_coefficient * jnp.max(jnp.abs(normal), axis=0) * polygon.steepest
    return Affine(along(polygon.target), jnp.where(jnp.abs(slope) > noise, slope, 0))


def _wall(polygon: RayPolygon, floorless: Bool[Array, "*n"]) -> Float[Array, "*n"]:
    """The largest alpha of a polygon without a floor: force along the line, either way, is a ray like the others."""
    along = polygon.per_acceleration[:, None]
    shared = jnp.broadcast_to(polygon.rays, (*polygon.rays.shape[:2], *along.shape[2:]))
    rays = jnp.concatenate([shared, along], axis=1)
    program = Program(rays, polygon.per_alpha, polygon.target, polygon.scale)
    start = simplex.identity(floorless.shape, polygon.target.dtype)
    found = simplex.solve(program, simplex.freed(program, start), floorless)
    bounded = (found.outcome == Outcome.OPTIMAL) & jnp.any(found.basis.chosen == FREE, axis=0)
    return jnp.where(bounded, -_value(program, found.basis), jnp.inf)


def _follow(polygon: RayPolygon, alpha: Array, basis: Basis) -> Next:
    """Where the first weight of the basis comes to zero, and the basis with the ray that takes over."""
    end, leaving, grows = _end(polygon, basis)
    bounds = tolerances(polygon.target.dtype)
    row = simplex.combination(leaving.astype(end.dtype), basis.inverse) * jnp.where(grows, -1, 1)
    normal = _normal(basis)
    entry = simplex.combination(-row, polygon.rays)
    inside = jnp.maximum(simplex.combination(-normal, polygon.rays), 0)
    takes = entry > bounds.pivot * jnp.max(jnp.abs(row), axis=0)
    # A little is added to each: of several rays on the same face, that with the largest pivot takes over.
    near = bounds.reduced_cost * jnp.max(jnp.abs(normal), axis=0)
    turn = jax.lax.optimization_barrier(jnp.where(takes, -(inside + near) / jnp.where(takes, entry, 1), -jnp.inf))
    first = jnp.max(turn, axis=0)
    entering, leaves = simplex.first_of(turn, first), first == -jnp.inf
    direction = simplex.times(basis.inverse, simplex.ray(polygon.rays, entering))
    following = simplex.pivot(basis, leaving, entering, direction, ~leaves & (end < jnp.inf))
    return Next(end, leaves, _line(polygon, following), following)


def _end(polygon: RayPolygon, basis: Basis) -> tuple[Float[Array, "*n"], Bool[Array, "6 *n"], Bool[Array, "*n"]]:
    """Where the line of a basis ends, which column leaves there (one of six), and whether it does so as it grows."""
    bounds = tolerances(polygon.target.dtype)
    held, rate = simplex.times(basis.inverse, polygon.target), simplex.times(basis.inverse, polygon.per_alpha)
    noise = jnp.max(jnp.abs(basis.inverse), axis=1) * jnp.max(jnp.abs(polygon.per_alpha), axis=0)
    unit = basis.chosen <= UNIT
    ends = (jnp.where(unit, jnp.abs(rate), -rate) > bounds.parallel * noise) & (basis.chosen != FREE)
    above = jnp.where(unit, bounds.slack * polygon.scale - jnp.sign(rate) * held, held)
    at = jnp.where(ends, jnp.maximum(above, 0) / jnp.where(ends, jnp.abs(rate), 1), jnp.inf)
    end = jnp.min(at, axis=0)
    _, leaving = simplex.largest(jnp.where(at <= end, jnp.abs(rate), 0))
    return end, leaving, jnp.any(leaving & unit & (rate > 0), axis=0)


@_boundary.defjvp
def _boundary_jvp(rising, most, primals, tangents):
    """The search for the bases is not differentiated; the lines that belong to them are."""
    (polygon, limit, enough), (change, *_) = primals, tangents
    found, indices = _search(polygon, limit, enough, rising, most, lambda basis: basis.chosen)
    final = jnp.isinf(found.pieces.right)

    def of_piece(piece):
        """Line of a basis and its end: values, then how they move."""
        index, real = piece
        basis = simplex.factorised(polygon.at_start(), jnp.where(real, index, UNIT))
        _, leaving, _ = _end(polygon, basis)

        def figures(polygon):
            matrix = simplex.columns(polygon.at_start(), basis.chosen)
            held = simplex.weights(basis.inverse, matrix, polygon.target)
            rate = simplex.weights(basis.inverse, matrix, polygon.per_alpha)
            free = lambda values: jnp.sum(jnp.where(basis.chosen == FREE, values, 0), axis=0)
            out = lambda values: jnp.sum(jnp.where(leaving & (basis.chosen != FREE), values, 0), axis=0)
            return Affine(free(held), free(rate)), -ratio(out(held), out(rate))

        return jax.jvp(figures, (polygon,), (change,))[1]

    lines, walls = jax.lax.map(of_piece, (indices, found.pieces.right > found.pieces.left))
    return found, moved(found, lines, jnp.sum(jnp.where(final, walls, 0), axis=0))
