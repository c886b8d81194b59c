"""Kernel maps: the same answers as `score`, whatever the grid, the regions, the file and the interruptions."""

import importlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray as xr

import jaxcap
from jaxcap import Case, Status
from jaxcap.errors import InputError, MissingExtra
from jaxcap.files.contact_files import read_contacts
from jaxcap.files.fields import FIELDS
from jaxcap.maps import blocks as map_blocks
from jaxcap.maps import kernel_map, write_map
from jaxcap.maps.asked import checked, prepared
from jaxcap.maps.grid import AXES, grid_of
from jaxcap.one_state.decision import LIMITS, WALKED

FOOT = jaxcap.rectangle([0, 0.1, 0], np.eye(3), 0.1, 0.05, 0.5)
FEET = FOOT + jaxcap.rectangle([0.2, -0.15, 0.1], np.eye(3), 0.1, 0.05, 0.5)
CONE = jaxcap.centroidal_cone(FEET)
EVERY, VERDICT = tuple(name for name in FIELDS if name != "effort"), ("capturable", "margin", "case")
AXIS_ALIGNED = "0:360deg:4"
POINTS = {
    "com_x": "-0.1:0.25:4",
    "com_y": [-0.3, -0.1, 0.0, 0.1],
    "com_z": 0.8,
    "heading": AXIS_ALIGNED,
    "speed": [0, 0.1, 0.3, 1.1],
}
"""Grid of most tests, all with EVERY quantity: one program for all of them, since it is compiled for the shape."""
CARTESIAN = {
    "com_x": "-0.1:0.25:4",
    "com_y": [-0.1, 0.0],
    "com_z": 0.8,
    "velocity_x": "-0.6:0.6:8",
    "velocity_y": [0.0, 0.25, -0.4, 0.1],
}
STATES = 256
"""States of these grids."""


def scored(axes, cone=CONE):
    """The answers of `score` on arrays of the grid's states, in the grid's shape."""
    points = grid_of(axes)
    assert points.size <= STATES
    index = np.resize(np.arange(points.size), STATES)
    (coms, _), (_, velocities) = points.states(index, np.float64), points.states(index, np.float32)
    with jax.enable_x64(False):  # positions come in double precision, and are rounded relative to the contacts
        out = jaxcap.score(cone, coms, velocities)
    return jax.tree.map(lambda field: np.asarray(field)[: points.size].reshape(points.shape), out)


def assert_equal(found: xr.Dataset, expected: jaxcap.Capturability, names=EVERY):
    """Bit by bit."""
    for name in names:
        np.testing.assert_array_equal(found[name], getattr(expected, name), name)


def tree(path: Path) -> dict[str, bytes]:
    """All files of a directory."""
    return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}


# laws


@pytest.mark.parametrize("heading", [AXIS_ALIGNED, [0.3, 1.2, 2.0, 4.4]], ids=["along the axes", "any"])
def test_a_map_has_the_answers_of_score(heading):
    """To rounding; bit by bit along the axes, where a direction is the same whatever the speed that it is computed from, but
    for what follows the motion piece by piece: the compiler may round such sums differently in two programs.
    """
    axes = {**POINTS, "heading": heading}
    found, expected = kernel_map(FEET, axes, EVERY), scored(axes)
    assert set(expected.case.ravel().tolist()) >= {Case.C1, Case.C3_1, Case.EMPTY}
    assert np.nanmin(np.abs(expected.margin)) > 1e-5  # no verdict hangs on rounding
    for name in EVERY:
        values = getattr(expected, name)
        ours, values = found[name].values, values[..., 1] if name in LIMITS else values
        assert ours.dtype == values.dtype, name
        if values.dtype == np.float32 and (name in WALKED or heading != AXIS_ALIGNED):
            np.testing.assert_allclose(ours, values, rtol=1e-5, atol=3e-6, err_msg=name)
        else:
            np.testing.assert_array_equal(ours, values, name)


def test_velocities_by_components_are_scored_bit_by_bit():
    names = (*VERDICT, "max_speed")
    found = kernel_map(FEET, CARTESIAN, names)
    assert found.max_speed.dims == ("com_x", "com_y", "velocity_x", "velocity_y")
    assert_equal(found, scored(CARTESIAN), names)


