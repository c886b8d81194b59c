"""What the controller is asked to do (Appendix D), as affine functions of the joint accelerations.

The total wrench of the contacts F (base frame) gives both rates without another Jacobian: m acc = F_linear + m g, and the
angular momentum about the CoM changes by F_angular - c x F_linear.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

POSTURE_STIFFNESS = 30.0
"""kp of the posture task [1/s^2]."""

POSTURE_DAMPING = 2.0 * math.sqrt(POSTURE_STIFFNESS)
"""kd of the posture task [1/s]."""

COM_WEIGHT = 1e3
"""Of the CoM task's squared error in the cost, that of the posture task's being 1."""


class Centroid(NamedTuple):
    """The centre of mass, world frame; arrays are overwritten every step."""

    com: np.ndarray
    """(3,) [m]."""
    velocity: np.ndarray
    """(3,) [m/s]."""
    momentum: np.ndarray
    """(3,): angular, about the CoM [kg m^2/s]."""
    jacobian: np.ndarray
    """(3, n): of the CoM's acceleration, in joint accelerations."""
    drift: np.ndarray
    """(3,): that acceleration at zero joint accelerations [m/s^2]."""
    rate_jacobian: np.ndarray
    """(3, n): of the rate of angular momentum."""
    rate_drift: np.ndarray
    """(3,) [N m]."""


@numba.njit(cache=True)
def centroid_in(store, at, joints):
    """`Centroid` for n joints in a vector, from place `at` on; returns the place after it, too."""
    n = joints
    com, velocity, momentum, at = store[at : at + 3], store[at + 3 : at + 6], store[at + 6 : at + 9], at + 9
    jacobian, drift, at = store[at : at + 3 * n].reshape((3, n)), store[at + 3 * n : at + 3 * n + 3], at + 3 * n + 3
    rate, rate_drift = store[at : at + 3 * n].reshape((3, n)), store[at + 3 * n : at + 3 * n + 3]
    return Centroid(com, velocity, momentum, jacobian, drift, rate, rate_drift), at + 3 * n + 3


@numba.njit(cache=True)
def centroidal(mass, v, base, gravity, supply, supply_bias, out):
    """Fill `out` (`Centroid`) from mass matrix, velocity, base placement (4, 4), gravity (3,), and F of `Reduced`."""
    n, total = supply.shape[1], mass[0, 0]
    c = np.array([mass[1, 5], -mass[0, 5], mass[0, 4]]) / total  # mass[:3, 3:6] = -m [c]x, c in the base frame
    linear, angular = np.zeros(3), np.zeros(3)  # momentum of the base rows, base frame
    for i in range(3):
        for j in range(v.shape[0]):
            linear[i] += mass[min(i, j), max(i, j)] * v[j]
            angular[i] += mass[min(i + 3, j), max(i + 3, j)] * v[j]
    for i in range(3):
        out.com[i] = base[i, 3] + base[i, 0] * c[0] + base[i, 1] * c[1] + base[i, 2] * c[2]
        out.velocity[i], out.momentum[i] = 0.0, 0.0
        out.drift[i], out.rate_drift[i] = gravity[i], 0.0
        for m in range(3):
            a, b = (m + 1) % 3, (m + 2) % 3
            out.velocity[i] += base[i, m] * linear[m] / total
            out.momentum[i] += base[i, m] * (angular[m] - c[a] * linear[b] + c[b] * linear[a])
            out.drift[i] += base[i, m] * supply_bias[m] / total
            out.rate_drift[i] += base[i, m] * (supply_bias[3 + m] - c[a] * supply_bias[b] + c[b] * supply_bias[a])
        for j in range(n):
            acceleration, rate = 0.0, 0.0
            for m in range(3):
                a, b = (m + 1) % 3, (m + 2) % 3
                acceleration += base[i, m] * supply[m, j]
                rate += base[i, m] * (supply[3 + m, j] - c[a] * supply[b, j] + c[b] * supply[a, j])
            out.jacobian[i, j] = acceleration / total
            out.rate_jacobian[i, j] = rate


@numba.njit(cache=True)
def least_distance(centre, joints, v, posture, stiffness, damping, com_gain, weight, root, target):
    """The two tasks' cost as a distance: |qdd - qdd_des|^2 + weight^2 |acc - acc_des|^2 = |y - target|^2 + constant.

    centre: `Centroid`. joints, v: (n,) positions and velocities. posture: (n,) to maintain, with stiffness kp [1/s^2] and
    damping kd [1/s]. com_gain: kd of the CoM task [1/s].
    The Hessian is 1 + U'U with U = weight jacobian, of rank 3; qdd = (1 + U'U)^(-1/2) y is a row-wise update of rank 3:
    (1 + U'U)^(-1/2) = 1 - U' K U with K = V diag(1 / (s (1 + s))) V', U U' = V diag(s^2 - 1) V'.
    Writes K U to root[0] and U to root[1] (3, n each), and target (n,).
    """
    n = joints.shape[0]
    u, ku = root[1], root[0]
    gram = np.zeros((3, 3))
    for i in range(3):
        for j in range(n):
            u[i, j] = weight * centre.jacobian[i, j]
    for i in range(3):
        for k in range(3):
            for j in range(n):
                gram[i, k] += u[i, j] * u[k, j]
    values, vectors = np.linalg.eigh(gram)
    scale = np.sqrt(1.0 + np.maximum(values, 0.0))
    for i in range(3):
        for j in range(n):
            ku[i, j] = 0.0
    projection = np.zeros(3)
    for i in range(3):
        for k in range(3):
            entry = 0.0
            for m in range(3):
                entry += vectors[i, m] * vectors[k, m] / (scale[m] * (1.0 + scale[m]))
            for j in range(n):
                ku[i, j] += entry * u[k, j]
            # U' (1 + U U')^(-1/2) is (1 + U'U)^(-1/2) U', without its cancellation
            wanted = -com_gain * centre.velocity[k] - centre.drift[k]
            for m in range(3):
                projection[i] += vectors[i, m] * vectors[k, m] / scale[m] * weight * wanted
    along = np.zeros(3)
    for j in range(n):
        target[j] = stiffness * (posture[j] - joints[j]) - damping * v[j]
        for i in range(3):
            along[i] += ku[i, j] * target[j]
    for j in range(n):
        for i in range(3):
            target[j] += u[i, j] * (projection[i] - along[i])
