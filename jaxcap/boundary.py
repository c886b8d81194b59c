"""The lower boundary of the (alpha, acceleration) polygon, and what a CoM that follows it does: the walk, in energy.

With e = alphadot^2/2 in place of time, de/dalpha = acceleration. On a piece `intercept + slope alpha` the energy is a
quadratic of alpha, and every question about the motion needs polynomials and one square root.
"""

from enum import IntEnum
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int8

from jaxcap.numerics import atanh_ratio, ratio, root


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
    """It goes on for ever and stays below zero."""
    FLOORLESS = 4
    """There is none: the acceleration is unbounded below, up to the polygon's right end."""
    MAX_PIECES = 5
    """More pieces than are walked."""


class Boundary(NamedTuple):
    """A piecewise linear acceleration over alpha, from alpha = 0 on; convex, as long as it is not negated.

    Piece k is `intercepts[k] + slopes[k] * alpha` for alpha from knots[k] to knots[k + 1]. The last piece has an infinite
    right knot, wherever the boundary ends; pieces after it are empty.
    """

    knots: Float[Array, "k+1 *n"]
    intercepts: Float[Array, "k *n"]
    slopes: Float[Array, "k *n"]
    end: Float[Array, "*n"]
    """Where the boundary ends [m]: the zero of the acceleration, the polygon's end, or infinity."""
    ending: Int8[Array, "*n"]
    """An `End`."""

    def at(self, alpha: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The acceleration at alpha >= 0 [m/s^2]."""
        here = (self.knots[:-1] <= alpha) & (alpha < self.knots[1:])
        return jnp.sum(jnp.where(here, self.intercepts + self.slopes * alpha, 0), axis=0)

    def negated(self) -> "Boundary":
        """Minus this acceleration: a concave one."""
        return self._replace(intercepts=-self.intercepts, slopes=-self.slopes)

    def gain(self, alpha: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Energy gained from 0 to alpha >= 0, the integral of the acceleration [m^2/s^2]; zero for an infinite alpha."""
        alpha = jnp.where(jnp.isfinite(alpha), alpha, 0)
        return jnp.sum(self._gains(*self._pieces(0, alpha)), axis=0)

    def stop(self, energy: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Where a CoM that starts at 0 with this energy comes to rest [m]; meaningless where it does not."""
        left, right = self.knots[:-1], jnp.where(jnp.isfinite(self.knots[1:]), self.knots[1:], self.knots[:-1])
        gains = self._gains(left, right)
        before = energy + jnp.cumsum(gains, axis=0) - gains
        passed = (before + gains > 0) & jnp.isfinite(self.knots[1:])
        first = ~passed & (jnp.cumsum(~passed, axis=0) == 1)
        at = left + _rest(before, self.intercepts + self.slopes * left, self.slopes)
        return jnp.sum(jnp.where(first, at, 0), axis=0)

    def duration(self, energy, start, stop, ends_at_rest) -> Float[Array, "*n"]:
        """Time from alpha = start to stop [s] for a CoM that has this energy at start.

        ends_at_rest: bool; there its energy is zero, whatever rounding makes of it. One formula serves all slopes: with
        tau = 2 dx/(v0 + v1) and z = slope tau^2/4, t = tau atanh(sqrt z)/sqrt z; it replaces (19)-(24).
        """
        left, right = self._pieces(start, stop)
        gains = self._gains(left, right)
        after = energy + jnp.cumsum(gains, axis=0)
        before = after - gains
        after = jnp.where(ends_at_rest & (right >= stop), 0, after)
        tau = ratio(2 * (right - left), root(2 * before) + root(2 * after), otherwise=FROM_REST_TO_REST)
        tau = jnp.where(right > left, tau, 0)
        return jnp.sum(tau * atanh_ratio(self.slopes * tau * tau / 4), axis=0)

    def _pieces(self, start, stop):
        """Left and right ends of the pieces, cut to [start, stop]; those outside are empty."""
        return jnp.clip(self.knots[:-1], start, stop), jnp.clip(self.knots[1:], start, stop)

    def _gains(self, left, right):
        """Energy gained on each piece."""
        return (right - left) * (self.intercepts + self.slopes * (left + right) / 2)


def _rest(energy, acceleration, slope):
    """Distance in which a CoM with this energy comes to rest under an acceleration that changes with this slope; the
    smaller root of energy + acceleration d + slope d^2/2, in the form without cancellation.
    """
    discriminant = root(acceleration**2 - 2 * slope * energy)
    return jnp.where(
        acceleration > 0, ratio(acceleration + discriminant, -slope), ratio(2 * energy, discriminant - acceleration)
    )
