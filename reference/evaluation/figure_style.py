"""How the figures look: at the size at which they are printed, told apart by colour-blind readers and in grey."""

from __future__ import annotations

from contextlib import AbstractContextManager
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import matplotlib
from matplotlib.figure import Figure

from reference.evaluation import output

WIDE, NARROW = 7.16, 3.5
"""Widths of two columns and of one [in]."""

DPI = 300
"""Of the PNG."""

BLACK, BLUE, ORANGE, GREEN, RED, SKY, GREY = "#000000", "#0060a0", "#d08700", "#007a5a", "#b03000", "#56b4e9", "#909090"

BAND = "#c8d8e8"
"""Of confidence bands."""

SETTINGS = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.2,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "pdf.fonttype": 42,  # letters stay letters: text can be searched and edited
}


class Stroke(NamedTuple):
    """How a line is drawn."""

    color: str
    linestyle: str | tuple[float, tuple[float, ...]]


STROKES = (
    Stroke(BLUE, "-"),
    Stroke(RED, (0, (5, 1.5))),
    Stroke(GREEN, (0, (6, 1.5, 1, 1.5))),
    Stroke(ORANGE, (0, (2.5, 1.2))),
    Stroke(BLACK, (0, (1, 1.2))),
    Stroke(SKY, "-"),
    Stroke(GREY, (0, (8, 1.5, 1, 1.5, 1, 1.5))),
)
"""Lines of one picture, in this order."""


def styled() -> AbstractContextManager[None]:
    """Within it, figures are drawn with SETTINGS."""
    return matplotlib.rc_context(SETTINGS)


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write NAME.pdf and NAME.png, the same bytes for the same figure. Raises `output.Foreign`. Returns their paths."""
    paths = []
    for kind, metadata in (("pdf", {"CreationDate": None}), ("png", {"Software": None})):
        content = BytesIO()
        figure.savefig(content, format=kind, dpi=DPI, metadata=metadata)
        paths.append(Path(folder) / f"{name}.{kind}")
        output.write(paths[-1], content.getvalue())
    return paths
