"""Label a scenario's samples by simulation: `python -m reference.tsid.campaign two --samples 100 -o two.parquet --jobs 2`.

A campaign's file holds samples 0 to N-1. Interrupt it as you like, Ctrl-C or SIGKILL: results go to a journal beside the
file as they come, and the same command resumes; the file is the same to the byte as that of an uninterrupted run. A file
that is there already is continued if it has the same settings and fewer samples.

Samples are units of `jaxcap.engine`, which knows nothing of robots: they run on processes of this machine, on the workers
of a Dask scheduler (--dask; each with one thread, and this folder on its PYTHONPATH), or in shards, commands of their own in
any queue (--shard 0/64 to 63/64). The shard that ends last writes the file; so does the command without --shard, which does
what is missing.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from reference.extras import extra

with extra("sim", __name__):
    from tqdm import tqdm

    from jaxcap.engine import Finished, Place, Shard, Terms, Unit, check_place, chosen, over_units, shard_of
    from jaxcap.errors import InputError, MissingExtra
    from reference.tsid.journal import Busy
    from reference.tsid.labelling import ONE_CORE, THREADS, about, labelling, robot_hash, versions
    from reference.tsid.labels import BEST_OF_FOUR, Row, Settings, toolbox
    from reference.tsid.progress import Journals, Progress, Refused, known
    from reference.tsid.robot import configuration, load
    from reference.tsid.sampling import DISTRIBUTION, SCENARIOS
    from reference.tsid.table import Unreadable, write

STATES = 10_000
"""Rows that hold q and v, unless told otherwise."""

TERMS = Terms(about, ahead=1, environment=ONE_CORE, niceness=10)
"""What a campaign asks of workers."""

TRIES = 2
"""How often a sample is tried: a kill from outside hits it once, a crash of its own again."""

TOLD = 5
"""Samples that could not be labelled of which a line is printed."""


def main(arguments: list[str] | None = None) -> int:
    """Run a campaign. Returns the exit status: 0 done, 1 refused, 2 wrong usage, 3 out of time, 130 interrupted."""
    options = _parse(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a scheduler's request to end is a Ctrl-C
    try:
        return _run(options)
    except (Refused, Busy, Unreadable, InputError, MissingExtra, OSError) as error:
        print(f"campaign: {error}", file=sys.stderr)
        return 1


def _parse(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m reference.tsid.campaign", description=__doc__.split("\n\n")[0])
    add = parser.add_argument
    add("scenario", choices=SCENARIOS)
    add("--samples", type=_positive(int), required=True, metavar="N", help="samples 0 to N-1")
    add("-o", "--output", type=Path, required=True, metavar="FILE.parquet")
    add("--jobs", type=_positive(int), default=1, metavar="J", help="processes, one core each (default: 1)")
    add("--dask", metavar="ADDRESS", help="scheduler whose workers simulate, tcp://HOST:PORT; local: J workers of its own")
    add("--shard", metavar="I/N", help="every Nth sample from the Ith, from 0; the last shard to end writes the file")
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
    return Settings(
        scenario=options.scenario,
        robot=robot.name,
        robot_hash=robot_hash(options.robot),
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


def _run(options: argparse.Namespace) -> int:
    shard = shard_of(options.shard)
    check_place(options.dask, options.jobs)
    settings = settings_of(options)
    with Journals(options.output, shard) as journals:
        try:
            progress = known(options.output, journals, settings)
            if progress.written >= options.samples:
                return _complete(options, journals, progress)
            failed = _simulate(options, settings, shard, journals, progress)
        except KeyboardInterrupt:
            mine = shard.part(list(range(options.samples)))
            kept = sum(index in progress.rows for index in mine)
            told = f"{kept} of {len(mine)} samples are kept in {journals.own.path.name}"
            print(f"\ninterrupted: {told}; the same command resumes", file=sys.stderr)
            return 130
        except (Refused, Unreadable, InputError, MissingExtra):
            journals.leave()
            raise
        if shard.of > 1:  # others may have ended by now
            journals.own.sync()
            progress = known(options.output, journals, settings)
        return _finish(options, settings, shard, journals, progress, failed)


def _complete(options: argparse.Namespace, journals: Journals, progress: Progress) -> int:
    print(f"{options.output}: complete, {progress.written} samples ({options.samples} asked for)")
    if not any(index >= progress.written for index in progress.rows):
        journals.remove()
    return 0


def _simulate(
    options: argparse.Namespace, settings: Settings, shard: Shard, journals: Journals, progress: Progress
) -> list[Finished]:
    """Fill `progress` and the journal with what is missing, until done or out of time. Returns what could not be tried."""
    deadline = time.monotonic() + (options.budget or float("inf"))
    part = shard.part(list(range(options.samples)))
    missing = [index for index in part if index not in progress.rows]
    if not missing:
        return []
    failed = []
    units = itertools.takewhile(lambda _: time.monotonic() < deadline, (Unit(index, index) for index in missing))
    counts = Counter(_kind(progress.rows[index]) for index in part if index in progress.rows)
    interval = 0.5 if sys.stderr.isatty() else 30.0
    with (
        _place(options) as place,
        tqdm(total=len(part), initial=len(part) - len(missing), unit="sample", mininterval=interval) as bar,
        contextlib.closing(over_units(place, labelling(settings, _robot(options)), units, TRIES)) as results,
    ):
        journals.own.append({"settings": settings._asdict(), "versions": versions()})
        progress.versions.extend([] if versions() in progress.versions else [versions()])
        for one in results:
            if one.error and not one.died:
                failed.append(one)
                continue
            row: Row = {"index": one.unit.number, "error": one.error} if one.died else one.value
            journals.own.append(row)
            progress.rows[one.unit.number] = row
            counts[_kind(row)] += 1
            bar.set_postfix(counts, refresh=False)
            bar.update()
    return failed


@contextlib.contextmanager
def _place(options: argparse.Namespace) -> Iterator[Place]:
    """Where samples run. Raises Refused where that is not like here, InputError and MissingExtra."""
    with chosen(options.dask, options.jobs, TERMS, apart=True) as place:
        expected = about() | {THREADS: "1"}
        for name, value in expected.items():
            if (found := place.about.get(name)) != value:
                raise Refused(f"{place.words}: {name} is {found} there (expected {value}, as here)")
        yield place


def _robot(options: argparse.Namespace) -> str:
    """Its name, or its file, as it is found from any folder."""
    return options.robot if not Path(options.robot).is_file() else str(configuration(options.robot).resolve())


def _kind(row: Row) -> str:
    return "errors" if "error" in row else row.get("outcome", "done")


def _finish(
    options: argparse.Namespace,
    settings: Settings,
    shard: Shard,
    journals: Journals,
    progress: Progress,
    failed: list[Finished],
) -> int:
    """Write the file of the longest complete run of samples from 0, and delete the journals if that is all of it."""
    count = next(index for index in itertools.count() if index not in progress.rows or index == options.samples)
    mine = shard.part(list(range(options.samples)))
    if shard.of > 1 and count < options.samples:
        done = sum(index in progress.rows for index in mine)
        there = sum(index < options.samples for index in progress.rows)
        print(f"{options.output}: shard {shard}, {done} of its {len(mine)} samples; {there} of all {options.samples}")
        return _status(failed, done < len(mine))
    rows = [progress.rows[index] for index in range(count)]
    if count > progress.written:
        model = load(options.robot).model
        write(options.output, settings, progress.versions, rows, model.nq, model.nv)
    if all(index < count for index in progress.rows):
        journals.remove()
    summary = ", ".join(f"{number} {kind}" for kind, number in sorted(Counter(map(_kind, rows)).items()))
    print(f"{options.output}: {count} of {options.samples} samples ({summary})")
    return _status(failed, count < options.samples)


def _status(failed: list[Finished], incomplete: bool) -> int:
    """The exit status, and why."""
    for one in failed[:TOLD]:
        print(f"sample {one.unit.number} was not labelled: {one.error}", file=sys.stderr)
    if failed:
        print(f"{len(failed)} samples were not labelled; the same command tries again", file=sys.stderr)
        return 1
    if incomplete:
        print("out of time; the same command continues", file=sys.stderr)
        return 3
    return 0


if __name__ == "__main__":
    sys.exit(main())
