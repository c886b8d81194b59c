"""The line of travel of one state, as wrenches: what both forms of the cone are cut with.

Every array carries its lanes last: a single state has none, a chunk of a batch has one axis of them. The state index is
then the vectorised axis, whatever a producer does with rows or rays.

What rounding and slack may do. A wrench of the line is (f, c x f), f = acceleration * v - g being the force at the CoM c. So
a face of the cone asks for n . f <= 0 there, with a vector n that is rounded once, and a rounding error is the same as a CoM
moved a little, however small f is: near free fall f vanishes, and gravity is no measure of it. Therefore f is split in two,

    f = beyond * v - across,   beyond = acceleration - fall,   fall = g . v,   across = g - fall * v,

computed without cancellation, and all slack is relative to |beyond| + |across|.

Angular momentum. The robot's own, about the CoM, comes to rest in proportion to the CoM's speed: per unit mass it is
L / m = spin * alphadot, with the state's spin = L / (m |cdot|), so its rate is spin * acceleration: one vector beside c x v,
and the polygon stays a polygon. So it is zero where the CoM comes to rest, and where the CoM swings back it has turned too:
the ratio of L to the momentum m alphadot v is the same all along the line, whence the spin along -v is -spin, as c x v turns
to c x -v. What is said above of the force is then said of the wrench: `fall` is the acceleration at which it is smallest,
g . v / (1 + |spin|^2 / length^2).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxcap.contacts.conventions import ArrayLike
from jaxcap.numerics.guarded import snapped, tolerances

POSITION = 4
"""Rounding errors in a position, at most."""


class WrenchLine(NamedTuple):
    """The centroidal wrench per unit mass of a CoM on its line, force over torque about the contacts' centroid, (10) in (3):

    w = per_acceleration * acceleration + per_alpha * alpha - at_rest
      = per_acceleration * (acceleration - fall) + per_alpha * alpha - across.

    alpha is the distance along the line from the start [m], acceleration is along the line [m/s^2]. The mass cancels.
    """

    per_acceleration: Float[Array, "6 *n"]
    """(v, c x v + spin), with m v for the m I3 printed in (11)."""
    per_alpha: Float[Array, "6 *n"]
    """(0, g x v)"""
    at_rest: Float[Array, "6 *n"]
    """(g, c x g)"""
    across: Float[Array, "6 *n"]
    """What is left of it at the acceleration `fall`, (g, c x g) - per_acceleration * fall: without spin the part of g that
    is across the line, zero where the line is vertical."""
    fall: Float[Array, "*n"]
    """Acceleration along the line that asks least of the contacts: without spin that of free fall, g . v [m/s^2]."""
    weight: Float[Array, "*n"]
    """|g| [m/s^2]."""
    sideways: Float[Array, "*n"]
    """Size of the wrench at `fall`: without spin that of the part of g across the line [m/s^2]."""
    length: Float[Array, "*#n"]
    """Size of the stance [m]."""
    remoteness: Float[Array, "*n"]
    """1 + distance of the CoM from the contacts' centroid over the size of the stance: the scale of rounding errors."""
    slack: Float[Array, "*n"]
    """`Tolerances.slack` for this state: of the stance or of the CoM's distance from it, and never less than what the
    positions themselves may be rounded by, which is more where they are far from the world's origin [-]."""
    lever: Float[Array, "*n"] | None = None
    """|spin| over the size of the stance: how much torque an acceleration takes beside its force [-]; None without spin."""

    @property
    def largest(self) -> Float[Array, "*n"]:
        """The largest that a coefficient of the acceleration can be [-]."""
        return self.remoteness if self.lever is None else self.remoteness + self.lever

    @property
    def slack_of_acceleration(self) -> Float[Array, "*n"]:
        """`slack` of what the acceleration is multiplied by."""
        return self.slack if self.lever is None else self.slack * (1 + self.lever)

    def size_beyond(self, beyond: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Size of the wrench at the acceleration fall + beyond [m/s^2]."""
        beyond = jnp.abs(beyond)
        return (beyond if self.lever is None else beyond * (1 + self.lever)) + self.sideways

    def slack_at(self, beyond: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """By how much a face may be missed at the acceleration fall + beyond [m/s^2]: relative to the wrench there."""
        return self.slack * self.size_beyond(beyond)


def wrench_line(
    origin: ArrayLike,
    length: ArrayLike,
    com: Float[Array, "3 *n"],
    along: Float[Array, "3 *n"],
    gravity: ArrayLike,
    spin: Float[Array, "3 *n"] | None = None,
) -> WrenchLine:
    """The wrenches of a CoM on the line com + alpha * along.

    Args:
        origin: (3,) centroid of the contacts [m].
        length: their size [m].
        com: (3, *n) [m].
        along: (3, *n) unit vectors, or zero.
        gravity: (3,) [m/s^2].
        spin: (3, *n) angular momentum about the CoM over mass and speed [m]; None for zero, to the bit and at no cost.

    A line within the angle `slack` of gravity counts as vertical.
    """
    column = lambda vector: jnp.asarray(vector, com.dtype).reshape(3, *jnp.shape(vector)[1:] or [1] * (com.ndim - 1))
    length = jnp.asarray(length, com.dtype)
    arm = com - column(origin)
    gravity = jnp.broadcast_to(column(gravity), com.shape)
    size = lambda vector: jnp.sqrt(jax.lax.stop_gradient(jnp.sum(vector * vector, axis=0)))
    weight, turning = size(gravity), _cross(gravity, along)
    # Not g - fall v, which would cancel. Without a direction, all of gravity is across it.
    across = jnp.where(jnp.any(along != 0, axis=0), _cross(along, turning), gravity)
    bounds, remoteness = tolerances(com.dtype), 1 + size(arm) / length
    rounded = POSITION * float(jnp.finfo(com.dtype).eps) * (size(com) + size(column(origin))) / length
    noise = jnp.where(size(across) > bounds.slack * weight, 0, jnp.inf)
    across, turning = snapped(across, noise), snapped(turning, noise)
    line = WrenchLine(
        per_acceleration=jnp.concatenate([along, _cross(arm, along)]),
        per_alpha=jnp.concatenate([jnp.zeros_like(along), turning]),
        at_rest=jnp.concatenate([gravity, _cross(arm, gravity)]),
        across=jnp.concatenate([across, _cross(arm, across)]),
        fall=jnp.sum(gravity * along, axis=0),
        weight=weight,
        sideways=size(across),
        length=length,
        remoteness=remoteness,
        slack=bounds.slack * remoteness + rounded,
    )
    return line if spin is None else _spinning(line, spin)


def _spinning(line: WrenchLine, spin: Float[Array, "3 *n"]) -> WrenchLine:
    """The same with angular momentum.

    Where the spin is long, little acceleration is left, and to count it from free fall would lose it in the difference: so
    it is counted from where the wrench is smallest.
    """
    lever = jnp.sqrt(jax.lax.stop_gradient(jnp.sum(spin * spin, axis=0))) / line.length
    fall = line.fall / (1 + lever**2)
    turning = jnp.concatenate([jnp.zeros_like(spin), spin])
    # at_rest - per_acceleration * fall, without the difference where there is little spin
    across = line.across + (line.fall - fall) * line.per_acceleration - fall * turning
    force = jnp.sqrt(jax.lax.stop_gradient(jnp.sum(across[:3] ** 2, axis=0)))
    return line._replace(
        per_acceleration=line.per_acceleration + turning,
        across=across,
        fall=fall,
        sideways=force + jax.lax.stop_gradient(jnp.abs(fall)) * lever,
        lever=lever,
    )


def _cross(a: Float[Array, "3 *n"], b: Float[Array, "3 *n"]) -> Float[Array, "3 *n"]:
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
