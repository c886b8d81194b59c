"""Velocity areas: the velocities that a CoM can be stopped from, in the velocity plane and over the stance."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Num
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.patches import Patch
from matplotlib.typing import ColorType
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from jaxcap.contacts.conventions import FloatArray
from jaxcap.plotting.style import BLUE, DARK, GREY, axes_or_new
from jaxcap.regions.velocity_area import VelocityArea

CUT = 1.3
"""Speeds are cut a little beyond the largest finite one, at this many times that one ..."""
TYPICAL, TYPICAL_OF_ALL = 8.0, 4.0
"""... or this many times the median, if that is less; the second is for several areas, where there is less room."""
FILL = 0.8
"""Length of the longest speed over the stance, relative to the distance between neighbours: few areas go all around."""
BEYOND = "////"
"""Hatch where an area goes on."""
CLOSEST = 0.02
"""Positions are taken to be no closer than this [m]."""


def velocity_area(
    area: VelocityArea,
    *,
    longest: float | None = None,
    color: ColorType = BLUE,
    label: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """The horizontal CoM velocities that can be stopped from one place, in the velocity plane.

    Where it goes on beyond the cut, perhaps without end, the area is hatched and has no edge; where a direction is undecided
    it is dotted grey.

    Args:
        area: From `jaxcap.velocity_area`, for one CoM and its `headings`.
        longest: Larger speeds are cut to this [m/s], by default those that are far above the others.
        color: Of the area.
        label: Of the area, in a legend.
        ax: Axes to draw into; by default those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For an area of several CoM positions, or with directions that are not horizontal.
    """
    ax = axes_or_new(ax, (5.2, 4.8))
    _draw(ax, area, np.zeros(2), 1.0, _longest(area, longest), color, label)
    ax.axhline(0, color=DARK, linewidth=0.6, zorder=1)
    ax.axvline(0, color=DARK, linewidth=0.6, zorder=1)
    ax.set(aspect="equal", xlabel="CoM velocity x [m/s]", ylabel="CoM velocity y [m/s]")
    return ax


def velocity_areas(
    areas: VelocityArea,
    coms: Num[FloatArray, "k d"],
    *,
    scale: float | None = None,
    longest: float | None = None,
    color: ColorType = BLUE,
    label: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Velocity areas of several CoM positions as polar plots, each over its place, seen from above.

    A dot marks a place where the robot can stand, a ring one where it cannot. A bar gives the scale. The rest is as in
    `velocity_area`; `footprint` draws the contacts.

    Args:
        areas: From `jaxcap.velocity_area`, for k CoM positions and their `headings`.
        coms: (k, 2) or (k, 3) [m].
        scale: Length drawn for a speed [m per m/s]; by default such that neighbours hardly overlap.
        longest: Larger speeds are cut to this [m/s], by default those that are well above the others.
        color: Of the areas.
        label: Of the areas, in a legend.
        ax: Axes to draw into; by default those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: Where the number of areas and positions differ.
    """
    coms = np.asarray(coms, float)[:, :2]
    if np.shape(areas.max_speed)[:-1] != (len(coms),):
        raise ValueError(f"areas are those of {np.shape(areas.max_speed)[:-1]} CoM positions (expected {(len(coms),)})")
    ax = axes_or_new(ax, (6.4, 5.6))
    longest = _longest(areas, longest)
    scale = FILL * _apart(coms) / longest if scale is None else scale
    for i, com in enumerate(coms):
        one = areas._replace(min_speed=areas.min_speed[i], max_speed=areas.max_speed[i], standing=areas.standing[i])
        _draw(ax, one, com, scale, longest, color, label if i == 0 else None)
    standing = np.asarray(areas.standing)
    style: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4, "zorder": 8, "markeredgecolor": DARK}
    handles: list[Artist] = []
    for which, shade, meaning in ((standing, DARK, "CoM, can stand"), (~standing, "white", "CoM, cannot stand")):
        dots = ax.plot(*coms[which].T, color=shade, label=meaning, **style)
        handles += dots if which.any() else []
    ax.set(aspect="equal", xlabel="CoM position x [m]", ylabel="CoM position y [m]")
    _scale_bar(ax, scale, longest)
    if (np.asarray(areas.max_speed) > longest).any():
        look: dict[str, Any] = {"facecolor": to_rgba(color, 0.45), "edgecolor": color, "linewidth": 0, "hatch": BEYOND}
        handles.append(Patch(label="faster than shown", **look))
    ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1), borderaxespad=0)  # covers nothing
    return ax


