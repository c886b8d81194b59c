"""What is drawn is what is computed, with units, whatever the contacts; nothing global changes."""

import io
import subprocess
import sys
from itertools import pairwise

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from samplers import rotation
from scipy.optimize import linprog

import jaxcap
from jaxcap import Case, Status, plotting
from jaxcap.contacts.friction import pyramid_edges, wrench_rays
from jaxcap.plotting.kernels import CODES
from jaxcap.plotting.patches import patches
from jaxcap.plotting.region import clipped
from jaxcap.plotting.travel import travel
from jaxcap.regions.velocity_area import VelocityArea, headings, velocity_area

pytestmark = pytest.mark.usefixtures("x64")
UP, G, HEIGHT = np.eye(3), 9.81, 0.8
OMEGA = np.sqrt(G / HEIGHT)


def foot(x, y, friction=0.5, z=0.0, frame=UP):
    return jaxcap.rectangle([x, y, z], frame, 0.1, 0.05, friction)


def points(*positions, frames=UP):
    return jaxcap.ContactSet(np.array(positions, float), frames, 0.5)


FEET = foot(0, 0.1, 2.0) + foot(0, -0.1, 2.0)
CONTACTS = {
    "two feet": FEET,
    "one point": points([0, 0, 0]),
    "two points": points([0.1, 0, 0], [-0.1, 0, 0]),
    "coplanar points in a line": points([0.1, 0, 0], [0, 0, 0], [-0.1, 0, 0]),
    "opposing palms": foot(0, 0.2, frame=rotation(np.pi / 2, 0, 0)) + foot(0, -0.2, frame=rotation(-np.pi / 2, 0, 0)),
    "a wall alone": foot(0.3, 0, z=1, frame=rotation(0, -np.pi / 2, 0)),
    "a ceiling": foot(0, 0, z=2, frame=rotation(np.pi, 0, 0)),
    "masked contacts": FEET.padded(10),
    "far from the origin": jaxcap.ContactSet(FEET.points + np.array([100, 100, 0]), FEET.frames, FEET.friction),
}
STATES = {  # on FEET, along x: CoM position and speed
    "stops": (0.0, 0.2, Case.C3_1),
    "diverges": (0.0, 0.5, Case.C1),
    "has to be slow enough": (-0.15, 0.5, Case.C3_2_1),
    "reaches the feet with a push": (-0.15, 0.2, Case.C3_2_1),
    "falls back": (-0.15, 0.1, Case.C3_2_2),
}


@pytest.fixture
def cone():
    return jaxcap.centroidal_cone(FEET)


def drawn(ax) -> bytes:
    """The picture, drawn for good."""
    file = io.BytesIO()
    ax.figure.savefig(file, format="png", dpi=40)
    return file.getvalue()


def line(ax, label):
    """Data (n, 2) of the line with this label."""
    return next(np.column_stack(found.get_data()) for found in ax.lines if found.get_label() == label)


def legend(ax) -> list[str]:
    return [text.get_text() for text in ax.get_legend().get_texts()] if ax.get_legend() else []


# the polygon and the phase portrait


def test_the_polygon_of_flat_ground_is_the_one_of_the_inverted_pendulum(cone):
    """acceleration = omega^2 (position - centre of pressure), which is anywhere in the feet, while friction is ample."""
    ax = plotting.polygon(cone, [0, 0, HEIGHT], [0.2, 0, 0])
    (region,) = (patch.get_path().vertices for patch in ax.patches)
    pressure = region[:, 0] - region[:, 1] / OMEGA**2
    low, high = ax.get_xlim()
    edge = (region[:, 0] < low) | (region[:, 0] > high)
    assert edge.sum() >= 2
    np.testing.assert_allclose(np.abs(pressure), 0.1, atol=1e-8)