def test_speed_zero_is_standing_still():
    found = kernel_map(FEET, POINTS, EVERY).sel(speed=0)
    position = {name: POINTS[name] for name in ("com_x", "com_y", "com_z")}
    expected = scored({**position, "velocity_x": 0, "velocity_y": 0})
    assert 0 < expected.capturable.sum() < expected.capturable.size
    for heading in range(4):
        assert_equal(found.isel(heading=heading), expected, set(EVERY) - set(LIMITS))
    assert (found.status == Status.NO_DIRECTION).all() and found.margin.isnull().all()


def test_a_verdict_is_an_interval_of_speeds():
    found = kernel_map(FEET, {**POINTS, "speed": [0.1, 0.2, 0.3, 1.1]}, EVERY)
    speed, some = found.speed.astype(np.float32), found.max_speed > 0
    inside = some & (found.min_speed <= speed) & (speed <= found.max_speed)
    assert inside.any() and (found.capturable == inside).all()


def test_rays_give_the_same_map():
    found, faces = kernel_map(jaxcap.cone_rays(FEET), POINTS, ("margin", "case")), kernel_map(FEET, POINTS, EVERY)
    np.testing.assert_allclose(found.margin, faces.margin, atol=3e-5)
    assert (found.case == faces.case).all()
    assert "contacts" not in found.attrs and "sides" not in found.attrs


def test_double_precision(x64):
    double = kernel_map(FEET, POINTS, VERDICT, dtype=np.float64)
    assert double.margin.dtype == np.float64 and double.attrs["dtype"] == "float64"
    with jax.enable_x64(False):
        single = kernel_map(FEET, POINTS, EVERY)
    np.testing.assert_allclose(single.margin, double.margin, atol=3e-5)
    assert (single.margin.values != double.margin.values.astype(np.float32)).any()


def test_regions_and_the_order_of_axes_change_nothing(monkeypatch):
    names = (*VERDICT, "max_speed")
    whole = kernel_map(FEET, POINTS, EVERY)
    monkeypatch.setattr(map_blocks, "REGION", 30)
    monkeypatch.setattr(map_blocks, "SPEEDS", 3)
    order = ("speed", "com_y", "heading", "com_x", "com_z")
    axes = {name: POINTS[name] for name in order}
    assert len(map_blocks.regions(grid_of(axes))) >= 16
    parts = kernel_map(FEET, axes, names)
    assert parts.margin.dims == order[:4] and parts.max_speed.dims == ("com_y", "heading", "com_x")
    xr.testing.assert_equal(whole[list(names)], parts.transpose(*whole.dims))


def test_the_last_states_of_a_huge_grid(monkeypatch):
    """10^11 states: nothing is ever as long as the grid, and no index overflows."""
    monkeypatch.setattr(map_blocks, "REGION", STATES)
    axes = {"com_x": "0:0.1:4001", "com_y": "0:0.1:4001", "com_z": 0.8, "heading": "0:360deg:100", "speed": "0:1:64"}
    points = grid_of(axes)
    assert points.size > 1e11
    answers = map_blocks.Answers([CONE], points, ("margin",), (0, 0, -9.81), np.float32)
    ((region, values),) = answers.over([len(answers.regions) - 1])
    places = [np.arange(part.start, part.stop) for part in region.slices.values()]
    index = np.ravel_multi_index(np.meshgrid(*places, indexing="ij"), points.shape).ravel()
    assert index[-1] == points.size - 1
    expected = jaxcap.score(CONE, *points.states(np.resize(index, STATES), np.float32)).margin[: len(index)]
    np.testing.assert_allclose(values["margin"].ravel(), expected, rtol=1e-5, atol=3e-6)


# special contact sets and states


NEARBY = {**POINTS, "com_x": [-0.02, 0.0, 0.02, 0.05], "com_y": [-0.05, 0.0, 0.05, 0.1]}
ORIGIN = jaxcap.ContactSet(np.zeros((1, 3)), np.eye(3), 0.5)
PALM = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]])
PALMS = jaxcap.rectangle([-0.3, 0, 0.8], PALM, 0.1, 0.1, 2.0) + jaxcap.rectangle(
    [0.3, 0, 0.8], np.diag([-1, 1, -1]) @ PALM, 0.1, 0.1, 2.0
)
SPECIAL = {
    "one point": ORIGIN,
    "two points": ORIGIN + jaxcap.ContactSet(np.array([[0.1, 0, 0]]), np.eye(3), 0.5),
    "coplanar feet": FOOT + jaxcap.rectangle([0, -0.1, 0], np.eye(3), 0.1, 0.05, 0.5),
    "opposing palms": PALMS,
}


