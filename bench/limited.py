"""Simulated samples as states with contacts, a posture and its torque limits of their own."""

from typing import NamedTuple

import jax
import numpy as np

import jaxcap
from jaxcap.robots import actuation
from reference.evaluation.margins import corners
from reference.evaluation.samples import Samples
from reference.tsid.robot import Robot, load


class Limited(NamedTuple):
    """States, each with its own contacts and posture."""

    contacts: jaxcap.ContactSet
    actuation: jaxcap.Actuation
    coms: np.ndarray
    velocities: np.ndarray

    def repeated(self, n: int) -> "Limited":
        """n of them."""
        return jax.tree.map(lambda x: x[np.arange(n) % len(x)], self)

    def cast(self, dtype: str) -> "Limited":
        """In this precision."""
        return jax.tree.map(lambda x: x if x.dtype == bool else np.asarray(x, dtype), self)


def limited(samples: Samples, joints: str = "all") -> Limited:
    """The states of samples that hold their postures. joints: "all", or "arms" for those of the arms alone."""
    rows = np.flatnonzero(np.isfinite(samples.q).all(axis=1))
    contacts = jax.tree.map(lambda x: x[rows], jaxcap.ContactSet(*corners(samples.contacts)))
    posture = _postures(load(samples.robot), samples, rows, contacts, joints)
    return Limited(contacts, posture, samples.com[rows], samples.com_velocity[rows])


def _postures(
    robot: Robot, samples: Samples, rows: np.ndarray, contacts: jaxcap.ContactSet, joints: str
) -> jaxcap.Actuation:
    """Of all rows: what touches may differ from row to row, so those that are alike are made together."""
    effectors = samples.contacts.effectors[rows]
    whole: list[np.ndarray] = []
    for names in np.unique(effectors, axis=0):
        mine = np.flatnonzero((effectors == names).all(axis=1))
        frames = [robot.model.frames[robot.effectors[name].frame].name for name in names for _ in range(4)]
        sets, wanted = jax.tree.map(lambda x, mine=mine: x[mine], contacts), _wanted(robot, joints)
        found = actuation(robot.model, samples.q[rows[mine]], sets, frames, joints=wanted)
        parts = found.jacobians, found.gravity_torque, found.limit, found.mask
        if not whole:
            whole = [np.zeros((len(rows), *part.shape[1:]), part.dtype) for part in parts]
        for array, part in zip(whole, parts, strict=True):
            array[mine] = part
    return jaxcap.Actuation(*whole)


def _wanted(robot: Robot, joints: str) -> list[str]:
    """Names of joints."""
    names = list(robot.model.names)[2:]
    return [name for name in names if "arm" in name] if joints == "arms" else names
