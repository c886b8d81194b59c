"""A small simplex method with fixed shapes, for rows that may give way within bounds; many programs side by side.

The programs have m rows, one free variable z, a weight for each ray, and each row's own unit column:

    minimise z  such that  rays @ weights + free * z + units = target,  weights >= 0,  |units_i| <= bound_i.

A bound of zero makes a row a hard one, as all rows of `simplex` are; else the row may give way, up to the bound. A unit
column outside the basis is at one of its bounds, and `side` says at which: that is all there is to know besides the basis.
What is done about ties, rounding and cycles is as in `simplex`. The free variable is always the basis's first column, so
that the normal of the face through the basis is the first row of its inverse. Lanes come last.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxcap.numerics.bounded_basis import (
    Basis,
    Program,
    begun,
    column_at,
    combination,
    exchanged,
    held_back,
    improved,
    inverse_of,
    normal_of,
    of_units,
    times,
)
from jaxcap.numerics.guarded import tolerances
from jaxcap.numerics.simplex import SPOILT, Outcome, leaving_of, not_too_small
from jaxcap.numerics.simplex_basis import FREE, UNIT, first_of

PIVOTS = 40, 8
"""Most pivots of one program: so many, and so many for each row."""
BLAND = 20, 4
"""From here on, Bland's rule: of all columns that improve, and of all that may leave, the first. It cannot cycle."""


class Solution(NamedTuple):
    """Where the simplex ends."""

    basis: Basis
    outcome: Int[Array, "*n"]
    """An `Outcome`."""
    pivots: Int[Array, "*n"]


class SimplexState(NamedTuple):
    """Where the simplex stands."""

    solution: Solution
    running: Bool[Array, "*n"]
    flat: Bool[Array, "*n"]
    """No column takes over from those that are left of hard rows: these may be as large as the slack."""
    steps: Int[Array, ""]
    again: Bool[Array, "*n"]
    """The search has been asked for once more."""
    checked: Bool[Array, ""]
    """All have come to an end with inverses that are to be trusted."""
    room: Float[Array, "m *n"]
    """The bounds of the unit columns in the basis; zero for rays."""
    careful: Bool[Array, "*n"]
    """A pivot that was too small has spoilt an inverse: such a one no longer keeps z from falling without end."""


def solve(program: Program, basis: Basis, active: Bool[Array, "*n"]) -> Solution:
    """Minimise from any basis that holds this program's free variable, in the lanes that are active.

    While some column of the basis is out of its bounds, the sum of what is out is made smaller; then z.
    """
    outcome = jnp.full(active.shape, Outcome.UNDECIDED, jnp.int32)
    solution = Solution(basis, outcome, jnp.zeros(active.shape, jnp.int32))
    room = of_units(program.bound, basis.chosen)
    start = SimplexState(solution, active, ~active, jnp.int32(0), ~active, ~jnp.any(active), room, jnp.zeros_like(active))
    most = PIVOTS[0] + PIVOTS[1] * len(program.target)

    def one(state: SimplexState) -> SimplexState:
        searching = jnp.any(state.running) & (state.steps < most)
        return jax.lax.cond(searching, lambda: _step(program, state), lambda: _checked(program, state))

    return jax.lax.while_loop(lambda state: ~state.checked, one, start).solution


def _checked(program: Program, state: SimplexState) -> SimplexState:
    """Where pivots have spoilt an inverse beyond repair, its end was none: from a new one the search goes on, once.

    So it does, with a better inverse, where z falls without end: errors of the inverse may look like a way to fall. And once
    from the very beginning where it has found no end: another way may lead past the pivots that are too small.
    """
    solution = state.solution
    better, error = improved(program, solution.basis)
    first = ~state.again
    worn = ~(error <= SPOILT[jnp.finfo(error.dtype).bits]) & (solution.outcome != Outcome.UNDECIDED)
    endless = (solution.outcome == Outcome.UNBOUNDED) & first
    lost = state.running & first

    def anew() -> Basis:
        repaired = better._replace(inverse=jnp.where(worn, inverse_of(program, solution.basis).inverse, better.inverse))
        return jax.tree.map(lambda new, old: jnp.where(lost, new, old), begun(program), repaired)

    basis = jax.lax.cond(jnp.any(worn | lost), anew, lambda: better)
    running = (worn & first) | endless | lost
    # An end that was none must not be taken for one where the search then finds no other.
    outcome = jnp.where(running, Outcome.UNDECIDED, solution.outcome)
    return SimplexState(
        solution=solution._replace(basis=basis, outcome=outcome),
        running=running,
        flat=state.flat & ~lost,
        steps=jnp.where(jnp.any(lost), 0, state.steps),
        again=state.again | running,
        checked=~jnp.any(running),
        room=jnp.where(lost, of_units(program.bound, basis.chosen), state.room),
        careful=state.careful | worn & first,
    )


class Held(NamedTuple):
    """What the columns of a basis hold, and which of them hold what they must not."""

    weights: Float[Array, "m *n"]
    unit: Bool[Array, "m *n"]
    """Unit columns."""
    bound: Float[Array, "m *n"]
    """Of unit columns; zero for rays."""
    missing: Float[Array, "m *n"]
    """-1 for a ray below zero and a unit column below its bounds, +1 for one above, else 0."""
    seeking: Bool[Array, "*n"]
    """Something is missing: that is made smaller first."""
    zero: Float[Array, "*n"]
    """How far out of bounds is not."""


