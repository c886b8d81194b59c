"""Rays of the cone -> the (alpha, acceleration) polygon of one state, without ever forming its faces.

A vertex of the polygon's dual is an optimal basis of (25); its weights and their rates give the line, the ratio test its
end, and one pivot of the dual simplex the next line, which is (27)-(29) without forming K again.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from jaxcap.contacts.cone import ConeRays
from jaxcap.numerics import simplex, simplex_basis
from jaxcap.numerics.guarded import ratio, snapped, tolerances
from jaxcap.numerics.simplex import Outcome, Solution
from jaxcap.numerics.simplex_basis import FREE, UNIT, Basis, Program
from jaxcap.one_state.basis_line import Carrying, first_met, line_of, one_place
from jaxcap.one_state.boundary import Boundary, End
from jaxcap.one_state.polygon import Survey
from jaxcap.one_state.walk import Affine, Next, moved, walk
from jaxcap.one_state.wrench_line import WrenchLine, wrench_line


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


class Load(NamedTuple):
    """What the rays have to add up to."""

    wrench: Float[Array, "6 *n"]
    """[m/s^2]"""
    target: Float[Array, "6 *n"]
    """The same, moved a little into the cone: it breaks ties, and closes the cone in spite of rounding."""
    scale: Float[Array, "*n"]
    """Size of the wrench [m/s^2]."""

    def moved(self, change: Float[Array, "6 *n"]) -> "Load":
        """With this wrench added."""
        return self._replace(wrench=self.wrench + change, target=self.target + change)


class RayPolygon(NamedTuple):
    """All (alpha, acceleration) whose wrench is a sum of rays with weights >= 0.

    alpha is the distance along the line of travel from the start [m], acceleration is along the line [m/s^2]. Wrenches are
    force over torque divided by the size of the stance, per unit mass.
    """

    rays: Float[Array, "6 r *#n"]
    per_acceleration: Float[Array, "6 *n"]
    forward: Float[Array, "6 *n"]
    """The same, moved a little into the cone where the acceleration holds the robot up: see `Load.target`."""
    per_alpha: Float[Array, "6 *n"]
    at_rest: Load
    """What the rays have to carry at alpha = 0 without acceleration: the weight."""
    falling: Load
    """The same at the acceleration `fall`: without spin the part of the weight across the line."""
    fall: Float[Array, "*n"]
    """Acceleration along the line that asks least of the contacts, `WrenchLine.fall` [m/s^2]."""
    line: WrenchLine
    """What the wrenches were made of."""
    size: Float[Array, "*n"]
    """Scale of alpha [m]: size of the stance plus the CoM's distance from it."""
    start: Basis | None = None
    """Of the smallest acceleration at alpha = 0, or of a place nearby."""
    outcome: Int[Array, "*n"] | None = None
    """How the search for that basis ended; None where it is that of a place nearby, from where a search may begin."""
    sides: Int[Array, "*#n"] | None = None
    """`ConeRays.sides`."""

    @property
    def ready(self) -> Basis:
        """`start`, of a polygon that knows its survey: only such a one is walked, turned or moved."""
        assert self.start is not None, "the polygon is used before it knows its survey"
        return self.start

    def knowing(self, survey: Survey) -> "RayPolygon":
        """The same, with a basis to start from."""
        return self._replace(start=survey.start.basis, outcome=survey.start.outcome)

    def seen(
        self, start: Float[Array, "*n"], heading: int | Float[Array, ""], acceleration: int | Float[Array, ""]
    ) -> "RayPolygon":
        """As `Producer` has it."""
        same = jnp.asarray(acceleration) > 0
        return self._replace(
            per_acceleration=acceleration * self.per_acceleration,
            forward=acceleration * self.forward,
            per_alpha=heading * self.per_alpha,
            at_rest=self.at_rest.moved(self.per_alpha * start),
            falling=self.falling.moved(self.per_alpha * start),
            fall=acceleration * self.fall,
            start=jax.tree.map(functools.partial(jnp.where, same), self.ready, _turned(self.ready)),
            outcome=None,
        )

    def survey(self, near: "Bases | None" = None) -> Survey:
        """Static region, and polygon at alpha = 0. near: `Survey.near` of a similar state."""
        fixed = jax.tree.map(jax.lax.stop_gradient, self)
        start, first, second = _solved(fixed, near)
        feasible = start.outcome != Outcome.INFEASIBLE
        standing = first.outcome != Outcome.INFEASIBLE
        bounded = lambda sign, found: jnp.where(
            (found.outcome == Outcome.OPTIMAL) & jnp.any(found.basis.chosen == FREE, axis=0),
            _place(self, sign, found.basis),
            -jnp.inf,
        )
        s_min, s_max = one_place(bounded(-1, first), -bounded(1, second))
        pulled = (start.outcome != Outcome.OPTIMAL) | (_line(fixed, start.basis).intercept <= 0)
        undecided = (start.outcome == Outcome.UNDECIDED) | (first.outcome == Outcome.UNDECIDED)
        undecided |= standing & feasible & (second.outcome == Outcome.UNDECIDED)
        face = _normal(second.basis)
        hangs = standing & feasible & (jnp.sum(face * self.per_acceleration, axis=0) > 0)
        pivots = start.pivots + first.pivots + second.pivots
        return Survey(
            s_min=s_min,
            s_max=s_max,
            standing=standing,
            feasible=feasible,
            pulled_back=feasible & (s_min > 0) & pulled,
            known=~undecided,
            hangs=hangs,
            near=Bases(start.basis, first.basis, second.basis, pivots),
            start=start._replace(basis=simplex_basis.improved(fixed.at_start(), start.basis)),
        )

    def boundary(
        self,
        limit: Float[Array, "*n"],
        rising: bool | Bool[Array, ""] = False,
        most: int | None = None,
        enough: Float[Array, "*n"] | None = None,
    ) -> Boundary:
        """The lower boundary, as `Producer` has it."""
        return _boundary(self, *jax.lax.stop_gradient((limit.astype(self.fall.dtype), enough)), jnp.asarray(rising), most)

    def jiggled(self) -> Float[Array, "6 r *#n"]:
        """The rays of contacts that are moved a little, each in a direction of its own: no two of them tie."""
        assert self.sides is not None, "asked only where they are known"
        contact = jnp.arange(self.rays.shape[1]).reshape(-1, *[1] * self.fall.ndim) // self.sides
        turns = jnp.array([12.9898, 78.233, 37.719], self.rays.dtype)  # any numbers without a common measure
        apart = jnp.sin(turns.reshape(3, *[1] * contact.ndim) * (1 + contact.astype(self.rays.dtype)))
        forces, torques = self.rays[:3], self.rays[3:]
        far = tolerances(self.rays.dtype).slack ** 0.5
        return jnp.concatenate([forces, torques + far * jnp.cross(apart, forces, axis=0)])

    def at_start(self) -> Program:
        """The program of the smallest acceleration at alpha = 0, (25); the free variable is the acceleration less `fall`."""
        return Program(self.rays, -self.forward, self.falling.target, self.falling.scale)

    def standing(self, sign: int) -> Program:
        """The program of the smallest (-1) alpha at which zero acceleration is feasible, or of minus the largest (+1)."""
        return Program(self.rays, sign * self.per_alpha, self.at_rest.target, self.at_rest.scale)


