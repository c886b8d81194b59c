"""Programs of six hard rows, and the bases of `simplex`: what a pivot does, not which is next.

The programs have six rows, one free variable z, and a weight for each ray:

    minimise z  such that  rays @ weights + free * z = target,  weights >= 0.

Lanes come last. A cone without inside, as that of one or two points, needs no special case: unit columns fill the basis
where no ray can, and their weights must vanish, but for rounding.
"""

import functools
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int

from jaxcap.numerics.guarded import tolerances

FREE = -1
"""Index of the free variable's column in a basis."""
UNIT = -2
"""Index of the first unit column; the others follow downwards."""
LOST_UNIT = 8
"""How much rather a unit column leaves than a ray, where the free variable comes in."""
LEAST_FIT = 1e-3
"""A free column fits in another's place if its own share of it is at least this much of the largest."""
WORN = 0.1
"""Largest error of an inverse that a Newton step may mend: it squares the error."""


class Program(NamedTuple):
    """What is to be solved. All in one scale: unit forces, torques over the size of the stance."""

    rays: Float[Array, "6 r *#n"]
    """Columns; zeros are padding."""
    free: Float[Array, "6 *n"]
    """The free variable's column; zero where there is none."""
    target: Float[Array, "6 *n"]
    scale: Float[Array, "*n"]
    """Size of the target [m/s^2]."""


class Basis(NamedTuple):
    """Six columns of a program, one for each row."""

    chosen: Int[Array, "6 *n"]
    """Number of a ray, FREE, or UNIT, UNIT - 1, ..."""
    inverse: Float[Array, "6 6 *n"]
    """Of the matrix of these columns: times a vector, their weights in it."""


def identity(shape: tuple[int, ...], dtype: DTypeLike) -> Basis:
    """The basis of unit columns."""
    over_lanes = lambda array: jnp.broadcast_to(array.reshape(*array.shape, *[1] * len(shape)), (*array.shape, *shape))
    return Basis(over_lanes(UNIT - jnp.arange(6, dtype=jnp.int32)), over_lanes(jnp.eye(6, dtype=dtype)))


def times(matrix: Float[Array, "6 6 *n"], vector: Float[Array, "6 *n"]) -> Float[Array, "6 *n"]:
    """Product, lane by lane. The sum is written out: XLA's reductions over computed products are slow on a CPU."""
    return cast(Array, sum(matrix[:, i] * vector[i] for i in range(6)))


def mixture(rays: Float[Array, "m r *#n"]) -> Float[Array, "m *#n"]:
    """A random amount of every ray, of all together about four: what a target is moved by, a little.

    Ties are broken by it, and the cone is closed in spite of rounding. Regular amounts would cancel each other around a
    pyramid.
    """
    amounts = jnp.asarray(np.random.default_rng(0).exponential(size=rays.shape[1]), rays.dtype)
    return jnp.tensordot(amounts, rays, axes=(0, 1)) * (4 / rays.shape[1])


def combination(vector: Float[Array, "6 *n"], rows: Float[Array, "6 k *#n"]) -> Float[Array, "k *n"]:
    """Sum of rows with these factors: a row of the simplex tableau, of all rays or of a basis."""
    return cast(Array, sum(rows[i] * vector[i] for i in range(6)))


def ray(rays: Float[Array, "6 r *#n"], index: Int[Array, "*n"]) -> Float[Array, "6 *n"]:
    """One column for each lane."""
    return jnp.take_along_axis(rays, jnp.clip(index, 0, rays.shape[1] - 1)[None, None], axis=1)[:, 0]


def columns(program: Program, index: Int[Array, "6 *n"]) -> Float[Array, "6 6 *n"]:
    """The matrix of a basis."""
    rays = jnp.take_along_axis(program.rays, jnp.clip(index, 0, program.rays.shape[1] - 1)[None], axis=1)
    unit = (UNIT - index == jnp.arange(6).reshape(6, *[1] * index.ndim)).astype(rays.dtype)
    return jnp.where(index >= 0, rays, jnp.where(index == FREE, program.free[:, None], unit))


@jax.custom_jvp
def weights(
    inverse: Float[Array, "6 6 *n"], matrix: Float[Array, "6 6 *n"], target: Float[Array, "6 *n"]
) -> Float[Array, "6 *n"]:
    """The weights of a basis with this matrix in the target; differentiable in matrix and target, not in the inverse."""
    return times(inverse, target)


@weights.defjvp
def _weights_jvp(primals, tangents):
    (inverse, _, target), (_, matrix, moved) = primals, tangents
    found = times(inverse, target)
    return found, times(inverse, moved - times(matrix, found))


def pivot(
    basis: Basis,
    leaving: Bool[Array, "6 *n"],
    entering: Int[Array, "*n"],
    direction: Float[Array, "6 *n"],
    go: Bool[Array, "*n"],
) -> Basis:
    """The basis with one column replaced, in lanes that `go`.

    leaving: one row of six. direction: weights of the entering column in the basis.
    """
    row = combination(leaving.astype(direction.dtype), basis.inverse)
    element = jnp.sum(jnp.where(leaving, direction, 0), axis=0)
    row = row / jnp.where(go, element, 1)
    change = jnp.where(go, jnp.where(leaving, direction - 1, direction), 0)
    inverse = basis.inverse - change[:, None] * row[None]
    return Basis(jnp.where(leaving & go, entering, basis.chosen).astype(jnp.int32), inverse)


