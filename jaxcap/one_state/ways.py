"""The boundaries that only some states need: up ahead to the static region, out beyond it, and back into it.

They are walked one after the other in one loop: each copy of a walk by rays takes seconds to compile.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxcap.one_state.boundary import Boundary
from jaxcap.one_state.polygon import Producer, Survey


class Ways(NamedTuple):
    """Each in the lanes that need it; zeros in all lanes where none does."""

    upper: Boundary
    """Minus the largest acceleration, to s_min."""
    outwards: Boundary
    """The same from s_max on, to the polygon's end."""
    back: Boundary
    """The smallest acceleration from s_max back, to where it has taken the energy that the way from the end of `outwards` to
    s_max gains at least."""


def ways(polygon: Producer, survey: Survey, ahead: Bool[Array, "*n"], beyond: Bool[Array, "*n"], lower: Boundary) -> Ways:
    """The boundaries of a polygon that knows its survey.

    Args:
        polygon: the polygon.
        survey: of it.
        ahead: lanes that need the way up to s_min.
        beyond: lanes that need those out from s_max and back.
        lower: its lower boundary, whose shape theirs is.
    """
    nothing = jnp.zeros_like(survey.s_max)
    base, endless = jnp.where(beyond, survey.s_max, 0), jnp.where(beyond, jnp.inf, 0)
    starts = jnp.stack([nothing, base, base])
    limits = jnp.stack([jnp.where(ahead, survey.s_min, 0), endless, endless])
    headings, outwards, back = jnp.array([1, 1, -1], nothing.dtype), jnp.arange(3) == 1, jnp.arange(3) == 2

    def walked(start: Array, heading: Array, limit: Array, rising: Array, enough: Array) -> tuple[Boundary, Array]:
        found = polygon.seen(start, heading, -1).boundary(limit, rising, enough=enough)
        return found, jnp.where(jnp.isfinite(found.end), found.gain(found.end), jnp.inf)

    def one(gained: Array, way: tuple) -> tuple[Array, Boundary]:
        start, heading, limit, rising, last = way
        skip = lambda *_: (jax.tree.map(jnp.zeros_like, lower), nothing)
        enough = jnp.where(last, gained, jnp.inf)
        found, gained = jax.lax.cond(jnp.any(limit > 0), walked, skip, start, heading, limit, rising, enough)
        return gained, found

    found = jax.lax.scan(one, nothing, (starts, headings, limits, outwards, back))[1]
    return Ways(*(jax.tree.map(lambda field, k=k: field[k], found) for k in range(3)))