def ray_polygon(
    rays: ConeRays,
    com: Float[Array, "3 *n"],
    along: Float[Array, "3 *n"],
    gravity: Float[Array, "3"],
    spin: Float[Array, "3 *n"] | None = None,
) -> RayPolygon:
    """The polygon of a CoM that moves on the line com + alpha * along, Section III-A.

    rays: with lanes last, or none. com: [m]. along: unit vectors, or zero. gravity: [m/s^2]. spin: of `wrench_line` [m].
    """
    bounds = tolerances(com.dtype)
    line = wrench_line(rays.origin, rays.length, com, along, gravity, spin)
    scaled = lambda wrench: jnp.concatenate([wrench[:3], wrench[3:] / line.length])
    columns = _beside(jnp.swapaxes(jnp.asarray(rays.rays, com.dtype), 0, 1), com.ndim + 1)
    columns = jax.lax.optimization_barrier(scaled(columns))
    into = simplex_basis.mixture(columns)

    def load(wrench: Array, size: Array) -> Load:
        # A vertical line has nothing across it; but ties have to be broken there too.
        slack = line.slack * jnp.maximum(size, bounds.slack * line.weight)
        return Load(-scaled(wrench), slack * into - scaled(wrench), slack / bounds.slack)

    per_acceleration = scaled(line.per_acceleration)
    return RayPolygon(
        rays=columns,
        per_acceleration=per_acceleration,
        forward=per_acceleration - line.slack * line.fall / line.weight * into,
        per_alpha=scaled(line.per_alpha),
        at_rest=load(line.at_rest, line.weight),
        falling=load(line.across, line.sideways),
        fall=line.fall,
        line=line,
        size=line.length * line.remoteness,
        sides=None if rays.sides is None else jnp.asarray(rays.sides),
    )


