"""Rays -> faces of the cone they span, on the host.

The cone is split into its span, the largest subspace inside it (lineality space) and a pointed rest. A plane that cuts
every ray of the rest turns it into a polytope, whose hull is Qhull's work. Qhull's answer is then only a hint: each face is
computed again from the rays that it touches, and nothing is returned that was not checked against the rays.
"""

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, QhullError

RANK = 1e-9
"""Singular values below this times the largest are zero. Rays have unit length."""
PARALLEL = 1e-8
"""Two unit rays this close are one ray: exact duplicates up to rounding of contacts far from the origin."""
TIGHT = 1e-9
"""A unit ray this close to a unit face lies in it."""
VALID = 1e-10
"""No unit ray may stand out of a unit face by more than this."""
HINT_REACH = (1e-6, 1e-8, 0.0)
"""Rays this close to the plane that Qhull gives are taken for its rays, tried in this order."""
QHULL_OPTIONS = ("Qt", "Qt Qx", "QJ")
"""Tried in this order: merged facets triangulated, the same with exact pre-merging, points joggled instead."""


class ProjectionError(ValueError):
    """The faces of a cone could not be computed, or did not pass their check."""


def cone_faces(rays: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "m d"]:
    """Rows H of unit length with {H w <= 0} = {sum of non-negative multiples of the rays}.

    An equality is a pair of opposite rows; no row at all means the whole space. Zero rays are ignored. The rays' coordinates
    should be of one scale (torques divided by a length). Raises ProjectionError where the result does not pass its check:
    each ray satisfies every face, each face is spanned by the rays that it touches, and together they close the cone.
    """
    dimension = rays.shape[1]
    norms = np.linalg.norm(rays, axis=1)
    rays = _distinct(rays[norms > 0] / norms[norms > 0, None])
    span, outside = _split(rays, np.eye(dimension))
    pairs = np.concatenate([outside, -outside])
    if len(span) == 0:
        return pairs
    _, pointed = _split(rays[_in_lineality(rays)], span)
    if len(pointed) == 0:
        return pairs
    rest = rays @ pointed.T
    norms = np.linalg.norm(rest, axis=1)
    rest = _distinct(rest[norms > TIGHT] / norms[norms > TIGHT, None])
    faces = _pointed_faces(rest) @ pointed
    violation = (faces @ rays.T).max(initial=0)
    if violation > VALID:
        raise ProjectionError(f"a ray stands out of a face by {violation:.1e} (at most {VALID:.0e})")
    return np.concatenate([faces, pairs])


def _split(rays, basis):
    """Orthonormal rows spanning the rays' part of the space spanned by `basis` (r, d), and rows spanning the rest."""
    if len(rays) == 0:
        return basis[:0], basis
    _, sizes, axes = np.linalg.svd(rays @ basis.T)
    rank = int((sizes > RANK * max(sizes[0], 1.0)).sum())
    return axes[:rank] @ basis, axes[rank:] @ basis


def _distinct(rays):
    """The rays (n, d) of unit length without repetitions, the first of each kept."""
    close = np.linalg.norm(rays[:, None] - rays[None], axis=-1) < PARALLEL
    return rays[~np.tril(close, -1).any(axis=1)]


def _in_lineality(rays):
    """(n,) bool: the rays whose opposite also lies in the cone.

    They are the rays that take part in a non-negative combination that vanishes; one linear program finds all: maximise
    the sum of t with 0 <= t <= 1, R'(t + u) = 0, u >= 0.
    """
    n = len(rays)
    found = linprog(
        np.concatenate([-np.ones(n), np.zeros(n)]), A_eq=np.concatenate([rays, rays]).T, b_eq=np.zeros(rays.shape[1]),
        bounds=[(0, 1)] * n + [(0, None)] * n, method="highs-ds",
    )
    if not found.success:
        raise ProjectionError(f"lineality space: {found.message}")
    return found.x[:n] > 0.5


