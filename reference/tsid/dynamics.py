"""A robot with fixed contacts, seen from the first of them.

The first contact does not accelerate but for its stabilisation, so the base accelerations follow from the joints':
dv = T qdd + t, T = [P; 1]. That leaves the n joint accelerations qdd and the wrenches w_2..w_k as variables:

    torques        tau = T'(M dv + h - sum J_i' w_i) = inertia qdd + bias - sum_{i>1} R_i' w_i,    R_i = J_i T
    other contacts R_i qdd = goal_i - J_i t
    first wrench   w_1 = X'(F - sum_{i>1} J_ib' w_i),   X = J_1b^-1
    total wrench   F = supply qdd + supply_bias,   what all contacts supply: base rows of M dv + h, base frame

which is (30) without its torques, base accelerations and first wrench: same feasible set, same optimum. The robot's order of
contacts is that of the sample; which is first changes rounding only.
All motions are (linear, angular); a contact's in its own frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np


class Reduced(NamedTuple):
    """The equations above for k contacts, n joints, nv = n + 6; arrays are overwritten every step."""

    jacobians: np.ndarray
    """(k, 6, nv): J_i."""
    goals: np.ndarray
    """(k, 6): acceleration that each contact is to have, less what velocities alone give it [m/s^2, rad/s^2]."""
    errors: np.ndarray
    """(k, 6): displacement of each contact from where it should be [m, rad]."""
    inverse: np.ndarray
    """(6, 6): X."""
    base: np.ndarray
    """(6, n): P."""
    base_bias: np.ndarray
    """(6,): base rows of t; its other rows are zero."""
    inertia: np.ndarray
    """(n, n) [kg m^2]."""
    bias: np.ndarray
    """(n,) [N m]."""
    relative: np.ndarray
    """(k, 6, n): R_i; the first is zero."""
    relative_goals: np.ndarray
    """(k, 6): goal_i - J_i t."""
    supply: np.ndarray
    """(6, n) [kg, kg m]."""
    supply_bias: np.ndarray
    """(6,) [N, N m]."""


@numba.njit(cache=True)
def reduced_in(store, at, contacts, joints):
    """`Reduced` for k contacts and n joints in a vector, from place `at` on; returns the place after it, too."""
    k, n = contacts, joints
    jacobians, at = store[at : at + k * 6 * (n + 6)].reshape((k, 6, n + 6)), at + k * 6 * (n + 6)
    goals, errors, at = store[at : at + 6 * k], store[at + 6 * k : at + 12 * k], at + 12 * k
    inverse, at = store[at : at + 36].reshape((6, 6)), at + 36
    base, base_bias, at = store[at : at + 6 * n].reshape((6, n)), store[at + 6 * n : at + 6 * n + 6], at + 6 * n + 6
    inertia, bias, at = store[at : at + n * n].reshape((n, n)), store[at + n * n : at + n * n + n], at + n * n + n
    relative, at = store[at : at + 6 * k * n].reshape((k, 6, n)), at + 6 * k * n
    relative_goals, at = store[at : at + 6 * k].reshape((k, 6)), at + 6 * k
    supply, supply_bias = store[at : at + 6 * n].reshape((6, n)), store[at + 6 * n : at + 6 * n + 6]
    goals, errors = goals.reshape((k, 6)), errors.reshape((k, 6))
    found = Reduced(
        jacobians, goals, errors, inverse, base, base_bias, inertia, bias, relative, relative_goals, supply, supply_bias
    )
    return found, at + 6 * n + 6


@numba.njit(cache=True)
def contact_motion(world, rate, v, chain, joint, placement, fixed, stiffness, damping, jacobian, goal, error):
    """Jacobian (6, nv), goal (6,) and error (6,) of one contact.

    world, rate: (6, nv) Jacobian of all joints and its time derivative, at the world's origin. chain: (nv,) 1 for columns
    that move the contact, else 0. joint: (4, 4), the link's joint in the world; placement: (4, 4), the contact in that
    joint; fixed: (4, 4), where the contact should be in the world.
    stiffness [1/s^2], damping [1/s]: of Baumgarte's stabilisation, goal = -stiffness error - damping velocity - rate v.
    """
    at = np.empty((3, 4))
    for i in range(3):
        for j in range(4):
            total = joint[i, 3] if j == 3 else 0.0
            for k in range(3):
                total += joint[i, k] * placement[k, j]
            at[i, j] = total
    x, y, z = at[0, 3], at[1, 3], at[2, 3]
    velocity = np.zeros(6)
    drift = np.zeros(6)
    column = np.empty(6)
    for j in range(world.shape[1]):
        if chain[j] == 0.0:
            continue
        for derivative in range(2):
            source = rate if derivative else world
            wx, wy, wz = source[3, j], source[4, j], source[5, j]
            vx, vy, vz = source[0, j] - y * wz + z * wy, source[1, j] - z * wx + x * wz, source[2, j] - x * wy + y * wx
            for i in range(3):
                column[i] = at[0, i] * vx + at[1, i] * vy + at[2, i] * vz
                column[3 + i] = at[0, i] * wx + at[1, i] * wy + at[2, i] * wz
            for i in range(6):
                if derivative:
                    drift[i] += column[i] * v[j]
                else:
                    jacobian[i, j] = column[i]
                    velocity[i] += column[i] * v[j]
    turned = np.empty((3, 3))  # rotation of the contact, seen from where it should be
    for i in range(3):
        total = 0.0
        for k in range(3):
            total += at[k, i] * (at[k, 3] - fixed[k, 3])
        error[i] = total
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += fixed[k, i] * at[k, j]
            turned[i, j] = total
    error[3] = 0.5 * (turned[2, 1] - turned[1, 2])  # sine of the angle times the axis: small, or the contact is lost
    error[4] = 0.5 * (turned[0, 2] - turned[2, 0])
    error[5] = 0.5 * (turned[1, 0] - turned[0, 1])
    for i in range(6):
        goal[i] = -drift[i] - damping * velocity[i] - stiffness * error[i]


@numba.njit(cache=True)
def reduce(mass, bias, out):
    """Fill the rest of `out` (`Reduced`) from the upper triangle of the mass matrix (nv, nv) and the bias h (nv,)."""
    k, n = out.jacobians.shape[0], out.base.shape[1]
    out.inverse[:] = np.linalg.inv(np.ascontiguousarray(out.jacobians[0, :, :6]))
    first, base, t = out.jacobians[0], out.base, out.base_bias
    moving = np.zeros(n, dtype=np.bool_)  # joints between base and first contact: P is zero for the others
    for j in range(n):
        for i in range(6):
            moving[j] |= first[i, 6 + j] != 0.0
    for i in range(6):
        t[i] = 0.0
        for m in range(6):
            t[i] += out.inverse[i, m] * out.goals[0, m]
        for j in range(n):
            total = 0.0
            if moving[j]:
                for m in range(6):
                    total -= out.inverse[i, m] * first[m, 6 + j]
            base[i, j] = total
    for i in range(6):
        total = bias[i]
        for m in range(6):
            total += mass[min(i, m), max(i, m)] * t[m]
        out.supply_bias[i] = total
        for j in range(n):
            total = mass[i, 6 + j]
            if moving[j]:
                for m in range(6):
                    total += mass[min(i, m), max(i, m)] * base[m, j]
            out.supply[i, j] = total
    for i in range(n):
        total = bias[6 + i]
        for m in range(6):
            total += mass[m, 6 + i] * t[m] + base[m, i] * out.supply_bias[m]
        out.bias[i] = total
        for j in range(i, n):
            total = mass[6 + i, 6 + j]
            if moving[j]:
                for m in range(6):
                    total += mass[m, 6 + i] * base[m, j]
            if moving[i]:
                for m in range(6):
                    total += base[m, i] * out.supply[m, j]
            out.inertia[i, j] = total
            out.inertia[j, i] = total
    for c in range(1, k):
        jacobian = out.jacobians[c]
        for i in range(6):
            total = out.goals[c, i]
            for m in range(6):
                total -= jacobian[i, m] * t[m]
            out.relative_goals[c, i] = total
            for j in range(n):
                total = jacobian[i, 6 + j]
                if moving[j]:
                    for m in range(6):
                        total += jacobian[i, m] * base[m, j]
                out.relative[c, i, j] = total