@pytest.mark.parametrize("name", STATES)
def test_the_walk_is_the_motion_that_capturability_means(cone, name):
    """It begins at the state, its speed is the integral of its acceleration, and it ends where `distance` says."""
    x, speed, case = STATES[name]
    com, velocity = [x, 0, HEIGHT], [speed, 0, 0]
    out = jaxcap.capturability(cone, np.array(com, float), np.array(velocity, float))
    walk = travel(cone, com, velocity, (0, 0, -G)).walk
    assert out.case == case
    np.testing.assert_allclose([walk.alpha[0], walk.speed[0]], [0, speed], atol=1e-9)
    gains = np.diff(walk.speed**2) / 2
    means = (walk.acceleration[1:] + walk.acceleration[:-1]) / 2 * np.diff(walk.alpha)
    switch = np.argmax(np.abs(gains - means))  # where least deceleration turns into the largest
    np.testing.assert_allclose(np.delete(gains, switch), np.delete(means, switch), atol=1e-9)
    assert (abs(gains[switch] - means[switch]) < 1e-9) or case == Case.C3_2_1
    if out.capturable:
        assert walk.speed[-1] == 0
        assert walk.alpha[-1] == pytest.approx(float(out.distance), abs=1e-9)
    if case == Case.C1:
        assert walk.speed[-1] == pytest.approx(float(out.residual_speed), rel=1e-9)


@pytest.mark.parametrize("name", STATES)
def test_the_lines_in_both_pictures_are_the_walk(cone, name):
    x, speed, _ = STATES[name]
    arguments = cone, [x, 0, HEIGHT], [speed, 0, 0]
    walk = travel(*arguments, (0, 0, -G)).walk
    polygon, phase = plotting.polygon(*arguments), plotting.phase_portrait(*arguments)
    np.testing.assert_array_equal(line(polygon, "walk"), np.column_stack([walk.alpha, walk.acceleration]))
    np.testing.assert_array_equal(line(phase, "walk"), np.column_stack([walk.alpha, walk.speed]))
    (low, high), (bottom, top) = polygon.get_xlim(), polygon.get_ylim()
    assert low < 0 and walk.alpha[-1] < high and bottom < walk.acceleration.min() and walk.acceleration.max() < top
    ends = legend(polygon)
    assert ("comes to rest" in ends) == (walk.speed[-1] == 0)
    assert any(text.startswith("lost, at") for text in ends) == (walk.speed[-1] > 0)


@pytest.mark.parametrize("name", STATES)
def test_a_walk_stays_in_the_capturable_band_if_and_only_if_the_state_is_capturable(cone, name):
    x, speed, _ = STATES[name]
    arguments = cone, np.array([x, 0, HEIGHT]), np.array([speed, 0, 0])
    capturable = bool(jaxcap.capturability(*arguments).capturable)
    ax = plotting.phase_portrait(*arguments)
    walk, edges = line(ax, "walk"), [np.column_stack(edge.get_data()) for edge in ax.lines[:2]]
    smallest, largest = (np.interp(walk[:, 0], *edge.T) for edge in edges)
    inside = (smallest - 1e-3 <= walk[:, 1]) & (walk[:, 1] <= largest + 1e-3)
    assert inside.all() if capturable else not inside[0]


def test_the_band_of_flat_ground_is_that_of_the_capture_point(cone):
    """position + speed/omega is in the feet."""
    ax = plotting.phase_portrait(cone, [0, 0, HEIGHT], [0.2, 0, 0])
    for edge, sign, side in zip(ax.lines[:4], (1, 1, -1, -1), (-0.1, 0.1, 0.1, -0.1), strict=True):
        alpha, speed = np.array(edge.get_data())
        alpha, speed = alpha[np.isfinite(speed)], speed[np.isfinite(speed)]
        assert len(alpha) > 50
        np.testing.assert_allclose(speed, sign * np.maximum(0, sign * (side - alpha) * OMEGA), atol=1e-6)


@pytest.mark.parametrize("size", [(6.4, 4.8), (5, 5), (10, 4)])
def test_the_names_of_the_axes_of_a_stance_are_in_the_figure(size):
    """In axes of a figure without any layout."""
    ax = Figure(figsize=size).add_subplot(projection="3d")
    plotting.stance(FEET, [0, 0, HEIGHT], [0.3, 0, 0], ax=ax)
    drawn(ax)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        box, figure = axis.label.get_window_extent(), ax.figure.bbox
        assert figure.x0 <= box.x0 and box.x1 <= figure.x1 and figure.y0 <= box.y0 and box.y1 <= figure.y1


