"""`jaxcap states`, and `jaxcap score --robot`."""

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

pin = pytest.importorskip("pinocchio")

from state_files import leftovers  # noqa: E402

from bench.robot_motion import main as make_log  # noqa: E402
from jaxcap import plotting, robots  # noqa: E402
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
    assert "60 rows of 1 episode, layout lafan1_g1" in capsys.readouterr().out
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
    assert main(["view", "--help"]) == 0
    said += capsys.readouterr().out
    assert max(len(line) for line in said.splitlines() if not line.startswith("usage")) <= 80
    assert main(["states", "--robot", "g1", "-o", "a.parquet"]) == 2
    assert "LOG is missing" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [
        (["states", "{log}", "--robot", "g1", "-o", "{out}"], "logs"),
        (["states", "--robot", "g1", "--print-feet"], "logs"),
        (["score", "{log}", "--robot", "g1", "-o", "{out}"], "logs"),
        (["view", "{states}", "--robot", "g1"], "view"),
    ],
)
def test_without_pinocchio_the_extra_that_has_all_is_named(log, tmp_path, capsys, monkeypatch, arguments, extra):
    if extra == "view":
        pytest.importorskip("viser")
    states, out = tmp_path / "states.parquet", tmp_path / "out.parquet"
    assert main(["states", str(log), "--robot", "g1", "-o", str(states)]) == 0
    for name in [name for name in sys.modules if name.startswith("jaxcap.robots")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    assert main([text.format(log=log, states=states, out=out) for text in arguments]) == 2
    assert f'robots need Pinocchio; install it with: pip install "jaxcap[{extra}]"' in capsys.readouterr().err
    assert not out.exists() and not leftovers(tmp_path)


def test_those_extras_have_all_that_the_commands_import():
    """Commands need `cli`, robots Pinocchio, states pyarrow, and the patches of a robot YAML."""
    project = Path(__file__).parents[1] / "pyproject.toml"
    extras = tomllib.loads(project.read_text())["project"]["optional-dependencies"]
    for extra in ("logs", "view"):
        assert "jaxcap[robots,data,cli]" in extras[extra]
    assert any(package.startswith("pyyaml") for package in extras["cli"])


def test_a_scored_log_is_drawn_with_the_names_of_its_feet(log, tmp_path, capsys, monkeypatch):
    pytest.importorskip("matplotlib")
    states, scores, drawn = tmp_path / "states.parquet", tmp_path / "scores.parquet", []
    assert main(["states", str(log), "--robot", "g1", "-o", str(states)]) == 0
    assert main(["plot", str(states)]) == 2
    assert "states.parquet: scores has the columns t, episode, contact_mask (expected 'margin'" in capsys.readouterr().err
    table = pq.read_table(states)
    table = table.append_column("margin", pa.array(np.linspace(-1, 1, len(table))))
    pq.write_table(table.append_column("case", pa.array(np.zeros(len(table), np.int8))), scores)
    draw = plotting.timeline
    monkeypatch.setattr(plotting, "timeline", lambda *given: drawn.append(draw(*given)) or drawn[-1])
    assert main(["plot", str(scores)]) == 0
    assert (tmp_path / "scores.png").read_bytes()[1:4] == b"PNG" and not leftovers(tmp_path)
    (_, _, contacts), feet = drawn[-1], [*robots.load("g1").patches]
    assert [label.get_text() for label in contacts.get_yticklabels()] == feet
    assert main(["plot", str(scores), "-o", str(tmp_path / "a.png"), "--x", "com_x"]) == 2
    assert "is a log (--quantity, --x, --y and --select are for maps)" in capsys.readouterr().err
    assert main(["plot", str(log.with_suffix(".parquet"))]) == 2
    assert "walk.parquet: cannot be read as Parquet" in capsys.readouterr().err


def test_options_of_a_log_need_a_robot(log, tmp_path, capsys):
    assert main(["score", str(log), "-o", str(tmp_path / "a.parquet"), "--friction", "0.3"]) == 2
    assert "--friction says how a log is read (expected with --robot)" in capsys.readouterr().err


@pytest.mark.slow
def test_score_does_both_steps_at_once(log, tmp_path, capsys):
    """The same verdicts as of the states, and as of the direct path in Python."""
    states, one, two = (tmp_path / f"{name}.parquet" for name in ("states", "one", "two"))
    assert main(["states", str(log), "--robot", "g1", "-o", str(states)]) == 0
    assert main(["score", str(states), "-o", str(one), "--dtype", "float64"]) == 0
    assert main(["score", str(log), "--robot", "g1", "-o", str(two), "--dtype", "float64", "--point-mass"]) == 0
    assert "is a point mass" in capsys.readouterr().err
    first, second = columns(one), columns(two)
    assert set(first) == set(second)
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])
    assert first["capturable"].any() and not leftovers(tmp_path)
    said = json.loads(pq.read_schema(two).metadata[b"jaxcap"])  # what was read as what goes on into the scores
    assert said["read"]["layout"]["name"] == "lafan1_g1" and said["read"]["notes"] == [] and said["case"]["C1"] == 0
    assert main(["plot", str(two)]) == 0
    assert (tmp_path / "two.png").read_bytes()[1:4] == b"PNG"
