"""Convex regions of the plane across gravity: a walk around one, edge by edge, and the signed distance of points to it.

Regions may be empty, a point, a segment, or unbounded. Coordinates are those along `across(gravity)`: x and y where gravity
points down. Arrays of the walk carry their lanes last.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxcap.contacts.conventions import ArrayLike
from jaxcap.numerics.guarded import ratio, root

AROUND = 2 * math.pi + 0.1
"""A walk ends when its normal has turned by this [rad]: a little more than once around, for the walk may begin inside an
edge that is made of several collinear ones, and rounding turns the normal too."""


def across(gravity: ArrayLike) -> Float[Array, "2 3"]:
    """Two unit vectors across gravity and each other, as rows: x and y where gravity points down.

    Args:
        gravity: (3,) [m/s^2], any but zero.

    Returns:
        (2, 3); right-handed together with the direction against gravity.

    Source: Duff et al., Building an Orthonormal Basis, Revisited, JCGT 2017.
    """
    x, y, z = upward(gravity)
    # The sign keeps sign + z away from zero, whichever way gravity points.
    sign = jnp.where(z < 0, -1, 1).astype(z.dtype)
    a = -1 / (sign + z)
    return jnp.array([[1 + sign * x * x * a, sign * x * y * a, -sign * x], [x * y * a, sign + y * y * a, -y]])


def upward(gravity: ArrayLike) -> Float[Array, "3"]:
    """Unit vector against gravity."""
    gravity = jnp.asarray(gravity)
    return -gravity / jnp.sqrt(jnp.sum(gravity * gravity))


def rotated(vector: Float[Array, "2 *n"]) -> Float[Array, "2 *n"]:
    """Turned by a right angle, counterclockwise."""
    return jnp.stack([-vector[1], vector[0]])


def column(vectors: Float[Array, "2 k *n"], index: Int[Array, "*n"]) -> Float[Array, "2 *n"]:
    """One of the vectors for each lane; the last for an index beyond."""
    return jnp.take_along_axis(vectors, jnp.minimum(index, vectors.shape[1] - 1)[None, None], axis=1)[:, 0]


class Nearest(NamedTuple):
    """What the signed distance of points to a region depends on: the edge that is nearest in each of two senses."""

    normal: Float[Array, "2 m *n"]
    """Outwards, of the edge whose half-plane a point has the least room to leave, or has left the farthest ..."""
    offset: Float[Array, "m *n"]
    """... which holds all q with normal . q <= offset."""
    foot: Float[Array, "2 m *n"]
    """The point of the boundary that is nearest."""

    def distance(self, points: Float[Array, "2 m *n"]) -> Float[Array, "m *n"]:
        """Positive inside, minus the Euclidean distance outside; exact derivatives with respect to the points.

        Inside, the room that is left is also the distance to the boundary. Where it is less, as on the straight
        continuation of a segment, it is rounding error.
        """
        nearest = jax.lax.stop_gradient(self)
        room = nearest.offset - jnp.sum(nearest.normal * points, axis=0)
        apart = points - nearest.foot
        away = root(jnp.sum(apart * apart, axis=0))
        return jnp.where(2 * room > away, room, -away)


class Edge(NamedTuple):
    """What a region's producer knows about the edge that begins at a vertex."""

    along: Float[Array, "2 *n"]
    """Unit vector, counterclockwise around the region."""
    end: Float[Array, "2 *n"]
    """The next vertex."""
    exists: Bool[Array, "*n"]
    """False where the region is a single point."""
    counts: Bool[Array, "*n"]
    """False for an edge that only stands for infinity."""
    sound: Bool[Array, "*n"]
    """False where the producer is lost."""
    memory: Any
    """What the producer has to know about the next vertex."""


Follow = Callable[[Float[Array, "2 *n"], Float[Array, "2 *n"], Any], Edge]
"""(normal, vertex, memory) -> the edge that begins at the vertex."""


class Around(NamedTuple):
    """Where a walk around a region stands."""

    normal: Float[Array, "2 *n"]
    """A direction in which no point of the region lies farther out than the current vertex."""
    vertex: Float[Array, "2 *n"]
    turned: Float[Array, "*n"]
    """By how much the normal has turned since the start [rad]."""
    running: Bool[Array, "*n"]
    """Lanes that have not come round."""
    sound: Bool[Array, "*n"]
    """False where the producer was lost."""
    nearest: Nearest
    edges: Int[Array, ""]
    """Walked so far."""
    memory: Any


