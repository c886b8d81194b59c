"""Programs whose rows may give way within bounds, and the bases of `bounded_simplex`: what a pivot does, not which is next.

A unit column outside the basis is at one of its bounds, and `side` says which: that is all there is to know besides the
basis. The free variable is always the first column of the basis, so that the normal of the face through it is the first row
of its inverse. Lanes come last.
"""

from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxcap.numerics.guarded import tolerances
from jaxcap.numerics.simplex_basis import FREE, LEAST_FIT, LOST_UNIT, UNIT, largest


class Program(NamedTuple):
    """What is to be solved. All in one scale: unit forces, torques over the size of the stance or the joints' limits."""

    rays: Float[Array, "m r *n"]
    """Columns; zeros are padding."""
    free: Float[Array, "m *n"]
    """The free variable's column."""
    target: Float[Array, "m *n"]
    bound: Float[Array, "m *n"]
    """Of each row's unit column, >= 0."""
    scale: Float[Array, "*n"]
    """Size of the target [m/s^2]."""
    floor: Float[Array, "*n"]
    """A z below this counts as falling without end."""


class Basis(NamedTuple):
    """As many columns of a program as it has rows, and where the unit columns are that are not among them."""

    chosen: Int[Array, "m *n"]
    """Number of a ray, FREE, or UNIT, UNIT - 1, ... FREE comes first, if it is there: a column of zeros is not."""
    inverse: Float[Array, "m m *n"]
    """Of the matrix of these columns: times a vector, their weights in it."""
    side: Float[Array, "m *n"]
    """+1 or -1 for a unit column at that end of its bounds, 0 for one that is in the basis or can only be zero."""


def times(matrix: Float[Array, "m k *n"], vector: Float[Array, "k *n"]) -> Float[Array, "m *n"]:
    """Product, lane by lane."""
    return stored(_product(matrix, vector))


def _product(matrix: Float[Array, "m k *n"], vector: Float[Array, "k *n"]) -> Float[Array, "m *n"]:
    """The sum is written out, for XLA's reductions over computed products are slow on a CPU."""
    return cast(Array, sum(matrix[:, i] * vector[i] for i in range(len(vector))))


def combination(vector: Float[Array, "m *n"], rows: Float[Array, "m k *n"]) -> Float[Array, "k *n"]:
    """Sum of rows with these factors: a row of the simplex tableau."""
    return stored(cast(Array, sum(rows[i] * vector[i] for i in range(len(vector)))))


