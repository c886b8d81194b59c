"""The balance controller: the QP (30) of Appendix D, reduced, and its configurations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from reference.tsid.assembly import Fixed, Sizes, assemble, fixed_in, memory_in, memory_size, recover
from reference.tsid.robot import Robot, Sample
from reference.tsid.solvers import Problem
from reference.tsid.tasks import COM_WEIGHT, POSTURE_DAMPING, POSTURE_STIFFNESS
from reference.tsid.wrench_cone import wrench_cone


class Configuration(NamedTuple):
    """What limits and constraints a controller has; the default is the standard one."""

    torque_limits: bool = True
    position_limits: bool = True
    velocity_limits: bool = True
    deceleration: float = 10.0
    """With which every joint can stop before its position limit [rad/s^2]: while there are position limits, no joint
    accelerates more."""
    straight_com: bool = False
    """The CoM stays on the line of its initial velocity."""
    constant_momentum: bool = False
    """The angular momentum about the CoM does not change."""
    posture_stiffness: float = POSTURE_STIFFNESS
    """[1/s^2]"""
    posture_damping: float = POSTURE_DAMPING
    """[1/s]"""
    com_gain: float | None = None
    """Of the CoM's task, which asks for the acceleration -gain velocity [1/s]; None: 1/dt, to stop within a step."""


CONFIGURATIONS = {
    "standard": Configuration(),
    "straight": Configuration(straight_com=True),
    "fast": Configuration(deceleration=30.0),
    "brake": Configuration(deceleration=30.0, posture_stiffness=0.0, posture_damping=15.0, com_gain=7.0),
    "no_torque": Configuration(torque_limits=False),
    "no_position": Configuration(position_limits=False),
    "no_position_torque": Configuration(torque_limits=False, position_limits=False),
    "no_position_velocity": Configuration(position_limits=False, velocity_limits=False),
    "no_limits": Configuration(torque_limits=False, position_limits=False, velocity_limits=False),
    "constant_momentum": Configuration(constant_momentum=True),
}
"""The three controllers of V-A, whose best outcome is the paper's truth; "brake", which has no posture to go back to and
brakes the CoM over some steps in place of one, and so stops robots that the three let fall; the ablations of V-D. "straight"
is both of the first and the last."""


class Command(NamedTuple):
    """What the controller makes the robot do."""

    acceleration: np.ndarray
    """(nv,)."""
    torque: np.ndarray
    """(n,) [N m]."""
    wrenches: np.ndarray
    """(k, 6), exerted on the robot, in the contacts' frames [N, N m]."""


class Controller:
    """The QP of one robot on the contacts of one sample."""

    def __init__(self, robot: Robot, configuration: Configuration, sample: Sample, dt: float, stabilisation=(100.0, 20.0)):
        self.robot, self.sample = robot, sample
        self.data = robot.model.createData()
        links = [robot.model.frames[robot.effectors[c.effector].frame].parentJoint for c in sample.contacts]
        fixed = _fixed(robot, configuration, sample, dt, stabilisation)
        self.sizes = Sizes(len(sample.contacts), robot.model.nv - 6, len(fixed.across), len(fixed.momentum))
        self.rows, self.size = self.sizes.rows, self.sizes.joints + 6 * (self.sizes.contacts - 1)
        self._fixed = np.concatenate([np.ravel(values) for values in fixed])
        self._memory = np.zeros(memory_size(self.sizes.contacts, self.sizes.joints, self.rows))
        self.fixed = fixed_in(self._fixed, *self.sizes)
        self.memory = memory_in(self._memory, self.sizes.contacts, self.sizes.joints, self.rows)
        self.problem = Problem(self.memory.matrix, self.memory.lower, self.memory.upper, self.memory.target)
        self.memory.frames[:, 3, 3] = 1.0
        at = [self.data.oMi[joint] for joint in (1, *links)]
        # views of what Pinocchio overwrites, made once: making them takes longer than filling them
        self._terms = self.data.M, self.data.nle, self.data.J, self.data.dJ
        frames = zip(self.memory.frames, at, strict=True)
        self._views = [(frame[:3, :3], link.rotation, frame[:3, 3], link.translation) for frame, link in frames]
        self._slip = 0.0

    def problem_at(self, q: np.ndarray, v: np.ndarray) -> Problem:
        """The QP at configuration q (nq,) and velocity v (nv,), in y = (H^(1/2) qdd, REGULARISATION^(1/2) (w_2..w_k)).

        H is the Hessian of the two tasks. Rows have norm 1. The arrays are overwritten by the next call.
        """
        model, data = self.robot.model, self.data
        pin.crba(model, data, q)
        pin.nonLinearEffects(model, data, q, v)
        pin.computeJointJacobiansTimeVariation(model, data, q, v)  # last: crba overwrites data.J
        for own_rotation, rotation, own_place, place in self._views:
            own_rotation[:] = rotation
            own_place[:] = place
        self._slip = assemble(*self._terms, q, v, self._fixed, self._memory, *self.sizes, self.rows)
        return self.problem

    def command(self, y: np.ndarray) -> Command:
        """What a solution y of the problem last posed means."""
        k, n = self.sizes.contacts, self.sizes.joints
        acceleration, torque, wrenches = np.empty(n + 6), np.empty(n), np.empty((k, 6))
        recover(y, self._memory, k, n, self.rows, acceleration, torque, wrenches)
        return Command(acceleration, torque, wrenches)

    def slip(self) -> float:
        """How far the contact that moved most was from its place at the state last posed [m]."""
        return self._slip


