"""Fig. 7: paths of the CoM of robots that stopped, laid onto the predicted one.

Left, robots that were predicted to stop (true negatives: the event is a fall), right, robots that were predicted to fall
(false positives), a row for each scenario. A path is moved, turned and scaled so that the predicted one goes from (0, 0, 0)
to (1, 0, 0): x is along the initial velocity; z is orthogonal to it and to the world's y axis, and points up; y completes
the frame. The unit of length is the distance at which the braking pass of Algorithm 1 ends, which for a robot that is
predicted to fall is where it can no longer decelerate, or has no acceleration left at all, at a speed that is not zero: the
paper does not say what else its predicted path would be. States whose pass ends within SHORTEST have no such path, and are
left out and counted.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from reference.algorithm import is_state_capturable
from reference.evaluation import output, replay
from reference.evaluation.figure_style import BLUE, GREY, RED, WIDE, save, styled
from reference.evaluation.margins import corners, score
from reference.evaluation.roc_figures import TITLES
from reference.evaluation.samples import BEST, Samples, among

PATHS = 100
"""On each side, as in the paper."""

SIDES = ("predicted to stop", "predicted to fall")
"""True negatives and false positives, of robots that stopped."""

SEED = 2018
"""Of the choice."""

SHORTEST = 1e-3
"""Predicted paths that are shorter are left out [m]."""

SWINGS = 20
"""Passes allowed in C3.3, which the paper leaves open."""

FAR, ASIDE = 2.1, 0.6
"""What is shown along the prediction and to either side of it [-]; paths that go farther are cut off."""

STEPS = 10
"""Of the simulation between two points that are drawn."""


NOTE = """Robots that stopped. Lengths in those of the predicted path: median, quartiles. Left out: predicted to
end within 1 mm, so that there is no path to scale. Fell now: did not stop when simulated again."""


class Side(NamedTuple):
    """Paths of one column of the figure."""

    paths: list[Float[np.ndarray, "m 3"]]
    """On the unit segment [-]."""
    cells: int
    """Samples of this cell in the file."""
    short: int
    """Met on the way, but predicted to end within SHORTEST, or at rest from the start."""
    changed: int
    """Did not stop when simulated again."""


def onto_prediction(
    com: Float[np.ndarray, "n 3"], velocity: Float[np.ndarray, 3], length: float
) -> Float[np.ndarray, "n 3"]:
    """A path in the frame of its prediction: its start is the origin, and `length` along `velocity` is (1, 0, 0).

    com: [m], the first is the start. velocity: at the start [m/s], not zero. length: [m], > 0.
    """
    along = velocity / np.linalg.norm(velocity)
    up = np.cross(along, (0.0, 1.0, 0.0))
    if not np.linalg.norm(up) > 1e-9:  # along the y axis itself
        up = np.array([0.0, 0.0, 1.0])
    up = up / np.linalg.norm(up) * (1.0 if up[2] >= 0 else -1.0)
    frame = np.stack([along, np.cross(up, along), up])
    return (com - com[0]) @ frame.T / length


def stopped_by(samples: Samples) -> Int[np.ndarray, " n"]:
    """Number of the first controller that stopped the robot; -1 where none did."""
    stopped = np.array([samples.runs[name].outcomes == "stopped" for name in samples.controllers])
    return np.where(stopped.any(axis=0), stopped.argmax(axis=0), -1)


def sides(samples: Samples, capturable: Bool[np.ndarray, " n"], most: int = PATHS) -> dict[str, Side]:
    """Robots that stopped and were predicted to stop, or to fall: at most so many of each, chosen at random."""
    stopped = samples.outcomes[BEST] == "stopped"
    random = np.random.default_rng(SEED)
    cells = zip(SIDES, (stopped & capturable, stopped & ~capturable), strict=True)
    return {name: _side(samples, np.flatnonzero(cell), most, random) for name, cell in cells}


def _side(samples: Samples, rows: Int[np.ndarray, " r"], most: int, random: np.random.Generator) -> Side:
    states = (*corners(samples.contacts), samples.com, samples.com_velocity)
    lengths, short = {}, 0
    for row in random.permutation(rows):
        length = predicted_length(*(values[row] for values in states))
        if length < SHORTEST:
            short += 1
        else:
            lengths[int(row)] = length
        if len(lengths) == most:
            break
    chosen = list(lengths)
    controllers = [samples.controllers[number] for number in stopped_by(samples)[chosen]]
    runs = replay.paths(samples, chosen, controllers)
    paths = [
        onto_prediction(run.com, samples.com_velocity[row], lengths[row])
        for row, run in zip(chosen, runs, strict=True)
        if run.outcome == "stopped"
    ]
    return Side(paths, len(rows), short, len(chosen) - len(paths))


def predicted_length(points, frames, friction, com, com_velocity) -> float:
    """How far the braking pass of Algorithm 1 goes [m]; 0 at zero velocity."""
    if not np.any(com_velocity):
        return 0.0
    return is_state_capturable(points, frames, friction, com, com_velocity, swings=SWINGS).alpha_final


def com_paths(samples: dict[str, Samples], folder: Path) -> list[Path]:
    """Fig. 7, of each scenario, and a table of how far the paths go and stray."""
    files = among(samples, *TITLES)
    found = {TITLES[file.name]: sides(file, score(file, folder)["capturable"].astype(bool)) for file in files}
    table = Path(folder) / "figure_7.md"
    output.write(table, described(found).encode())
    with styled():
        return [*save(drawn(found), folder, "figure_7"), table]


def reach(side: Side) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """Of each path: where its end is along the prediction, and how far it strays from that line at most [-]."""
    ends = np.array([path[-1, 0] for path in side.paths])
    return ends, np.array([np.linalg.norm(path[:, 1:], axis=1).max() for path in side.paths])


def described(found: dict[str, dict[str, Side]]) -> str:
    """A table in Markdown, a line for each side of each scenario; medians with quartiles."""
    spread = lambda values: "{1:.2f} ({0:.2f} to {2:.2f})".format(*np.quantile(values, [0.25, 0.5, 0.75]))
    lines = [
        "| | | in the file | paths | left out | fell now | end along the prediction | stray at most | end beyond it |",
        "|---" * 9 + "|",
    ]
    for title, columns in found.items():
        for name, side in columns.items():
            counts = f"{title} | {name} | {side.cells} | {len(side.paths)} | {side.short} | {side.changed}"
            ends, strays = reach(side)
            figures = f"{spread(ends)} | {spread(strays)} | {np.mean(ends > 1):.0%}" if side.paths else "- | - | -"
            lines.append(f"| {counts} | {figures} |")
    return "\n".join([*lines, "", NOTE, ""])


def drawn(found: dict[str, dict[str, Side]]) -> Figure:
    """A row for each scenario; in it, for each side under its name, the xy plane and the xz plane."""
    figure = Figure(figsize=(WIDE, 0.8 + 1.0 * len(found)), layout="constrained")
    grid = figure.subplots(len(found), 2 * len(SIDES), squeeze=False, sharex=True, sharey=True)
    for row, (title, columns) in zip(grid, found.items(), strict=True):
        row[0].set_ylabel(title.replace(", ", ",\n"))
        for number, (name, color) in enumerate(zip(SIDES, (BLUE, RED), strict=True)):
            side = columns[name]
            for axes, axis in zip(row[2 * number : 2 * number + 2], (1, 2), strict=True):
                _draw(axes, side, axis, color)
            row[2 * number].text(
                0.02, 0.97, f"{len(side.paths)} of {side.cells:,}", transform=row[2 * number].transAxes, va="top"
            )
    for number, axes in enumerate(grid[0]):
        axes.set_title(f"{SIDES[number // 2]}: {'yz'[number % 2]}")
    for axes in grid[-1]:
        axes.set_xlabel("x, along the velocity")
    line = lambda label, **style: Line2D([], [], label=label, **style)
    dot, star = {"marker": ".", "color": GREY, "linewidth": 0.8}, {"marker": "*", "color": "black", "markersize": 8}
    signs = [line("CoM of the simulated robot, dot where it stopped", **dot)]
    signs.append(line("predicted path and its end; its length is the unit of both axes", **star))
    figure.legend(handles=signs, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _draw(axes: Axes, side: Side, axis: int, color: str) -> None:
    """Paths in the plane of x and another axis, the predicted one above them."""
    for path in side.paths:
        axes.plot(path[::STEPS, 0], path[::STEPS, axis], color=color, linewidth=0.4, alpha=0.6)
        axes.plot(path[-1, 0], path[-1, axis], ".", color=color, markersize=2)
    axes.plot([0, 1], [0, 0], color="black", linewidth=1.0)
    axes.plot(1, 0, "*", color="black", markersize=8, markeredgecolor="white", markeredgewidth=0.6)
    axes.set(aspect="equal", xlim=(-0.1, FAR), ylim=(-ASIDE, ASIDE))
    axes.xaxis.set_major_locator(MultipleLocator(0.5))
    axes.yaxis.set_major_locator(MultipleLocator(0.5))
    axes.grid(color="#e8e8e8", linewidth=0.4)
    axes.set_axisbelow(True)
