"""Robots by configuration: their rectangles lie where the meshes end, their limits are real, mistakes are named."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from processors import ROUNDS_AS_THEN

import reference.tsid
from reference.tsid.holding import effort
from reference.tsid.push import contact_jacobian, speed_bounds
from reference.tsid.robot import CONFIGURATIONS, EFFECTORS, configuration, load
from reference.tsid.sampling import draw
from reference.tsid.table import read

ROBOTS = sorted(path.stem for path in CONFIGURATIONS.glob("*.toml"))
DATA = Path(reference.tsid.__file__).parent / "data"


@pytest.fixture(scope="module", params=ROBOTS)
def robot(request):
    return load(request.param)


def vertices(robot, effector):
    """Of the shapes fixed to the effector's joint, in the rectangle's frame."""
    frame = robot.model.frames[effector.frame]
    rectangle = frame.placement * effector.placement
    found = []
    for shape in robot.collisions.geometryObjects:
        if shape.parentJoint == frame.parentJoint:
            place = rectangle.inverse() * shape.placement
            points = shape.geometry.vertices() if hasattr(shape.geometry, "vertices") else np.zeros((1, 3))
            low = getattr(shape.geometry, "radius", 0.0)
            found += [place.act(np.asarray(point)) - np.array([0, 0, low]) for point in points]
    return np.array(found)


def test_two_robots_ship():
    assert {"talos", "g1"} <= set(ROBOTS)


def test_talos_is_the_robot_of_the_campaign():
    robot = load("talos")
    assert (robot.model.nq, robot.model.nv) == (37, 36)
    assert pin.computeTotalMass(robot.model) == pytest.approx(90.3, abs=0.05)
    assert robot.torque.max() == 300 and robot.speed.min() == 1.0


def test_a_configuration_like_another_changes_what_it_names():
    talos, strong = load("talos"), load("talos_strong_arms")
    changed = {
        name for name, one, other in zip(talos.model.names[2:], talos.torque, strong.torque, strict=True) if one != other
    }
    assert changed == {f"arm_{side}_{joint}_joint" for side in ("left", "right") for joint in (1, 2, 3, 4)}
    assert set(strong.torque[talos.torque != strong.torque]) == {50.0}
    assert strong.name == "talos_strong_arms" and strong.effectors == talos.effectors
    np.testing.assert_array_equal(strong.home, talos.home)


@pytest.mark.parametrize(
    "line, message",
    [
        ("arm_left_9_joint = 50.0", "torque: 'arm_left_9_joint' is no joint of"),
        ("arm_left_1_joint = 0", "arm_left_1_joint = 0 "),
    ],
)
def test_wrong_torques_are_named(tmp_path, line, message):
    path = tmp_path / "mine.toml"
    path.write_text(f'like = "talos"\n[torque]\n{line}\n')
    with pytest.raises(ValueError, match=message):
        load(path)


def test_limits_and_home(robot):
    n = robot.model.nv - 6
    for values in (robot.lower, robot.upper, robot.speed, robot.torque):
        assert values.shape == (n,) and np.all(np.isfinite(values))
    assert np.all(robot.torque > 0) and np.all(robot.speed > 0)
    assert np.all(robot.lower <= robot.home[7:]) and np.all(robot.home[7:] <= robot.upper)
    assert pin.isNormalized(robot.model, robot.home)
    np.testing.assert_array_equal(robot.model.gravity.linear, [0, 0, -9.81])


def test_nothing_collides_at_home_and_arms_may_hit_legs(robot):
    data = robot.collisions.createData()
    assert not pin.computeCollisions(robot.model, robot.model.createData(), robot.collisions, data, robot.home, False)
    frames = [robot.model.frames[robot.effectors[name].frame].parentJoint for name in EFFECTORS]
    joints = {
        tuple(sorted(robot.collisions.geometryObjects[i].parentJoint for i in (pair.first, pair.second)))
        for pair in robot.collisions.collisionPairs
    }
    assert tuple(sorted((frames[0], frames[1]))) in joints and tuple(sorted((frames[0], frames[2]))) in joints
    for first, second in joints:
        assert robot.model.parents[second] != first and first != second


def test_effectors_are_rectangles_on_the_surface(robot):
    """Right-handed frames, normals upwards at the soles, mirrored left to right; nothing of the feet sticks out below."""
    assert tuple(robot.effectors) == EFFECTORS
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.home)
    at = {name: data.oMf[effector.frame] * effector.placement for name, effector in robot.effectors.items()}
    for name, effector in robot.effectors.items():
        assert np.linalg.det(at[name].rotation) == pytest.approx(1.0)
        assert 0.01 < effector.half_width <= effector.half_length < 0.15
        if name.endswith("foot"):
            assert at[name].rotation[2, 2] > 0.999
            assert vertices(robot, effector)[:, 2].min() > -1e-3
    for side in ("foot", "hand"):
        left, right = at[f"left_{side}"], at[f"right_{side}"]
        np.testing.assert_allclose(left.translation * [1, -1, 1], right.translation, atol=2e-3)
        np.testing.assert_allclose(left.rotation[:, 2] * [1, -1, 1], right.rotation[:, 2], atol=5e-3)


def test_talos_hands_touch_with_nothing_before_their_rectangle():
    robot = load("talos")
    for name in ("left_hand", "right_hand"):
        points = vertices(robot, robot.effectors[name])
        assert -1e-4 < points[:, 2].min() < 1e-3
        tips = points[points[:, 2] < 1e-3]
        assert np.abs(tips[:, :2]).max() > robot.effectors[name].half_width


def test_a_file_of_ones_own(tmp_path):
    text = configuration("talos").read_text()
    mine = tmp_path / "mine.toml"
    mine.write_text(text.replace("half_length = 0.105", "half_length = 0.09"))
    robot = load(mine)
    assert robot.name == "mine" and robot.effectors["left_foot"].half_length == 0.09


@pytest.mark.parametrize(
    "old, new, message",
    [
        ('home = "half_sitting"', 'home = "lying"', r"home = 'lying' \(expected one of: .*half_sitting"),
        ('frame = "left_sole_link"', 'frame = "hoof"', "effectors.left_foot.frame = 'hoof' is no frame of talos"),
        ("[effectors.left_foot]", "[effectors.nose]", "effectors.left_foot has nothing"),
        ("half_width = 0.065", "half_width = -1.0", r"left_foot.half_width = -1.0 \(expected a positive length\)"),
        ("along = [1.0, 0.0, 0.0]", "along = [0.0, 0.0, 2.0]", "left_foot.along = .* not parallel"),
        ('"gripper_left_joint"', '"wing"', "locked: 'wing' is no joint of talos"),
        ('packages = "."', 'pakages = "."', r"unknown keys \['pakages'\], missing keys \['packages'\]"),
        ("talos_reduced.urdf", "talus.urdf", "urdf = .*talus.urdf' is neither in"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, message):
    text = configuration("talos").read_text()
    assert old in text
    (tmp_path / "mine.toml").write_text(text.replace(old, new))
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        load(tmp_path / "mine.toml")


def test_unknown_robots_are_named():
    with pytest.raises(FileNotFoundError, match=r"robot 'atlas': no such file \(by name: g1, talos, talos_strong_arms\)"):
        load("atlas")


@pytest.mark.parametrize("file", ["two_coplanar_g1", "two_g1", "three_strong_arms", "four_strong_arms"])
def test_committed_rows_are_this_robots(file):
    """A file of another robot holds the postures that its configuration gives, and what they cost that robot's joints."""
    settings, _, rows = read(DATA / f"{file}.parquet")
    robot, row = load(settings["robot"]), rows[7]
    assert settings["robot"] in ("g1", "talos_strong_arms") and [one["index"] for one in rows] == list(range(len(rows)))
    sample = draw(robot, settings["scenario"], settings["seed"], row["index"])
    assert len(row["q"]) == robot.model.nq and len(row["v"]) == robot.model.nv
    np.testing.assert_allclose(sample.q, row["q"], atol=1e-6)
    velocity, names = np.array(row["v"]), [contact.effector for contact in sample.contacts]
    moving = contact_jacobian(robot, robot.model.createData(), sample.q, names) @ velocity
    np.testing.assert_allclose(moving, 0.0, atol=1e-5)
    least, greatest = speed_bounds(robot, sample.q)
    assert np.all((velocity[6:] >= least - 1e-5) & (velocity[6:] <= greatest + 1e-5))
    if ROUNDS_AS_THEN:
        np.testing.assert_allclose(sample.v, row["v"], atol=1e-5)
    assert row["effort"] == pytest.approx(effort(robot, sample.q, sample.contacts), rel=1e-5)
