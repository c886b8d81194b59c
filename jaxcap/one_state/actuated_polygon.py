"""Rays of the cone and a robot's limits -> the (alpha, acceleration) polygon of one state: the third producer.

To the six rows of (25), whose angular ones may give way by the momentum box, each joint that carries a contact adds one:

    tau + J' f = gravity_torque,  |tau| <= limit,

all per unit mass. The posture is frozen: alpha and acceleration enter by the wrench alone, and the polygon stays one. Pieces
are found as in `ray_polygon`, by pivots of the dual simplex, in which a joint may come to its limit as a ray to zero.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxcap.contacts.actuation import ActuatedRays
from jaxcap.numerics import bounded_basis, bounded_simplex
from jaxcap.numerics.bounded_basis import Basis, Program
from jaxcap.numerics.guarded import ratio, snapped, tolerances
from jaxcap.numerics.simplex import Outcome
from jaxcap.numerics.simplex_basis import FREE, UNIT, largest, mixture
from jaxcap.one_state.actuated_rows import Rows
from jaxcap.one_state.basis_line import Carrying, first_met, line_of, one_place
from jaxcap.one_state.boundary import Boundary, End
from jaxcap.one_state.polygon import Survey
from jaxcap.one_state.programs_in_turn import Load, Solved, solved_in_turn, stacked_programs
from jaxcap.one_state.walk import Affine, Next, moved, walk
from jaxcap.one_state.wrench_line import WrenchLine, wrench_line

DEEPEST = 1e3
"""A deceleration beyond this [m/s^2] is one without bound: near a line down into the ground, rounding alone bounds it."""
APEX = {64: 1e3, 32: 1e2}
"""By how much more than elsewhere ties are broken in the program of the effort, whose target is zero: without, it cycles."""


class ActuatedPolygon(NamedTuple):
    """All (alpha, acceleration) whose wrench is a sum of rays that the joints can bear.

    Rows are force, torque divided by the size of the stance, and the joints' torques in units in which their limits are as
    large as gravity; per unit mass.
    """

    rays: Float[Array, "m r *n"]
    """The last one is zero: see `_first`."""
    per_acceleration: Float[Array, "m *n"]
    forward: Float[Array, "m *n"]
    """The same, moved a little into the cone where the acceleration holds the robot up: see `Load.target`."""
    per_alpha: Float[Array, "m *n"]
    at_rest: Load
    """What is to be carried at alpha = 0 without acceleration: the weight."""
    falling: Load
    """The same at the acceleration `fall`."""
    fall: Float[Array, "*n"]
    """Acceleration along the line in free fall [m/s^2]."""
    bound: Float[Array, "m *n"]
    """By how much each row may give way: nothing, the momentum box, the torque limits."""
    wider: Float[Array, "m *n"]
    """The same, a little more: it breaks ties."""
    mixture: Float[Array, "m *n"]
    """Of all rays: what targets are moved by."""
    line: WrenchLine
    """What the wrenches were made of."""
    size: Float[Array, "*n"]
    """Scale of alpha [m]: size of the stance plus the CoM's distance from it."""
    start: Basis | None = None
    """Of the smallest acceleration at alpha = 0, or of a place nearby."""

    @property
    def joints(self) -> int:
        """How many rows are torques."""
        return self.bound.shape[0] - 6

    @property
    def ready(self) -> Basis:
        """`start`, of a polygon that knows its survey: only such a one is walked, turned or moved."""
        assert self.start is not None, "the polygon is used before it knows its survey"
        return self.start

    @property
    def scale(self) -> Float[Array, "*n"]:
        """Size of what is to be carried, for rounding errors [m/s^2]."""
        return self.line.weight * self.line.slack / tolerances(self.fall.dtype).slack

    def knowing(self, survey: Survey) -> "ActuatedPolygon":
        """The same, with a basis to start from."""
        return self._replace(start=survey.start)

    def seen(
        self, start: Float[Array, "*n"], heading: int | Float[Array, ""], acceleration: int | Float[Array, ""]
    ) -> "ActuatedPolygon":
        """As `Producer` has it."""
        same = jnp.asarray(acceleration) > 0
        return self._replace(
            per_acceleration=acceleration * self.per_acceleration,
            forward=acceleration * self.forward,
            per_alpha=heading * self.per_alpha,
            at_rest=self.at_rest.moved(self.per_alpha * start),
            falling=self.falling.moved(self.per_alpha * start),
            fall=acceleration * self.fall,
            start=jax.tree.map(functools.partial(jnp.where, same), self.ready, bounded_basis.turned(self.ready)),
        )

    def survey(self, near: Any = None) -> Survey:
        """Polygon at alpha = 0, and effort. Of the static region only whether the CoM stands in it: see `completed`.

        near: not used.
        """
        fixed = jax.tree.map(jax.lax.stop_gradient, self)
        lowest, hold = fixed.at_start(), fixed.holding()
        everywhere = jnp.ones(self.fall.shape, bool)
        loads = [fixed.falling, Load(0 * fixed.at_rest.wrench, hold.target)]
        start, held = solved_in_turn([lowest, hold], loads, bounded_basis.begun(lowest), everywhere)
        feasible, effort = start.outcome != Outcome.INFEASIBLE, _effort(self, held)
        pulled = (start.outcome != Outcome.OPTIMAL) | (_line(fixed, start.basis).intercept <= 0)
        nothing = jnp.zeros_like(self.fall)
        return Survey(
            s_min=nothing,
            s_max=nothing,
            standing=effort <= 1,
            feasible=feasible,
            pulled_back=feasible & pulled,
            known=(start.outcome != Outcome.UNDECIDED) & (held.outcome != Outcome.UNDECIDED),
            hangs=jnp.zeros_like(feasible),
            start=start.basis,
            effort=effort if self.joints else None,  # of a box alone there is none: where it stands is all there is to say
        )

    def completed(self, survey: Survey, beyond: Bool[Array, "*n"]) -> Survey:
        """The survey with the static region itself, where it is needed.

        It is not where the CoM stands in it, and the walk does not lead beyond it: acceleration turns positive at its end.

        Args:
            survey: of this polygon.
            beyond: where the walk leads beyond it.
        """
        fixed = jax.tree.map(jax.lax.stop_gradient, self)
        wanted = survey.feasible & beyond | ~survey.standing
        programs = [fixed.standing(-1), fixed.standing(1)]
        least, most = solved_in_turn(programs, [fixed.at_rest] * 2, fixed.ready, wanted)
        standing = jnp.where(wanted, least.outcome != Outcome.INFEASIBLE, survey.standing)
        s_min, s_max = one_place(_bounded(self, -1, least), -_bounded(self, 1, most))
        lost = (least.outcome == Outcome.UNDECIDED) | (standing & (most.outcome == Outcome.UNDECIDED))
        here = wanted & standing
        return survey._replace(
            s_min=jnp.where(here, s_min, survey.s_min),
            s_max=jnp.where(here, s_max, survey.s_max),
            standing=standing,
            pulled_back=survey.pulled_back & here & (s_min > 0),
            known=survey.known & ~(wanted & lost),
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

    def at_start(self) -> Program:
        """The program of the smallest acceleration at alpha = 0, (25); the free variable is the acceleration less `fall`."""
        floor = jnp.full_like(self.fall, -DEEPEST)
        return Program(self.rays, -self.forward, self.falling.target, self.wider, self.scale, floor)

    def standing(self, sign: int) -> Program:
        """The program of the smallest (-1) alpha at which zero acceleration is feasible, or of minus the largest (+1)."""
        floor = jnp.full_like(self.fall, -jnp.inf)
        return Program(self.rays, sign * self.per_alpha, self.at_rest.target, self.wider, self.scale, floor)

    def holding(self) -> Program:
        """The program of the effort: z = -1 / effort, everything at rest, without the momentum box.

        Divided by the effort, weights stay weights, and torques come to the limits.
        """
        floor, bits = jnp.full_like(self.fall, -jnp.inf), jnp.finfo(self.fall.dtype).bits
        moved = APEX[bits] * self.line.slack * self.line.weight * self.mixture
        box = _is_torque(self.bound)
        return Program(self.rays, self.at_rest.wrench, moved, jnp.where(box, self.wider, 0), self.scale, floor)


def actuated_polygon(
    cone: ActuatedRays,
    com: Float[Array, "3 *n"],
    along: Float[Array, "3 *n"],
    gravity: Float[Array, "3"],
    spin: Float[Array, "3 *n"] | None = None,
) -> ActuatedPolygon:
    """The polygon of a CoM that moves on the line com + alpha * along.

    Args:
        cone: with lanes last, or none.
        com: [m].
        along: unit vectors, or zero.
        gravity: [m/s^2].
        spin: angular momentum per unit mass over the speed [m]: it comes to rest in proportion to the speed.
    """
    line = wrench_line(cone.origin, cone.length, com, along, gravity, spin)
    lanes, dtype = com.shape[1:], com.dtype
    rows = Rows.of(cone, line, lanes, dtype)
    rays, weight = jax.lax.optimization_barrier(rows.rays), line.weight
    into, slack = mixture(rays), line.slack
    # Random shares: regular ones would make new ties.
    shares = jnp.asarray(np.random.default_rng(1).uniform(1, 2, size=len(rays)), dtype).reshape(-1, *[1] * len(lanes))

    def load(wrench: Array) -> Load:
        wrench = jnp.concatenate([-rows.scaled(wrench), rows.gravity])
        return Load(wrench, wrench + slack * weight * into)

    nothing = jnp.zeros_like(rows.gravity)
    per_acceleration = jnp.concatenate([rows.scaled(line.per_acceleration), nothing])
    return ActuatedPolygon(
        rays=rays,
        per_acceleration=per_acceleration,
        forward=per_acceleration - slack * line.fall / weight * into,
        per_alpha=jnp.concatenate([rows.scaled(line.per_alpha), nothing]),
        at_rest=load(line.at_rest),
        falling=load(line.across),
        fall=line.fall,
        bound=rows.bound,
        wider=jnp.where(rows.bound > 0, rows.bound + slack * weight * shares, 0),
        mixture=into,
        line=line,
        size=line.length * line.remoteness,
    )


def _is_torque(bound: Array) -> Bool[Array, "m *#n"]:
    """The rows of joints."""
    return (jnp.arange(len(bound)) >= 6).reshape(-1, *[1] * (bound.ndim - 1))


def _exact(polygon: ActuatedPolygon, basis: Basis, wrench: Array) -> Array:
    """What the columns of a basis have to carry of a wrench, limits as they are."""
    return wrench - basis.side * polygon.bound


def _free(polygon: ActuatedPolygon, program: Program, end: Solved, wrench: Array) -> Float[Array, "*n"]:
    """The free variable at the end of a program, with this wrench to be carried; differentiable."""
    matrix = bounded_basis.columns(program, end.basis.chosen)
    carried = wrench - end.basis.side * polygon.bound
    return bounded_basis.weights(bounded_basis.normal_of(end.basis)[None], end.found, matrix, carried)[0]


def _effort(polygon: ActuatedPolygon, hold: Solved) -> Float[Array, "*n"]:
    """Share of the limits that holding still takes; infinite where no forces balance the weight, whatever the torques."""
    z = _free(polygon, polygon.holding(), hold, jnp.zeros_like(polygon.bound))
    noise = polygon.line.slack * polygon.line.weight * jnp.max(jnp.abs(bounded_basis.normal_of(hold.basis)), axis=0)
    held = -snapped(z, noise)
    effort = jnp.where(held > 0, 1 / jnp.where(held > 0, held, 1), jnp.inf)
    endless = (hold.outcome == Outcome.UNBOUNDED) | (hold.basis.chosen[0] != FREE)
    return jnp.where(hold.outcome == Outcome.UNDECIDED, jnp.nan, jnp.where(endless, 0, effort))


def _bounded(polygon: ActuatedPolygon, sign: int, end: Solved) -> Float[Array, "*n"]:
    """The free variable of `standing(sign)`, minus infinity where nothing bounds it."""
    bounded = (end.outcome == Outcome.OPTIMAL) & (end.basis.chosen[0] == FREE)
    return jnp.where(bounded, _place(polygon, sign, end), -jnp.inf)


def _place(polygon: ActuatedPolygon, sign: int, end: Solved) -> Float[Array, "*n"]:
    """The free variable where the basis meets the weight itself; zero where that is all slack."""
    held = _free(polygon, polygon.standing(sign), end, polygon.at_rest.wrench)
    noise = polygon.line.slack * polygon.line.weight * jnp.max(jnp.abs(bounded_basis.normal_of(end.basis)), axis=0)
    return snapped(held, noise)


@functools.partial(jax.custom_jvp, nondiff_argnums=(4,))
def _boundary(
    polygon: ActuatedPolygon, limit: Float[Array, "*n"], enough: Array | None, rising: Array, most: int | None
) -> Boundary:
    return _search(polygon, limit, enough, rising, most, lambda basis: ())[0]


def _search(
    polygon: ActuatedPolygon,
    limit: Array,
    enough: Array | None,
    rising: Array,
    most: int | None,
    mark: Callable[[Basis], Any],
) -> tuple[Boundary, Any]:
    """The boundary, and the marks of its pieces' bases."""
    walked = limit > 0
    found, wall = _first(polygon, walked)
    floorless = walked & ((found.outcome == Outcome.UNBOUNDED) | (found.basis.chosen[0] != FREE))
    lost = walked & ((found.outcome == Outcome.UNDECIDED) | (found.outcome == Outcome.INFEASIBLE))
    bounded = floorless & (wall.outcome == Outcome.OPTIMAL) & (wall.basis.chosen[0] == FREE)
    farthest = jnp.where(bounded, -_place(polygon, 1, wall), jnp.inf)
    follow = lambda alpha, line, basis: _follow(polygon, basis)
    limit = jnp.where(lost, 0, limit)
    first = _line(polygon, found.basis)
    boundary, marks = walk(follow, first, found.basis, floorless, farthest, limit, rising, most, enough, mark)
    return boundary._replace(ending=jnp.where(lost, End.MAX_PIECES, boundary.ending).astype(jnp.int8)), marks


def _first(polygon: ActuatedPolygon, walked: Bool[Array, "*n"]) -> list[Solved]:
    """The basis of the first piece; and in lanes without a floor, that of the largest alpha of the polygon.

    For the latter, force along the line, either way, is a ray like the others; the former has zeros in its place.
    """
    spare, widened = polygon.rays, polygon.rays.at[:, -1].set(polygon.per_acceleration)
    floorless = lambda end: walked & ((end.outcome == Outcome.UNBOUNDED) | (end.basis.chosen[0] != FREE))
    before = Solved(polygon.ready, jnp.zeros_like(polygon.bound), jnp.zeros(walked.shape, jnp.int32))
    stacked = stacked_programs([polygon.at_start(), polygon.standing(1)])

    def one(before: Solved, step: tuple) -> tuple[Solved, Solved]:
        number, own, wrench = step
        lanes = jnp.where(number == 0, walked, floorless(before))
        rays = jax.lax.cond(number == 0, lambda: spare, lambda: widened)
        program = Program(rays, own.free, own.target, own.bound, polygon.scale, own.floor)
        basis = jax.lax.cond(number == 0, lambda: before.basis, lambda: bounded_basis.begun(program))
        solution = bounded_simplex.solve(program, basis, lanes)
        found = bounded_basis.times(solution.basis.inverse, wrench - solution.basis.side * polygon.bound)
        end = Solved(solution.basis, found, solution.outcome)
        return end, end

    wrenches = jnp.stack([polygon.falling.wrench, polygon.at_rest.wrench])
    ends = jax.lax.scan(one, before, (jnp.arange(2), stacked, wrenches))[1]
    return [jax.tree.map(lambda x, k=k: x[k], ends) for k in range(2)]


def _line(polygon: ActuatedPolygon, basis: Basis) -> Affine:
    """The acceleration over alpha."""
    carried = _exact(polygon, basis, polygon.falling.wrench)
    carrying = Carrying(polygon.per_acceleration, polygon.per_alpha, carried, polygon.fall)
    return line_of(bounded_basis.normal_of(basis), carrying, polygon.line)


def _follow(polygon: ActuatedPolygon, basis: Basis) -> Next:
    """Where the first column of the basis comes to a bound, and the basis with the one that takes over."""
    alpha, leaving, side, grows = _end(polygon, basis)
    row = jnp.sum(jnp.where(leaving[:, None], basis.inverse, 0), axis=0) * jnp.where(grows, -1, 1)
    normal = bounded_basis.normal_of(basis)
    over = lambda vector: jnp.concatenate([bounded_basis.combination(vector, polygon.rays), -basis.side * vector])
    place, leaves = first_met(over(normal), over(-row), normal, row)
    entering = bounded_basis.column_at(polygon.rays, basis, place)
    direction = bounded_basis.times(basis.inverse, entering.column)
    following = bounded_basis.exchanged(basis, leaving, side, entering, direction, ~leaves & (alpha < jnp.inf))
    return Next(alpha, leaves, _line(polygon, following), following)


class LineEnd(NamedTuple):
    """Where the line of a basis ends."""

    alpha: Float[Array, "*n"]
    """[m], infinite where it does not."""
    leaving: Bool[Array, "m *n"]
    """The column that comes to a bound there."""
    side: Float[Array, "*n"]
    """At which of its bounds a unit column that can be other than zero is then, else zero."""
    grows: Bool[Array, "*n"]
    """It comes there from below."""


def _end(polygon: ActuatedPolygon, basis: Basis) -> LineEnd:
    """The ratio test of the dual bounded_basis."""
    bounds, target = tolerances(polygon.fall.dtype), polygon.falling.target
    held = bounded_basis.times(basis.inverse, target - basis.side * polygon.wider)
    rate = bounded_basis.times(basis.inverse, polygon.per_alpha)
    noise = jnp.max(jnp.abs(basis.inverse), axis=1) * jnp.max(jnp.abs(polygon.per_alpha), axis=0)
    unit = basis.chosen <= UNIT
    room, own = bounded_basis.of_units(polygon.wider, basis.chosen), bounded_basis.of_units(polygon.bound, basis.chosen)
    ends = (jnp.where(unit, jnp.abs(rate), -rate) > bounds.slack * noise) & (basis.chosen != FREE)
    room = jnp.where(own > 0, room, bounds.slack * polygon.scale)
    above = jnp.where(unit, room - jnp.sign(rate) * held, held)
    at = jnp.where(ends, jnp.maximum(above, 0) / jnp.where(ends, jnp.abs(rate), 1), jnp.inf)
    first = jnp.min(at, axis=0)
    _, leaving = largest(jnp.where(at <= first, jnp.abs(rate), 0))
    of = lambda values: jnp.sum(jnp.where(leaving, values, 0), axis=0)
    # The target decides which column leaves, for it has no ties. Where that is, the wrench itself says: a way to go that is
    # all slack is none.
    exact = bounded_basis.times(basis.inverse, _exact(polygon, basis, polygon.falling.wrench))
    end = ratio(of(jnp.where(unit, jnp.sign(rate) * own, 0) - exact), of(rate))
    side = of(jnp.where(unit & (own > 0), jnp.sign(rate), 0))
    grows = jnp.any(leaving & unit & (rate > 0), axis=0)
    return LineEnd(jnp.where(first < jnp.inf, end, jnp.inf), leaving, side, grows)


@_boundary.defjvp
def _boundary_jvp(most, primals, tangents):
    """The search for the bases is not differentiated; the lines that belong to them are."""
    (polygon, limit, enough, rising), (change, *_) = primals, tangents
    found, bases = _search(polygon, limit, enough, rising, most, lambda basis: (basis.chosen, basis.side))
    final = jnp.isinf(found.pieces.right)

    def of_piece(piece):
        """Line of a basis and its end: how they move."""
        (chosen, side), real = piece
        chosen = jnp.where(real, chosen, UNIT - jnp.arange(len(chosen)).reshape(-1, *[1] * real.ndim))
        program = polygon.at_start()
        basis = bounded_basis.inverse_of(program, Basis(chosen, jnp.zeros_like(program.target)[:, None], side))
        end = _end(polygon, basis)
        exact = bounded_basis.times(basis.inverse, _exact(polygon, basis, polygon.falling.wrench))
        moving = bounded_basis.times(basis.inverse, polygon.per_alpha)

        def figures(polygon):
            matrix = bounded_basis.columns(polygon.at_start(), basis.chosen)
            held = bounded_basis.weights(basis.inverse, exact, matrix, _exact(polygon, basis, polygon.falling.wrench))
            rate = bounded_basis.weights(basis.inverse, moving, matrix, polygon.per_alpha)
            bound = bounded_basis.of_units(polygon.bound, basis.chosen) * jax.lax.stop_gradient(jnp.sign(rate))
            out = lambda values: jnp.sum(jnp.where(end.leaving & (basis.chosen != FREE), values, 0), axis=0)
            return Affine(held[0] + polygon.fall, rate[0]), ratio(out(bound - held), out(rate))

        return jax.jvp(figures, (polygon,), (change,))[1]

    lines, walls = jax.lax.map(of_piece, (bases, found.pieces.right > found.pieces.left))
    return found, moved(found, lines, jnp.sum(jnp.where(final, walls, 0), axis=0))