def test_both_pictures_name_axes_verdict_and_static_region(cone):
    for draw, unit in ((plotting.polygon, "[m/s$^2$]"), (plotting.phase_portrait, "[m/s]")):
        ax = draw(cone, [0.02, 0, HEIGHT], [0.2, 0, 0])
        margin = 0.08 * OMEGA - 0.2
        assert ax.get_title() == f"capturable: stops where it can stand, margin {margin:+.2f} m/s"
        assert "[m]" in ax.get_xlabel() and unit in ax.get_ylabel()
        np.testing.assert_allclose(line(ax, "static region"), [[-0.12, 0], [0.08, 0]], atol=1e-9)


def test_unbounded_speeds_are_hatched_and_said():
    cone = jaxcap.centroidal_cone(CONTACTS["opposing palms"])
    ax = plotting.phase_portrait(cone, [0, 0, 1], [0.3, 0, 0])
    assert "at any speed" in legend(ax)
    assert [found.get_hatch() for found in ax.collections].count("//") == 2


def test_no_acceleration_at_all_is_said():
    ax = plotting.polygon(jaxcap.centroidal_cone(CONTACTS["a wall alone"]), [3, 0, 1], [0.3, 0.1, 0])
    assert not ax.patches
    assert [text.get_text() for text in ax.texts] == ["no acceleration keeps the contacts"]
    assert "walk" not in legend(ax)


@pytest.mark.parametrize("draw", [plotting.polygon, plotting.phase_portrait])
def test_states_without_a_line_are_refused(cone, draw):
    with pytest.raises(ValueError, match="com_velocity is zero"):
        draw(cone, [0, 0, HEIGHT], [0, 0, 0])
    with pytest.raises(ValueError, match=r"com = .*nan.*expected 3 finite numbers"):
        draw(cone, [0, np.nan, HEIGHT], [0.1, 0, 0])
    with pytest.raises(ValueError, match=r"com_velocity = .*expected 3 finite numbers"):
        draw(cone, [0, 0, HEIGHT], [0.1, 0])


def test_a_window_clips_half_planes():
    square = (0.0, 1.0, 0.0, 1.0)
    normals = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, 0.0]])
    np.testing.assert_array_equal(clipped(square, normals[:0], np.zeros(0)), [[0, 0], [1, 0], [1, 1], [0, 1]])
    np.testing.assert_allclose(clipped(square, normals[:1], np.ones(1)), [[0, 0], [1, 0], [0, 1]])
    np.testing.assert_allclose(np.unique(clipped(square, normals[:2], np.array([1.0, -1.0])), axis=0), [[0, 1], [1, 0]])
    assert clipped(square, normals[2:], np.array([-0.5])).shape == (0, 2)
    assert clipped(square, np.zeros((1, 2)), np.array([-1.0])).shape == (0, 2)


# the stance


def stands(contacts, sides, place) -> bool:
    """Whether forces in the friction pyramids balance a weight at this place (2,), by linear programming."""
    rays = wrench_rays(contacts, sides, np.zeros(3))
    weight = np.array([0, 0, 1, place[1], -place[0], 0])
    return linprog(np.zeros(len(rays)), A_eq=rays.T, b_eq=weight, bounds=(0, None)).success


def test_a_stance_shows_contacts_pyramids_support_polygon_and_com():
    contacts = FEET + points([0.3, 0.1, 0.4])
    com, velocity = np.array([0.05, 0.02, 0.9]), np.array([0.4, -0.2, 0.1])
    ax = plotting.stance(contacts, com, velocity, sides=5, scale=0.5)
    shown = {found.get_label(): found for found in ax.collections}
    assert shown.keys() >= {"contacts", "friction pyramids", "support polygon", "CoM"}
    corners = lambda name: [np.asarray(face) for face in shown[name]._faces]
    np.testing.assert_allclose(np.concatenate(corners("contacts")), FEET.points)
    sides = np.array(corners("friction pyramids")).reshape(len(contacts), 5, 3, 3)
    np.testing.assert_allclose(sides[:, :, 0], np.repeat(contacts.points[:, None], 5, axis=1))
    edges = pyramid_edges(contacts.frames, contacts.friction, 5)
    drawn_edges = sides[:, :, 1] - sides[:, :, 0]
    aligned = np.sum(edges * drawn_edges, axis=-1) / np.linalg.norm(edges, axis=-1) / np.linalg.norm(drawn_edges, axis=-1)
    np.testing.assert_allclose(aligned, 1)
    (support,) = corners("support polygon")
    assert (support[:, 2] == 0).all()
    for vertex in support[:, :2]:  # its edge is where standing ends
        inwards = 1e-6 * (support[:, :2].mean(axis=0) - vertex)
        assert [stands(contacts, 5, at) for at in (vertex + inwards, vertex - inwards)] == [True, False]
    arrow = next(found for found in ax.collections if found.get_label().startswith("velocity"))
    assert arrow.get_label() == f"velocity, {np.linalg.norm(velocity):.2f} m/s"
    np.testing.assert_allclose(np.asarray(arrow._segments3d[0])[[-1, 0]], [com, com + 0.5 * velocity])


