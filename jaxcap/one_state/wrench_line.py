"""The line of travel of one state, as wrenches: what both forms of the cone are cut with.

Every array carries its lanes last: a single state has none, a chunk of a batch has one axis of them. The state index is
then the vectorised axis, whatever a producer does with rows or rays.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxcap.contacts.conventions import ArrayLike


class WrenchLine(NamedTuple):
    """The centroidal wrench per unit mass of a CoM on its line, force over torque about the contacts' centroid, (10) in (3):

    w = per_acceleration * acceleration + per_alpha * alpha - at_rest.

    alpha is the distance along the line from the start [m], acceleration is along the line [m/s^2]. The mass cancels.
    """

    per_acceleration: Float[Array, "6 *n"]
    """(v, c x v), with m v for the m I3 printed in (11)."""
    per_alpha: Float[Array, "6 *n"]
    """(0, g x v)"""
    at_rest: Float[Array, "6 *n"]
    """(g, c x g)"""
    weight: Float[Array, "*n"]
    """|g| [m/s^2]."""
    length: Float[Array, "*#n"]
    """Size of the stance [m]."""
    remoteness: Float[Array, "*n"]
    """1 + distance of the CoM from the contacts' centroid over the size of the stance: the scale of rounding errors."""


def wrench_line(
    origin: ArrayLike, length: ArrayLike, com: Float[Array, "3 *n"], along: Float[Array, "3 *n"], gravity: ArrayLike
) -> WrenchLine:
    """The wrenches of a CoM on the line com + alpha * along.

    origin: (3,) centroid of the contacts [m], length: their size [m]. com: [m]. along: unit vectors, or zero. gravity: (3,)
    [m/s^2].
    """
    column = lambda vector: jnp.asarray(vector, com.dtype).reshape(3, *jnp.shape(vector)[1:] or [1] * (com.ndim - 1))
    length = jnp.asarray(length, com.dtype)
    arm = com - column(origin)
    gravity = jnp.broadcast_to(column(gravity), com.shape)
    distance = jnp.sqrt(jax.lax.stop_gradient(jnp.sum(arm * arm, axis=0)))
    return WrenchLine(
        per_acceleration=jnp.concatenate([along, _cross(arm, along)]),
        per_alpha=jnp.concatenate([jnp.zeros_like(along), _cross(gravity, along)]),
        at_rest=jnp.concatenate([gravity, _cross(arm, gravity)]),
        weight=jnp.sqrt(jax.lax.stop_gradient(jnp.sum(gravity * gravity, axis=0))),
        length=length,
        remoteness=1 + distance / length,
    )


def _cross(a, b):
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
