"""Where a CoM that follows a boundary is after a given time: each piece in closed form, its time inverted.

On a piece the motion obeys x'' = a + gamma x, with x counted from where the CoM stands on it and a the acceleration there.
With w^2 = gamma, S(t) = sinh(w t)/w and C(t) = (cosh(w t) - 1)/w^2 = (t sinh(w t/2)/(w t/2))^2/2, and sines for gamma < 0,

    x(t) = v S + a C,   x'(t) = v (1 + gamma C) + a S,

one real formula for all signs of gamma, none of whose terms cancels. Which piece that is, the times over whole pieces say.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxcap.numerics.guarded import root, sinh_ratio
from jaxcap.one_state.boundary import Boundary, Pieces, rest_within, stretch_time


class TimedRide(NamedTuple):
    """Where a CoM stands on its way along a boundary, and how long it still has."""

    alpha: Float[Array, "*n"]
    """[m]"""
    speed: Float[Array, "*n"]
    """[m/s], >= 0."""
    time_left: Float[Array, "*n"]
    """[s]; zero once it is used up."""
    rested: Float[Array, "*n"]
    """1 once it has come to rest, where it stays."""


class _Course(NamedTuple):
    """What is left of one piece, and how it is passed."""

    length: Float[Array, "*n"]
    """To its right end, or to where the CoM comes to rest on it [m]; infinite where there is neither."""
    rests: Bool[Array, "*n"]
    time: Float[Array, "*n"]
    """[s]"""
    speed: Float[Array, "*n"]
    """At its end [m/s]."""


def ride_on(boundary: Boundary, until: Float[Array, "*n"], ride: TimedRide) -> TimedRide:
    """The ride as it goes on along the boundary, no further than `until` [m]: to where its time is up, or it comes to rest.

    Time is left at the end where it came to rest, or to `until`, or where the pieces end.
    """
    return boundary.over_pieces(_along_piece, until, ride)


def _along_piece(piece: Pieces, until: Array, ride: TimedRide) -> TimedRide:
    alpha, speed, time_left, rested = ride
    right = jnp.minimum(piece.right, until)
    here = (piece.left <= alpha) & (alpha < right) & (time_left > 0) & (rested == 0)
    acceleration = piece.intercept + piece.slope * alpha
    course = _course(speed, acceleration, piece.slope, jnp.where(here, right - alpha, 0))
    within = time_left < course.time
    time = jnp.where(within, time_left, 0)
    swept, travelled = time * sinh_ratio(piece.slope * time * time), time * sinh_ratio(piece.slope * time * time / 4)
    travelled = travelled * travelled / 2  # S, and C
    on_the_way = jnp.clip(speed * swept + acceleration * travelled, 0, course.length)
    at_end = jnp.where(course.rests, alpha + course.length, right)
    then = jnp.maximum(speed * (1 + piece.slope * travelled) + acceleration * swept, 0)
    choose = lambda new, old: jnp.where(here, new, old)
    return TimedRide(
        alpha=choose(jnp.where(within, alpha + on_the_way, at_end), alpha),
        speed=choose(jnp.where(within, then, course.speed), speed),
        time_left=choose(jnp.where(within, 0, time_left - jnp.where(within, 0, course.time)), time_left),
        rested=choose(jnp.where(~within & course.rests, 1, 0), rested),
    )


def _course(speed: Array, acceleration: Array, slope: Array, length: Array) -> _Course:
    """How a CoM with this speed passes a piece: acceleration where it stands, length to the right end."""
    energy = speed * speed / 2
    # Where the slope is positive, speed may only dip: the CoM rests if its energy does reach zero.
    stops = (slope < 0) | (acceleration < 0) & (acceleration**2 >= 2 * slope * energy)
    rest = rest_within(energy, acceleration, slope)
    rests = stops & (rest <= length)
    length = jnp.where(rests, rest, length)
    ends = jnp.isfinite(length)
    finite = jnp.where(ends, length, 0)
    after = jnp.where(rests, 0, energy + finite * (acceleration + slope * finite / 2))
    time = stretch_time(finite, energy, after, slope)
    # A CoM already at rest that is not pushed on never leaves.
    return _Course(length, rests, jnp.where(ends, time, jnp.inf), root(2 * after))
