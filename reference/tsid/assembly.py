"""The controller's QP in numbers: rows, bounds and target, written in place at every step."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from reference.tsid.dynamics import Reduced, contact_motion, reduce
from reference.tsid.limits import acceleration_bounds
from reference.tsid.tasks import Centroid, centroidal, least_distance

CONE_ROWS = 16

REGULARISATION = 1e-6
"""Weight of |w|^2 [1/N^2, 1/(N m)^2] in the cost: internal forces have no cost in (30). The wrenches of all contacts but the
first are drawn to an equal share of the weight."""


class Fixed(NamedTuple):
    """What does not change while a robot is controlled."""

    placements: np.ndarray
    """(k, 4, 4): of the contacts in those joints."""
    chains: np.ndarray
    """(k, nv): whether a velocity moves the contact."""
    surfaces: np.ndarray
    """(k, 4, 4): of the contacts in the world."""
    cones: np.ndarray
    """(k, 16, 6)."""
    shares: np.ndarray
    """(k, 6): equal shares of the weight, in the contacts' frames [N]."""
    posture: np.ndarray
    """(n,): to maintain [rad]."""
    gravity: np.ndarray
    """(3,) [m/s^2]."""
    lower: np.ndarray
    upper: np.ndarray
    speed: np.ndarray
    torque: np.ndarray
    """(n,) each: limits, infinite where the configuration has none."""
    gains: np.ndarray
    """(7,): dt, deceleration, largest acceleration, stiffness, damping, CoM gain, root of the CoM weight."""
    across: np.ndarray
    """(2 or 0, 3): directions across the CoM's straight line."""
    start: np.ndarray
    """(3,): a point of that line [m]."""
    momentum: np.ndarray
    """(3 or 0,): angular momentum to keep [kg m^2/s]."""


class Memory(NamedTuple):
    """What is overwritten every step."""

    reduced: Reduced
    centroid: Centroid
    frames: np.ndarray
    """(k + 1, 4, 4): the base and the contacts' joints in the world."""
    root: np.ndarray
    """(2, 3, n): K U and U of `least_distance`."""
    matrix: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    target: np.ndarray
    """Of the `Problem`."""


@numba.njit(cache=True)
def assemble(mass, bias, world, rate, q, v, fixed, memory):
    """Fill the problem's arrays. Rows: joint accelerations, torques, cones, other contacts, straight line, momentum."""
    k, n = fixed.placements.shape[0], fixed.posture.shape[0]
    dt, deceleration, largest, stiffness, damping, com_gain, weight = fixed.gains
    dyn, centre, matrix, lower, upper = memory.reduced, memory.centroid, memory.matrix, memory.lower, memory.upper
    for c in range(k):
        contact_motion(
            world, rate, v, fixed.chains[c], memory.frames[c + 1], fixed.placements[c], fixed.surfaces[c],
            stiffness, damping, dyn.jacobians[c], dyn.goals[c], dyn.errors[c],
        )  # fmt: skip
    reduce(mass, bias, dyn)
    centroidal(mass, v, memory.frames[0], fixed.gravity, dyn.supply, dyn.supply_bias, centre)
    matrix[:] = 0.0
    row = _joint_rows(q, v, fixed, dyn, deceleration, largest, dt, matrix, lower, upper)
    row = _cone_rows(fixed, dyn, matrix, lower, upper, row)
    for c in range(1, k):
        for i in range(6):
            matrix[row, :n] = dyn.relative[c, i]
            lower[row] = dyn.relative_goals[c, i]
            upper[row] = lower[row]
            row += 1
    for axis in fixed.across:
        goal = 0.0
        for i in range(3):
            goal += axis[i] * (stiffness * (fixed.start[i] - centre.com[i]) - damping * centre.velocity[i] - centre.drift[i])
            for j in range(n):
                matrix[row, j] += axis[i] * centre.jacobian[i, j]
        lower[row] = goal
        upper[row] = goal
        row += 1
    for i in range(fixed.momentum.shape[0]):
        matrix[row, :n] = centre.rate_jacobian[i]
        lower[row] = damping * (fixed.momentum[i] - centre.momentum[i]) - centre.rate_drift[i]
        upper[row] = lower[row]
        row += 1
    least_distance(centre, q[7:], v[6:], fixed.posture, com_gain, weight, memory.root, memory.target)
    _change_variables(memory.root, matrix, lower, upper, n)
    scale = np.sqrt(REGULARISATION)
    for c in range(1, k):
        for i in range(6):
            memory.target[n + 6 * (c - 1) + i] = scale * fixed.shares[c, i]


