"""Wrenches that the limbs of a robot in one posture can exert: by vertices and rays, on the host.

A limb is the contacts that share joints, directly or by others. Where they are on one link, its joints' torques follow from
the wrench w that they exert together, J' f = M w, whatever forces make it up, and what the limb can do is the cone of its
contacts cut by two half-spaces for each joint:

    {w: H w <= 0,  gravity_torque - limit <= M w <= gravity_torque + limit}.

Its vertices and rays are the faces of the cone that these rows span, which `projection` finds and checks.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxcap.contacts.actuation import Actuation
from jaxcap.contacts.cone import Stance
from jaxcap.contacts.projection import cone_faces

LOADS = 1e-12
"""A ray's torque on a joint below this [m] is none: the joint does not carry that contact."""
FOLLOWS = 1e-9
"""How far, relative to the largest, torques may be from what the wrench says."""
FARTHEST = 1e9
"""A vertex so far out, in robots' weights, is a ray."""
LEAST_LIMIT = 1e-3
"""Rows of a joint are scaled by its limit, or by that of gravity on an arm of this share of the stance if it is less."""


class SeveralLinksError(ValueError):
    """Torques on a limb do not follow from its wrench."""


class Limb(NamedTuple):
    """What some of the contacts can exert, in robots' weights, torques in weights times the size of the stance."""

    vertices: Float[np.ndarray, "v 6"]
    """None where the limb cannot be held in its posture, whatever it exerts."""
    rays: Float[np.ndarray, "r 6"]
    """Along which there is no limit."""


class Loads(NamedTuple):
    """Rays of contacts that touch, and what they ask of the joints that count."""

    rays: Float[np.ndarray, "k s 6"]
    """Of each contact; torques divided by the size of the stance."""
    torques: Float[np.ndarray, "j k s"]
    """Of each joint, under a unit of each ray, over the size of the stance."""
    gravity: Float[np.ndarray, " j"]
    """Torque that holds each joint, over weight and size of the stance."""
    limit: Float[np.ndarray, " j"]
    """The same of what it bears."""

    @staticmethod
    def of(stance: Stance, touching: Bool[np.ndarray, " k"], actuation: Actuation, weight: float) -> "Loads":
        """Of one posture. touching: which of its contacts are those of the stance. weight: of a unit of mass [m/s^2]."""
        length, counts = float(stance.length), np.asarray(actuation.mask)
        double = lambda field: np.asarray(field, np.float64)[..., counts]
        rays = (stance.rays / np.array([1, 1, 1, length, length, length])).reshape(int(touching.sum()), -1, 6)
        torques = np.einsum("kxj,ksx->jks", double(actuation.jacobians)[touching], rays[..., :3]) / length
        per_joint = (double(field) / (weight * length) for field in (actuation.gravity_torque, actuation.limit))
        return Loads(rays, torques, *per_joint)

    def only(self, joints: Bool[np.ndarray, " j"]) -> "Loads":
        """On some of the joints."""
        return Loads(self.rays, self.torques[joints], self.gravity[joints], self.limit[joints])

    @property
    def carries(self) -> Bool[np.ndarray, "j k"]:
        """Which joint is loaded by which contact."""
        return np.abs(self.torques).max(axis=2, initial=0) > LOADS

    @property
    def sagging(self) -> bool:
        """Whether a joint that counts, though it carries no contact, does not hold itself."""
        return bool((~self.carries.any(axis=1) & (np.abs(self.gravity) > self.limit)).any())

    def limbs(self) -> list[Limb]:
        """One for each limb.

        Raises:
            SeveralLinksError: for a limb with contacts on several links.
            ProjectionError: where its vertices do not pass their check.
        """
        labels = _labels(self.carries)
        return [self._limb(labels == label) for label in np.unique(labels)]

    def _limb(self, contacts: Bool[np.ndarray, " k"]) -> Limb:
        rays, joints = self.rays[contacts].reshape(-1, 6), np.any(self.carries[:, contacts], axis=1)
        if not joints.any():
            return Limb(np.zeros((1, 6)), rays)
        torques = self.torques[joints][:, contacts].reshape(joints.sum(), -1)
        of_wrench = np.linalg.lstsq(rays, torques.T, rcond=FOLLOWS)[0].T
        if np.abs(of_wrench @ rays.T - torques).max() > FOLLOWS * np.abs(torques).max():
            where = ", ".join(map(str, np.flatnonzero(contacts)))
            raise SeveralLinksError(
                f"actuation: contacts {where} share joints and are on several links (expected each limb to touch with one "
                f"link: cone_rays(contacts) takes others)"
            )
        gravity, limit = self.gravity[joints], self.limit[joints]
        scale = np.maximum(limit, LEAST_LIMIT)[:, None]
        above = np.concatenate([of_wrench, -(gravity + limit)[:, None]], axis=1) / scale
        below = np.concatenate([-of_wrench, (gravity - limit)[:, None]], axis=1) / scale
        cone = np.pad(cone_faces(rays), ((0, 0), (0, 1)))
        corners = cone_faces(np.concatenate([cone, above, below, -np.eye(7)[6:]]))
        far = corners[:, 6] * FARTHEST < np.linalg.norm(corners[:, :6], axis=1)
        return Limb(corners[~far, :6] / corners[~far, 6:], corners[far, :6])


def _labels(carries: Bool[np.ndarray, "j k"]) -> Int[np.ndarray, " k"]:
    """The limb of each contact, by the number of its first one."""
    labels = np.arange(carries.shape[1])
    for row in carries:
        joined = np.isin(labels, labels[row])
        labels[joined] = labels[joined].min(initial=len(labels))
    return labels