@pytest.mark.parametrize("contacts", SPECIAL.values(), ids=SPECIAL)
def test_special_contacts_are_mapped_as_they_are_scored(contacts):
    cone = jaxcap.centroidal_cone(contacts).padded(len(CONE.faces))
    found, expected = kernel_map(cone, NEARBY, EVERY), scored(NEARBY, cone)
    assert_equal(found, expected, VERDICT)
    assert set(expected.case.ravel().tolist()) - {Case.EMPTY}


def test_opposing_palms_stop_any_speed():
    cone = jaxcap.centroidal_cone(PALMS)
    assert len(cone.faces) == 0
    found = kernel_map(cone.padded(len(CONE.faces)), NEARBY, EVERY)
    assert found.capturable.all() and np.isposinf(found.margin.isel(speed=slice(1, None))).all()
    assert np.isposinf(found.max_speed).all() and (found.min_speed == 0).all()


def test_masked_contacts_are_not_there():
    xr.testing.assert_identical(kernel_map(FEET.padded(12), POINTS, EVERY), kernel_map(FEET, POINTS, EVERY))


def test_a_value_beyond_single_precision_costs_no_other():
    axes = {**POINTS, "com_x": [-0.1, 0.0, 0.1, 1e39], "speed": [0, 0.1, 0.3, 1e39]}
    found = kernel_map(FEET, axes, EVERY, dtype=np.float32)
    good = kernel_map(FEET, {**axes, "com_x": [-0.1, 0.0, 0.1, 0.2], "speed": [0, 0.1, 0.3, 1]}, EVERY)
    bad = ((found.com_x > 1e38) | (found.speed > 1e38)).broadcast_like(found.margin)
    assert (found.status.values[bad] == Status.NONFINITE).all() and (found.case.values[bad] == Case.UNDECIDED).all()
    assert not found.capturable.values[bad].any() and np.isnan(found.margin.values[bad]).all()
    assert found.max_speed.isel(com_x=3).isnull().all()
    places = {"com_x": slice(3), "speed": slice(3)}
    of = lambda dataset, name: dataset[name].isel(places, missing_dims="ignore").values
    for name in EVERY:
        np.testing.assert_array_equal(of(found, name), of(good, name), name)


def test_a_grid_of_one_point():
    axes = {"com_x": 0.1, "com_y": 0, "com_z": 0.8, "heading": 0.0}
    found = kernel_map(FEET, axes)
    assert tuple(found.data_vars) == LIMITS and found.max_speed.dims == () and found.com_x == 0.1
    expected = scored({**axes, "speed": 0.5})
    assert found.max_speed == expected.max_speed > 0


# grids


def test_values_ranges_and_lists():
    points = grid_of({"com_x": "-0.4:0.4:5", "com_y": "1,2.5", "com_z": "0.8", "velocity_x": [0], "velocity_y": 3})
    np.testing.assert_allclose(points.axes["com_x"], [-0.4, -0.2, 0, 0.2, 0.4], atol=1e-16)
    np.testing.assert_array_equal(points.axes["com_y"], [1, 2.5])
    assert points.dims == ("com_x", "com_y", "velocity_x") and points.shape == (5, 2, 1)
    assert points.axes["com_z"].shape == () and points.axes["velocity_z"] == 0


def test_a_full_circle_does_not_repeat_its_end():
    circle = lambda text: grid_of({"com_x": 0, "com_y": 0, "com_z": 0, "heading": text}).axes["heading"]
    np.testing.assert_allclose(np.degrees(circle("0:360deg:72")), np.arange(72) * 5, atol=1e-12)
    np.testing.assert_allclose(np.degrees(circle("180deg:-180deg:4")), [180, 90, 0, -90], atol=1e-12)
    np.testing.assert_allclose(circle("0:6.2832:8"), np.arange(8) * np.pi / 4, atol=1e-12)
    np.testing.assert_allclose(np.degrees(circle("0:180deg:3")), [0, 90, 180])


