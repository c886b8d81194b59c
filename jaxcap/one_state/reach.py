"""C3.2.1: maximum deceleration stops too early; decelerate less, reach the static region, and be at rest there."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxcap.numerics.guarded import ratio
from jaxcap.one_state.boundary import Boundary, End

MAX_STEPS = 64
"""Halving alone needs no more in double precision."""


def reach_time(
    lower: Boundary,
    upper: Boundary,
    s_min: Float[Array, "*n"],
    energy: Float[Array, "*n"],
    reaching: Bool[Array, "*n"],
) -> Float[Array, "*n"]:
    """Time to come to rest at s_min [s]; zero in lanes that are not `reaching`.

    Of the manoeuvres that end there it is the fastest, as (12) asks: least deceleration up to a switch, then maximum
    deceleration. lower: smallest acceleration. upper: minus the largest. energy: alphadot^2/2 at the start [m^2/s^2].
    """
    target = jnp.where(reaching, s_min, 0)
    skip = lambda *_: jnp.zeros_like(target)
    return jax.lax.cond(jnp.any(reaching), _reach_time, skip, lower, upper, target, energy)


def _reach_time(lower, upper, target, energy):
    switch = switch_of(lower, upper, target, energy)
    at_switch = energy - upper.gain(switch)
    none = jnp.zeros_like(target)
    return upper.negated().duration(none, switch, energy, at_switch) + lower.duration(switch, target, at_switch, none)


def switch_of(
    lower: Boundary, upper: Boundary, target: Float[Array, "*n"], energy: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """Where the manoeuvre of `reach_time` changes over [m]; at the target itself where nothing limits deceleration."""
    floorless = lower.ending == End.FLOORLESS
    return jnp.where(floorless, target, _switch(lower, upper, target, energy))


def _switch(lower: Boundary, upper: Boundary, target: Array, energy: Array) -> Array:
    """Where the way under the largest acceleration from the start meets the way under the smallest to rest at the target.

    The difference of their energies rises with alpha. Newton's method, halving the bracket where it would leave it; the
    last step is the one that is differentiated.
    """
    found = _bisected_newton(*jax.lax.stop_gradient((lower, upper, target, energy)))
    return jnp.clip(found - ratio(_excess(lower, upper, target, energy, found), _width(lower, upper, found)), 0, target)


def _excess(lower, upper, target, energy, alpha):
    return energy - upper.gain(alpha) - lower.gain(alpha) + lower.gain(target)


def _width(lower, upper, alpha):
    return jax.lax.stop_gradient(-upper.at(alpha) - lower.at(alpha))


def _bisected_newton(lower, upper, target, energy):
    """The zero of the excess in [0, target], to rounding."""
    close = 4 * jnp.finfo(target.dtype).eps

    def step(state):
        count, low, high, alpha, _ = state
        excess = _excess(lower, upper, target, energy, alpha)
        low, high = jnp.where(excess < 0, alpha, low), jnp.where(excess < 0, high, alpha)
        guess = alpha - ratio(excess, _width(lower, upper, alpha))
        guess = jnp.where((low <= guess) & (guess <= high), guess, (low + high) / 2)
        return count + 1, low, high, guess, jnp.abs(guess - alpha) > close * target

    start = jnp.int32(0), jnp.zeros_like(target), target, target / 2, target > 0
    return jax.lax.while_loop(lambda state: jnp.any(state[-1]) & (state[0] < MAX_STEPS), step, start)[3]