def test_a_stance_is_to_scale_and_has_units():
    ax = plotting.stance(FEET, [0, 0, HEIGHT])
    extents = [np.ptp(limits) for limits in (ax.get_xlim(), ax.get_ylim(), ax.get_zlim())]
    np.testing.assert_allclose(ax.get_box_aspect() / ax.get_box_aspect()[0], np.array(extents) / extents[0])
    assert [ax.get_xlabel(), ax.get_ylabel(), ax.get_zlabel()] == ["x [m]", "y [m]", "z [m]"]


def test_a_support_polygon_that_goes_on_says_so():
    assert "support polygon, goes on" in legend(plotting.stance(CONTACTS["opposing palms"]))
    assert "support polygon" in legend(plotting.stance(FEET))
    assert not [text for text in legend(plotting.stance(CONTACTS["a ceiling"])) if "support" in text]


def test_a_foot_is_four_corners_and_four_feet_are_points():
    hand = jaxcap.rectangle([0.5, 0.3, 1], rotation(0.4, 1.2, -2), 0.03, 0.02, 0.5)
    quadruped = points([0.37, 0.2, 0], [-0.37, 0.2, 0], [-0.37, -0.2, 0], [0.37, -0.2, 0])
    assert [len(found) for found in patches(FEET + hand + quadruped)] == [4, 4, 4, 1, 1, 1, 1]
    assert [len(found) for found in patches(points([0, 0, 0]) + hand)] == [1, 4]
    masked = jaxcap.ContactSet(FEET.points, FEET.frames, FEET.friction, mask=[False] + [True] * 7)
    assert [len(found) for found in patches(masked)] == [1, 1, 1, 4]


def test_a_footprint_draws_them_from_above():
    ax = plotting.footprint(FEET + points([0.3, 0.1, 0.4]))
    corners = np.array([patch.get_path().vertices[:4] for patch in ax.patches])
    np.testing.assert_array_equal(corners, FEET.points[:, :2].reshape(2, 4, 2))
    np.testing.assert_array_equal(ax.lines[0].get_xydata(), [[0.3, 0.1]])
    assert ax.get_aspect() == 1 and [ax.get_xlabel(), ax.get_ylabel()] == ["x [m]", "y [m]"]


# velocity areas


def test_a_velocity_area_has_the_largest_speeds_as_its_edge(cone):
    area = velocity_area(cone, np.array([0.02, 0.05, HEIGHT]), headings(24))
    ax = plotting.velocity_area(area)
    largest = np.asarray(area.max_speed)
    (patch,) = ax.patches
    np.testing.assert_allclose(patch.get_path().vertices[:24], largest[:, None] * area.directions[:, :2])
    np.testing.assert_allclose(np.linalg.norm(ax.lines[0].get_xydata(), axis=1), [*largest, largest[0]])
    assert ax.get_aspect() == 1 and "[m/s]" in ax.get_xlabel() and "[m/s]" in ax.get_ylabel()


def made(smallest, largest, standing=False):
    """A velocity area with these speeds, evenly spread."""
    return VelocityArea(headings(len(largest)), np.array(smallest, float), np.array(largest, float), np.array(standing))


def test_a_sector_keeps_its_smallest_speeds():
    ax = plotting.velocity_area(made([1, 1, 0, 0, 0, 1], [2, 2, 0, 0, 0, 2]))
    (patch,) = ax.patches
    assert sorted(np.round(np.linalg.norm(patch.get_path().vertices[:-1], axis=1), 9)) == [1, 1, 1, 2, 2, 2]