def _draw(
    ax: Axes,
    area: VelocityArea,
    centre: Float[np.ndarray, "2"],
    scale: float,
    longest: float,
    color: ColorType,
    label: str | None,
) -> None:
    """One area around its centre [m]; scale: of its speeds."""
    directions = np.asarray(area.directions)[:, :2]
    smallest, largest = np.asarray(area.min_speed, float), np.asarray(area.max_speed, float)
    for outline in area.outline(longest):
        ax.fill(*(centre + scale * outline).T, facecolor=to_rgba(color, 0.45), linewidth=0, zorder=6, label=label)
        label = None
    for edge in (largest, smallest):
        shown = (largest > 0) & np.isfinite(edge) & (edge <= longest)
        if not shown.any() or not edge[shown].any():
            continue
        curve = np.where(shown, edge, np.nan)[:, None] * directions
        curve = centre + scale * np.concatenate([curve, curve[:1]])
        ax.plot(*curve.T, color=color, linewidth=1.8, solid_joinstyle="round", zorder=7)
    for which, low, style in (
        (largest > longest, smallest, {"edgecolor": color, "hatch": BEYOND}),
        (np.isnan(largest), np.zeros_like(smallest), {"edgecolor": GREY, "hatch": "...."}),
    ):
        for outline in _only(area, which, low).outline(longest):
            ax.fill(*(centre + scale * outline).T, facecolor="none", linewidth=0, zorder=6, **style)


def _only(area: VelocityArea, which: Bool[np.ndarray, "n"], low: Float[np.ndarray, "n"]) -> VelocityArea:
    """The speeds above `low` in the directions `which`."""
    smallest: Any = np.where(which, low, 0.0)
    largest: Any = np.where(which, np.inf, 0.0)
    return area._replace(min_speed=smallest, max_speed=largest)


def _longest(area: VelocityArea, longest: float | None) -> float:
    """Where speeds are cut [m/s]."""
    if longest is not None:
        return longest
    speeds = np.asarray(area.max_speed, float)
    speeds = np.where(np.isfinite(speeds), speeds, 0)
    some = speeds[speeds > 0]
    if not some.size:
        return 1.0
    return CUT * min(some.max(), (TYPICAL if speeds.ndim == 1 else TYPICAL_OF_ALL) * np.median(some))


def _apart(coms: Float[np.ndarray, "k 2"]) -> float:
    """Distance from a position to its nearest neighbour [m], 1 for a single one."""
    if len(coms) < 2:
        return 1.0
    distance = np.linalg.norm(coms[:, None] - coms[None], axis=-1)
    return float(np.where(distance > CLOSEST, distance, np.inf).min()) if (distance > CLOSEST).any() else 1.0


def _scale_bar(ax: Axes, scale: float, longest: float) -> None:
    """A bar below on the right: the length of a round speed."""
    speed = 10 ** np.floor(np.log10(longest))
    speed *= next(factor for factor in (5, 2, 1) if factor * speed <= longest)
    bar = AnchoredSizeBar(ax.transData, scale * speed, f"{speed:g} m/s", "lower right", sep=4, frameon=False, color=DARK)
    bar.size_bar.get_children()[0].set(fill=True, linewidth=3)
    ax.add_artist(bar)
