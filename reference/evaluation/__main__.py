"""Every figure and table about the predictor and the outcomes of whole-body simulation.

    python -m reference.evaluation [-o evaluation] [--data reference/tsid/data] [--first N]

Writes figures as PDF and PNG, and `evaluation.md` with the tables and what is to be said about them, and says what it is at.
Files of a campaign that are not there are skipped, with the command that makes them. A figure or table that fails is named
with its error, the others are made, and the exit status is 1. Files in the output folder that this command did not write are
never overwritten. Needs the extra evaluation.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from reference.extras import extra

with extra("evaluation", __name__):
    from reference.evaluation import (
        failures,
        findings,
        output,
        path_figure,
        polygon_figure,
        postures,
        roc_figures,
        tables,
        time_figure,
        tree_figure,
    )
    from reference.evaluation.margins import NotScored, score_all
    from reference.evaluation.samples import MissingFile, Samples, paths_of, read
    from reference.tsid.table import Unreadable

DATA = Path(__file__).parents[1] / "tsid" / "data"

Files = dict[str, Samples]
"""Samples by the name of their file."""

FIGURES: dict[str, Callable[[Files, Path], list[Path]]] = {
    "figure_2": polygon_figure.polygon,
    "figure_3": tree_figure.tree,
    "figure_4": roc_figures.five_margins,
    "figure_4_held": roc_figures.five_margins_held,
    "figure_5": roc_figures.without_limits,
    "figure_6": roc_figures.with_constraints,
    "figure_7": path_figure.com_paths,
    "figure_8": time_figure.times,
    "figure_9": roc_figures.subsamples,
    "failures": failures.where_prediction_fails,
}
"""By name: from the samples and the output folder to the files written there, of which `.md` goes into the report."""


class Section(NamedTuple):
    """Of the report."""

    title: str
    texts: tuple[Callable[[Files, Path], str], ...]
    """Tables and paragraphs, each from the samples and the output folder."""
    figures: tuple[str, ...]
    """Names in FIGURES, below the texts; each name is in one section."""


SECTIONS = (
    Section("In short", (postures.in_short, postures.areas_in_short, postures.order_in_words), ()),
    Section("Beside the paper's numbers", (tables.beside_the_paper, findings.differences), ()),
    Section(
        "Postures that can be held, and a fourth controller",
        (postures.beside_the_paper, postures.order, postures.rescued),
        ("figure_4_held",),
    ),
    Section("Five margins", (tables.five_margins, findings.order, tables.among_predicted_stops), ("figure_4",)),
    Section("Where prediction fails", (), ("failures",)),
    Section("Undecided outcomes", (tables.undecided_either_way,), ()),
    Section(
        "Limits and constraints",
        (tables.other_controllers, findings.ablations, tables.order_by_controller, findings.reason_of_the_order),
        ("figure_5", "figure_6"),
    ),
    Section("Height of the capture point", (tables.heights, findings.heights), ()),
    Section("Sample size", (tables.subsamples,), ("figure_9",)),
    Section("Polygon, tree, paths, time", (), ("figure_2", "figure_3", "figure_7", "figure_8")),
)


class Report:
    """Markdown that is put together part by part; what is missing is said in it and on stderr."""

    def __init__(self, samples: Files, folder: Path):
        self.samples, self.folder, self.parts = samples, folder, []
        self.failed: list[str] = []
        """Names of what raised an error."""

    def add(self, part: str) -> None:
        self.parts.append(part.strip("\n"))

    def text(self, make: Callable[[Files, Path], str]) -> None:
        """Add what a function says, and what its docstring says about it."""
        try:
            found = make(self.samples, self.folder)
        except MissingFile as missing:
            self._skip(make.__name__, missing)
        except Exception as error:  # the others are worth having
            self._fail(f"{make.__module__.rpartition('.')[2]}.{make.__name__}", error)
        else:
            self.add((make.__doc__ or "").split("\n\n")[0])
            self.add(found)

    def figure(self, name: str) -> None:
        """Draw a figure and add it, with its tables."""
        start = time.perf_counter()
        print(f"{name} ...", flush=True)
        try:
            paths = FIGURES[name](self.samples, self.folder)
        except MissingFile as missing:
            self._skip(name, missing)
            return
        except Exception as error:  # the others are worth having
            self._fail(name, error)
            return
        print(f"{name}: {', '.join(path.name for path in paths)} ({time.perf_counter() - start:.0f} s)", flush=True)
        for path in paths:
            if path.suffix == ".png":
                self.add(f"![{(FIGURES[name].__doc__ or name).splitlines()[0]}]({path.name})")
            elif path.suffix == ".md":
                self.add(path.read_text(encoding="utf-8"))

    def _skip(self, name: str, missing: MissingFile) -> None:
        print(f"skipped {name}: {missing}", file=sys.stderr)
        self.add(f"*{name} is skipped: {missing}*")

    def _fail(self, name: str, error: Exception) -> None:
        told = f"{name} failed: {type(error).__name__}: {error}"
        print(f"evaluation: {told}", file=sys.stderr)
        self.failed.append(name)
        self.add(f"*{told}*")

    def markdown(self) -> str:
        """All parts."""
        return "\n\n".join(part for part in self.parts if part) + "\n"


def report(samples: Files, folder: Path) -> Report:
    """Make every figure and table. Raises NotScored where not even the margins can be had."""
    print(f"scoring {sum(len(file.index) for file in samples.values()):,} states ...", flush=True)
    score_all(((file, ()) for file in samples.values()), folder)
    made = Report(samples, folder)
    made.add("# The predictor and the whole-body truth")
    made.add(findings.data(samples, folder))
    for section in SECTIONS:
        made.add(f"## {section.title}")
        print(f"{section.title} ...", flush=True)
        for make in section.texts:
            made.text(make)
        for name in section.figures:
            made.figure(name)
    return made


def read_all(folder: Path, first: int | None) -> Files:
    """The files of a folder, telling which is being read."""
    samples = {}
    for path in paths_of(folder):
        print(f"reading {path} ...", flush=True)
        samples[path.stem] = read(path, first)
    return samples


def main(arguments: list[str] | None = None) -> int:
    """Read, draw, write. Returns the exit status: 0, or 1 if something cannot be used."""
    parser = argparse.ArgumentParser(
        prog="python -m reference.evaluation", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("evaluation"), metavar="FOLDER")
    parser.add_argument("--data", type=Path, default=DATA, metavar="FOLDER", help="with the files of the campaign")
    parser.add_argument("--first", type=int, metavar="N", help="only the first N samples of each file")
    options = parser.parse_args(arguments)
    if options.first is not None and options.first < 1:
        parser.error(f"--first {options.first} (expected at least 1)")
    start = time.perf_counter()
    try:
        samples = read_all(options.data, options.first)
        if not samples:
            parser.error(f"--data {options.data}: no file of a campaign, such as two.parquet")
        made = report(samples, options.output)
        output.write(options.output / "evaluation.md", made.markdown().encode())
    except (NotScored, Unreadable, output.Foreign, OSError) as error:
        print(f"evaluation: {error}", file=sys.stderr)
        return 1
    print(f"{options.output / 'evaluation.md'} ({time.perf_counter() - start:.0f} s in all)")
    if made.failed:
        print(f"evaluation: incomplete, failed: {', '.join(made.failed)}", file=sys.stderr)
    return 1 if made.failed else 0


if __name__ == "__main__":
    sys.exit(main())
