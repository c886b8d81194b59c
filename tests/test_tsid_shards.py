"""Campaigns beyond one process: in shards, and on a Dask cluster of real processes, with the bytes of one process."""

import os
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from bench.dask_cluster import DaskCluster, kill, until
from reference.tsid import campaign
from reference.tsid.journal import Journal, records_of
from reference.tsid.labelling import labelling

ROOT = Path(__file__).parents[1]
SAMPLES = 12


def arguments(path, *more, samples=SAMPLES):
    """A campaign with a simulator that takes no time."""
    fake = ("--simulator", "tests.tsid_fake", "--seed", "5")
    return ["four", "--samples", str(samples), "-o", str(path), *fake, *more]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An uninterrupted campaign of one process."""
    path = tmp_path_factory.mktemp("campaign") / "whole.parquet"
    assert campaign.main(arguments(path)) == 0
    return path


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_shards_in_any_order_make_the_whole(tmp_path, whole, order, capsys):
    path = tmp_path / "a.parquet"
    for number in order:
        assert not path.exists()
        assert campaign.main(arguments(path, "--shard", f"{number}/3")) == 0
    told = capsys.readouterr().out
    assert f"shard {order[0]}/3, 4 of its 4 samples; 4 of all 12" in told and "12 of 12 samples" in told
    assert path.read_bytes() == whole.read_bytes() and os.listdir(tmp_path) == ["a.parquet"]


def test_a_run_without_a_shard_makes_the_rest(tmp_path, whole):
    """Of a shard of three, of one of two that was broken off, and of a file with fewer samples."""
    path = tmp_path / "b.parquet"
    assert campaign.main(arguments(path, samples=2)) == 0
    assert campaign.main(arguments(path, "--shard", "1/3")) == 0
    assert campaign.main(arguments(path, "--shard", "1/2", "--budget", "1e-9")) == 3
    assert len(records_of(tmp_path / "b.parquet.journal-1-of-3")) == 1 + 3  # settings; of 1, 4, 7, 10 the file has 1
    assert campaign.main(arguments(path)) == 0
    assert path.read_bytes() == whole.read_bytes() and os.listdir(tmp_path) == ["b.parquet"]


def test_a_shard_and_the_whole_do_not_run_at_a_time(tmp_path, capsys):
    path = tmp_path / "c.parquet"
    for name, more in [
        ("c.parquet.journal", ("--shard", "0/3")),
        ("c.parquet.journal-0-of-3", ("--shard", "0/3")),
        ("c.parquet.journal-1-of-3", ()),
    ]:
        with Journal(tmp_path / name) as journal:
            assert campaign.main(arguments(path, *more)) == 1
            assert f"{name}: another campaign is writing it" in capsys.readouterr().err
            journal.remove()
        assert [file for file in os.listdir(tmp_path) if file != "c.parquet.journal"] == []


def test_a_shard_of_other_settings_is_refused(tmp_path, capsys):
    path = tmp_path / "d.parquet"
    assert campaign.main(arguments(path, "--shard", "0/2", samples=2)) == 0
    assert campaign.main(arguments(path, "--shard", "1/2", "--zero-momentum", samples=2)) == 1
    assert "zero_momentum is False there and True now" in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["d.parquet.journal-0-of-2"]


@pytest.mark.parametrize(
    "more, message",
    [
        (("--shard", "3/3"), "--shard 3/3 (expected 0/3 to 2/3"),
        (("--shard", "some"), "--shard some (expected i/n"),
        (("--jobs", "2", "--dask", "tcp://here:1"), "--jobs 2 (expected without --dask tcp://here:1"),
    ],
)
def test_bad_arguments_are_named(tmp_path, capsys, more, message):
    assert campaign.main(arguments(tmp_path / "e.parquet", *more)) == 1
    assert message in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_another_robot_there_is_an_error_by_name():
    """Where a worker finds another configuration under the name."""
    settings = campaign.settings_of(campaign._parse(arguments("x.parquet")))
    with pytest.raises(ValueError, match=r"robot g1: has another configuration here \(expected that of the campaign\)"):
        labelling(settings, "g1")(0)


def test_samples_that_could_not_be_tried_are_no_rows(tmp_path, whole, monkeypatch, capsys):
    """What a worker fails at, and not the simulation, is told, and tried again by the next run."""
    path = tmp_path / "f.parquet"
    monkeypatch.setattr(campaign, "labelling", lambda settings, robot: labelling(settings._replace(simulator="gone"), robot))
    assert campaign.main(arguments(path, samples=2)) == 1
    told = capsys.readouterr().err
    assert "sample 0 was not labelled: ModuleNotFoundError: No module named 'gone'" in told
    assert "2 samples were not labelled; the same command tries again" in told
    monkeypatch.undo()
    assert campaign.main(arguments(path)) == 0
    assert path.read_bytes() == whole.read_bytes() and os.listdir(tmp_path) == ["f.parquet"]


def command(path, *more) -> subprocess.Popen:
    """A campaign as a command."""
    line = [sys.executable, "-m", "reference.tsid.campaign", *arguments(path, *more)]
    return subprocess.Popen(line, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_on_a_cluster_a_killed_worker_changes_no_byte(tmp_path, monkeypatch):
    """Nor does the scheduler, when the command is given again."""
    pytest.importorskip("distributed")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert campaign.main(arguments(tmp_path / "one.parquet", "--set", "delay=0.2")) == 0
    path, journal = tmp_path / "dask.parquet", tmp_path / "dask.parquet.journal"
    with DaskCluster(tmp_path) as dask:
        slow = ("--set", "delay=0.2", "--dask", dask.address)
        first = command(path, *slow)
        until(lambda: len(records_of(journal)) >= 3, first)
        kill(dask.workers[0])
        there = len(records_of(journal))
        until(lambda: len(records_of(journal)) >= there + 2, first)
        kill(dask.scheduler)
        told = first.communicate(timeout=100)[1]
        assert first.returncode == 1 and dask.address in told and "what is done stays done" in told
        assert not path.exists() and 5 <= len(records_of(journal)) < 1 + SAMPLES
        dask.start_scheduler()
        dask.start_worker()
        again = command(path, *slow)
        told = again.communicate(timeout=100)[1]
        assert again.returncode == 0, told
    assert path.read_bytes() == (tmp_path / "one.parquet").read_bytes() and not journal.exists()


def test_a_cluster_of_this_machine_and_a_sample_that_kills_its_workers(tmp_path, whole):
    pytest.importorskip("distributed")
    path = tmp_path / "local.parquet"
    run = command(path, "--dask", "local", "--jobs", "2", "--set", "dies_at=2")
    told = run.communicate(timeout=200)[1]
    assert run.returncode == 0, told
    for row, good in zip(pq.read_table(path).to_pylist(), pq.read_table(whole).to_pylist(), strict=True):
        if row["index"] == 2:
            assert row["error"] == "its process died on 4 workers" and row["outcome"] is None
        else:
            assert row == good


def test_workers_with_more_threads_are_refused(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    with DaskCluster(tmp_path, workers=1) as dask:
        run = command(tmp_path / "g.parquet", "--dask", dask.address)
        told = run.communicate(timeout=100)[1]
    assert run.returncode == 1
    assert f"scheduler {dask.address}: OMP_NUM_THREADS is not set there (expected 1, as here)" in told
    assert not list(tmp_path.glob("g.parquet*"))
