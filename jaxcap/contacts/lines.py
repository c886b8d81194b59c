"""The lines inside a cone, and the direction in which the rest of it points: both by least squares, without linear programs.

The shortest convex combination x of unit rays decides. Where it is not zero, it has a product of at least |x|^2 with every
ray, so a plane across it cuts all rays, and no plane cuts them closer to their middle: the cone is pointed. Where it is
zero, the rays that take part have their opposites in the cone; their span is divided out, and what is left is asked again.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxcap.contacts import rationals

RANK = 1e-11
"""Singular values below this times the largest are zero. Rays have unit length."""
CLEAR = 1e-3
"""Directions of lines are taken together if their singular values are not below this times the largest; fainter ones are
looked at again, at their own scale, when the others have been divided out."""
NEAR = 1e-6
"""Rays with less than this outside the lines are taken for rays along them, to fit the lines to."""
FAINT = 1e-3
"""Of rays with less than this outside the lines, what is left is checked on its own."""
TAKES_PART = 1e-3
"""Weights below this times the largest do not show that a ray's opposite lies in the cone."""


class Parts(NamedTuple):
    """A cone is its lines and a pointed rest, at right angles."""

    lines: Float[np.ndarray, "l d"]
    """Orthonormal rows."""
    pointed: Float[np.ndarray, "r d"]
    """Orthonormal rows, which span the rest."""
    inside: Float[np.ndarray, " r"]
    """Unit vector in the space of the rest, with a positive product with every ray of it."""
    zero: float
    """Rays with less than this outside the lines lie in them."""


def split(
    rays: Float[np.ndarray, "n d"], basis: Float[np.ndarray, "r d"], smallest: float = RANK
) -> tuple[Float[np.ndarray, "s d"], Float[np.ndarray, "t d"]]:
    """Orthonormal rows spanning the rays' part of the space spanned by `basis`, and rows spanning the rest of that space."""
    inside = rays @ basis.T
    # With as many rows as columns, at least, the reduced decomposition has all axes, those of the rest too.
    padded = np.concatenate([inside, np.zeros((max(0, len(basis) - len(inside)), len(basis)))])
    _, sizes, axes = np.linalg.svd(padded, full_matrices=False)
    rank = int((sizes > smallest * max(sizes.max(initial=0), np.finfo(float).tiny)).sum())
    return axes[:rank] @ basis, axes[rank:] @ basis


def parts(rays: Float[np.ndarray, "n d"], span: Float[np.ndarray, "s d"], opposite: float, zero: float) -> Parts:
    """The lines of a cone and its pointed rest.

    Args:
        rays: of unit length.
        span: orthonormal rows that span the same space.
        opposite: unit rays with a convex combination this short have their opposites in the cone.
        zero: rays with less than this outside the lines lie in them.

    Returns:
        The parts; without a rest, `pointed` has no rows.
    """
    lines, pointed = span[:0], span
    while True:
        rest = rays @ pointed.T
        sizes = np.linalg.norm(rest, axis=1)
        left_over = sizes > zero
        if not left_over.any():
            return Parts(np.concatenate([lines, pointed]), pointed[:0], np.zeros(0), zero)
        rest = rest[left_over] / sizes[left_over, None]
        weights = _shortest(rest)
        length = np.linalg.norm(weights @ rest)
        if length > opposite:
            return Parts(lines, pointed, _inside(rest, weights), zero)
        # A ray that takes part with weight w has its opposite in the cone, up to length / w.
        _, pointed = split(rest[weights > TAKES_PART * weights.max()] @ pointed, pointed, CLEAR)
        lines, pointed = _fitted(rays, span, pointed)


