"""What a rectangle can push: its friction pyramids as a cone of 6-D wrenches, and static equilibrium on several of them.

A wrench is (force, moment), exerted on the robot, in the contact's frame, moment about the rectangle's centre. At each
corner the friction cone is replaced by the inscribed pyramid with four edges at angles pi/4 + j pi/2 from the first
tangent: each tangential component is at most mu / sqrt(2) times the normal one. The predictor uses the same pyramid.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linprog, nnls

from reference.contacts import GRAVITY, wrench_rays
from reference.tsid.robot import Contact

NOTHING, SOMETHING = 1e-12, 1e-3
"""Shares of the weight: what forces that carry it may leave, and what they leave at least where proved not to [-]."""

CORNERS = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
"""Signs of the four corners along the length and the width."""


def wrench_cone(half_length: float, half_width: float, friction: float) -> np.ndarray:
    """Rows B (16, 6) such that B w <= 0 if and only if four corner forces in their pyramids add up to the wrench w.

    half_length, half_width: of the rectangle along its first and second axis [m]. friction: mu of the circular cone [-].
    Rows 0-3 bound the tangential force [N], 4-7 the centre of pressure [N m], 8-15 the yaw moment [N m].
    Raises ValueError naming an argument that is not positive.
    Source: Caron, Pham, Nakamura, "Stability of surface contacts for humanoid robots", ICRA 2015.
    """
    for name, value in (("half_length", half_length), ("half_width", half_width), ("friction", friction)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} = {value} (expected a positive number)")
    x, y, mu = half_length, half_width, friction / np.sqrt(2.0)
    signs = [(first, second) for first in (1.0, -1.0) for second in (1.0, -1.0)]
    rows = [(first, 0, -mu, 0, 0, 0) for first in (1.0, -1.0)]
    rows += [(0, second, -mu, 0, 0, 0) for second in (1.0, -1.0)]
    rows += [(0, 0, -y, first, 0, 0) for first in (1.0, -1.0)]
    rows += [(0, 0, -x, 0, second, 0) for second in (1.0, -1.0)]
    # +yaw <= mu (x + y) fz - |y fx + mu mx| - |x fy + mu my|
    rows += [(a * y, b * x, -mu * (x + y), a * mu, b * mu, 1.0) for a, b in signs]
    # -yaw <= mu (x + y) fz - |y fx - mu mx| - |x fy - mu my|
    rows += [(a * y, b * x, -mu * (x + y), -a * mu, -b * mu, -1.0) for a, b in signs]
    return np.array(rows, dtype=float)


def corner_points(contact: Contact) -> np.ndarray:
    """The four corners (4, 3) of a contact's rectangle, counterclockwise about its normal [m], world frame."""
    local = np.zeros((4, 3))
    local[:, :2] = CORNERS * (contact.half_length, contact.half_width)
    return local @ contact.placement.rotation.T + contact.placement.translation


def equilibrium(contacts: Sequence[Contact], com: np.ndarray, gravity: Sequence[float] = GRAVITY) -> bool:
    """Whether forces in the corners' pyramids can hold a body at rest whose centre of mass is `com`.

    contacts: one or more. com: (3,) [m], world frame. gravity: (3,) [m/s^2]. The mass cancels.
    Nonnegative least squares answers nearly always, and proves it: by forces that leave nothing (NOTHING), or by what the
    best forces leave, a direction against which no force of the pyramids helps. The rest is for a linear program: the
    greatest share, at most 1, of the body's weight that forces in the pyramids can carry. It has a solution always, which a
    plain feasibility problem has not, and since the pyramids are cones the share is 0 or 1.
    Solved by HiGHS; raises ArithmeticError where it does not solve it.
    """
    points = np.concatenate([corner_points(contact) for contact in contacts])
    frames = np.repeat([contact.placement.rotation for contact in contacts], 4, axis=0)
    friction = np.repeat([contact.friction for contact in contacts], 4)
    rays, origin = wrench_rays(points, frames, friction)[:2]
    weight = -np.asarray(gravity, dtype=float)  # what the contacts must supply, per unit mass
    target = np.concatenate([weight, np.cross(np.asarray(com) - origin, weight)])
    proved = _proved(rays, target)
    if proved is not None:
        return proved
    columns = rays.shape[1] + 1
    bounds = np.column_stack([np.zeros(columns), np.full(columns, np.inf)])
    bounds[-1, 1] = 1.0
    cost = np.zeros(columns)
    cost[-1] = -1.0
    result = linprog(cost, A_eq=np.column_stack([rays, -target]), b_eq=np.zeros(6), bounds=bounds, method="highs")
    if result.status != 0:
        raise ArithmeticError(f"static equilibrium: HiGHS ended with status {result.status}: {result.message}")
    return bool(result.x[-1] > 0.5)


def _proved(rays: np.ndarray, target: np.ndarray) -> bool | None:
    """Whether nonnegative weights of the rays (6, r) make up the target (6,); None where least squares do not settle it."""
    try:
        weights, _ = nnls(rays, target)
    except RuntimeError:  # too many iterations
        return None
    left, size = target - rays @ weights, np.linalg.norm(target)
    distance = np.linalg.norm(left)
    if distance <= NOTHING * size:
        return True
    helps = (left @ rays).max() / distance  # of a unit of force, along what is left
    return False if distance > SOMETHING * size and helps <= NOTHING else None
