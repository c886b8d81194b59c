"""What a touchdown does: laws of the plastic impact, and that bounds are relaxed only where a joint is beyond them."""

import numpy as np
import pinocchio as pin
import pytest

from reference.tsid.controller import CONFIGURATIONS, Controller
from reference.tsid.push import contact_jacobian
from reference.tsid.robot import load
from reference.tsid.sampling import draw, place
from reference.tsid.simulator import DEFAULT, Options, Simulator
from reference.tsid.touchdown import (
    HANDS,
    RelaxedController,
    TouchdownSimulator,
    beyond,
    facing,
    impact,
    joined,
    touchdown,
    wall_normals,
)

DECELERATION, DT = CONFIGURATIONS["standard"].deceleration, DEFAULT.dt
AT_REST = 1e-9
"""Of contacts after an impact [m/s, rad/s]."""


@pytest.fixture(scope="module")
def robot():
    return load("talos")


@pytest.fixture(scope="module")
def samples(robot):
    return [draw(robot, "two", 19, index) for index in range(4)]


@pytest.fixture(scope="module")
def landed(robot, samples):
    """Robots with a hand turned to a wall, and samples after touchdown: both hands, all walls."""
    found = []
    for number, sample in enumerate(samples):
        data = robot.model.createData()
        pin.centerOfMass(robot.model, data, sample.q, sample.v)
        for which, normal in enumerate(wall_normals(data.vcom[0])):
            hand = HANDS[(number + which) % 2]
            turned = facing(robot, sample.q, hand, normal)
            found.append((turned, sample, hand, normal, touchdown(turned, sample, sample.q, sample.v, hand)))
    return found


def energy(robot, q, v):
    return pin.computeKineticEnergy(robot.model, robot.model.createData(), q, v)


def effectors(sample):
    return [contact.effector for contact in sample.contacts]


def test_contacts_are_at_rest_after_it(landed):
    for robot, _, _, _, after in landed:
        jacobian = contact_jacobian(robot, robot.model.createData(), after.q, effectors(after))
        assert np.abs(jacobian @ after.v).max() < AT_REST


def test_kinetic_energy_never_grows(landed):
    for robot, before, _, _, after in landed:
        had, has = energy(robot, after.q, before.v), energy(robot, after.q, after.v)
        assert has < had
        # What is lost is the energy of the difference: the projection is orthogonal in the metric of the mass matrix.
        np.testing.assert_allclose(had - has, energy(robot, after.q, before.v - after.v), rtol=1e-9)


def test_a_second_impact_changes_nothing(landed):
    for robot, _, _, _, after in landed:
        np.testing.assert_allclose(impact(robot, after.q, after.v, effectors(after)), after.v, rtol=0, atol=AT_REST)


def test_a_contact_that_is_there_already_changes_nothing(landed):
    """Alone, and among the constraints, where its rows make the Jacobian lose rank."""
    for robot, _, hand, _, after in landed:
        again = touchdown(robot, after, after.q, after.v, hand)
        assert again.contacts == after.contacts
        np.testing.assert_allclose(again.v, after.v, rtol=0, atol=AT_REST)
        twice = impact(robot, after.q, after.v + 0.1, [*effectors(after), hand])
        np.testing.assert_allclose(twice, impact(robot, after.q, after.v + 0.1, effectors(after)), rtol=0, atol=1e-8)


def test_an_effector_cannot_touch_at_two_places(landed):
    _, _, hand, _, after = landed[0]
    moved = after.contacts[-1]._replace(placement=pin.SE3(np.eye(3), np.zeros(3)))
    with pytest.raises(ValueError, match=f"{hand} touches at"):
        joined(after.contacts, moved)


def test_the_hand_faces_the_wall_where_it_is(robot, landed):
    for turned, before, hand, normal, after in landed:
        own = place(robot, robot.model.createData(), before.q, [hand])[0]
        contact = after.contacts[-1]
        np.testing.assert_allclose(contact.placement.rotation[:, 2], normal, atol=1e-12)
        np.testing.assert_allclose(contact.placement.translation, own.placement.translation, atol=1e-12)
        np.testing.assert_allclose(contact.placement.rotation.T @ contact.placement.rotation, np.eye(3), atol=1e-12)
        assert turned.effectors[hand].half_length == robot.effectors[hand].half_length


def test_walls_stand_upright_against_the_velocity():
    for velocity in np.random.default_rng(3).normal(size=(20, 3)):
        normals = wall_normals(velocity)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
        assert np.all(normals[:, 2] == 0) and np.all(normals @ velocity < 0)
    assert np.isfinite(wall_normals(np.zeros(3))).all()


def test_without_a_joint_beyond_its_bounds_none_is_relaxed(robot, samples):
    """Pushes are viable: the QP is the controller's, to the bit, and so is the run."""
    for sample in samples:
        assert not beyond(robot, sample.q, sample.v, DECELERATION, DT).any()
        configuration = CONFIGURATIONS["standard"]
        relaxed, plain = (kind(robot, configuration, sample, DT) for kind in (RelaxedController, Controller))
        assert not relaxed.relaxed.any()
        for one, other in zip(relaxed.problem_at(sample.q, sample.v), plain.problem_at(sample.q, sample.v), strict=True):
            np.testing.assert_array_equal(one, other)
        options = Options(time_limit=0.05)
        runs = [kind(robot, configuration, options).run(sample) for kind in (TouchdownSimulator, Simulator)]
        assert runs[0].outcome == runs[1].outcome and runs[0].steps == runs[1].steps
        np.testing.assert_array_equal(runs[0].com_end, runs[1].com_end)


def test_only_joints_beyond_their_bounds_are_relaxed_and_only_until_they_are_viable(landed):
    seen = 0
    for robot, _, _, _, after in landed:
        side = beyond(robot, after.q, after.v, DECELERATION, DT)
        seen += np.count_nonzero(side)
        configuration, n = CONFIGURATIONS["standard"], len(side)
        relaxed, plain = (kind(robot, configuration, after, DT) for kind in (RelaxedController, Controller))
        one, other = (controller.problem_at(after.q, after.v) for controller in (relaxed, plain))
        changed = (one.lower != other.lower) | (one.upper != other.upper)
        np.testing.assert_array_equal(changed, np.concatenate([side != 0, np.zeros(len(changed) - n, bool)]))
        # They need not brake at one rate, and must not get faster.
        towards = np.where(side > 0, one.upper[:n], -one.lower[:n])[side != 0]
        assert np.all(towards == 0) and np.all(np.isinf(np.where(side > 0, one.lower[:n], one.upper[:n])[side != 0]))
        calm = relaxed.problem_at(after.q, 0 * after.v)
        np.testing.assert_array_equal(calm.lower, plain.problem_at(after.q, 0 * after.v).lower)
        assert not relaxed.relaxed.any()
        again = relaxed.problem_at(after.q, after.v)  # beyond anew, which is no touchdown's doing
        np.testing.assert_array_equal(again.lower, plain.problem_at(after.q, after.v).lower)
    assert seen > 0
