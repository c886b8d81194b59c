"""Faces of the cone -> its support polygon, on the host: the CoM positions at which the robot can stand still.

With zero acceleration a face is a half-plane in the plane across gravity. Each one's line is cut with all the others: what
is left of it is an edge. So no case is special: no region, a point, a segment, a strip, the whole plane.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxcap.contacts.cone import CentroidalCone
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, FloatArray, checked_gravity
from jaxcap.numerics.guarded import tolerances
from jaxcap.regions.plane import Nearest, across, rotated, upward

FLAT = 1e-9
"""A face whose half-plane has a normal this small holds everywhere or nowhere: its line is 1e9 stances away."""
PARALLEL = 1e-12
"""Unit normals that differ by this little belong to parallel lines."""
EDGES = 16
"""Edges are repeated up to a multiple of this number, so that few sizes are compiled."""
SAME = 1e-9
"""Points this close, relative to the size of the stance, are one."""


class SupportPolygon(NamedTuple):
    """The static-equilibrium region of a contact set in the plane across gravity, by edges and by vertices.

    Edge i is what lies between `low` and `high` on the line normals[i] . (q - origin) = offsets[i], counted along the normal
    turned counterclockwise by a right angle; the region is where `<=` holds for all edges. Without edges it is the whole
    plane, unless it is `empty`.
    """

    normals: Float[FloatArray, "m 2"]
    """Unit vectors, outwards."""
    offsets: Float[FloatArray, " m"]
    """[m]"""
    low: Float[FloatArray, " m"]
    """[m], minus infinity where the edge has no end."""
    high: Float[FloatArray, " m"]
    """[m], or infinity."""
    vertices: Float[FloatArray, "k 2"]
    """Counterclockwise [m]. One for a point, two for a segment; where it is unbounded those that there are, perhaps none."""
    origin: Float[FloatArray, "2"]
    """Centroid of the contacts [m]."""
    empty: Bool[FloatArray, ""]
    """Nowhere can the robot stand."""

    def distance(self, points: Float[Array, "*n 2"]) -> Float[Array, "*n"]:
        """Signed distance of points, as `support_distance` has it.

        Args:
            points: (..., 2) [m], in the plane across gravity.

        Returns:
            (...) [m], positive inside.
        """
        known = jnp.all(jnp.isfinite(points), axis=-1)
        local = jnp.where(known[..., None], points - jnp.asarray(self.origin).astype(points.dtype), 0)
        if len(self.offsets) == 0:
            distance = jnp.where(self.empty, -jnp.inf, jnp.full(known.shape, jnp.inf, points.dtype))
        else:
            xp: Any = self.offsets.__array_namespace__()
            repeat = lambda x: xp.pad(x, [(0, -len(x) % EDGES)] + [(0, 0)] * (x.ndim - 1), mode="edge")
            edges = (repeat(x) for x in (self.normals, self.offsets, self.low, self.high))
            edges = (jnp.asarray(x).astype(points.dtype) for x in edges)
            distance = _distance(*edges, local.reshape(-1, 2)).reshape(known.shape)
        return jnp.where(known, distance, jnp.nan)


def support_polygon(cone: CentroidalCone, gravity: ArrayLike = GRAVITY) -> SupportPolygon:
    """The region of CoM positions, projected along gravity, at which the contacts can hold the robot still; host only.

    Args:
        cone: from `centroidal_cone`.
        gravity: (3,) [m/s^2], not zero.

    Returns:
        The region. The plane's coordinates are x and y where gravity points down; else see `plane.across`.

    Raises:
        ValueError: for gravity that is zero or not finite; and under a JAX transformation, where `support_distance` with
            rays works.
        TypeError: for gravity that is not three numbers.

    Source: Bretl and Lall, Testing Static Equilibrium for Legged Robots, T-RO 2008, whose region it is; from the faces (6).
    """
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((cone, gravity))):
        raise ValueError("support_polygon works on the host, once for each contact set: call it outside jit, vmap and grad")
    pull = _double(checked_gravity(gravity))
    if not pull.any():
        raise ValueError("gravity = 0 (expected a direction, as (0, 0, -9.81))")
    up, axes = np.asarray(upward(pull), float), np.asarray(across(pull), float)
    faces, length = _double(cone.faces), float(cone.length)
    # The wrench of a robot at rest is (up, arm x up) per unit of weight; arms in sizes of the stance.
    rows = np.cross(up, faces[:, 3:] * length) @ axes.T
    bounds = tolerances(np.float64).slack - faces[:, :3] @ up
    if cone.offsets is not None:
        bounds += _double(cone.offsets) / np.linalg.norm(pull)
    sizes = np.linalg.norm(rows, axis=1)
    flat = sizes <= FLAT
    holds = bool((bounds[flat] >= 0).all())
    normals, offsets = rows[~flat] / sizes[~flat, None], bounds[~flat] / sizes[~flat]
    low, high = _ends(normals, offsets)
    edges = (low <= high + SAME) & holds
    empty = not holds or (len(offsets) > 0 and not edges.any())
    normals, offsets, low, high = normals[edges], offsets[edges], low[edges], high[edges]
    # Edges as short as rounding may have their ends crossed: both are then their middle.
    crossed = low > high
    low[crossed] = high[crossed] = (low[crossed] + high[crossed]) / 2
    origin = axes @ _double(cone.origin)
    vertices = origin + length * _vertices(normals, offsets, low, high)
    return SupportPolygon(normals, length * offsets, length * low, length * high, vertices, origin, np.asarray(empty))


@jax.jit
def _distance(
    normals: Float[Array, "m 2"],
    offsets: Float[Array, " m"],
    low: Float[Array, " m"],
    high: Float[Array, " m"],
    points: Float[Array, "n 2"],
) -> Float[Array, " n"]:
    """Signed distance of points to a region with these edges, both relative to the same origin."""
    lines = jax.lax.stop_gradient(points)[:, None]
    along = rotated(normals.T).T
    room = offsets - jnp.sum(normals * lines, axis=-1)
    way = jnp.clip(jnp.sum(along * lines, axis=-1), low, high)
    feet = offsets[:, None] * normals + along * way[..., None]
    nearest, tightest = jnp.argmin(jnp.sum((lines - feet) ** 2, axis=-1), axis=-1), jnp.argmin(room, axis=-1)
    foot = jnp.take_along_axis(feet, nearest[:, None, None], axis=1)[:, 0]
    return Nearest(normals[tightest].T, offsets[tightest], foot.T).distance(points.T)


def _double(array: ArrayLike) -> np.ndarray:
    return np.asarray(array, np.float64)


def _ends(
    normals: Float[np.ndarray, "m 2"], offsets: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """What all other half-planes leave of each one's line: (m,), (m,); nothing where the first is the larger."""
    along = np.column_stack([-normals[:, 1], normals[:, 0]])
    rates, room = along @ normals.T, offsets - offsets[:, None] * (normals @ normals.T)
    parallel = np.abs(rates) < PARALLEL
    at = room / np.where(parallel, 1, rates)
    low = np.where(~parallel & (rates < 0), at, -np.inf).max(axis=1, initial=-np.inf)
    high = np.where(~parallel & (rates > 0), at, np.inf).min(axis=1, initial=np.inf)
    outside = (parallel & (room < -SAME)).any(axis=1)
    return np.where(outside, np.inf, low), np.where(outside, -np.inf, high)


def _vertices(
    normals: Float[np.ndarray, "m 2"],
    offsets: Float[np.ndarray, " m"],
    low: Float[np.ndarray, " m"],
    high: Float[np.ndarray, " m"],
) -> Float[np.ndarray, "k 2"]:
    """The ends of all edges, each once, counterclockwise: (k, 2)."""
    along = np.column_stack([-normals[:, 1], normals[:, 0]])
    ends = np.concatenate([low, high])
    real = np.isfinite(ends)
    lines = np.tile(offsets[:, None] * normals, (2, 1))[real]
    points = lines + ends[real, None] * np.tile(along, (2, 1))[real]
    close = np.linalg.norm(points[:, None] - points[None], axis=-1) < SAME
    points = points[~np.tril(close, -1).any(axis=1)]
    around = points - points.mean(axis=0) if len(points) else points
    return points[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]
