"""Maps through contact sets: sections along friction, slope, or one set and another."""

import numpy as np
import pytest
import xarray as xr
from samplers import rotation
from state_files import write_contacts

import jaxcap
from jaxcap import Case
from jaxcap.commands.cli import main
from jaxcap.errors import InputError
from jaxcap.files.contact_files import read_contact_sets
from jaxcap.maps import blocks as map_blocks
from jaxcap.maps import kernel_map, write_map
from jaxcap.maps.contact_axes import contacts_at
from jaxcap.maps.grid import axes_around, grid_of
from jaxcap.plotting.map_figure import map_figure

FOOT = jaxcap.rectangle([0, 0.1, 0], np.eye(3), 0.1, 0.05, 0.5)
FEET = FOOT + jaxcap.rectangle([0.2, -0.15, 0.1], np.eye(3), 0.1, 0.05, 0.7)
PALM = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]])
NONE = jaxcap.ContactSet(np.zeros((0, 3)), np.eye(3), 1.0)
HAND = jaxcap.rectangle([0.6, 0.2, 1.0], PALM, 0.05, 0.03, 0.8)
AXES = {"com_x": [-0.1, 0.0, 0.1, 0.25], "com_y": [-0.1, 0.0], "com_z": 0.8, "heading": "0:360deg:8"}
PLACE = {"com_x": 0, "com_y": 0, "com_z": 0.8, "heading": 0.0}
ROWS = 160
"""Faces of any cone here, or less: one program for all maps of the same shape."""


def mapped(contacts, axes=AXES):
    """The map of one contact set, by its cone."""
    return kernel_map(jaxcap.centroidal_cone(contacts).padded(ROWS), axes)


def assert_same(found: xr.Dataset, expected: xr.Dataset):
    """The same figures, bit by bit."""
    for name in ("min_speed", "max_speed"):
        np.testing.assert_array_equal(found[name], expected[name], name)


# laws


def test_a_section_holds_the_map_of_each_contact_set():
    """Whatever the number of faces: those of other friction and slopes are others."""
    frictions, slopes = [0.2, 0.7], [-0.2, 0.0, 0.3]
    found = kernel_map(FEET + HAND, {"slope": slopes, **AXES, "friction": frictions, "downhill": 1.0})
    assert found.max_speed.dims == ("slope", "com_x", "com_y", "heading", "friction")
    faces = set()
    for slope in slopes:
        for friction in frictions:
            one = contacts_at([FEET + HAND], friction=friction, slope=slope, downhill=1.0)
            faces.add(len(jaxcap.centroidal_cone(one).faces))
            assert_same(found.sel(slope=slope, friction=friction), mapped(one))
    assert len(faces) > 1


def test_a_slope_is_gravity_turned(x64):
    """A robot on a slope is one on level ground, under gravity that is not upright: in the frame of its contacts."""
    slope, downhill = 0.15, 2.0
    turn = np.array(rotation(0, 0, downhill)) @ rotation(0, slope, 0) @ rotation(0, 0, -downhill)
    assert (turn @ [np.cos(downhill), np.sin(downhill), 0])[2] == pytest.approx(-np.sin(slope))  # downhill goes down
    coms, velocities = grid_of({**AXES, "speed": 0.1}).states(np.arange(64))
    centroid = FEET.points.mean(axis=0)
    cone, gravity = jaxcap.centroidal_cone(FEET), np.array([0, 0, -9.81])
    level = jaxcap.score(cone, centroid + (coms - centroid) @ turn, velocities @ turn, gravity @ turn)
    found = kernel_map(FEET, {**AXES, "slope": slope, "downhill": downhill})
    for name in ("min_speed", "max_speed"):
        np.testing.assert_allclose(found[name].values.ravel(), getattr(level, name), atol=1e-9, err_msg=name)
    assert (level.max_speed > 0).any() and (level.min_speed > 0).any()


def test_a_slope_turns_with_its_heading(x64):
    """Uphill is downhill the other way, and a full circle of slopes is none."""
    slopes = kernel_map(FEET, {**PLACE, "slope": [-0.1, 0.1], "downhill": [0.5, 0.5 + np.pi]}).max_speed
    np.testing.assert_allclose(slopes[0, 0], slopes[1, 1], rtol=1e-9)
    np.testing.assert_allclose(slopes[0, 1], slopes[1, 0], rtol=1e-9)
    directions = grid_of({**PLACE, "slope": 0.1, "downhill": "0:360deg:8"}).axes["downhill"]
    np.testing.assert_allclose(directions, np.arange(8) * np.pi / 4)


