"""The program: options, exit codes, what is printed, signals. What it refuses is in `test_bad_input`."""

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import jax
import numpy as np
import pyarrow.parquet as pq
import pytest
from state_files import (
    command,
    fake_score,
    leftovers,
    read_columns,
    read_metadata,
    states,
    write_contacts,
    write_states,
)

import jaxcap
from jaxcap.commands import cli
from jaxcap.commands.cli import main
from jaxcap.files.fields import FIELDS
from jaxcap.one_state.result import Case, Status

PAIRS = [(i, o) for i in ("parquet", "npz") for o in ("parquet", "npz")]

SLOW = """
import signal
import sys
import time
import jaxcap
from state_files import fake_score
from jaxcap.commands.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)   # ignored where the tests run in the background of a shell,
signal.signal(signal.SIGHUP, signal.SIG_DFL)               # or under nohup
calls = []
def score(*arguments, **options):
    calls.append(0) or len(calls) > 1 or print("scoring", flush=True)
    time.sleep(0.02)
    return fake_score(*arguments, **options)
jaxcap.score = score
sys.exit(main(sys.argv[1:]))
"""
"""A run of `jaxcap` that says when it begins to score, and takes its time."""


@pytest.fixture
def fake(monkeypatch):
    """Replaces the predictor by a simple rule."""
    monkeypatch.setattr(jaxcap, "score", fake_score)


@pytest.fixture
def arguments(tmp_path):
    """Arguments that score 10 states into out.parquet."""
    write_states(tmp_path / "states.npz")
    write_contacts(tmp_path / "feet.yaml")
    return command(tmp_path / "states.npz", tmp_path / "feet.yaml", tmp_path / "out.parquet")


def start(*arguments, **options):
    """`jaxcap` in a process of its own, with the slow predictor."""
    root = Path(__file__).parents[1]
    path = os.pathsep.join([str(root), str(root / "tests")])
    return subprocess.Popen(
        [sys.executable, "-c", SLOW, *map(str, arguments)],
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options},
    )


# what is said


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"jaxcap {jaxcap.__version__}\n"


