"""Tolerances, by dtype and named for what they bound, and functions guarded where they would be singular.

They are used hundreds of times in one program: under `jax.jit` each is traced once for each shape.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float


class Tolerances(NamedTuple):
    """Relative bounds on rounding errors."""

    slack: float
    """The one distance within which a verdict may differ: a CoM moved by this, relative to the size of the stance, or a
    velocity turned by this angle [rad]. See `wrench_line`."""
    same_alpha: float
    """Positions this close, relative to the size of the stance and the CoM's distance from it, are one position."""
    pivot: float
    """An entry of the simplex this small is zero: no pivot."""
    reduced_cost: float
    """A ray outside the current face by less than this, relative to the face's normal, lies on it."""
    weight: float
    """A ray's weight this far below zero, relative to gravity's wrench, is zero."""


def tolerances(dtype: DTypeLike) -> Tolerances:
    """The tolerances of a floating-point dtype."""
    if jnp.finfo(dtype).bits == 64:
        return Tolerances(1e-12, 1e-9, pivot=1e-9, reduced_cost=1e-12, weight=1e-14)
    return Tolerances(2e-6, 1e-4, pivot=1e-4, reduced_cost=2e-6, weight=2e-7)


@jax.jit
def root(square: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Square root, zero (and its gradient too) where the argument is not positive."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1)), 0)


@functools.partial(jax.jit, static_argnames="otherwise")
def ratio(numerator: Float[Array, "..."], denominator: Float[Array, "..."], otherwise: float = 0.0) -> Float[Array, "..."]:
    """Quotient, `otherwise` where the denominator is zero."""
    safe = denominator != 0
    return jnp.where(safe, numerator / jnp.where(safe, denominator, 1), otherwise)


@jax.custom_jvp
def least_of(values: Float[Array, "k *n"]) -> Float[Array, "*n"]:
    """The smallest along the first axis; of several that are equal the first one's gradient, where `jnp.min` has the mean of
    theirs, which is that of no side of a kink."""
    return jnp.min(values, axis=0)


@least_of.defjvp
def _least_of_jvp(primals, tangents):
    (values,), (change,) = primals, tangents
    first = jnp.argmin(values, axis=0)[None]
    return jnp.min(values, axis=0), jnp.take_along_axis(change, first, axis=0)[0]


def greatest_of(values: Float[Array, "k *n"]) -> Float[Array, "*n"]:
    """The largest, likewise."""
    return -least_of(-values)


def lesser(one: Float[Array, "*n"], other: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The smaller of two, with the gradient of the first where they are equal."""
    return jnp.where(one <= other, one, other)


def greater(one: Float[Array, "*n"], other: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The larger of two, likewise."""
    return jnp.where(one >= other, one, other)


@jax.jit
def snapped(value: Float[Array, "..."], noise: Float[Array, "..."]) -> Float[Array, "..."]:
    """Zero where the value is no larger than the noise; its gradient is kept, for to the right and left it is not zero."""
    return value - jax.lax.stop_gradient(jnp.where(jnp.abs(value) <= noise, value, 0))


def select(conditions, choices, otherwise):
    """`jnp.select`, which looks for the first condition that holds, without the search: nested choices run as one loop."""
    for condition, choice in zip(reversed(conditions), reversed(choices), strict=True):
        otherwise = jnp.where(condition, choice, otherwise)
    return otherwise


def direction(velocity: Float[Array, "3 *n"]) -> tuple[Float[Array, "3 *n"], Float[Array, "*n"]]:
    """Unit vector and norm; at zero velocity the direction is zero, and so is its gradient.

    The velocity is scaled first, such that its square neither overflows nor vanishes.
    """
    size = jnp.max(jnp.abs(velocity), axis=0)
    scale = jax.lax.stop_gradient(jnp.where(size > 0, size, 1))  # it cancels, so it has no gradient
    scaled = velocity / scale
    norm = root(jnp.sum(scaled * scaled, axis=0))
    return ratio(scaled, norm), norm * scale


@jax.jit
def atanh_ratio(z: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """atanh(sqrt z)/sqrt z for 0 < z < 1, atan(sqrt -z)/sqrt -z for z < 0, 1 at 0; z >= 1 is taken for just below 1."""
    z = jnp.minimum(z, 1 - jnp.finfo(z.dtype).epsneg)
    small = jnp.abs(z) < 1e-4
    series = 1 + z * (1 / 3 + z * (1 / 5 + z / 7))
    w = root(jnp.where(small, 1, jnp.abs(z)))
    # atanh(w) = log1p(2w / (1 - w)) / 2: one logarithm, exact near 1
    below = jnp.where(z > 0, w, 0.5)
    return jnp.where(small, series, jnp.where(z > 0, 0.5 * jnp.log1p(2 * below / (1 - below)), jnp.arctan(w)) / w)


@jax.jit
def sinh_ratio(z: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """sinh(sqrt z)/sqrt z for z > 0, sin(sqrt -z)/sqrt -z for z < 0, 1 at 0."""
    small = jnp.abs(z) < 1e-2
    series = 1 + z / 6 * (1 + z / 20 * (1 + z / 42 * (1 + z / 72)))
    w = root(jnp.where(small, 1, jnp.abs(z)))
    rising = z > 0
    return jnp.where(small, series, jnp.where(rising, jnp.sinh(jnp.where(rising, w, 1)), jnp.sin(w)) / w)
