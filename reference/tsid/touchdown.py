"""A hand that comes down on a wall while its robot falls: a plastic impact, then the same controllers on one contact more.

The wall stands where the hand is, so that the contact fits the posture: the hand's rectangle is turned on its link, about
its centre, until its normal is the wall's (a fist that touches with whatever side faces the wall). What an impact does to
velocities is the projection on the contacts' constraints in the metric of the mass matrix: the velocity nearest to the old
one, by kinetic energy, among those that leave all contacts at rest. Impulses are not asked to lie in friction cones.

An impact can leave joints beyond their viability bounds: they move towards a limit faster than they can brake. The
controller would ask of them to brake at one exact rate, which together with a new contact makes most QPs infeasible. So
until such a joint is viable again it may brake as hard as it likes and only must not get faster (`RelaxedController`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from reference.tsid.controller import Controller
from reference.tsid.limits import viable_speed
from reference.tsid.push import contact_jacobian
from reference.tsid.robot import Contact, Robot, Sample
from reference.tsid.sampling import place
from reference.tsid.simulator import Simulator
from reference.tsid.solvers import Problem

HANDS = ("left_hand", "right_hand")

WALLS = (-60.0, -20.0, 20.0, 60.0)
"""How far the normals of walls are turned about the vertical from straight against the CoM's horizontal velocity [deg]."""

BEYOND = 1e-6
"""By how much a joint speed must exceed what can be braked in time before it counts [rad/s]: not by rounding."""


def wall_normals(velocity: np.ndarray) -> np.ndarray:
    """Horizontal unit vectors (4, 3), the normals of walls that a robot of CoM velocity (3,) moves towards.

    One for each of WALLS. Along x where it does not move.
    """
    ahead = np.arctan2(-velocity[1], -velocity[0]) if np.any(velocity[:2]) else 0.0
    angles = ahead + np.radians(WALLS)
    return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])


def facing(robot: Robot, q: np.ndarray, hand: str, normal: np.ndarray) -> Robot:
    """The robot whose hand, at q (nq,), touches with a rectangle of that normal (3,), a unit vector in the world.

    Its centre and size stay; its length is as upright as can be.
    """
    at = place(robot, robot.model.createData(), q, [hand])[0].placement
    up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    along = up - (normal @ up) * normal
    along /= np.sqrt(along @ along)
    turn = at.rotation.T @ np.column_stack([along, np.cross(normal, along), normal])
    effector = robot.effectors[hand]
    turned = effector._replace(placement=effector.placement * pin.SE3(turn, np.zeros(3)))
    return robot._replace(effectors=robot.effectors | {hand: turned})


def joined(contacts: Sequence[Contact], new: Contact) -> tuple[Contact, ...]:
    """The contacts and a new one; the same where it is there already.

    Raises ValueError for an effector that touches somewhere else: it cannot be at two places.
    """
    for contact in contacts:
        if contact.effector == new.effector:
            if not contact.placement.isApprox(new.placement, 1e-9):
                raise ValueError(f"{new.effector} touches at {contact.placement.translation} (expected it to be free)")
            return tuple(contacts)
    return (*contacts, new)


def impact(robot: Robot, q: np.ndarray, v: np.ndarray, effectors: Sequence[str]) -> np.ndarray:
    """The velocity (nv,) after a plastic impact that brings the effectors to rest: v - M^-1 J' (J M^-1 J')^+ J v.

    q: (nq,). v: (nv,) before. J may lose rank: a straight arm, or the same contact twice.
    """
    data = robot.model.createData()
    mass = pin.crba(robot.model, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    jacobian = contact_jacobian(robot, data, q, effectors)
    root = np.linalg.cholesky(mass)
    # In w = root' v kinetic energy is |w|^2 / 2, so that what is left is an orthogonal projection.
    rows = np.linalg.solve(root, jacobian.T).T
    w = root.T @ v
    w = w - np.linalg.lstsq(rows, rows @ w, rcond=None)[0]
    return np.linalg.solve(root.T, w)


def touchdown(robot: Robot, sample: Sample, q: np.ndarray, v: np.ndarray, hand: str) -> Sample:
    """The sample that begins where a hand comes down at q (nq,), v (nv,): in its place, as `facing` has turned it.

    The posture to which controllers return is that of the touchdown.
    """
    new = place(robot, robot.model.createData(), q, [hand])[0]
    contacts = joined(sample.contacts, new)
    after = impact(robot, q, v, [contact.effector for contact in contacts])
    return sample._replace(q=q.copy(), v=after, contacts=contacts)


def beyond(robot: Robot, q: np.ndarray, v: np.ndarray, deceleration: float, dt: float) -> np.ndarray:
    """(n,): +1 for a joint too fast towards its upper limit to brake in time at `deceleration` [rad/s^2], -1 for the lower.

    q: (nq,), v: (nv,). Limits of position and of speed count, as in `limits.acceleration_bounds`.
    """
    found = np.zeros(len(robot.lower), dtype=int)
    for i, (position, speed) in enumerate(zip(q[7:], v[6:], strict=True)):
        up = min(robot.speed[i], viable_speed(robot.upper[i] - position, deceleration, dt))
        down = min(robot.speed[i], viable_speed(position - robot.lower[i], deceleration, dt))
        found[i] = int(speed - up > deceleration * dt + BEYOND) - int(-speed - down > deceleration * dt + BEYOND)
    return found


class RelaxedController(Controller):
    """A controller that is patient with joints that begin beyond their viability bounds, until they are viable."""

    def __init__(self, robot, configuration, sample, dt, stabilisation=(100.0, 20.0)):
        super().__init__(robot, configuration, sample, dt, stabilisation)
        limits = {name: getattr(self.fixed, name) for name in ("lower", "upper", "speed")}
        self._limited, self._dt, self._deceleration = robot._replace(**limits), dt, configuration.deceleration
        self.relaxed = beyond(self._limited, sample.q, sample.v, self._deceleration, dt) != 0
        """(n,): joints that have been beyond at every step so far."""

    def problem_at(self, q: np.ndarray, v: np.ndarray) -> Problem:
        """As a controller's, but for the accelerations of joints that are relaxed."""
        problem = super().problem_at(q, v)
        if self.relaxed.any():
            side = beyond(self._limited, q, v, self._deceleration, self._dt)
            self.relaxed &= side != 0
            # Rows of joint accelerations come first; their scale does not matter to zero and infinity.
            for i in np.flatnonzero(self.relaxed):
                problem.lower[i], problem.upper[i] = (-np.inf, 0.0) if side[i] > 0 else (0.0, np.inf)
        return problem


class TouchdownSimulator(Simulator):
    """Runs samples that begin with a touchdown."""

    controller = RelaxedController