def test_friction_and_contacts_never_hurt(x64):
    found = kernel_map({"foot": FOOT, "feet": FEET, "hand": FEET + HAND}, {**AXES, "friction": "0.1:1:4"})
    for axis in ("contact_set", "friction"):
        assert (found.max_speed.astype(np.float64).diff(axis) >= -1e-9).all()
        gained = found.max_speed.isel({axis: -1}) > found.max_speed.isel({axis: 0}) + 1e-3
        assert gained.any()
        some = found.max_speed.isel({axis: slice(None, -1)}).drop_vars(axis) > 0
        assert (found.min_speed.diff(axis).drop_vars(axis).where(some, 0) <= 1e-9).all()


def test_a_section_of_verdicts_and_of_velocities():
    """With a speed, and with velocities by components, the contacts are outer axes like any other."""
    found = kernel_map(FEET, {"friction": [0.1, 0.7], **AXES, "speed": [0, 0.1, 1.0]}, ("capturable", "case", "max_speed"))
    assert found.capturable.dims == ("friction", "com_x", "com_y", "heading", "speed")
    moving = found.sel(speed=[0.1, 1.0])
    assert not (moving.capturable & (moving.speed.astype(np.float32) > moving.max_speed)).any()
    assert moving.capturable.any("speed").any(("com_x", "com_y", "heading")).all()
    assert {Case.C1, Case.C3_1} <= set(found.case.values.ravel().tolist())
    cartesian = {"com_x": 0, "com_y": 0, "com_z": 0.8, "velocity_x": [-0.2, 0.2], "velocity_y": [0.0, 0.1]}
    both = kernel_map(FEET, {**cartesian, "friction": [0.1, 0.7]}, ["margin"])
    for i, friction in enumerate((0.1, 0.7)):
        one = jaxcap.ContactSet(FEET.points, FEET.frames, friction)
        alone = kernel_map(jaxcap.centroidal_cone(one).padded(ROWS), cartesian, ["margin"])
        np.testing.assert_array_equal(both.margin[..., i], alone.margin)


# contact sets


def test_several_sets_are_an_axis_with_their_names(tmp_path):
    sets = {"one foot": FOOT, "both feet": FEET, "feet, hand": FEET + HAND}
    found = kernel_map(sets, AXES)
    assert found.max_speed.dims == ("contact_set", "com_x", "com_y", "heading")
    assert found.contact_set.dtype == np.int32
    assert found.contact_set.flag_meanings == "one_foot both_feet feet,_hand"
    for number, contacts in enumerate(sets.values()):
        assert_same(found.sel(contact_set=number), mapped(contacts))
    (tmp_path / "sets.json").write_text(found.attrs["contacts"])
    again, names = read_contact_sets(tmp_path / "sets.json")
    assert names == tuple(sets)
    for ours, theirs in zip(again, sets.values(), strict=True):
        np.testing.assert_array_equal(ours.points, theirs.points)
    two = kernel_map(list(sets.values()), {"contact_set": [2, 0], **AXES})
    assert_same(two, found.sel(contact_set=[2, 0]))
    assert "flag_meanings" not in two.contact_set.attrs
    alone = kernel_map(sets, {**AXES, "contact_set": 1})
    assert alone.max_speed.dims == ("com_x", "com_y", "heading")
    assert_same(alone, found.sel(contact_set=1))


def test_one_set_in_a_list_is_that_set():
    xr.testing.assert_identical(kernel_map([FEET], PLACE), kernel_map(FEET, PLACE))


def test_masked_contacts_are_not_turned_about():
    padded, plain = (contacts_at([contacts], slope=0.2) for contacts in (FEET.padded(10), FEET))
    np.testing.assert_array_equal(padded.points[:8], plain.points)
    np.testing.assert_allclose(plain.points.mean(axis=0), FEET.points.mean(axis=0), atol=1e-15)
    assert contacts_at([FEET.padded(10)], friction=0.1).mask.sum() == 8


def test_a_level_set_with_its_own_friction_is_untouched():
    same = contacts_at([FOOT, FEET], contact_set=1)
    for field in ("points", "frames", "friction", "mask"):
        np.testing.assert_array_equal(getattr(same, field), getattr(FEET, field))


def test_defaults_lie_around_all_sets():
    axes = axes_around([FOOT, HAND], {})
    assert axes["com_x"][[0, -1]] == pytest.approx([-0.2, 0.7]) and axes["com_z"] == pytest.approx(0.8)


# what is refused


