"""A small simplex method with fixed shapes, for many programs of `simplex_basis` side by side: which pivot is next.

Degenerate programs are the normal case here (coplanar feet with equal frames). What is done about it: the caller moves the
target a little into the cone, which breaks ties as Charnes's perturbation does; a pivot is the largest of those that
rounding cannot tell apart (Harris); the inverse of the basis is improved by a Newton step at the end. If all this does not
end it in time, Bland's rule takes over. Lanes come last.
"""

from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxcap.numerics.guarded import tolerances
from jaxcap.numerics.simplex_basis import (
    FREE,
    UNIT,
    Basis,
    Program,
    combination,
    factorised,
    first_of,
    largest,
    newton,
    pivot,
    ray,
    times,
)

MAX_PIVOTS = 100
"""Most pivots of one program."""
BLAND = 40
"""From here on, Bland's rule: of all rays that improve, and of all columns that may leave, the first. It cannot cycle."""
SMALLEST = {64: 1e-12, 32: 1e-5}
"""Smallest pivot that is taken where there is no other, or where to leave it out would push a weight below zero."""
LEAST_FALL = {64: 1e-9, 32: 2e-5}
"""A ray outside the face by less than this, relative to the face's normal, makes nothing fall without end."""
SPOILT = {64: 1e-6, 32: 1e-2}
"""Largest error of an inverse at the end of a search that a Newton step may mend, by the bits of a number."""


class Outcome(IntEnum):
    """How a program ends."""

    OPTIMAL = 0
    INFEASIBLE = 1
    UNBOUNDED = 2
    UNDECIDED = 3
    """More than MAX_PIVOTS."""


class Solution(NamedTuple):
    """Where the simplex ends."""

    basis: Basis
    outcome: Int[Array, "*n"]
    pivots: Int[Array, "*n"]


class Held(NamedTuple):
    """What the six columns of a basis hold of the target, and which of them hold what they must not."""

    weights: Float[Array, "6 *n"]
    missing: Float[Array, "6 *n"]
    """-1 for a ray below zero, the sign of a unit column that is not zero, else 0."""
    seeking: Bool[Array, "*n"]
    """Something is missing: that is made smaller first."""
    zero: Float[Array, "*n"]
    """How far below zero a weight is still zero [m/s^2]."""
    normal: Float[Array, "6 *n"]
    """Of the face of what is to become smaller: the columns that are missing something, or else the free variable."""


class SimplexState(NamedTuple):
    """Where the simplex stands."""

    solution: Solution
    running: Bool[Array, "*n"]
    flat: Bool[Array, "*n"]
    """No ray takes over from the unit columns that are left: their weights may be as large as the slack."""
    steps: Int[Array, ""]
    again: Bool[Array, "*n"]
    """The search has been asked for once more."""
    checked: Bool[Array, ""]
    """All have come to an end with inverses that are to be trusted."""
    careful: Bool[Array, "*n"]
    """A pivot that was too small has spoilt an inverse: such a one no longer keeps z from falling without end."""
    held: Held
    """What the columns of the basis hold, from the turn before. It is carried because XLA's CPU code stores what a loop
    carries; of what is made within a turn it computes, for each ray, all anew."""


def solve(program: Program, basis: Basis, active: Bool[Array, "*n"]) -> Solution:
    """Minimise from any basis that holds this program's free variable (see `freed`), in the lanes that are active.

    While some weight of the basis is negative, or one of a unit column is not zero, the sum of what is missing is made
    smaller; then z. The basis of a similar program is therefore as good a start as it is near.
    """
    outcome = jnp.full(active.shape, Outcome.UNDECIDED, jnp.int32)
    solution = Solution(basis, outcome, jnp.zeros(active.shape, jnp.int32))
    none = jnp.zeros_like(active)
    held = _held(program, basis, ~active, jnp.int32(0))
    start = SimplexState(solution, active, ~active, jnp.int32(0), ~active, jnp.zeros((), bool), none, held)

    def one(state: SimplexState) -> SimplexState:
        searching = jnp.any(state.running) & (state.steps < MAX_PIVOTS)
        state = jax.lax.cond(searching, lambda: _step(program, state), lambda: _checked(program, state))
        return state._replace(held=_held(program, state.solution.basis, state.flat, state.steps))

    return jax.lax.while_loop(lambda state: ~state.checked, one, start).solution


