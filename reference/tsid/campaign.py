"""Label a scenario's samples by simulation: `python -m reference.tsid.campaign two --samples 100 -o two.parquet --jobs 2`.

A campaign's file holds samples 0 to N-1. Interrupt it as you like, Ctrl-C or SIGKILL: results go to a journal beside the
file as they come, and the same command resumes; the file is the same to the byte as that of an uninterrupted run. A file
that is there already is continued if it has the same settings and fewer samples.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import itertools
import json
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from reference.extras import extra

with extra("sim", __name__):
    from tqdm import tqdm

    from reference.tsid.journal import Busy, Journal
    from reference.tsid.labels import BEST_OF_FOUR, Row, Settings, labeller, toolbox
    from reference.tsid.robot import entries_of, load
    from reference.tsid.sampling import DISTRIBUTION, SCENARIOS
    from reference.tsid.table import Unreadable, read, write
    from reference.tsid.workers import Died, answers

LIBRARIES = ("numpy", "scipy", "pin", "coal", "example-robot-data", "daqp", "proxsuite", "numba", "pyarrow")

STATES = 10_000
"""Rows that hold q and v, unless told otherwise."""


class Refused(Exception):
    """The campaign cannot run as asked; nothing was touched."""


def main(arguments: list[str] | None = None) -> int:
    """Run a campaign. Returns the exit status: 0 done, 1 refused, 2 wrong usage, 3 out of time, 130 interrupted."""
    options = _parse(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a scheduler's request to end is a Ctrl-C
    try:
        return _run(options)
    except (Refused, Busy, Unreadable, OSError) as error:
        print(f"campaign: {error}", file=sys.stderr)
        return 1


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m reference.tsid.campaign", description=__doc__.split("\n\n")[0])
    add = parser.add_argument
    add("scenario", choices=SCENARIOS)
    add("--samples", type=_positive(int), required=True, metavar="N", help="samples 0 to N-1")
    add("-o", "--output", type=Path, required=True, metavar="FILE.parquet")
    add("--jobs", type=_positive(int), default=1, metavar="J", help="processes, one core each (default: 1)")
    add("--seed", type=_seed, default=0)
    add("--robot", default="talos", help="a name in reference/tsid/robots, or a TOML file (default: talos)")
    add("--controllers", nargs="+", default=BEST_OF_FOUR, metavar="NAME", help=f"default: {' '.join(BEST_OF_FOUR)}")
    add("--all", action="store_true", help="run every controller; else one runs if those before it did not stop the robot")
    add("--zero-momentum", action="store_true", help="pushes without angular momentum")
    add("--states", type=int, default=STATES, metavar="N", help=f"rows that hold q and v (default: {STATES})")
    add("--budget", type=_positive(float), metavar="SECONDS", help="start no sample after this time")
    add("--set", action="append", default=[], metavar="NAME=VALUE", help="an option of the simulator")
    add("--simulator", default="reference.tsid.simulator", metavar="MODULE", help="with Simulator and Options of its own")
    return parser.parse_args(arguments)


def _positive(kind: type) -> Callable[[str], Any]:
    def convert(text: str):
        value = kind(text)
        if not value > 0:
            raise argparse.ArgumentTypeError(f"{text} (expected more than 0)")
        return value

    convert.__name__ = kind.__name__  # for argparse's message
    return convert


def _seed(text: str) -> int:
    if not 0 <= int(text) < 2**63:
        raise argparse.ArgumentTypeError(f"{text} (expected 0 to 2^63 - 1)")
    return int(text)


def settings_of(options: argparse.Namespace) -> Settings:
    """What the rows will depend on. Raises Refused naming an argument that is wrong."""
    if options.output.suffix != ".parquet" or not options.output.parent.is_dir():
        raise Refused(f"-o {options.output}: expected a .parquet file in a folder that exists")
    try:
        tools = toolbox(options.simulator)
    except (ImportError, AttributeError) as error:
        raise Refused(f"--simulator {options.simulator}: {error}") from error
    unknown = [name for name in options.controllers if name not in tools.configurations]
    if unknown or len(set(options.controllers)) < len(options.controllers):
        known = ", ".join(tools.configurations)
        raise Refused(f"--controllers {' '.join(options.controllers)}: expected some of, each once: {known}")
    values = _simulator_options(tools.options(), options.set)
    try:  # what would fail for every sample
        robot = load(options.robot)
        for name in options.controllers:
            tools.simulator(robot, tools.configurations[name], tools.options(**values))
    except ValueError as error:
        raise Refused(str(error)) from error
    entries = entries_of(options.robot)
    return Settings(
        scenario=options.scenario,
        robot=robot.name,
        robot_hash=hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest(),
        seed=options.seed,
        zero_momentum=options.zero_momentum,
        controllers=tuple(options.controllers),
        configurations={name: repr(tools.configurations[name]) for name in options.controllers},
        every=options.all,
        simulator=options.simulator,
        options=values,
        sampling=DISTRIBUTION,
        effectors={name: {"half_length": e.half_length, "half_width": e.half_width} for name, e in robot.effectors.items()},
        states=max(0, options.states),
    )


def _simulator_options(defaults, assignments: list[str]) -> dict[str, Any]:
    """All options of the simulator, those named changed."""
    values = defaults._asdict()
    for assignment in assignments:
        name, _, text = assignment.partition("=")
        if name not in values:
            raise Refused(f"--set {assignment}: expected NAME=VALUE with one of the names {', '.join(values)}")
        try:
            values[name] = text if isinstance(values[name], str) else type(values[name])(json.loads(text))
        except (ValueError, TypeError):
            raise Refused(f"--set {assignment}: expected a value like {json.dumps(values[name])}") from None
    return values


class Progress(NamedTuple):
    """What is known of a campaign's rows."""

    rows: dict[int, Row]
    """By index, from file and journal."""
    written: int
    """How many of them the file holds: 0 to written - 1."""
    versions: list[dict[str, str]]
    """Of the libraries that made the rows; more than one entry if they changed in between."""


