"""The phase portrait (alpha, alphadot) along one state's line of travel, with the capturable band."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

import jaxcap
from jaxcap.contacts.cone import CentroidalCone
from jaxcap.contacts.conventions import GRAVITY, ArrayLike
from jaxcap.plotting.acceleration import endpoint, static_region
from jaxcap.plotting.style import BLUE, DARK, PALE, RED, axes_or_new
from jaxcap.plotting.travel import Travel, travel

COLUMNS = 512
"""Positions at which the band is computed."""


def phase_portrait(
    cone: CentroidalCone,
    com: ArrayLike,
    com_velocity: ArrayLike,
    *,
    gravity: ArrayLike = GRAVITY,
    ax: Axes | None = None,
) -> Axes:
    """Which speeds along the line of travel can be stopped, from which position on it, and what the CoM does.

    The band holds, for each position, the speeds from `min_speed` to `max_speed`, forwards above the axis and backwards
    below; it is hatched where no speed is too large. The rest is as in `polygon`.

    Args:
        cone: From `centroidal_cone`.
        com: (3,) [m], in the contacts' frame, and so are velocity and gravity.
        com_velocity: (3,) [m/s].
        gravity: (3,) [m/s^2].
        ax: Axes to draw into; by default those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For zero velocity, which has no line, or a state that is not finite.
        TypeError: For rays.
    """
    line = travel(cone, com, com_velocity, gravity)
    ax = axes_or_new(ax)
    alpha, bands = _bands(cone, np.asarray(com, float), line, gravity)
    top = _top(line, bands)
    for sign, (smallest, largest) in zip((1, -1), bands, strict=True):
        some = largest > 0
        ax.fill_between(
            alpha,
            sign * smallest,
            sign * np.minimum(largest, top),
            where=some,
            facecolor=PALE,
            zorder=2,
            linewidth=0,
            label="capturable" if sign > 0 else None,
        )
        for edge in (smallest, largest):
            ax.plot(alpha, np.where(some & np.isfinite(edge), sign * edge, np.nan), color=BLUE, linewidth=1.5, zorder=3)
        endless = largest == np.inf
        if endless.any():
            ax.fill_between(
                alpha,
                sign * smallest,
                sign * top,
                where=endless,
                facecolor="none",
                edgecolor=BLUE,
                hatch="//",
                linewidth=0,
                zorder=2,
                label="at any speed" if sign > 0 else None,
            )
    ax.axhline(0, color=DARK, linewidth=0.8, zorder=1)
    static_region(ax, line)
    if line.walk is not None:
        ax.plot(line.walk.alpha, line.walk.speed, color=RED, linewidth=2.8, zorder=5, label="walk")
    last, final = (float(line.walk.alpha[-1]), float(line.walk.speed[-1])) if line.walk else (0.0, 0.0)
    endpoint(ax, line, last, final, line.speed)
    ax.set(xlim=line.window, ylim=(-top, top), title=line.verdict)
    ax.set(xlabel=r"position along the line of travel $\alpha$ [m]", ylabel=r"speed $\dot\alpha$ [m/s]")
    ax.legend(loc="best", framealpha=0.9)
    return ax


Band = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]
"""Smallest and largest capturable speeds [m/s]."""


def _bands(
    cone: CentroidalCone, com: Float[np.ndarray, "3"], line: Travel, gravity: ArrayLike
) -> tuple[Float[np.ndarray, " n"], list[Band]]:
    """Positions (n,) [m]; and for both directions the capturable speeds there."""
    alpha = np.linspace(*line.window, COLUMNS)
    coms = com + alpha[:, None] * line.along
    found = [jaxcap.score(cone, coms, np.tile(sign * line.along, (COLUMNS, 1)), gravity) for sign in (1, -1)]
    return alpha, [(np.asarray(out.min_speed, float), np.asarray(out.max_speed, float)) for out in found]


def _top(line: Travel, bands: list[Band]) -> float:
    """The largest speed to show [m/s]."""
    largest = np.concatenate([largest for _, largest in bands])
    largest = largest[np.isfinite(largest)]
    speeds = np.concatenate([[line.speed], line.walk.speed if line.walk else []])
    return 1.15 * max(speeds.max(), min(largest.max(initial=0), 2 * speeds.max()))
