"""Rays -> faces of the cone they span, on the host.

The cone is split into its span, its lines (the largest subspace inside it) and a pointed rest, whose hull gives the faces.
Nothing is returned that was not checked against the rays: see `lines` and `cone_hull`.
"""

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxcap.contacts.cone_hull import VALID, CheckedFaces, distinct, pointed_faces
from jaxcap.contacts.cone_hull import ProjectionError as ProjectionError
from jaxcap.contacts.lines import distance_of_parts, parts, split

WANTED = 1e-9
"""The first faces with at most this excess are taken, else the best that there are, ..."""
ACCEPTED = 1e-6
"""... unless theirs is larger than this: then there is an error. Lines may be as far from the cone, too."""


FLAT = 1e-9
"""A face of a cone with a box whose normal has less than this of force and torque bounds neither."""


class Attempt(NamedTuple):
    """How large a difference counts as none."""

    opposite: float
    """Rays that oppose each other up to this make a line: to rounding, or as contacts given in single precision."""
    zero: float
    """A ray with less than this outside the lines lies in them."""


ATTEMPTS = (Attempt(1e-12, 1e-11), Attempt(1e-6, 1e-11))
"""Tried in this order. Where two pyramids touch along an edge, single precision leaves a wedge of 1e-8 there, whose rays
Qhull cannot resolve beside the others; it then counts as a line, which makes the cone larger by about as much."""
QHULL_OPTIONS = ("Qt", "QJ")
"""Tried in this order: merged facets triangulated; points joggled, so that there is nothing to merge."""


def cone_faces(rays: Float[np.ndarray, "n d"], qhull_options: tuple[str, ...] | None = None) -> Float[np.ndarray, "m d"]:
    """Rows H of unit length with {H w <= 0} = {sum of non-negative multiples of the rays}.

    Args:
        rays: zero rays are ignored. Their coordinates should be of one scale (torques divided by a length).
        qhull_options: tried in this order; None for QHULL_OPTIONS.

    Returns:
        The faces. An equality is a pair of opposite rows; no row at all means the whole space.

    Raises:
        ProjectionError: where no faces pass their check: each ray satisfies every face, together they close the cone.
    """
    norms = np.linalg.norm(rays, axis=1)
    unit = rays[norms > 0] / norms[norms > 0, None]
    failures = []
    best = CheckedFaces(unit[:0], np.inf)
    for found in _attempts(unit, qhull_options or QHULL_OPTIONS):
        if isinstance(found, ProjectionError):
            failures.append(found)
            continue
        best = min(best, found, key=lambda checked: checked.excess)
        if best.excess <= WANTED:
            break
    if best.excess <= ACCEPTED:
        return best.faces
    if np.isfinite(best.excess):
        raise ProjectionError(f"the cone is not closed: its faces make it {best.excess:.1e} larger (at most {ACCEPTED:.0e})")
    raise failures[0]


def boxed_faces(rays: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "m 6"]:
    """Normals of the faces of a cone with a box of torques at its tip, the same for a box of any size; unit length.

    The sum of both is a polyhedron, and as the cut of a cone of one more dimension it is projected and checked like any
    other: the rays go along it, the corners of the box stand at its tip. How far out each face is, the box says itself: a
    face of the sum touches the cone, and the box at the corner that is farthest along its normal.

    Args:
        rays: as for `cone_faces`.

    Returns:
        The normals of the faces: those of the cone, and others where the box stands out.

    Raises:
        ProjectionError: as `cone_faces`.
    """
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    at_tip = np.concatenate([np.zeros((len(corners), 3)), corners, np.ones((len(corners), 1))], axis=1)
    faces = cone_faces(np.concatenate([np.pad(rays, ((0, 0), (0, 1))), at_tip]))
    sizes = np.linalg.norm(faces[:, :6], axis=1)
    bounding = sizes > FLAT  # not the one that says that there is nothing before the cut through the tip
    normals = faces[bounding, :6] / sizes[bounding, None]
    off = np.abs(faces[bounding, 6] / sizes[bounding] + np.abs(normals[:, 3:]).sum(axis=1)).max(initial=0)
    if off > ACCEPTED:
        raise ProjectionError(f"a face is {off:.1e} from the corner of the box that it touches (at most {ACCEPTED:.0e})")
    return normals


def _attempts(rays: Float[np.ndarray, "n d"], qhull_options: tuple[str, ...]) -> Iterator[CheckedFaces | ProjectionError]:
    """The faces of the cone of unit rays in one way after another, or what stood in the way."""
    each_once = distinct(rays)
    span, outside = split(each_once, np.eye(rays.shape[1]))
    equalities = np.concatenate([outside, -outside])
    for attempt in ATTEMPTS:
        for options in qhull_options:
            try:
                found = _faces(each_once, span, attempt, options)
                faces = np.concatenate([found.faces, equalities])
                violation = (faces @ rays.T).max(initial=0)
                if violation > VALID:
                    raise ProjectionError(f"a ray stands out of a face by {violation:.1e} (at most {VALID:.0e})")
                yield found._replace(faces=faces)
            except ProjectionError as error:
                yield error


def _faces(rays: Float[np.ndarray, "n d"], span: Float[np.ndarray, "s d"], attempt: Attempt, options: str) -> CheckedFaces:
    """Faces of the cone in its span."""
    found = parts(rays, span, *attempt)
    distance = distance_of_parts(rays, found, ACCEPTED)
    if distance > ACCEPTED:
        raise ProjectionError(f"a line is {distance:.1e} from the cone (at most {ACCEPTED:.0e})")
    if len(found.pointed) == 0:
        return CheckedFaces(found.pointed, 0.0)
    rest = rays @ found.pointed.T
    sizes = np.linalg.norm(rest, axis=1)
    rest = rest[sizes > attempt.zero] / sizes[sizes > attempt.zero, None]
    faces, excess = pointed_faces(distinct(rest) if len(found.lines) else rest, found.inside, options)
    return CheckedFaces(faces @ found.pointed, excess)