def _beside(rows: Shaped[Array, "..."], dimensions: int) -> Shaped[Array, "..."]:
    """What there is once for all lanes, with an axis of one for each of theirs."""
    return rows.reshape(*rows.shape, *[1] * (dimensions - rows.ndim))


def _solved(polygon: RayPolygon, near: Bases | None) -> tuple[Solution, Solution, Solution]:
    """The programs of a survey: smallest acceleration, smallest alpha, largest alpha.

    One after the other in one loop, for each copy of the simplex takes a second or two to compile.
    """
    programs = [polygon.at_start(), polygon.standing(-1), polygon.standing(1)]
    own = jax.tree.map(lambda *fields: jnp.stack(fields), *[program[1:] for program in programs])  # all but the rays
    everywhere = jnp.ones(polygon.fall.shape, bool)
    bases = None if near is None else jax.tree.map(lambda *fields: jnp.stack(fields), near.start, near.least, near.most)

    def one(before: tuple[Basis, Array], given: tuple[Array, tuple, Any]) -> tuple[tuple[Basis, Array], Solution]:
        (basis, active), (turns, fields, similar) = before, given
        program = Program(polygon.rays, *fields)
        if similar is not None:
            begin = simplex_basis.renewed(program, similar)
        else:
            choose = functools.partial(jnp.where, turns)
            begin = jax.tree.map(choose, _turned(basis), simplex_basis.freed(program, basis))
        found = simplex.solve(program, begin, active | ~turns)
        return (found.basis, active & (found.outcome != Outcome.INFEASIBLE)), found

    begin = simplex_basis.identity(polygon.fall.shape, polygon.fall.dtype), everywhere
    found = jax.lax.scan(one, begin, (jnp.array([False, False, True]), own, bases))[1]
    start, least, most = (jax.tree.map(lambda field, k=k: field[k], found) for k in range(3))
    return start, least, most


def _turned(basis: Basis) -> Basis:
    """The basis with the free variable's column turned round."""
    return basis._replace(inverse=jnp.where((basis.chosen == FREE)[:, None], -basis.inverse, basis.inverse))


def _normal(basis: Basis) -> Float[Array, "6 *n"]:
    """Of the face through the basis, pointing outwards, scaled such that its product with the free column is 1."""
    return simplex_basis.combination((basis.chosen == FREE).astype(basis.inverse.dtype), basis.inverse)


def _place(polygon: RayPolygon, sign: int, basis: Basis) -> Float[Array, "*n"]:
    """The free variable of `standing(sign)` where the basis meets the weight itself; zero where that is all slack."""
    normal, matrix = _normal(basis), simplex_basis.columns(polygon.standing(sign), basis.chosen)
    held = simplex_basis.weights(basis.inverse, matrix, polygon.at_rest.wrench)
    noise = polygon.line.slack * polygon.line.weight * jnp.max(jnp.abs(normal), axis=0)
    return snapped(jnp.sum(jnp.where(basis.chosen == FREE, held, 0), axis=0), noise)


@functools.partial(jax.custom_jvp, nondiff_argnums=(4,))
def _boundary(
    polygon: RayPolygon, limit: Float[Array, "*n"], enough: Array | None, rising: Array, most: int | None
) -> Boundary:
    return _search(polygon, limit, enough, rising, most, lambda basis: ())[0]


def _search(
    polygon: RayPolygon, limit: Array, enough: Array | None, rising: Array, most: int | None, mark: Callable[[Basis], Any]
) -> tuple[Boundary, Any]:
    """The boundary, and the marks of its pieces' bases."""
    walked = limit > 0
    found, floorless, wall = _first(polygon, walked)
    lost = walked & ((found.outcome == Outcome.UNDECIDED) | (found.outcome == Outcome.INFEASIBLE))
    follow = lambda alpha, line, basis: _follow(polygon, alpha, basis)
    first = _line(polygon, found.basis)
    limit = jnp.where(lost, 0, limit)
    boundary, marks = walk(follow, first, found.basis, floorless, wall, limit, rising, most, enough, mark)
    return boundary._replace(ending=jnp.where(lost, End.MAX_PIECES, boundary.ending).astype(jnp.int8)), marks


