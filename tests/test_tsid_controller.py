"""The reduced QP is (30): same feasible set, same optimum, whatever the robot and its contacts."""

import numpy as np
import pinocchio as pin
import pytest
from proxsuite import proxqp

from reference.tsid.assembly import REGULARISATION
from reference.tsid.controller import CONFIGURATIONS, Configuration, Controller
from reference.tsid.push import contact_jacobian
from reference.tsid.robot import load
from reference.tsid.sampling import draw
from reference.tsid.solvers import Daqp, Status
from reference.tsid.tasks import COM_WEIGHT, POSTURE_DAMPING, POSTURE_STIFFNESS

DT = 1e-3
STIFFNESS, DAMPING = 100.0, 20.0


@pytest.fixture(scope="module", params=["talos", "g1"])
def robot(request):
    return load(request.param)


def moving(sample, share):
    """The sample with its velocity scaled, so that it is not at the edge of what can be stopped."""
    return sample._replace(v=share * sample.v)


def swaying(robot, sample, speed):
    """The sample with the joint velocity nearest to one that moves the CoM to its side [m/s]; nothing of it is drawn."""
    data = robot.model.createData()
    constraints = contact_jacobian(robot, data, sample.q, [contact.effector for contact in sample.contacts])
    free = np.eye(robot.model.nv) - np.linalg.pinv(constraints, rcond=1e-8) @ constraints
    sideways = pin.jacobianCenterOfMass(robot.model, data, sample.q)[1]
    v = free @ sideways
    return sample._replace(v=speed * v / (sideways @ v))


@pytest.fixture(scope="module")
def posed(robot):
    """For each scenario: controller, problem, and the command of its solution."""
    found = {}
    for scenario in ("two_coplanar", "two", "three", "four"):
        controller = Controller(robot, Configuration(), moving(draw(robot, scenario, 5, 0), 0.3), DT)
        problem = controller.problem_at(controller.sample.q, controller.sample.v)
        answer = Daqp().solve(problem)
        assert answer.status == Status.OPTIMAL
        found[scenario] = controller, problem, controller.command(answer.y)
    return found


class Dynamics:
    """What Pinocchio says about a state, with none of the code under test."""

    def __init__(self, robot, sample, q, v):
        model, data = robot.model, robot.model.createData()
        mass = pin.crba(model, data, q)
        self.mass = np.triu(mass) + np.triu(mass, 1).T
        self.bias = pin.rnea(model, data, q, v, np.zeros(model.nv))
        self.jacobian = contact_jacobian(robot, data, q, [contact.effector for contact in sample.contacts])
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        pin.updateFramePlacements(model, data)
        drifts, errors = [], []
        for contact in sample.contacts:
            effector = robot.effectors[contact.effector]
            local = effector.placement.inverse()
            drifts.append(local.act(pin.getFrameAcceleration(model, data, effector.frame, pin.LOCAL)).vector)
            moved = contact.placement.actInv(data.oMf[effector.frame] * effector.placement)
            linear = moved.rotation.T @ moved.translation
            errors.append(np.concatenate([linear, moved.rotation.T @ pin.log3(moved.rotation)]))
        self.drift, self.error = np.concatenate(drifts), np.concatenate(errors)
        self.com_jacobian = pin.jacobianCenterOfMass(model, data, q).copy()
        pin.centerOfMass(model, data, q, v, np.zeros(model.nv))
        self.com_drift, self.com_velocity = data.acom[0].copy(), data.vcom[0].copy()

    def goal(self, v):
        return -self.drift - DAMPING * self.jacobian @ v - STIFFNESS * self.error


def corner_edges(contact):
    """(16, 6) wrenches of the pyramids' edges at the four corners, in the contact's frame."""
    slope = contact.friction / np.sqrt(2)
    edges = []
    for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        corner = np.array([x * contact.half_length, y * contact.half_width, 0.0])
        for first, second in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
            force = np.array([first * slope, second * slope, 1.0])
            edges.append(np.concatenate([force, np.cross(corner, force)]))
    return np.array(edges)


