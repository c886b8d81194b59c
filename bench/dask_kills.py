"""On a Dask cluster whose workers and scheduler are killed: has a dataset, a map, a campaign the bytes of one process?

    python -m bench.dask_kills [JOB ...] [--files N] [--rows N] [--states N] [--samples N]

Full size by default: 200 files with 10^7 rows, a map of 10^8 states, 200 simulated samples; a few minutes each on two cores.
Every job is done by one process first. Then by a cluster of two workers, real processes: one is killed when a third
is done, the scheduler when two thirds are; the command says so and ends, a scheduler and a worker are started anew,
and the same command is given again. `kept` are the units that were done by then. `twice` are those of them that were done
again, by the times of their files or by the records of the journal; it has to be 0.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zarr

from bench.dask_cluster import DaskCluster, jaxcap, kill, program, until
from bench.maps import CONTACTS, axes
from bench.memory import write_dataset
from jaxcap.maps.store import JOURNAL, partial_path
from reference.tsid.journal import records_of

PATIENCE = 1800.0
"""Nothing here takes longer [s]."""


class Job(NamedTuple):
    """A command, and how far it is."""

    what: str
    begin: Callable[..., subprocess.Popen]
    """Its process, from where the output goes and further options."""
    output: str
    """Name of the output."""
    done: Callable[[Path], dict]
    """Units that are done in an output that is not complete, and what changes if one is done again."""
    units: Callable[[Path], int]
    """How many there are in a complete output."""


class Killed(NamedTuple):
    """What came out."""

    alone: float
    """Seconds by one process, starting Python included."""
    clustered: float
    """Seconds on the cluster, both commands together."""
    units: int
    kept: int
    twice: int
    same: bool
    """Whether the bytes are those of one process."""


def files_of(folder: Path, files: int, rows: int) -> Job:
    """A dataset to score, which is written here."""
    write_dataset(folder, files, rows)
    begin = lambda output, *options: jaxcap(
        "score", folder / "in", "--contacts", CONTACTS, "-o", output, "--cache", folder / "cache", *options
    )
    times = lambda output: {path.name: path.stat().st_mtime_ns for path in output.glob("*.parquet")}
    return Job(f"{files} files, {files * rows:.3g} rows", begin, "scores", times, lambda output: len(times(output)))


def map_of(folder: Path, states: int) -> Job:
    """A map of four axes, of at least so many states."""
    texts = axes(CONTACTS, states)
    options = [f"--axis={name}={text}" for name, text in texts.items()]
    begin = lambda output, *more: jaxcap("map", CONTACTS, "-o", output, "--cache", folder / "cache", *options, *more)
    size = int(np.prod([int(text.split(":")[2]) for text in texts.values()]))
    return Job(f"map of {size:.3g} states", begin, "map.zarr", _regions_done, _regions)


def _regions_done(output: Path) -> dict:
    """Regions that the journal knows, with the number of its lines for each."""
    journal = partial_path(output) / JOURNAL
    lines = journal.read_text().split() if journal.exists() else []
    return {line: lines.count(line) for line in lines}


def _regions(output: Path) -> int:
    """A region is a chunk of the verdicts."""
    verdicts = zarr.open_group(output, mode="r")["capturable"]
    assert isinstance(verdicts, zarr.Array)
    return int(np.prod([-(-size // chunk) for size, chunk in zip(verdicts.shape, verdicts.chunks, strict=True)]))


def campaign_of(samples: int) -> Job:
    """Simulated pushes of TALOS on two feet."""
    begin = lambda output, *options: program(
        "reference.tsid.campaign", "two", "--samples", samples, "--seed", 2018, "-o", output, *options
    )
    return Job(f"campaign of {samples} samples", begin, "two.parquet", _samples_done, lambda output: samples)


def _samples_done(output: Path) -> dict:
    """Samples that the journal knows, with the number of its records for each."""
    journal = output.with_name(f"{output.name}.journal")
    records = list(records_of(journal)) if journal.exists() else []
    rows = [record["index"] for record in records if "index" in record]
    return {row: rows.count(row) for row in rows}


def killed(job: Job, folder: Path) -> Killed:
    """The job by one process, and on a cluster of which a worker and then the scheduler is killed."""
    (folder / "alone").mkdir()
    (folder / "cluster").mkdir()
    one, other = folder / "alone" / job.output, folder / "cluster" / job.output
    start = time.perf_counter()
    ended(job.begin(one))
    alone = time.perf_counter() - start
    units = job.units(one)
    start = time.perf_counter()
    with DaskCluster(folder, 2) as dask:
        run = job.begin(other, "--dask", dask.address)
        until(lambda: 3 * len(job.done(other)) >= units, run, PATIENCE)
        kill(dask.workers[0])
        until(lambda: 3 * len(job.done(other)) >= 2 * units, run, PATIENCE)
        kill(dask.scheduler)
        run.communicate()
        if not run.returncode:
            raise RuntimeError(f"{job.what}: it was done before the scheduler was killed")
        kept = job.done(other)
        dask.start_scheduler()
        dask.start_worker()  # the others have ended with their scheduler
        run = job.begin(other, "--dask", dask.address)
        twice = _watched(run, lambda: job.done(other), kept)
    seconds = time.perf_counter() - start
    return Killed(alone, seconds, units, len(kept), twice, _tree(one) == _tree(other))


def _watched(run: subprocess.Popen, done: Callable[[], dict], kept: dict) -> int:
    """Waits for the command. Returns how many of the units that were kept have been done again."""
    again: set = set()
    while run.poll() is None:
        now = done()
        again |= {unit for unit in kept if unit in now and now[unit] != kept[unit]}
        time.sleep(0.05)
    ended(run)
    return len(again)


def ended(run: subprocess.Popen) -> None:
    """Waits. Raises RuntimeError with what the command said, if that was an error."""
    _, error = run.communicate()
    if run.returncode:
        raise RuntimeError(error)


def _tree(path: Path) -> dict[str, bytes]:
    """All files under a path, but for the records of who did what when."""
    if path.is_file():
        return {"": path.read_bytes()}
    files = [file for file in path.rglob("*") if file.is_file() and not file.relative_to(path).parts[0].startswith("_")]
    return {str(file.relative_to(path)): file.read_bytes() for file in files}


def main() -> None:
    """Does and prints."""
    parser = argparse.ArgumentParser(prog="python -m bench.dask_kills", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("jobs", nargs="*", metavar="JOB", help="files, map, campaign; default: all three")
    parser.add_argument("--files", type=int, default=200)
    parser.add_argument("--rows", type=int, default=50_000, help="of each file")
    parser.add_argument("--states", type=int, default=10**8, help="of the map")
    parser.add_argument("--samples", type=int, default=200, help="of the campaign")
    options = parser.parse_args()
    made: dict[str, Callable[[Path], Job]] = {
        "files": lambda folder: files_of(folder, options.files, options.rows),
        "map": lambda folder: map_of(folder, options.states),
        "campaign": lambda _: campaign_of(options.samples),
    }
    if unknown := set(options.jobs) - set(made):
        parser.error(f"{', '.join(sorted(unknown))} (expected {', '.join(made)})")
    os.environ["OMP_NUM_THREADS"] = "1"  # a campaign asks for it of its workers, which inherit it here
    print(f"{'job':<28}{'alone s':>9}{'cluster s':>11}{'units':>7}{'kept':>6}{'twice':>7}  bytes")
    for name in options.jobs or made:
        with tempfile.TemporaryDirectory() as folder:
            job = made[name](Path(folder))
            found = killed(job, Path(folder))
        bytes_are = "the same" if found.same else "DIFFERENT"
        counts = f"{found.units:>7}{found.kept:>6}{found.twice:>7}"
        print(f"{job.what:<28}{found.alone:>9.1f}{found.clustered:>11.1f}{counts}  {bytes_are}", flush=True)
        if not found.same or found.twice:
            sys.exit(1)


if __name__ == "__main__":
    main()
