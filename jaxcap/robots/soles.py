"""Contact patches found from a robot's collision shapes: the lowest flat face, or ball, of the links that reach lowest.

What is found is a start, not a truth: print it (`patches_yaml`), look at it, give it back corrected.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, QhullError

from jaxcap.robots.patches import ContactPatch

FLAT = 2e-3
"""Points this near to the lowest one are in one plane with it [m]."""
FEET = 0.05
"""Links that reach lower than this above the robot's lowest point are feet [m]."""
NARROWEST = 0.02
"""What is less wide is no face but the bottom of something round [m]."""
ROUND = 24
"""Points that stand for a circle."""


class _Bottom(NamedTuple):
    """The points of a link's shapes that can touch: vertices, and centres of balls."""

    points: Float[np.ndarray, "k 3"]
    """In the frame of the joint [m]."""
    radii: Float[np.ndarray, " k"]
    """[m]; 0 for a vertex."""


def find_patches(
    model: pin.Model, collisions: pin.GeometryModel, posture: Float[np.ndarray, " nq"]
) -> dict[str, ContactPatch]:
    """The patches of the links that reach lowest.

    Args:
        model: Pinocchio's.
        collisions: Its collision shapes.
        posture: (nq,) standing upright, soles flat.

    Returns:
        By the name of the link's frame: the largest rectangle inside the lowest flat face, its length along the link's x
        axis or y axis, or the lowest ball. Perhaps none.
    """
    data = model.createData()
    pin.framesForwardKinematics(model, data, posture)
    bottoms = {joint: _bottom(shapes) for joint, shapes in _by_joint(collisions)}
    lowest = {
        joint: float(_heights(bottom, data.oMi[joint]).min()) for joint, bottom in bottoms.items() if len(bottom.radii)
    }
    if not lowest:
        return {}
    ground = min(lowest.values())
    feet = [joint for joint in lowest if lowest[joint] < ground + FEET and not _carries(model, joint, lowest)]
    return {patch.frame: patch for patch in (_patch(model, data, joint, bottoms[joint]) for joint in sorted(feet))}


def _carries(model: pin.Model, joint: int, others: dict[int, float]) -> bool:
    """Whether the joint carries another with shapes that reach at least as low."""
    return any(other > joint and joint in model.supports[other] and others[other] <= others[joint] for other in others)


def _by_joint(collisions: pin.GeometryModel) -> Iterator[tuple[int, list[Any]]]:
    shapes = list(collisions.geometryObjects)
    for joint in sorted({shape.parentJoint for shape in shapes if shape.parentJoint}):
        yield joint, [shape for shape in shapes if shape.parentJoint == joint]


def _bottom(shapes: list[Any]) -> _Bottom:
    """The touching points of all shapes of a joint."""
    points, radii = [np.zeros((0, 3))], [np.zeros(0)]
    for shape in shapes:
        local, radius = _touching(shape.geometry, np.asarray(shape.meshScale).reshape(3))
        points.append(local @ shape.placement.rotation.T + shape.placement.translation)
        radii.append(np.full(len(local), radius))
    return _Bottom(np.concatenate(points), np.concatenate(radii))


def _touching(shape: Any, scale: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "k 3"], float]:
    """Points of one shape in its own frame, and the radius of the balls around them."""
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    angles = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), float(shape.radius)
    if isinstance(shape, coal.Box):
        return signs * np.asarray(shape.halfSide).reshape(3), 0.0
    if isinstance(shape, coal.Capsule):
        return np.array([[0, 0, -1.0], [0, 0, 1.0]]) * shape.halfLength, float(shape.radius)
    if isinstance(shape, coal.Cylinder):
        return np.concatenate([circle * shape.radius + (0, 0, end * shape.halfLength) for end in (-1, 1)]), 0.0
    if isinstance(shape, coal.BVHModelBase):
        return np.array(shape.vertices()).reshape(-1, 3), 0.0
    if isinstance(shape, coal.ConvexBase):
        return np.array(shape.points()).reshape(-1, 3), 0.0
    return np.zeros((0, 3)), 0.0


def _heights(bottom: _Bottom, placement: pin.SE3) -> Float[np.ndarray, " k"]:
    return bottom.points @ placement.rotation[2] + placement.translation[2] - bottom.radii


def _patch(model: pin.Model, data: pin.Data, joint: int, bottom: _Bottom) -> ContactPatch:
    """The patch of one foot, in the frame of its link."""
    frame = next(i for i, one in enumerate(model.frames) if one.parentJoint == joint and one.type == pin.FrameType.BODY)
    name, link = model.frames[frame].name, data.oMf[frame]
    height = _heights(bottom, data.oMi[joint])
    low = height < height.min() + FLAT
    world = data.oMi[joint]
    points = bottom.points[low] @ world.rotation.T + world.translation
    ahead = link.rotation[:, 0] if abs(link.rotation[2, 0]) < 0.7 else link.rotation[:, 2]
    ahead = np.array([ahead[0], ahead[1], 0.0]) / np.hypot(ahead[0], ahead[1])
    turn = np.stack([ahead, np.cross([0, 0, 1], ahead), [0, 0, 1]], axis=1)
    rectangle = _rectangle(points @ turn[:, :2])
    if rectangle is None:
        return _ball(name, link, points, bottom.radii[low])
    (x, y), (half_x, half_y) = rectangle
    if half_y > half_x:
        turn, x, y, half_x, half_y = turn @ [[0, -1, 0], [1, 0, 0], [0, 0, 1]], y, -x, half_y, half_x
    centre = turn @ [x, y, 0] + (0, 0, height.min())
    local = link.actInv(centre)
    rotation = link.rotation.T @ turn
    return ContactPatch(name, _rounded(local), tuple(map(_rounded, rotation)), round(half_x, 6), round(half_y, 6))


def _ball(name: str, link: pin.SE3, points: Float[np.ndarray, "k 3"], radii: Float[np.ndarray, " k"]) -> ContactPatch:
    """A foot without a flat face."""
    lowest = points[np.isclose(radii, radii.max())].mean(axis=0)
    return ContactPatch(name, _rounded(link.actInv(lowest)), radius=round(float(radii.max()), 6))


def _rectangle(points: Float[np.ndarray, "k 2"]) -> tuple[Float[np.ndarray, "2"], tuple[float, float]] | None:
    """Centre and half sides of the largest rectangle along the axes inside the hull of the points; None if there is no
    face.
    """
    if len(points) < 3 or np.ptp(points, axis=0).min() < NARROWEST:
        return None
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    normals, offsets = hull.equations[:, :2], hull.equations[:, 2]
    middle, size = points[hull.vertices].mean(axis=0), np.ptp(points, axis=0)
    room = lambda x: -(normals @ x[:2] + np.abs(normals) @ np.exp(x[2:]) + offsets)  # all four corners inside every edge
    start = np.r_[middle, np.log(size / 20)]
    found = minimize(lambda x: -x[2] - x[3], start, constraints={"type": "ineq", "fun": room}, method="SLSQP", tol=1e-12)
    half = np.exp(found.x[2:])
    return None if 2 * half.min() < NARROWEST else (found.x[:2], (float(half[0]), float(half[1])))


def _rounded(numbers: Float[np.ndarray, " k"]) -> Any:
    """To a micrometre, and no negative zeros."""
    return tuple(round(float(number), 6) + 0.0 for number in numbers)