def test_infinite_and_undecided_directions_are_hatched_and_have_no_edge():
    area = made([0] * 8, [1, 1, np.inf, np.inf, 1, 1, np.nan, 1])
    ax = plotting.velocity_area(area, longest=3.0)
    fill, beyond, undecided = ax.patches
    assert [patch.get_hatch() for patch in ax.patches] == [None, "////", "...."]
    radii = lambda patch: np.linalg.norm(patch.get_path().vertices, axis=1)
    assert radii(beyond).max() == radii(undecided).max() == radii(fill).max() == pytest.approx(3)
    np.testing.assert_array_equal(np.isnan(ax.lines[0].get_xdata()), [0, 0, 1, 1, 0, 0, 1, 0, 0])


def test_nothing_capturable_draws_nothing():
    ax = plotting.velocity_area(made([0] * 8, [0] * 8))
    assert not ax.patches
    drawn(ax)


def test_velocity_areas_stand_over_their_places_to_one_scale(cone):
    coms = np.array([[-0.05, 0, HEIGHT], [0.05, 0, HEIGHT], [0.05, 0.3, HEIGHT]])
    areas = velocity_area(cone, coms, headings(16))
    ax = plotting.velocity_areas(areas, coms, scale=0.1)
    outlines = [patch.get_path().vertices[:16] for patch in ax.patches[:2]]
    for i, outline in enumerate(outlines):
        expected = coms[i, :2] + 0.1 * np.asarray(areas.max_speed)[i, :, None] * areas.directions[:, :2]
        np.testing.assert_allclose(outline, expected)
    standing, fallen = (np.column_stack(found.get_data()) for found in ax.lines[-2:])
    np.testing.assert_array_equal(standing, coms[:2, :2])
    np.testing.assert_array_equal(fallen, coms[2:, :2])
    assert ax.get_aspect() == 1 and "[m]" in ax.get_xlabel()
    (bar,) = (artist for artist in ax.artists if hasattr(artist, "size_bar"))
    length, text = bar.size_bar.get_children()[0].get_width(), bar.txt_label.get_text()
    assert length == pytest.approx(0.1 * float(text.removesuffix(" m/s")))


def test_velocity_areas_need_as_many_places(cone):
    area = velocity_area(cone, np.array([[0, 0, HEIGHT]]), headings(8))
    with pytest.raises(ValueError, match=r"areas are those of \(1,\) CoM positions \(expected \(2,\)\)"):
        plotting.velocity_areas(area, np.zeros((2, 2)))


# maps


def field(values, name="margin", dims=("com_x", "com_y"), **other):
    """A map with one field, (n, m), over x from -1 to 1 and y from 0 to 1."""
    values = np.asarray(values)
    ends = {"com_x": (-1, 1), "com_y": (0, 1), "heading": (0, 5), "speed": (0, 2)}
    units = {"com_x": "m", "com_y": "m", "heading": "rad", "speed": "m/s"}
    about = lambda dim: {"units": units[dim], "long_name": dim.replace("com_", "CoM ")}
    grids = {dim: (dim, np.linspace(*ends[dim], n), about(dim)) for dim, n in zip(dims, values.shape, strict=True)}
    fields = {name: (dims, values, {"units": "m/s"})} | {key: (dims, value) for key, value in other.items()}
    return xr.Dataset(fields, coords={**grids, "com_z": ((), 0.8, {"units": "m"})})


def sliced(values, name="margin", **other):
    """The picture of such a map over its first two axes."""
    return plotting.kernel_slice(field(values, name), name, **other)


def zero_level(ax):
    """Points (n, 2) of the thick line."""
    thick = [found for found in ax.collections if np.size(found.get_linewidth()) and np.max(found.get_linewidth()) > 2]
    return np.concatenate([path.vertices for found in thick for path in found.get_paths()] or [np.zeros((0, 2))])


X, Y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(0, 1, 11), indexing="ij")


def test_the_zero_level_of_a_margin_is_where_it_vanishes():
    ax = sliced(X - 0.73 * Y + 0.1)
    level = zero_level(ax)
    assert len(level) > 10
    np.testing.assert_allclose(level[:, 0] - 0.73 * level[:, 1] + 0.1, 0, atol=1e-12)
    assert (np.abs(level[:, 1][[0, -1]] - [0, 1]) < 1e-9).all() or (np.abs(level[:, 1][[0, -1]] - [1, 0]) < 1e-9).all()


