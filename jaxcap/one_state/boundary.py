"""The lower boundary of the (alpha, acceleration) polygon, and what a CoM that follows it does: the walk, in energy.

With e = alphadot^2/2 in place of time, de/dalpha = acceleration. On a piece `intercept + slope alpha` the energy is a
quadratic of alpha, and every question about the motion needs polynomials and one square root.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Int8

from jaxcap.numerics.guarded import atanh_ratio, ratio, root
from jaxcap.numerics.loops import bounded_loop

MAX_PIECES = 64
"""Most pieces of a boundary that are walked. Mean and largest number seen: 2 and 12 for two rectangles with 4 sides, 3 and
22 for four; 5 and 40 with 16 sides."""

FROM_REST_TO_REST = 1e9
"""Stands for an infinite tau [s], where a swing takes half a period on one piece."""


class End(IntEnum):
    """How a boundary ends."""

    LIMIT = 0
    """Where the caller wanted."""
    DIVERGES = 1
    """The acceleration turns non-negative while rising (C1)."""
    POLYGON = 2
    """The right end of the polygon (C2)."""
    NEVER = 3
    """It goes on for ever."""
    FLOORLESS = 4
    """There is none: the acceleration is unbounded below, up to the polygon's right end."""
    MAX_PIECES = 5
    """More pieces than are walked."""


class Pieces(NamedTuple):
    """`intercept + slope * alpha` for alpha from left to right, piece by piece; unused pieces are all zeros.

    The last piece has an infinite right end, wherever the boundary ends.
    """

    left: Float[Array, "k *n"]
    right: Float[Array, "k *n"]
    intercept: Float[Array, "k *n"]
    slope: Float[Array, "k *n"]


