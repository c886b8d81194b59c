"""The contacts seen from above, as ground for maps and velocity areas."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.plotting.style import DARK, axes_or_new, halo

LARGEST = 0.5
"""Corners of a foot or a hand are at most this far apart [m]; farther apart they are four feet."""
IN_ONE_PLANE = 1e-6
"""Corners this close to a rectangle's are its corners [m]."""


def footprint(contacts: ContactSet, *, color: ColorType = DARK, ax: Axes | None = None) -> Axes:
    """The contacts seen from above: feet and hands as outlines, single points as crosses.

    Args:
        contacts: One set; masked contacts are left out.
        color: Of outlines and crosses.
        ax: Axes to draw into; by default those of a new figure.

    Returns:
        The axes.
    """
    ax = axes_or_new(ax, (6.4, 5.6))
    for corners in patches(contacts):
        x, y = corners[:, :2].T
        if len(corners) == 1:
            ax.plot(x, y, marker="x", markersize=8, markeredgewidth=2, color=color, path_effects=halo(), zorder=5)
        else:
            ax.fill(x, y, facecolor="none", edgecolor=color, linewidth=1.5, path_effects=halo(3), zorder=5)
    ax.set(aspect="equal", xlabel=ax.get_xlabel() or "x [m]", ylabel=ax.get_ylabel() or "y [m]")
    return ax


def patches(contacts: ContactSet) -> list[Float[np.ndarray, "c 3"]]:
    """Corners of the feet and hands (4, 3), and single points (1, 3) [m].

    A foot or a hand is what `rectangle` makes: four rows of one frame, the corners of a rectangle along its tangents.
    """
    active = np.asarray(contacts.mask)
    points, frames = np.asarray(contacts.points, float)[active], np.asarray(contacts.frames, float)[active]
    found, row = [], 0
    while row < len(points):
        size = 4 if _rectangle(points[row : row + 4], frames[row : row + 4]) else 1
        found.append(points[row : row + size])
        row += size
    return found


def _rectangle(points: Float[np.ndarray, "k 3"], frames: Float[np.ndarray, "k 3 3"]) -> bool:
    """Whether these are four corners in order around a rectangle along the tangents of their one frame."""
    if len(points) < 4 or not np.allclose(frames, frames[0], atol=IN_ONE_PLANE):
        return False
    local = (points - points.mean(axis=0)) @ frames[0]
    half = np.abs(local[0])
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    corners = np.column_stack([signs * half[:2], np.zeros(4)])
    small = 2 * np.linalg.norm(half) <= LARGEST
    return bool(small and half[:2].min() > IN_ONE_PLANE and np.abs(local - corners).max() <= IN_ONE_PLANE)
