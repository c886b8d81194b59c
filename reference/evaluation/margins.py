"""Margins of a campaign's samples, by the program `jaxcap` as a process of its own."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Bool, Float

from reference.evaluation.samples import Contacts, Samples
from reference.tsid.wrench_cone import CORNERS

OPTIONS = ("--dtype", "float64", "--baselines", "--batch-size", "2000")

CACHE = "JAX_COMPILATION_CACHE_DIR"
"""Environment variable: where JAX keeps what it compiled, which is the same for all files of a scenario."""

TRUSTED, AT_REST = ("ok", "max_swings"), "no_direction"
"""Names of statuses: the margin stands; zero velocity, which has a verdict and no margin."""


PROCESSES = 2
"""Of `jaxcap` at a time; each keeps more than one core busy for a part of its time only."""


class Margin(NamedTuple):
    """A margin among those that are compared."""

    column: str
    label: str
    unit: str
    has_zero: bool
    """Whether a margin of zero divides predicted stops from predicted falls."""


SPEED = "com_speed"
"""The trivial margin: minus the speed of the CoM."""

MARGINS = (
    Margin("margin", "exact margin", "m/s", True),
    Margin("paper_margin", "paper's margin", "m/s^2 or m/s", True),
    Margin("capture_point_support", "capture point to support polygon", "m", True),
    Margin("capture_point_hull", "capture point to hull of contacts", "m", True),
    Margin(SPEED, "minus CoM speed", "m/s", False),
)
"""In the order of figures and tables."""


class NotScored(Exception):
    """`jaxcap` did not score the samples; the message holds its own."""


def score(samples: Samples, folder: Path, *options: str) -> dict[str, np.ndarray]:
    """All columns of the samples' scored file, by name; vectors are (n, 3), `case` and `status` the names of their codes.

    folder: of the evaluation's output: the scored file is kept in its subfolder `scores`, and taken from there if it was
    made from the same states and contacts with the same options by the same sources of `jaxcap`. options: more of
    `jaxcap score`, as ("--height", "0.7"). Raises NotScored.
    """
    columns, options = _columns(samples), (*OPTIONS, *options)
    output = Path(folder) / "scores" / f"{samples.name}-{_digest(columns, options)}.parquet"
    if not output.exists():
        output.parent.mkdir(parents=True, exist_ok=True)
        _run(columns, output, options)
    table = pq.read_table(output)
    codes = json.loads(table.schema.metadata[b"jaxcap"])
    scores = {name: _array(table[name]) for name in table.column_names if not name.startswith("contact_")}
    for name in ("case", "status"):
        names = {code: text for text, code in codes[name].items()}
        scores[name] = np.array([names[code] for code in scores[name].tolist()])
    return scores | {SPEED: -np.linalg.norm(samples.com_velocity, axis=1)}


def score_all(jobs: Iterable[tuple[Samples, tuple[str, ...]]], folder: Path) -> None:
    """Score samples with options, PROCESSES at a time, so that `score` finds them. Raises NotScored."""
    with ThreadPoolExecutor(PROCESSES) as pool:
        for done in [pool.submit(score, samples, folder, *options) for samples, options in jobs]:
            done.result()


def compared(samples: Samples, folder: Path, *options: str) -> dict[str, Float[np.ndarray, " n"]]:
    """MARGINS of the samples, by column. A state at rest has no margin but a verdict: plus or minus infinity.

    NaN where a distance of the capture point is not known, as where the CoM is below the ground: `everywhere` says where
    none is. Raises NotScored, also where the verdict is not known: the tables must not leave out what is hard.
    """
    scores = score(samples, folder, *options)
    at_rest = scores["status"] == AT_REST
    unknown = ~at_rest & ~np.isin(scores["status"], TRUSTED)
    if unknown.any():
        found = ", ".join(np.unique(scores["status"][unknown]))
        raise NotScored(f"{samples.name}: {unknown.sum()} states have the status {found} (expected {', '.join(TRUSTED)})")
    verdict = np.where(scores["capturable"], np.inf, -np.inf)
    margins = {margin.column: scores[margin.column] for margin in MARGINS}
    return margins | {name: np.where(at_rest, verdict, margins[name]) for name in ("margin", "paper_margin")}


def everywhere(margins: dict[str, Float[np.ndarray, " n"]]) -> Bool[np.ndarray, " n"]:
    """Which samples have all of the margins."""
    return ~np.isnan(np.stack(list(margins.values()))).any(axis=0)


def corners(contacts: Contacts) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corner points of the rectangles (n, m, 3) [m], their frames (n, m, 3, 3) and friction (n, m), m = 4 k."""
    x, y = contacts.half_lengths[..., None] * CORNERS[:, 0], contacts.half_widths[..., None] * CORNERS[:, 1]
    along, across = contacts.rotations[..., None, :, 0], contacts.rotations[..., None, :, 1]
    points = contacts.positions[..., None, :] + x[..., None] * along + y[..., None] * across
    n, k = contacts.friction.shape
    repeat = lambda values: np.repeat(values, len(CORNERS), axis=1)
    return points.reshape(n, len(CORNERS) * k, 3), repeat(contacts.rotations), repeat(contacts.friction)


def _columns(samples: Samples) -> dict[str, Float[np.ndarray, "n ..."]]:
    """What `jaxcap` reads; the friction of each contact, frames row by row."""
    points, frames, friction = corners(samples.contacts)
    columns = {"com": samples.com, "com_velocity": samples.com_velocity, "contact_points": points}
    columns |= {"contact_frames": frames, "contact_friction": friction}
    return {name: np.ascontiguousarray(values.reshape(len(values), -1)) for name, values in columns.items()}


def _digest(columns: dict[str, np.ndarray], options: tuple[str, ...]) -> str:
    """Of all that the scored file depends on."""
    digest = hashlib.sha256(json.dumps(options).encode())
    for name, values in columns.items():
        digest.update(f"{name} {values.shape} {values.dtype}".encode() + values.tobytes())
    sources = Path(find_spec("jaxcap").origin).parent
    for path in sorted(sources.rglob("*.py")):
        digest.update(str(path.relative_to(sources)).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _run(columns: dict[str, np.ndarray], output: Path, options: tuple[str, ...]) -> None:
    """`jaxcap score` of these columns. It writes the output whole or not at all. Raises NotScored."""
    lists = lambda values: pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
    with tempfile.TemporaryDirectory() as folder:
        states = Path(folder) / "states.parquet"
        pq.write_table(pa.table({name: lists(values) for name, values in columns.items()}), states)
        command = [sys.executable, "-m", "jaxcap.commands.cli", "score", str(states), "-o", str(output), *options]
        environment = {CACHE: str(output.parent / "compiled")} | os.environ
        done = subprocess.run(command, capture_output=True, text=True, env=environment)
    if done.returncode:
        raise NotScored(f"jaxcap score {' '.join(options)}: exit code {done.returncode}: {done.stderr.strip()}")


def _array(column: pa.ChunkedArray) -> np.ndarray:
    """A column of numbers (n,), or of lists of equal length (n, m)."""
    whole = column.combine_chunks()
    if pa.types.is_fixed_size_list(whole.type) or pa.types.is_list(whole.type):
        return whole.flatten().to_numpy(zero_copy_only=False).reshape(len(whole), -1)
    return whole.to_numpy(zero_copy_only=False)
