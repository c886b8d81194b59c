"""Contact sets and states that a fuzz run draws: kinds that robots meet and kinds that break programs. All is seeded.

A kind is a function of a random generator; it returns a set of at most eight contacts about one metre wide. `draw` then
scales it (1 mm to 10 m), turns it about the vertical, shifts it, and draws states for it. None of this shares a line with
the samplers in `tests/`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

CONTACTS = 8
"""Most contacts of a set."""
UP = np.array([0.0, 0.0, 1.0])
FRICTION = (0.01, 3.0)
SIDES = (3, 16)
WIDTHS = (1e-3, 10.0)
"""[m]"""
SPEEDS = (1e-4, 10.0)
"""[m/s]"""


class Sample(NamedTuple):
    """A contact set of k contacts, and n states on it."""

    kind: str
    index: int
    sides: int
    points: np.ndarray
    """(k, 3) [m]"""
    frames: np.ndarray
    """(k, 3, 3), third column the normal."""
    friction: np.ndarray
    """(k,)"""
    coms: np.ndarray
    """(n, 3) [m]"""
    velocities: np.ndarray
    """(n, 3) [m/s]"""

    def rounded(self, dtype: str) -> Sample:
        """The numbers that a program of this precision reads, in double precision."""
        to = lambda array: array.astype(dtype).astype(np.float64)
        return self._replace(**{name: to(getattr(self, name)) for name in self._fields[3:]})


def draw(seed: int, index: int, kind: str, states: int) -> Sample:
    """The contact set of this number, and states on it: the same for the same arguments, whatever was drawn before."""
    rng = np.random.default_rng((seed, index))
    points, frames = KINDS[kind](rng)
    one_friction = rng.uniform() < 0.5
    friction = np.exp(rng.uniform(*np.log(FRICTION), size=1 if one_friction else len(points)))
    coms = _coms(rng, points, states)
    directions = _directions(rng, points, coms)
    speeds = np.exp(rng.uniform(*np.log(SPEEDS), size=states))
    width = np.exp(rng.uniform(*np.log(WIDTHS))) if rng.uniform() < 0.7 else 1.0
    turn = about_z(rng.choice([0.0, np.pi / 2, rng.uniform(-np.pi, np.pi)]))
    shift = rng.choice([0.0, rng.uniform(0, 10), 100 * width * rng.uniform() if width < 0.1 else 10.0])
    place = shift * rng.uniform(-1, 1, 3)
    return Sample(
        kind=kind,
        index=index,
        sides=4 if rng.uniform() < 0.3 else int(rng.integers(SIDES[0], SIDES[1] + 1)),
        points=width * points @ turn.T + place,
        frames=turn @ frames,
        friction=np.broadcast_to(friction, len(points)).copy(),
        coms=width * coms @ turn.T + place,
        velocities=speeds[:, None] * (directions @ turn.T),
    )


def _coms(rng, points, n: int) -> np.ndarray:
    """Anywhere around, or exactly above (below, at) a corner, an edge, a combination of the points; some of them nearly."""
    k, centre = len(points), points.mean(axis=0)
    first, second = points[rng.integers(k, size=(2, n))]
    size = max(np.ptp(points, axis=0).max(), 0.3)
    share = rng.uniform(size=(n, 1))
    places = np.stack([
        centre + size * rng.uniform(-1.5, 1.5, (n, 3)),
        rng.dirichlet(np.ones(k), size=n) @ points,
        first,
        (first + second) / 2,
        first + share * (second - first),
        np.broadcast_to(centre, (n, 3)),
        first + 1.2 * (second - first),
        centre + 10 * size * rng.normal(size=(n, 3)),
    ])  # fmt: skip
    place = places[rng.choice(len(places), n, p=[0.25, 0.3, 0.1, 0.1, 0.1, 0.08, 0.05, 0.02]), np.arange(n)]
    above = rng.uniform(0.2, 2, n)
    heights = np.stack([np.zeros(n), above, np.ones(n), -above, np.full(n, 1e-3)])
    height = heights[rng.choice(len(heights), n, p=[0.1, 0.5, 0.2, 0.15, 0.05]), np.arange(n)]
    nudge = np.where(rng.uniform(size=n) < 0.1, 10.0 ** rng.uniform(-12, -2, n), 0.0)
    return place + size * (height[:, None] * UP + nudge[:, None] * rng.normal(size=(n, 3)))


def _directions(rng, points, coms) -> np.ndarray:
    """Any unit vectors, or vertical, horizontal, along an edge, towards a contact, along an axis; some of them nearly."""
    n = len(coms)
    first, second = points[rng.integers(len(points), size=(2, n))]
    level = np.array([1.0, 1.0, 0.0])
    sign = rng.choice([-1.0, 1.0], size=(n, 1))
    axes = sign * np.eye(3)[rng.integers(3, size=n)]
    vectors = np.stack([
        rng.normal(size=(n, 3)),
        level * rng.normal(size=(n, 3)),
        sign * UP,
        axes,
        second - first,
        level * (second - first),
        level * (points.mean(axis=0) - coms),
        first - coms,
        np.cross(second - first, UP),
    ])  # fmt: skip
    chosen = vectors[rng.choice(len(vectors), n, p=[0.25, 0.2, 0.12, 0.1, 0.05, 0.08, 0.1, 0.05, 0.05]), np.arange(n)]
    length = np.linalg.norm(chosen, axis=1, keepdims=True)
    chosen = np.where(length > 1e-12, chosen / np.where(length > 1e-12, length, 1.0), axes)
    nudge = np.where(rng.uniform(size=n) < 0.2, 10.0 ** rng.uniform(-30, -2, n), 0.0)
    chosen = chosen + nudge[:, None] * rng.normal(size=(n, 3))
    return chosen / np.linalg.norm(chosen, axis=1, keepdims=True)


def about_z(angle: float) -> np.ndarray:
    """Rotation (3, 3) by an angle [rad] about the vertical."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def frame(normal, angle: float = 0.0) -> np.ndarray:
    """A contact frame (3, 3) with this normal, its tangents turned by an angle [rad] about it."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(np.cross(normal, helper), normal)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.column_stack([cos * first + sin * second, cos * second - sin * first, normal])


def tilted(rng, most: float) -> np.ndarray:
    """A frame whose normal is up to `most` [rad] from the vertical, somehow turned."""
    around, off = rng.uniform(-np.pi, np.pi), most * np.sqrt(rng.uniform())
    return frame([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), np.cos(off)], rng.uniform(-np.pi, np.pi))


def joined(*parts):
    """One set of several."""
    return tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def alike(points, one_frame):
    """These points, all with this frame."""
    return np.asarray(points, float), np.repeat(np.asarray(one_frame)[None], len(points), axis=0)


def patch(centre, one_frame, length=0.2, width=0.12, corners=4):
    """A rectangle (or, of two corners, an edge) in the plane of a frame."""
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]] if corners == 4 else [[1, 0], [-1, 0]]) / 2
    local = np.column_stack([signs * [length, width], np.zeros(corners)])
    return alike(np.asarray(centre, float) + local @ one_frame.T, one_frame)


def turned(rng) -> float:
    """No angle, or any [rad]."""
    return rng.choice([0.0, rng.uniform(-np.pi, np.pi)])


def _point(rng):
    return alike([[0, 0, 0]], tilted(rng, rng.choice([0.0, 0.3, np.pi])))


def _points(rng):
    k = rng.integers(2, CONTACTS + 1)
    most = rng.choice([0.3, 1.0, np.pi])
    return rng.uniform(-0.5, 0.5, (k, 3)), np.array([tilted(rng, most) for _ in range(k)])


def _edge(rng):
    return patch([0, 0, 0], tilted(rng, rng.choice([0.0, 0.5])), length=1.0, corners=2)


def _sole(rng):
    return patch([0, 0, 0], tilted(rng, rng.choice([0.0, 0.0, 0.5])), 1.0, rng.uniform(0.2, 1))


def _two_soles(rng):
    angle = turned(rng)
    return joined(*(patch([x, y, 0], frame(UP, angle)) for x, y in ((0, 0.1), (rng.choice([0.0, 0.3]), -0.1))))


def _tilted_soles(rng):
    step = rng.uniform(-0.3, 0.3)
    return joined(patch([0, 0.2, 0], tilted(rng, 0.8)), patch([rng.uniform(-0.5, 0.5), -0.2, step], tilted(rng, 0.8)))


def _slope(rng):
    plane = frame([np.sin(rng.uniform(0, 1.2)), 0, 1], turned(rng))
    sideways = plane @ np.array([0.0, 0.15, 0.0])
    return joined(patch(sideways, plane), patch(-sideways, plane))


def _near_flat(rng):
    points, frames = _two_soles(rng) if rng.uniform() < 0.5 else _sole(rng)
    off = 10.0 ** rng.uniform(-12, -3)
    tilt = rng.choice([0.0, off])
    frames = np.array([f @ tilted(rng, tilt).T if tilt else f for f in frames])
    return points + off * rng.normal(size=points.shape) * UP, frames


def _quadruped(rng):
    points = np.array([[x, y, 0.0] for x in (0.35, -0.35) for y in (0.2, -0.2)])
    if rng.uniform() < 0.5:
        return alike(points[: rng.integers(2, 5)], frame(UP, turned(rng)))
    return points + rng.uniform(-0.1, 0.1, (4, 3)), np.array([tilted(rng, 0.6) for _ in points])


def _ring(rng):
    k = rng.integers(3, CONTACTS + 1)
    angles = 2 * np.pi * np.arange(k) / k
    return alike(0.3 * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles]), frame(UP, turned(rng)))


def _walls(rng):
    lean, high, angle = rng.choice([0.0, rng.uniform(-0.3, 0.3)]), rng.choice([0.0, rng.uniform(-0.3, 0.3)]), turned(rng)
    corners = rng.choice([2, 4])
    parts = (([x, 0, z], frame([-np.sign(x), 0, lean], angle)) for x, z in ((0.4, high), (-0.4, 0.0)))
    return joined(*(patch(*part, corners=corners) for part in parts))


def _wall(rng):
    points = np.column_stack([np.zeros(4), rng.uniform(-0.4, 0.4, (4, 2))])[: rng.integers(2, 5)]
    return alike(points, frame([1, 0, rng.choice([0.0, rng.uniform(-0.5, 0.5)])], turned(rng)))


def _foot_and_wall(rng):
    hand = frame([-1, 0, 0], turned(rng))
    return joined(patch([0, 0.1, 0], frame(UP, turned(rng))), patch([0.5, -0.2, 1.2], hand, 0.1, 0.1, rng.choice([2, 4])))


def _palms(rng):
    up, down = frame(UP, turned(rng)), frame(-UP, turned(rng))
    above = rng.choice([[0.0, 0.0, 0.3], [0.3, 0.1, 0.5], [0.0, 0.0, 0.0]])
    corners = rng.choice([2, 4])
    return joined(patch([0, 0, 0], up, corners=corners), patch(above, down, corners=corners))


def _ceiling(rng):
    normal = frame([rng.choice([0.0, 0.3]), 0, -1], turned(rng))
    return joined(patch([0, 0.2, 0], normal), patch([0, -0.2, 0], normal))


def _ladder(rng):
    rungs = rng.integers(2, 5)
    normals = [frame([0, -np.sin(lean), np.cos(lean)], 0.0) for lean in rng.choice([0.0, 0.5, np.pi / 2, 2.0], size=rungs)]
    return joined(*(alike([[x, 0, 0.3 * i] for x in (-0.2, 0.2)], normal) for i, normal in enumerate(normals)))


def _rail(rng):
    k, angle = rng.integers(2, CONTACTS + 1), turned(rng)
    x = np.sort(rng.uniform(-0.5, 0.5, k)) if rng.uniform() < 0.5 else np.linspace(-0.5, 0.5, k)
    signs = rng.choice([-1.0, 1.0], size=k) if rng.uniform() < 0.5 else np.ones(k)
    return np.column_stack([x, 0 * x, 0 * x]), np.array([frame(sign * UP, angle) for sign in signs])


def _chimney(rng):
    k = rng.integers(3, 5)
    angles = np.pi / 2 * np.arange(4)[:k] + rng.choice([0.0, 0.4])
    heights = rng.choice([0.0, 0.2, 0.5], size=k)
    lean = rng.choice([0.0, 0.05, -0.3])
    points = np.column_stack([0.4 * np.cos(angles), 0.4 * np.sin(angles), heights])
    return points, np.array([frame([-np.cos(a), -np.sin(a), lean], turned(rng)) for a in angles])


def _fist(rng):
    normal = tilted(rng, rng.choice([0.0, np.pi]))
    across, angle = rng.uniform(0.005, 0.1), turned(rng)
    axis = normal[:, 2]
    grip = lambda place: (place + np.outer([-across, across], axis) / 2, np.array([frame(-axis, angle), frame(axis, angle)]))
    if rng.uniform() < 0.5:
        return grip(np.zeros(3))
    return joined(grip(np.zeros(3)), grip(normal @ [1.0, 0.0, 0.0]))


def _pole(rng):
    k, radius = rng.integers(2, 5), rng.choice([0.01, 0.1])
    angles = 2 * np.pi * np.arange(k) / k
    outward = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(k)])
    heights = rng.choice([0.0, 0.3, rng.uniform(0, 1)], size=(k, 1))
    inside = rng.choice([-1.0, 1.0])
    return radius * outward + heights * UP, np.array([frame(inside * o) for o in outward])


def _collinear(rng):
    k = rng.integers(3, CONTACTS + 1)
    line = rng.normal(size=3) / 2
    along = np.linspace(-0.5, 0.5, k) if rng.uniform() < 0.5 else rng.uniform(-0.5, 0.5, k)
    if rng.uniform() < 0.5:
        return alike(np.outer(along, line), tilted(rng, 0.6))
    return np.outer(along, line), np.array([tilted(rng, 0.6) for _ in range(k)])


def _duplicates(rng):
    makers = (_point, _edge, _quadruped, _fist, _rail, _ring)
    points, frames = makers[rng.integers(len(makers))](rng)
    k = len(points)
    again = np.concatenate([np.arange(k), rng.integers(k, size=CONTACTS)])[
        : rng.integers(min(k, CONTACTS - 1), CONTACTS) + 1
    ]
    frames = frames[again]
    if rng.uniform() < 0.3:
        frames = np.array([frame(f[:, 2], rng.uniform(-np.pi, np.pi)) for f in frames])
    return points[again], frames


def _mixed(rng):
    makers = (_point, _edge, _fist, _wall, _palms, _pole, _sole)
    chosen = [makers[i](rng) for i in rng.integers(len(makers), size=3)]
    points, frames = joined(*((p + rng.uniform(-0.5, 0.5, 3), f) for p, f in chosen))
    return points[:CONTACTS], frames[:CONTACTS]


KINDS = {
    "point": _point,
    "points": _points,
    "edge": _edge,
    "sole": _sole,
    "two soles": _two_soles,
    "tilted soles": _tilted_soles,
    "slope": _slope,
    "near-flat": _near_flat,
    "quadruped": _quadruped,
    "ring": _ring,
    "walls": _walls,
    "wall": _wall,
    "foot and wall": _foot_and_wall,
    "palms": _palms,
    "ceiling": _ceiling,
    "ladder": _ladder,
    "rail": _rail,
    "chimney": _chimney,
    "fist": _fist,
    "pole": _pole,
    "collinear": _collinear,
    "duplicates": _duplicates,
    "mixed": _mixed,
}
