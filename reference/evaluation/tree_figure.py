"""Fig. 3: the decision tree, and how many states of each scenario end in each leaf; of those, how many fell."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Shaped
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from reference.evaluation import output
from reference.evaluation.figure_style import BLUE, GREY, RED, WIDE, save, styled
from reference.evaluation.margins import score
from reference.evaluation.roc_figures import TITLES
from reference.evaluation.samples import BEST, Samples, among

PALE = "#cfd8e3"
"""Of robots that stopped."""


class Leaf(NamedTuple):
    """An end of the decision."""

    parent: str
    text: str
    color: str
    """BLUE: capturable, RED: not, GREY: either."""


LEAVES = {
    "C1": Leaf("brake", "no deceler-\nation left", RED),
    "C2": Leaf("brake", "no feasible\nacceleration", RED),
    "C3_1": Leaf("rest", "where it\ncan rest", BLUE),
    "C3_2_1": Leaf("before", "where it\ncan rest", BLUE),
    "C3_2_2": Leaf("before", "at rest\nbefore", RED),
    "C3_3": Leaf("rest", "beyond:\nswings back", GREY),
    "EMPTY": Leaf("rest", "can rest\nnowhere", RED),
}
"""By the predictor's case, from left to right."""

SAID = {BLUE: "stop", RED: "fall", GREY: "either"}
"""What the predictor says in a leaf."""

NODES = {
    "brake": (None, 1.5, 0.96, "maximum deceleration, until"),
    "rest": ("brake", 4.0, 0.74, "at rest (C3), and that is"),
    "before": ("rest", 3.5, 0.45, "before it can rest (C3.2):\nmaximum acceleration, until"),
}
"""Inner nodes: parent, place across [leaves] and up [share of the tree's height], text."""


FORK = 0.115
"""How far below a node its branches part, share of the tree's height [-]."""


class Count(NamedTuple):
    """Of the states in one leaf."""

    states: int
    fell: int
    stopped: int
    """The others are undecided."""


def counted(cases: Shaped[np.ndarray, " n"], outcomes: Shaped[np.ndarray, " n"]) -> dict[str, Count]:
    """How many states end in each of LEAVES. Raises ValueError for a case that is none of them."""
    unknown = set(cases.tolist()) - set(LEAVES)
    if unknown:
        raise ValueError(f"cases: {sorted(unknown)} (expected {', '.join(LEAVES)})")
    here = {name: outcomes[cases == name] for name in LEAVES}
    return {
        name: Count(len(ends), int((ends == "fallen").sum()), int((ends == "stopped").sum())) for name, ends in here.items()
    }


def tree(samples: dict[str, Samples], folder: Path) -> list[Path]:
    """Fig. 3, a line of bars for each scenario, and the same as a table."""
    files = among(samples, *TITLES)
    counts = {TITLES[file.name]: counted(score(file, folder)["case"], file.outcomes[BEST]) for file in files}
    table = Path(folder) / "figure_3.md"
    output.write(table, described(counts).encode())
    with styled():
        return [*save(drawn(counts), folder, "figure_3"), table]


def described(counts: dict[str, dict[str, Count]]) -> str:
    """A table in Markdown: share of the states in each leaf, and of the decided ones among these, how many fell."""
    names = " | ".join(_printed(name) for name in LEAVES)
    lines = [f"| | states | {names} |", "|---" * (len(LEAVES) + 2) + "|"]
    for title, leaves in counts.items():
        total = sum(leaf.states for leaf in leaves.values())
        cells = " | ".join(_shares(leaf, total) if leaf.states else "0" for leaf in leaves.values())
        lines.append(f"| {title} | {total:,} | {cells} |")
    return "\n".join(
        [*lines, "", "Share of the states; in brackets, of those that fell or stopped, the share that fell.", ""]
    )


def _shares(leaf: Count, total: int) -> str:
    decided = leaf.fell + leaf.stopped
    fell = f"{leaf.fell / decided:.1%}" if decided else "-"
    return f"{leaf.states / total:.1%} ({fell})"


def drawn(counts: dict[str, dict[str, Count]]) -> Figure:
    """The tree above; below each leaf the bars, a line for each scenario."""
    figure = Figure(figsize=(WIDE, 2.2 + 0.3 * len(counts)), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(1.85, 0.3 * len(counts)))
    _draw_tree(above)
    _draw_bars(below, counts)
    handles = [Patch(facecolor=RED, label="fell"), Patch(facecolor=PALE, label="stopped")]
    handles += [Patch(facecolor="white", edgecolor=GREY, label="undecided; a whole cell's width is all states of its line")]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return figure


def _draw_tree(axes: Axes) -> None:
    places = {name: (x, y) for name, (_, x, y, _) in NODES.items()}
    box = {"boxstyle": "round,pad=0.35", "facecolor": "white", "linewidth": 0.8}
    center = {"ha": "center", "va": "center", "zorder": 2, "linespacing": 1.05}
    edges = [(parent, place) for (parent, *_), place in zip(NODES.values(), places.values(), strict=True) if parent]
    edges += [(leaf.parent, (number, 0.1)) for number, leaf in enumerate(LEAVES.values())]
    for parent, (x, y) in edges:
        left, top = places[parent]
        axes.plot([left, left, x, x], [top, top - FORK, top - FORK, y], color="black", linewidth=0.7, zorder=1)
    for _, x, y, text in NODES.values():
        axes.text(x, y, text, bbox=box | {"edgecolor": "black"}, **center)
    for number, (name, leaf) in enumerate(LEAVES.items()):
        text = f"{_printed(name)}: {SAID[leaf.color]}\n{leaf.text}"
        axes.text(number, 0.1, text, bbox=box | {"edgecolor": leaf.color, "linewidth": 1.6}, **center)
    axes.set(xlim=(-1.6, len(LEAVES) - 0.45), ylim=(-0.1, 1.04))
    axes.set_axis_off()


def _draw_bars(axes: Axes, counts: dict[str, dict[str, Count]]) -> None:
    for line, (title, leaves) in enumerate(counts.items()):
        total = sum(leaf.states for leaf in leaves.values())
        axes.text(-0.55, line, title, ha="right", va="center")
        for number, leaf in enumerate(leaves.values()):
            start = number - 0.45
            style = {"height": 0.3, "linewidth": 0.4}
            for size, color in ((leaf.fell, RED), (leaf.stopped, PALE), (leaf.states - leaf.fell - leaf.stopped, "white")):
                axes.barh(line + 0.2, 0.9 * size / total, left=start, facecolor=color, edgecolor=GREY, **style)
                start += 0.9 * size / total
            fell = f", {leaf.fell / (leaf.fell + leaf.stopped):.0%} fell" if leaf.fell + leaf.stopped else ""
            text = f"{leaf.states / total:.1%}{fell}" if leaf.states else "none"
            axes.text(
                number - 0.45, line - 0.16, text, ha="left", va="center", fontsize=7, color="black" if leaf.states else GREY
            )
    axes.set(xlim=(-1.6, len(LEAVES) - 0.45), ylim=(len(counts) - 0.55, -0.5))
    axes.set_axis_off()


def _printed(case: str) -> str:
    """As the paper writes it."""
    return case.replace("_", ".").replace("EMPTY", "no $\\mathcal{S}$")
