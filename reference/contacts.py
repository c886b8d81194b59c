"""From contacts to wrench rays: (3), and (5) in generator form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

GRAVITY = (0.0, 0.0, -9.81)  # [m/s^2]


class Wrenches(NamedTuple):
    """The centroidal cone of a contact set by its generators: w = rays @ weights, weights >= 0.

    Beyond the paper: less a moment (y1, y2, y3) with |yi| <= box, by which the robot's angular momentum may change besides.
    """

    rays: np.ndarray  # (6, k * sides): unit force [-] above its moment about `origin` [m]
    origin: np.ndarray  # (3,): the contacts' centroid [m], to which CoM positions must be shifted before use
    box: float = 0.0  # per unit mass [m^2/s^2]


def pyramid_edges(frames, friction, sides=4):
    """Unit edges of the pyramids inscribed in the friction cones (4).

    frames: (k, 3, 3), third column the normal, pointing at the robot, first column a tangent. friction: (k,) [-].
    Edge j lies at the angle pi/sides + 2 pi j/sides from the first tangent: n + mu (cos t1 + sin t2), normalised.
    Returns (k, sides, 3). A force is admissible, B f <= 0 in (5), if and only if it is a combination of its contact's
    edges with nonnegative weights: (5) in generator form, which needs no B.
    """
    frames, friction = np.asarray(frames, float), np.asarray(friction, float)
    angles = np.pi / sides + 2.0 * np.pi * np.arange(sides) / sides
    first, second, normal = (frames[:, None, :, column] for column in range(3))
    tangent = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * second
    edges = normal + friction[:, None, None] * tangent
    return edges / np.linalg.norm(edges, axis=2, keepdims=True)


def grasp_matrix(points):
    """A of (3): (6, 3k), stacked contact forces to centroidal wrench. points: (k, 3) [m]."""
    blocks = []
    for x, y, z in np.asarray(points, float):
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        blocks.append(np.vstack([np.eye(3), cross]))
    return np.hstack(blocks)


def wrench_rays(points, frames, friction, sides=4):
    """Generators A f of the centroidal cone, f over all pyramid edges, moments about the contacts' centroid.

    points: (k, 3) [m]. frames: (k, 3, 3). friction: (k,) [-], > 0. Returns `Wrenches`.
    Raises ValueError if there is no contact, or if there are fewer than 3 sides.
    """
    points = np.asarray(points, float)
    if len(points) == 0 or sides < 3:
        raise ValueError(f"expected at least 1 point and 3 sides, got {len(points)} points and {sides} sides")
    origin = points.mean(axis=0)
    edges = pyramid_edges(frames, friction, sides)
    stacked = np.zeros((3 * len(points), len(points) * sides))
    for i, edge in enumerate(edges):
        stacked[3 * i : 3 * i + 3, i * sides : (i + 1) * sides] = edge.T
    return Wrenches(grasp_matrix(points - origin) @ stacked, origin)