def test_the_filled_contours_are_the_field_at_the_grid_points():
    ax = sliced(X * Y, levels=[-1, -0.3, 0, 0.3, 1])
    filled = next(found for found in ax.collections if found.get_zorder() == 2)
    np.testing.assert_array_equal(filled.levels, [-1, -0.3, 0, 0.3, 1])
    np.testing.assert_array_equal(np.asarray(filled.zmax), 1)
    for low, path in zip(filled.levels, filled.get_paths(), strict=False):
        for x, y in ((-0.55, 0.85), (0.72, 0.33), (0.15, 0.15), (-0.93, 0.95)):
            inside = low < x * y < low + np.diff(filled.levels)[list(filled.levels).index(low)]
            assert path.contains_point((x, y)) == inside


def test_the_zero_level_of_a_field_that_is_nowhere_negative_is_straight_and_in_its_cell():
    """A linear field cut at zero: found to rounding. A jump: in the middle between the grid points."""
    level = zero_level(sliced(np.maximum(0, X - 0.33), "max_speed"))
    np.testing.assert_allclose(level[:, 0], 0.33, atol=1e-12)
    for jump in (2.0, np.inf):
        level = zero_level(sliced(np.where(X > 0.31, jump, 0), "max_speed"))
        np.testing.assert_allclose(level[:, 0], 0.35, atol=1e-12)


def test_infinite_figures_and_those_that_are_none_are_told_apart():
    values = np.where(X > 0.8, np.inf, np.where(X < -0.8, np.nan, 1 + X))
    ax = sliced(values, "max_speed")
    assert legend(ax) == ["at any speed", "no value"]
    assert sorted(hatch for found in ax.collections for hatch in found.hatches if found.hatches and hatch) == ["..", "//"]
    ax = sliced(values, "distance")
    assert "no stop" in legend(ax)
    status = np.where(Y > 0.5, Status.MAX_STEPS, Status.NO_DIRECTION).astype(np.int8)
    assert legend(plotting.kernel_slice(field(values, status=status), "margin")) == ["at any speed", "undecided", "at rest"]
    speeds = field(np.where(X < -0.9, np.nan, X), dims=("speed", "com_x"))  # speed 0 is the first row
    assert legend(plotting.kernel_slice(speeds, "margin", x="com_x", y="speed"))[0] == "at rest"
    both = field(values, "max_speed").assign(speeds.rename(com_x="other"))  # a field beside one that has speeds
    assert legend(plotting.kernel_slice(both, "max_speed")) == ["at any speed", "no value"]


def test_a_field_without_any_number_is_drawn():
    for value in (np.nan, np.inf, 0.0, 1.0):
        drawn(sliced(np.full(X.shape, value), "max_speed"))


def test_a_slice_has_names_units_and_tells_where_it_is():
    dataset = field(X[..., None] * np.arange(4), dims=("com_x", "com_y", "speed"))
    ax = plotting.kernel_slice(dataset, "margin", speed=1.3)
    assert [ax.get_xlabel(), ax.get_ylabel()] == ["CoM position x [m]", "CoM position y [m]"] and ax.get_aspect() == 1
    assert ax.get_title() == "com_z = 0.8 m, speed = 1.33 m/s"
    assert [child.get_ylabel() for child in ax.child_axes] == ["margin [m/s]"]
    ax = plotting.kernel_slice(dataset, "margin", x="speed", y="com_x", com_y=0.5)
    assert [ax.get_xlabel(), ax.get_ylabel()] == ["CoM speed [m/s]", "CoM position x [m]"] and ax.get_aspect() == "auto"
    assert ax.get_xlim() == (0, 2) and ax.get_ylim() == (-1, 1)


