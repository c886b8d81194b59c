"""Figures 4, 5, 6 and 9: ROC curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter

from reference.evaluation.figure_style import BAND, GREY, NARROW, STROKES, WIDE, Stroke, save, styled
from reference.evaluation.margins import MARGINS, compared, everywhere
from reference.evaluation.paper import STATED, Stated
from reference.evaluation.roc import SEED, Interval, Point, Roc, area, band, curve, judged, point
from reference.evaluation.samples import BEST, FOUR, MissingFile, Samples, among

TITLES = {
    "two_coplanar": "two coplanar feet",
    "two": "two feet",
    "three": "two feet, one hand",
    "four": "two feet, two hands",
    "four_strong": "two feet, two hands, strong pushes",
}

CONTROLLERS = {
    "standard": "standard",
    "straight": "straight CoM path",
    "no_torque": "no torque limits",
    "no_position": "no position limits",
    "no_position_torque": "no position, no torque limits",
    "no_position_velocity": "no position, no velocity limits",
    "no_limits": "no limits",
    "constant_momentum": "constant angular momentum",
}
"""Names of the controllers in words."""

LIMITS = ("standard", "no_torque", "no_position", "no_position_torque", "no_position_velocity", "no_limits")
"""Controllers of Fig. 5."""

CONSTRAINTS = {
    "ablations": {"standard": "standard", "straight": "straight CoM path"},
    "zero_momentum": {
        "standard": "standard, no initial angular momentum",
        "constant_momentum": "constant (no) angular momentum",
    },
}
"""Controllers of Fig. 6, by the kind of file they are in."""

GRID = np.linspace(0.0, 1.0, 401)
"""False alarms at which bands are computed."""

SUBSAMPLES, SHARE = 50, 0.1
"""Of Fig. 9: how many, and how much of all samples each of them is."""

STAR = 7.5
"""Size of a star [points]."""

CORNER = 0.3
"""Side of the square at the upper left that is shown larger where all stars lie in it."""


class Curve(NamedTuple):
    """What is drawn of one margin and one set of outcomes."""

    label: str
    stroke: Stroke
    star_size: float
    """Of a margin of zero [points]; 0 if that means nothing."""
    roc: Roc
    area: Interval
    star: Point | None
    """At a margin of zero, if that means something."""
    band: Float[np.ndarray, "2 g"] | None
    """Detection on GRID, lower and upper end."""
    stated: Stated | None
    """By the paper's text."""


def five_margins(samples: dict[str, Samples], folder: Path) -> list[Path]:
    """Fig. 4: the five margins against the best of three controllers, a panel for each scenario."""
    return _five_margins(among(samples, *TITLES), folder, "figure_4", BEST, np.inf)


def five_margins_held(samples: dict[str, Samples], folder: Path) -> list[Path]:
    """Fig. 4 again: postures that can be held, and the best of four controllers."""
    files = [file for file in among(samples, *TITLES) if FOUR in file.outcomes]
    if not files:
        raise MissingFile("no file has a fourth controller")
    return _five_margins(files, folder, "figure_4_held", FOUR, 1.0)


def _five_margins(files: list[Samples], folder: Path, name: str, truth: str, effort: float) -> list[Path]:
    """A panel for each file, of the samples up to that effort."""
    panels = {}
    for file in files:
        margins = compared(file, folder)
        used, fell = judged(file.outcomes[truth], among=everywhere(margins) & (file.effort <= effort))
        title = f"{TITLES[file.name]}: {fell.sum():,} falls, {(~fell).sum():,} stops"
        stated = STATED.get((file.name, truth))
        panels[title] = [
            _curve(place, margins[margin.column][used], fell, margin.label, STAR if margin.has_zero else 0, stated)
            for place, margin in enumerate(MARGINS)
        ]
        panels[title][0] = panels[title][0]._replace(star_size=1.5 * STAR)  # that of the paper's margin lies upon it
    return _drawn(panels, folder, name, "exact margin, 95 % band")


