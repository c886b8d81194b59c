"""`jaxcap map`: axes and quantities as text, defaults, messages, exit codes, signals."""

import contextlib
import os
import pty
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from state_files import FEET, write_contacts

from jaxcap.commands.cli import main
from jaxcap.files.contact_files import read_contacts
from jaxcap.maps import blocks as map_blocks
from jaxcap.maps import kernel_map
from jaxcap.maps.grid import axes_around, grid_of

SMALL = ("--axis", "com_x=0:0.1:3", "--axis", "com_y=0", "--axis", "heading=0:90deg:2")

SLOW = """
import signal, sys, time
import numpy as np
from jaxcap.maps import blocks as map_blocks
from jaxcap.commands.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)   # ignored where the tests run in the background of a shell
map_blocks.REGION = 16

def over(self, numbers):
    for number in numbers:
        region = self.regions.region(number)
        yield region, {name: np.full(region.shape(self.dims(name)), number, np.float32) for name in self.quantities}
        print(number, flush=True)
        time.sleep(float(sys.argv[1]))

map_blocks.Answers.over = over
sys.exit(main(sys.argv[2:]))
"""
"""A run of `jaxcap` that says how far it is, and takes its time."""


@pytest.fixture
def contacts(tmp_path):
    return write_contacts(tmp_path / "feet.yaml")


@pytest.fixture
def fake(monkeypatch):
    """Answers that need no compiling: every figure is the number of its region."""

    def over(self, numbers):
        for number in numbers:
            region = self.regions.region(number)
            kinds = {"capturable": bool, "case": np.int8, "status": np.int8}
            shapes = {name: region.shape(self.dims(name)) for name in self.quantities}
            yield region, {name: np.full(shape, number, kinds.get(name, np.float32)) for name, shape in shapes.items()}

    monkeypatch.setattr(map_blocks.Answers, "over", over)


def command(contacts, output, *options) -> list[str]:
    """Arguments of `jaxcap`."""
    return ["map", str(contacts), "-o", str(output), *options]


def start(seconds, *arguments, **options):
    """`jaxcap` in a process of its own, with slow and simple answers."""
    root = Path(__file__).parents[1]
    return subprocess.Popen(
        [sys.executable, "-c", SLOW, str(seconds), *map(str, arguments)],
        text=True,
        env={**os.environ, "PYTHONPATH": str(root)},
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options},
    )


# what is said


def test_help_of_map_is_good_reading(capsys):
    assert main(["map", "--help"]) == 0
    text = capsys.readouterr().out
    for words in (
        ["jaxcap map feet.yaml -o kernel.zarr", "EXIT CODES", "xarray.open_dataset", "[m]", "[m/s]", "[rad]"],
        ["com_x", "heading", "pitch", "speed", "velocity_x", "min_speed", "max_speed", "0:360deg:72"],
        ["--axis", "--quantity", "--dtype", "--sides", "--force", "-o OUT, --output OUT"],
        ["--robot", "--posture", "--row", "--joints", "50,000"],
    ):
        assert [word for word in words if word not in text] == []
    assert max(map(len, text.splitlines())) <= 80


