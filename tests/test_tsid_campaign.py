"""Campaigns: the same bytes however they are run and interrupted; failures stay in their row; nothing is overwritten."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
import pyarrow.parquet as pq
import pytest

from reference.tsid import campaign, labels
from reference.tsid.holding import effort
from reference.tsid.journal import Busy, Journal
from reference.tsid.robot import load
from reference.tsid.sampling import draw, restore

ROOT = Path(__file__).parents[1]
FAKE = ("--simulator", "tests.tsid_fake", "--seed", "5")


def arguments(path, *more, scenario="four", samples=12):
    return [scenario, "--samples", str(samples), "-o", str(path), *FAKE, *more]


def rows(path):
    return pq.read_table(path).to_pylist()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("campaign")


@pytest.fixture(scope="module")
def whole(folder):
    """An uninterrupted campaign of 12 samples in one process."""
    assert campaign.main(arguments(folder / "whole.parquet")) == 0
    assert os.listdir(folder) == ["whole.parquet"]
    return folder / "whole.parquet"


def test_a_row_says_what_was_simulated(whole):
    robot = load("talos")
    table, settings = rows(whole), json.loads(pq.read_schema(whole).metadata[b"tsid"])["settings"]
    assert (settings["scenario"], settings["robot"], settings["seed"]) == ("four", "talos", 5)
    assert [row["index"] for row in table] == list(range(12))
    for row in table:
        sample = draw(robot, "four", 5, row["index"])
        np.testing.assert_array_equal(restore(robot.model, np.float32(row["q"])), sample.q)
        np.testing.assert_array_equal(row["v"], sample.v)
        assert row["error"] is None
        for found, contact in zip(row["contacts"], sample.contacts, strict=True):
            assert found["effector"] == contact.effector
            np.testing.assert_allclose(found["position"], contact.placement.translation, rtol=0, atol=5e-7)
            turned = pin.Quaternion(np.array(found["quaternion"])).normalized().toRotationMatrix()
            np.testing.assert_allclose(turned, contact.placement.rotation, rtol=0, atol=1e-6)
            assert settings["effectors"][contact.effector] == {
                "half_length": contact.half_length,
                "half_width": contact.half_width,
            }
            assert settings["sampling"]["friction"] == contact.friction
        data = robot.model.createData()
        momentum = pin.computeCentroidalMomentum(robot.model, data, sample.q, sample.v)
        np.testing.assert_array_equal(row["com"], np.float32(data.com[0]))
        np.testing.assert_array_equal(row["com_velocity"], np.float32(data.vcom[0]))
        np.testing.assert_array_equal(row["angular_momentum"], np.float32(momentum.angular))
        assert row["effort"] == np.float32(effort(robot, sample.q, sample.contacts))


def test_states_are_held_by_the_first_rows_only(tmp_path, whole):
    path = tmp_path / "states.parquet"
    assert campaign.main(arguments(path, "--states", "2", samples=4)) == 0
    for row, other in zip(rows(path), rows(whole), strict=False):
        held = row["index"] < 2
        assert (row["q"], row["v"]) == ((other["q"], other["v"]) if held else (None, None))
        assert {**row, "q": 0, "v": 0} == {**other, "q": 0, "v": 0}


def test_the_best_of_several_runs_no_more_than_it_must(whole):
    names = ("standard", "straight", "fast", "brake")
    best = set()
    for row in rows(whole):
        outcomes = [row[f"{name}_outcome"] for name in names]
        ran = [outcome for outcome in outcomes if outcome is not None]
        assert outcomes == ran + [None] * (4 - len(ran))
        assert "stopped" not in ran[:-1] and (ran[-1] == "stopped" or len(ran) == 4)
        for column, some in (("outcome", ran[:3]), ("best_of_four", ran)):
            assert row[column] == next(o for o in ("stopped", "undecided", "fallen") if o in some)
        for name, outcome in zip(names, outcomes, strict=True):
            for column in ("reason", "steps"):
                assert (row[f"{name}_{column}"] is None) == (outcome is None)
            assert row[f"{name}_refusals"] == (None if outcome is None else row[f"{name}_steps"] % 2)
        best.add((row["outcome"], row["best_of_four"]))
    assert {one for one, _ in best} == {"stopped", "undecided", "fallen"}


def test_brake_changes_only_the_best_of_four():
    settings = campaign.settings_of(campaign._parse(["four", "--samples", "1", "-o", "x.parquet", *FAKE]))
    for brake in ("stopped", "undecided", "fallen"):
        row = labels.judge(settings, lambda name, brake=brake: {f"{name}_outcome": brake if name == "brake" else "fallen"})
        assert (row["outcome"], row["best_of_four"]) == ("fallen", brake)
    row = labels.judge(settings, lambda name: {f"{name}_outcome": "stopped"})
    assert row == {"standard_outcome": "stopped", "outcome": "stopped", "best_of_four": "stopped"}


def test_every_controller_runs_if_asked(tmp_path, whole):
    path = tmp_path / "all.parquet"
    assert (
        campaign.main(arguments(path, "--all", "--controllers", "straight", "straight_up", "--zero-momentum", samples=4))
        == 0
    )
    table = rows(path)
    assert not {"outcome", "best_of_four", "standard_outcome"} & set(table[0])
    for row, other in zip(table, rows(whole), strict=False):
        assert row["straight_up_outcome"] == "stopped" and row["straight_outcome"] is not None
        assert (
            row["q"] == other["q"] and np.abs(row["angular_momentum"]).max() < 1e-4 < np.abs(other["angular_momentum"]).max()
        )
        refusals = [row.get(f"{name}_refusals", 0) for name in ("straight_up", "straight")]  # no column where none occurs
        assert refusals == [row["straight_up_steps"] % 2] * 2


def test_the_number_of_processes_does_not_matter(tmp_path, whole):
    path = tmp_path / "two.parquet"
    assert campaign.main(arguments(path, "--jobs", "2")) == 0
    assert path.read_bytes() == whole.read_bytes()


def test_a_shorter_file_is_continued_and_a_longer_one_left(tmp_path, whole, capsys):
    path = tmp_path / "a.parquet"
    assert campaign.main(arguments(path, samples=5)) == 0
    first = path.read_bytes()
    assert campaign.main(arguments(path)) == 0
    assert path.read_bytes() == whole.read_bytes() != first
    assert campaign.main(arguments(path, samples=5)) == 0
    assert "complete, 12 samples (5 asked for)" in capsys.readouterr().out
    assert path.read_bytes() == whole.read_bytes() and os.listdir(tmp_path) == ["a.parquet"]


def test_a_budget_ends_it_and_a_later_run_continues(tmp_path, whole):
    path = tmp_path / "b.parquet"
    assert campaign.main(arguments(path, "--budget", "1e-9")) == 3
    assert not path.exists()
    with Journal(tmp_path / "b.parquet.journal") as journal:  # results that came out of order
        header = json.loads(pq.read_schema(whole).metadata[b"tsid"])
        journal.append({"settings": header["settings"], "versions": header["versions"][0]})
        for row in rows(whole):
            if row["index"] in (0, 1, 3):
                journal.append({name: x for name, x in row.items() if x is not None})
    assert campaign.main(arguments(path, "--budget", "1e-9")) == 3
    assert [row["index"] for row in rows(path)] == [0, 1]
    assert sorted(os.listdir(tmp_path)) == ["b.parquet", "b.parquet.journal"]
    assert campaign.main(arguments(path)) == 0
    assert path.read_bytes() == whole.read_bytes() and os.listdir(tmp_path) == ["b.parquet"]


def test_killed_at_random_moments_it_resumes_to_the_same_bytes(tmp_path):
    """SIGKILL of the campaign, or of its processes as well; a slow simulator, so that it is caught at work."""
    more = ("--set", "delay=0.05", "--jobs", "2")
    command = [sys.executable, "-m", "reference.tsid.campaign", *arguments(tmp_path / "killed.parquet", *more, samples=16)]
    rng, caught, journal = random.Random(1), 0, tmp_path / "killed.parquet.journal"
    for _ in range(40):
        process = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
        )
        until = (journal.stat().st_size if journal.exists() else 0) + rng.randrange(40_000)
        start = time.monotonic()
        while process.poll() is None and time.monotonic() - start < 60:
            if journal.exists() and journal.stat().st_size > until:
                time.sleep(rng.uniform(0.0, 0.1))
                break
            time.sleep(0.005)
        process.kill() if rng.random() < 0.5 else os.killpg(process.pid, signal.SIGKILL)
        error = process.communicate(timeout=30)[1]  # returns when the last process that it started has ended
        if process.returncode != -signal.SIGKILL:
            assert process.returncode == 0, error
            break
        caught += 1
        if journal.exists():  # and the disk has only part of the last record
            with open(journal, "ab") as file:
                file.write(b"\x20\x03\x00\x00torn"[: rng.randrange(9)])
    else:
        pytest.fail("40 runs did not end it")
    assert caught >= 2
    assert campaign.main(arguments(tmp_path / "whole.parquet", "--set", "delay=0.05", samples=16)) == 0
    assert (tmp_path / "killed.parquet").read_bytes() == (tmp_path / "whole.parquet").read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["killed.parquet", "whole.parquet"]


def test_ctrl_c_keeps_the_journal_and_says_how_to_resume(tmp_path):
    path = tmp_path / "c.parquet"
    program = (  # a shell that runs the tests in the background has the signal ignored
        "import signal, sys; from reference.tsid.campaign import main;"
        "signal.signal(signal.SIGINT, signal.default_int_handler); sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", program, *arguments(path, "--set", "delay=0.2", "--jobs", "2")]
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, start_new_session=True)
    journal, start = tmp_path / "c.parquet.journal", time.monotonic()
    while time.monotonic() - start < 60 and not (journal.exists() and journal.stat().st_size > 8000):
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    error = process.communicate(timeout=30)[1]
    assert process.returncode == 130
    assert "samples are kept in c.parquet.journal; the same command resumes" in error and "Traceback" not in error
    assert os.listdir(tmp_path) == ["c.parquet.journal"]


def test_a_failing_sample_fails_in_its_own_row(tmp_path, whole):
    for name in ("raises_at=2", "dies_at=2"):
        path = tmp_path / f"{name}.parquet"
        assert campaign.main(arguments(path, "--set", name, samples=4)) == 0
        for row, good in zip(rows(path), rows(whole), strict=False):
            if row["index"] != 2:
                assert row["error"] is None and row == good
            else:
                expected = "ArithmeticError: sample 2 is not to my taste" if name == "raises_at=2" else "exit code -6"
                assert expected in row["error"]
                assert row["outcome"] is row["standard_outcome"] is row["standard_steps"] is None
                assert (row["q"] is None) == (name == "dies_at=2")


def test_other_settings_are_refused_and_nothing_is_touched(tmp_path, whole, capsys):
    path = tmp_path / "d.parquet"
    path.write_bytes(whole.read_bytes())
    for more, difference in [
        (("--seed", "6"), "seed is 5 there and 6 now"),
        (("--set", "delay=0.5"), "options.delay is 0.0 there and 0.5 now"),
        (("--robot", "g1"), "robot is 'talos' there and 'g1' now; robot_hash"),
        (("--controllers", "fast"), "now; configurations.standard is '0.3' there and None now"),
        (("--zero-momentum",), "zero_momentum is False there and True now"),
    ]:
        assert campaign.main(arguments(path, *more, samples=20)) == 1
        assert difference in capsys.readouterr().err
    path.write_bytes(b"PAR1 not really")
    assert campaign.main(arguments(path)) == 1
    assert "not the file of a campaign" in capsys.readouterr().err
    assert path.read_bytes() == b"PAR1 not really" and os.listdir(tmp_path) == ["d.parquet"]


@pytest.mark.parametrize(
    "more, message",
    [
        (("--controllers", "standard", "wild"), "expected some of, each once: standard, straight, fast"),
        (("--set", "daley=1"), "expected NAME=VALUE with one of the names delay, raises_at, dies_at"),
        (("--set", "delay=soon"), "expected a value like 0.0"),
        (("--set", "delay=-1"), "delay = -1.0 (expected at least 0)"),
        (("--simulator", "tests.nothing"), "--simulator tests.nothing: No module named"),
        (("--robot", "atlas"), "robot 'atlas': no such file"),
        (("-o", "/nowhere/x.parquet"), "expected a .parquet file in a folder that exists"),
    ],
)
def test_bad_arguments_are_named(tmp_path, capsys, more, message):
    assert campaign.main(arguments(tmp_path / "e.parquet", *more)) == 1
    assert message in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_two_campaigns_do_not_share_a_file(tmp_path, capsys):
    with Journal(tmp_path / "f.parquet.journal"):
        assert campaign.main(arguments(tmp_path / "f.parquet")) == 1
    assert "f.parquet.journal: another campaign is writing it" in capsys.readouterr().err


def test_a_journal_drops_what_was_torn(tmp_path):
    path = tmp_path / "journal"
    with Journal(path) as journal:
        journal.append({"index": 0, "value": 0.1})
        journal.append([1, None])
        with pytest.raises(Busy):
            Journal(path)
    content = path.read_bytes()
    for end in range(len(content) + 1):
        path.write_bytes(content[:end])
        with Journal(path) as journal:
            kept = journal.records
            journal.append("next")
        with Journal(path) as journal:
            assert journal.records == [*kept, "next"]
        assert kept == [{"index": 0, "value": 0.1}, [1, None]][: len(kept)] and (len(kept) == 2) == (end == len(content))
    path.write_bytes(content[:12] + b"?" + content[13:])
    with Journal(path) as journal:
        assert journal.records == []