def without_limits(samples: dict[str, Samples], folder: Path) -> list[Path]:
    """Fig. 5: the exact margin against controllers without some of the robot's limits."""
    files = among(samples, "three_ablations", "two_ablations")
    labels = {name: CONTROLLERS[name] for name in LIMITS}
    panels = {TITLES[file.scenario]: _controllers(file, folder, labels) for file in files}
    return _drawn(panels, folder, "figure_5", "standard, 95 % band")


def with_constraints(samples: dict[str, Samples], folder: Path) -> list[Path]:
    """Fig. 6: the exact margin against controllers that keep the CoM on a line, or the angular momentum constant."""
    files = among(samples, *(f"{scenario}_{kind}" for scenario in ("two", "three") for kind in CONSTRAINTS))
    panels: dict[str, list[Curve]] = {}
    for file in files:
        curves = panels.setdefault(TITLES[file.scenario], [])
        controllers = CONSTRAINTS[file.name.removeprefix(f"{file.scenario}_")]
        curves += _controllers(file, folder, controllers, 2 * list(CONSTRAINTS.values()).index(controllers))
    return _drawn(panels, folder, "figure_6", "standard, 95 % band")


def subsamples(samples: dict[str, Samples], folder: Path) -> list[Path]:
    """Fig. 9: curves of the exact margin from random subsamples of `three`, and the curve of all its samples."""
    (file,) = among(samples, "three")
    used, fell = judged(file.outcomes[BEST])
    margin = compared(file, folder)["margin"][used]
    choices = chosen_subsamples(len(fell))
    with styled():
        figure, (axes,) = _panels(1, 1)
        for choice in choices:
            axes.plot(*curve(margin[choice], fell[choice]), color=GREY, linewidth=0.3)
        whole = _curve(0, margin, fell, f"all {len(fell):,} samples", STAR, None)
        _draw(axes, [whole])
        _finish(axes, TITLES["three"])
        some = Line2D([], [], color=GREY, linewidth=0.6, label=f"{len(choices)} times {len(choices[0]):,} of them")
        _explain(figure, [whole], some, Patch(color=BAND, label="95 % band of all"))
        return save(figure, folder, "figure_9")


def chosen_subsamples(n: int) -> list[Int[np.ndarray, " m"]]:
    """Fig. 9's choices of SHARE of n samples, without replacement, by SEED."""
    random = np.random.default_rng(SEED)
    return [random.choice(n, max(1, round(SHARE * n)), replace=False) for _ in range(SUBSAMPLES)]


def _controllers(file: Samples, folder: Path, labels: dict[str, str], first: int = 0) -> list[Curve]:
    """The exact margin against outcomes of those of the controllers that ran. first: number of the first stroke."""
    margin = compared(file, folder)["margin"]
    curves = []
    for place, (controller, label) in enumerate(labels.items(), start=first):
        if controller in file.outcomes:
            used, fell = judged(file.outcomes[controller])
            curves.append(_curve(place, margin[used], fell, label, STAR, STATED.get((file.name, controller))))
    return curves


def _curve(
    place: int,
    margin: Float[np.ndarray, " n"],
    fell: Bool[np.ndarray, " n"],
    label: str,
    star_size: float,
    stated: Stated | None,
) -> Curve:
    """The curve that has this place among those of a panel; the first one has a band."""
    return Curve(
        label=label,
        stroke=STROKES[place],
        star_size=star_size,
        roc=curve(margin, fell),
        area=area(margin, fell),
        star=point(margin, fell) if star_size else None,
        band=None if place else band(margin, fell, GRID),
        stated=stated,
    )