def test_the_direction_of_heading_and_pitch():
    axes = {"com_x": 0, "com_y": 0, "com_z": 1, "heading": "0,90deg", "pitch": "-90deg,0,30deg", "speed": 2.0}
    _, velocities = grid_of(axes).states(np.arange(6))
    half, root = 1.0, np.sqrt(3)
    expected = [[0, 0, -2], [2, 0, 0], [root, 0, half], [0, 0, -2], [0, 2, 0], [0, root, half]]
    np.testing.assert_allclose(velocities, expected, atol=1e-15)
    assert velocities[4, 0] == 0  # exactly


def test_a_state_that_is_not_there():
    with pytest.raises(IndexError, match="expected 0 to 255"):
        grid_of(POINTS).states(np.array([256]))


PLACE = {"com_x": 0, "com_y": 0, "com_z": 0.8}
BAD_AXES = {
    "unknown": ({**PLACE, "height": 1}, "axis 'height' is not known"),
    "mixed": ({**PLACE, "heading": 0, "velocity_x": 1}, "the velocity is given twice"),
    "no position": ({"com_x": 0, "com_z": 0.8, "heading": 0}, "axis 'com_y' is missing"),
    "no direction": (PLACE, "axis 'heading' is missing"),
    "half a velocity": ({**PLACE, "velocity_z": 1}, "axis 'velocity_x' is missing"),
    "words": ({**PLACE, "heading": "north"}, "axis heading: 'north' .*for example heading=0:360deg:72"),
    "no count": ({**PLACE, "heading": 0, "speed": "0:1"}, "axis speed: '0:1' .*FIRST:LAST:COUNT"),
    "count of one": ({**PLACE, "heading": "0:1:1"}, "has 1 values .expected 2 to"),
    "endless": ({**PLACE, "heading": "0:1:1000000000"}, "has 1000000000 values"),
    "not finite": ({**PLACE, "heading": [0, np.nan]}, "axis heading holds nan"),
    "twice": ({**PLACE, "heading": [0, 1, 0]}, "axis heading holds 0 twice"),
    "empty": ({**PLACE, "heading": []}, r"axis heading has shape \(0,\)"),
    "table": ({**PLACE, "heading": [[0, 1]]}, r"axis heading has shape \(1, 2\)"),
    "object": ({**PLACE, "heading": None}, "axis heading"),
    "negative speed": ({**PLACE, "heading": 0, "speed": [-1, 1]}, "axis speed holds -1 m/s"),
    "degrees": ({**PLACE, "heading": 90}, "axis heading holds 90 rad .*write 90deg"),
    "over the top": ({**PLACE, "heading": 0, "pitch": 2}, "axis pitch holds 2 rad"),
    "degrees of length": ({**PLACE, "com_x": "90deg", "heading": 0}, "axis com_x: '90deg'"),
}


@pytest.mark.parametrize("axes, message", BAD_AXES.values(), ids=BAD_AXES)
def test_axes_that_cannot_be_used(axes, message):
    with pytest.raises(InputError, match=message):
        kernel_map(FEET, axes)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"quantities": ["height"]}, "quantity 'height' is not known"),
        ({"quantities": ["effort"]}, "quantity 'effort' needs a robot's posture"),
        ({"quantities": ["max_speed", "max_speed"]}, "'max_speed' is given twice"),
        ({"quantities": []}, "quantities: none"),
        ({"quantities": "margin"}, "quantity 'margin' needs a speed"),
        ({"gravity": (0, 0)}, "gravity"),
        ({"gravity": (0, 0, np.nan)}, "gravity"),
        ({"sides": 2}, "sides"),
        ({"dtype": np.int32}, "dtype = int32"),
        ({"dtype": np.float64}, "dtype = float64 while JAX is restricted"),
    ],
    ids=str,
)
def test_options_that_cannot_be_used(options, message):
    with pytest.raises(InputError, match=message):
        kernel_map(FEET, {**PLACE, "heading": 0}, **options)


