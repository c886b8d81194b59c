"""Signed distances of points to support polygons, and to hulls of contact points: one region for all, or each its own."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num

from jaxcap.batch.blocks import RAYS_BLOCK, Block, over_blocks, over_chunks
from jaxcap.batch.second_opinion import MOST
from jaxcap.contacts.cone import CentroidalCone, ConeRays, projected
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, FloatArray
from jaxcap.contacts.projection import ProjectionError
from jaxcap.regions.plane import Edge, across, column, first_edge, walk_around
from jaxcap.regions.ray_support import nearest_of_rays
from jaxcap.regions.support_polygon import SupportPolygon, support_polygon

SAME_POINT = 8
"""Contact points this many rounding errors apart are one."""


def support_distance(
    support: SupportPolygon | CentroidalCone | ConeRays, points: Num[FloatArray, "*n 2"], gravity: ArrayLike = GRAVITY
) -> Float[Array, "*n"]:
    """Signed distance of points in the plane across gravity to the support polygon: positive inside, minus the Euclidean
    distance outside [m].

    Differentiable in the points; the polygon is taken for fixed. With rays or a polygon it works under jit, vmap and grad.

    Args:
        support: a polygon, a cone whose polygon is made first, or rays: of one contact set, or with a leading axis of n, a
            set for each row of `points`.
        points: (..., 2) [m], such as capture points; (n, m, 2) for m points for each of n sets. Their dtype decides the
            precision.
        gravity: (3,) [m/s^2], not used with a polygon.

    Returns:
        (...,) [m]: infinite where the robot can stand everywhere, minus infinite where nowhere; NaN for a point or contacts
        that are not finite, or where no answer was found. What rays do not find is asked of faces, outside of jit.

    Raises:
        TypeError: for wrong shapes.

    Source: Bretl and Lall, Testing Static Equilibrium for Legged Robots, T-RO 2008, whose region it is.
    """
    points = _floats(points)
    if isinstance(support, CentroidalCone):
        support = support_polygon(support, gravity)
    if isinstance(support, SupportPolygon):
        return support.distance(points)
    real = lambda leaf: leaf.astype(points.dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf
    rays: ConeRays = jax.tree.map(lambda leaf: real(jnp.asarray(leaf)), support)
    found = _distances(_to_rays, "rays", rays, rays.batched, points, gravity)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in (found, points, *jax.tree.leaves(rays))):
        return found
    return _decided(support, points, gravity, found)


def _decided(rays: ConeRays, points: Array, gravity: ArrayLike, found: Array) -> Array:
    """The distances, those that rays do not find by faces, in double precision on the host, as `second_opinion` has it."""
    missing = np.isnan(found) & np.isfinite(points).all(axis=-1)
    if not missing.any():
        return found
    wrenches, origins, lengths = (np.asarray(field, float) for field in (rays.rays, rays.origin, rays.length))
    answer = np.array(found)
    for row in np.flatnonzero(missing.reshape(len(missing), -1).any(axis=1))[:MOST] if rays.batched else [...]:
        if not np.isfinite(wrenches[row]).all():
            continue
        try:
            cone = projected(wrenches[row], origins[row], np.asarray(lengths[row]))
        except ProjectionError:
            continue
        with jax.enable_x64(True):
            by_faces = support_polygon(cone, gravity).distance(jnp.asarray(points[row], float))
        answer[row] = np.where(missing[row], by_faces, answer[row])
    return jnp.asarray(answer)


def hull_distance(contacts: ContactSet, points: Num[FloatArray, "*n 2"], gravity: ArrayLike = GRAVITY) -> Float[Array, "*n"]:
    """Signed distance of points to the convex hull of the contact points, projected along gravity, as `support_distance`.

    Frames and friction do not matter, so only for coplanar contacts is this the support polygon.

    Args:
        contacts: one set, or a batch of n, a set for each row of `points`. Masked contacts are left out.
        points: (..., 2) [m], as for `support_distance`.
        gravity: (3,) [m/s^2].

    Returns:
        (...,) [m]; minus infinite without a contact that is not masked.

    Raises:
        TypeError: for wrong shapes.
    """
    points, contacts = _floats(points), contacts.padded(max(1, len(contacts)))
    positions, mask = jnp.asarray(contacts.points).astype(points.dtype), jnp.asarray(contacts.mask)
    return _distances(_to_hull, "contacts", (positions, mask), mask.ndim == 2, points, gravity)


def _floats(points: Any) -> Float[Array, "*n 2"]:
    points = jnp.asarray(points)
    if points.shape[-1:] != (2,):
        raise TypeError(f"points has shape {points.shape} (expected (..., 2))")
    return points.astype(jnp.promote_types(points.dtype, jnp.float32))


def _distances(one: Callable, name: str, region: Any, own: bool, points: Array, gravity: ArrayLike) -> Array:
    """`one`(region, points, gravity), lanes last, of points (..., 2) and one region, or a region for each row of points."""
    pull = jnp.asarray(gravity, points.dtype)
    if not own:
        answer = _compiled_one(one, region, jnp.moveaxis(points.reshape(-1, 2), -1, 0), pull)
        return answer.reshape(points.shape[:-1])
    n, sets = points.shape[0], jax.tree.leaves(region)[0].shape[0]
    if points.ndim < 2 or n != sets:
        raise TypeError(f"points has shape {points.shape} and {name} {sets} contact sets (expected a row for each)")
    rows = points.reshape(n, -1, 2)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((region, rows))):
        answer = _compiled_block(one, Block((region, rows), None), pull)
    else:
        answer = over_blocks(lambda block: _compiled_block(one, block, pull), (region, rows), n, RAYS_BLOCK)
    return answer.reshape(points.shape[:-1])


_compiled_one = jax.jit(lambda one, *arguments: one(*arguments), static_argnums=0)


@partial(jax.jit, static_argnums=0)
def _compiled_block(one: Callable, block: Block, gravity: Array) -> Array:
    return over_chunks(lambda lanes: one(lanes[0], jnp.moveaxis(lanes[1], 1, 0), gravity), block.rows, filled=block.filled)


def _finite(points):
    """Points that can be computed with, and which they were."""
    known = jnp.all(jnp.isfinite(points), axis=0)
    return jnp.where(known, points, 0), known


def _to_rays(rays: ConeRays, points: Float[Array, "2 m *n"], gravity: Array) -> Float[Array, "m *n"]:
    points, finite = _finite(points)
    origin = jnp.tensordot(across(gravity), rays.origin, axes=1, precision=jax.lax.Precision.HIGHEST)
    local = (points - origin[:, None]) / rays.length
    nearest, stands, known = nearest_of_rays(rays, local, gravity)
    distance = jnp.where(stands, nearest.distance(local) * rays.length, -jnp.inf)
    return jnp.where(finite & known, distance, jnp.nan)


def _to_hull(contacts: tuple[Array, Array], points: Float[Array, "2 m *n"], gravity: Array) -> Float[Array, "m *n"]:
    points, finite = _finite(points)
    positions, mask = jax.lax.stop_gradient(contacts)  # (k, 3, *n), (k, *n)
    origin = jnp.sum(jnp.where(mask[:, None], positions, 0), axis=0) / jnp.maximum(jnp.sum(mask, axis=0), 1)
    project = lambda arms: jnp.tensordot(across(gravity), arms, axes=(1, 1), precision=jax.lax.Precision.HIGHEST)
    corners = jnp.where(mask, project(jnp.where(mask[:, None], positions - origin, 0)), 0)
    size, same = jnp.max(jnp.abs(corners), axis=(0, 1)), SAME_POINT * float(jnp.finfo(points.dtype).eps)

    def follow(normal: Array, vertex: Array, _: Any) -> Edge:
        ways = jnp.where(mask, corners - vertex[:, None], 0)
        index, sound = first_edge(normal, ways, size, same)
        end, exists = column(corners, index), index < len(mask)
        way = end - vertex
        along = way / jnp.where(exists, jnp.sqrt(jnp.sum(way * way, axis=0)), 1)
        return Edge(along, end, exists, jnp.ones_like(exists), sound, ())

    stands, known = jnp.any(mask, axis=0), jnp.all(jnp.isfinite(corners), axis=(0, 1))
    first = column(corners, jnp.argmax(jnp.where(mask, corners[0], -jnp.inf), axis=0))
    local = points - jnp.tensordot(across(gravity), origin, axes=1, precision=jax.lax.Precision.HIGHEST)[:, None]
    nearest, sound = walk_around(follow, first, (), jax.lax.stop_gradient(local), stands & known, 4 * len(mask) + 8)
    distance = jnp.where(stands, nearest.distance(local), -jnp.inf)
    return jnp.where(finite & known & (sound | ~stands), distance, jnp.nan)
