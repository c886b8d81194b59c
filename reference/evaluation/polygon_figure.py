"""Fig. 2: the polygon of feasible accelerations of one state, and the walk along its lower edge, by `reference.algorithm`.

Above, acceleration against place: what the contacts allow, where the CoM could rest, and the walk under maximum
deceleration. Below, the speed that is left. Left a state that can stop, right one that cannot.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reference.algorithm import Result, is_state_capturable
from reference.evaluation.figure_style import BLUE, GREY, RED, WIDE, save, styled
from reference.evaluation.margins import corners
from reference.evaluation.samples import Samples, among
from reference.oracles import feasible_polygon, static_interval

PALE = "#e4e4e4"
"""Of what is feasible."""

SAMPLES = (36, 44)
"""Of `three`: both walk along several edges before they end, the one at rest, the other not."""

SWINGS = 20
"""Passes allowed in C3.3, which the paper leaves open."""

KNOTS = 2001
"""Places at which edges and speeds are drawn."""

HIGHEST = 15.0
"""Accelerations shown [m/s^2]; harder braking is drawn here."""

FLAT = 1e-6
"""A polygon without width, as of one contact point, may have its edges crossed by this much [m/s^2]."""

REACH = 0.35
"""Places of rest that are farther from the walk are not shown [m]."""

ROOM = 0.3
"""What is shown on either side of all that, share of its extent [-]."""


class Line(NamedTuple):
    """One state on the line of its velocity."""

    rows: tuple[np.ndarray, np.ndarray, np.ndarray] | None
    """a, b, d of the polygon a acc + b alpha <= d; None if it is empty."""
    static: tuple[float, float] | None
    """Where it could rest [m]; None if nowhere."""
    speed: float
    """At the start [m/s]."""
    result: Result


def line_of(points, frames, friction, com, com_velocity) -> Line:
    """What Fig. 2 shows of one state; arguments as `is_state_capturable`, which raises ValueError at zero velocity."""
    result = is_state_capturable(points, frames, friction, com, com_velocity, swings=SWINGS)
    state = (points, frames, friction, com, com_velocity)
    return Line(feasible_polygon(*state), static_interval(*state), float(np.linalg.norm(com_velocity)), result)


def boundaries(rows, alphas: Float[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest acceleration (n,) [m/s^2] at these places [m]; NaN where none is feasible.

    rows: a, b, d of a acc + b alpha <= d, or None for the empty polygon.
    """
    if rows is None:
        return np.full(len(alphas), np.nan), np.full(len(alphas), np.nan)
    a, b, d = (np.asarray(column, float)[:, None] for column in rows)
    room = d - b * alphas
    with np.errstate(divide="ignore", invalid="ignore"):
        lower = np.where(a < 0, room / a, -np.inf).max(axis=0)
        upper = np.where(a > 0, room / a, np.inf).min(axis=0)
    outside = (lower > upper + FLAT) | np.any((a == 0) & (room < 0), axis=0)
    return np.where(outside, np.nan, lower), np.where(outside, np.nan, upper)


def speeds(alphas: Float[np.ndarray, " n"], accelerations: Float[np.ndarray, " n"], speed: float) -> np.ndarray:
    """Speed (n,) [m/s] at increasing places, the acceleration taken as linear in between: d(speed^2 / 2) = acc d(alpha)."""
    work = np.concatenate([[0.0], np.cumsum(np.diff(alphas) * (accelerations[1:] + accelerations[:-1]) / 2)])
    return np.sqrt(np.maximum(speed**2 + 2 * work, 0.0))


def window(line: Line) -> tuple[float, float]:
    """First and last place shown [m]: start and end of the walk, places of rest within REACH of it, and room around them."""
    first, last = sorted((0.0, line.result.alpha_final))
    places = [first, last, *np.clip(line.static or (), first - REACH, last + REACH)]
    extent = max(np.ptp(places), 1e-3)
    return min(places) - ROOM * extent, max(places) + ROOM * extent