@pytest.mark.parametrize("width", [0.1, 0.2, 0.8])
def test_a_slice_of_a_few_centimetres_has_numbers_that_stand_apart(width):
    """By a figure's width at least, in a picture of the size that `jaxcap plot` makes."""
    axis = lambda name, n: (name, np.linspace(-width / 2, width / 2, n), {"units": "m"})
    dataset = field(X).assign_coords(com_x=axis("com_x", X.shape[0]), com_y=axis("com_y", X.shape[1]))
    figure = Figure(figsize=(7.0, 5.0), layout="compressed")
    ax = plotting.kernel_slice(dataset, "margin", ax=figure.subplots())
    FigureCanvasAgg(figure).draw()
    low, high = ax.get_xlim()
    ticks = [tick for tick in ax.xaxis.get_major_ticks() if low <= tick.get_loc() <= high]
    boxes = [tick.label1.get_window_extent() for tick in ticks]
    digit = boxes[0].width / len(ticks[0].label1.get_text())
    assert len(boxes) > 1 and all(one.x1 + digit < other.x0 for one, other in pairwise(boxes))


@pytest.mark.parametrize("quantity", CODES)
def test_codes_are_told_apart_in_grey(quantity):
    """CIE lightness, of 100."""
    linear = np.array([to_rgb(colour) for _, colour in CODES[quantity].values()])
    linear = np.where(linear > 0.04045, ((linear + 0.055) / 1.055) ** 2.4, linear / 12.92)
    lightness = 116 * np.cbrt(linear @ [0.2126, 0.7152, 0.0722]) - 16
    assert np.diff(np.sort(lightness)).min() > 6


def test_codes_are_areas_of_colour_with_names():
    codes = np.where(X > 0, Case.C3_1, np.where(Y > 0.5, Case.C1, Case.EMPTY)).astype(np.int8)
    ax = sliced(codes, "case")
    assert legend(ax) == ["C1: diverges", "C3_1: stops where it can stand", "EMPTY: no contact or nowhere to stand"]
    mesh = ax.collections[0]
    np.testing.assert_array_equal(np.asarray(mesh.get_array()).reshape(11, 21), codes.T)
    shown = {to_hex(colour) for colour in mesh.cmap(mesh.norm(np.unique(codes)))}
    assert shown == {to_hex(patch.get_facecolor()) for patch in ax.get_legend().get_patches()} and len(shown) == 3
    assert legend(sliced(X > 0, "capturable")) == ["falls, or has to step", "capturable"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"quantity": "max_speed"}, r"'max_speed' is not in the map \(it holds margin\)"),
        ({"y": "heading"}, r"'heading' is not an axis of margin \(expected one of com_x, com_y, speed\)"),
        ({"x": "com_y"}, "com_y is asked for twice"),
        ({}, r"no value for the axis speed \(expected one from 0 to 2\)"),
        ({"speed": 3.0}, r"speed = 3 is not on the grid \(expected from 0 to 2\)"),
        ({"speed": 1.0, "com_x": 0.0}, "com_x is an axis of the picture"),
    ],
)
def test_what_a_map_does_not_hold_is_refused(arguments, message):
    dataset = field(X[..., None] * np.arange(4), dims=("com_x", "com_y", "speed"))
    with pytest.raises(ValueError, match=message):
        plotting.kernel_slice(dataset, **{"quantity": "margin"} | arguments)


def test_a_plane_needs_two_points_along_each_axis():
    with pytest.raises(ValueError, match=r"com_y has 1 grid point \(expected at least 2\)"):
        plotting.kernel_slice(field(X[:, :1]), "margin")


def test_the_weakest_heading_decides_and_an_unknown_one_leaves_no_figure():
    values = np.stack([X + 2, Y + 1, 3 + 0 * X], axis=-1)
    values[0, 0, 2] = np.nan
    least = plotting.weakest(field(values, "max_speed", ("com_x", "com_y", "heading")))["weakest"].values
    np.testing.assert_array_equal(np.isnan(least), (X == -1) & (Y == 0))
    np.testing.assert_array_equal(least[1:], np.minimum(X + 2, Y + 1)[1:])


