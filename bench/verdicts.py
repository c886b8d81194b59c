"""Does the predictor know who falls? Its verdict against the outcome of whole-body simulation, as four-cell tables.

    python -m bench.verdicts [FILE.parquet | FOLDER ...] [--first N]

The files are those of `python -m reference.tsid.campaign`; without arguments, all in reference/tsid/data. One line is one
file and, where a file has every controller run on every sample, one controller; "best of 3" is the best outcome of the three
controllers of the paper's V-A. `score` gets the contacts, CoM and CoM velocity of each row, in double precision.

    detected, missed      of those that fell: the predictor said so, or not
    false, right          of those that stopped: the predictor said that they would fall, or not
    undecided             runs that did neither in time, and failed rows: in no other column
    detection             detected / (detected + missed), with its 95 % interval (Wilson)
    false alarms          false / (false + right), likewise
    AUC                   probability that the margin orders a stop above a fall; 50 % is chance
    stop here             of the falls of the first controller that the predictor missed, how many stop under this one
    paper                 detection / false alarms of HRP-2: issue and V-D, where they say it in numbers

Needs the extra data, and nothing of the simulator.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from functools import reduce
from operator import add
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import pyarrow.parquet as pq
from scipy.stats import rankdata

import jaxcap

DATA = Path("reference/tsid/data")

CONFIDENCE = 1.96
"""Standard deviations of a 95 % interval."""

PAPER = {
    ("two_coplanar", "best of 3"): "90 / 8",
    ("two", "best of 3"): "90 / 8",
    ("three", "best of 3"): "74 / 2.3",
    ("three", "no_torque"): "77 / 2.4",
    ("three", "no_position"): "80 / 4",
    ("three", "no_position_torque"): "81 / 4",
    ("two", "standard"): "98 / 19",
    ("two", "straight"): "92 / 18.6",
    ("two", "constant_momentum"): "92 / 1",
}
"""Detection and false alarms of HRP-2 [%], by scenario and controller. The rows of "two" with one controller are from the
samples without angular momentum."""


class Counts(NamedTuple):
    """The four cells, and what is outside of them."""

    detected: int
    missed: int
    false: int
    right: int
    undecided: int


class Prediction(NamedTuple):
    """What `score` says of n samples."""

    capturable: np.ndarray
    """(n,)"""
    margin: np.ndarray
    """(n,) [m/s]: how much speed could be added; negative for falls."""


def predict(rows: list[dict]) -> Prediction:
    """Verdicts on rows of one scenario, whose contacts are as many in each. Raises ArithmeticError where one is unknown."""
    sets = [reduce(add, map(_rectangle, row["contacts"])) for row in rows]
    rays = jaxcap.cone_rays(jax.tree.map(lambda *leaves: np.stack(leaves), *sets))
    states = (np.array([row[name] for row in rows]) for name in ("com", "com_velocity"))
    out = jaxcap.score(rays, *states)
    if (np.asarray(out.status) != jaxcap.Status.OK).any():
        raise ArithmeticError(f"score: {np.bincount(np.asarray(out.status))} states by status (expected all OK)")
    return Prediction(np.asarray(out.capturable), np.asarray(out.margin))


def _rectangle(contact: dict) -> jaxcap.ContactSet:
    rotation = np.reshape(contact["rotation"], (3, 3))
    sizes = contact["half_length"], contact["half_width"], contact["friction"]
    return jaxcap.rectangle(contact["position"], rotation, *sizes)


def count(outcomes: np.ndarray, capturable: np.ndarray) -> Counts:
    """The four cells. outcomes: (n,) of "fallen", "stopped" and anything else. capturable: (n,) bool."""
    fell, stopped = outcomes == "fallen", outcomes == "stopped"
    cells = (fell & ~capturable, fell & capturable, stopped & ~capturable, stopped & capturable, ~fell & ~stopped)
    return Counts(*(int(cell.sum()) for cell in cells))


def interval(hits: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share; (0, 1) of nothing. Source: Wilson, JASA 22(158), 1927."""
    if of == 0:
        return 0.0, 1.0
    z = CONFIDENCE
    share = hits / of
    middle = share + z * z / (2 * of)
    half = z * np.sqrt(share * (1 - share) / of + z * z / (4 * of * of))
    return (middle - half) / (1 + z * z / of), (middle + half) / (1 + z * z / of)


