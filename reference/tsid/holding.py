"""How much of its torque limits a robot needs to stand still in a posture, by a linear program."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from scipy.optimize import linprog

from reference.contacts import grasp_matrix, pyramid_edges
from reference.tsid.push import contact_jacobian
from reference.tsid.robot import Contact, Robot
from reference.tsid.wrench_cone import CORNERS


def effort(robot: Robot, q: np.ndarray, contacts: Sequence[Contact]) -> float:
    """Least share t [-] such that the robot can stand still at q (nq,) with no torque above t of its limit.

    Above 1 it cannot be held. Contact forces are in the pyramids of the contacts' corners. Only joints between the base and
    a contact count: a free arm that sags is no fall, and what holds it up is nobody's choice.
    Raises ArithmeticError if HiGHS does not solve it: where no forces balance gravity there is no such share.
    """
    data = robot.model.createData()
    gravity = pin.computeGeneralizedGravity(robot.model, data, q)
    pin.framesForwardKinematics(robot.model, data, q)
    jacobian = contact_jacobian(robot, data, q, [contact.effector for contact in contacts])
    pushes = np.hstack([jacobian[6 * i : 6 * i + 6].T @ _edges(contact) for i, contact in enumerate(contacts)])
    carry = 6 + np.flatnonzero(carrying(robot, contacts))
    held, needed = pushes[carry], gravity[carry]  # torque = needed - held @ weights
    limit = robot.torque[carry - 6, None]
    cost = np.zeros(pushes.shape[1] + 1)
    cost[-1] = 1.0
    weight = np.abs(gravity[:6]).max()  # the program's weights and torques are in its units: all of order 1
    result = linprog(
        cost,
        A_ub=np.block([[-held * weight / limit, -np.ones_like(limit)], [held * weight / limit, -np.ones_like(limit)]]),
        b_ub=np.concatenate([-needed / limit[:, 0], needed / limit[:, 0]]),
        A_eq=np.column_stack([pushes[:6], np.zeros(6)]),
        b_eq=gravity[:6] / weight,
        method="highs",
    )
    if result.status != 0:
        raise ArithmeticError(f"effort: HiGHS ended with status {result.status}: {result.message}")
    return float(result.fun)


def carrying(robot: Robot, contacts: Sequence[Contact]) -> np.ndarray:
    """(n,): whether a joint lies between the base and one of the contacts."""
    model, found = robot.model, np.zeros(robot.model.nv - 6, dtype=bool)
    for contact in contacts:
        link = model.frames[robot.effectors[contact.effector].frame].parentJoint
        found[[model.joints[joint].idx_v - 6 for joint in model.supports[link] if joint > 1]] = True
    return found


def _edges(contact: Contact) -> np.ndarray:
    """Wrenches (6, 16), force and moment about the centre, of the edges of a contact's pyramids, in its own frame."""
    points = np.zeros((4, 3))
    points[:, :2] = CORNERS * (contact.half_length, contact.half_width)
    edges = pyramid_edges(np.broadcast_to(np.eye(3), (4, 3, 3)), np.full(4, contact.friction))
    return np.hstack([grasp_matrix(point[None]) @ own.T for point, own in zip(points, edges, strict=True)])
