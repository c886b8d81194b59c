"""The capture region on surfaces: where a new contact lets the robot stop, painted on floor, wall and rail."""

from typing import Any

import numpy as np
from contourpy import contour_generator
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import TwoSlopeNorm
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from jaxcap.contacts.surfaces import Candidates
from jaxcap.plotting.style import DARK, GREY, axes_or_new

ALONE = 0.02
"""Half of the width of what is one row wide, as it is drawn [m]."""
COLORS = "PuOr"
"""Colours of margins: told apart by colour-blind readers, pale where the sign changes."""


def capture_region(
    candidates: Candidates, margin: Float[np.ndarray, "m"], *, limit: float = 1.0, ax: Axes | None = None
) -> Axes:
    """The margin of every candidate, painted where it is, and the line where it is zero: inside, the robot can stop.

    In axes of three dimensions as they lie in space; in others as seen from above.

    Args:
        candidates: From `candidates_on`.
        margin: (m,) of each, as `NextContacts.margin` [m/s]; where it is NaN the surface is grey.
        limit: The colours end at plus and minus this margin [m/s]: many are infinite.
        ax: Axes to draw into, of two or three dimensions; by default new ones of three.

    Returns:
        The axes.

    Raises:
        ValueError: For another number of margins than candidates, or a limit that is not positive.
    """
    margin = np.asarray(margin, float)
    if margin.shape != candidates.surface.shape:
        raise ValueError(f"margin has shape {margin.shape} (expected {candidates.surface.shape}: one for each candidate)")
    if not limit > 0:
        raise ValueError(f"limit = {limit} (expected a positive number of m/s)")
    axes: Any = axes_or_new(None, (6.8, 5.6), "3d") if ax is None else ax
    if ax is None:
        axes.computed_zorder = False  # lines on a surface, whatever the depth of its middle
    colors = ScalarMappable(TwoSlopeNorm(0, -limit, limit), COLORS)
    for owner, shape in enumerate(candidates.grids):
        mine = candidates.surface == owner
        frame = np.asarray(candidates.contacts.frames)[mine][0, 0]
        grid = _Grid(shape, candidates.centres[mine], frame, np.clip(margin[mine], -limit, limit))
        paint = [GREY if np.isnan(value) else colors.to_rgba(value) for value in margin[mine]]
        _draw(axes, grid.cells(), paint, grid.zero())
    bar = axes.figure.colorbar(colors, ax=axes, shrink=0.7, pad=0.1, extend="both")
    bar.set_label("margin with a contact there [m/s]")
    names = ("xlabel", "ylabel", "zlabel") if isinstance(axes, Axes3D) else ("xlabel", "ylabel")
    axes.set(aspect="equal", **{name: f"{name[0]} [m]" for name in names})
    return axes


class _Grid:
    """The candidates of one surface, which `candidates_on` puts on a grid, flat or not."""

    def __init__(self, shape: tuple[int, int], centres: np.ndarray, frame: np.ndarray, margin: np.ndarray):
        self._shape, self._frame = shape, frame
        self._centres, self._margin = centres.reshape(*shape, 3), margin.reshape(shape)

    def cells(self) -> np.ndarray:
        """Corners of a cell around each candidate (m, 4, 3) [m]."""
        by_length = _borders(self._centres, self._frame[:, 0])
        nodes = np.swapaxes(_borders(np.swapaxes(by_length, 0, 1), self._frame[:, 1]), 0, 1)
        corners = nodes[1:, 1:], nodes[:-1, 1:], nodes[:-1, :-1], nodes[1:, :-1]
        return np.stack([each.reshape(-1, 3) for each in corners], axis=1)

    def zero(self) -> list[np.ndarray]:
        """Lines of zero margin, (k, 3) each [m]; none on a surface that is one row wide."""
        if min(self._shape) < 2:
            return []
        lines: Any = contour_generator(z=np.ma.masked_invalid(self._margin).T).lines(0.0)
        return [self._at(line) for line in lines]

    def _at(self, line: np.ndarray) -> np.ndarray:
        """Points between the candidates, from their numbers (k, 2) along length and width."""
        first = np.minimum(line.astype(int), np.subtract(self._shape, 2))
        (i, j), (u, v) = first.T, (line - first).T[:, :, None]
        near, far = ((1 - v) * self._centres[k, j] + v * self._centres[k, j + 1] for k in (i, i + 1))
        return (1 - u) * near + u * far


def _borders(rows: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Midway between rows of points (n, k, 3), and as far beyond the first and the last: (n + 1, k, 3).

    across: unit vector, the way to go from a row that is alone.
    """
    if len(rows) == 1:
        return np.concatenate([rows - ALONE * across, rows + ALONE * across])
    middle = (rows[1:] + rows[:-1]) / 2
    return np.concatenate([2 * rows[:1] - middle[:1], middle, 2 * rows[-1:] - middle[-1:]])


def _draw(axes: Any, cells: np.ndarray, paint: list, lines: list[np.ndarray]) -> None:
    if isinstance(axes, Axes3D):
        axes.add_collection3d(Poly3DCollection(cells, facecolors=paint, edgecolors=paint, linewidths=0.2, alpha=0.9))
        if lines:
            axes.add_collection3d(Line3DCollection(lines, colors=DARK, linewidths=2, zorder=10))
        low, high = cells.min(axis=(0, 1)), cells.max(axis=(0, 1))
        axes.auto_scale_xyz(*np.stack([low, high], axis=1), had_data=axes.has_data())
        return
    for corners, color in zip(cells, paint, strict=True):
        axes.fill(*corners[:, :2].T, facecolor=color, edgecolor=color, linewidth=0.2)
    for line in lines:
        axes.plot(*line[:, :2].T, color=DARK, linewidth=2)
