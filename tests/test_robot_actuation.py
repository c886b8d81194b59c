"""Torque limits of a robot's postures: as Pinocchio has them, state by state."""

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")

import jaxcap  # noqa: E402
from jaxcap.errors import InputError  # noqa: E402
from jaxcap.robots import ANYMAL_FEET, TALOS_CONTACTS, actuation, anymal, joint_names, talos  # noqa: E402

FRAMES = [patch.frame for name, patch in TALOS_CONTACTS.items() if name != "right_hand" for _ in range(4)]


@pytest.fixture(scope="module")
def robot():
    return talos()


def postures(robot, n=5, seed=0):
    """(n, nq) around half sitting, base turned too."""
    rng = np.random.default_rng(seed)
    home = robot.postures["half_sitting"]
    return np.array([pin.integrate(robot.model, home, 0.4 * rng.normal(size=robot.model.nv)) for _ in range(n)])


def contacts_of(robot, q, frames=FRAMES):
    """Points near the frames."""
    rng, data, points = np.random.default_rng(1), robot.model.createData(), []
    for row in q:
        pin.framesForwardKinematics(robot.model, data, row)
        places = [data.oMf[robot.model.getFrameId(name)].translation for name in frames]
        points.append(np.array(places) + rng.uniform(-0.1, 0.1, (len(frames), 3)))
    return jaxcap.ContactSet(np.array(points), np.eye(3), np.full((len(q), len(frames)), 0.5))


def test_jacobians_torques_and_limits_are_pinocchios(robot):
    model, data, q = robot.model, robot.model.createData(), postures(robot)
    contacts = contacts_of(robot, q)
    found = actuation(model, q, contacts, FRAMES)
    above = {int(j) for name in FRAMES for j in model.supports[model.frames[model.getFrameId(name)].parentJoint] if j > 1}
    columns = [model.joints[joint].idx_v for joint in sorted(above)]
    mass = pin.computeTotalMass(model)
    assert found.joints == len(columns) == 21
    for i, row in enumerate(q):
        gravity = pin.computeGeneralizedGravity(model, data, row)
        np.testing.assert_allclose(found.gravity_torque[i], gravity[columns] / mass, atol=1e-12)
        pin.computeJointJacobians(model, data, row)
        pin.framesForwardKinematics(model, data, row)
        for k, name in enumerate(FRAMES):
            frame = model.getFrameId(name)
            at_frame = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            arm = contacts.points[i, k] - data.oMf[frame].translation
            expected = at_frame[:3] - pin.skew(arm) @ at_frame[3:]
            np.testing.assert_allclose(found.jacobians[i, k], expected[:, columns], atol=1e-12)
    np.testing.assert_allclose(found.limit, np.tile(model.upperEffortLimit[columns] / mass, (len(q), 1)))
    assert found.mask.all()


def test_only_joints_that_carry_a_contact_count(robot):
    """A hand that does not touch in one of two postures masks its arm there; in none, the arm is left out."""
    q = postures(robot, 2)
    contacts, lifted = contacts_of(robot, q), np.ones((2, 12), bool)
    lifted[0, 8:] = False
    some = jaxcap.ContactSet(contacts.points, contacts.frames, contacts.friction, lifted)
    found = actuation(robot.model, q, some, FRAMES)
    assert found.joints == 21 and found.mask.sum(axis=1).tolist() == [12, 21]
    none = jaxcap.ContactSet(contacts.points, contacts.frames, contacts.friction, lifted[[0, 0]])
    assert actuation(robot.model, q, none, FRAMES).joints == 12


def test_one_posture_and_patches_by_name(robot):
    q = postures(robot, 1)[0]
    frames = [patch.frame for patch in TALOS_CONTACTS.values() for _ in range(4)]
    contacts = contacts_of(robot, q[None], frames)
    one = jaxcap.ContactSet(contacts.points[0], contacts.frames[0], contacts.friction[0])
    found = actuation(robot.model, q, one, TALOS_CONTACTS)
    assert found.jacobians.shape == (16, 3, 28) and not found.batched
    many = actuation(robot.model, q[None], contacts, frames)
    np.testing.assert_array_equal(found.jacobians, many.jacobians[0])


def test_limits_that_are_missing_are_said_once_and_given_by_name():
    robot = anymal()
    model = robot.model.copy()
    model.upperEffortLimit = np.full(model.nv, np.inf)
    frames = [patch.frame for patch in ANYMAL_FEET.values()]
    q = pin.neutral(model)[None]
    contacts = contacts_of(robot, q, frames)
    with pytest.raises(InputError, match=r"LF_HAA.*unlimited=True"):
        actuation(model, q, contacts, frames)
    with pytest.warns(UserWarning, match="no effort limit for LF_HAA") as said:
        found = actuation(model, q, contacts, frames, unlimited=True)
    assert len(said) == 1 and not found.mask.any()
    limits = {name: 40.0 for name in list(model.names)[2:]}
    found = actuation(model, q, contacts, frames, limits=limits | {"LF_HAA": 0.0})
    assert found.mask.all() and found.limit.min() == 0
    with pytest.raises(InputError, match=r"limits\['LF_HAA'\] = -1"):
        actuation(model, q, contacts, frames, limits=limits | {"LF_HAA": -1.0})


def test_what_cannot_be_used_is_named(robot):
    q = postures(robot, 2)
    contacts = contacts_of(robot, q)
    with pytest.raises(InputError, match=r"frames\[0\] = 'toe' is no frame"):
        actuation(robot.model, q, contacts, ["toe"] * 12)
    with pytest.raises(ValueError, match=r"frames: 4 \(expected 12"):
        actuation(robot.model, q, contacts, FRAMES[:4])
    with pytest.raises(ValueError, match="contacts: 2 sets"):
        actuation(robot.model, postures(robot, 3), contacts, FRAMES)
    with pytest.raises(InputError, match="is no joint"):
        actuation(robot.model, q, contacts, FRAMES, limits={"knee": 1.0})


def test_names_are_those_of_the_columns(robot):
    """Of many postures, and of one whose hand does not touch."""
    q = postures(robot, 2)
    contacts = contacts_of(robot, q)
    feet = jaxcap.ContactSet(contacts.points[0], contacts.frames[0], contacts.friction[0], np.arange(12) < 8)
    for sets, row in ((contacts, q), (feet, q[0])):
        found, names = actuation(robot.model, row, sets, FRAMES), joint_names(robot.model, sets, FRAMES)
        columns = [robot.model.joints[robot.model.getJointId(name)].idx_v for name in names]
        known = robot.model.upperEffortLimit[columns] / pin.computeTotalMass(robot.model)
        np.testing.assert_allclose(np.broadcast_to(known, found.limit.shape), found.limit)
        assert any("arm" in name for name in names) == (sets is contacts)


def test_only_joints_that_are_wanted(robot):
    q = postures(robot, 2)
    contacts = contacts_of(robot, q)
    arm = [name for name in robot.model.names if "arm_left" in name]
    found, whole = (actuation(robot.model, q, contacts, FRAMES, joints=joints) for joints in (arm, None))
    assert found.joints == len(arm) == 7
    np.testing.assert_array_equal(found.jacobians, whole.jacobians[..., 14:])
    assert joint_names(robot.model, contacts, FRAMES, joints=arm) == arm
    with pytest.raises(InputError, match="joints: 'elbow' is no joint"):
        actuation(robot.model, q, contacts, FRAMES, joints=["elbow"])
    none = actuation(robot.model, q, contacts, FRAMES, joints=[])
    assert none.jacobians.shape == (*whole.jacobians.shape[:-1], 0) and none.limit.shape[-1] == 0
