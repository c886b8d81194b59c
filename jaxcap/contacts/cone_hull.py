"""Rays of a pointed cone -> its faces. Qhull's answer is a hint; what is returned carries a certificate.

A plane that cuts every ray turns the cone into a polytope. Its hull is a closed surface of simplices, each of which hints at
a face. The certificate has three parts, none of which trusts Qhull:

1. No ray stands out of a face.
2. The simplices close a surface: each side of one is the side of another, and a line from the middle crosses them an odd
   number of times.
3. Each simplex lies on one of the faces, but for `excess`.

So a wrench within all faces leaves the surface, seen from the middle, through a simplex, thus through a face of its own: it
is at most `1 + excess` times as far out as the cone is. No face can be missing.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

VALID = 1e-10
"""No unit ray may stand out of a unit face by more than this."""
ROUNDING = 1e-15
"""A unit ray this close to a unit face lies in it, and unit rays this close are one: they have errors of this size. Where a
cone is as thin as 1e-11, more would be a part of it."""
SAME_FACE = 1e-10
"""A face whose simplices are this close to another one, relative to its depth, is not needed."""
FLAT = 1e-4
"""Simplices of less than this part of the largest volume may be flat but for rounding, and not be a face of their own."""
DAMPING = 1e-13
"""A face is not moved in directions in which its rays, in squares, extend less than this: they do not say where it is."""
NEAR = 1e-3
"""A line from the middle that leaves the cone at this or less of a face's depth may cross the simplices of that face."""
REFINEMENTS = 2
KEY = np.random.default_rng(0).normal(size=7)
"""A random direction, in as many dimensions as any cone here has: rows with equal products with it are equal, and sorting by
one number brings equal rows together."""


class ProjectionError(ValueError):
    """The faces of a cone could not be computed, or did not pass their check."""


class CheckedFaces(NamedTuple):
    """Faces that hold all rays, and how much larger than the rays' cone their cone may be."""

    faces: Float[np.ndarray, "m d"]
    """Of unit length, outwards."""
    excess: float
    """Relative: seen from the middle of the cone, in the plane that cuts it."""


class Simplices(NamedTuple):
    """The surface of a polytope, as Qhull has it."""

    planes: Float[np.ndarray, "s q"]
    """Outward normals and offsets; equal rows for simplices that share a face."""
    corners: Int[np.ndarray, "s c"]
    """Numbers of the points."""


def pointed_faces(rays: Float[np.ndarray, "n d"], inside: Float[np.ndarray, " d"], options: str) -> CheckedFaces:
    """Faces of a cone without lines that spans its space.

    Args:
        rays: of unit length, each once.
        inside: unit vector with a positive product with every ray.
        options: for Qhull.

    Returns:
        The faces, and how good they are.

    Raises:
        ProjectionError: where Qhull fails, or the faces fail the first two parts of their check.
    """
    dimension = rays.shape[1]
    if dimension == 1:
        return CheckedFaces(-rays[:1], 0.0)
    heights = rays @ inside
    if heights.min() <= 0:
        raise ProjectionError("no plane cuts all rays of the pointed part: the cone is too close to containing a line")
    points = rays / heights[:, None]
    # Coordinates in the cutting plane, with the cloud of points made round: Qhull's tolerances are absolute.
    centre = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - centre, full_matrices=False)
    whiten = axes[: dimension - 1] / sizes[: dimension - 1, None]
    round_points = (points - centre) @ whiten.T
    surface = _hull(round_points, options)
    if not _is_closed(surface.corners, len(rays)):
        raise ProjectionError("the cone is not closed: Qhull's simplices leave a gap")
    _, first, owner = np.unique(surface.planes @ KEY[:dimension], return_index=True, return_inverse=True)
    # n.(W(x - c)) + b <= 0 on the plane inside.x = 1, made homogeneous
    planes = surface.planes[first]
    hints = planes[:, :-1] @ whiten
    hints += (planes[:, -1:] - hints @ centre[:, None]) * inside
    faces = _valid(_refined(_unit(hints), surface.corners, owner, rays), rays, inside, heights.min())
    volumes = np.abs(np.linalg.det(round_points[surface.corners]))
    behind = _behind(faces, rays, heights)
    if not _is_covered_once(round_points, surface.corners, behind, owner, volumes):
        raise ProjectionError("the cone is not closed: Qhull's simplices do not go around it once")
    needed, owner = _needed(faces, surface.corners, behind, owner, volumes)
    return CheckedFaces(faces[needed], _excess(behind[needed], surface.corners, owner))


