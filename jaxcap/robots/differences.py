"""Velocities from configurations: differences on the Lie group, inside an episode.

In the middle central differences, at both ends one-sided ones. The base is differentiated as position and orientation, its
velocity is along its own axes at that row.
"""

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

POLYNOMIAL = 3
"""Degree of the polynomials of the Savitzky-Golay filter."""


def differences(
    model: pin.Model, time: Float[np.ndarray, " n"], configurations: Float[np.ndarray, "n nq"]
) -> Float[np.ndarray, "n nv"]:
    """Velocities by differences.

    Args:
        model: Pinocchio's, with a floating base.
        time: (n,) increasing [s].
        configurations: (n, nq).

    Returns:
        (n, nv) in Pinocchio's conventions; zeros for a single row.
    """
    n = len(time)
    v = np.zeros((n, model.nv))
    if n < 2:
        return v
    before, after = np.r_[0, np.arange(n - 1)], np.r_[np.arange(1, n), n - 1]
    elapsed = (time[after] - time[before])[:, None]
    turned = Rotation.from_quat(configurations[:, 3:7])
    moved = configurations[after, :3] - configurations[before, :3]
    v[:, :3] = turned.inv().apply(moved) / elapsed
    v[:, 3:6] = (turned[before].inv() * turned[after]).as_rotvec() / elapsed
    for joint in list(model.joints)[2:]:
        q = configurations[:, joint.idx_q : joint.idx_q + joint.nq]
        angle = np.unwrap(np.arctan2(q[:, 1], q[:, 0])) if joint.nq == 2 else q[:, 0]
        v[:, joint.idx_v] = (angle[after] - angle[before]) / elapsed[:, 0]
    return v


def smoothed(velocities: Float[np.ndarray, "n nv"], window: int) -> Float[np.ndarray, "n nv"]:
    """A Savitzky-Golay filter over rows at equal steps. window: rows, odd; fewer where there are fewer; 0 or 1: none."""
    window = min(window, len(velocities) - (len(velocities) + 1) % 2)
    if window <= POLYNOMIAL:
        return velocities
    return savgol_filter(velocities, window, POLYNOMIAL, axis=0)