@numba.njit(cache=True)
def _joint_rows(q, v, fixed, dyn, deceleration, largest, dt, matrix, lower, upper):
    """Rows of accelerations, then of torques; returns the next row."""
    k, n = fixed.placements.shape[0], fixed.posture.shape[0]
    acceleration_bounds(q[7:], v[6:], fixed.lower, fixed.upper, fixed.speed, deceleration, largest, dt, lower[:n], upper[:n])
    for i in range(n):
        matrix[i, i] = 1.0
        matrix[n + i, :n] = dyn.inertia[i]
        for c in range(1, k):
            for m in range(6):
                matrix[n + i, n + 6 * (c - 1) + m] = -dyn.relative[c, m, i]
        lower[n + i] = -fixed.torque[i] - dyn.bias[i]
        upper[n + i] = fixed.torque[i] - dyn.bias[i]
    return 2 * n


@numba.njit(cache=True)
def _cone_rows(fixed, dyn, matrix, lower, upper, row):
    """Rows of the contacts' wrenches in their cones; returns the next row."""
    k, n = fixed.placements.shape[0], fixed.posture.shape[0]
    for r in range(CONE_ROWS):
        bound = 0.0
        for i in range(6):
            # a row of B_1 w_1, with w_1 = X'(F - sum J_ib' w_i)
            entry = 0.0
            for m in range(6):
                entry += fixed.cones[0, r, m] * dyn.inverse[i, m]
            bound -= entry * dyn.supply_bias[i]
            for j in range(n):
                matrix[row, j] += entry * dyn.supply[i, j]
            for c in range(1, k):
                for m in range(6):
                    matrix[row, n + 6 * (c - 1) + m] -= entry * dyn.jacobians[c, m, i]
        lower[row], upper[row] = -np.inf, bound
        row += 1
    for c in range(1, k):
        for r in range(CONE_ROWS):
            for m in range(6):
                matrix[row, n + 6 * (c - 1) + m] = fixed.cones[c, r, m]
            lower[row], upper[row] = -np.inf, 0.0
            row += 1
    return row


@numba.njit(cache=True)
def _change_variables(root, matrix, lower, upper, n):
    """Rows in (qdd, w_2..w_k) to rows of norm 1 in y, in place."""
    scale = 1.0 / np.sqrt(REGULARISATION)
    for row in range(matrix.shape[0]):
        first, second, third = 0.0, 0.0, 0.0
        for j in range(n):
            first += matrix[row, j] * root[1, 0, j]
            second += matrix[row, j] * root[1, 1, j]
            third += matrix[row, j] * root[1, 2, j]
        square = 0.0
        for j in range(n):
            matrix[row, j] -= first * root[0, 0, j] + second * root[0, 1, j] + third * root[0, 2, j]
            square += matrix[row, j] ** 2
        for j in range(n, matrix.shape[1]):
            matrix[row, j] *= scale
            square += matrix[row, j] ** 2
        norm = np.sqrt(square)
        for j in range(matrix.shape[1]):
            matrix[row, j] /= norm
        if lower[row] > -np.inf:
            lower[row] /= norm
        if upper[row] < np.inf:
            upper[row] /= norm


@numba.njit(cache=True)
def recover(y, memory, acceleration, torque, wrenches):
    """Joint and base accelerations, torques and wrenches from y, written in place."""
    dyn, n, k = memory.reduced, memory.root.shape[2], memory.reduced.jacobians.shape[0]
    scale = 1.0 / np.sqrt(REGULARISATION)
    along = np.zeros(3)
    for s in range(3):
        for j in range(n):
            along[s] += memory.root[1, s, j] * y[j]
    for j in range(n):
        acceleration[6 + j] = y[j]
        for s in range(3):
            acceleration[6 + j] -= memory.root[0, s, j] * along[s]
    for c in range(1, k):
        for m in range(6):
            wrenches[c, m] = scale * y[n + 6 * (c - 1) + m]
    supply = dyn.supply_bias.copy()
    for i in range(6):
        acceleration[i] = dyn.base_bias[i]
        for j in range(n):
            acceleration[i] += dyn.base[i, j] * acceleration[6 + j]
            supply[i] += dyn.supply[i, j] * acceleration[6 + j]
        for c in range(1, k):
            for m in range(6):
                supply[i] -= dyn.jacobians[c, m, i] * wrenches[c, m]
    for m in range(6):
        wrenches[0, m] = 0.0
        for i in range(6):
            wrenches[0, m] += dyn.inverse[i, m] * supply[i]
    for i in range(n):
        torque[i] = dyn.bias[i]
        for j in range(n):
            torque[i] += dyn.inertia[i, j] * acceleration[6 + j]
        for c in range(1, k):
            for m in range(6):
                torque[i] -= dyn.relative[c, m, i] * wrenches[c, m]