def distance_of_parts(rays: Float[np.ndarray, "n d"], found: Parts, enough: float) -> float:
    """How far the lines, and what they leave of rays that are nearly along them, are from the cone of the rays, about.

    It is the check of the parts. What is left of a ray is the ray less its part along the lines, which is in the cone if
    they are; but where little is left, an error of the lines is large beside it.

    Args:
        rays: of unit length.
        found: from `parts`.
        enough: distances up to this need not be known more exactly.

    Returns:
        The largest distance of a unit vector.
    """
    if len(found.lines) == 0:
        return 0.0
    rest = rays @ found.pointed.T
    sizes = np.linalg.norm(rest, axis=1)
    faint = (sizes > found.zero) & (sizes < FAINT)
    targets = np.concatenate(
        [
            found.lines,
            -found.lines.sum(axis=0, keepdims=True) / np.sqrt(len(found.lines)),  # they span the lines' space
            (rest[faint] / sizes[faint, None]) @ found.pointed,
        ]
    )
    farthest = 0.0
    for target in targets:
        distance = _distance(rays, target)
        farthest = max(farthest, distance if distance <= enough else min(distance, rationals.distance(rays, target)))
        if farthest > enough:
            break
    return farthest


def _distance(rays: Float[np.ndarray, "n d"], target: Float[np.ndarray, " d"]) -> float:
    """Of a unit vector from the cone, with what rounding makes of large weights."""
    from scipy.optimize import nnls  # a heavy import, as in `cone_hull`

    try:
        weights, _ = nnls(rays.T, target)
    except RuntimeError:  # too many iterations
        return float(np.inf)
    return float(np.linalg.norm(weights @ rays - target) + np.finfo(float).eps * weights.sum())


def _fitted(
    rays: Float[np.ndarray, "n d"], span: Float[np.ndarray, "s d"], pointed: Float[np.ndarray, "r d"]
) -> tuple[Float[np.ndarray, "l d"], Float[np.ndarray, "r d"]]:
    """The lines' space, from all rays near it, and the rest of the span.

    Faint directions were found from short remainders of rays, so to few digits; other rays lie along them with all of their
    length.
    """
    _, lines = split(pointed, span, 0.5)
    near = np.linalg.norm(rays @ pointed.T, axis=1) < NEAR
    inside = rays[near] @ span.T
    padded = np.concatenate([inside, np.zeros((max(0, len(span) - len(inside)), len(span)))])
    _, sizes, axes = np.linalg.svd(padded, full_matrices=False)
    rank = len(lines)
    # Only where these rays span as many dimensions, and all of them clearly, do they say where the lines are.
    clear = 0 < rank < len(span) and sizes[rank - 1] > CLEAR * sizes[0] and sizes[rank] < CLEAR * sizes[rank - 1]
    return (axes[:rank] @ span, axes[rank:] @ span) if clear else (lines, pointed)


def _shortest(rays: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
    """Weights of the shortest convex combination (Lawson and Hanson, Solving Least Squares Problems, 1974, chapter 23)."""
    from scipy.optimize import nnls  # a heavy import, as in `cone_hull`

    ones = np.ones((1, len(rays)))
    weights, _ = nnls(np.concatenate([rays.T, ones]), np.r_[np.zeros(rays.shape[1]), 1.0])
    return weights / weights.sum()


def _inside(rays: Float[np.ndarray, "n d"], weights: Float[np.ndarray, " n"]) -> Float[np.ndarray, " d"]:
    """Unit vector with a positive product with every ray, from the weights of the shortest combination.

    It is that combination's direction. Solved for anew, from the rays that take part: where rays nearly oppose each other,
    that is a small difference of large numbers, and its direction is known to few digits only. But weights that are zero
    but for rounding let rays take part that are none of it, and the direction then stands away from others: so the
    combination itself is taken where it is clearly farther from the nearest ray.
    """
    taking_part = rays[weights > 0]
    solved, combined = np.linalg.lstsq(taking_part, np.ones(len(taking_part)), rcond=1e-14)[0], weights @ rays
    solved, combined = solved / np.linalg.norm(solved), combined / np.linalg.norm(combined)
    return solved if 2 * (rays @ solved).min() > (rays @ combined).min() else combined