def walk_around(
    follow: Follow,
    vertex: Float[Array, "2 *n"],
    memory: Any,
    points: Float[Array, "2 m *n"],
    active: Bool[Array, "*n"],
    most: int,
) -> tuple[Nearest, Bool[Array, "*n"]]:
    """The edges that are nearest to these points, found by walking around the region once.

    Args:
        follow: (normal, vertex, memory) -> the edge that begins at the vertex.
        vertex: one that lies farthest along the first axis.
        memory: what `follow` has to know about that vertex.
        points: for which the nearest edges are sought.
        active: lanes that have a vertex.
        most: largest number of edges.

    Returns:
        The nearest edges (of a region without edges that count, `Nearest.distance` is infinite), and the lanes in which they
        are to be trusted: all of the way around was walked.
    """
    east = jnp.zeros_like(vertex).at[0].set(1)
    no_edge = Nearest(jnp.zeros_like(points), jnp.full(points.shape[1:], jnp.inf, points.dtype), jnp.zeros_like(points))
    start = Around(
        normal=east,
        vertex=vertex,
        turned=jnp.zeros_like(vertex[0]),
        running=active,
        sound=jnp.ones_like(active),
        nearest=no_edge,
        edges=jnp.int32(0),
        memory=memory,
    )
    last = jax.lax.while_loop(
        lambda state: jnp.any(state.running) & (state.edges < most), lambda state: _next_edge(follow, points, state), start
    )
    return last.nearest, last.sound & ~last.running


def _next_edge(follow: Follow, points: Float[Array, "2 m *n"], state: Around) -> Around:
    normal, vertex, turned, running, sound, nearest, edges, memory = state
    edge = follow(normal, vertex, memory)
    # Without an edge the vertex is all of the region: a square without length says so.
    along = jnp.where(edge.exists, edge.along, -normal)
    outwards = -rotated(along)
    turn = jnp.arctan2(jnp.maximum(-jnp.sum(normal * along, axis=0), 0), jnp.sum(rotated(normal) * along, axis=0))
    length = jnp.where(edge.exists, jnp.maximum(jnp.sum((edge.end - vertex) * along, axis=0), 0), 0)
    turned = turned + jnp.where(running, turn, 0)
    sound &= edge.sound | ~running
    goes_on = running & edge.sound & (turned < AROUND)
    choose = lambda new, old: jnp.where(goes_on, new, old)
    return Around(
        normal=choose(outwards, normal),
        vertex=choose(edge.end, vertex),
        turned=turned,
        running=goes_on,
        sound=sound,
        nearest=_nearer(nearest, points, vertex, along, outwards, length, running & edge.counts),
        edges=edges + 1,
        memory=jax.tree.map(choose, edge.memory, memory),
    )


def _nearer(
    nearest: Nearest,
    points: Float[Array, "2 m *n"],
    start: Float[Array, "2 *n"],
    along: Float[Array, "2 *n"],
    outwards: Float[Array, "2 *n"],
    length: Float[Array, "*n"],
    counts: Bool[Array, "*n"],
) -> Nearest:
    """Of the edges so far and this one, the nearest."""
    normal, offset, foot = nearest
    own = jnp.sum(outwards * start, axis=0)
    room = own - jnp.sum(outwards[:, None] * points, axis=0)
    less = counts & (room < offset - jnp.sum(normal * points, axis=0))
    way = jnp.clip(jnp.sum(along[:, None] * (points - start[:, None]), axis=0), 0, length)
    other = start[:, None] + along[:, None] * way
    square = lambda vector: jnp.sum(vector * vector, axis=0)
    nearer = counts & (jnp.isinf(offset) | (square(points - other) < square(points - foot)))
    return Nearest(
        normal=jnp.where(less, outwards[:, None], normal),
        offset=jnp.where(less, own, offset),
        foot=jnp.where(nearer, other, foot),
    )


def first_edge(
    normal: Float[Array, "2 *n"], ways: Float[Array, "2 k *n"], scale: Float[Array, "*n"], same: float
) -> tuple[Int[Array, "*n"], Bool[Array, "*n"]]:
    """Which of the ways from a vertex into the region goes along its next edge, counterclockwise: the most outward one.

    Args:
        normal: as in `Around`.
        ways: from the vertex to other points of the region.
        scale: of the numbers that the ways are differences of.
        same: ways this short, relative to the scale, are none.

    Returns:
        The index (k: there is none), and whether all ways lead into the region, as they must: to the square root of a
        rounding error, which is how far the distance may be wrong.
    """
    noise = same * scale
    out = jnp.sum(normal[:, None] * ways, axis=0)
    ahead = jnp.sum(rotated(normal)[:, None] * ways, axis=0)
    size = jnp.abs(out) + jnp.abs(ahead)
    real = size > noise
    # Rises with the angle from straight ahead, 0, over inwards, 1, to back, 2.
    angle = 1 - ratio(ahead, jnp.maximum(-out, 0) + jnp.abs(ahead), otherwise=1.0)
    first = jnp.min(jnp.where(real, angle + ratio(noise, size), jnp.inf), axis=0)
    # Of all that rounding cannot tell apart, the longest.
    longest = jnp.max(jnp.where(real & (angle <= first), size, 0), axis=0)
    places = jnp.arange(len(size), dtype=jnp.int32).reshape(-1, *[1] * (size.ndim - 1))
    index = jnp.min(jnp.where(real & (angle <= first) & (size >= longest), places, len(size)), axis=0)
    return index, jnp.max(out, axis=0) <= jnp.finfo(out.dtype).eps ** 0.5 * scale
