"""The walk along the lower boundary of a polygon, piece by piece, whatever the polygon is made of.

A producer knows the first line and, standing on a line, where that line ends and which one follows; what ends a walk, and
how, is decided here.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxcap.numerics.guarded import ratio, select
from jaxcap.one_state.boundary import MAX_PIECES, Boundary, End, Pieces, piece_gain


class Affine(NamedTuple):
    """`intercept + slope * alpha`."""

    intercept: Float[Array, "*n"]
    """[m/s^2]"""
    slope: Float[Array, "*n"]
    """[1/s^2]"""


class Next(NamedTuple):
    """What comes after a line."""

    end: Float[Array, "*n"]
    """Where the line ends [m]; infinity where it goes on for ever."""
    leaves: Bool[Array, "*n"]
    """The polygon ends there."""
    line: Affine
    """The line that follows."""
    memory: Any
    """What the producer has to know about that line."""


class WalkState(NamedTuple):
    """Where the walk along the lower boundary stands."""

    alpha: Float[Array, "*n"]
    """Where the current piece begins [m]."""
    line: Affine
    """The current line."""
    energy: Float[Array, "*n"]
    """Gained so far [m^2/s^2]; only kept where some is `enough`."""
    running: Bool[Array, "*n"]
    """Lanes that have not come to an end."""
    memory: Any
    """What the producer knows about the current line."""
    found: Boundary
    """The pieces so far."""
    marks: Any
    """What the producer left for each piece."""


def walk(
    follow: Callable[[Array, Affine, Any], Next],
    first: Affine,
    memory: Any,
    floorless: Bool[Array, "*n"],
    wall: Float[Array, "*n"],
    limit: Float[Array, "*n"],
    rising: Bool[Array, ""],
    most: int | None = None,
    enough: Float[Array, "*n"] | None = None,
    mark: Callable[[Any], Any] = lambda memory: (),
) -> tuple[Boundary, Any]:
    """The boundary from alpha = 0 on, to where it turns non-negative while rising (C1; not with `rising`), to the polygon's
    right end (C2), or a little beyond `limit` or where it has taken the energy `enough`; `most` pieces at most (MAX_PIECES).
    Lanes whose limit is not positive are not walked.

    follow(alpha, line, memory) -> Next. floorless: lanes without a lower boundary, where the polygon ends at `wall`.
    Returns the boundary, and mark(memory) for every piece, stacked.
    """
    most = MAX_PIECES if most is None else most
    # Forces without limit, but no way to go: a robot that moves has left the polygon already.
    endless = floorless & (wall > 0)
    nothing = jnp.zeros((most, *limit.shape), limit.dtype)
    found = Boundary(
        pieces=Pieces(nothing, nothing, nothing, nothing),
        used=jnp.zeros((), jnp.int32),
        end=jnp.where(floorless, jnp.maximum(wall, 0), jnp.inf),
        ending=jnp.where(endless, End.FLOORLESS, jnp.where(floorless, End.POLYGON, End.LIMIT)).astype(jnp.int8),
    )
    start = WalkState(
        alpha=jnp.zeros_like(limit),
        line=jax.tree.map(lambda field: jnp.where(floorless, 0, field), first),
        energy=jnp.zeros_like(limit),
        running=(limit > 0) & ~floorless,
        memory=memory,
        found=found,
        marks=jax.tree.map(lambda field: jnp.zeros((most, *field.shape), field.dtype), mark(memory)),
    )
    last = jax.lax.while_loop(
        lambda state: jnp.any(state.running) & (state.found.used < most),
        lambda state: _next_piece(follow, limit, enough, rising, mark, state),
        start,
    )
    ending = jnp.where(last.running, End.MAX_PIECES, last.found.ending)
    return last.found._replace(ending=ending.astype(jnp.int8)), last.marks


def _next_piece(
    follow: Callable, limit: Array, enough: Array | None, rising: Array, mark: Callable, state: WalkState
) -> WalkState:
    """Record the current line; go on along the one that follows, or stop."""
    alpha, line, energy, running, memory, found, marks = state
    intercept, slope = line
    following = follow(alpha, line, memory)
    end = jnp.maximum(alpha, following.end)

    # Where the line rises through zero; a line that is nowhere negative ends the walk at once.
    zero = jnp.where(slope > 0, -ratio(intercept, slope), jnp.where((slope == 0) & (intercept >= 0), alpha, jnp.inf))
    zero = jnp.maximum(zero, alpha)
    diverges = running & (zero <= end) & (zero < jnp.inf) & ~rising
    never = running & ~diverges & (end == jnp.inf)
    leaves = running & ~diverges & ~never & following.leaves
    wanted = end < limit
    if enough is not None:
        energy += piece_gain(Pieces(alpha, end, *line), alpha, end)
        wanted &= energy > -enough
    goes_on = running & wanted & ~(diverges | never | leaves)
    ending = select([diverges, never, leaves], [End.DIVERGES, End.NEVER, End.POLYGON], found.ending)
    # The last line goes on without end, so that what lies beyond its end is still well defined.
    piece = Pieces(left=alpha, right=jnp.where(goes_on, end, jnp.inf), intercept=intercept, slope=slope)
    put = lambda fields, value: jax.lax.dynamic_update_index_in_dim(fields, jnp.where(running, value, 0), found.used, 0)
    choose = lambda new, old: jnp.where(goes_on, new, old)
    return WalkState(
        alpha=choose(end, alpha),
        line=jax.tree.map(choose, following.line, line),
        energy=energy,
        running=goes_on,
        memory=jax.tree.map(choose, following.memory, memory),
        found=Boundary(
            pieces=jax.tree.map(put, found.pieces, piece),
            used=found.used + 1,
            end=jnp.where(diverges, zero, jnp.where(leaves, end, found.end)),
            ending=ending.astype(jnp.int8),
        ),
        marks=jax.tree.map(put, marks, mark(memory)),
    )


def moved(found: Boundary, lines: Affine, wall: Float[Array, "*n"]) -> Boundary:
    """The tangent of a boundary whose lines move: exact, since pieces join where they meet, so that to move a knot changes
    no integral to first order. What is not differentiable has the tangent None or zero.

    lines: tangents of every piece's line. wall: how the right end moves where the polygon ends there.
    """
    # The end: the last line's zero; or, where that line is nowhere negative, the knot where it begins; or the wall.
    pieces = found.pieces
    final = jnp.isinf(pieces.right)
    before = jnp.roll(final, -1, axis=0).at[-1].set(False)
    end = jnp.where(jnp.isfinite(found.end), found.end, 0)
    pick = lambda which, values: jnp.sum(jnp.where(which, values, 0), axis=0)
    slope = pick(final, pieces.slope)
    rise = pick(final, lines.intercept + lines.slope * end)
    steeper = jnp.where(before.any(axis=0), slope - pick(before, pieces.slope), 0)
    at_knot = ratio(pick(before, lines.intercept + lines.slope * end) - rise, steeper)
    at_zero = jnp.where(pick(final, pieces.left) < end, -ratio(rise, slope), at_knot)
    ends = jnp.where(found.ending == End.DIVERGES, at_zero, jnp.where(found.ending == End.POLYGON, wall, 0))
    zero = jnp.zeros_like(pieces.left)
    of_integers: Any = lambda x: np.zeros(x.shape, jax.dtypes.float0)  # the tangent that JAX wants for them
    return Boundary(Pieces(zero, zero, *lines), of_integers(found.used), ends, of_integers(found.ending))