def stored(values: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The values, in memory: else XLA computes them again wherever they are used, which may be for each entry of a matrix.

    It takes sums and products for cheap, through an optimization barrier too, but no quotient.
    """
    return values / (1 + 0 * values)  # one, for all it knows


def held_back(program: Program, basis: Basis) -> Float[Array, "m *n"]:
    """What the basis has to add up to: the target less the unit columns at their bounds."""
    return program.target - basis.side * program.bound


def columns(program: Program, index: Int[Array, "m *n"]) -> Float[Array, "m m *n"]:
    """The matrix of a basis."""
    rays = jnp.take_along_axis(program.rays, jnp.clip(index, 0, program.rays.shape[1] - 1)[None], axis=1)
    unit = (UNIT - index == _places(index)[:, None]).astype(rays.dtype)
    return jnp.where(index >= 0, rays, jnp.where(index == FREE, program.free[:, None], unit))


@jax.custom_jvp
def weights(
    inverse: Float[Array, "k m *n"],
    found: Float[Array, "m *n"],
    matrix: Float[Array, "m m *n"],
    target: Float[Array, "m *n"],
) -> Float[Array, "k *n"]:
    """The weights of a basis with this matrix in the target; differentiable in matrix and target, not in the inverse.

    Args:
        inverse: all of its rows, or those of which the weights are wanted.
        found: all weights, for the derivative.
        matrix: of the columns.
        target: what they add up to.
    """
    return times(inverse, target)


@weights.defjvp
def _weights_jvp(primals, tangents):
    (inverse, found, _, target), (_, _, matrix, moved) = primals, tangents
    # Tangents are not `stored`: a quotient by them has no transpose, and there would be no reverse mode.
    return times(inverse, target), _product(inverse, moved - _product(matrix, found))


def begun(program: Program) -> Basis:
    """The basis of unit columns, and the free variable in place of the best of them."""
    lanes, dtype, m = program.target.shape[1:], program.target.dtype, len(program.target)
    over = lambda array: jnp.broadcast_to(array.reshape(*array.shape, *[1] * len(lanes)), (*array.shape, *lanes))
    units = Basis(over(UNIT - jnp.arange(m, dtype=jnp.int32)), over(jnp.eye(m, dtype=dtype)), jnp.zeros_like(program.target))
    return freed(program, _with_best_first(program, units, program.free))


def freed(program: Program, basis: Basis) -> Basis:
    """The basis with this program's free column in the place of the first, if it can be there."""
    direction = times(basis.inverse, program.free)
    first = jnp.broadcast_to(_places(direction) == 0, direction.shape)
    fits = jnp.abs(direction[0]) > tolerances(direction.dtype).pivot * jnp.max(jnp.abs(program.free), axis=0)
    found = pivot(basis, first, jnp.full(fits.shape, FREE, jnp.int32), direction, fits)
    # A unit column that can be other than zero goes to one of its bounds, whichever: what that spoils is mended.
    out = (UNIT - basis.chosen[0] == _places(basis.chosen)) & fits
    return found._replace(side=jnp.where(out, (program.bound > 0).astype(basis.side.dtype), basis.side))


def renewed(program: Program, basis: Basis) -> Basis:
    """A basis that was found for another free column and perhaps other bounds, as one for this program.

    Where the new column does not fit in the old one's place, a unit column takes that, and the new one another.
    """
    side = jnp.where((basis.side == 0) | (program.bound == 0), 0, basis.side)
    # What had no bounds and is not in the basis goes to one of them.
    inside = jnp.any(UNIT - basis.chosen[None] == _places(basis.chosen)[:, None], axis=1)
    basis = basis._replace(side=jnp.where(~inside & (side == 0) & (program.bound > 0), 1, side).astype(side.dtype))
    direction = times(basis.inverse, program.free)
    own, size = jnp.abs(direction[0]), jnp.max(jnp.abs(direction), axis=0)
    stays = (own >= LEAST_FIT * size) & (own > tolerances(own.dtype).pivot * jnp.max(jnp.abs(program.free), axis=0))
    stays |= basis.chosen[0] != FREE

    def elsewhere() -> Basis:
        _, unit = largest(jnp.abs(basis.inverse[0]) * jnp.where(program.bound > 0, 1, LOST_UNIT))
        number = UNIT - jnp.sum(jnp.where(unit, _places(unit), 0), axis=0)
        first = jnp.broadcast_to(_places(direction) == 0, direction.shape)
        filled = pivot(basis, first, number, jnp.sum(jnp.where(unit[None], basis.inverse, 0), axis=1), ~stays)
        filled = filled._replace(side=jnp.where(unit & ~stays, 0, filled.side))
        better = _with_best_first(program, filled, times(filled.inverse, program.free))
        choose = lambda new, old: jnp.where(stays & (basis.chosen[0] == FREE), old, new)
        return jax.tree.map(choose, better, filled)

    return freed(program, jax.lax.cond(jnp.all(stays & (basis.chosen[0] == FREE)), lambda: basis, elsewhere))


def _with_best_first(program: Program, basis: Basis, direction: Float[Array, "m *n"]) -> Basis:
    """The same basis, the column first in whose place one with these weights fits best; hard rows' are as good as lost."""
    hard = (basis.chosen <= UNIT) & (of_units(program.bound, basis.chosen) == 0)
    _, place = largest(jnp.where(hard, LOST_UNIT, 1) * jnp.abs(direction))
    pick = lambda rows, which: jnp.sum(jnp.where(which, rows, 0), axis=0)
    swap = lambda rows, which: jnp.where(which, rows[:1], rows).at[0].set(pick(rows, which).astype(rows.dtype))
    return basis._replace(chosen=swap(basis.chosen, place), inverse=swap(basis.inverse, place[:, None]))


def normal_of(basis: Basis) -> Float[Array, "m *n"]:
    """Of the face through the basis, pointing outwards, scaled such that its product with the free column is 1."""
    return jnp.where(basis.chosen[0] == FREE, basis.inverse[0], 0)


def turned(basis: Basis) -> Basis:
    """The basis with the free variable's column turned round."""
    return basis._replace(inverse=basis.inverse.at[0].multiply(jnp.where(basis.chosen[0] == FREE, -1, 1)))


def pivot(
    basis: Basis,
    leaving: Bool[Array, "m *n"],
    entering: Int[Array, "*n"],
    direction: Float[Array, "m *n"],
    go: Bool[Array, "*n"],
) -> Basis:
    """The basis with one column replaced, in lanes that `go`; `side` is left as it is.

    leaving: one row. direction: weights of the entering column in the basis.
    """
    row = jnp.sum(jnp.where(leaving[:, None], basis.inverse, 0), axis=0)
    element = jnp.sum(jnp.where(leaving, direction, 0), axis=0)
    row = row / jnp.where(go, element, 1)
    change = stored(jnp.where(go, jnp.where(leaving, direction - 1, direction), 0))
    inverse = basis.inverse - change[:, None] * row[None]
    return Basis(jnp.where(leaving & go, entering, basis.chosen).astype(jnp.int32), inverse, basis.side)


def inverse_of(program: Program, basis: Basis) -> Basis:
    """The basis with its inverse computed anew, by Gauss-Jordan elimination with the largest pivot of each column.

    Not by LAPACK, as `jnp.linalg` has it: its kernel shares the threads of the program that calls it, and two programs side
    by side that all wait for a thread wait for ever (jaxlib 0.10, on two cores).
    """
    matrix = columns(program, basis.chosen)
    m, lanes = len(matrix), matrix.shape[2:]
    eye = jnp.eye(m, dtype=matrix.dtype).reshape(m, m, *[1] * len(lanes))

    def one(k: Int[Array, ""], state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        left, found, turn = state
        column = jax.lax.dynamic_index_in_dim(left, k, 1, keepdims=False)
        _, here = largest(jnp.where(turn < m, -1, jnp.abs(column)))  # of the rows that have not had their turn
        element = jnp.sum(jnp.where(here, column, 0), axis=0)
        factor = stored(jnp.where(here, 0, column))

        def eliminated(rows: Array) -> Array:
            row = stored(jnp.sum(jnp.where(here[:, None], rows, 0), axis=0) / jnp.where(element != 0, element, 1))
            return jnp.where(here[:, None], row, rows - factor[:, None] * row)

        return eliminated(left), eliminated(found), jnp.where(here, k, turn)

    start = matrix, jnp.broadcast_to(eye, matrix.shape), jnp.full((m, *lanes), m)
    _, found, turn = jax.lax.fori_loop(0, m, one, start)
    return basis._replace(inverse=jnp.take_along_axis(found, jnp.argsort(turn, axis=0)[:, None], axis=0))


def improved(program: Program, basis: Basis) -> tuple[Basis, Float[Array, "*n"]]:
    """The basis with a better normal, and how far pivots have spoilt its inverse.

    A Newton step for all of the inverse, as `simplex` has it, would cost as much as a dozen pivots of so many rows. What
    matters is the normal, which gets its step, and the weights, by which the inverse is judged.
    """
    matrix, inverse = columns(program, basis.chosen), basis.inverse
    aim = held_back(program, basis)
    found = times(inverse, aim)
    left = times(inverse, aim - times(matrix, found))
    short = (_places(aim) == 0) - combination(inverse[0], matrix)
    size = program.scale + jnp.max(jnp.abs(found), axis=0)
    error = jnp.maximum(jnp.max(jnp.abs(left), axis=0) / size, jnp.max(jnp.abs(short), axis=0))
    normal = inverse[0] + combination(short, inverse)
    return basis._replace(inverse=jnp.concatenate([normal[None], inverse[1:]])), error


class Entering(NamedTuple):
    """The column that comes in."""

    number: Int[Array, "*n"]
    """As in a basis."""
    column: Float[Array, "m *n"]
    """What is added as it comes in: of a unit column at its upper bound, minus that column."""
    row: Bool[Array, "m *n"]
    """Of a unit column; none of a ray."""


def column_at(rays: Float[Array, "m r *n"], basis: Basis, place: Int[Array, "*n"]) -> Entering:
    """The column at a place in the list of rays, then rows."""
    r = rays.shape[1]
    row = place - r == _places(basis.side)
    ray = jnp.take_along_axis(rays, jnp.clip(place, 0, r - 1)[None, None], axis=1)[:, 0]
    number = jnp.where(place < r, place, UNIT - (place - r)).astype(jnp.int32)
    column = stored(jnp.where(place < r, ray, jnp.where(row, -basis.side, 0)))
    return Entering(number, column, row & (place >= r))


def exchanged(
    basis: Basis,
    leaving: Bool[Array, "m *n"],
    side: Float[Array, "*n"],
    entering: Entering,
    direction: Float[Array, "m *n"],
    go: Bool[Array, "*n"],
) -> Basis:
    """The basis after a pivot, in lanes that `go`. side: at which of its bounds the leaving column is then."""
    left = UNIT - jnp.sum(jnp.where(leaving, basis.chosen, 0), axis=0) == _places(
        basis.side
    )  # its row, if it is a unit column
    sign = jnp.where(jnp.any(entering.row, axis=0), jnp.sum(jnp.where(entering.row, -basis.side, 0), axis=0), 1)
    found = pivot(basis, leaving, entering.number, direction * sign, go)
    after = jnp.where(left, side, jnp.where(entering.row, 0, basis.side))
    return found._replace(side=jnp.where(go, after, basis.side))


def of_units(values: Float[Array, "m *n"], chosen: Int[Array, "m *n"]) -> Float[Array, "m *n"]:
    """A value of each row, for the columns of a basis that are unit columns; zero for the others."""
    row = jnp.clip(UNIT - chosen, 0, len(values) - 1)
    return jnp.where(chosen <= UNIT, jnp.take_along_axis(values, row, axis=0), 0)


def _places(like: Array) -> Int[Array, "m *#n"]:
    """0, 1, ... along the first axis."""
    return jnp.arange(len(like), dtype=jnp.int32).reshape(-1, *[1] * (like.ndim - 1))
