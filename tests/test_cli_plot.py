"""`jaxcap plot`: a figure from a map, and one line for whatever cannot be drawn."""

import json

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.image import imread
from state_files import FEET, leftovers

from jaxcap.commands.cli import main
from jaxcap.plotting.map_figure import map_figure

X, Y, HEADINGS = np.linspace(-0.2, 0.2, 9), np.linspace(-0.3, 0.3, 7), np.arange(8) * np.pi / 4
UNITS = {"com_x": "m", "com_y": "m", "com_z": "m", "heading": "rad", "speed": "m/s"}


def dataset(**axes):
    """A map like those of `jaxcap map`, with figures that need no predictor, over com_x, com_y and these axes."""
    axes = {"com_x": X, "com_y": Y, **axes}
    coords = {name: (name, grid, {"units": UNITS[name], "long_name": f"the {name}"}) for name, grid in axes.items()}
    shape = [len(grid) for grid in axes.values()]
    largest = np.maximum(0, 0.5 - np.hypot(*np.meshgrid(X, Y, indexing="ij")))
    largest = np.broadcast_to(largest.reshape(*largest.shape, *[1] * (len(shape) - 2)), shape)
    values = {"max_speed": largest, "min_speed": 0 * largest, "case": np.zeros(shape, np.int8)}
    fields = {name: (tuple(axes), value, {"units": "m/s"}) for name, value in values.items()}
    return xr.Dataset(fields, {**coords, "com_z": ((), 0.8, {"units": "m"})}, {"contacts": json.dumps(FEET)})


def written(path, **axes):
    """Such a map as a file. Returns its path."""
    dataset(**axes).to_zarr(path, zarr_format=3, consolidated=False)
    return path


@pytest.fixture
def kernel(tmp_path):
    return written(tmp_path / "kernel.zarr", heading=HEADINGS)


def plot(*arguments) -> int:
    return main(["plot", *map(str, arguments)])


def refused(capsys, *arguments) -> str:
    """The one line that says why this is not plotted."""
    assert plot(*arguments) == 2
    told = capsys.readouterr()
    assert told.out == "" and told.err.startswith("error: ") and told.err.count("\n") == 1
    return told.err


def test_a_map_alone_is_enough(kernel, capsys):
    assert plot(kernel) == 0
    figure = kernel.with_suffix(".png")
    told = capsys.readouterr()
    assert told.out == f"{figure}\n" and told.err == ""
    picture = imread(figure)
    assert picture.shape[0] >= 800 and picture.std() > 0.1
    assert leftovers(kernel.parent) == []


def test_the_overview_shows_the_weakest_heading_areas_and_contacts():
    figure, chosen = map_figure(dataset(heading=HEADINGS), None, None, (None, None), {})
    left, right = figure.axes[0], figure.axes[1]
    assert chosen == {} and "com_z = 0.8 m" in figure.get_suptitle()
    assert left.get_aspect() == right.get_aspect() == 1
    assert left.get_xlim() == right.get_xlim() and left.get_ylim() == right.get_ylim()
    assert left.get_xlabel() == right.get_xlabel() == "CoM position x [m]" and "[m]" in right.get_ylabel()
    assert [child.get_ylabel() for child in left.child_axes] == ["largest capturable speed, weakest heading [m/s]"]
    assert len(right.patches) == 16  # areas at 4 x 4 positions


@pytest.mark.parametrize("extension", ["png", "pdf", "svg"])
def test_a_slice_goes_into_the_file_that_is_asked_for(kernel, tmp_path, extension):
    figure = tmp_path / f"slice.{extension}"
    assert plot(kernel, "-o", figure, "--quantity", "max_speed", "--select", "heading=90deg") == 0
    starts = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
    assert figure.read_bytes().startswith(starts[extension])


def test_degrees_are_radians_of_the_map(kernel, tmp_path, monkeypatch):
    titles = []
    save = Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda figure, *args, **kw: titles.append(figure.axes[0].get_title()) or save(figure, *args, **kw)
    )
    plot(kernel, "-o", tmp_path / "a.png", "--select", "heading=90deg")
    plot(kernel, "-o", tmp_path / "b.png", "--select", "heading=1.6")
    assert titles == ["com_z = 0.8 m, heading = 90 deg"] * 2


