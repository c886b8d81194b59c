"""What the engine costs: many files in this process, in others and on a Dask cluster, against one file of the same rows.

    python -m bench.engine [--files N] [--rows N] [--workers N]

200 files of 50,000 rows by default, float32, one contact set. Programs are compiled before, and kept in a folder that
all share. Seconds are those of the whole command without starting Python; `of one file` is the throughput over that of
the one file in one process, which uses all cores; `at work` the same from when every worker has done two files, so without
their waiting for JAX to begin, which a longer job does not notice. At the end, what 10^10 states on 64 workers come to by
these costs, on paper. What becomes of killed workers and schedulers: `python -m bench.dask_kills`.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from bench.dask_cluster import DaskCluster
from bench.maps import CONTACTS
from bench.memory import write_dataset
from bench.process import in_process
from jaxcap.engine import Unit, over_units
from jaxcap.engine.cluster import cluster

MB = 1e6
EMPTY = 200
"""Units that do nothing, to see what handing one over costs."""
PAPER_STATES, PAPER_WORKERS = 1e10, 64


class Line(NamedTuple):
    """A line of the table."""

    what: str
    seconds: float
    states: int
    peak_bytes: int | None = None
    """The largest resident memory of a process that scores."""
    at_work: float | None = None
    """States a second when all workers have begun."""


class Job(NamedTuple):
    """What is scored, and with which options in any case."""

    folder: Path
    states: int
    options: list[str]

    def command(self, states: str, output: str, *options: str) -> list[str]:
        """Arguments of `jaxcap`."""
        where = [str(self.folder / states), "-o", str(self.folder / output)]
        return ["score", *where, "--contacts", str(CONTACTS), *self.options, *options]

    def here(self, what: str, states: str, output: str, *options: str, workers: int = 1) -> Line:
        """One command, and what it took; memory is that of the command itself."""
        cost = in_process(self.command(states, output, *options))
        memory = None if "--jobs" in options else cost.peak_bytes
        return Line(what, cost.seconds, self.states, memory, at_work(self.folder / output, self.states, 2 * workers))


def at_work(folder: Path, states: int, begun: int) -> float | None:
    """States a second of a folder after so many files, by the times at which the files appeared; None for a file."""
    times = sorted(file.stat().st_mtime for file in folder.glob("*.parquet"))
    share = (len(times) - begun) / len(times) if len(times) > begun else 0
    return share * states / (times[-1] - times[begun - 1]) if share else None


def prepared(folder: Path, files: int, rows: int) -> Job:
    """The files of a job, and its programs."""
    (folder / "log").mkdir()
    write_dataset(folder, files, rows)
    job = Job(folder, files * rows, ["--cache", str(folder / "cache")])
    for name in ("all.parquet", "in/00000.parquet"):  # compiles
        in_process(job.command(name, "compiled.parquet", "--force"))
    return job


def peak(pid: int) -> int:
    """Largest resident memory of a process so far, where Linux tells it [bytes]; else 0."""
    try:
        status = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmHWM"))


def on_dask(job: Job, workers: int) -> Line:
    """The job on a cluster of so many workers, which have imported nothing."""
    with DaskCluster(job.folder / "log", workers) as dask:
        line = job.here("", "in", f"dask{workers}", "--dask", dask.address, workers=workers)
        memory = max(peak(worker.pid) for worker in dask.workers)
    return line._replace(what=f"Dask, {workers} worker{'s' if workers > 1 else ''}", peak_bytes=memory)


def handing_over(folder: Path) -> float:
    """Seconds that a unit costs that does nothing, on one worker."""
    with DaskCluster(folder / "log", 1) as dask, cluster(dask.address, 1) as place:
        units = [Unit(number, number) for number in range(EMPTY)]
        list(over_units(place, abs, units[:10]))
        start = time.perf_counter()
        list(over_units(place, abs, units))
        return (time.perf_counter() - start) / EMPTY


def on_paper(job: Job, files: int, alone: Line, unit: float) -> str:
    """What saturates first, by the costs measured."""
    size = lambda name: sum(file.stat().st_size for file in (job.folder / name).glob("*.parquet")) / job.states
    read, written, per_state = size("in"), size("here"), alone.seconds / alone.states
    units = PAPER_STATES / (job.states / files)
    compute = PAPER_STATES * per_state / PAPER_WORKERS
    traffic = PAPER_STATES * (read + written) / compute
    return (
        f"on paper, 10^10 states in {units:.3g} files on {PAPER_WORKERS} workers like one here: {compute / 3600:.2g} h; "
        f"reads {read:.3g} and writes {written:.3g} bytes a state, {traffic / MB:.3g} MB/s for a disk that all share; "
        f"the scheduler hands over {units / compute:.3g} files a second (one worker alone took {1 / unit:.3g} empty units a "
        "second here), the fewer the larger they are"
    )


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--files", type=int, default=200)
    parser.add_argument("--rows", type=int, default=50_000, help="of each file")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        job = prepared(Path(name), options.files, options.rows)
        one = job.here("one file, this process", "all.parquet", "scores.parquet")
        lines = [one, job.here("files, this process", "in", "here")]
        jobs = ("--jobs", str(options.workers))
        lines.append(job.here(f"files, {options.workers} processes", "in", "processes", *jobs, workers=options.workers))
        lines += [on_dask(job, workers) for workers in sorted({1, options.workers})]
        print(f"{options.files} files of {options.rows} rows, float32")
        print(f"{'what':<26}{'seconds':>10}{'states/s':>12}{'of one file':>13}{'at work':>9}{'peak MB':>10}")
        for line in lines:
            memory = "" if line.peak_bytes is None else f"{line.peak_bytes / MB:.0f}"
            share, later = one.seconds / line.seconds, ""
            if line.at_work is not None:
                later = f"{line.at_work * one.seconds / one.states:.2f}"
            rate = line.states / line.seconds
            print(f"{line.what:<26}{line.seconds:>10.2f}{rate:>12.3g}{share:>13.2f}{later:>9}{memory:>10}")
        alone = next(line for line in lines if line.what == "Dask, 1 worker")
        print(on_paper(job, options.files, alone, handing_over(Path(name))))


if __name__ == "__main__":
    main()
