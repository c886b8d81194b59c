"""The controller's QP (30) as the paper prints it, in NumPy: the baseline of `bench.simulator`.

Variables x = (dv, f, tau): accelerations, a force for each corner of a contact in its frame [N], torques. Written the way
one writes it first: dense matrices, made anew at each step.
"""

from __future__ import annotations

import daqp
import numpy as np
import pinocchio as pin

from reference.tsid.assembly import REGULARISATION
from reference.tsid.push import contact_jacobian
from reference.tsid.robot import Robot, Sample
from reference.tsid.tasks import COM_WEIGHT, POSTURE_DAMPING, POSTURE_STIFFNESS
from reference.tsid.wrench_cone import CORNERS

STIFFNESS, DAMPING, DECELERATION = 100.0, 20.0, 10.0
"""Of the simulator's defaults: stabilisation [1/s^2, 1/s] and the standard controller's deceleration [rad/s^2]."""

SCALE = 1e-3
"""Of the cost: its Hessian has entries of 1e3."""

CURVATURE = 1e-9
"""Of the cost in variables that (30) gives none: DAQP needs a positive definite Hessian."""

RESIDUAL = 1e-3
"""Greatest violation of a row of an answer [N, N m, rad/s^2]."""

EQUALITY = 5
"""DAQP's mark of such a row."""


