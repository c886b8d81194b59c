"""Seeded random contact sets and states, as plain NumPy arrays."""

from __future__ import annotations

import numpy as np

FRICTION = 0.5
HALF_LENGTH, HALF_WIDTH = 0.10, 0.07  # [m]
TILT = 2.0 * np.arctan(FRICTION)  # largest roll and pitch of a contact [rad]
APART = 0.3  # least distance between the centres of two contacts [m]
SIDEWAYS, BELOW, ABOVE = 0.05, 0.3, 1.5  # how far the CoM may be outside the box around the contact points [m]


def rotation(roll, pitch, yaw):
    """Rz(yaw) Ry(pitch) Rx(roll), (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_y @ about_x


def rectangle(position, frame, half_length=HALF_LENGTH, half_width=HALF_WIDTH, friction=FRICTION):
    """The four corners of one contact: points (4, 3) [m], frames (4, 3, 3), friction (4,)."""
    signs = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
    local = np.column_stack([signs * [half_length, half_width], np.zeros(4)])
    frame = np.asarray(frame, float)
    return np.asarray(position, float) + local @ frame.T, np.repeat(frame[None], 4, axis=0), np.full(4, friction)


def join(*contacts):
    """One contact set from several (points, frames, friction)."""
    return tuple(np.concatenate(parts) for parts in zip(*contacts, strict=True))


def random_contacts(rng, n):
    """`n` rectangles: points (4n, 3) [m], frames (4n, 3, 3), friction (4n,).

    Centres uniform in [-0.5, 0.5] x [-0.5, 0.5] x [0, 0.5] m and at least 0.3 m apart, roll and pitch uniform within
    +-2 atan(friction), yaw uniform.
    """
    centres: list[np.ndarray] = []
    while len(centres) < n:
        centre = rng.uniform([-0.5, -0.5, 0.0], [0.5, 0.5, 0.5])
        if all(np.linalg.norm(centre - other) >= APART for other in centres):
            centres.append(centre)
    angles = rng.uniform([-TILT, -TILT, -np.pi], [TILT, TILT, np.pi], size=(n, 3))
    return join(*(rectangle(centre, rotation(*angle)) for centre, angle in zip(centres, angles, strict=True)))


def random_state(rng, points):
    """A CoM (3,) [m] around and up to 1.5 m above the contact points, and its velocity (3,) uniform in [-1, 1] m/s.

    points: (k, 3) [m]. About half of the states cannot hold their contacts even at the start (C2 at once); every case
    of the decision tree occurs in a few hundred, the hanging one (C3.3) because the CoM may be below the contacts.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    com = rng.uniform(low - np.array([SIDEWAYS, SIDEWAYS, BELOW]), high + np.array([SIDEWAYS, SIDEWAYS, ABOVE]))
    return com, rng.uniform(-1.0, 1.0, size=3)


def random_samples(rng, count):
    """`count` contact sets of 2, 3 and 4 rectangles in turn, each with a state: yields contacts, com, com_velocity."""
    for i in range(count):
        contacts = random_contacts(rng, 2 + i % 3)
        yield contacts, *random_state(rng, contacts[0])


def hinges(rng, points, first, count=3):
    """Jacobians (k, 3, count) of a chain of random hinges at the rectangle that begins with this point."""
    jacobians = np.zeros((len(points), 3, count))
    for joint in range(count):
        axis, place = rng.normal(size=3), points[first] + rng.uniform(-0.4, 0.4, 3)
        for point in range(first, first + 4):
            jacobians[point, :, joint] = np.cross(axis / np.linalg.norm(axis), points[point] - place)
    return jacobians


def limited_stance(seed=3):
    """Two feet nearly flat and a hand nearly upright beside them; three hinges to a foot, three to the hand.

    Contacts, and of the posture Jacobians (12, 3, 6), gravity torques (6,) and limits (6,) per unit mass.
    """
    rng = np.random.default_rng(seed)
    feet = [rectangle([0, side * 0.15, 0], rotation(*rng.uniform(-0.1, 0.1, 3))) for side in (-1, 1)]
    hand = rectangle([0.5, 0.1, 0.9], rotation(0, -np.pi / 2, 0) @ rotation(*rng.uniform(-0.3, 0.3, 3)), 0.04, 0.03)
    contacts = join(*feet, hand)
    jacobians = np.concatenate([hinges(rng, contacts[0], 0), hinges(rng, contacts[0], 8)], axis=2)
    # In foot and hand gravity's torque is borne by a force or by the joints.
    return contacts, (jacobians, rng.uniform(-0.3, 0.3, 6), np.array([4.0, 4.0, 4.0, 0.25, 0.25, 0.25]))


def limited_samples(rng, count):
    """Two feet nearly flat and a hand nearly upright beside them, three hinges to each, a CoM between: `count` of them.

    Yields contacts, posture (as of `limited_stance`, nine joints), com, com_velocity.
    """
    for _ in range(count):
        tilt = lambda most: rng.uniform(-most, most, 3)
        feet = [rectangle([rng.uniform(-0.1, 0.1), side * 0.15, 0], rotation(*tilt(0.2))) for side in (-1, 1)]
        hand = rectangle([0.5, rng.uniform(-0.3, 0.3), 0.9], rotation(0, -np.pi / 2, 0) @ rotation(*tilt(0.4)), 0.04, 0.03)
        contacts = join(*feet, hand)
        com = np.array([0.05, 0, 0.8]) + rng.uniform(-0.15, 0.15, 3)
        jacobians = np.concatenate([hinges(rng, contacts[0], first) for first in (0, 4, 8)], axis=2)
        posture = jacobians, rng.normal(size=9), rng.uniform(1, 6, 9)
        yield contacts, posture, com, rng.uniform(-0.8, 0.8, 3) * [1, 1, 0.3]
