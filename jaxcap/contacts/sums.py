"""Vertices and rays -> the faces of sums of polytopes and a cone, on the host.

The sum of polytopes has fewer vertices than there are sums of their vertices: for two arms one or two thousand out of tens
of thousands. So the hull of some sums is computed, and each of its faces asks how far the sum goes along its normal: as far
as all polytopes together. Where that is beyond the face, the vertices found there make a new point; where no face is passed,
the hull is the sum. The hulls carry the certificate of `projection`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxcap.contacts.cone_hull import ProjectionError
from jaxcap.contacts.projection import FLAT, cone_faces

FACES = 50_000
"""More faces than this are refused: rays are then as fast, and the hull takes minutes."""
SUMS = 100_000
"""More sums of vertices than this are refused before any hull: they make more faces, or hulls of many minutes."""
WHOLE = 500
"""Up to so many sums of vertices are all taken at once."""
FIRST = 20_000
"""Of more, the sums that are farthest along so many normals are taken first."""
PASSED = 1e-9
"""A sum that stands out of a face by less than this, where parts are of size one, is on it; the face is moved to it."""
QHULL_OPTIONS = ("Qt", "Qt Q14")
"""Merged facets triangulated; pinched vertices merged too. No joggling: sums that share a face would make many of it."""
ROUNDS = 40
"""Of hulls, at most. Each takes in all that stood out of the one before; two arms take about five."""


class TooManyFacesError(ProjectionError):
    """The sum has more faces than are of use."""


class Halfspaces(NamedTuple):
    """All points with normals @ point <= offsets."""

    normals: Float[np.ndarray, "m d"]
    """Of unit length."""
    offsets: Float[np.ndarray, " m"]


def faces_of_sum(parts: Sequence[Float[np.ndarray, "_ d"]], rays: Float[np.ndarray, "r d"]) -> Halfspaces:
    """All sums of a point of each polytope and non-negative multiples of rays, by its faces.

    Args:
        parts: the vertices of each polytope, at least one, which may hold other points of it too; coordinates of size one.
        rays: of the cone; may be none.

    Returns:
        The faces, each at the distance that the parts say; an equality as a pair. No row at all means the whole space.

    Raises:
        TooManyFacesError: with more than FACES, or SUMS.
        ProjectionError: as `cone_faces`.
    """
    if (count := math.prod(len(part) for part in parts)) > SUMS:
        raise TooManyFacesError(f"{count} sums of the limbs' vertices (at most {SUMS})")
    chosen = _first(parts, rays)
    for _ in range(ROUNDS):
        points = _sums(parts, chosen)
        found = _hull(points, rays)
        if len(found.normals) > FACES:
            raise TooManyFacesError(f"more than {FACES} faces")
        farthest = _farthest(parts, found.normals)
        support = np.einsum("md,md->m", found.normals, _sums(parts, farthest))
        out = support > found.offsets + PASSED
        more = np.unique(farthest[out], axis=0)
        if not len(more):
            return Halfspaces(found.normals, support)
        known = len(chosen)
        chosen = np.unique(np.concatenate([chosen, more]), axis=0)
        if len(chosen) == known:
            raise ProjectionError(
                f"a face misses its vertex by {(support - found.offsets).max():.1e} (at most {PASSED:.0e})"
            )
    raise ProjectionError(f"after {ROUNDS} hulls there are sums that stand out")


def _hull(points: Float[np.ndarray, "n d"], rays: Float[np.ndarray, "r d"]) -> Halfspaces:
    """Faces of the hull of points and a cone: as the cut of a cone of one more dimension."""
    d = points.shape[1]
    tips, far = np.pad(points, ((0, 0), (0, 1)), constant_values=1), np.pad(rays, ((0, 0), (0, 1)))
    rows = cone_faces(np.concatenate([tips, far]), QHULL_OPTIONS)
    sizes = np.linalg.norm(rows[:, :d], axis=1)
    bounding = sizes > FLAT  # not the one that says that there is nothing before the cut through the tip
    rows = rows[bounding] / sizes[bounding, None]
    return Halfspaces(rows[:, :d], -rows[:, d])


def _first(parts: Sequence[Float[np.ndarray, "_ d"]], rays: Float[np.ndarray, "r d"]) -> Int[np.ndarray, "n p"]:
    """Numbers of the vertices of the sums to begin with."""
    counts = [len(part) for part in parts]
    if math.prod(counts) <= WHOLE:
        return np.stack(np.unravel_index(np.arange(math.prod(counts)), counts), axis=1)
    normals = np.random.default_rng(0).normal(size=(FIRST, parts[0].shape[1]))
    if len(rays):
        # Only along normals of the cone's faces, and between them, is the sum bounded.
        cone = cone_faces(rays)
        shares = np.random.default_rng(0).exponential(size=(FIRST, len(cone))) ** 3
        normals = np.concatenate([cone, shares @ cone])
    return np.unique(_farthest(parts, normals), axis=0)


def _farthest(parts: Sequence[Float[np.ndarray, "_ d"]], normals: Float[np.ndarray, "m d"]) -> Int[np.ndarray, "m p"]:
    """Number of the vertex of each part that is farthest along each normal."""
    return np.stack([np.argmax(normals @ part.T, axis=1) for part in parts], axis=1)


def _sums(parts: Sequence[Float[np.ndarray, "_ d"]], chosen: Int[np.ndarray, "n p"]) -> Float[np.ndarray, "n d"]:
    """Of the chosen vertices."""
    return np.sum([part[chosen[:, i]] for i, part in enumerate(parts)], axis=0)
