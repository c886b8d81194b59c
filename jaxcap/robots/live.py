"""Contacts and centroidal state of a live MuJoCo simulation. MuJoCo itself is not imported: its two structs are read.

MuJoCo's contact frame has the normal in its first row, pointing from the first geom to the second; ours has it in the third
column, pointing at the robot. qvel has the base's linear velocity in the world, its angular velocity along its own axes.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.errors import InputError


class LiveStates(NamedTuple):
    """What is scored of n states of a simulation. World frame."""

    contacts: ContactSet
    """(n, k): those of each state; those that are not there are masked."""
    com: Float[np.ndarray, "n 3"]
    """[m]"""
    com_velocity: Float[np.ndarray, "n 3"]
    """[m/s]"""


def from_mujoco(model: Any, data: Any, body: int | str = 1, trajectory: Any = None, forward: Any = None) -> LiveStates:
    """Contact sets, CoM and velocity of MuJoCo states, as `jaxcap.cone_rays` and `jaxcap.score` take them.

    Contacts are those between the robot and what is not the robot, that press or touch (distance not positive).

    Args:
        model: `mujoco.MjModel`.
        data: `mujoco.MjData` after `mj_forward` or `mj_step`.
        body: The robot's root body, by number or name; all bodies below it are the robot.
        trajectory: (n, nq + nv), qpos and qvel of each state, or None for the state in `data`. `data` is changed.
        forward: `mujoco.mj_forward`, needed for a trajectory.

    Returns:
        One state, n = 1, or those of the trajectory.

    Raises:
        InputError: For a body that is not there, and a trajectory of another shape or without `forward`.
    """
    root = _body(model, body)
    if trajectory is None:
        return _stacked([_state(model, data, root)])
    rows = np.asarray(trajectory, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != model.nq + model.nv or forward is None:
        raise InputError(
            f"trajectory has shape {rows.shape} (expected (n, {model.nq + model.nv}), and forward=mujoco.mj_forward)"
        )
    found = []
    for row in rows:
        data.qpos[:], data.qvel[:] = row[: model.nq], row[model.nq :]
        forward(model, data)
        found.append(_state(model, data, root))
    return _stacked(found)


def _body(model: Any, body: int | str) -> int:
    """The number of a body."""
    if isinstance(body, str):
        try:
            return int(model.body(body).id)
        except KeyError as error:
            raise InputError(f"body {body!r} is not there ({error})") from error
    if not 0 < body < model.nbody:
        raise InputError(f"body = {body} (expected 1 to {model.nbody - 1})")
    return body


def _state(model: Any, data: Any, root: int) -> LiveStates:
    """Of one state, without the leading axis."""
    mine = _below(model, root)
    masses = np.where(mine, model.body_mass, 0.0)
    com = masses @ data.xipos / masses.sum()
    velocity = sum(mass * _velocity(model, data, number) for number, mass in enumerate(masses) if mass) / masses.sum()
    return LiveStates(_touching(model, data, mine), com, velocity)


def _below(model: Any, root: int) -> Bool[np.ndarray, " b"]:
    """The bodies that the root carries, itself too."""
    mine = np.zeros(model.nbody, dtype=bool)
    mine[root] = True
    for number in range(root + 1, model.nbody):
        mine[number] = mine[model.body_parentid[number]]
    return mine


def _velocity(model: Any, data: Any, number: int) -> Float[np.ndarray, "3"]:
    """Velocity of a body's centre of mass: `cvel` is angular, then linear at the centre of mass of the whole tree."""
    twist, centre = data.cvel[number], data.subtree_com[model.body_rootid[number]]
    return twist[3:] + np.cross(twist[:3], data.xipos[number] - centre)


def _touching(model: Any, data: Any, mine: Bool[np.ndarray, " b"]) -> ContactSet:
    """The contacts of the robot with the rest of the world."""
    points, frames, friction = [], [], []
    for contact in data.contact[: data.ncon]:
        first, second = (mine[model.geom_bodyid[geom]] for geom in np.asarray(contact.geom).reshape(2))
        if first == second or contact.dist > 0:
            continue
        normal, tangent, _ = np.asarray(contact.frame).reshape(3, 3)
        if first:
            normal = -normal  # it points from the first geom to the second, and that is not the robot
        points.append(np.array(contact.pos))
        frames.append(np.stack([tangent, np.cross(normal, tangent), normal], axis=1))
        friction.append(float(contact.friction[0]))
    k = len(points)
    arrays = np.array(points).reshape(k, 3), np.array(frames).reshape(k, 3, 3), np.array(friction).reshape(k)
    return ContactSet.unchecked(*arrays, np.ones(k, dtype=bool))


def _stacked(found: list[LiveStates]) -> LiveStates:
    """Padded to the most contacts; unchecked, or a contact without friction would cost the other states."""
    k, n = max(1, *(len(state.contacts) for state in found)), len(found)
    points, frames = np.zeros((n, k, 3)), np.tile(np.eye(3), (n, k, 1, 1))
    friction, mask = np.ones((n, k)), np.zeros((n, k), dtype=bool)
    for i, state in enumerate(found):
        for whole, part in zip((points, frames, friction, mask), jax.tree.leaves(state.contacts), strict=True):
            whole[i, : len(part)] = part
    coms, velocities = (np.array([getattr(state, name) for state in found]) for name in ("com", "com_velocity"))
    return LiveStates(ContactSet.unchecked(points, frames, friction, mask), coms, velocities)