def test_help_names_the_commands(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert "score" in text and "--version" in text
    assert "STATES is" not in text  # one line for each command


def test_help_of_score_is_good_reading(capsys):
    assert main(["score", "--help"]) == 0
    text = capsys.readouterr().out
    for words in (
        ["jaxcap score walk.parquet --contacts feet.yaml -o scores.parquet", "EXIT CODES", "nonfinite", *FIELDS],
        [".parquet", ".npz", ".yaml", "com_velocity", "com_x", "half_length", "friction"],
        ["[m]", "[m/s]", "inertial frame with z up"],
        ["--dtype", "--sides", "--batch-size", "--force", "-o OUT, --output OUT"],
    ):
        assert [word for word in words if word not in text] == []
    assert max(map(len, text.splitlines())) <= 80


def test_the_contact_file_in_the_help_is_valid(capsys, tmp_path):
    main(["score", "--help"])
    lines = capsys.readouterr().out.splitlines()
    first = next(i for i, line in enumerate(lines) if line.strip() == "contacts:")
    last = next(i for i, line in enumerate(lines) if "friction: 0.7" in line)
    (tmp_path / "help.yaml").write_text("\n".join(lines[first : last + 1]))
    from jaxcap.files.contact_files import read_contacts

    assert len(read_contacts(tmp_path / "help.yaml")) == 5


def test_no_command_is_wrong_usage(capsys):
    assert main([]) == 2
    assert "score" in capsys.readouterr().err


def test_closing_table(fake, arguments, capsys):
    assert main(arguments) == 0
    printed = capsys.readouterr()
    rows = {line.split()[0]: line.split() for line in printed.out.splitlines() if line}
    capturable = int(fake_score(None, *states(10)).capturable.sum())
    assert rows["states"][1:] == ["10", "100.00%"]
    assert rows["capturable"][1:] == [str(capturable), f"{capturable / 10:.2%}"]
    assert rows["C3_1"][-2] == str(capturable) and rows["C1"][-2] == str(10 - capturable)
    for name in {case.name for case in Case} - {"C1", "C3_1"} | {status.name.lower() for status in Status} - {"ok"}:
        assert rows[name][-2:] == ["0", "0.00%"]
    assert rows["5%"] == ["5%", "25%", "50%", "75%", "95%"]
    assert "states/s" in printed.out and "compiling" in printed.out
    assert printed.err == ""  # no progress bar in a pipe


def test_quantiles_of_the_margin(fake, tmp_path, capsys):
    write_states(tmp_path / "a.npz", 2000)
    write_contacts(tmp_path / "feet.json")
    main(command(tmp_path / "a.npz", tmp_path / "feet.json", tmp_path / "out.npz", "--batch-size", "300"))
    lines = capsys.readouterr().out.splitlines()
    printed = [float(x) for x in lines[next(i for i, line in enumerate(lines) if "95%" in line) + 1].split()]
    margins = read_columns(tmp_path / "out.npz")["margin"]
    exact = np.quantile(margins, [0.05, 0.25, 0.5, 0.75, 0.95], method="inverted_cdf")
    np.testing.assert_allclose(printed, exact, rtol=6e-3)  # three digits are printed


def test_arrays_that_are_not_carried_through_are_named(fake, arguments, tmp_path, capsys):
    write_states(tmp_path / "states.npz", dt=np.array(0.1))
    assert main(arguments) == 0
    assert "note: " in (error := capsys.readouterr().err) and "'dt'" in error


def test_map_coordinates_lose_nothing(tmp_path):
    """Positions and contacts reach the scorer in double precision, whatever the precision of the answers."""
    coms, velocities = states(50)
    found = []
    for name, place in (("here", np.zeros(3)), ("there", np.array([5e5, 5e6, 300]))):
        feet = [
            {
                "type": "rectangle",
                "position": np.add(place, [0, y, 0]).tolist(),
                "half_length": 0.1,
                "half_width": 0.06,
                "friction": 0.5,
            }
            for y in (0.1, -0.1)
        ]
        (tmp_path / f"{name}.json").write_text(json.dumps({"contacts": feet}))
        write_states(tmp_path / f"{name}.npz", com=coms + place, com_velocity=velocities)
        output = tmp_path / f"{name}.parquet"
        assert main(command(tmp_path / f"{name}.npz", tmp_path / f"{name}.json", output, "--baselines")) == 0
        found.append(read_columns(output))
    here, there = found
    assert 0 < here["capturable"].sum() < 50
    np.testing.assert_array_equal(here["capturable"], there["capturable"])
    for name in ("margin", "capture_point_support", "capture_point_hull"):
        np.testing.assert_allclose(here[name], there[name], rtol=0, atol=1e-4, err_msg=name)


def test_progress_bar_on_a_terminal(tmp_path, arguments):
    terminal, end = pty.openpty()
    termios.tcsetwinsize(end, (24, 80))
    process = start(*arguments, stderr=end)
    process.communicate(timeout=60)
    os.close(end)
    shown = b""
    with contextlib.suppress(OSError):  # the end of a terminal that nobody holds open
        while piece := os.read(terminal, 4096):
            shown += piece
    os.close(terminal)
    assert process.returncode == 0
    assert b"100%" in shown and b"states" in shown


# what is done


@pytest.mark.parametrize(("source", "target"), PAIRS)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_scores_are_those_of_the_library(tmp_path, source, target, dtype):
    path = write_states(tmp_path / f"a.{source}", 60, name=np.array(["x", "yy"] * 30))
    write_contacts(tmp_path / "feet.yaml")
    out = tmp_path / f"out.{target}"
    before = jax.config.jax_enable_x64
    assert main(command(path, tmp_path / "feet.yaml", out, "--dtype", dtype, "--batch-size", "40")) == 0
    assert jax.config.jax_enable_x64 == before
    feet = [jaxcap.rectangle([0, y, 0], np.eye(3), 0.1, 0.05, 0.5) for y in (0.1, -0.1)]
    coms, velocities = (x.astype(dtype) for x in states(60))
    jax.config.update("jax_enable_x64", dtype == "float64")
    try:
        expected = jaxcap.score(jaxcap.centroidal_cone(feet[0] + feet[1]), coms, velocities)
        assert expected.margin.dtype == dtype
        expected = jax.device_get(expected)
    finally:
        jax.config.update("jax_enable_x64", before)
    columns = read_columns(out)
    for name in FIELDS:
        np.testing.assert_array_equal(columns[name], getattr(expected, name))
    assert read_metadata(out)["dtype"] == dtype
    assert 0 < columns["capturable"].sum() < 60


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_float32_and_float64_agree(tmp_path, extension):
    path = write_states(tmp_path / f"a.{extension}", 60)
    write_contacts(tmp_path / "feet.yaml")
    margins = []
    for dtype in ("float32", "float64"):
        out = tmp_path / f"{dtype}.{extension}"
        assert main(command(path, tmp_path / "feet.yaml", out, "--dtype", dtype)) == 0
        margins.append(read_columns(out)["margin"])
    np.testing.assert_allclose(*margins, atol=1e-3)


def test_bad_rows_do_not_touch_the_others(tmp_path, capsys):
    coms, velocities = states(60)
    write_states(tmp_path / "a.npz", 60)
    coms[7, 0], velocities[50, 1] = np.nan, np.inf
    np.savez(tmp_path / "b.npz", com=coms, com_velocity=velocities)
    write_contacts(tmp_path / "feet.json")
    for name in "ab":
        assert main(command(tmp_path / f"{name}.npz", tmp_path / "feet.json", tmp_path / f"{name}.parquet")) == 0
    good, bad = read_columns(tmp_path / "a.parquet"), read_columns(tmp_path / "b.parquet")
    rows = np.isin(np.arange(60), [7, 50])
    for name in FIELDS:
        np.testing.assert_array_equal(good[name][~rows], bad[name][~rows])
    assert (bad["status"][rows] == jaxcap.Status.NONFINITE).all() and not bad["capturable"][rows].any()
    for name in list(FIELDS)[3:]:
        assert np.isnan(bad[name][rows]).all()


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_zero_rows(tmp_path, capsys, source, target):
    path = write_states(tmp_path / f"a.{source}", 0)
    write_contacts(tmp_path / "feet.json")
    out = tmp_path / f"out.{target}"
    assert main(command(path, tmp_path / "feet.json", out)) == 0
    assert set(read_columns(out)) == {"com", "com_velocity", *FIELDS}
    assert "no states" in capsys.readouterr().out


def test_the_last_batch_has_the_shape_of_the_others(monkeypatch, tmp_path, arguments):
    shapes = []
    monkeypatch.setattr(jaxcap, "score", lambda cone, c, v, **_: shapes.append(c.shape) or fake_score(cone, c, v))
    assert main([*arguments, "--batch-size", "4"]) == 0
    assert shapes == [(4, 3)] * 4  # one to compile
    assert pq.read_metadata(tmp_path / "out.parquet").num_rows == 10


def test_sides_reach_the_cone_and_the_metadata(fake, monkeypatch, tmp_path, arguments):
    seen = []
    monkeypatch.setattr(jaxcap, "centroidal_cone", lambda contacts, sides, _box: seen.append((len(contacts), sides)))
    assert main([*arguments, "--sides", "8"]) == 0
    assert seen == [(8, 8)] and read_metadata(tmp_path / "out.parquet")["sides"] == 8


def test_a_cone_that_cannot_be_built_is_bad_input(fake, monkeypatch, tmp_path, arguments, capsys):
    def fail(contacts, sides, momentum_box):
        raise ValueError("a face is\nviolated")

    monkeypatch.setattr(jaxcap, "centroidal_cone", fail)
    assert main(arguments) == 2
    assert capsys.readouterr().err == f"error: {tmp_path / 'feet.yaml'}: a face is violated\n"


def test_force_replaces_the_output(fake, tmp_path, arguments):
    assert main(arguments) == 0
    first = (tmp_path / "out.parquet").stat().st_ino
    assert main([*arguments, "--force"]) == 0
    assert (tmp_path / "out.parquet").stat().st_ino != first and not leftovers(tmp_path)


# how it ends


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_leaves_nothing(tmp_path, arguments, number, code):
    process = start(*arguments, "--batch-size", "1")
    assert process.stdout.readline() == "scoring\n"
    time.sleep(0.03)
    process.send_signal(number)
    _, error = process.communicate(timeout=60)
    assert process.returncode == code and "Traceback" not in error
    assert sorted(os.listdir(tmp_path)) == ["feet.yaml", "states.npz"]


LOST = SLOW.replace(
    "    time.sleep(0.02)\n",
    """\
    if len(calls) == 1:
        class Callback:
            def __del__(self):
                time.sleep(60)   # a handler that raises here raises for nobody
        Callback()
    time.sleep(0.02)
""",
)
"""The same, at first in a place where Python drops exceptions, as it does in callbacks of libraries."""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_whose_exception_is_lost_still_ends_the_run(tmp_path, number, code):
    """F9: or the run goes on to its end, and its exit code says 0."""
    write_states(tmp_path / "states.npz", 500)
    write_contacts(tmp_path / "feet.yaml")
    arguments = command(tmp_path / "states.npz", tmp_path / "feet.yaml", tmp_path / "out.parquet", "--batch-size", "5")
    root = Path(__file__).parents[1]
    path = os.pathsep.join([str(root), str(root / "tests")])
    process = subprocess.Popen(
        [sys.executable, "-c", LOST, *arguments],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert process.stdout.readline() == "scoring\n"
    time.sleep(0.3)
    process.send_signal(number)
    error = process.communicate(timeout=50)[1]
    assert process.returncode == code and "Traceback" not in error
    assert sorted(os.listdir(tmp_path)) == ["feet.yaml", "states.npz"]


def test_a_signal_leaves_without_taking_the_interpreter_down(monkeypatch):
    """F9: threads inside XLA would meet an interpreter that is no more, and end the process by a segmentation fault."""
    left = []
    monkeypatch.setattr(cli, "_leave", left.append)
    monkeypatch.setattr(cli, "_outcome", lambda arguments: 143)
    assert main() == 143 and left == [143]
    assert main([]) == 143 and left == [143]  # within a process of someone else


def test_interrupt_in_process(monkeypatch, tmp_path, arguments, capsys):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(jaxcap, "score", interrupt)
    assert main(arguments) == 130
    assert not (tmp_path / "out.parquet").exists() and not leftovers(tmp_path)


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_a_kill_at_any_moment_leaves_no_half_written_output(tmp_path, arguments, extension):
    rng = np.random.default_rng(0)
    outputs = [tmp_path / f"out{i}.{extension}" for i in range(3)]
    processes = [start(*arguments[:-1], output, "--batch-size", "1") for output in outputs]
    for process in processes:
        process.stdout.readline()
        time.sleep(rng.uniform(0, 0.25))  # a run takes 0.22 s
        process.kill()
    for process, output in zip(processes, outputs, strict=True):
        process.communicate(timeout=60)
        if output.exists():
            assert len(read_columns(output)["margin"]) == 10
    names = {path.name for path in tmp_path.iterdir()} - {"feet.yaml", "states.npz", *(path.name for path in outputs)}
    assert all(name.startswith(".jaxcap-") and name.endswith(".tmp") for name in names)


def test_a_reader_that_goes_away_is_no_error(tmp_path, arguments):
    process = start(*arguments)
    process.stdout.readline()
    process.stdout.close()
    error = process.stderr.read()
    process.stderr.close()
    assert process.wait(timeout=60) in (0, 141) and "Traceback" not in error