def _line(polygon: RayPolygon, basis: Basis) -> Affine:
    """The acceleration over alpha."""
    carrying = Carrying(polygon.per_acceleration, polygon.per_alpha, polygon.falling.wrench, polygon.fall)
    return line_of(_normal(basis), carrying, polygon.line)


def _first(polygon: RayPolygon, walked: Bool[Array, "*n"]) -> tuple[Solution, Bool[Array, "*n"], Float[Array, "*n"]]:
    """The first basis of a walk; lanes without a floor; and where the polygon ends there.

    That end is the largest alpha at all: force along the line, either way, is a ray like the others. A search from a place
    nearby and that for the end are one loop, for each copy of the simplex takes a second or two to compile.
    """
    fallen = lambda found: walked & ((found.outcome == Outcome.UNBOUNDED) | ~jnp.any(found.basis.chosen == FREE, axis=0))
    along = polygon.per_acceleration[:, None]
    shared = jnp.broadcast_to(polygon.rays, (*polygon.rays.shape[:2], *along.shape[2:]))
    with_column = lambda column: jnp.concatenate([shared, column], axis=1)

    def search(last: Array | bool, begin: Basis, active: Array) -> Solution:
        choose = functools.partial(jnp.where, last)
        program = jax.tree.map(choose, polygon.standing(1), polygon.at_start())
        program = program._replace(rays=with_column(jnp.where(last, along, 0)))
        return simplex.solve(program, jax.tree.map(choose, simplex_basis.freed(program, begin), begin), active)

    def wall(found: Solution, floorless: Array) -> Array:
        bounded = floorless & (found.outcome == Outcome.OPTIMAL) & jnp.any(found.basis.chosen == FREE, axis=0)
        return jnp.where(bounded, -_place(polygon._replace(rays=with_column(along)), 1, found.basis), jnp.inf)

    unit = simplex_basis.identity(walked.shape, polygon.fall.dtype)
    if polygon.outcome is not None:
        found = Solution(polygon.ready, polygon.outcome, jnp.zeros_like(polygon.outcome))
        floorless = fallen(found)
        end = lambda: wall(search(True, unit, floorless), floorless)
        return found, floorless, jax.lax.cond(jnp.any(floorless), end, lambda: jnp.full_like(polygon.fall, jnp.inf))

    def one(before: tuple[Basis, Array], last: Array) -> tuple[tuple[Basis, Array], Solution]:
        found = search(last, *before)
        return (unit, fallen(found)), found

    both = jax.lax.scan(one, (polygon.ready, walked), jnp.array([False, True]))[1]
    found, ended = (jax.tree.map(lambda field, k=k: field[k], both) for k in range(2))
    return found, fallen(found), wall(ended, fallen(found))


def _follow(polygon: RayPolygon, alpha: Array, basis: Basis) -> Next:
    """Where the first weight of the basis comes to zero, and the basis with the ray that takes over."""
    end, leaving, grows = _end(polygon, basis)
    row = simplex_basis.combination(leaving.astype(end.dtype), basis.inverse) * jnp.where(grows, -1, 1)
    normal = _normal(basis)
    outside, entry = simplex_basis.combination(normal, polygon.rays), simplex_basis.combination(-row, polygon.rays)
    entering, leaves = first_met(outside, entry, normal, row)
    direction = simplex_basis.times(basis.inverse, simplex_basis.ray(polygon.rays, entering))
    following = simplex_basis.pivot(basis, leaving, entering, direction, ~leaves & (end < jnp.inf))
    return Next(end, leaves, _line(polygon, following), following)


class LineEnd(NamedTuple):
    """Where the line of a basis ends."""

    alpha: Float[Array, "*n"]
    """[m], infinite where it does not."""
    leaving: Bool[Array, "6 *n"]
    """The column that comes to zero there."""
    grows: Bool[Array, "*n"]
    """It does so from below: a unit column."""


