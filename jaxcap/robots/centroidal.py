"""Robot states (q, v) to centre of mass, its velocity and angular momentum, for many states at once.

Conventions are Pinocchio's. A configuration q of a free-flying robot starts with the base position in the world frame
[m] and the base orientation as a unit quaternion in the order x, y, z, w; joint angles [rad] follow. A velocity v
starts with the linear [m/s] and angular [rad/s] velocity of the base in the LOCAL frame of the base; joint velocities
[rad/s] follow. What comes out is in the world frame, z up. Data recorded elsewhere (MuJoCo: w, x, y, z) has to be
converted first, as `jaxcap.robots.states` does by the layout of a log.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from jaxcap.contacts.conventions import ArrayLike
from jaxcap.robots.tree import BLOCK, Link, cross, links, turned

UNIT_NORM = 1e-4
"""Largest deviation from 1 of the norm of a quaternion, for single precision and text files; normalised on use."""

UNIT_TAIL = {"JointModelFreeFlyer": 4, "JointModelSpherical": 4, "JointModelPlanar": 2}
"""How many of a joint's last coordinates form a unit vector."""


class CentroidalStates(NamedTuple):
    """What the predictor needs of n robot states, and the angular momentum that it neglects. World frame, float64."""

    com: Float[np.ndarray, "n 3"]
    """Centre of mass [m]."""
    com_velocity: Float[np.ndarray, "n 3"]
    """[m/s]."""
    angular_momentum: Float[np.ndarray, "n 3"]
    """About the centre of mass [kg m^2/s]."""


def centroidal_states(model: pin.Model, configurations: ArrayLike, velocities: ArrayLike) -> CentroidalStates:
    """Centre of mass, its velocity and the angular momentum about it, of n robot states.

    Quaternions in the wrong order and base velocities in the world frame cannot be seen here: see `convention_error`.

    Args:
        model: Pinocchio's.
        configurations: (n, nq), in the conventions at the head of this module.
        velocities: (n, nv), likewise.

    Raises:
        ValueError: Naming field and row for a wrong shape, a value that is not finite, a quaternion not of unit norm.
    """
    configurations = rows_of("configurations", configurations, "nq", model.nq)
    velocities = rows_of("velocities", velocities, "nv", model.nv)
    if len(configurations) != len(velocities):
        raise ValueError(f"velocities has {len(velocities)} rows (expected {len(configurations)}, as configurations)")
    check_units(model, configurations)
    out = CentroidalStates(*(np.empty((len(configurations), 3)) for _ in CentroidalStates._fields))
    for first in range(0, len(configurations), BLOCK):
        rows = slice(first, first + BLOCK)
        states = momentum(model, links(model, configurations[rows], velocities[rows]))
        for whole, part in zip(out, states, strict=True):
            whole[rows] = part
    return out


def momentum(model: pin.Model, found: Sequence[Link]) -> CentroidalStates:
    """Centre of mass, its velocity and angular momentum of a block of states.

    Args:
        model: Pinocchio's.
        found: What `links` gives for it.
    """
    bodies = [(link, inertia) for link, inertia in zip(found[1:], list(model.inertias)[1:], strict=True) if inertia.mass]
    coms = [link.point(inertia.lever) for link, inertia in bodies]
    speeds = [link.velocity(com) for (link, _), com in zip(bodies, coms, strict=True)]
    total = sum(inertia.mass for _, inertia in bodies)
    weighed = lambda vectors: sum(inertia.mass / total * each for (_, inertia), each in zip(bodies, vectors, strict=True))
    com, com_velocity = weighed(coms), weighed(speeds)
    angular = np.zeros_like(com)
    for (link, inertia), place, speed in zip(bodies, coms, speeds, strict=True):
        spin = np.einsum("ij,jn->in", inertia.inertia, np.einsum("jin,jn->in", link.rotation, link.angular))
        angular += turned(link.rotation, spin) + inertia.mass * cross(place - com, speed - com_velocity)
    return CentroidalStates(com.T, com_velocity.T, angular.T)


def convention_error(
    model: pin.Model, configurations: ArrayLike, velocities: ArrayLike, dt: float
) -> Float[np.ndarray, "n"]:
    """How far a recorded trajectory's velocities are from its configurations, row by row.

    It shrinks with dt^2 where velocities and configurations belong together. Where they do not (base velocity in the
    world frame, quaternion w first, joint velocities in an order of their own) it is of the order of the speed, if the
    base is turned. It cannot see what is wrong in both alike: joints permuted or in degrees in both, an upright base with
    the quaternion w first. `jaxcap.robots.states` looks at joint limits, soles and the base for that.

    Args:
        model: Pinocchio's.
        configurations: (n, nq) at equal steps, n >= 3.
        velocities: (n, nv) at the same times.
        dt: Those steps [s].

    Returns:
        The distance [m/s] between the CoM velocity and the difference of the CoM, (n,): central, and one-sided of second
        order in the first and the last row.

    Raises:
        ValueError: As `centroidal_states`; also for fewer than three rows, and a step that is not positive.
    """
    if not (np.ndim(dt) == 0 and np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt = {dt} (expected a positive number of seconds)")
    states = centroidal_states(model, configurations, velocities)
    if len(states.com) < 3:
        raise ValueError(f"configurations has {len(states.com)} rows (expected at least 3 for a central difference)")
    return np.linalg.norm(np.gradient(states.com, dt, axis=0, edge_order=2) - states.com_velocity, axis=1)


def rows_of(name: str, value: ArrayLike, symbol: str, size: int) -> Float[np.ndarray, "n size"]:
    """`value` as float64 rows of this size, or ValueError."""
    array = np.asarray(value)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} has dtype {array.dtype} (expected numbers)")
    if array.ndim != 2 or array.shape[1] != size:
        raise ValueError(f"{name} has shape {array.shape} (expected (n, {size}): {symbol} = {size})")
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        row, column = map(int, bad[0])
        raise ValueError(f"{name}[{row}, {column}] = {array[row, column]} (expected a finite number)")
    return np.ascontiguousarray(array, dtype=np.float64)


def check_units(model: pin.Model, configurations: Float[np.ndarray, "n nq"]) -> None:
    """ValueError for the first quaternion, or sine and cosine of an unbounded joint, that is not of unit norm."""
    for name, joint in zip(model.names, model.joints, strict=True):
        tail = UNIT_TAIL.get(joint.shortname(), 2 if (joint.nq, joint.nv) == (2, 1) else 0)
        end = joint.idx_q + joint.nq
        norm = np.linalg.norm(configurations[:, end - tail : end], axis=1)
        bad = np.flatnonzero((np.abs(norm - 1) > UNIT_NORM) & (tail > 0))
        if len(bad):
            row = int(bad[0])
            what = "quaternion (x, y, z, w)" if tail == 4 else "cosine and sine"
            raise ValueError(
                f"configurations[{row}, {end - tail}:{end}]: {what} of {name} has norm {norm[row]:.6g} "
                f"(expected 1 within {UNIT_NORM:g})"
            )
