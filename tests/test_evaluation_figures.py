"""Figures 2, 3, 7, 8 and the failures: laws of what is drawn, on states that are made here or simulated in a moment."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from reference.algorithm import is_state_capturable
from reference.evaluation import failures, path_figure, polygon_figure, replay, time_figure, tree_figure
from reference.evaluation.__main__ import DATA
from reference.evaluation.samples import BEST, FOUR, Contacts, Runs, Samples, read
from reference.tsid.robot import load
from reference.tsid.sampling import draw

TALOS = load("talos")


def samples_of(scenario, indices, outcomes):
    """Samples as `read` gives them, drawn here; every controller has the same outcome."""
    drawn = [draw(TALOS, scenario, 2018, index) for index in indices]
    data = TALOS.model.createData()
    centres = []
    for sample in drawn:
        momentum = pin.computeCentroidalMomentum(TALOS.model, data, sample.q, sample.v)
        centres.append((data.com[0].copy(), data.vcom[0].copy(), momentum.angular.copy()))
    com, com_velocity, angular = (np.array(values) for values in zip(*centres, strict=True))
    column = lambda get: np.array([[get(contact) for contact in sample.contacts] for sample in drawn])
    contacts = Contacts(
        column(lambda contact: contact.effector),
        column(lambda contact: contact.placement.translation),
        column(lambda contact: contact.placement.rotation),
        *(column(lambda contact, name=name: getattr(contact, name)) for name in ("half_length", "half_width", "friction")),
    )
    outcomes = np.array(outcomes)
    runs = Runs(outcomes, outcomes, np.zeros(len(drawn)))
    q, v = (np.array([getattr(sample, name) for sample in drawn]) for name in ("q", "v"))
    names = ("standard", "straight", "fast")
    states = (np.array(indices), q, v, com, com_velocity, angular)
    effort = np.ones(len(drawn))
    best = {BEST: outcomes, FOUR: outcomes}
    return Samples(
        scenario, scenario, "talos", 2018, False, names, *states, contacts, effort, best, dict.fromkeys(names, runs), 0
    )


@pytest.fixture(scope="module")
def three():
    return samples_of("three", [5, 19], ["stopped", "fallen"])


def line_of(samples, row):
    points, frames, friction = polygon_figure.corners(samples.contacts)
    return polygon_figure.line_of(points[row], frames[row], friction[row], samples.com[row], samples.com_velocity[row])


# Fig. 2


@pytest.mark.parametrize("row", [0, 1])
def test_the_speed_on_the_lower_boundary_is_that_of_the_closed_forms(three, row):
    line = line_of(three, row)
    walked = np.linspace(0, line.result.alpha_final, 20001)
    left = polygon_figure.speeds(walked, polygon_figure.boundaries(line.rows, walked)[0], line.speed)
    assert line.result.case == ("C3_1", "C1")[row]
    assert left[-1] == pytest.approx(line.result.alphadot_final, abs=5e-3)  # a square root at rest
    assert np.all(np.diff(left) <= 0)


@pytest.mark.parametrize("row", [0, 1])
def test_zero_acceleration_is_feasible_in_the_static_region_only(three, row):
    line = line_of(three, row)
    inward = np.array([1e-6, -1e-6])
    inside, outside = line.static + inward, line.static - inward
    for places, holds in ((inside, True), (outside, False)):
        lower, upper = polygon_figure.boundaries(line.rows, places)
        assert (np.all((lower <= 0) & (upper >= 0))) == holds


def test_boundaries_of_a_triangle():
    rows = (np.array([-1.0, 1.0, 0.0]), np.array([0.0, 1.0, -1.0]), np.array([1.0, 2.0, 1.0]))  # acc in [-1, 2 - alpha]
    lower, upper = polygon_figure.boundaries(rows, np.array([-1.5, -1.0, 0.0, 3.0, 3.5]))
    assert np.array_equal(lower, [np.nan, -1, -1, -1, np.nan], equal_nan=True)
    assert np.array_equal(upper, [np.nan, 3, 2, -1, np.nan], equal_nan=True)


def test_the_empty_polygon_has_no_boundaries():
    assert np.isnan(polygon_figure.boundaries(None, np.zeros(3))).all()


def test_a_state_without_contacts_to_hold_it_is_drawn():
    line = polygon_figure.line_of(np.zeros((1, 3)), np.eye(3)[None], np.array([0.5]), (5.0, 0.0, 1.0), (0.0, 1.0, 0.0))
    assert line.rows is None and line.static is None and line.result.case == "C2"
    polygon_figure.drawn({"one point, far away": line}).draw_without_rendering()


def test_one_contact_point_is_a_polygon_without_width():
    line = polygon_figure.line_of(np.zeros((1, 3)), np.eye(3)[None], np.array([0.5]), (-0.1, 0.0, 1.0), (0.2, 0.0, 0.0))
    lower, upper = polygon_figure.boundaries(line.rows, np.array([0.0, 0.1, 0.2]))
    assert lower == pytest.approx(9.81 * np.array([-0.1, 0.0, 0.1]), abs=1e-5) and upper == pytest.approx(lower, abs=1e-5)
    polygon_figure.drawn({"one point": line}).draw_without_rendering()


def test_opposing_palms_are_drawn():
    frames = Rotation.from_rotvec([[0, np.pi / 2, 0], [0, -np.pi / 2, 0]]).as_matrix()  # normals towards each other
    corners = np.array([(0, y, z) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])
    beside = np.array([0.4, 0, 0])
    points = np.concatenate([corners - beside, corners + beside])
    state = (points, np.repeat(frames, 4, axis=0), np.full(8, 0.9), (0.0, 0.0, 0.0), (0.5, 0.0, 0.0))
    line = polygon_figure.line_of(*state)
    assert line.result.capturable and line.result.alpha_final == 0.0  # it can stop at once
    polygon_figure.drawn({"opposing palms": line}).draw_without_rendering()


# Fig. 3


def test_the_leaves_hold_every_state_once():
    random = np.random.default_rng(3)
    cases = random.choice(list(tree_figure.LEAVES), 200)
    outcomes = random.choice(["fallen", "stopped", "undecided"], 200)
    counts = tree_figure.counted(cases, outcomes)
    assert sum(leaf.states for leaf in counts.values()) == 200
    assert sum(leaf.states / 200 for leaf in counts.values()) == pytest.approx(1.0)
    assert sum(leaf.fell for leaf in counts.values()) == (outcomes == "fallen").sum()
    assert all(leaf.fell + leaf.stopped <= leaf.states for leaf in counts.values())
    tree_figure.drawn({"random": counts}).draw_without_rendering()


def test_an_empty_leaf_is_no_share_of_nothing():
    counts = tree_figure.counted(np.array(["C1", "C1"]), np.array(["undecided", "undecided"]))
    text = tree_figure.described({"two": counts})
    assert "100.0% (-)" in text and "nan" not in text
    tree_figure.drawn({"two": counts}).draw_without_rendering()


def test_a_case_that_is_no_leaf_is_named():
    with pytest.raises(ValueError, match="UNDECIDED"):
        tree_figure.counted(np.array(["C1", "UNDECIDED"]), np.array(["fallen", "fallen"]))


# Fig. 7

PATH = np.random.default_rng(7).normal(size=(30, 3)).cumsum(axis=0)


@pytest.mark.parametrize("velocity", [(0.3, -0.2, 0.1), (1.0, 0, 0), (-1.0, 0, 0), (0, 1.0, 0), (0, -2.0, 0), (0, 0, 1.0)])
def test_the_prediction_itself_is_the_unit_segment(velocity):
    velocity = np.array(velocity)
    path = np.array([1.0, 2.0, 3.0]) + np.linspace(0, 0.4, 5)[:, None] * velocity / np.linalg.norm(velocity)
    expected = np.stack([np.linspace(0, 1, 5), np.zeros(5), np.zeros(5)], axis=1)
    assert path_figure.onto_prediction(path, velocity, 0.4) == pytest.approx(expected, abs=1e-12)


def test_paths_do_not_depend_on_place_and_unit():
    velocity = np.array([0.3, -0.2, 0.1])
    path = path_figure.onto_prediction(PATH, velocity, 0.5)
    assert path_figure.onto_prediction(3 * PATH + [1.0, 2.0, 3.0], 7 * velocity, 1.5) == pytest.approx(path)


def test_paths_keep_their_shape_under_rotation():
    velocity = np.array([0.3, -0.2, 0.1])
    rotation = Rotation.from_rotvec([0.4, 1.1, -0.7]).as_matrix()
    path = path_figure.onto_prediction(PATH, velocity, 0.5)
    other = path_figure.onto_prediction(PATH @ rotation.T, rotation @ velocity, 0.5)
    assert other[:, 0] == pytest.approx(path[:, 0])
    assert np.linalg.norm(other[:, 1:], axis=1) == pytest.approx(np.linalg.norm(path[:, 1:], axis=1))
    aside = path_figure.onto_prediction(PATH, velocity, 1.0)
    assert np.linalg.norm(aside, axis=1) == pytest.approx(np.linalg.norm(PATH - PATH[0], axis=1))


def test_z_points_up_and_is_orthogonal_to_the_worlds_y_axis():
    for velocity in np.random.default_rng(8).normal(size=(20, 3)):
        axes = path_figure.onto_prediction(np.concatenate([np.zeros((1, 3)), np.eye(3)]), velocity, 1.0)[
            1:
        ].T  # rows: x, y, z
        assert axes @ axes.T == pytest.approx(np.eye(3)) and np.linalg.det(axes) == pytest.approx(1.0)
        assert axes[2, 2] >= 0 and axes[2, 1] == pytest.approx(0.0, abs=1e-12)


def test_no_velocity_has_no_predicted_length():
    contacts = (np.zeros((1, 3)), np.eye(3)[None], np.array([0.5]))
    assert path_figure.predicted_length(*contacts, np.array([0.0, 0.0, 1.0]), np.zeros(3)) == 0.0


def test_a_side_without_paths_is_drawn_and_described():
    none, one = path_figure.Side([], 0, 0, 0), path_figure.Side([PATH], 1, 0, 0)
    found = {"four": dict(zip(path_figure.SIDES, (one, none), strict=True))}
    told = path_figure.described(found)
    assert "nan" not in told and "| four | predicted to fall | 0 | 0 | 0 | 0 | - | - | - |" in told
    path_figure.drawn(found).draw_without_rendering()


def test_a_replay_starts_in_the_sample_and_is_laid_onto_its_prediction():
    # A row of the file, not a draw: which push is drawn depends on how the processor rounds (`reference/tsid/push.py`).
    two = read(DATA / "two.parquet", 9)
    chosen = (two.outcomes[BEST] == "stopped") & (np.linalg.norm(two.com_velocity, axis=1) > 0.1)
    row = np.arange(len(chosen)) == np.flatnonzero(chosen)[0]
    column = path_figure.sides(two, row, 1)[path_figure.SIDES[0]]
    (path,) = column.paths
    assert column.cells == 1 and column.short == 0 and column.changed == 0
    assert path[0] == pytest.approx(np.zeros(3)) and path[1, 0] > 0
    assert np.abs(path[1, 1:]).max() < 0.05 * path[1, 0]  # it sets out along its velocity


@pytest.mark.parametrize("held", [True, False])
def test_a_sample_is_restored_from_its_row(three, held):
    file = three if held else three._replace(q=np.full_like(three.q, np.nan), v=np.full_like(three.v, np.nan))
    sample, again = draw(TALOS, "three", 2018, 19), replay.sample_of(file, 1, TALOS)
    assert np.array_equal(sample.q, again.q) and np.array_equal(sample.v, again.v)
    for one, other in zip(sample.contacts, again.contacts, strict=True):
        assert one.placement == other.placement
        assert one._replace(placement=None) == other._replace(placement=None)


# Fig. 8


@pytest.mark.parametrize("seconds", [[0.3], [0.2, 0.2], [0.5, 0.1, 0.3, 0.1]])
def test_a_cumulative_histogram_rises_from_zero_to_one(seconds):
    times, shares = time_figure.cumulative(np.array(seconds))
    assert shares[0] == 0.0 and shares[-1] == 1.0
    assert np.all(np.diff(shares) > 0) and np.all(np.diff(times) >= 0)
    assert times[0] == min(seconds) and times[-1] == max(seconds)


@pytest.mark.parametrize("predict", [time_figure.algorithm_1, time_figure.capture_point_reach])
def test_times_of_single_states_are_measured(three, predict):
    seconds = time_figure.single_times(three, predict)
    assert len(seconds) == 1 and 0 < seconds[0] < 60  # the first call is not counted


def test_times_are_told_and_drawn():
    measured = {"three": time_figure.Times(np.array([1e-3, 3e-3]), np.array([5e-4]), 2e-5, 1e-6)}
    told = time_figure.described(measured)
    assert "| three | 2 | 2.00 | 2.90 | 3.00 | 0.50 | 0.50 | 0.50 | 20.00 | 1.00 |" in told
    time_figure.drawn(measured).draw_without_rendering()


@pytest.mark.parametrize("speed", [0.1, 1.0, 4.0])
def test_the_capture_point_reaches_the_edge_of_a_level_sole(speed):
    points, frames = np.array([[x, y, 0.2] for x in (-0.1, 0.1) for y in (-0.05, 0.05)]), np.tile(np.eye(3), (4, 1, 1))
    com, velocity = np.array([0.0, 0.0, 1.01]), np.array([speed, 0.0, 0.3])
    found = time_figure.capture_point_reach(points, frames, np.full(4, 0.5), com, velocity)
    assert found == pytest.approx(0.1 - speed * np.sqrt(0.81 / 9.81), abs=1e-9)  # (14), of a CoM 0.81 m above the sole


def test_the_capture_point_is_not_known_below_ground_or_beside_the_polygon():
    points, frames = np.array([[x, y, 0.2] for x in (-0.1, 0.1) for y in (-0.05, 0.05)]), np.tile(np.eye(3), (4, 1, 1))
    reach = lambda com: time_figure.capture_point_reach(
        points, frames, np.full(4, 0.5), np.array(com), np.array([0.1, 0, 0])
    )
    assert np.isnan(reach([0.0, 0.0, 0.1])) and np.isnan(reach([0.0, 0.3, 1.0])) and not np.isnan(reach([0.3, 0.0, 1.0]))


# Failures


def test_the_cells_hold_every_decided_sample_once():
    outcomes = np.array(["fallen", "fallen", "stopped", "stopped", "undecided"])
    where = failures.cells(outcomes, np.array([True, False, True, False, True]))
    assert {name: np.flatnonzero(members).tolist() for name, members in where.items()} == {
        "right": [2], "missed": [0], "false": [3], "detected": [1],
    }  # fmt: skip


def test_braking_stops_a_joint_at_its_limit():
    position, velocity = np.array([[0.5, 0.0, 0.9]]), np.array([[1.0, -2.0, -0.1]])
    lower, upper = np.array([-1.0, -0.5, -1.0]), np.ones(3)
    (needed,) = failures.braking(position, velocity, lower, upper)
    assert needed == 4.0 and 0.0 - 2.0**2 / (2 * needed) == -0.5  # the second joint is the nearest
    assert failures.braking(position, 0 * velocity, lower, upper) == 0.0
    assert failures.braking(upper[None], velocity, lower, upper) == np.inf  # at its limit, and moving on


def found_of(random, sizes):
    """Cells of these sizes with random features; missed falls have more speed, by construction."""
    labels = np.repeat(list(failures.CELLS), sizes)
    values = {name: random.uniform(size=len(labels)) for name in failures.FEATURES}
    values["speed"] = values["speed"] + (labels == "missed")
    return failures.Found({name: labels == name for name in failures.CELLS}, values, labels == "detected")


def test_a_contrast_is_the_share_of_ordered_pairs():
    found = found_of(np.random.default_rng(9), (20, 10, 5, 8))
    more, less = (found.values["momentum"][found.where[name]] for name in ("false", "detected"))
    assert failures.contrast(found, "false", "momentum").value == pytest.approx(np.mean(more[:, None] > less))
    assert failures.contrast(found, "missed", "speed").value == 1.0
    assert "more CoM speed (100.0" in failures.believe({"two": found})


def test_cells_without_samples_are_drawn_and_described():
    found = {
        "none": found_of(np.random.default_rng(9), (3, 0, 0, 0)),
        "all": found_of(np.random.default_rng(9), (3, 2, 1, 2)),
    }
    text = failures.medians(found) + failures.contrasts(found) + failures.believe(found)
    assert "nan" not in text
    failures.drawn(found).draw_without_rendering()


def test_features_of_every_sample(three):
    found = failures.find(three, np.array([True, True]))
    assert {name: members.sum() for name, members in found.where.items()} == dict(right=1, missed=1, false=0, detected=0)
    assert found.values["speed"] == pytest.approx(np.linalg.norm(three.com_velocity, axis=1))
    assert np.all(np.isfinite(np.stack(list(found.values.values()))))
    assert np.all(found.values["braking"] <= 10.0 * (1 + 1e-3))  # what the sampling allows, speeds rounded
    assert found.at_once.tolist() == [False, True]


def test_the_reference_says_of_these_samples_what_the_tests_assume(three):
    points, frames, friction = polygon_figure.corners(three.contacts)
    states = zip(points, frames, friction, three.com, three.com_velocity, strict=True)
    assert [is_state_capturable(*state).capturable for state in states] == [True, False]