def distinct(rays: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "k d"]:
    """The rays of unit length without repetitions, up to rounding; the first of each kept."""
    key = rays @ KEY[: rays.shape[1]]
    order = np.argsort(key)
    starts = np.flatnonzero(np.diff(key[order], prepend=-np.inf) > 10 * ROUNDING)
    if len(starts) == len(rays):
        return rays
    repeated = np.zeros(len(rays), bool)
    sizes = np.diff(starts, append=len(rays))
    for start, size in zip(starts[sizes > 1], sizes[sizes > 1], strict=True):  # equal, or only with equal keys
        group = np.sort(order[start : start + size])
        close = np.linalg.norm(rays[group][:, None] - rays[group][None], axis=-1) < ROUNDING
        repeated[group] = np.tril(close, -1).any(axis=1)
    return rays[~repeated]


def _unit(rows: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "m d"]:
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def _hull(points: Float[np.ndarray, "n q"], options: str) -> Simplices:
    """The surface of the hull of points."""
    if points.shape[1] == 1:
        low, high = points[:, 0].argmin(), points[:, 0].argmax()
        return Simplices(np.array([[-1.0, points[low, 0]], [1.0, -points[high, 0]]]), np.array([[low], [high]]))
    # As heavy as half of JAX to import: whoever projects nothing does without.
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points, qhull_options=options)
    except QhullError as error:
        raise ProjectionError(f"Qhull: {str(error).splitlines()[0]}") from error
    return Simplices(hull.equations, hull.simplices)


def _is_closed(corners: Int[np.ndarray, "s c"], points: int) -> bool:
    """Whether every side of every simplex is the side of another one."""
    size = corners.shape[1]
    ordered = np.sort(corners, axis=1).astype(np.int64)
    # A side is one number, its corners the digits; 64 bits hold 4 corners out of 55,000.
    digits = np.int64(points) ** np.arange(size - 1)
    sides = np.sort(np.concatenate([np.delete(ordered, i, axis=1) @ digits for i in range(size)]))
    return len(sides) % 2 == 0 and bool((sides[::2] == sides[1::2]).all())


def _refined(
    hints: Float[np.ndarray, "m d"],
    corners: Int[np.ndarray, "s c"],
    owner: Int[np.ndarray, " s"],
    rays: Float[np.ndarray, "n d"],
) -> Float[np.ndarray, "m d"]:
    """The hints, moved onto the rays of their simplices by Newton's method; as they were where that makes them worse."""
    n, dimension = rays.shape
    touches = _touches((len(hints), n), corners, owner).astype(float)
    squares = (touches @ (rays[:, :, None] * rays[:, None]).reshape(n, -1)).reshape(-1, dimension, dimension)
    faces = hints
    for _ in range(REFINEMENTS):
        # Small corrections, so the squares' condition number does no harm: it multiplies what is small already.
        slopes = (touches * (faces @ rays.T)) @ rays
        matrices = squares + faces[:, :, None] * faces[:, None] + DAMPING * np.eye(dimension)
        faces = _unit(faces - np.linalg.solve(matrices, slopes[..., None])[..., 0])
    worse = (faces @ rays.T).max(axis=1) > (hints @ rays.T).max(axis=1) + ROUNDING
    return np.where(worse[:, None], hints, faces)


def _valid(
    faces: Float[np.ndarray, "m d"], rays: Float[np.ndarray, "n d"], inside: Float[np.ndarray, " d"], lowest: float
) -> Float[np.ndarray, "m d"]:
    """The faces, turned away from the cone's middle until no ray stands out; what that costs shows in their excess."""
    violation = (faces @ rays.T).max(axis=1)
    out = violation > VALID / 10
    turned = _unit(faces[out] - (violation[out] / lowest)[:, None] * inside)
    return _with_rows(faces, out, turned)


def _with_rows(
    array: Float[np.ndarray, "m d"], where: Bool[np.ndarray, " m"], rows: Float[np.ndarray, "k d"]
) -> Float[np.ndarray, "m d"]:
    changed = array.copy()
    changed[where] = rows
    return changed


