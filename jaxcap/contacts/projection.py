"""Rays -> faces of the cone they span, on the host.

The cone is split into its span, its lines (the largest subspace inside it) and a pointed rest, whose hull gives the faces.
Nothing is returned that was not checked against the rays: see `lines` and `cone_hull`.
"""

from collections.abc import Iterator
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


def cone_faces(rays: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "m d"]:
    """Rows H of unit length with {H w <= 0} = {sum of non-negative multiples of the rays}.

    Args:
        rays: zero rays are ignored. Their coordinates should be of one scale (torques divided by a length).

    Returns:
        The faces. An equality is a pair of opposite rows; no row at all means the whole space.

    Raises:
        ProjectionError: where no faces pass their check: each ray satisfies every face, together they close the cone.
    """
    norms = np.linalg.norm(rays, axis=1)
    unit = rays[norms > 0] / norms[norms > 0, None]
    failures = []
    best = CheckedFaces(unit[:0], np.inf)
    for found in _attempts(unit):
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


def _attempts(rays: Float[np.ndarray, "n d"]) -> Iterator[CheckedFaces | ProjectionError]:
    """The faces of the cone of unit rays in one way after another, or what stood in the way."""
    each_once = distinct(rays)
    span, outside = split(each_once, np.eye(rays.shape[1]))
    equalities = np.concatenate([outside, -outside])
    for attempt in ATTEMPTS:
        for options in QHULL_OPTIONS:
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