def solve_unreduced(robot, controller, lower, upper):
    """Accelerations that solve (30); the other variables are coefficients of pyramid edges [100 N] and torques [100 N m]."""
    sample, n = controller.sample, robot.model.nv - 6
    k, q, v = len(sample.contacts), sample.q, sample.v
    dyn = Dynamics(robot, sample, q, v)
    generators = np.zeros((6 * k, 16 * k))
    for i, contact in enumerate(sample.contacts):
        generators[6 * i : 6 * i + 6, 16 * i : 16 * i + 16] = 100.0 * corner_edges(contact).T
    size = n + 6 + 16 * k + n
    accelerations, edges, torques = slice(0, n + 6), slice(n + 6, n + 6 + 16 * k), slice(n + 6 + 16 * k, size)
    equal, right = np.zeros((6 * k + n + 6, size)), np.concatenate([dyn.goal(v), -dyn.bias])
    equal[: 6 * k, accelerations] = dyn.jacobian
    equal[6 * k :, accelerations] = dyn.mass
    equal[6 * k :, edges] = -dyn.jacobian.T @ generators
    equal[6 * k + 6 :, torques] = -100.0 * np.eye(n)
    tasks = np.zeros((n + 3 + 6 * (k - 1), size))
    tasks[:n, 6 : n + 6] = np.eye(n)
    tasks[n : n + 3, accelerations] = np.sqrt(COM_WEIGHT) * dyn.com_jacobian
    tasks[n + 3 :, edges] = np.sqrt(REGULARISATION) * generators[6:]
    wanted = np.concatenate(
        [
            POSTURE_STIFFNESS * (sample.q[7:] - q[7:]) - POSTURE_DAMPING * v[6:],
            np.sqrt(COM_WEIGHT) * (-dyn.com_velocity / DT - dyn.com_drift),
            np.sqrt(REGULARISATION) * np.concatenate([share for share in controller.fixed.shares[1:]]),
        ]
    )
    bounds = np.eye(size)[6:]
    least = np.concatenate([lower, np.zeros(16 * k), -robot.torque / 100.0])
    greatest = np.concatenate([upper, np.full(16 * k, 1e20), robot.torque / 100.0])
    scale = 1e-3
    qp = proxqp.dense.QP(size, len(equal), len(bounds))
    qp.settings.eps_abs, qp.settings.eps_rel, qp.settings.max_iter = 1e-9, 0.0, 10_000
    qp.init(scale * tasks.T @ tasks, -scale * tasks.T @ wanted, equal, right, bounds, least, greatest)
    qp.solve()
    assert qp.results.info.status == proxqp.PROXQP_SOLVED
    return qp.results.x[accelerations]


def joint_bounds(controller, problem):
    """Bounds of the joints' accelerations, before rows were scaled to norm 1."""
    n = controller.robot.model.nv - 6
    u, ku = controller.memory.root[1], controller.memory.root[0]
    norms = np.linalg.norm(np.eye(n) - u.T @ ku, axis=1)
    return problem.lower[:n] * norms, problem.upper[:n] * norms


@pytest.mark.parametrize("scenario", ["two_coplanar", "three"])
def test_the_reduced_problem_has_the_optimum_of_the_full_one(robot, posed, scenario):
    controller, problem, command = posed[scenario]
    full = solve_unreduced(robot, controller, *joint_bounds(controller, problem))
    np.testing.assert_allclose(command.acceleration, full, atol=2e-3 * np.abs(full).max())