def test_areas_of_a_map_are_those_of_its_headings(cone):
    angles = np.linspace(0, 5, 7)
    com_x, com_y = np.linspace(-1, 1, 21), np.linspace(0, 1, 11)
    directions = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    values = 1 + np.arange(7) + X[..., None]
    ax = plotting.map_areas(field(values, "max_speed", ("com_x", "com_y", "heading")), places=2)
    dots = np.column_stack(ax.lines[-2].get_data())
    assert len(dots) == 4 and np.isin(dots[:, 0], com_x).all() and np.isin(dots[:, 1], com_y).all()
    scale = np.linalg.norm(ax.patches[0].get_path().vertices[0] - dots[0]) / (1 + dots[0, 0])
    for patch, dot in zip(ax.patches[:4], dots, strict=True):
        expected = dot + scale * (1 + np.arange(7) + dot[0])[:, None] * directions[:, :2]
        np.testing.assert_allclose(patch.get_path().vertices[:7], expected, rtol=1e-12)
    with pytest.raises(ValueError, match="'heading' is not an axis of the map"):
        plotting.map_areas(field(X, "max_speed"))


# whatever the contacts


@pytest.mark.parametrize("name", CONTACTS)
def test_every_contact_set_is_drawn(name):
    """Without an error or a warning, which the tests take for one."""
    contacts = CONTACTS[name]
    active = contacts.points[contacts.mask]
    com, velocity = active.mean(axis=0) + np.array([0.01, 0.02, 0.7]), np.array([0.3, 0.1, 0.0])
    cone = jaxcap.centroidal_cone(contacts)
    coms = com + np.array([[0.0, 0, 0], [0.1, 0, 0]])
    areas = velocity_area(cone, coms, headings(12))
    first = VelocityArea(areas.directions, *(one[0] for one in areas[1:]))
    pictures = [
        plotting.polygon(cone, com, velocity),
        plotting.phase_portrait(cone, com, velocity),
        plotting.stance(contacts, com, velocity),
        plotting.velocity_area(first),
        plotting.velocity_areas(areas, coms, ax=plotting.footprint(contacts)),
    ]
    for ax in pictures:
        assert len(drawn(ax)) > 1000
    (shown,) = (
        found
        for found in pictures[2].collections
        if isinstance(found, Poly3DCollection) and found.get_label() == "friction pyramids"
    )
    assert len(shown._faces) == 4 * len(active)


def test_no_contact_at_all_is_refused():
    none = jaxcap.ContactSet(np.zeros((2, 3)), UP, 0.5, mask=[False, False])
    with pytest.raises(ValueError, match="none of 2 is active"):
        plotting.stance(none)


# manners


def test_axes_that_are_given_are_drawn_into_and_returned(cone):
    figure = Figure()
    for draw in (
        lambda ax: plotting.polygon(cone, [0, 0, HEIGHT], [0.2, 0, 0], ax=ax),
        lambda ax: plotting.phase_portrait(cone, [0, 0, HEIGHT], [0.2, 0, 0], ax=ax),
        lambda ax: plotting.footprint(FEET, ax=ax),
        lambda ax: sliced(X, ax=ax, bar=False),
    ):
        ax = figure.add_subplot()
        assert draw(ax) is ax and ax.has_data()
    with pytest.raises(ValueError, match="projection 'rectilinear' \\(expected '3d'\\)"):
        plotting.stance(FEET, ax=figure.add_subplot())


def test_nothing_global_changes(cone):
    matplotlib.get_backend()  # which settles what the setting says
    before = matplotlib.rcParams.copy()
    plotting.polygon(cone, [0, 0, HEIGHT], [0.2, 0, 0])
    plotting.phase_portrait(cone, [0, 0, HEIGHT], [0.2, 0, 0])
    plotting.stance(FEET, [0, 0, HEIGHT])
    sliced(X)
    plotting.velocity_area(made([0] * 4, [1] * 4))
    assert matplotlib.rcParams == before
    assert plt.get_fignums() == []


WITHOUT = """
import sys
{forbidden}
try:
    import jaxcap.plotting
except ImportError as error:
    print(type(error).__name__, error)
print("matplotlib.pyplot" in sys.modules)
"""


def test_matplotlib_is_asked_for_by_name_and_pyplot_is_not_imported():
    run = lambda forbidden: subprocess.run(
        [sys.executable, "-c", WITHOUT.format(forbidden=forbidden)], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    assert run("") == ["False"]
    said, pyplot = run("sys.modules['matplotlib'] = None")
    assert said.startswith("MissingExtra drawing needs matplotlib")
    assert said.endswith('install it with: pip install "jaxcap[plots]"') and pyplot == "False"
