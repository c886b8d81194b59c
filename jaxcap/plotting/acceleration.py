"""The (alpha, acceleration) polygon of one state, with the walk drawn on it: the paper's Fig. 2."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from jaxcap.contacts.cone import CentroidalCone
from jaxcap.contacts.conventions import GRAVITY, ArrayLike
from jaxcap.one_state.binding import BindingJoints
from jaxcap.plotting.style import BLUE, DARK, GREY, ORANGE, PALE, RED, axes_or_new, halo
from jaxcap.plotting.travel import Travel, travel

ABOVE = 0.12
"""Free space above and below the polygon, relative to its height."""
NAMED = 3
"""Joints that bind, at most, whose names are written."""


def polygon(
    cone: CentroidalCone,
    com: ArrayLike,
    com_velocity: ArrayLike,
    *,
    gravity: ArrayLike = GRAVITY,
    unlimited: CentroidalCone | None = None,
    binding: BindingJoints | None = None,
    ax: Axes | None = None,
) -> Axes:
    """The accelerations that keep the contacts, over the positions along the line of travel, and what the CoM does there.

    The thick bar is the static region, where zero acceleration is feasible. The red line is the walk, from the circle on:
    maximum deceleration, up to a stop (star), or to where the robot is lost (cross); in C3_2_1 the fastest way to rest at
    the static region, in C3_2_2 the least deceleration, which still stops too early.

    Args:
        cone: From `centroidal_cone`, or of a robot's posture from `actuated_cone`.
        com: (3,) [m], in the contacts' frame, and so are velocity and gravity.
        com_velocity: (3,) [m/s].
        gravity: (3,) [m/s^2].
        unlimited: Of the same contacts without the robot's limits: its polygon is drawn too, dashed, as
            far as the picture goes.
        binding: From `binding_joints`: which joints bind is said above the picture.
        ax: Axes to draw into; by default those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For zero velocity, which has no line, or a state that is not finite.
        TypeError: For rays.

    Source:
        Fig. 2 and Section III.
    """
    line = travel(cone, com, com_velocity, gravity)
    wider = (
        None if unlimited is None else travel(unlimited, com, com_velocity, gravity)._replace(window=line.window).region()
    )
    ax = axes_or_new(ax)
    region = line.region()
    low, high = _limits(line, region)
    ax.axhline(0, color=DARK, linewidth=0.8, zorder=1)
    if len(region):
        said = "feasible" if wider is None else "feasible for the robot's joints"
        ax.fill(*region.T, facecolor=PALE, edgecolor=BLUE, linewidth=1.5, zorder=2, label=said)
    else:
        ax.text(0.5, 0.9, "no acceleration keeps the contacts", transform=ax.transAxes, ha="center", color=DARK)
    if wider is not None and len(wider):
        style: Any = {"edgecolor": ORANGE, "linestyle": "--", "linewidth": 1.5}
        ax.fill(*wider.T, fill=False, zorder=2, label="for the contacts alone", **style)
    static_region(ax, line)
    _draw_walk(ax, line, low)
    ax.set(xlim=line.window, ylim=(low, high), title=line.verdict + _binds(binding))
    ax.set(xlabel=r"position along the line of travel $\alpha$ [m]", ylabel=r"acceleration $\ddot\alpha$ [m/s$^2$]")
    ax.legend(loc="best", framealpha=0.9)
    return ax


def _binds(binding: BindingJoints | None) -> str:
    """Which joints do, the first of them by name."""
    if binding is None:
        return ""
    names = [name if isinstance(name, str) else f"joint {name}" for name in binding.gains]
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    said = f"what binds: {', '.join(names[:NAMED])}{more}" if names else "no joint binds"
    return f"\n{said}"


def static_region(ax: Axes, line: Travel) -> None:
    """The static region as a bar on the horizontal axis, its ends named."""
    if line.static is None:
        return
    left, right = np.clip(line.static, *line.window)
    ax.plot([left, right], [0, 0], color=DARK, linewidth=5, solid_capstyle="butt", zorder=3, label="static region")
    for end, name in zip(line.static, (r"$s_\mathrm{min}$", r"$s_\mathrm{max}$"), strict=True):
        if np.isfinite(end):
            ax.axvline(end, color=GREY, linewidth=0.9, linestyle=":", zorder=1)
            ax.annotate(
                name, (end, 0), (0, 5), textcoords="offset points", ha="center", va="bottom", path_effects=halo(), zorder=6
            )


def endpoint(ax: Axes, line: Travel, alpha: float, height: float, before: float) -> None:
    """Start and end of a walk. height, before: vertical coordinate of the end and of the start."""
    style: dict[str, Any] = {"color": "white", "markeredgecolor": RED, "markeredgewidth": 1.8, "zorder": 7}
    style["linestyle"] = "none"
    ax.plot([0], [before], marker="o", markersize=8, label="start", **style)
    if line.walk is None:
        return
    if line.walk.speed[-1] == 0:
        ax.plot([alpha], [height], marker="*", markersize=14, label="comes to rest", **style)
    else:
        speed = line.walk.speed[-1]
        ax.plot([alpha], [height], marker="X", markersize=11, label=f"lost, at {speed:.2f} m/s", **style)


def _draw_walk(ax: Axes, line: Travel, low: float) -> None:
    if line.walk is None:
        endpoint(ax, line, 0.0, 0.0, 0.0)
        return
    height = np.maximum(line.walk.acceleration, low)
    ax.plot(line.walk.alpha, height, color=RED, linewidth=2.8, zorder=5, label="walk")
    endpoint(ax, line, float(line.walk.alpha[-1]), float(height[-1]), float(height[0]))


def _limits(line: Travel, region: Float[np.ndarray, "k 2"]) -> tuple[float, float]:
    """Vertical limits: around what there is to see, but no space beyond what is not shown to its end."""
    shown = np.concatenate([[0.0], region[:, 1], line.walk.acceleration if line.walk else []])
    low, high = (np.clip(end, -line.steepest, line.steepest) for end in (shown.min(), shown.max()))
    space = ABOVE * max(1.0, high - low)
    return max(low - space, -line.steepest), min(high + space, line.steepest)