def test_contacts_that_cannot_be_used():
    axes = {**PLACE, "heading": 0}
    many = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), FEET)
    with pytest.raises(InputError, match="expected one"):
        kernel_map(many, axes)
    with pytest.raises(InputError, match="rays of 2 contact sets"):
        kernel_map(jaxcap.cone_rays(many), axes)
    with pytest.raises(InputError, match="none of 0 is active"):
        kernel_map(jaxcap.ContactSet(np.zeros((0, 3)), np.eye(3), 1.0), axes)


# files


def test_a_file_is_the_map_and_opens_without_us(tmp_path):
    expected = kernel_map(FEET, POINTS, EVERY)
    for name in ("map.zarr", "map.nc"):
        assert write_map(tmp_path / name, FEET, POINTS, EVERY) == expected.margin.size
        with xr.open_dataset(tmp_path / name) as found:
            if name == "map.zarr":  # there a verdict may be lost with its chunk: -1, beside 0 and 1
                assert found.capturable.dtype == np.int8 and found.capturable.flag_meanings == "no yes"
                verdict = found.capturable.astype(bool).assign_attrs(found.capturable.attrs)
                found = found.assign(capturable=verdict)
                del found.capturable.attrs["flag_values"], found.capturable.attrs["flag_meanings"]
            xr.testing.assert_identical(found.load(), expected)
            assert all(found[quantity].dtype == expected[quantity].dtype for quantity in EVERY)
            assert found.com_z.dims == () and "com_z" in found.coords
    assert sorted(os.listdir(tmp_path)) == ["map.nc", "map.zarr"]


def test_what_a_map_says_of_itself(tmp_path):
    found = kernel_map(FEET, POINTS, EVERY)
    assert {name: found[name].units for name in found.coords} == {name: AXES[name].unit for name in found.coords}
    assert found.heading.units == "rad" and found.max_speed.units == "m/s" and found.capturable.units == "1"
    assert all(found[name].long_name for name in found.variables)
    named = dict(zip(found.case.flag_meanings.split(), found.case.flag_values, strict=True))
    assert named == {case.name: case.value for case in Case}
    assert found.attrs["source"] == f"jaxcap {jaxcap.__version__}" and found.attrs["gravity"] == [0, 0, -9.81]
    assert found.attrs["sides"] == 4 and found.attrs["dtype"] == "float32"
    (tmp_path / "contacts.json").write_text(found.attrs["contacts"])
    again = read_contacts(tmp_path / "contacts.json")
    np.testing.assert_array_equal(again.points, FEET.points)
    np.testing.assert_array_equal(again.frames, FEET.frames)


def test_the_dtype_of_the_axes_decides(x64):
    of = lambda **axes: checked(FEET, {**PLACE, **axes}, None, None).dtype
    assert of(heading=np.zeros(1, np.float32)) == np.float32
    assert of(heading=np.zeros(1)) == of(heading="0:1:4") == of(heading=[0, 1]) == np.float64
    assert of(heading=np.zeros(1, np.float32), com_x=np.zeros(1)) == np.float64
    with jax.enable_x64(False):
        assert of(heading=np.zeros(1)) == np.float32


@pytest.fixture
def small(monkeypatch):
    """Regions so small that POINTS has many."""
    monkeypatch.setattr(map_blocks, "REGION", 30)


def interrupted(monkeypatch, after: int, error=KeyboardInterrupt):
    """Makes the next map end with an error when so many regions are done."""
    over = map_blocks.Answers.over

    def some(self, numbers):
        for i, answer in enumerate(over(self, numbers)):
            if i == after:
                raise error
            yield answer

    monkeypatch.setattr(map_blocks.Answers, "over", some)


def test_an_interrupted_map_goes_on_to_the_same_bytes(tmp_path, monkeypatch, small):
    write_map(tmp_path / "whole.zarr", FEET, POINTS, EVERY)
    total = len(map_blocks.regions(grid_of(POINTS)))
    assert total > 12
    for after in (0, 3, 1, 4):
        with monkeypatch.context() as patch:
            interrupted(patch, after)
            with pytest.raises(KeyboardInterrupt):
                write_map(tmp_path / "map.zarr", FEET, POINTS, EVERY)
        assert not (tmp_path / "map.zarr").exists()
    journal = tmp_path / "map.zarr.partial" / "journal"
    assert journal.read_text().split() == [str(i) for i in range(8)]
    stray = tmp_path / "map.zarr.partial" / "map.zarr" / "margin" / "c.0123.partial"
    stray.write_bytes(b"half")  # as zarr leaves it when it is killed
    with open(journal, "a") as file:
        file.write("1")  # of 10 or 11: a torn line
        assert 0 < write_map(tmp_path / "map.zarr", FEET, POINTS, EVERY) < grid_of(POINTS).size
    assert tree(tmp_path / "map.zarr") == tree(tmp_path / "whole.zarr")
    assert sorted(os.listdir(tmp_path)) == ["map.zarr", "whole.zarr"]