def _behind(
    faces: Float[np.ndarray, "m d"], rays: Float[np.ndarray, "n d"], heights: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "m n"]:
    """How far behind each face the rays are, where the plane cuts them, relative to the cone's middle.

    Rays that are nearly along the plane are far out there: a face has to meet them all the more closely.
    """
    products = faces @ rays.T
    depths = -products.sum(axis=1) / heights.sum()
    return np.where(products > -ROUNDING, 0, -products / heights) / depths[:, None]


def _is_covered_once(
    points: Float[np.ndarray, "n q"],
    corners: Int[np.ndarray, "s c"],
    behind: Float[np.ndarray, "m n"],
    owner: Int[np.ndarray, " s"],
    volumes: Float[np.ndarray, " s"],
) -> bool:
    """Whether a line from the middle, which is zero, crosses the simplices an odd number of times.

    A closed surface is crossed oddly often by all lines or by none: twice around would be even, as no way around. The line
    goes through the simplex that is farthest from flat. It meets no simplex beyond a face, so it can meet only those whose
    faces are near where it leaves.
    """
    widest = corners[volumes.argmax()]
    shares = 1 + np.abs(KEY[: corners.shape[1]])  # not its centre: others may have a side there
    shares /= shares.sum()
    crossing = shares @ points[widest]
    near = (behind[:, widest] @ shares < NEAR)[owner]
    if near.sum() == 1:
        return True
    matrices = np.swapaxes(points[corners[near]], 1, 2)
    weights = np.linalg.pinv(matrices) @ crossing  # the simplices may be flat
    met = np.linalg.norm((matrices @ weights[..., None])[..., 0] - crossing, axis=1) < NEAR * np.linalg.norm(crossing)
    return int((met & (weights > 0).all(axis=1)).sum()) % 2 == 1


def _needed(
    faces: Float[np.ndarray, "m d"],
    corners: Int[np.ndarray, "s c"],
    behind: Float[np.ndarray, "m n"],
    owner: Int[np.ndarray, " s"],
    volumes: Float[np.ndarray, " s"],
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " s"]]:
    """Numbers of the faces without those that rounding has made of others, and which of these each simplex lies on."""
    off = (behind > SAME_FACE).astype(np.float32)
    # Nearly equal rows are met one after another. They may still be two faces: of a cone that is thin where they differ.
    key = faces @ KEY[: faces.shape[1]]
    order = np.argsort(key)
    starts = np.diff(key[order], prepend=-np.inf) > SAME_FACE
    first = np.empty_like(order)
    first[order] = order[starts][np.cumsum(starts) - 1]
    repeats = np.flatnonzero(first != np.arange(len(faces)))
    same = (_touches(behind.shape, corners, owner)[repeats] * off[first[repeats]]).sum(axis=1) == 0
    instead = np.arange(len(faces))
    instead[repeats[same]] = first[repeats[same]]
    owner = instead[owner]
    # A face whose simplices are all flat may be one that rounding has made, between faces that are there without it.
    largest = np.zeros(len(faces))
    np.maximum.at(largest, owner, volumes)
    flat = np.flatnonzero((largest > 0) & (largest < FLAT * largest.max()))
    proper = np.flatnonzero(largest >= FLAT * largest.max())
    if len(flat):
        missed = _touches(behind.shape, corners, owner)[flat] @ off[proper].T
        found = missed.min(axis=1) == 0
        instead = np.arange(len(faces))
        instead[flat[found]] = proper[missed.argmin(axis=1)[found]]
        owner = instead[owner]
    return np.unique(owner, return_inverse=True)


def _touches(
    shape: tuple[int, ...], corners: Int[np.ndarray, "s c"], owner: Int[np.ndarray, " s"]
) -> Float[np.ndarray, "m n"]:
    """Which rays are corners of the simplices on each face: 1, else 0; in single precision, for products of it are sums."""
    touches = np.zeros(shape, np.float32)
    touches[owner[:, None], corners] = 1
    return touches


def _excess(behind: Float[np.ndarray, "m n"], corners: Int[np.ndarray, "s c"], owner: Int[np.ndarray, " s"]) -> float:
    """By how much the simplices lie behind the faces, each at its own; those that do so most at the best face of all."""
    own = behind[owner[:, None], corners].max(axis=1)
    loose = own > own.max() / 2
    if own.max() > 0 and loose.sum() * len(behind) < 10**6:
        own[loose] = behind[:, corners[loose]].max(axis=2).min(axis=0)
    return float(own.max())