def _run(options: argparse.Namespace) -> int:
    settings = settings_of(options)
    with Journal(options.output.with_name(f"{options.output.name}.journal")) as journal:
        try:
            progress = _known(options.output, journal, settings)
        except (Refused, Unreadable):
            if not journal.records:
                journal.remove()
            raise
        if progress.written >= options.samples:
            print(f"{options.output}: complete, {progress.written} samples ({options.samples} asked for)")
            if not any(index >= progress.written for index in progress.rows):
                journal.remove()
            return 0
        try:
            _simulate(options, settings, journal, progress)
        except KeyboardInterrupt:
            kept = f"{len(progress.rows)} of {options.samples} samples are kept in {journal.path.name}"
            print(f"\ninterrupted: {kept}; the same command resumes", file=sys.stderr)
            return 130
        return _finish(options, settings, journal, progress)


def _known(output: Path, journal: Journal, settings: Settings) -> Progress:
    """Rows from an earlier run. Raises Refused naming what differs if that had other settings."""
    rows: dict[int, Row] = {}
    versions: list[dict[str, str]] = []
    written = 0
    if output.exists():
        found, versions, old = read(output)
        _compare(output, found, settings)
        rows, written = {row["index"]: row for row in old}, len(old)
    for record in journal.records:
        if "settings" in record:
            _compare(journal.path, record["settings"], settings)
            versions += [record["versions"]] if record["versions"] not in versions else []
        else:
            rows[record["index"]] = record
    return Progress(rows, written, versions)


def _compare(path: Path, found: dict[str, Any], settings: Settings) -> None:
    there, here = _flat(found), _flat(json.loads(json.dumps(settings._asdict())))
    keys = [key for key in {**here, **there} if there.get(key) != here.get(key)]
    if keys:
        differences = "; ".join(f"{key} is {there.get(key)!r} there and {here.get(key)!r} now" for key in keys)
        raise Refused(f"{path} was made with other settings: {differences}. Name another output, or move it away")


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    """Every value by its path."""
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        flat |= {f"{key}.{name}": inner for name, inner in value.items()} if isinstance(value, dict) else {key: value}
    return flat


def _simulate(options: argparse.Namespace, settings: Settings, journal: Journal, progress: Progress) -> None:
    """Fill `progress` and the journal with what is missing, until done or out of time."""
    deadline = time.monotonic() + (options.budget or float("inf"))
    missing = [index for index in range(options.samples) if index not in progress.rows]
    if not missing:
        return
    versions = {name: version(name) for name in LIBRARIES}
    journal.append({"settings": settings._asdict(), "versions": versions})
    if versions not in progress.versions:
        progress.versions.append(versions)
    questions = itertools.takewhile(lambda _: time.monotonic() < deadline, missing)
    counts = Counter(_kind(progress.rows[i]) for i in range(options.samples) if i in progress.rows)
    interval = 0.5 if sys.stderr.isatty() else 30.0
    with (
        contextlib.closing(answers(labeller, (settings, str(options.robot)), questions, options.jobs)) as results,
        tqdm(total=options.samples, initial=options.samples - len(missing), unit="sample", mininterval=interval) as bar,
    ):
        for index, answer in results:
            row = {"index": index, "error": str(answer)} if isinstance(answer, Died) else answer
            journal.append(row)
            progress.rows[index] = row
            counts[_kind(row)] += 1
            bar.set_postfix(counts, refresh=False)
            bar.update()


def _kind(row: Row) -> str:
    return "errors" if "error" in row else row.get("outcome", "done")


def _finish(options: argparse.Namespace, settings: Settings, journal: Journal, progress: Progress) -> int:
    """Write the file of the longest complete run of samples from 0, and delete the journal if that is all of it."""
    count = next(index for index in itertools.count() if index not in progress.rows or index == options.samples)
    rows = [progress.rows[index] for index in range(count)]
    if count > progress.written:
        model = load(options.robot).model
        write(options.output, settings, progress.versions, rows, model.nq, model.nv)
    if all(index < count for index in progress.rows):
        journal.remove()
    summary = ", ".join(f"{number} {kind}" for kind, number in sorted(Counter(map(_kind, rows)).items()))
    print(f"{options.output}: {count} of {options.samples} samples ({summary})")
    if count < options.samples:
        print("out of time; the same command continues", file=sys.stderr)
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main())