def _held(program: Program, state: SimplexState, bland: int) -> Held:
    basis, flat, steps, bound = state.solution.basis, state.flat, state.steps, state.room
    bounds = tolerances(program.target.dtype)
    found = times(basis.inverse, held_back(program, basis))
    size = program.scale + jnp.max(jnp.abs(program.free), axis=0) * jnp.abs(found[0])
    late = jnp.maximum(steps - bland, 0) / 8
    zero = jnp.where(steps < bland, bounds.weight, (1 + late) * bounds.slack).astype(found.dtype) * size
    unit = basis.chosen <= UNIT
    slack = jnp.where(flat & (bound == 0), jnp.maximum(bounds.slack * size, zero), zero)
    is_out = jnp.abs(found) > bound + slack
    missing = jnp.where(unit & is_out, jnp.sign(found), jnp.where((basis.chosen >= 0) & (found < -zero), -1, 0))
    return Held(found, unit, bound, missing, jnp.any(missing != 0, axis=0), zero)


def _step(program: Program, state: SimplexState) -> SimplexState:
    """One pivot, one unit column from one of its bounds to the other, or the end."""
    (basis, outcome, pivots), running, flat, steps, again, checked, room, careful = state
    bland = BLAND[0] + BLAND[1] * len(program.target)
    late = steps >= bland
    held = _held(program, state, bland)
    normal = jnp.where(held.seeking, combination(held.missing, basis.inverse), normal_of(basis))
    gain = jnp.concatenate([combination(normal, program.rays), -basis.side * normal])
    enough = tolerances(gain.dtype).reduced_cost * jnp.max(jnp.abs(normal), axis=0)
    best = jnp.max(gain, axis=0)
    improves = running & (best > enough)
    entering = column_at(program.rays, basis, first_of(gain, jnp.where(late, enough, best)))
    direction = times(basis.inverse, entering.column)
    leaving, way, side = _leaving(basis, held, direction, late, careful)
    own = jnp.sum(jnp.where(entering.row, program.bound, 0), axis=0)
    flips = improves & jnp.any(entering.row, axis=0) & (2 * own <= way)
    gives_way = jnp.any(leaving, axis=0)
    falls = ~held.seeking & (held.weights[0] < program.floor)

    go = improves & gives_way & ~flips & ~falls
    stuck = running & ~improves & held.seeking
    flattens = stuck & _within_slack(program, basis, held) & ~flat
    outcome = jnp.where(running & ~improves & ~flattens, jnp.where(stuck, Outcome.INFEASIBLE, Outcome.OPTIMAL), outcome)
    # No column gives way: z falls without end. What is missing cannot fall so; then it was no more than rounding that fell.
    endless = jnp.where(held.seeking, Outcome.INFEASIBLE, Outcome.UNBOUNDED)
    outcome = jnp.where(improves & ((~gives_way & ~flips) | falls), endless, outcome)
    basis = exchanged(basis, leaving, side, entering, direction, go)
    basis = basis._replace(side=jnp.where(flips & entering.row, -basis.side, basis.side))
    solution = Solution(basis, outcome.astype(jnp.int32), pivots + go)
    room = jnp.where(leaving & go, own, room)
    running = go | flattens | (flips & ~falls)
    return SimplexState(solution, running, flat | flattens, steps + 1, again, checked, room, careful)


def _within_slack(program: Program, basis: Basis, held: Held) -> Bool[Array, "*n"]:
    """Nothing is missing but unit columns of hard rows, and those by no more than the slack."""
    size = program.scale + jnp.max(jnp.abs(program.free), axis=0) * jnp.abs(held.weights[0])
    little = held.unit & (held.bound == 0) & (jnp.abs(held.weights) <= tolerances(size.dtype).slack * size)
    return ~jnp.any((held.missing != 0) & ~little, axis=0)


def _leaving(
    basis: Basis, held: Held, direction: Float[Array, "m *n"], late: Bool[Array, ""], careful: Bool[Array, "*n"]
) -> tuple[Bool[Array, "m *n"], Float[Array, "*n"], Float[Array, "*n"]]:
    """The column that has to leave as another comes in (none, where none has to), after what way, and to which side."""
    size, out = jnp.abs(direction), held.missing != 0
    down = direction > 0
    # What is out of bounds comes to the nearer one; the others to the one ahead.
    falls = jnp.where(out, direction * held.missing > 0, held.unit | (basis.chosen >= 0) & down) & (basis.chosen != FREE)
    ahead = jnp.where(held.unit, held.bound + jnp.where(down, held.weights, -held.weights), held.weights)
    above = jnp.where(out, jnp.abs(held.weights) - held.bound, jnp.maximum(ahead, 0))
    bland = 1 / (2.0 + jnp.abs(basis.chosen)).astype(size.dtype)
    preferred = jnp.where(late, bland, size)
    falls = not_too_small(falls, above, size, held.zero, careful & ~held.seeking)
    leaving, found = leaving_of(falls, above, size, held.zero, preferred)
    leaving &= found
    pick = lambda values: jnp.sum(jnp.where(leaving, values, 0), axis=0)
    to = jnp.where(out, held.missing, jnp.where(down, -1, 1)) * (held.bound > 0)
    way = jnp.where(jnp.any(leaving, axis=0), pick(above / jnp.where(falls, size, 1)), jnp.inf)
    return leaving, way, pick(to.astype(size.dtype))
