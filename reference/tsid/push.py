"""A push: a random velocity that the contacts and the joint limits allow (V-B).

The velocities allowed are a polytope: zero at the contacts (and, if asked for, without angular momentum), and each joint
within its speed limit and the viability bound (15). A push is a point of that polytope by hit-and-run, times U(0, 1).
Why that: rays from zero of random direction and length are too gentle (a median CoM speed of 0.06-0.13 m/s, so that almost
every robot stops), uniform points of the polytope too violent (1.6 m/s on two feet, so that almost every robot falls); the
scaled points give both outcomes. Zero is always allowed, so scaling stays in the polytope.

On feet and hands these are still gentle (0.15 m/s): falls are decided by the posture rather than by the push. A strong push
is (1 - s) a + s b: a the point by hit-and-run, unscaled; b the point of the polytope with the greatest CoM speed in a random
direction, uniform on the sphere; s from U(0, 1). That is in the polytope too, since it is convex; the median is 0.6 m/s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
import pinocchio as pin
from scipy.optimize import linprog

from reference.tsid.robot import Robot

DECELERATION = 10.0
"""Of every joint [rad/s^2]: with it a joint stops before its position limit, (15)."""

STEPS = 3000
"""Of hit-and-run from zero; with 10,000 the mean CoM speeds are the same within their sampling error, 300 are too few."""

RANK = 1e-8
"""Singular values of the constraints below this share of the largest count as zero [-]."""


def contact_jacobian(robot: Robot, data: pin.Data, q: np.ndarray, effectors: Sequence[str]) -> np.ndarray:
    """(6 k, nv): velocities, linear then angular, of k rectangles in their own frames, per joint velocity."""
    blocks = []
    for name in effectors:
        effector = robot.effectors[name]
        jacobian = pin.computeFrameJacobian(robot.model, data, q, effector.frame, pin.LOCAL)
        blocks.append(effector.placement.inverse().action @ jacobian)
    return np.concatenate(blocks)


def speed_bounds(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest joint speeds (n,) [rad/s]: the viability bounds (15), within the speed limits. q: (nq,)."""
    joints = q[7:]
    least = -np.sqrt(2 * DECELERATION * np.maximum(joints - robot.lower, 0.0))
    greatest = np.sqrt(2 * DECELERATION * np.maximum(robot.upper - joints, 0.0))
    return np.maximum(least, -robot.speed), np.minimum(greatest, robot.speed)


def push(
    robot: Robot,
    q: np.ndarray,
    effectors: Sequence[str],
    rng: np.random.Generator,
    zero_momentum: bool = False,
    strong: bool = False,
) -> np.ndarray:
    """A random velocity (nv,) of the robot at q (nq,), in contact with `effectors`; representable in single precision.

    zero_momentum: without angular momentum about the centre of mass. Rounding leaves about 1e-7 of what is meant to be zero.
    strong: a strong push. Raises ArithmeticError if HiGHS does not find its fastest point.
    """
    data = robot.model.createData()
    constraints = contact_jacobian(robot, data, q, effectors)
    if zero_momentum:
        constraints = np.concatenate([constraints, pin.computeCentroidalMap(robot.model, data, q)[3:]])
    # Directions are projected, not taken in a basis of the null space: the projection is unique but for rounding. That is
    # enough on processors that round alike; on others (LAPACK has code of its own for each kind) hit-and-run, which is
    # chaotic, makes another point of what differs by 1e-15. The files hold the velocities that were drawn.
    projection = np.eye(robot.model.nv) - np.linalg.pinv(constraints, rcond=RANK) @ constraints
    directions, places = rng.standard_normal((STEPS, robot.model.nv)), rng.random(STEPS)
    bounds = speed_bounds(robot, q)
    share = rng.random()
    velocity = projection @ _hit_and_run(projection, *bounds, directions, places)
    if strong:
        velocity = (1.0 - share) * velocity + share * _fastest(robot, data, q, constraints, bounds, rng.standard_normal(3))
    else:
        velocity = share * velocity
    return velocity.astype(np.float32).astype(float)


def _fastest(robot: Robot, data: pin.Data, q: np.ndarray, constraints: np.ndarray, bounds, direction: np.ndarray):
    """The velocity (nv,) allowed by constraints (c, nv) and bounds of joint speeds, its CoM fastest in a direction (3,)."""
    speed = direction @ pin.jacobianCenterOfMass(robot.model, data, q)
    limits = np.column_stack([np.full((2, 6), [[-np.inf], [np.inf]]), np.stack(bounds)]).T
    result = linprog(-speed, A_eq=constraints, b_eq=np.zeros(len(constraints)), bounds=limits, method="highs")
    if result.status != 0:
        raise ArithmeticError(f"the fastest push: HiGHS ended with status {result.status}: {result.message}")
    return result.x


@numba.njit(cache=True)
def _hit_and_run(projection, least, greatest, directions, places):
    """A point (nv,) of {v: v = projection v, least <= v[6:] <= greatest} after len(places) steps from zero.

    Each step goes to a uniform place of the chord in a direction that is isotropic in the projection's image. The loops are
    written out so that no BLAS, whose sums depend on its threads, has a part in it.
    """
    size = projection.shape[0]
    point, along = np.zeros(size), np.empty(size)
    for step in range(len(places)):
        for i in range(size):
            total = 0.0
            for j in range(size):
                total += projection[i, j] * directions[step, j]
            along[i] = total
        low, high = -np.inf, np.inf
        for i in range(size - 6):
            slope = along[i + 6]
            if slope != 0.0:
                first, second = (least[i] - point[i + 6]) / slope, (greatest[i] - point[i + 6]) / slope
                low, high = max(low, min(first, second)), min(high, max(first, second))
        if low < high:  # otherwise at a corner, by rounding: stay
            length = low + places[step] * (high - low)
            for i in range(size):
                point[i] += length * along[i]
    return point
