"""Fig. 8: cumulative histograms of computation times, of Algorithm 1 in `reference`, of the batch in `jaxcap`, and of the
capture point.

Algorithm 1 and the capture point are timed state by state: Python, linear programs by HiGHS through SciPy, a QP by ProxQP;
the paper's figures are of its linear programs alone. The capture point takes one of them (V-F): how far it can go on along
the velocity within the support polygon. A batch is timed as a whole, by the program itself, in single precision, compilation
apart: all its states share one time, the mean. Times are of the wall clock: nothing else should run.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter, PercentFormatter

from reference.algorithm import is_state_capturable
from reference.contacts import wrench_rays
from reference.evaluation import output
from reference.evaluation.figure_style import GREY, STROKES, WIDE, save, styled
from reference.evaluation.margins import CACHE, NotScored, corners
from reference.evaluation.roc_figures import TITLES
from reference.evaluation.samples import Samples, among
from reference.linear_programs import line_terms, solve

STATES = 200
"""Of each file that are timed one by one: its first."""

OWN, SHARED = 10_000, 100_000
"""States of a batch, those of a file again and again: on contacts of their own; on the contacts of the first of them."""

SCENARIOS = ("two", "three", "four")
"""As in the paper."""

SWINGS = 20
"""Passes allowed in C3.3, which the paper leaves open."""

QUANTILES = (0.5, 0.95, 1.0)
"""Of the times that are told."""

PAPER = 0.011
"""V-F: the paper's linear programs for one state never took longer [s]."""


class Times(NamedTuple):
    """Computation times of one scenario."""

    single: Float[np.ndarray, " n"]
    """Of Algorithm 1 for one state [s]."""
    point: Float[np.ndarray, " n"]
    """Of the capture point's linear program for the same states [s]."""
    own: float
    """Of a batch whose states have contacts of their own, for each state [s]."""
    shared: float
    """Of a batch on one contact set, likewise [s]."""


def times(samples: dict[str, Samples], folder: Path) -> list[Path]:
    """Fig. 8 of the scenarios, and a table."""
    files = among(samples, *SCENARIOS)
    measured = {}
    for file in files:
        singles = (single_times(file, predict) for predict in (algorithm_1, capture_point_reach))
        measured[TITLES[file.name]] = Times(*singles, own_time(file, folder), shared_time(file, folder))
    table = Path(folder) / "figure_8.md"
    output.write(table, described(measured).encode())
    with styled():
        return [*save(drawn(measured), folder, "figure_8"), table]


def algorithm_1(points, frames, friction, com, com_velocity) -> bool:
    """What Algorithm 1 says of one state."""
    return is_state_capturable(points, frames, friction, com, com_velocity, swings=SWINGS).capturable


def capture_point_reach(points, frames, friction, com, com_velocity) -> float:
    """How far the capture point can go on along the velocity within the support polygon, by one linear program [m].

    Negative: it is beyond. NaN where there is no capture point (14), as the CoM is not above the contacts' centroid, or
    where the line misses the polygon. points: (m, 3) [m]. com, com_velocity: (3,) [m], [m/s]; the velocity is not vertical.
    """
    height = com[2] - np.mean(points[:, 2])
    if height <= 0:
        return np.nan
    level = np.array([*com_velocity[:2], 0.0])
    at = com + level * np.sqrt(height / 9.81)
    wrenches = wrench_rays(points, frames, friction)
    _, weight, moving = line_terms(at, level / np.linalg.norm(level), wrenches)
    matrix = np.column_stack([-moving, wrenches.rays])
    cost = np.zeros(matrix.shape[1])
    cost[0] = -1.0
    result = solve(cost, matrix, weight)
    return -result.fun if result.status == 0 else {2: np.nan, 3: np.inf}[result.status]


def single_times(samples: Samples, predict: Callable[..., object], most: int = STATES) -> Float[np.ndarray, " n"]:
    """Seconds that a prediction takes for each of the first samples that move."""
    states = list(zip(*corners(samples.contacts), samples.com, samples.com_velocity, strict=True))
    states = [state for state in states[: most + 1] if state[-1].any()]
    seconds = []
    for state in states:
        start = time.perf_counter()
        predict(*state)
        seconds.append(time.perf_counter() - start)
    return np.array(seconds[1:] if len(seconds) > 1 else seconds)  # the first call loads the solvers


def own_time(samples: Samples, folder: Path, size: int = OWN) -> float:
    """Seconds a state that `jaxcap score` takes for the samples on their own contacts. Raises NotScored."""
    points, frames, friction = corners(samples.contacts)
    columns = {"com": samples.com, "com_velocity": samples.com_velocity, "contact_points": points}
    return _scored(columns | {"contact_frames": frames, "contact_friction": friction}, size, folder)