def _checked(program: Program, state: SimplexState) -> SimplexState:
    """Where pivots have spoilt an inverse beyond repair, its end was none: from a new one the search goes on. Where nothing
    but so small a pivot keeps z from falling without end, one that slack or rounding have made, it then falls: else that
    pivot would be taken again and again.

    The search goes on, once, with a better inverse where z falls without end: errors of the inverse may look like a way to
    fall. And once from the very beginning where it has found no end: another way may lead past pivots that are too small.
    """
    solution, late = state.solution, state.steps >= MAX_PIVOTS
    better, error = newton(program, solution.basis)
    at_end = (solution.outcome == Outcome.UNBOUNDED) & _flat_out(program, better)
    solution = solution._replace(outcome=jnp.where(at_end, Outcome.OPTIMAL, solution.outcome))
    spoilt = error > SPOILT[jnp.finfo(error.dtype).bits]
    # The second time an optimum is taken whose inverse is as good as rounding lets it be: else it is left and met for ever.
    again_no_better = state.careful & (solution.outcome == Outcome.OPTIMAL) & (error <= _rounding(program, better))
    worn = spoilt & ~again_no_better & (solution.outcome != Outcome.UNDECIDED) & ~late
    endless = (solution.outcome == Outcome.UNBOUNDED) & ~state.again
    lost = (state.running | spoilt & late) & ~state.again

    def anew():
        beginning = jnp.full_like(solution.basis.chosen, UNIT).at[0].set(FREE)
        basis = factorised(program, jnp.where(lost, beginning, solution.basis.chosen))
        return jax.tree.map(lambda new, old: jnp.where(worn | lost, new, old), basis, better)

    basis = jax.lax.cond(jnp.any(worn | lost), anew, lambda: better)
    running = worn | endless | lost
    # An end that was none must not be taken for one where the search then finds no other.
    outcome = jnp.where(running | spoilt & late, Outcome.UNDECIDED, solution.outcome)
    return state._replace(
        solution=solution._replace(basis=basis, outcome=outcome),
        running=running,
        steps=jnp.where(jnp.any(lost), 0, state.steps),
        again=state.again | endless | lost,
        checked=~jnp.any(running),
        careful=state.careful | worn,
    )


def _rounding(program: Program, basis: Basis) -> Float[Array, "*n"]:
    """Error of an inverse that rounding alone brings about: its entries, times those of the columns, cancel to 0 and 1."""
    largest_entry = jnp.maximum(jnp.max(jnp.abs(program.free), axis=0), 1)  # of rays it is about 1
    return 8 * jnp.finfo(largest_entry.dtype).eps * jnp.max(jnp.abs(basis.inverse), axis=(0, 1)) * largest_entry


def _flat_out(program: Program, basis: Basis) -> Bool[Array, "*n"]:
    """Whether no ray is outside the face of this basis by more than LEAST_FALL.

    So it is with all rays of a flat cone, but for their rounding, of which the inverse makes more. That z falls without end
    along one of them is no more than rounding then: a robot would need forces of so many times its weight to slow down.
    """
    normal = combination((basis.chosen == FREE).astype(basis.inverse.dtype), basis.inverse)
    best = jnp.max(jax.lax.optimization_barrier(combination(normal, program.rays)), axis=0)
    return best <= LEAST_FALL[jnp.finfo(best.dtype).bits] * jnp.max(jnp.abs(normal), axis=0)


def _step(program: Program, state: SimplexState) -> SimplexState:
    """One pivot, or the end."""
    (basis, outcome, pivots), running, flat, steps, again, checked, careful, held = state
    late = steps >= BLAND
    entering, improves = _entering(program, held.normal, late)
    improves &= running
    direction = times(basis.inverse, ray(program.rays, entering))
    leaving, gives_way = _leaving(basis, held, direction, late, careful)

    go = improves & gives_way
    stuck = running & ~improves & held.seeking
    flattens = stuck & _within_slack(program, basis, held) & ~flat
    ending = jnp.where(stuck, Outcome.INFEASIBLE, Outcome.OPTIMAL)
    outcome = jnp.where(running & ~improves & ~flattens, ending, outcome)
    # No column gives way: z falls without end. What is missing cannot fall so; then it was no more than rounding that fell.
    endless = jnp.where(held.seeking, Outcome.INFEASIBLE, Outcome.UNBOUNDED)
    outcome = jnp.where(improves & ~gives_way, endless, outcome)
    basis = pivot(basis, leaving, entering, direction, go)
    solution = Solution(basis, outcome.astype(jnp.int32), pivots + go)
    return SimplexState(solution, go | flattens, flat | flattens, steps + 1, again, checked, careful, held)


def _zero(program: Program, basis: Basis, weights: Float[Array, "6 *n"], steps: Int[Array, ""]) -> Float[Array, "*n"]:
    """How far below zero a weight is still zero [m/s^2]: relative to all that the rays have to add up to.

    Pivots that are too small to be taken are left out, yet the weights behind them move, and where a cone is nearly flat by
    more than rounding: what one pivot mends another one spoils, for ever. So late in the search all that is slack is zero,
    and more and more of it.
    """
    bounds = tolerances(program.target.dtype)
    late = jnp.maximum(steps - BLAND, 0) / 8
    share = jnp.where(steps < BLAND, bounds.weight, (1 + late) * bounds.slack)
    return share.astype(weights.dtype) * _size(program, basis, weights)


def _size(program: Program, basis: Basis, weights: Float[Array, "6 *n"]) -> Float[Array, "*n"]:
    """Of target and free variable together [m/s^2]."""
    free = jnp.sum(jnp.where(basis.chosen == FREE, jnp.abs(weights), 0), axis=0)
    return program.scale + jnp.max(jnp.abs(program.free), axis=0) * free


