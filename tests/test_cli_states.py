"""`jaxcap states`, and `jaxcap score --robot`."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

pin = pytest.importorskip("pinocchio")

from state_files import leftovers  # noqa: E402

from bench.robot_motion import main as make_log  # noqa: E402
from jaxcap import robots  # noqa: E402
from jaxcap.commands.cli import main  # noqa: E402


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "walk.csv"
    make_log(["g1", "-o", str(path), "--seconds", "2"])
    return path


def columns(path):
    table = pq.read_table(path)
    return {name: np.array(table[name].to_pylist()) for name in table.column_names}


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_states_are_written_whole_with_what_was_read_as_what(log, tmp_path, capsys, extension):
    output = tmp_path / f"states.{extension}"
    assert main(["states", str(log), "--robot", "g1", "-o", str(output), "--friction", "0.7"]) == 0
    assert "60 rows of 1 episodes, layout lafan1_g1" in capsys.readouterr().out
    if extension == "npz":
        with np.load(output) as file:
            found, said = dict(file), json.loads(str(file["metadata"]))
    else:
        found, said = columns(output), json.loads(pq.read_schema(output).metadata[b"jaxcap"])
    wanted = robots.states(log, "g1", friction=0.7)
    for name, values in wanted._asdict().items():
        np.testing.assert_array_equal(found[name], values)
    assert said["read"]["layout"]["quaternion"] == "xyzw" and said["read"]["friction"] == 0.7
    assert said["notes"] == [] and said["units"]["com"] == "m"


def test_notes_are_told_and_strict_refuses(log, tmp_path, capsys):
    rows = np.loadtxt(log, delimiter=",")
    rows[:, 2] += 0.05
    np.savetxt(log, rows, delimiter=",", fmt="%.17g")
    output = tmp_path / "states.parquet"
    assert main(["states", str(log), "--robot", "g1", "-o", str(output)]) == 0
    assert f"note: {log}: the soles stand at +0.050 m" in capsys.readouterr().err
    assert "the soles stand at" in json.loads(pq.read_schema(output).metadata[b"jaxcap"])["notes"][0]
    assert main(["states", str(log), "--robot", "g1", "-o", str(output), "--force", "--ground", "0.05", "--strict"]) == 0
    output.unlink()
    assert main(["states", str(log), "--robot", "g1", "-o", str(output), "--strict"]) == 2
    assert "--strict: " in capsys.readouterr().err and not output.exists() and not leftovers(tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--robot", "g2"], "robot 'g2' is unknown"),
        (["--robot", "g1", "--layout", "lafan"], "layout 'lafan' is unknown"),
        (["--robot", "g1", "--friction", "0"], "--friction 0.0 (expected a positive number)"),
        (["--robot", "g1", "--smooth", "4"], "--smooth 4 (expected an odd number"),
        (["--robot", "g1", "--ground", "up"], "ground 'up' is no height"),
        (["--robot", "g1", "--feet", "none.yaml"], "none.yaml: cannot be read"),
        (["--robot", "talos"], "joint 'left_hip_pitch_joint' is no joint of talos"),
    ],
)
def test_what_is_refused(log, tmp_path, capsys, arguments, message):
    assert main(["states", str(log), "-o", str(tmp_path / "states.parquet"), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "states.parquet").exists() and not leftovers(tmp_path)


def test_feet_are_printed_as_they_are_read(tmp_path, capsys):
    assert main(["states", "--robot", "go1", "--print-feet"]) == 0
    (tmp_path / "feet.yaml").write_text(capsys.readouterr().out)
    assert robots.load("go1", tmp_path / "feet.yaml").patches == robots.load("go1").patches


def test_help_and_what_is_missing(capsys):
    assert main(["states", "--help"]) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in (*robots.known_layouts(), *robots.ROBOTS))
    assert main(["states", "--robot", "g1", "-o", "a.parquet"]) == 2
    assert "LOG is missing" in capsys.readouterr().err


def test_options_of_a_log_need_a_robot(log, tmp_path, capsys):
    assert main(["score", str(log), "-o", str(tmp_path / "a.parquet"), "--friction", "0.3"]) == 2
    assert "--friction says how a log is read (expected with --robot)" in capsys.readouterr().err


@pytest.mark.slow
def test_score_does_both_steps_at_once(log, tmp_path, capsys):
    """The same verdicts as of the states, and as of the direct path in Python."""
    states, one, two = (tmp_path / f"{name}.parquet" for name in ("states", "one", "two"))
    assert main(["states", str(log), "--robot", "g1", "-o", str(states)]) == 0
    assert main(["score", str(states), "-o", str(one), "--dtype", "float64"]) == 0
    assert main(["score", str(log), "--robot", "g1", "-o", str(two), "--dtype", "float64"]) == 0
    first, second = columns(one), columns(two)
    assert set(first) == set(second)
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])
    assert first["capturable"].any() and not leftovers(tmp_path)