def area_under_roc(margin: np.ndarray, outcomes: np.ndarray) -> float:
    """Probability that a stop's margin exceeds a fall's, ties half; not a number where there are no stops or no falls."""
    fell, stopped = outcomes == "fallen", outcomes == "stopped"
    ranks = rankdata(margin[fell | stopped])
    some, others = int(stopped.sum()), int(fell.sum())
    if not some or not others:
        return np.nan
    return float((ranks[stopped[fell | stopped]].sum() - some * (some + 1) / 2) / (some * others))


HEADER = (
    f"{'file':22}{'controller':22}{'detected':>9}{'missed':>7}{'false':>6}{'right':>6}{'undecided':>10}"
    f"{'detection %':>22}{'false alarms %':>22}{'AUC %':>7}{'stop here':>11}{'paper':>11}"
)


def lines(path: Path, first: int | None) -> Iterator[str]:
    """The table's lines for one file, of its first samples."""
    file = pq.ParquetFile(path)
    settings = json.loads(file.schema_arrow.metadata[b"tsid"])["settings"]
    outcomes = [name for name in file.schema_arrow.names if name.endswith("outcome")]
    table = file.read(columns=["contacts", "com", "com_velocity", *outcomes])
    rows = [row for row in table.slice(0, first).to_pylist() if row["com"] is not None]
    failed = min(table.num_rows, first or table.num_rows) - len(rows)
    if not rows:
        yield f"{path.stem:22}no samples"
        return
    prediction = predict(rows)
    controllers = settings["controllers"] if settings["every"] else ["best of 3"]
    column = lambda name: np.array([row["outcome" if name == "best of 3" else f"{name}_outcome"] for row in rows])
    missed = (column(controllers[0]) == "fallen") & prediction.capturable
    for name in controllers:
        outcomes = column(name)
        cells = count(outcomes, prediction.capturable)
        cells = cells._replace(undecided=cells.undecided + failed)
        rescued = f"{(missed & (outcomes == 'stopped')).sum()} of {missed.sum()}" if name != controllers[0] else "-"
        yield (
            f"{path.stem:22}{name:22}{cells.detected:9}{cells.missed:7}{cells.false:6}{cells.right:6}{cells.undecided:10}"
            f"{_percent(cells.detected, cells.detected + cells.missed):>22}"
            f"{_percent(cells.false, cells.false + cells.right):>22}"
            f"{100 * area_under_roc(prediction.margin, outcomes):7.1f}{rescued:>11}"
            f"{PAPER.get((settings['scenario'], name), '-'):>11}"
        )


def _percent(hits: int, of: int) -> str:
    if of == 0:
        return "-"
    low, high = interval(hits, of)
    return f"{100 * hits / of:.1f} ({100 * abs(low):.1f}-{100 * high:.1f})"  # abs: rounding below zero


def main(arguments: list[str] | None = None) -> None:
    """Parse, predict, print."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.verdicts", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", type=Path, default=[DATA], metavar="FILE.parquet | FOLDER")
    parser.add_argument("--first", type=int, metavar="N", help="only the first N samples of each file")
    options = parser.parse_args(arguments)
    files = [file for path in options.files for file in (sorted(path.glob("*.parquet")) if path.is_dir() else [path])]
    if not files or (options.first is not None and options.first < 1):
        parser.error(f"no .parquet file in {', '.join(map(str, options.files))}, or --first is not at least 1")
    jax.config.update("jax_enable_x64", True)
    print(HEADER)
    for path in files:
        for line in lines(path, options.first):
            print(line, flush=True)


if __name__ == "__main__":
    main()