def _held(program: Program, basis: Basis, flat: Bool[Array, "*n"], steps: Int[Array, ""]) -> Held:
    weights = times(basis.inverse, program.target)
    zero = _zero(program, basis, weights, steps)
    slack = tolerances(program.target.dtype).slack * _size(program, basis, weights)
    left_over = (basis.chosen <= UNIT) & (jnp.abs(weights) > jnp.where(flat, slack, zero))
    missing = jnp.where((basis.chosen >= 0) & (weights < -zero), -1, jnp.where(left_over, jnp.sign(weights), 0))
    seeking = jnp.any(missing != 0, axis=0)
    objective = jnp.where(seeking, missing, basis.chosen == FREE).astype(weights.dtype)
    return Held(weights, missing, seeking, zero, combination(objective, basis.inverse))


def _within_slack(program: Program, basis: Basis, held: Held) -> Bool[Array, "*n"]:
    """Nothing is missing but unit columns' weights, and those by no more than the slack."""
    slack = tolerances(program.target.dtype).slack * _size(program, basis, held.weights)
    is_ray, is_unit = basis.chosen >= 0, basis.chosen <= UNIT
    return ~jnp.any(is_ray & (held.missing != 0) | is_unit & (jnp.abs(held.weights) > slack), axis=0)


def _entering(
    program: Program, normal: Float[Array, "6 *n"], late: Bool[Array, ""]
) -> tuple[Int[Array, "*n"], Bool[Array, "*n"]]:
    """The ray that lies farthest outside the face with this normal (late: the first that does), and whether one does."""
    # Stored before it is reduced (on a GPU; XLA's CPU code stores it because it is used twice), or each product is computed
    # again for every lane of the reduction.
    gain = jax.lax.optimization_barrier(combination(normal, program.rays))
    enough = tolerances(gain.dtype).reduced_cost * jnp.max(jnp.abs(normal), axis=0)
    best = jnp.max(gain, axis=0)
    return first_of(gain, jnp.where(late, enough, best)), best > enough


def _leaving(
    basis: Basis,
    held: Held,
    direction: Float[Array, "6 *n"],
    late: Bool[Array, ""],
    careful: Bool[Array, "*n"],
) -> tuple[Bool[Array, "6 *n"], Bool[Array, "*n"]]:
    """The column that has to leave as a ray comes in, of those that come to zero first, and whether there is one."""
    is_ray, is_unit, missing = basis.chosen >= 0, basis.chosen <= UNIT, held.missing != 0
    size = jnp.abs(direction)
    falls = jnp.where(missing, direction * held.weights > 0, is_unit | is_ray & (direction > 0)) & (basis.chosen != FREE)
    above = jnp.where(missing, jnp.abs(held.weights), jnp.where(is_unit, 0, jnp.maximum(held.weights, 0)))
    bland = 1 / (2.0 + jnp.abs(basis.chosen)).astype(size.dtype)
    preferred = jnp.where(late, bland, size)
    falls = not_too_small(falls, above, size, held.zero, careful & ~held.seeking)
    return leaving_of(falls, above, size, held.zero, preferred)


def not_too_small(
    falls: Bool[Array, "m *n"], above: Array, size: Array, spare: Array, endless: Bool[Array, "*n"]
) -> Bool[Array, "m *n"]:
    """Columns that may leave, arguments as `leaving_of` has them: such as give a pivot that is large enough.

    A small one only where there is no other, or where to leave it out would push its column far beyond zero: what that one
    pivot does another mends, for ever. And not where there is no other if z may fall without end (`endless`).
    """
    large, falls = falls & (size > tolerances(size.dtype).pivot), falls & (size > SMALLEST[jnp.finfo(size.dtype).bits])
    step = jnp.min(jnp.where(large, (above + spare) / jnp.where(large, size, 1), jnp.inf), axis=0)
    pushed = jnp.any(falls & ~large & (above + spare < step * size), axis=0) & ~(endless & (step == jnp.inf))
    return jnp.where(pushed, falls, large)


def leaving_of(
    falls: Bool[Array, "m *n"], above: Array, size: Array, spare: Array | float, preferred: Array
) -> tuple[Bool[Array, "m *n"], Bool[Array, "*n"]]:
    """The ratio test: which of the basis's columns has to leave, and whether there is one.

    falls: columns that come nearer to zero as the new one comes in. above: how far they are from it. size: how fast they
    fall. spare: how far below zero a weight may come so that a larger pivot can be taken (Harris). preferred: of columns
    that rounding cannot tell apart, the one where this is largest.
    """
    safe = jnp.where(falls, size, 1)
    within = jnp.min(jnp.where(falls, (above + spare) / safe, jnp.inf), axis=0)
    # Compared as quotients on both sides: a product could round down, and the very column that sets the bound be left out.
    element, leaving = largest(jnp.where(falls & (above / safe <= within), preferred, 0))
    return leaving, element > 0