def test_axes_that_are_not_named_are_chosen_with_a_note(kernel, tmp_path, capsys):
    assert plot(kernel, "-o", tmp_path / "a.png", "--x", "heading") == 0
    assert capsys.readouterr().err == f"note: {kernel}: com_y = 0 m, one of 7 (--select com_y=...)\n"
    assert plot(kernel, "-o", tmp_path / "b.png", "--quantity", "case") == 0
    assert capsys.readouterr().err == f"note: {kernel}: heading = 0 deg, one of 8 (--select heading=...)\n"


def test_a_map_of_another_kind_becomes_a_slice(tmp_path, capsys):
    speeds = written(tmp_path / "speeds.zarr", speed=np.linspace(0, 1, 3))
    assert plot(speeds) == 0
    assert capsys.readouterr().err == f"note: {speeds}: speed = 0.5 m/s, one of 3 (--select speed=...)\n"


def test_nothing_is_overwritten_unasked(kernel, capsys):
    figure = kernel.with_suffix(".png")
    figure.write_text("mine")
    assert "exists already (--force overwrites it)" in refused(capsys, kernel)
    assert figure.read_text() == "mine"
    assert plot(kernel, "--force") == 0 and figure.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--quantity", "margin"], "'margin' is not in the map (it holds"),
        (["--x", "com_z"], "'com_z' is not an axis of max_speed (expected one of com_x, com_y, heading)"),
        (["--x", "com_x", "--y", "com_x"], "the axis com_x is asked for twice"),
        (["--select", "heading=9"], "heading = 9 is not on the grid (expected from 0 to 5.49779)"),
        (["--select", "com_x=0", "--select", "com_y=0"], "max_speed has the axes com_x, com_y, heading at a value"),
        (["--select", "heading"], "--select heading (expected NAME=VALUE"),
        (["--select", "heading=up"], "--select heading=up (expected a number"),
        (["--select", "com_x=nan"], "--select com_x=nan (expected a finite number"),
        (["--select", "com_x=1deg"], "--select com_x=1deg (expected a number"),
        (["--select", "com_x=0", "--select", "com_x=0"], "--select com_x is given twice"),
        (["-o", "kernel.gif"], "unknown extension '.gif' (expected .png, .pdf or .svg)"),
        (["-o", "nowhere/kernel.png"], "no such directory"),
    ],
)
def test_what_cannot_be_plotted_is_told_before_anything_is_drawn(kernel, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(kernel.parent)
    monkeypatch.setattr(Figure, "savefig", lambda *_, **__: pytest.fail("drawn"))
    assert message in refused(capsys, kernel, *arguments)
    assert {path.name for path in kernel.parent.iterdir()} == {"kernel.zarr"}


def test_files_that_are_no_maps_are_told(tmp_path, capsys):
    assert "no such file" in refused(capsys, tmp_path / "none.zarr")
    (tmp_path / "half.zarr.partial").mkdir()
    assert "not complete" in refused(capsys, tmp_path / "half.zarr")
    (tmp_path / "empty.zarr").mkdir()
    assert "cannot be read as a map" in refused(capsys, tmp_path / "empty.zarr")
    (tmp_path / "feet.yaml").write_text("contacts: []")
    assert "expected .zarr or .nc, from jaxcap map" in refused(capsys, tmp_path / "feet.yaml")
    xr.Dataset(coords={"com_x": X}).to_zarr(tmp_path / "bare.zarr", zarr_format=3, consolidated=False)
    assert "holds no quantity" in refused(capsys, tmp_path / "bare.zarr")


def test_contacts_that_cannot_be_read_are_told(tmp_path, capsys):
    bad = dataset(heading=HEADINGS).assign_attrs(contacts='{"contacts": [{"type": "moon"}]}')
    bad.to_zarr(tmp_path / "bad.zarr", zarr_format=3, consolidated=False)
    assert "attribute 'contacts': contacts[0]: type = 'moon'" in refused(capsys, tmp_path / "bad.zarr")


def test_a_map_without_contacts_is_drawn_without_them(tmp_path):
    plain = dataset(heading=HEADINGS).drop_attrs()
    plain.to_zarr(tmp_path / "plain.zarr", zarr_format=3, consolidated=False)
    assert plot(tmp_path / "plain.zarr") == 0


def test_help_of_plot_is_good_reading(capsys):
    assert main(["plot", "--help"]) == 0
    text = capsys.readouterr().out
    for word in ("jaxcap plot kernel.zarr", "--quantity", "--select", "--force", "-o FIGURE, --output FIGURE", "EXIT CODES"):
        assert word in text
    assert max(map(len, text.splitlines())) <= 80