class Boundary(NamedTuple):
    """A piecewise linear acceleration over alpha, from alpha = 0 on; convex, as long as it is not negated.

    Its questions are asked many times in one program, and each, `jax.jit` sees to it, is traced once.
    """

    pieces: Pieces
    used: Int[Array, ""]
    """Number of pieces in use in any lane."""
    end: Float[Array, "*n"]
    """Where the boundary ends [m]: the zero of the acceleration, the polygon's end, or infinity."""
    ending: Int8[Array, "*n"]
    """An `End`."""

    def negated(self) -> "Boundary":
        """Minus this acceleration: a concave one."""
        lines = self.pieces._replace(intercept=-self.pieces.intercept, slope=-self.pieces.slope)
        return self._replace(pieces=lines)

    @jax.jit
    def at(self, alpha: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The acceleration at a finite alpha >= 0 [m/s^2]."""

        def add(piece, alpha, total):
            here = (piece.left <= alpha) & (alpha < piece.right)
            return total + jnp.where(here, piece.intercept + piece.slope * alpha, 0)

        return self.over_pieces(add, alpha, jnp.zeros_like(alpha))

    @jax.jit
    def gain(self, alpha: Float[Array, "*jn"]) -> Float[Array, "*jn"]:
        """Energy gained from 0 to alpha >= 0, the integral of the acceleration [m^2/s^2]; zero for an infinite alpha.

        Several alphas for each lane may be stacked in front of the lanes.
        """
        alpha = jnp.where(jnp.isfinite(alpha), alpha, 0)

        def add(piece, alpha, total):
            return total + piece_gain(piece, jnp.minimum(piece.left, alpha), jnp.minimum(piece.right, alpha))

        return self.over_pieces(add, alpha, jnp.zeros_like(alpha))

    @jax.jit
    def ride(self, energy: Float[Array, "*n"]) -> "Ride":
        """The motion of a CoM that starts at 0 with this energy, to where it first comes to rest.

        Meaningless where it never does.
        """
        zero = jnp.zeros_like(energy)
        return self.over_pieces(_ride_piece, None, Ride(energy, zero, zero, jnp.ones_like(zero)))

    @jax.jit
    def duration(self, start: Array, stop: Array, energy: Array, energy_at_stop: Array) -> Float[Array, "*n"]:
        """Time from alpha = start to a finite stop [s] for a CoM that has these energies there.

        The second follows from the first but for rounding, which would show in a CoM that comes to rest.
        """

        def add(piece, ends, state):
            start, stop, energy_at_stop = ends
            energy, time = state
            left, right = jnp.clip(piece.left, start, stop), jnp.clip(piece.right, start, stop)
            after = jnp.where(right < stop, energy + piece_gain(piece, left, right), energy_at_stop)
            return after, time + stretch_time(right - left, energy, after, piece.slope)

        return self.over_pieces(add, (start, stop, energy_at_stop), (energy, jnp.zeros_like(energy)))[1]

    def over_pieces(self, step: Callable, values: Any, start: Any) -> Any:
        """Fold `step(piece, values, state)` over the pieces."""
        at = lambda k, field: jax.lax.dynamic_index_in_dim(field, k, keepdims=False)
        one = lambda k, arguments, state: step(Pieces(*(at(k, field) for field in arguments[0])), arguments[1], state)
        return bounded_loop(one, len(self.pieces.left), self.used, (self.pieces, values), start)


class Ride(NamedTuple):
    """Where a CoM stands on its way along the boundary."""

    energy: Float[Array, "*n"]
    """alphadot^2/2 at the end of the last piece [m^2/s^2]; zero once at rest."""
    alpha: Float[Array, "*n"]
    """Where it came to rest [m]."""
    time: Float[Array, "*n"]
    """Since the start [s]."""
    moving: Float[Array, "*n"]
    """1 until it has come to rest, then 0."""


def _ride_piece(piece: Pieces, _: None, ride: Ride) -> Ride:
    moving = (ride.moving > 0) & (piece.right > piece.left)
    last = jnp.isinf(piece.right)
    right = jnp.where(last, piece.left, piece.right)
    after = ride.energy + piece_gain(piece, piece.left, right)
    rests = last | (after <= 0)
    travelled = rest_within(ride.energy, piece.intercept + piece.slope * piece.left, piece.slope)
    travelled = jnp.where(rests, travelled, right - piece.left)
    after = jnp.where(rests, 0, after)
    time = stretch_time(travelled, ride.energy, after, piece.slope)
    return Ride(
        energy=jnp.where(moving, after, ride.energy),
        alpha=jnp.where(moving & rests, piece.left + travelled, ride.alpha),
        time=ride.time + jnp.where(moving, time, 0),
        moving=jnp.where(moving & rests, 0, ride.moving),
    )


def piece_gain(piece: Pieces, left: Array, right: Array) -> Array:
    """Energy gained from left to right, both on the piece."""
    return (right - left) * (piece.intercept + piece.slope * (left + right) / 2)


def rest_within(energy: Array, acceleration: Array, slope: Array) -> Array:
    """Distance in which a CoM with this energy comes to rest under an acceleration that changes with this slope: the
    smaller root of energy + acceleration d + slope d^2/2, in the form without cancellation.
    """
    discriminant = root(acceleration**2 - 2 * slope * energy)
    return jnp.where(
        acceleration > 0, ratio(acceleration + discriminant, -slope), ratio(2 * energy, discriminant - acceleration)
    )


def stretch_time(travelled: Array, before: Array, after: Array, slope: Array) -> Array:
    """Time over a stretch of one piece, from the energies at its ends [s]; one real formula in place of (19)-(24):
    with tau = 2 dx/(v0 + v1) and z = slope tau^2/4, t = tau atanh(sqrt z)/sqrt z.
    """
    tau = ratio(2 * travelled, root(2 * before) + root(2 * after), otherwise=FROM_REST_TO_REST)
    tau = jnp.where(travelled > 0, tau, 0)
    return tau * atanh_ratio(slope * tau * tau / 4)