@pytest.mark.parametrize(
    "contacts, axes, message",
    [
        (FEET, {"friction": [0, 0.5]}, "axis friction holds 0 .expected positive numbers"),
        (FEET, {"friction": "none"}, "axis friction: 'none'"),
        (FEET, {"slope": 10}, "axis slope holds 10 rad .*write 10deg"),
        (FEET, {"downhill": 1}, "axis downhill: there is no slope"),
        (FEET, {"contact_set": 1}, "axis contact_set holds 1 .expected 0: there is one set"),
        ([FEET, FOOT], {"contact_set": [0, 2]}, "axis contact_set holds 2 .expected 0 to 1"),
        ([FEET, FOOT], {"contact_set": [0, 0.5]}, "axis contact_set holds 0.5 .expected 0 to 1"),
        ([FEET, FOOT], {"contact_set": -1}, "axis contact_set holds -1"),
        (jaxcap.centroidal_cone(FEET), {"friction": 0.5}, "axis 'friction' needs contacts .got a CentroidalCone"),
        (jaxcap.cone_rays(FEET), {"slope": 0.5}, "axis 'slope' needs contacts .got a ConeRays"),
        ([], {}, "contacts: no set"),
        ([FEET, "feet.yaml"], {}, "contacts: set 1: 'feet.yaml' .expected one set of contacts"),
        ({"none": NONE, "feet": FEET}, {}, "contact_set = 0: none of 0 is active"),
    ],
)
def test_contacts_that_cannot_be_mapped(tmp_path, contacts, axes, message):
    with pytest.raises(InputError, match=message):
        kernel_map(contacts, {**PLACE, **axes})
    with pytest.raises(InputError, match=message):
        write_map(tmp_path / "map.zarr", contacts, {**PLACE, **axes})
    assert not list(tmp_path.iterdir())


# files and pictures


def test_a_section_that_is_interrupted_goes_on(tmp_path, monkeypatch):
    axes = {**AXES, "friction": "0.1:1:4"}
    expected = kernel_map([FOOT, FEET], axes)
    over = map_blocks.Answers.over

    def some(self, numbers):
        for i, answer in enumerate(over(self, numbers)):
            if i == 5:
                raise KeyboardInterrupt
            yield answer

    with monkeypatch.context() as patch:
        patch.setattr(map_blocks.Answers, "over", some)
        with pytest.raises(KeyboardInterrupt):
            write_map(tmp_path / "map.zarr", [FOOT, FEET], axes)
    with pytest.raises(InputError, match="unfinished map with other"):
        write_map(tmp_path / "map.zarr", [FOOT, FOOT], axes)
    assert write_map(tmp_path / "map.zarr", [FOOT, FEET], axes) == 3 * grid_of(AXES).size
    with xr.open_dataset(tmp_path / "map.zarr") as found:
        xr.testing.assert_identical(found.load(), expected)


def test_the_command_line_maps_sections_and_draws_them(tmp_path, capsys):
    foot = {"type": "rectangle", "position": [0, 0.1, 0], "half_length": 0.1, "half_width": 0.05, "friction": 0.5}
    feet = [foot, {**foot, "position": [0, -0.1, 0]}]
    sets = [{"name": "left foot", "contacts": [foot]}, {"name": "feet", "contacts": feet}]
    contacts = write_contacts(tmp_path / "sets.yaml", {"sets": sets})
    axes = "com_x=-0.2:0.2:5", "com_y=-0.2:0.2:5", "heading=0:360deg:4", "slope=-5deg,5deg"
    options = [f"--axis={axis}" for axis in axes]
    assert main(["map", str(contacts), "-o", str(tmp_path / "map.zarr"), *options]) == 0
    assert "contact_set 2 x com_x 5 x com_y 5 x heading 4 x slope 2, 400 states" in capsys.readouterr().out
    assert main(["plot", str(tmp_path / "map.zarr"), "--select", "contact_set=1"]) == 0
    told = capsys.readouterr()
    assert told.err.endswith("slope = 5 deg, one of 2 (--select slope=...)\n")
    with xr.open_dataset(tmp_path / "map.zarr") as found:
        sets = read_contact_sets(contacts).sets
        for number, count in ((0, 1), (1, 2)):
            figure, _ = map_figure(found, sets, None, (None, None), {"contact_set": number, "slope": 0.08727})
            soles = [patch for patch in figure.axes[0].patches if len(patch.get_xy()) == 5]
            assert len(soles) == count  # turned about their centroid, seen from above
            assert np.ptp(soles[0].get_xy()[:, 0]) == pytest.approx(0.2 * np.cos(np.radians(5)))
            name = ("left_foot", "feet")[number]
            assert figure.get_suptitle() == f"com_z = 0.8 m, pitch = 0 deg, contact_set = {name}, slope = 5 deg"


def test_friction_against_heading_is_a_picture():
    found = kernel_map(FEET, {"friction": "0.1:1:4", **PLACE, "heading": "0:360deg:8"})
    figure, chosen = map_figure(found, [FEET], None, (None, None), {})
    assert chosen == {} and figure.axes[0].get_xlabel() == "friction coefficient"
    assert figure.axes[0].get_title() == "com_x = 0 m, com_y = 0 m, com_z = 0.8 m, pitch = 0 deg"