def polygon(samples: dict[str, Samples], folder: Path) -> list[Path]:
    """Fig. 2 of two samples of `three`; of its first two if it has not got SAMPLES."""
    (file,) = among(samples, "three")
    points, frames, friction = corners(file.contacts)
    rows = np.flatnonzero(np.isin(file.index, SAMPLES))
    lines = {}
    for row in rows if len(rows) == len(SAMPLES) else range(min(len(SAMPLES), len(file.index))):
        state = (points[row], frames[row], friction[row], file.com[row], file.com_velocity[row])
        lines[f"{file.scenario}, sample {file.index[row]}"] = line_of(*state)
    with styled():
        return save(drawn(lines), folder, "figure_2")


def drawn(lines: dict[str, Line]) -> Figure:
    """A column for each state, under these titles."""
    figure = Figure(figsize=(WIDE, 3.2), layout="constrained")
    grid = figure.subplots(2, len(lines), squeeze=False, sharex="col", height_ratios=(2.2, 1.0))
    for (above, below), (title, line) in zip(grid.T, lines.items(), strict=True):
        _draw_accelerations(above, line)
        _draw_speed(below, line)
        above.set_title(f"{title}: {_verdict(line.result)}")
        below.set(xlabel=r"place on the line of the velocity, $\alpha$ [m]", xlim=window(line))
    grid[0, 0].set_ylabel(r"acceleration $\ddot\alpha$ [m/s$^2$]")
    grid[1, 0].set_ylabel(r"speed $\dot\alpha$ [m/s]")
    signs = {label: sign for axes in grid[0] for sign, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(signs.values(), signs, loc="outside lower center", ncols=len(signs), handlelength=1.5, frameon=False)
    return figure


def _verdict(result: Result) -> str:
    speed, place = f"{result.alphadot_final:.2f} m/s left", f"at rest after {result.alpha_final:.2f} m"
    return f"{result.case.replace('_', '.')}, {speed if result.alphadot_final > 0 else place}"


def _draw_accelerations(axes: Axes, line: Line) -> None:
    """The polygon, the static region, and the walk along the lower edge."""
    alphas = np.linspace(*window(line), KNOTS)
    lower, upper = boundaries(line.rows, alphas)
    axes.fill_between(alphas, lower, upper, color=PALE, linewidth=0, label="feasible")
    for edge in (lower, upper):
        axes.plot(alphas, edge, color=GREY, linewidth=0.8)
    axes.axhline(0.0, color="black", linewidth=0.5)
    if line.static is not None:
        axes.plot(line.static, (0.0, 0.0), color=BLUE, linewidth=4, solid_capstyle="butt", label="can rest here")
    walked, braking = _walk(line)
    _draw_path(axes, line.result, walked, np.clip(braking, -HIGHEST, HIGHEST), label="maximum deceleration")
    shown = np.clip([-1.0, 1.0, *lower[np.isfinite(lower)], *upper[np.isfinite(upper)]], -HIGHEST, HIGHEST)
    axes.set_ylim(shown.min() - 0.06 * np.ptp(shown), shown.max() + 0.06 * np.ptp(shown))


def _draw_speed(axes: Axes, line: Line) -> None:
    """What is left of the speed on the way."""
    walked, braking = _walk(line)
    if line.static is not None:
        axes.axvspan(*line.static, color=BLUE, alpha=0.15, linewidth=0)
    _draw_path(axes, line.result, walked, speeds(walked, braking, line.speed), label=None)
    axes.set_ylim(0.0, 1.2 * line.speed)


def _draw_path(axes: Axes, result: Result, places: np.ndarray, heights: np.ndarray, label: str | None) -> None:
    """The walk, its start and its end."""
    axes.plot(places, heights, color=RED, linewidth=2.2, label=label, clip_on=False, zorder=3)
    axes.plot(places[0], heights[0], "o", color="white", markeredgecolor=RED, markersize=5, zorder=4)
    stops = result.alphadot_final == 0
    style = {"linestyle": "", "color": RED, "markeredgecolor": "white", "clip_on": False, "zorder": 4}
    style |= {"marker": "*", "markersize": 10} if stops else {"marker": "X", "markersize": 7}
    name = "at rest" if stops else "no deceleration left"
    axes.plot(places[-1], heights[-1], label=name if label else None, **style)


def _walk(line: Line) -> tuple[np.ndarray, np.ndarray]:
    """Places passed under maximum deceleration, from start to end [m], and the acceleration there [m/s^2]."""
    walked = np.linspace(0.0, line.result.alpha_final, KNOTS)
    return walked, boundaries(line.rows, walked)[0]