def _pointed_faces(rays):
    """Faces (m, d) of a cone without lines that spans its space R^d, rays (n, d) of unit length."""
    dimension = rays.shape[1]
    if dimension == 1:
        return -rays[:1]
    inside = _dual_interior(rays)
    points = rays / (rays @ inside)[:, None]
    # Coordinates in the cutting plane, with the cloud of points made round: Qhull's tolerances are absolute.
    centre = points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(points - centre, full_matrices=False)
    whiten = axes[: dimension - 1] / sizes[: dimension - 1, None]
    failure = None
    for options in QHULL_OPTIONS:
        try:
            planes, simplices = _hull((points - centre) @ whiten.T, options)
            # n.(W(x - c)) + b <= 0 on the plane inside.x = 1, made homogeneous
            hints = planes[:, :-1] @ whiten
            hints += (planes[:, -1:] - hints @ centre[:, None]) * inside
            return _refined(hints / np.linalg.norm(hints, axis=1, keepdims=True), simplices, rays)
        except ProjectionError as error:
            failure = error
    raise failure


def _dual_interior(rays):
    """(d,) direction with a positive product with every ray, the smallest as large as can be."""
    n, dimension = rays.shape
    best = linprog(
        np.r_[np.zeros(dimension), -1.0], A_ub=np.column_stack([-rays, np.ones(n)]), b_ub=np.zeros(n),
        bounds=[(-1, 1)] * dimension + [(None, None)], method="highs-ds",
    )
    if not best.success or -best.fun <= TIGHT:
        raise ProjectionError("no plane cuts all rays of the pointed part: the cone is too close to containing a line")
    return best.x[:-1]


def _hull(points, options):
    """Hull of points (n, q): outward normals and offsets (m, q + 1), and the points of each simplex of it (m, q)."""
    if points.shape[1] == 1:
        low, high = points[:, 0].argmin(), points[:, 0].argmax()
        return np.array([[-1.0, points[low, 0]], [1.0, -points[high, 0]]]), np.array([[low], [high]])
    try:
        hull = ConvexHull(points, qhull_options=options)
    except QhullError as error:
        raise ProjectionError(f"Qhull: {str(error).splitlines()[0]}") from error
    return hull.equations, hull.simplices


def _is_closed(simplices):
    """Whether every side of every simplex (m, q) is the side of another one."""
    size = simplices.shape[1]
    sides = np.concatenate([np.delete(simplices, i, axis=1) for i in range(size)])
    _, counts = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    return (counts % 2 == 0).all()


def _refined(hints, simplices, rays):
    """The faces that Qhull hints at, computed again from the rays that they touch, each once.

    Qhull's simplices must form a closed surface. If every simplex lies in a face that has all rays on one side, the
    surface is the whole boundary, so no face is missing. Simplices without area, which Qhull makes where more rays than
    needed share a face, lie in the faces of their neighbours.
    """
    if not _is_closed(simplices):
        raise ProjectionError("the cone is not closed: Qhull's simplices leave a gap")
    faces = []
    closed = np.zeros(len(simplices), dtype=bool)
    for i, (hint, simplex) in enumerate(zip(hints, simplices, strict=True)):
        if closed[i]:
            continue
        for reach in HINT_REACH:
            touched = np.abs(rays @ hint) <= reach
            touched[simplex] = True
            _, sizes, axes = np.linalg.svd(rays[touched])
            face = axes[-1] * np.sign(axes[-1] @ hint)
            products = rays @ face
            on = np.abs(products) < TIGHT
            if sizes[rays.shape[1] - 2] > RANK and products.max() < VALID and on[simplex].all():
                faces.append(face)
                closed |= on[simplices].all(axis=1)
                break
    if not closed.all():
        raise ProjectionError(f"the cone is not closed: {(~closed).sum()} of {len(closed)} simplices are in no face")
    return np.array(faces)
