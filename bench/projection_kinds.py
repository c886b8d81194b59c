"""Random contact sets of many kinds, seeded: what `bench.projection` projects.

A kind is a function of a generator, a distance [m] and a number of contacts, to points (k, 3) and frames (k, 3, 3). A
contact is a point, an edge or a sole. Distances go from 1 mm to 10 m, sizes of contacts from 0.5 mm to 150 mm, friction from
0.01 to 3, the same for all contacts or not, pyramids from 3 to 16 sides; half of the sets are turned and moved, half are
rounded to single precision. Many numbers are exactly zero or equal: symmetry is where a projection breaks.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxcap import ContactSet
from tests.samplers import rotation

Placed = tuple[np.ndarray, np.ndarray]
"""Points (k, 3) [m] and frames (k, 3, 3)."""
CORNERS = {"point": [[0, 0]], "edge": [[1, 0], [-1, 0]], "sole": [[1, 1], [1, -1], [-1, -1], [-1, 1]]}


class Sample(NamedTuple):
    """A contact set to be projected."""

    contacts: ContactSet
    sides: int
    single: bool
    """Points and frames were rounded to single precision."""


def sample(kind: str, seed: int, number: int) -> Sample:
    """The contact set of this kind, seed and number."""
    rng = np.random.default_rng((seed, list(KINDS).index(kind), number))
    distance, contacts, sides = between(rng, 1e-3, 10), int(rng.integers(1, 9)), int(rng.integers(3, 17))
    friction = between(rng, 0.01, 3)
    if kind == "touching edges":
        points, frames = touching(rng, distance, max(2, contacts), friction, sides)
    else:
        points, frames = KINDS[kind](rng, distance, contacts)
    many = np.full(len(points), friction)
    if kind == "round numbers":
        many[:], sides = rng.choice([0.25, 0.5, 1, 2**0.5, 3**-0.5, 2]), int(rng.choice([3, 4, 6, 8, 12, 16]))
    elif kind != "touching edges" and rng.random() < 0.3:
        many = np.exp(rng.uniform(np.log(0.01), np.log(3), len(points)))
    if rng.random() < 0.5:
        turn = rotation(0, 0, rng.uniform(-3, 3)) if rng.random() < 0.7 else any_rotation(rng)
        points, frames = points @ turn.T + rng.choice([0, 1, 10]) * rng.normal(size=3), turn @ frames
    single = bool(rng.random() < 0.5)
    if single:
        points, frames = points.astype(np.float32), frames.astype(np.float32)
    return Sample(ContactSet(points, frames, many), sides, single)


def between(rng, low: float, high: float) -> float:
    """Log-uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def any_rotation(rng) -> np.ndarray:
    """Uniform."""
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return axes * np.sign(np.linalg.det(axes))