@pytest.mark.parametrize("quantity", EVERY)
def test_a_chunk_that_is_lost_holds_no_verdict(tmp_path, small, quantity):
    """F2: -1 in codes, NaN in figures; a chunk of zeros is there, and no chunk is not zeros."""
    write_map(tmp_path / "map.zarr", FEET, POINTS, EVERY)
    with xr.open_dataset(tmp_path / "map.zarr", engine="zarr") as whole:
        whole = whole[quantity].load()
    chunk = next(file for file in sorted((tmp_path / "map.zarr" / quantity / "c").rglob("*")) if file.is_file())
    chunk.unlink()
    with xr.open_dataset(tmp_path / "map.zarr", engine="zarr") as found:
        found = found[quantity].load()
    lost = np.isnan(found.values) if found.dtype.kind == "f" else found.values == -1
    there = np.isnan(whole.values) if whole.dtype.kind == "f" else whole.values == -1
    assert lost.sum() > there.sum() and (lost | (found.values == whole.values)).all()


def test_a_chunk_that_is_not_in_the_journal_is_written_again(tmp_path, monkeypatch, small):
    write_map(tmp_path / "whole.zarr", FEET, POINTS, EVERY)
    with monkeypatch.context() as patch:
        interrupted(patch, 5)
        with pytest.raises(KeyboardInterrupt):
            write_map(tmp_path / "map.zarr", FEET, POINTS, EVERY)
    partial = tmp_path / "map.zarr.partial"
    (partial / "journal").write_text("0\n")
    for chunk in (file for file in (partial / "map.zarr" / "margin" / "c").rglob("*") if file.is_file()):
        if chunk.read_bytes() != tree(tmp_path / "whole.zarr").get("margin/c/0/0/0/0"):
            chunk.write_bytes(chunk.read_bytes()[:20])
    write_map(tmp_path / "map.zarr", FEET, POINTS, EVERY)
    assert tree(tmp_path / "map.zarr") == tree(tmp_path / "whole.zarr")


@pytest.mark.parametrize(
    "change, field",
    [
        (lambda axes: ({**axes, "com_z": 0.9}, EVERY, {}), "axes"),
        (lambda axes: (axes, VERDICT, {}), "title"),
        (lambda axes: (axes, EVERY, {"gravity": (0, 0, -1.62)}), "gravity"),
        (lambda axes: (axes, EVERY, {"sides": 8}), "sides"),
    ],
    ids=["axes", "quantities", "gravity", "sides"],
)
def test_an_unfinished_map_of_other_settings_is_left_alone(tmp_path, monkeypatch, small, change, field):
    with monkeypatch.context() as patch:
        interrupted(patch, 2)
        with pytest.raises(KeyboardInterrupt):
            write_map(tmp_path / "map.zarr", FEET, POINTS, EVERY)
    before = tree(tmp_path)
    axes, quantities, options = change(POINTS)
    with pytest.raises(InputError, match=f"unfinished map with other {field}"):
        write_map(tmp_path / "map.zarr", FEET, axes, quantities, **options)
    assert tree(tmp_path) == before


def test_a_directory_in_the_way_is_left_alone(tmp_path):
    (tmp_path / "map.zarr.partial").mkdir()
    (tmp_path / "map.zarr.partial" / "thesis.tex").write_text("all of it")
    with pytest.raises(InputError, match="is in the way"):
        write_map(tmp_path / "map.zarr", FEET, POINTS, EVERY)
    assert tree(tmp_path) == {"map.zarr.partial/thesis.tex": b"all of it"}


def test_two_processes_do_not_write_one_map(tmp_path, monkeypatch, small):
    fcntl = pytest.importorskip("fcntl")
    with monkeypatch.context() as patch:
        interrupted(patch, 2)
        with pytest.raises(KeyboardInterrupt):
            write_map(tmp_path / "map.zarr", FEET, POINTS, EVERY)
    with open(tmp_path / "map.zarr.partial" / "settings.json") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another process is writing it"):
            write_map(tmp_path / "map.zarr", FEET, POINTS, EVERY)


