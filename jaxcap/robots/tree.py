"""A robot's links, for many states at once: where they are and how they move.

Pinocchio takes one state a call. Here one pass over the joints, from the base outwards, takes all states of a block in
NumPy, and links, contact points and momentum come from that pass. The tests hold it against Pinocchio, state by state.

States are the last axis throughout: a vector is (3, n), a rotation (3, 3, n). So every inner loop runs along memory.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Float

Rows = Float[np.ndarray, "n _"]
Vectors = Float[np.ndarray, "3 n"]
Rotations = Float[np.ndarray, "3 3 n"]

BLOCK = 512
"""States that are computed at a time: their links fit into the cache."""


class Link(NamedTuple):
    """The frame of a joint's link in the world, in n states."""

    rotation: Rotations
    position: Vectors
    """[m]"""
    angular: Vectors
    """Angular velocity, in the world frame [rad/s]."""
    linear: Vectors
    """Velocity of the frame's origin, in the world frame [m/s]."""

    def point(self, local: Float[np.ndarray, "3"]) -> Vectors:
        """Where a point of the link is [m]. local: in the link's frame [m]."""
        return self.position + np.einsum("ijn,j->in", self.rotation, local)

    def velocity(self, point: Vectors) -> Vectors:
        """How a point that moves with the link moves [m/s]. point: in the world frame [m]."""
        return self.linear + cross(self.angular, point - self.position)


class Motion(NamedTuple):
    """What a joint does in n states: placement and velocity of its link in the frame of the joint. None: does not."""

    rotation: Rotations | None = None
    position: Vectors | None = None
    angular: Vectors | None = None
    linear: Vectors | None = None


def cross(a: Vectors, b: Vectors) -> Vectors:
    """Vector products; `np.cross` takes several times as long."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def turned(rotation: Rotations, vectors: Vectors) -> Vectors:
    """Each vector turned by its rotation."""
    return np.einsum("ijn,jn->in", rotation, vectors)


def rotations(quaternions: Float[np.ndarray, "n 4"]) -> Rotations:
    """Rotation matrices of quaternions x, y, z, w, which are normalised."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def links(model: pin.Model, q: Float[np.ndarray, "n nq"], v: Float[np.ndarray, "n nv"]) -> list[Link]:
    """The links of all joints, the world first.

    Args:
        model: Pinocchio's.
        q: (n, nq) in Pinocchio's conventions; quaternions are normalised.
        v: (n, nv) likewise.

    Returns:
        One `Link` for each joint of the model, in its order.
    """
    still = np.zeros((3, len(q)))
    found = [Link(np.repeat(np.eye(3)[..., None], len(q), axis=2), still, still, still)]
    for joint, (parent, placement) in enumerate(zip(model.parents, model.jointPlacements, strict=True)):
        if joint:
            found.append(_next(found[parent], placement, _motion(model.joints[joint], q, v)))
    return found


def _next(base: Link, placement: pin.SE3, moved: Motion) -> Link:
    """The link that a joint carries. base: that which carries the joint, at `placement` in its frame."""
    frame = np.einsum("ijn,jk->ikn", base.rotation, placement.rotation)
    origin = base.point(placement.translation)
    if moved.position is not None:
        origin = origin + turned(frame, moved.position)
    rotation = frame if moved.rotation is None else np.einsum("ijn,jkn->ikn", frame, moved.rotation)
    angular, linear = base.angular, base.velocity(origin)
    if moved.angular is not None:  # a joint's velocity is given in the frame that it carries
        angular = angular + turned(rotation, moved.angular)
    if moved.linear is not None:
        linear = linear + turned(rotation, moved.linear)
    return Link(rotation, origin, angular, linear)


def _motion(joint: Any, q: Rows, v: Rows) -> Motion:
    """What a joint does: by formula for the usual kinds, else state by state."""
    own_q, own_v = q[:, joint.idx_q : joint.idx_q + joint.nq], v[:, joint.idx_v : joint.idx_v + joint.nv]
    kind = _planar if joint.shortname() == "JointModelPlanar" else _KINDS.get((joint.nq, joint.nv), _by_pinocchio)
    return kind(joint, own_q, own_v)


def _one_axis(joint: Any, q: Rows, v: Rows) -> Motion:
    """A hinge or a slider: its axis is constant."""
    axis = _axis(joint, np.zeros(1))
    if not axis[3:].any():
        return Motion(position=np.outer(axis[:3], q), linear=np.outer(axis[:3], v))
    if axis[:3].any():
        return _by_pinocchio(joint, q, v)  # a screw
    return Motion(_about(axis[3:], np.cos(q[:, 0]), np.sin(q[:, 0])), angular=np.outer(axis[3:], v))


def _endless(joint: Any, q: Rows, v: Rows) -> Motion:
    """A hinge without limits, of which cosine and sine are given."""
    axis = _axis(joint, np.array([1.0, 0.0]))[3:]
    cosine, sine = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    return Motion(_about(axis, cosine, sine), angular=np.outer(axis, v))


def _free(joint: Any, q: Rows, v: Rows) -> Motion:
    """A base that moves freely."""
    return Motion(rotations(q[:, 3:]), q[:, :3].T, v[:, 3:].T, v[:, :3].T)


def _ball(joint: Any, q: Rows, v: Rows) -> Motion:
    """A joint that turns about any axis, of which a quaternion is given."""
    return Motion(rotations(q), angular=v.T)


def _planar(joint: Any, q: Rows, v: Rows) -> Motion:
    """A joint that moves in a plane: state by state, its cosine and sine normalised."""
    return _by_pinocchio(joint, np.concatenate([q[:, :2], q[:, 2:] / np.linalg.norm(q[:, 2:], axis=1, keepdims=True)], 1), v)


def _by_pinocchio(joint: Any, q: Rows, v: Rows) -> Motion:
    """Any joint, state by state: slow, and rare."""
    data, before_q, before_v = joint.createData(), np.zeros(joint.idx_q), np.zeros(joint.idx_v)
    rotation, position, angular, linear = np.empty((3, 3, len(q))), *(np.empty((3, len(q))) for _ in range(3))
    for i, (one_q, one_v) in enumerate(zip(q, v, strict=True)):
        joint.calc(data, np.r_[before_q, one_q], np.r_[before_v, one_v])
        moving = np.array(data.S).reshape(6, -1) @ one_v
        rotation[..., i], position[:, i] = data.M.rotation, data.M.translation
        angular[:, i], linear[:, i] = moving[3:], moving[:3]
    return Motion(rotation, position, angular, linear)


_KINDS: dict[tuple[int, int], Callable[[Any, Rows, Rows], Motion]] = {
    (1, 1): _one_axis,
    (2, 1): _endless,
    (4, 3): _ball,
    (7, 6): _free,
}
"""By the numbers of coordinates and velocities of a joint."""


def _axis(joint: Any, q: Float[np.ndarray, " k"]) -> Float[np.ndarray, "6"]:
    """The motion of a joint with one axis: linear part, angular part."""
    data = joint.createData()
    joint.calc(data, np.r_[np.zeros(joint.idx_q), q], np.zeros(joint.idx_v + 1))
    return np.array(data.S).reshape(6)


def _about(axis: Float[np.ndarray, "3"], cosine: Float[np.ndarray, " n"], sine: Float[np.ndarray, " n"]) -> Rotations:
    """Rotations about an axis of unit length (Rodrigues)."""
    x, y, z = axis
    along, across = np.outer(axis, axis)[..., None], np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])[..., None]
    return along + (np.eye(3)[..., None] - along) * cosine + across * sine