@pytest.mark.parametrize("scenario", ["two_coplanar", "two", "three", "four"])
def test_newton_euler_and_contacts(robot, posed, scenario):
    controller, _, command = posed[scenario]
    sample = controller.sample
    dyn = Dynamics(robot, sample, sample.q, sample.v)
    forces = dyn.mass @ command.acceleration + dyn.bias - dyn.jacobian.T @ command.wrenches.ravel()
    np.testing.assert_allclose(forces[:6], 0.0, atol=1e-7)
    np.testing.assert_allclose(forces[6:], command.torque, atol=1e-7)
    np.testing.assert_allclose(dyn.jacobian @ command.acceleration, dyn.goal(sample.v), atol=2e-5)


def test_the_com_task_is_met_where_nothing_hinders_it(robot):
    sample = swaying(robot, draw(robot, "three", 5, 1), 1e-4)
    controller = Controller(robot, CONFIGURATIONS["no_limits"], sample, DT)
    command = controller.command(Daqp().solve(controller.problem_at(sample.q, sample.v)).y)
    dyn = Dynamics(robot, sample, sample.q, sample.v)
    acceleration = dyn.com_jacobian @ command.acceleration + dyn.com_drift
    # the posture task, of weight 1 to 1000, leaves an error where moving the CoM takes large joint accelerations
    np.testing.assert_allclose(acceleration, -dyn.com_velocity / DT, atol=0.1 * np.abs(dyn.com_velocity).max() / DT)


def test_centroid_is_pinocchios(robot, posed):
    for controller, _, command in posed.values():
        centre, sample, model = controller.memory.centroid, controller.sample, robot.model
        data = model.createData()
        pin.computeCentroidalMomentumTimeVariation(model, data, sample.q, sample.v, command.acceleration)
        pin.centerOfMass(model, data, sample.q, sample.v, command.acceleration)
        joints = command.acceleration[6:]
        np.testing.assert_allclose(centre.com, data.com[0], atol=1e-12)
        np.testing.assert_allclose(centre.velocity, data.vcom[0], atol=1e-12)
        np.testing.assert_allclose(centre.momentum, data.hg.angular, atol=1e-11)
        np.testing.assert_allclose(centre.jacobian @ joints + centre.drift, data.acom[0], atol=1e-5)
        np.testing.assert_allclose(centre.rate_jacobian @ joints + centre.rate_drift, data.dhg.angular, atol=1e-3)


def test_stabilisation_pulls_a_contact_back(robot):
    """After a displacement of every contact, the goals are those of Pinocchio's logarithm."""
    sample = moving(draw(robot, "four", 5, 2), 0.1)
    controller = Controller(robot, Configuration(), sample, DT)
    nudge = 1e-4 * np.random.default_rng(3).standard_normal(robot.model.nv)
    q = pin.integrate(robot.model, sample.q, nudge)
    controller.problem_at(q, sample.v)
    dyn = Dynamics(robot, sample, q, sample.v)
    np.testing.assert_allclose(controller.memory.reduced.goals.ravel(), dyn.goal(sample.v), atol=1e-6)


@pytest.mark.parametrize("name", sorted(CONFIGURATIONS))
def test_removing_limits_really_removes_them(robot, name):
    configuration = CONFIGURATIONS[name]
    sample = moving(draw(robot, "two", 5, 0), 0.1)
    controller = Controller(robot, configuration, sample, DT)
    problem, n = controller.problem_at(sample.q, sample.v), robot.model.nv - 6
    joints = configuration.position_limits or configuration.velocity_limits
    for bound in (problem.lower, problem.upper):
        assert np.isfinite(bound[:n]).all() if joints else np.isinf(bound[:n]).all()
        assert np.isfinite(bound[n : 2 * n]).all() if configuration.torque_limits else np.isinf(bound[n : 2 * n]).all()
    if configuration.position_limits:
        least, greatest = joint_bounds(controller, problem)
        assert max(-least.min(), greatest.max()) <= configuration.deceleration * (1 + 1e-9)
    extra = 2 * configuration.straight_com + 3 * configuration.constant_momentum
    assert (problem.lower == problem.upper).sum() == 6 + extra
    np.testing.assert_allclose(np.linalg.norm(problem.matrix, axis=1), 1.0)