def facing(normal, turn: float = 0.0) -> np.ndarray:
    """A frame with this normal, turned about it."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    other = np.eye(3)[1 if abs(normal[0]) > 0.9 else 0]
    tangent = other - normal * (other @ normal)
    tangent /= np.linalg.norm(tangent)
    frame = np.stack([tangent, np.cross(normal, tangent), normal], axis=1)
    return frame @ rotation(0, 0, turn)


def turned(rng) -> float:
    """No turn at all, or any [rad]."""
    return float(rng.choice([0, rng.uniform(-3, 3)]))


def patch(rng, centre, frame, size: float, shape: str | None = None) -> Placed:
    """A contact around a centre: a point, the ends of an edge, the corners of a sole."""
    corners = np.array(CORNERS[shape or str(rng.choice(list(CORNERS)))]) * size * rng.uniform(0.2, 1, 2)
    points = np.asarray(centre) + np.column_stack([corners, np.zeros(len(corners))]) @ frame.T
    return points, np.repeat(frame[None], len(points), axis=0)


def joined(parts) -> Placed:
    """One set of many."""
    points, frames = zip(*parts, strict=True)
    return np.concatenate(points), np.concatenate(frames)


def anywhere(shape: str) -> Callable[..., Placed]:
    """Contacts of a shape in any attitude."""

    def kind(rng, distance: float, contacts: int) -> Placed:
        size = between(rng, 5e-4, 0.15)
        return joined(patch(rng, distance * rng.normal(size=3), any_rotation(rng), size, shape) for _ in range(contacts))

    return kind


def level(heights, upright) -> Callable[..., Placed]:
    """Contacts on horizontal ground or ceilings: heights, in distances, and signs of the normals to choose from."""

    def kind(rng, distance: float, contacts: int) -> Placed:
        size = between(rng, 5e-4, 0.15)
        place = lambda: distance * np.r_[rng.normal(size=2), rng.choice(heights)]
        return joined(patch(rng, place(), facing([0, 0, rng.choice(upright)], turned(rng)), size) for _ in range(contacts))

    return kind


def quadruped(rng, distance: float, contacts: int) -> Placed:
    """Four feet at the corners of a rectangle, on level or on rough ground."""
    size, rough, shape = between(rng, 5e-4, 0.15), rng.choice([0, 0, 0.1, 0.5]), str(rng.choice(["point", "sole"]))
    corners = np.array(CORNERS["sole"]) * rng.uniform(0.3, 1, 2)
    frame = lambda: rotation(*(rough * rng.normal(size=2)), turned(rng))
    return joined(patch(rng, distance * np.r_[at, rough * rng.normal()], frame(), size, shape) for at in corners)


def walls(rng, distance: float, contacts: int) -> Placed:
    """Two walls that face each other."""
    size = between(rng, 5e-4, 0.15)
    place = lambda y: distance * np.array([rng.choice([0, 0.2, rng.normal()]), y, rng.choice([0, 0.5, rng.normal()])])
    sides = [(-1) ** i for i in range(max(2, contacts))]
    return joined(patch(rng, place(y), facing([0, -y, 0], turned(rng)), size) for y in sides)


def chimney(rng, distance: float, contacts: int) -> Placed:
    """Two to four walls around."""
    size, around = between(rng, 5e-4, 0.15), int(rng.integers(2, 5))
    parts = []
    for i in range(contacts):
        angle = 2 * np.pi * (i % around) / around
        normal = np.array([np.cos(angle), np.sin(angle), 0.0])
        centre = normal + np.array([0, 0, rng.choice([0, 0.3, rng.normal()])])
        leaning = -normal - np.array([0, 0, rng.choice([0, 0, 0.2 * rng.normal()])])
        parts.append(patch(rng, distance * centre, facing(leaning), size))
    return joined(parts)


def ladder(rng, distance: float, contacts: int) -> Placed:
    """Hands and feet around rungs: up to three points each, at right angles."""
    radius, parts = between(rng, 0.005, 0.05) * distance, []
    for _ in range(max(1, contacts // 2)):
        rung = distance * np.array([rng.choice([-0.2, 0.2]), 0, 0.3 * rng.integers(0, 6)])
        start = turned(rng)
        for j in range(rng.integers(1, 4)):
            normal = np.array([0, np.cos(start + j * np.pi / 2), np.sin(start + j * np.pi / 2)])
            parts.append(((rung + radius * normal)[None], facing(normal)[None]))
    return joined(parts)


def rails(rng, distance: float, contacts: int) -> Placed:
    """Fists around a rail: two opposed points each, or one."""
    along = rng.normal(size=3) if rng.random() < 0.5 else np.eye(3)[rng.integers(3)]
    frame, radius, parts = facing(along), between(rng, 0.005, 0.05) * distance, []
    for _ in range(max(1, contacts // 2)):
        centre, angle = distance * rng.normal() * frame[:, 2], turned(rng)
        out = np.cos(angle) * frame[:, 0] + np.sin(angle) * frame[:, 1]
        for sign in (1, -1) if rng.random() < 0.7 else (1,):
            normal = sign * out * rng.choice([1, 1, 1, -1])
            parts.append(((centre + radius * sign * out)[None], facing(normal)[None]))
    return joined(parts)


def nearly_flat(rng, distance: float, contacts: int) -> Placed:
    """Soles that are parallel up to 1e-12 to 1e-3."""
    size, tilt = between(rng, 5e-4, 0.15), between(rng, 1e-12, 1e-3)
    place = lambda: distance * np.r_[rng.normal(size=2), tilt * rng.normal()]
    frame = lambda: rotation(*(tilt * rng.normal(size=2)), turned(rng))
    return joined(patch(rng, place(), frame(), size, "sole") for _ in range(contacts))


def nearly_on_a_line(rng, distance: float, contacts: int) -> Placed:
    """Points that are on a line, with equal frames, up to 1e-12 to 1e-3."""
    tilt, along, frame = between(rng, 1e-12, 1e-3), facing(rng.normal(size=3))[:, 2], any_rotation(rng)
    place = lambda: distance * (rng.normal() * along + tilt * rng.normal(size=3))
    return joined((place()[None], (frame @ rotation(*(tilt * rng.normal(size=3))))[None]) for _ in range(max(2, contacts)))


def round_numbers(rng, distance: float, contacts: int) -> Placed:
    """Multiples of a tenth of the distance, and of 15, 30 or 45 degrees."""
    angles = lambda: rng.integers(-6, 7, 3) * np.pi / rng.choice([4, 6, 12])
    size = float(rng.choice([0.05, 0.1]))
    return joined(patch(rng, distance * rng.integers(-5, 6, 3) / 10, rotation(*angles()), size) for _ in range(contacts))


def touching(rng, distance: float, contacts: int, friction: float, sides: int) -> Placed:
    """Points whose pyramids have edges that oppose each other exactly: rounding decides whether a line is in the cone."""

    def edge(frame):
        angle = np.pi / sides + 2 * np.pi * rng.integers(sides) / sides
        vector = frame @ [friction * np.cos(angle), friction * np.sin(angle), 1]
        return vector / np.linalg.norm(vector)

    parts = [(distance * rng.normal(size=(1, 3)), any_rotation(rng)[None])]
    for _ in range(contacts - 1):
        point, frame = parts[rng.integers(len(parts))]
        force, own = edge(frame[0]), any_rotation(rng)
        other = edge(own)
        # The rotation that takes `other` to the opposite of `force`.
        x, y, z = np.cross(other, -force)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn = np.eye(3) + cross + cross @ cross / (1 - other @ force)
        parts.append((point + distance * rng.choice([-1, 1]) * rng.uniform(0.2, 1) * force, (turn @ own)[None]))
    return joined(parts)


KINDS: dict[str, Callable[..., Placed]] = {
    "points": anywhere("point"),
    "edges": anywhere("edge"),
    "soles": anywhere("sole"),
    "flat ground": level([0], [1]),
    "ceiling": level([1], [-1]),
    "palms up and down": level([0, 1], [-1, 1]),
    "quadruped": quadruped,
    "opposite walls": walls,
    "chimney": chimney,
    "ladder": ladder,
    "rails": rails,
    "near-flat soles": nearly_flat,
    "near a line": nearly_on_a_line,
    "round numbers": round_numbers,
    "touching edges": touching,
}
