"""What the producers by rays read off a basis: the line of its face, and the first column that it meets as it turns."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxcap.numerics.guarded import snapped, tolerances
from jaxcap.numerics.simplex_basis import first_of
from jaxcap.one_state.walk import Affine
from jaxcap.one_state.wrench_line import WrenchLine


class Carrying(NamedTuple):
    """What the columns of a basis carry: for acceleration, for alpha, and at alpha = 0 at the acceleration `fall`."""

    per_acceleration: Float[Array, "m *n"]
    per_alpha: Float[Array, "m *n"]
    falling: Float[Array, "m *n"]
    """The wrench itself, not a target: a deceleration that a target has only because it was moved into the cone would stop
    the robot in the end, however far away. What is left of such a one is rounding error."""
    fall: Float[Array, "*n"]
    """[m/s^2]"""


def line_of(normal: Float[Array, "m *n"], carrying: Carrying, line: WrenchLine) -> Affine:
    """The acceleration over alpha on the face with this normal, whose product with the free column is 1."""
    along = lambda vector: jnp.sum(normal * vector, axis=0)
    own = -along(carrying.per_acceleration)  # 1, but for what the free column was moved by
    share = jnp.where(own > 0.5, 1 / jnp.where(own > 0.5, own, 1), 1)
    beyond, slope = share * along(carrying.falling), share * along(carrying.per_alpha)
    slack = line.slack * jnp.max(jnp.abs(normal), axis=0)
    steepest = line.weight / line.length
    return Affine(snapped(beyond + carrying.fall, slack * line.size_beyond(beyond)), snapped(slope, slack * steepest))


def first_met(
    outside: Float[Array, "k *n"], entry: Float[Array, "k *n"], normal: Float[Array, "m *n"], row: Float[Array, "m *n"]
) -> tuple[Int[Array, "*n"], Bool[Array, "*n"]]:
    """Of k columns the one that a face meets first as it turns about those that stay, and whether it meets none.

    Args:
        outside: products of the columns with the normal, at most zero but for rounding.
        entry: with minus the row of the inverse that belongs to the column that leaves.
        normal: of the face.
        row: that row.
    """
    bounds = tolerances(entry.dtype)
    takes = entry > bounds.pivot * jnp.max(jnp.abs(row), axis=0)
    # A little is added to each: of several on the same face, that with the largest pivot takes over.
    near = bounds.reduced_cost * jnp.max(jnp.abs(normal), axis=0)
    inside = jnp.maximum(-outside, 0)
    turn = jax.lax.optimization_barrier(jnp.where(takes, -(inside + near) / jnp.where(takes, entry, 1), -jnp.inf))
    first = jnp.max(turn, axis=0)
    return first_of(turn, first), first == -jnp.inf


def one_place(s_min: Float[Array, "*n"], s_max: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
    """Ends that meet, but for rounding, are one place."""
    crossed, middle = s_min > s_max, jnp.where(s_min > s_max, (s_min + s_max) / 2, 0)
    return jnp.where(crossed, middle, s_min), jnp.where(crossed, middle, s_max)