def shared_time(samples: Samples, folder: Path, size: int = SHARED) -> float:
    """The same with all velocities at the CoM and on the contacts of the first sample. Raises NotScored."""
    _, positions, rotations, lengths, widths, friction = (field[0].tolist() for field in samples.contacts)
    names = ("position", "rotation", "half_length", "half_width", "friction")
    rectangles = [
        {"type": "rectangle"} | dict(zip(names, values, strict=True))
        for values in zip(positions, rotations, lengths, widths, friction, strict=True)
    ]
    columns = {"com": np.broadcast_to(samples.com[0], samples.com.shape), "com_velocity": samples.com_velocity}
    return _scored(columns, size, folder, {"contacts": rectangles})


def _scored(columns: dict[str, Float[np.ndarray, "n ..."]], size: int, folder: Path, contacts: dict | None = None) -> float:
    """Seconds a state, by the program's own account, for `size` rows. folder: below it is what JAX has compiled."""
    lists = lambda values: pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values[0].size)
    with tempfile.TemporaryDirectory() as temporary:
        states, feet, scores = (Path(temporary) / name for name in ("states.parquet", "contacts.json", "scores.parquet"))
        rows = {name: np.resize(values, (size, *values.shape[1:])) for name, values in columns.items()}
        pq.write_table(pa.table({name: lists(values) for name, values in rows.items()}), states)
        command = [sys.executable, "-m", "jaxcap.commands.cli", "score", str(states), "-o", str(scores)]
        if contacts is not None:
            feet.write_text(json.dumps(contacts), encoding="utf-8")
            command += ["--contacts", str(feet)]
        environment = {CACHE: str(Path(folder).resolve() / "scores" / "compiled")} | os.environ
        done = subprocess.run(command, capture_output=True, text=True, env=environment)
    if done.returncode:
        raise NotScored(f"jaxcap score: exit code {done.returncode}: {done.stderr.strip()}")
    return 1.0 / float(re.search(r"^(\S+) states/s", done.stdout, re.MULTILINE).group(1))


def cumulative(seconds: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Corners of the cumulative histogram: times in increasing order [s], and the share that took no longer; from 0 to 1."""
    ordered = np.sort(seconds)
    return np.concatenate([ordered[:1], ordered]), np.arange(len(ordered) + 1) / len(ordered)


def described(measured: dict[str, Times]) -> str:
    """A table in Markdown, a line for each scenario."""
    lines = [
        "| | states | Algorithm 1: median [ms] | 95 % [ms] | longest [ms] | capture point: median [ms] | 95 % [ms] "
        "| longest [ms] | batch, own contacts [us] | batch, one contact set [us] |",
        "|---" * 10 + "|",
    ]
    for title, (single, point, own, shared) in measured.items():
        spreads = " | ".join(f"{1e3 * value:.2f}" for times in (single, point) for value in np.quantile(times, QUANTILES))
        lines.append(f"| {title} | {len(single)} | {spreads} | {1e6 * own:.2f} | {1e6 * shared:.2f} |")
    return "\n".join([*lines, "", "Times of one state; those of a batch are means, in single precision.", ""])


def drawn(measured: dict[str, Times]) -> Figure:
    """Left, Algorithm 1 and the times of batches, right, the capture point; a line for each scenario."""
    figure = Figure(figsize=(WIDE, 3.1), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    for (title, (single, point, own, shared)), stroke in zip(measured.items(), STROKES, strict=False):
        left.step(*cumulative(single), where="post", **stroke._asdict(), label=title)
        right.step(*cumulative(point), where="post", **stroke._asdict())
        for batch, face in ((own, stroke.color), (shared, "white")):
            left.step(*cumulative(np.array([batch])), where="post", **stroke._asdict())
            dot = {"markersize": 4, "markerfacecolor": face, "markeredgecolor": stroke.color, "clip_on": False}
            left.plot(batch, 1.0, "o", **dot)
    left.axvline(PAPER, color=GREY, linewidth=0.8)
    left.text(1.08 * PAPER, 0.4, "paper: at most 11 ms", rotation=90, va="center", fontsize=7, color="#505050")
    left.set(title="(a) Algorithm 1, and batches of jaxcap", ylabel="share that took no longer")
    right.set_title("(b) capture point, by one linear program")
    for axes in (left, right):
        axes.set(xscale="log", ylim=(0, 1.02), xlabel="computation time for one state")
        axes.xaxis.set_major_formatter(EngFormatter(unit="s"))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.grid(color="#e8e8e8", linewidth=0.4)
        axes.set_axisbelow(True)
    sign = lambda face, label: Line2D([], [], color=GREY, marker="o", markersize=4, markerfacecolor=face, label=label)
    batches = [sign(GREY, "batch, own contacts: mean"), sign("white", "batch, one contact set: mean")]
    handles, _ = left.get_legend_handles_labels()
    figure.legend(handles=[*handles, *batches], loc="outside lower center", ncols=3, frameon=False, handlelength=3.0)
    return figure