class PlainQP:
    """The QP of one robot on the contacts of one sample, under the standard controller."""

    def __init__(self, robot: Robot, sample: Sample, dt: float):
        self.robot, self.sample, self.dt = robot, sample, dt
        self.data = robot.model.createData()
        self._model: daqp.Model | None = None

    def assemble(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
        """H, f, A, upper, lower, sense of DAQP's problem at q (nq,), v (nv,)."""
        robot, sample, data, model = self.robot, self.sample, self.data, self.robot.model
        contacts, n, nv = sample.contacts, model.nv - 6, model.nv
        k = len(contacts)
        size, forces = nv + 12 * k + n, slice(nv, nv + 12 * k)
        mass = pin.crba(model, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        bias = pin.nonLinearEffects(model, data, q, v).copy()
        jacobian = contact_jacobian(robot, data, q, [contact.effector for contact in contacts])
        grasp = np.zeros((6 * k, 12 * k))
        friction = np.zeros((16 * k, size))
        for c, contact in enumerate(contacts):
            grasp[6 * c : 6 * c + 6, 12 * c : 12 * c + 12] = _grasp(contact)
            rows = _pyramids(contact.friction / np.sqrt(2.0))
            friction[16 * c : 16 * c + 16, nv + 12 * c : nv + 12 * c + 12] = rows
        equal = np.zeros((6 * k + nv, size))
        equal[: 6 * k, :nv] = jacobian
        equal[6 * k :, :nv] = mass
        equal[6 * k :, forces] = -jacobian.T @ grasp
        equal[6 * k + 6 :, nv + 12 * k :] = -np.eye(n)
        right = np.concatenate([self._goal(q, v, jacobian), -bias])
        hessian, gradient = self._cost(q, v, grasp, size)
        least, greatest = self._bounds(q[7:], v[6:])
        free = np.full(6, np.inf), np.full(12 * k, np.inf)
        upper = np.concatenate([free[0], greatest, free[1], robot.torque, right, np.zeros(16 * k)])
        lower = np.concatenate([-free[0], least, -free[1], -robot.torque, right, np.full(16 * k, -np.inf)])
        sense = np.zeros(len(upper), dtype=np.int32)
        sense[size : size + len(right)] = EQUALITY
        return hessian, gradient, np.concatenate([equal, friction]), upper, lower, sense

    def solve(self, problem: tuple[np.ndarray, ...], warm: bool) -> tuple[bool, np.ndarray]:
        """Whether DAQP solved it, from the last active set or from scratch, and accelerations (nv,).

        An answer with a residual is none: a few per thousand of what it calls solved violate a row by up to 10 N or rad/s^2.
        """
        hessian, gradient, matrix, upper, lower, sense = problem
        if not warm or self._model is None:
            self._model = daqp.Model()
            flag, _ = self._model.setup(hessian, gradient, matrix, upper, lower, sense)
        else:
            flag = self._model.update(hessian, gradient, matrix, upper, lower)
        if flag < 0:
            self._model = None
            return False, np.full(self.robot.model.nv, np.nan)
        x, _, flag, _ = self._model.solve()
        rows = np.concatenate([x, matrix @ x])
        return flag == 1 and bool(max((rows - upper).max(), (lower - rows).max()) < RESIDUAL), x[: self.robot.model.nv]

    def _goal(self, q, v, jacobian):
        """Accelerations of the contacts that stabilise them, less what velocities alone give (6 k,)."""
        model, data = self.robot.model, self.data
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        pin.updateFramePlacements(model, data)
        drift, error = [], []
        for contact in self.sample.contacts:
            effector = self.robot.effectors[contact.effector]
            acceleration = pin.getFrameAcceleration(model, data, effector.frame, pin.LOCAL)
            drift.append(effector.placement.inverse().act(acceleration).vector)
            moved = contact.placement.actInv(data.oMf[effector.frame] * effector.placement)
            error.append(np.concatenate([moved.rotation.T @ moved.translation, pin.log3(moved.rotation)]))
        return -np.concatenate(drift) - DAMPING * jacobian @ v - STIFFNESS * np.concatenate(error)

    def _cost(self, q, v, grasp, size):
        """Hessian and gradient of half the squared errors of the two tasks."""
        model, data, n, nv = self.robot.model, self.data, self.robot.model.nv - 6, self.robot.model.nv
        jacobian = pin.jacobianCenterOfMass(model, data, q).copy()
        pin.centerOfMass(model, data, q, v, np.zeros(nv))
        weight = -pin.computeTotalMass(model) * model.gravity.linear / len(self.sample.contacts)
        shares = [np.concatenate([contact.placement.rotation.T @ weight, np.zeros(3)]) for contact in self.sample.contacts]
        others = grasp[6:]  # the first contact's wrench has no cost
        tasks = np.zeros((n + 3 + len(others), size))
        tasks[:n, 6:nv] = np.eye(n)
        tasks[n : n + 3, :nv] = np.sqrt(COM_WEIGHT) * jacobian
        tasks[n + 3 :, nv : nv + grasp.shape[1]] = np.sqrt(REGULARISATION) * others
        posture = POSTURE_STIFFNESS * (self.sample.q[7:] - q[7:]) - POSTURE_DAMPING * v[6:]
        com = np.sqrt(COM_WEIGHT) * (-data.vcom[0] / self.dt - data.acom[0])
        wanted = np.concatenate([posture, com, np.sqrt(REGULARISATION) * np.concatenate(shares[1:])])
        return SCALE * tasks.T @ tasks + CURVATURE * np.eye(size), -SCALE * tasks.T @ wanted

    def _bounds(self, joints, speeds):
        """Of joint accelerations (n,) each, as `limits.acceleration_bounds` has them."""
        robot, dt = self.robot, self.dt
        step = DECELERATION * dt
        viable = lambda room: -step + np.sqrt(np.maximum(step * step + 2 * DECELERATION * room, 0.0))
        up = np.minimum(robot.speed, viable(robot.upper - joints))
        down = np.minimum(robot.speed, viable(joints - robot.lower))
        greatest = np.minimum(np.maximum((up - speeds) / dt, -DECELERATION), DECELERATION)
        return np.maximum(np.minimum((-down - speeds) / dt, DECELERATION), -DECELERATION), greatest


def _grasp(contact) -> np.ndarray:
    """(6, 12): the wrench of four corner forces, in the contact's frame."""
    blocks = []
    for x, y in CORNERS * (contact.half_length, contact.half_width):
        blocks.append(np.vstack([np.eye(3), pin.skew(np.array([x, y, 0.0]))]))
    return np.hstack(blocks)


def _pyramids(slope: float) -> np.ndarray:
    """(16, 12): rows that are at most 0 for corner forces in their pyramids."""
    rows = np.array([[1.0, 0.0, -slope], [-1.0, 0.0, -slope], [0.0, 1.0, -slope], [0.0, -1.0, -slope]])
    return np.kron(np.eye(4), rows)