def _drawn(panels: dict[str, list[Curve]], folder: Path, name: str, banded: str) -> list[Path]:
    """Draw panels by title, explain them, save the figure. banded: what the band is of."""
    with styled():
        figure, grid = _panels(len(panels), 2)
        for axes, letter, (title, curves) in zip(grid, "abcdef", panels.items(), strict=False):
            _draw(axes, curves)
            _enlarge_corner(axes, curves)
            _finish(axes, f"({letter}) {title}" if len(panels) > 1 else title)
        _explain(figure, [line for curves in panels.values() for line in curves], Patch(color=BAND, label=banded))
        return save(figure, folder, name)


def _panels(number: int, columns: int) -> tuple[Figure, list[Axes]]:
    """A figure with so many axes."""
    columns = min(columns, number)
    rows = -(-number // columns)
    figure = Figure(figsize=(WIDE, 3.2 * rows + 0.9) if columns > 1 else (NARROW, 3.7), layout="constrained")
    return figure, [figure.add_subplot(rows, columns, place + 1) for place in range(number)]


def _draw(axes: Axes, curves: Sequence[Curve], size: float = 1.0) -> None:
    """Bands, lines, stars, and what the paper says. size: of the stars, relative."""
    for line in curves:
        if line.band is not None:
            axes.fill_between(GRID, *line.band, color=BAND, linewidth=0, zorder=0)
        axes.plot(*line.roc, **line.stroke._asdict(), label=f"{100 * line.area.value:.1f} %")
        if line.star is not None:
            star = {"color": line.stroke.color, "ms": size * line.star_size, "mec": "black", "mew": 0.4}
            places = line.star.false_alarms.value, line.star.detection.value
            axes.plot(*places, "*", **star, zorder=20 - line.star_size, clip_on=False)  # the small ones on top
        if line.stated is not None and line.stated.detection is not None:
            diamond = {"color": "white", "ms": 4 * size, "mec": line.stroke.color, "mew": 1.0}
            axes.plot(line.stated.false_alarms, line.stated.detection, "D", **diamond, zorder=5)


def _enlarge_corner(axes: Axes, curves: Sequence[Curve]) -> None:
    """Show the corner in the middle of the axes, if that is where all stars are."""
    stars = [line.star for line in curves if line.star is not None]
    if not all(star.false_alarms.value < CORNER and star.detection.value > 1 - CORNER for star in stars):
        return
    inset = axes.inset_axes((0.22, 0.36, 0.44, 0.44), xlim=(0, CORNER), ylim=(1 - CORNER, 1))
    _draw(inset, curves)
    _scales(inset)
    inset.tick_params(labelsize=6)


def _scales(axes: Axes) -> None:
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    axes.grid(color="#e8e8e8", linewidth=0.4)
    axes.set_axisbelow(True)


def _finish(axes: Axes, title: str) -> None:
    """Axes, chance, and the areas under the curves."""
    axes.plot([0, 1], [0, 1], color=GREY, linewidth=0.5, zorder=0)
    axes.set(aspect="equal", xlim=(0, 1), ylim=(0, 1), title=title, xlabel="false alarms", ylabel="detection of falls")
    _scales(axes)
    axes.legend(loc="lower right", title="area", title_fontsize=7, handlelength=2.8, borderpad=0.4, labelspacing=0.3)


def _explain(figure: Figure, curves: Sequence[Curve], *signs: Line2D | Patch) -> None:
    """Lines and signs, each once, below the panels."""
    lines = {line.label: Line2D([], [], **line.stroke._asdict(), label=line.label) for line in curves}
    unfilled = {"linestyle": "", "color": "white", "markeredgecolor": "black"}
    mark = lambda marker, size, label: Line2D([], [], marker=marker, markersize=size, label=label, **unfilled)
    handles = [*lines.values(), *signs, mark("*", 8, "margin of zero")]
    if any(line.stated is not None and line.stated.detection is not None for line in curves):
        handles.append(mark("D", 4, "paper's text (HRP-2)"))
    columns = 3 if figure.get_figwidth() > NARROW else 2
    style = {"handlelength": 3.2, "columnspacing": 1.2, "frameon": False}
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, **style)