def _end(polygon: RayPolygon, basis: Basis) -> LineEnd:
    """The ratio test of the dual simplex."""
    bounds, load = tolerances(polygon.fall.dtype), polygon.falling
    held, rate = simplex_basis.times(basis.inverse, load.target), simplex_basis.times(basis.inverse, polygon.per_alpha)
    noise = jnp.max(jnp.abs(basis.inverse), axis=1) * jnp.max(jnp.abs(polygon.per_alpha), axis=0)
    unit = basis.chosen <= UNIT
    ends = (jnp.where(unit, jnp.abs(rate), -rate) > bounds.slack * noise) & (basis.chosen != FREE)
    above = jnp.where(unit, bounds.slack * load.scale - jnp.sign(rate) * held, held)
    at = jnp.where(ends, jnp.maximum(above, 0) / jnp.where(ends, jnp.abs(rate), 1), jnp.inf)
    first = jnp.min(at, axis=0)
    _, leaving = simplex_basis.largest(jnp.where(at <= first, jnp.abs(rate), 0))
    of = lambda values: jnp.sum(jnp.where(leaving, values, 0), axis=0)
    # The target decides which column leaves, for it has no ties. Where that is, the wrench itself says: a way to go that is
    # all slack is none.
    end = -ratio(of(simplex_basis.times(basis.inverse, load.wrench)), of(rate))
    return LineEnd(jnp.where(first < jnp.inf, end, jnp.inf), leaving, jnp.any(leaving & unit & (rate > 0), axis=0))


@_boundary.defjvp
def _boundary_jvp(most, primals, tangents):
    """The search for the bases is not differentiated; the lines that belong to them are."""
    (polygon, limit, enough, rising), (change, *_) = primals, tangents
    found, indices = _search(polygon, limit, enough, rising, most, lambda basis: basis.chosen)
    final = jnp.isinf(found.pieces.right)

    def of_piece(piece):
        """Line of a basis and its end: values, then how they move."""
        index, real = piece
        basis = simplex_basis.factorised(polygon.at_start(), jnp.where(real, index, UNIT))
        _, leaving, _ = _end(polygon, basis)

        def figures(polygon):
            matrix = simplex_basis.columns(polygon.at_start(), basis.chosen)
            held = simplex_basis.weights(basis.inverse, matrix, polygon.falling.wrench)
            rate = simplex_basis.weights(basis.inverse, matrix, polygon.per_alpha)
            free = lambda values: jnp.sum(jnp.where(basis.chosen == FREE, values, 0), axis=0)
            out = lambda values: jnp.sum(jnp.where(leaving & (basis.chosen != FREE), values, 0), axis=0)
            return Affine(free(held) + polygon.fall, free(rate)), -ratio(out(held), out(rate))

        return jax.jvp(figures, (polygon,), (change,))[1]

    lines, walls = jax.lax.map(of_piece, (indices, found.pieces.right > found.pieces.left))
    return found, moved(found, lines, _wall_moved(polygon, change, found, jnp.sum(jnp.where(final, walls, 0), axis=0)))


def _wall_moved(polygon: RayPolygon, change: RayPolygon, found: Boundary, by_last: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """How the polygon's right end moves, as the contacts do; `by_last`: as the basis of the last line has it.

    Where contacts are coplanar, several bases meet the end, and each of them moves in its own way with the points, also
    where the end itself has one derivative only. That of the contacts moved a little, each its own way, is the right one.
    """
    if polygon.sides is None:
        return by_last
    ending = found.ending == End.POLYGON
    apart = _wall(polygon._replace(rays=polygon.jiggled()))
    begin = simplex_basis.freed(apart, simplex_basis.identity(polygon.fall.shape, polygon.fall.dtype))
    solution = simplex.solve(apart, begin, ending)
    basis = simplex_basis.factorised(_wall(polygon), solution.basis.chosen)
    place = lambda polygon: -_place(polygon._replace(rays=_wall(polygon).rays), 1, basis)
    at, moves = jax.jvp(place, (polygon,), (change,))
    # Not where they have another end: what is flat is not, when its contacts are moved.
    there = jnp.abs(at - jnp.where(ending, found.end, 0)) <= tolerances(at.dtype).same_alpha * polygon.size
    return jnp.where(ending & there & (solution.outcome == Outcome.OPTIMAL), moves, by_last)


def _wall(polygon: RayPolygon) -> Program:
    """The program of the polygon's right end: the largest alpha, at any acceleration."""
    rays = jnp.broadcast_to(polygon.rays, (*polygon.rays.shape[:2], *polygon.fall.shape))
    way = jnp.broadcast_to(polygon.per_acceleration[:, None], (6, 1, *polygon.fall.shape))
    return polygon.standing(1)._replace(rays=jnp.concatenate([rays, way, -way], axis=1))
