"""The controller's QP in numbers: rows, bounds and target, written in place at every step.

`Fixed` and `Memory` have forty arrays, and handing an array to compiled code costs as much as a hundred products. So all of
them lie in two stores, vectors that are handed over whole; `fixed_in` and `memory_in` find the arrays there.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from reference.tsid.dynamics import Reduced, contact_motion, reduce, reduced_in
from reference.tsid.limits import acceleration_bounds
from reference.tsid.tasks import Centroid, centroid_in, centroidal, least_distance

CONE_ROWS = 16

GAINS = 9

REGULARISATION = 1e-6
"""Weight of |w|^2 [1/N^2, 1/(N m)^2] in the cost: internal forces have no cost in (30). The wrenches of all contacts but the
first are drawn to an equal share of the weight."""


class Fixed(NamedTuple):
    """What does not change while a robot is controlled."""

    placements: np.ndarray
    """(k, 4, 4): of the contacts in those joints."""
    chains: np.ndarray
    """(k, nv): 1 where a velocity moves the contact, else 0."""
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
    """(9,): dt, deceleration, largest acceleration; stiffness and damping of the contacts, then of the posture; gain of the
    CoM, root of its weight."""
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


class Sizes(NamedTuple):
    """Of the arrays in a store."""

    contacts: int
    joints: int
    lines: int
    """Rows that keep the CoM on its line: 2 or 0."""
    momenta: int
    """Rows that keep the angular momentum: 3 or 0."""

    @property
    def rows(self) -> int:
        """Of the problem."""
        return 2 * self.joints + CONE_ROWS * self.contacts + 6 * (self.contacts - 1) + self.lines + self.momenta


@numba.njit(cache=True)
def fixed_in(store, contacts, joints, lines, momenta):
    """`Fixed` in a vector that holds its arrays one after the other."""
    k, n, at = contacts, joints, 0
    placements, at = store[at : at + 16 * k].reshape((k, 4, 4)), at + 16 * k
    chains, at = store[at : at + k * (n + 6)].reshape((k, n + 6)), at + k * (n + 6)
    surfaces, at = store[at : at + 16 * k].reshape((k, 4, 4)), at + 16 * k
    cones, at = store[at : at + 6 * CONE_ROWS * k].reshape((k, CONE_ROWS, 6)), at + 6 * CONE_ROWS * k
    shares, at = store[at : at + 6 * k].reshape((k, 6)), at + 6 * k
    posture, at = store[at : at + n], at + n
    gravity, at = store[at : at + 3], at + 3
    lower, upper, at = store[at : at + n], store[at + n : at + 2 * n], at + 2 * n
    speed, torque, at = store[at : at + n], store[at + n : at + 2 * n], at + 2 * n
    gains, at = store[at : at + GAINS], at + GAINS
    across, at = store[at : at + 3 * lines].reshape((lines, 3)), at + 3 * lines
    start, momentum = store[at : at + 3], store[at + 3 : at + 3 + momenta]
    return Fixed(
        placements, chains, surfaces, cones, shares, posture, gravity, lower, upper, speed, torque, gains, across, start,
        momentum,
    )  # fmt: skip


@numba.njit(cache=True)
def memory_in(store, contacts, joints, rows):
    """`Memory` in a vector of at least `memory_size` numbers."""
    k, n = contacts, joints
    size = n + 6 * (k - 1)
    dyn, at = reduced_in(store, 0, k, n)
    centre, at = centroid_in(store, at, n)
    frames, at = store[at : at + 16 * (k + 1)].reshape((k + 1, 4, 4)), at + 16 * (k + 1)
    root, at = store[at : at + 6 * n].reshape((2, 3, n)), at + 6 * n
    matrix, at = store[at : at + rows * size].reshape((rows, size)), at + rows * size
    lower, upper, at = store[at : at + rows], store[at + rows : at + 2 * rows], at + 2 * rows
    return Memory(dyn, centre, frames, root, matrix, lower, upper, store[at : at + size])


def memory_size(contacts: int, joints: int, rows: int) -> int:
    """Numbers that `memory_in` needs."""
    k, n = contacts, joints
    size = n + 6 * (k - 1)
    dyn = k * 6 * (n + 6) + 12 * k + 36 + 6 * n + 6 + n * n + n + 6 * k * n + 6 * k + 6 * n + 6
    return dyn + 15 + 6 * n + 16 * (k + 1) + 6 * n + rows * size + 2 * rows + size


@numba.njit(cache=True)
def assemble(mass, bias, world, rate, q, v, fixed_store, memory_store, contacts, joints, lines, momenta, rows):
    """Fill the problem's arrays. Rows: joint accelerations, torques, cones, other contacts, straight line, momentum.

    Returns how far the contact that moved most is from its place [m].
    """
    fixed = fixed_in(fixed_store, contacts, joints, lines, momenta)
    memory = memory_in(memory_store, contacts, joints, rows)
    k, n = contacts, joints
    dt, deceleration, largest, stiffness, damping, posture_stiffness, posture_damping, com_gain, weight = fixed.gains
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
    for line in range(lines):
        axis, goal = fixed.across[line], 0.0
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
    least_distance(
        centre, q[7:], v[6:], fixed.posture, posture_stiffness, posture_damping, com_gain, weight, memory.root, memory.target
    )  # fmt: skip
    _change_variables(memory.root, matrix, lower, upper, n)
    scale = np.sqrt(REGULARISATION)
    for c in range(1, k):
        for i in range(6):
            memory.target[n + 6 * (c - 1) + i] = scale * fixed.shares[c, i]
    farthest = 0.0
    for c in range(k):
        farthest = max(farthest, dyn.errors[c, 0] ** 2 + dyn.errors[c, 1] ** 2 + dyn.errors[c, 2] ** 2)
    return np.sqrt(farthest)


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
def recover(y, memory_store, contacts, joints, rows, acceleration, torque, wrenches):
    """Joint and base accelerations, torques and wrenches from y, written in place."""
    memory = memory_in(memory_store, contacts, joints, rows)
    dyn, n, k = memory.reduced, joints, contacts
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