def first_of(values: Float[Array, "k *n"], least: Float[Array, "*n"]) -> Int[Array, "*n"]:
    """The place of the first value along the first axis that is at least this large; k where there is none."""
    places = jnp.arange(len(values), dtype=jnp.int32).reshape(-1, *[1] * (values.ndim - 1))
    return jnp.min(jnp.where(values >= least, places, len(values)), axis=0)


def largest(values: Float[Array, "m *n"]) -> tuple[Float[Array, "*n"], Bool[Array, "m *n"]]:
    """The largest along the first axis, and its place: the first of several."""
    most = jnp.max(values, axis=0)
    places = jnp.arange(len(values), dtype=jnp.int32).reshape(-1, *[1] * (values.ndim - 1))
    return most, places == first_of(values, most)


def freed(program: Program, basis: Basis) -> Basis:
    """The basis with the free variable of this program, in place of another program's or of the best unit column."""
    bound = tolerances(program.target.dtype).pivot
    stale = basis.chosen == FREE
    row = combination(stale.astype(program.target.dtype), basis.inverse)
    size, unit = largest(jnp.abs(row))
    axis = jnp.argmax(unit, axis=0).astype(jnp.int32)
    out = jnp.any(stale, axis=0)
    unit_direction = jnp.sum(jnp.where(unit[None], basis.inverse, 0), axis=1)
    basis = pivot(basis, stale, UNIT - axis, unit_direction, out & (size > 0))
    direction = times(basis.inverse, program.free)
    # A unit column is as good as lost; among the others, the largest pivot.
    size, leaving = largest(jnp.where(basis.chosen <= UNIT, LOST_UNIT, 1) * jnp.abs(direction))
    found = size > bound * jnp.max(jnp.abs(program.free), axis=0)
    return pivot(basis, leaving, jnp.full(size.shape, FREE, jnp.int32), direction, found)


def factorised(program: Program, index: Int[Array, "6 *n"]) -> Basis:
    """The basis of these columns, by Gauss-Jordan elimination; a ray that depends on the others stays out.

    The free variable comes first: a ray that is left out can come in again, it can not.
    """
    bound = tolerances(program.target.dtype).pivot
    basis = identity(index.shape[1:], program.target.dtype)
    free = index == FREE
    index = jnp.concatenate([jnp.where(free.any(axis=0), FREE, index[0])[None], jnp.where(free, index[0], index)[1:]])
    matrix = columns(program, index)

    def one(k: Int[Array, ""], basis: Basis) -> Basis:
        at = lambda field, axis: jax.lax.dynamic_index_in_dim(field, k, axis, keepdims=False)
        direction, number = times(basis.inverse, at(matrix, 1)), at(index, 0)
        size, leaving = largest(jnp.where(basis.chosen <= UNIT, jnp.abs(direction), 0))
        return pivot(basis, leaving, number, direction, (size > bound) & (number > UNIT))

    return jax.lax.fori_loop(0, 6, one, basis)


def improved(program: Program, basis: Basis) -> Basis:
    """A Newton step for the inverse, which pivots have spoilt."""
    return newton(program, basis)[0]


def renewed(program: Program, basis: Basis) -> Basis:
    """The basis of a similar program as one of this: other free column, rays perhaps a little different.

    Where the free column does not fit, or the rays have changed so much that the inverse is none, it begins anew.
    """
    leaving, direction = basis.chosen == FREE, times(basis.inverse, program.free)
    own = jnp.abs(jnp.sum(jnp.where(leaving, direction, 0), axis=0))
    fits = own > LEAST_FIT * jnp.max(jnp.abs(direction), axis=0)
    better, error = newton(program, pivot(basis, leaving, jnp.full(fits.shape, FREE, jnp.int32), direction, fits))
    good = fits & (error < WORN)

    def mended():
        anew = freed(program, identity(fits.shape, direction.dtype))
        return jax.tree.map(lambda old, new: jnp.where(good, old, new), better, anew)

    return jax.lax.cond(jnp.all(good), lambda: better, mended)


def newton(program: Program, basis: Basis) -> tuple[Basis, Float[Array, "*n"]]:
    """The basis after a Newton step for its inverse, and the largest error before.

    The error is that of inverse @ matrix, which weights inherit. That of matrix @ inverse would do for most bases, but where
    an inverse is large, as that of a nearly flat cone, its rounding errors would be multiplied by all of it.
    """
    matrix, inverse = columns(program, basis.chosen), basis.inverse
    product = sum(inverse[:, i, None] * matrix[None, i] for i in range(6))
    error = jnp.eye(6, dtype=inverse.dtype).reshape(6, 6, *[1] * (inverse.ndim - 2)) - product
    better = inverse + sum(error[:, i, None] * inverse[None, i] for i in range(6))
    # Row by row: XLA's CPU reduction of all entries would compute each from the start, lane by lane.
    in_column = functools.reduce(jnp.maximum, jnp.abs(error))
    return basis._replace(inverse=better), functools.reduce(jnp.maximum, in_column)