@pytest.fixture
def no_computing(monkeypatch):
    """Whoever computes fails the test."""

    def fail(*_):
        raise AssertionError("something is computed")

    monkeypatch.setattr(map_blocks, "_compiled", fail)


def test_outputs_that_cannot_be_written(tmp_path, no_computing):
    (tmp_path / "file.nc").write_text("old")
    (tmp_path / "file.zarr").write_text("old")
    (tmp_path / "home.zarr").mkdir()
    cases = {
        "map.parquet": "unknown extension '.parquet' .expected .zarr or .nc",
        "nowhere/map.zarr": "no such directory",
        "file.nc": "exists already",
        "file.zarr": "is not a Zarr group",
        "home.zarr": "is not a Zarr group",
    }
    for name, message in cases.items():
        with pytest.raises(InputError, match=message):
            write_map(tmp_path / name, FEET, POINTS)
    for name in ("file.zarr", "home.zarr"):
        with pytest.raises(InputError, match="is not a Zarr group"):
            write_map(tmp_path / name, FEET, POINTS, force=True)


def test_a_map_that_does_not_fit(tmp_path, monkeypatch, no_computing):
    huge = {**POINTS, "com_x": "0:1:100000", "com_y": "0:1:100000", "com_z": "0:1:1000"}
    with pytest.raises(InputError, match=r"the map may take 9.6e\+05 GB, and the disk has"):
        write_map(tmp_path / "map.zarr", FEET, huge)
    with pytest.raises(InputError, match="write it to Zarr instead"):
        kernel_map(FEET, huge)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=100))
    for name in ("map.zarr", "map.nc"):
        with pytest.raises(InputError, match="the disk has 1e-07 GB left"):
            write_map(tmp_path / name, FEET, POINTS)
    assert os.listdir(tmp_path) == []


def test_force_replaces_a_map_when_the_new_one_is_there(tmp_path, monkeypatch):
    path = tmp_path / "map.zarr"
    write_map(path, FEET, POINTS, EVERY)
    old = tree(path)
    faster = {**POINTS, "speed": [0, 0.1, 0.3, 0.9]}
    with pytest.raises(InputError, match="exists already"):
        write_map(path, FEET, faster, EVERY)
    with monkeypatch.context() as patch:
        interrupted(patch, 0)
        with pytest.raises(KeyboardInterrupt):
            write_map(path, FEET, faster, EVERY, force=True)
    assert tree(path) == old
    write_map(path, FEET, faster, EVERY, force=True)
    with xr.open_dataset(path) as found:
        expected = kernel_map(FEET, faster, EVERY)
        xr.testing.assert_identical(found.drop_vars("capturable").load(), expected.drop_vars("capturable"))
        np.testing.assert_array_equal(found.capturable.values == 1, expected.capturable.values)
    assert os.listdir(tmp_path) == ["map.zarr"]


# what it costs to import


def test_importing_the_library_needs_no_xarray():
    program = "import sys, jaxcap, jaxcap.maps.grid; assert not {'xarray', 'zarr', 'tqdm'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_missing_extra_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    monkeypatch.delitem(sys.modules, "jaxcap.maps.kernel")
    with pytest.raises(MissingExtra, match=r'jaxcap.maps needs xarray; install it with: pip install "jaxcap\[maps\]"'):
        importlib.import_module("jaxcap.maps").kernel_map  # noqa: B018
    monkeypatch.undo()
    assert importlib.import_module("jaxcap.maps").kernel_map is kernel_map


def test_netcdf_without_its_packages(tmp_path, monkeypatch, no_computing):
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingExtra, match=r"writing netCDF needs h5py; .*jaxcap\[maps\]"):
        write_map(tmp_path / "map.nc", FEET, POINTS)


def test_settings_are_json():
    """What decides whether a map may be continued is written down, and is the same when it is read."""
    _, about = prepared(FEET, checked(FEET, POINTS, None, None), (0, 0, -9.81), 4, False)
    assert json.loads(json.dumps(about.settings)) == about.settings