def _fixed(robot: Robot, configuration: Configuration, sample: Sample, dt: float, stabilisation) -> Fixed:
    model, contacts = robot.model, sample.contacts
    data = model.createData()
    effectors = [robot.effectors[contact.effector] for contact in contacts]
    weight = -pin.computeTotalMass(model) * model.gravity.linear / len(contacts)
    shares = [np.concatenate([contact.placement.rotation.T @ weight, np.zeros(3)]) for contact in contacts]
    pin.ccrba(model, data, sample.q, sample.v)
    pin.centerOfMass(model, data, sample.q, sample.v)
    largest = configuration.deceleration if configuration.position_limits else np.inf
    none = np.full(model.nv - 6, np.inf)
    return Fixed(
        placements=np.array([(model.frames[e.frame].placement * e.placement).homogeneous for e in effectors]),
        chains=np.array([_chain(model, model.frames[e.frame].parentJoint) for e in effectors]),
        surfaces=np.array([contact.placement.homogeneous for contact in contacts]),
        cones=np.array([wrench_cone(c.half_length, c.half_width, c.friction) for c in contacts]),
        shares=np.array(shares),
        posture=sample.q[7:].copy(),
        gravity=model.gravity.linear.copy(),
        lower=robot.lower if configuration.position_limits else -none,
        upper=robot.upper if configuration.position_limits else none,
        speed=robot.speed if configuration.velocity_limits else none,
        torque=robot.torque if configuration.torque_limits else none,
        gains=_gains(configuration, largest, dt, stabilisation),
        across=_across(data.vcom[0]) if configuration.straight_com else np.zeros((0, 3)),
        start=data.com[0].copy(),
        momentum=data.hg.angular.copy() if configuration.constant_momentum else np.zeros(0),
    )


def _gains(configuration: Configuration, largest: float, dt: float, stabilisation: tuple[float, float]) -> np.ndarray:
    """As `Fixed` has them."""
    posture = configuration.posture_stiffness, configuration.posture_damping
    com_gain = 1.0 / dt if configuration.com_gain is None else configuration.com_gain
    return np.array([dt, configuration.deceleration, largest, *stabilisation, *posture, com_gain, np.sqrt(COM_WEIGHT)])


def _chain(model: pin.Model, joint: int) -> np.ndarray:
    """(nv,): 1 for velocities that move the link of a joint, else 0."""
    moved = np.zeros(model.nv)
    for ancestor in list(model.supports[joint])[1:]:  # the first is the universe
        start = model.joints[ancestor].idx_v
        moved[start : start + model.joints[ancestor].nv] = 1.0
    return moved


def _across(direction: np.ndarray) -> np.ndarray:
    """Two unit vectors (2, 3) orthogonal to `direction` and to each other; to the x axis where `direction` is zero."""
    square = direction @ direction
    axis = direction / np.sqrt(square) if square > 0 else np.array([1.0, 0.0, 0.0])
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.sqrt(first @ first)
    return np.array([first, np.cross(axis, first)])