def test_the_list_of_commands_has_one_line_for_it(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert "Map where a robot can stop" in text and "AXES" not in text


# what is written


def test_a_contacts_file_alone_gives_the_kernel(tmp_path, contacts, capsys):
    assert main(command(contacts, tmp_path / "kernel.zarr")) == 0
    text = capsys.readouterr().out
    assert "com_x 41 x com_y 41 x heading 72, 121032 states" in text and "states/s" in text and "float32" in text
    with xr.open_dataset(tmp_path / "kernel.zarr") as found:
        assert set(found.data_vars) == {"min_speed", "max_speed"} and found.max_speed.dtype == np.float32
        assert found.com_z == 0.8 and found.pitch == 0
        np.testing.assert_allclose(found.com_x[[0, -1]], [-0.2, 0.2])
        np.testing.assert_allclose(found.com_y[[0, -1]], [-0.25, 0.25])
        np.testing.assert_allclose(found.heading, np.radians(5) * np.arange(72))
        stops = (found.max_speed > 0).mean("heading")
        assert (stops.sel(com_x=0, com_y=0, method="nearest") == 1) and stops.isel(com_x=0, com_y=0) < 0.5
        stance = read_contacts(contacts)
        xr.testing.assert_identical(found.load(), kernel_map(stance, axes_around(stance, {})))


def test_options_reach_the_map(tmp_path, contacts, fake):
    axes = ("--axis", "speed=0:1:5", "--axis", "com_x=-0.1:0.1:3", "--axis", "com_z=0.7,0.9")
    options = ("--quantity", "margin", "--quantity", "max_speed", "--dtype", "float64", "--sides", "8")
    assert main(command(contacts, tmp_path / "map.nc", *axes, *options)) == 0
    with xr.open_dataset(tmp_path / "map.nc") as found:
        assert found.margin.dims == ("com_y", "heading", "speed", "com_x", "com_z")
        assert found.max_speed.dims == ("com_y", "heading", "com_x", "com_z")
        assert set(found.data_vars) == {"margin", "max_speed"}
        assert found.attrs["dtype"] == "float64" and found.attrs["sides"] == 8
        assert (found.speed == np.linspace(0, 1, 5)).all() and (found.com_z == [0.7, 0.9]).all()


def test_a_speed_brings_the_verdict(tmp_path, contacts, fake):
    assert main(command(contacts, tmp_path / "map.zarr", *SMALL, "--axis", "speed=0.5")) == 0
    with xr.open_dataset(tmp_path / "map.zarr") as found:
        assert set(found.data_vars) == {"capturable", "margin", "case"}
        assert found.speed == 0.5 and found.margin.dims == ("com_x", "heading")


def test_velocities_by_components_need_no_heading(tmp_path, contacts, fake):
    axes = ("--axis", "velocity_x=-1:1:3", "--axis", "velocity_y=0", "--axis", "com_x=0", "--axis", "com_y=0")
    assert main(command(contacts, tmp_path / "map.zarr", *axes)) == 0
    with xr.open_dataset(tmp_path / "map.zarr") as found:
        assert found.margin.dims == ("velocity_x",) and found.velocity_z == 0 and "heading" not in found


def test_defaults_lie_around_the_contacts():
    contacts = read_contacts(Path(__file__).parents[1] / "bench" / "data" / "talos_hand_on_wall.yaml")
    axes = grid_of(axes_around(contacts, {"com_y": 0.25, "speed": 0.5})).axes
    low, high = contacts.points.min(axis=0), contacts.points.max(axis=0)
    np.testing.assert_allclose(axes["com_x"], np.linspace(low[0] - 0.1, high[0] + 0.1, 41))
    assert axes["com_y"] == 0.25 and axes["com_z"] == low[2] + 0.8 and axes["speed"] == 0.5
    assert len(axes["heading"]) == 72


def test_places_that_are_hardly_plausible_are_told(tmp_path, contacts, fake, capsys):
    """R4: one line, and in the map; with --strict an error, and no map."""
    far, words = [*SMALL, "--axis", "com_z=800"], "the CoM is more than 10 m from all contacts"
    assert main(command(contacts, tmp_path / "map.zarr", *far)) == 0
    assert [words in line for line in capsys.readouterr().err.splitlines()] == [True]
    with xr.open_dataset(tmp_path / "map.zarr", engine="zarr") as found:
        assert words in found.attrs["notes"]
    assert main(command(contacts, tmp_path / "strict.zarr", *far, "--strict")) == 2
    assert words in capsys.readouterr().err and not (tmp_path / "strict.zarr").exists()
    assert main(command(contacts, tmp_path / "near.zarr", *SMALL, "--strict")) == 0
    assert capsys.readouterr().err == ""


# what is refused


@pytest.mark.parametrize(
    "options, message",
    [
        (["--axis", "com_x"], "--axis com_x (expected NAME=VALUES, for example com_x=-0.4:0.4:201)"),
        (["--axis", "com_x=0", "--axis", "com_x=1"], "--axis com_x is given twice"),
        (["--axis", "com_q=0"], "axis 'com_q' is not known"),
        (["--axis", "com_x=a:b:c"], "axis com_x: 'a:b:c'"),
        (["--axis", "com_x="], "axis com_x: ''"),
        (["--axis", "heading=0", "--axis", "velocity_x=1"], "the velocity is given twice"),
        (["--quantity", "speediness"], "quantity 'speediness' is not known"),
        (["--quantity", "margin"], "quantity 'margin' needs a speed"),
        (["--sides", "2"], "--sides 2 (expected at least 3)"),
        (["--axis", "com_x=0:1:9000000", "--axis", "com_y=0:1:9000000"], "the disk has"),
    ],
    ids=lambda value: value[-1] if isinstance(value, list) else "",
)
def test_options_that_cannot_be_used(tmp_path, contacts, capsys, options, message):
    assert main(command(contacts, tmp_path / "map.zarr", *options)) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and message in error and error.count("\n") == 1
    assert os.listdir(tmp_path) == ["feet.yaml"]


def test_files_that_cannot_be_used(tmp_path, contacts, capsys):
    two = write_contacts(tmp_path / "two.yaml", {"sets": [FEET, {"contacts": []}]})
    none = write_contacts(tmp_path / "none.yaml", {"sets": [{"contacts": []}]})
    (tmp_path / "old.nc").write_text("old")
    for file, output, message in (
        (tmp_path / "no.yaml", "map.zarr", "no such file"),
        (two, "map.zarr", "contact_set = 1: none of 0 is active"),
        (none, "map.zarr", "contacts: none is active"),
        (contacts, "old.nc", "exists already (--force overwrites it)"),
        (contacts, "map.png", "unknown extension '.png'"),
        (contacts, "no/map.zarr", "no such directory"),
    ):
        assert main(command(file, tmp_path / output)) == 2
        assert message in capsys.readouterr().err
    assert (tmp_path / "old.nc").read_text() == "old"


def test_force_overwrites(tmp_path, contacts, fake):
    for options in ((), ("--force",)):
        assert main(command(contacts, tmp_path / "map.zarr", *SMALL, *options)) == 0
    assert main(command(contacts, tmp_path / "map.zarr", *SMALL)) == 2


# interruptions


def test_interrupted_and_continued(tmp_path, contacts, monkeypatch):
    """Ctrl-C: exit code 130, nothing under the name of the map, and the same command goes on."""
    output, axes = tmp_path / "map.zarr", ("--axis", "com_x=0:0.1:8", "--axis", "com_y=0:0.1:8", "--axis", "heading=0:1:8")
    run = start(0.05, *command(contacts, output, *axes))
    for _ in range(3):  # regions
        run.stdout.readline()
    run.send_signal(signal.SIGINT)
    _, error = run.communicate(timeout=60)
    assert run.returncode == 130
    assert error == f"note: the same command goes on where this one ended ({output}.partial)\ninterrupted\n"
    assert not output.exists()
    again = start(0, *command(contacts, output, *axes))
    text, error = again.communicate(timeout=60)
    assert (again.returncode, error) == (0, "")
    assert f"{8**3} states; " in text and " were there" in text and int(text.split()[0]) >= 3
    monkeypatch.setattr(map_blocks, "REGION", 16)
    with xr.open_dataset(output) as found:
        points = grid_of({name: found[name].values for name in found.coords})
        assert (found.max_speed.values.ravel()[[0, -1]] == [0, len(map_blocks.regions(points)) - 1]).all()


def test_a_map_killed_five_times_at_random_is_the_same_to_the_bit(tmp_path, contacts):
    """The command as it is, with nothing of it replaced: SIGKILL among 38 million states."""
    rng = np.random.default_rng(5)
    axes = ("com_x=-0.2:0.2:121", "com_y=-0.3:0.3:121", "heading=0:360deg:64", "speed=0:1:41")
    options = [*(f"--axis={axis}" for axis in axes), f"--cache={tmp_path / 'cache'}"]
    run = lambda output: subprocess.Popen(
        [sys.executable, "-m", "jaxcap.commands.cli", *command(contacts, output), *options], stdout=subprocess.DEVNULL
    )
    journal = tmp_path / "map.zarr.partial" / "journal"
    done = lambda: journal.stat().st_size if journal.exists() else 0
    assert run(tmp_path / "whole.zarr").wait() == 0
    for _ in range(5):
        before, process = done(), run(tmp_path / "map.zarr")
        while done() == before and process.poll() is None:
            time.sleep(0.001)
        time.sleep(rng.uniform(0, 0.1))
        process.kill()
        assert process.wait() == -signal.SIGKILL, "it was not killed in time"
    assert not (tmp_path / "map.zarr").exists()
    assert run(tmp_path / "map.zarr").wait() == 0
    assert not journal.parent.exists()
    whole, killed = (
        {file.relative_to(tmp_path / name): file for file in (tmp_path / name).rglob("*") if file.is_file()}
        for name in ("whole.zarr", "map.zarr")
    )
    assert whole.keys() == killed.keys() and len(whole) > 3 * 30  # chunks of three quantities
    assert all(file.read_bytes() == killed[name].read_bytes() for name, file in whole.items())


def test_a_terminal_sees_a_bar(tmp_path, contacts):
    terminal, end = pty.openpty()
    termios.tcsetwinsize(end, (24, 80))
    run = start(0, *command(contacts, tmp_path / "map.zarr", *SMALL), stderr=end)
    run.communicate(timeout=60)
    os.close(end)
    shown = b""
    with contextlib.suppress(OSError):  # the end of a terminal that nobody holds open
        while piece := os.read(terminal, 4096):
            shown += piece
    os.close(terminal)
    assert run.returncode == 0 and b"100%" in shown and b"states" in shown


# where it is computed

REGIONS = (*SMALL, "--axis", "friction=0.3:0.8:7")
"""Seven regions: one for each contact set."""


def files_of(path: Path) -> dict[str, bytes]:
    """All of a map."""
    return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_shards_make_the_whole(fake, tmp_path, contacts, capsys, order):
    assert main(command(contacts, tmp_path / "whole.zarr", *REGIONS)) == 0
    whole = files_of(tmp_path / "whole.zarr")
    for number in order:
        assert not (tmp_path / "map.zarr").exists()
        capsys.readouterr()
        assert main(command(contacts, tmp_path / "map.zarr", *REGIONS, "--shard", f"{number}/3")) == 0
        assert f"; shard {number}/3" in capsys.readouterr().out
    assert files_of(tmp_path / "map.zarr") == whole
    assert sorted(path.name for path in tmp_path.iterdir()) == ["feet.yaml", "map.zarr", "whole.zarr"]


def test_a_shard_leaves_what_others_do_alone(fake, tmp_path, contacts, capsys):
    """Another shard may write at the same time, the same shard may not, and a command for the whole goes on from them."""
    fcntl = pytest.importorskip("fcntl")
    assert main(command(contacts, tmp_path / "map.zarr", *REGIONS, "--shard", "1/3")) == 0
    partial = tmp_path / "map.zarr.partial"
    with open(partial / "journal.0-3", "wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        assert main(command(contacts, tmp_path / "map.zarr", *REGIONS, "--shard", "0/3")) == 2
        assert "another process is writing it" in capsys.readouterr().err
    with open(partial / "settings.json") as other:
        fcntl.flock(other, fcntl.LOCK_SH)  # as a shard that is at work holds it
        assert main(command(contacts, tmp_path / "map.zarr", *REGIONS, "--shard", "0/3")) == 0
        assert main(command(contacts, tmp_path / "map.zarr", *REGIONS)) == 2
        assert "another process is writing it" in capsys.readouterr().err
    assert sorted(path.name for path in partial.glob("journal*")) == ["journal", "journal.0-3", "journal.1-3"]
    assert main(command(contacts, tmp_path / "map.zarr", *REGIONS)) == 0
    assert main(command(contacts, tmp_path / "whole.zarr", *REGIONS)) == 0
    assert files_of(tmp_path / "map.zarr") == files_of(tmp_path / "whole.zarr")


@pytest.mark.parametrize(
    "options, output, why",
    [
        (["--shard", "3/3"], "map.zarr", "--shard 3/3 (expected 0/3 to 2/3"),
        (["--shard", "0/3", "--force"], "map.zarr", "expected without --force"),
        (["--jobs", "2"], "map.nc", "--jobs 2 (expected with a .zarr map"),
        (["--jobs", "0"], "map.zarr", "--jobs 0"),
    ],
)
def test_places_that_cannot_be_used(fake, tmp_path, contacts, capsys, options, output, why):
    assert main(command(contacts, tmp_path / output, *REGIONS, *options)) == 2
    assert why in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["feet.yaml"]
