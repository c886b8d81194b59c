"""On a real Dask cluster: a scheduler and workers as commands, some of which are killed."""

import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

pytest.importorskip("distributed")

from state_files import states, vectors, write_contacts
from test_score_folder import tree

from bench.dask_cluster import DaskCluster, jaxcap, kill, until

FILES = 60


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Files of states, and their scores by one process."""
    folder = tmp_path_factory.mktemp("dataset")
    (folder / "in").mkdir()
    write_contacts(folder / "feet.yaml")
    for number in range(FILES):
        coms, velocities = states(2000, number)
        table = pa.table({"com": vectors(coms), "com_velocity": vectors(velocities)})
        pq.write_table(table, folder / "in" / f"{number:02}.parquet")
    finished(jaxcap(*scoring(folder, folder / "one")))
    return folder


def scoring(folder: Path, output: Path, *options: str) -> list:
    """Arguments that score the dataset."""
    return ["score", folder / "in", "--contacts", folder / "feet.yaml", "-o", output, *options]


def finished(process) -> str:
    """What it printed when it was done."""
    out, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    return out


def refused(process) -> str:
    """The line by which it refuses, and the seconds that it took."""
    out, err = process.communicate(timeout=240)
    assert process.returncode == 2 and out == "", (out, err)
    return err


def scored(folder: Path) -> int:
    """How many files are there."""
    return len(list(folder.glob("*.parquet")))


@pytest.mark.slow
def test_killed_workers_and_schedulers_change_no_byte(dataset, tmp_path):
    """A worker is killed in the middle, then the scheduler; the same command goes on, and nothing is lost or done twice."""
    out = tmp_path / "out"
    with DaskCluster(tmp_path) as dask:
        arguments = scoring(dataset, out, "--dask", dask.address)
        first = jaxcap(*arguments)
        until(lambda: scored(out) >= 2, first)
        kill(dask.workers[0])
        there = scored(out)
        until(lambda: scored(out) >= there + 2, first)
        kill(dask.scheduler)
        told = refused(first)
        assert dask.address in told and "what is done stays done" in told
        done = {file.name: file.stat().st_mtime_ns for file in out.glob("*.parquet")}
        assert 4 <= len(done) < FILES
        dask.start_scheduler()
        dask.start_worker()
        printed = finished(jaxcap(*arguments))
    assert f"{FILES} of {FILES} files" in printed and "files were there" in printed
    assert tree(out) == tree(dataset / "one")


CONNECT = """
import sys, time
from jaxcap.engine.cluster import cluster
start = time.monotonic()
try:
    with cluster(sys.argv[1], 1):
        pass
except ValueError as error:
    print(error)
print(time.monotonic() - start)
"""
"""In a process of its own: Dask's client leaves threads behind when it fails."""


@pytest.mark.slow
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "somewhere"])
def test_a_scheduler_that_does_not_answer_is_told_within_ten_seconds(address):
    done = subprocess.run([sys.executable, "-c", CONNECT, address], capture_output=True, text=True, check=True, timeout=100)
    told, seconds = done.stdout.splitlines()
    assert told == f"--dask {address}: no scheduler answers there (expected tcp://HOST:PORT, or local)"
    assert float(seconds) < 10


@pytest.mark.slow
def test_a_cluster_of_this_machine(dataset, tmp_path):
    """It begins and ends with the command."""
    printed = finished(jaxcap(*scoring(dataset, tmp_path / "out", "--dask", "local", "--jobs", "2")))
    assert "2 workers of a local cluster" in printed
    assert tree(tmp_path / "out") == tree(dataset / "one")


@pytest.mark.slow
def test_workers_that_are_different_are_refused_by_name(dataset, tmp_path):
    """One has another jaxcap, then one another JAX; then one has two task threads."""
    other = tmp_path / "other" / "jaxcap"
    other.mkdir(parents=True)
    (other / "__init__.py").write_text('__version__ = "0.0.7"\n')
    with DaskCluster(tmp_path, workers=0) as dask:
        arguments = scoring(dataset, tmp_path / "out", "--dask", dask.address)
        old = dask.start_worker(path=str(tmp_path / "other"))
        told = refused(jaxcap(*arguments))
        assert "worker tcp://127.0.0.1:" in told and "has jaxcap 0.0.7 (expected " in told
        kill(old)
    newer = tmp_path / "newer"
    newer.mkdir()
    (newer / "sitecustomize.py").write_text("import jax\njax.__version__ = '99.0'\n")
    with DaskCluster(tmp_path, workers=0) as dask:
        dask.start_worker(path=str(newer))
        told = refused(jaxcap(*scoring(dataset, tmp_path / "out", "--dask", dask.address)))
        assert "worker tcp://127.0.0.1:" in told and "has jax 99.0 (expected " in told
    with DaskCluster(tmp_path, workers=0) as dask:
        dask.start_worker(threads=2)
        told = refused(jaxcap(*scoring(dataset, tmp_path / "out", "--dask", dask.address)))
        assert "has 2 task threads (expected 1: dask worker --nthreads 1)" in told
    assert not (tmp_path / "out").exists()


OTHERS = """
import sys
sys.path.insert(0, sys.argv[2])
import only_here
from jaxcap.engine import Terms
from jaxcap.engine.cluster import cluster
try:
    with cluster(sys.argv[1], 1, Terms(about=only_here.about)):
        pass
except ValueError as error:
    print(error)
"""


@pytest.mark.slow
def test_workers_that_lack_what_the_job_needs_are_refused_by_name(tmp_path):
    (tmp_path / "only_here.py").write_text("def about():\n    return {}\n")
    with DaskCluster(tmp_path / "..", workers=1) as dask:
        command = [sys.executable, "-c", OTHERS, dask.address, str(tmp_path)]
        told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=100).stdout
    assert "worker tcp://127.0.0.1:" in told and "has no only_here (expected on its PYTHONPATH, as here)" in told


@pytest.mark.slow
def test_a_map_is_the_same_when_a_worker_is_killed(tmp_path):
    """And by spawned processes."""
    contacts = write_contacts(tmp_path / "feet.yaml")
    axes = ["--axis=com_x=0:0.1:3", "--axis=com_y=0", "--axis=heading=0:90deg:2", "--axis=friction=0.3:0.8:150"]
    mapping = lambda name, *options: ["map", contacts, "-o", tmp_path / f"{name}.zarr", *axes, *options]
    finished(jaxcap(*mapping("one")))
    finished(jaxcap(*mapping("processes", "--jobs", "2")))
    journal = tmp_path / "dask.zarr.partial" / "journal"
    with DaskCluster(tmp_path) as dask:
        run = jaxcap(*mapping("dask", "--dask", dask.address))
        until(lambda: journal.exists() and journal.stat().st_size, run)
        kill(dask.workers[0])
        assert journal.exists(), "it was not killed in time"
        finished(run)
    assert tree(tmp_path / "one.zarr") == tree(tmp_path / "processes.zarr") == tree(tmp_path / "dask.zarr")
