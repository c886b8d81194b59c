"""A 4-D map of 10^8 states: how fast, and in how much memory? Against `jaxcap.score` on arrays of the same states.

    python -m bench.maps [--states 100000000] [--sample 2000000] [--contacts FILE] [--json FILE]

A line is a command `jaxcap map CONTACTS -o OUT.zarr --axis ...` in a process of its own: com_x, com_y around the stance, 72
headings, 61 speeds, float32. `verdict` writes capturable, margin and case of every state; `all` writes all fields. The ratio
comes first: states/s of the map over those of `score`, which computes every field, on arrays of the same states. `seconds`
are those of the whole command without starting Python: compiling, computing, compressing and writing.
`peak` is the largest resident memory of the process, the interpreter and JAX included (see bench/process.py).

`score` is given `--sample` of the states, runs of neighbours that begin at random places (seed 0), from the host, compiled
before, once before the map and once after it; its rate is the better of the two. A busy machine slows both alike, so trust
the ratio. `differ` counts the states of the sample whose verdict in the map is another than that of `score`, although their
margin is larger than 1e-5 m/s; it has to be 0. Needs the extras maps and cli. Takes about five minutes on two cores.
"""

import argparse
import json
import math
import tempfile
import time
from pathlib import Path

import jax
import numpy as np
import xarray as xr

import jaxcap
from bench.process import in_process
from bench.stances import DATA
from jaxcap.files.contact_files import read_contacts
from jaxcap.files.fields import FIELDS
from jaxcap.maps.grid import Grid, axes_around, grid_of

CONTACTS = DATA / "talos_two_feet.yaml"
SEED, RUN = 0, 1 << 16
HEADINGS, SPEEDS, FASTEST = 72, 61, 1.5
BAND = 1e-5
"""Margins smaller than this are too close for a verdict to be compared in single precision [m/s]."""


def axes(contacts: Path, states: int) -> dict[str, str]:
    """Axes with at least this many states, as on the command line."""
    places = max(2, math.ceil(math.sqrt(states / (HEADINGS * SPEEDS))))
    around = axes_around(read_contacts(contacts), {})
    position = {name: f"{around[name].min():.4g}:{around[name].max():.4g}:{places}" for name in ("com_x", "com_y")}
    return {**position, "heading": f"0:360deg:{HEADINGS}", "speed": f"0:{FASTEST}:{SPEEDS}"}


def mapped(contacts: Path, output: Path, texts: dict[str, str], quantities) -> dict:
    """Runs the command. Returns its seconds and its peak memory."""
    options = [*(f"--axis={name}={text}" for name, text in texts.items()), *(f"--quantity={name}" for name in quantities)]
    command = ["map", str(contacts), "-o", str(output), *options]
    return {"command": " ".join(["jaxcap", *command]), **in_process(command)._asdict()}


def scored(cone, points: Grid, starts: np.ndarray) -> tuple[float, jaxcap.Capturability]:
    """States/s of `score` on runs of states, and its answers."""
    runs = [points.states(start + np.arange(RUN), np.float32) for start in starts]
    jax.block_until_ready(jaxcap.score(cone, *runs[0]))
    begin = time.perf_counter()
    parts = [jax.tree.map(np.asarray, jaxcap.score(cone, *run)) for run in runs]
    seconds = time.perf_counter() - begin
    return RUN * len(runs) / seconds, jax.tree.map(lambda *fields: np.concatenate(fields), *parts)


def differing(output: Path, points: Grid, starts: np.ndarray, answer: jaxcap.Capturability) -> int:
    """How many verdicts of the map are others than these."""
    with xr.open_dataset(output) as dataset:
        flat = dataset.capturable.transpose(*points.dims).variable
        rows = math.prod(points.shape[1:])
        found = []
        for start in starts:  # only the rows of com_x that the run touches are read
            first, last = start // rows, (start + RUN - 1) // rows
            part = np.ravel(flat[first : last + 1].values)
            found.append(part[start - first * rows :][:RUN])
    clear = ~(np.abs(answer.margin) < BAND)
    return int(np.sum((np.concatenate(found) != answer.capturable) & clear))


def line(name: str, quantities, options, directory: Path) -> dict:
    """One line of the table."""
    texts, output = axes(options.contacts, options.states), directory / f"{name}.zarr"
    stance = read_contacts(options.contacts)
    points, cone = grid_of(axes_around(stance, texts)), jaxcap.centroidal_cone(stance)
    rng = np.random.default_rng(SEED)
    starts = rng.integers(0, points.size - RUN, max(1, options.sample // RUN))
    before, _ = scored(cone, points, starts)
    found = mapped(options.contacts, output, texts, quantities)
    after, answer = scored(cone, points, starts)
    rate, score = points.size / found["seconds"], max(before, after)
    return {
        "map": name,
        "states": points.size,
        "ratio_to_score": rate / score,
        "states_per_second": rate,
        "score_states_per_second": score,
        **found,
        "file_bytes": sum(file.stat().st_size for file in output.rglob("*") if file.is_file()),
        "differ": differing(output, points, starts, answer),
    }


def main(arguments=None) -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(prog="python -m bench.maps", description=__doc__.splitlines()[0])
    parser.add_argument("--states", type=int, default=100_000_000)
    parser.add_argument("--sample", type=int, default=2_000_000)
    parser.add_argument("--contacts", type=Path, default=CONTACTS)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    if options.states < 2 * RUN:
        parser.error(f"--states {options.states} (expected at least {2 * RUN})")
    # The effort is a posture's, and there is none here
    kinds = {"verdict": ("capturable", "margin", "case"), "all": tuple(name for name in FIELDS if name != "effort")}
    heads = ("x score", 9), ("states/s", 12), ("score", 12), ("seconds", 9), ("peak", 9), ("file", 9), ("differ", 8)
    print(f"{'map':<9}{'states':>12}" + "".join(f"{head:>{width}}" for head, width in heads))
    lines = []
    with tempfile.TemporaryDirectory() as directory:
        for name, quantities in kinds.items():
            found = line(name, quantities, options, Path(directory))
            lines.append(found)
            print(
                f"{name:<9}{found['states']:>12,}{found['ratio_to_score']:>9.2f}{found['states_per_second']:>12,.0f}"
                f"{found['score_states_per_second']:>12,.0f}{found['seconds']:>9.1f}{found['peak_bytes'] / 1e9:>6.2f} GB"
                f"{found['file_bytes'] / 1e9:>6.2f} GB{found['differ']:>8}",
                flush=True,
            )
    print(f"\n{lines[0]['command']}")
    if options.json:
        options.json.write_text(json.dumps(lines, indent=1))


if __name__ == "__main__":
    main()
