"""Surfaces that a hand or a foot may be put on, and the candidates that a grid over them gives.

Most are made of flat rectangles: a floor or a wall is one, a rail a narrow one, a box six. Uneven ground is a field of
heights, on which a foot stands as flat as it is.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxcap.contacts.contact_set import ContactSet, rectangle
from jaxcap.contacts.conventions import ROTATION_ERROR, ArrayLike

Number = float | int


class Surface(NamedTuple):
    """A flat rectangle that can be touched from the side that its normal points to; see `surface`."""

    position: Float[np.ndarray, "3"]
    """Its centre [m]."""
    rotation: Float[np.ndarray, "3 3"]
    """Columns: direction of the length, of the width, normal."""
    half_length: float
    """[m]"""
    half_width: float
    """[m]"""
    friction: float


class HeightField(NamedTuple):
    """Uneven ground seen from above; see `height_field`."""

    heights: Float[np.ndarray, "nx ny"]
    """[m]"""
    origin: Float[np.ndarray, "3"]
    """Of the first height [m]."""
    spacing: float
    """[m]"""
    friction: float


class Candidates(NamedTuple):
    """Places for a new contact, one set of four corners each."""

    contacts: ContactSet
    """A batch of m sets."""
    centres: Float[np.ndarray, "m 3"]
    """[m]"""
    surface: Int[np.ndarray, "m"]
    """Which of the surfaces."""
    grids: tuple[tuple[int, int], ...]
    """Of each surface, how many places along its length and its width: they come row by row, each row along the width."""


class _Spot(NamedTuple):
    """Where a hand or a foot would lie."""

    centre: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]


class _Extent(NamedTuple):
    """A surface as a grid of places sees it."""

    middle: tuple[float, float]
    """In its own coordinates [m]."""
    half_length: float
    half_width: float
    spot: Callable[[float, float], _Spot]
    """At own coordinates [m]."""


def surface(
    position: ArrayLike, rotation: ArrayLike, half_length: Number, half_width: Number, friction: Number
) -> Surface:  # fmt: skip
    """A part of a floor, a wall or a slope.

    Args:
        position: (3,) centre [m].
        rotation: (3, 3), columns: direction of the length, of the width, normal, pointing at where the robot is.
        half_length: [m], > 0.
        half_width: [m], > 0.
        friction: coefficient, > 0.

    Returns:
        The surface.

    Raises:
        ValueError: naming the field, as `rectangle`: for a size of zero, or a rotation that is none.
    """
    rectangle(position, rotation, half_length, half_width, friction)  # what it refuses is refused
    return Surface(
        np.asarray(position, float), np.asarray(rotation, float), float(half_length), float(half_width), float(friction)
    )


def rail(start: ArrayLike, end: ArrayLike, normal: ArrayLike, half_width: Number, friction: Number) -> Surface:
    """A rail that a hand can press on from one side.

    Args:
        start: (3,) one end [m].
        end: (3,) the other [m].
        normal: (3,) unit vector across the rail, from where it is pressed on.
        half_width: [m], > 0.
        friction: coefficient, > 0.

    Returns:
        A narrow surface.

    Raises:
        ValueError: for ends that are one place, a normal that is no unit vector or not across the rail, or as `rectangle`.
    """
    start, end, normal = (np.asarray(vector, float) for vector in (start, end, normal))
    length = float(np.linalg.norm(end - start))
    if not 0 < length < np.inf:
        raise ValueError(f"start, end are {length} m apart (expected a positive distance)")
    along = (end - start) / length
    if not abs(np.linalg.norm(normal) - 1) <= ROTATION_ERROR:
        raise ValueError(f"normal has length {np.linalg.norm(normal):.6f} (expected 1)")
    if not abs(along @ normal) <= ROTATION_ERROR:
        raise ValueError(f"normal has the part {along @ normal:.6f} along the rail (expected 0)")
    rotation = np.stack([along, np.cross(normal, along), normal], axis=1)
    return surface((start + end) / 2, rotation, length / 2, half_width, friction)


def box(position: ArrayLike, rotation: ArrayLike, half_sizes: ArrayLike, friction: Number) -> list[Surface]:
    """The six sides of a box.

    Args:
        position: (3,) centre [m].
        rotation: (3, 3), columns: the box's axes.
        half_sizes: (3,) along them [m], > 0.
        friction: coefficient, > 0.

    Returns:
        Six surfaces: along each axis the one ahead, then the one behind.

    Raises:
        ValueError: naming the field, for a size of zero, or a rotation that is none.
    """
    sizes, axes = np.asarray(half_sizes, float), np.asarray(rotation, float)
    if sizes.shape != (3,) or not (np.isfinite(sizes) & (sizes > 0)).all():
        raise ValueError(f"half_sizes = {half_sizes} (expected three positive numbers of metres)")
    sides = []
    for k in range(3):
        first, second = (k + 1) % 3, (k + 2) % 3
        for sign in (1, -1):
            frame = np.stack([axes[:, first], sign * axes[:, second], sign * axes[:, k]], axis=1)
            centre = np.asarray(position, float) + sign * sizes[k] * axes[:, k]
            sides.append(surface(centre, frame, float(sizes[first]), float(sizes[second]), friction))
    return sides


def height_field(heights: ArrayLike, origin: ArrayLike, spacing: Number, friction: Number) -> HeightField:
    """Uneven ground, from a grid of its heights.

    Args:
        heights: (nx, ny) [m], at least 2 x 2: `heights[i, j]` is that of the place (i, j) * spacing from the origin, in x
            and y, above the origin's z.
        origin: (3,) of the first height [m].
        spacing: between neighbours [m], > 0.
        friction: coefficient, > 0.

    Returns:
        The field. Between its points heights are bilinear.

    Raises:
        ValueError: naming the field, for a wrong shape, what is not finite, or what is not positive.
    """
    heights, origin = np.asarray(heights), np.asarray(origin)
    for name, field, fits, expected in (
        ("heights", heights, heights.ndim == 2 and min(heights.shape, default=0) >= 2, "(nx, ny), at least 2 x 2"),
        ("origin", origin, origin.shape == (3,), "(3,)"),
    ):
        if field.dtype.kind not in "iuf" or not fits:
            raise ValueError(f"{name}: {field.dtype} of shape {field.shape} (expected numbers of shape {expected})")
        for index in np.argwhere(~np.isfinite(field))[:1]:
            raise ValueError(f"{name}{index.tolist()} = {field[tuple(index)]} (expected a finite number of metres)")
    for name, value, unit in (("spacing", spacing, " of metres"), ("friction", friction, "")):
        if not (np.ndim(value) == 0 and np.isfinite(value) and value > 0):
            raise ValueError(f"{name} = {value} (expected a positive number{unit})")
    return HeightField(heights.astype(float), origin.astype(float), float(spacing), float(friction))


def candidates_on(
    surfaces: Sequence[Surface | HeightField], half_length: Number, half_width: Number, spacing: Number
) -> Candidates:
    """A grid of places for a hand or a foot on surfaces, each with its four corners on them.

    Args:
        surfaces: from `surface`, `rail`, `box` and `height_field`.
        half_length: of the hand or foot, along the surface's length [m]; along x on a field of heights.
        half_width: along its width [m]. Where a surface is narrower than that, only so much of the hand bears. On a field of
            heights a foot stays flat: it passes through the height at its centre, with the mean slope under it.
        spacing: between the centres of neighbours [m], at most.

    Returns:
        The candidates, surface by surface.

    Raises:
        ValueError: for no surfaces, or a size or a spacing that is not positive.
    """
    if not surfaces:
        raise ValueError("surfaces: none (expected at least one)")
    for name, value in (("half_length", half_length), ("half_width", half_width), ("spacing", spacing)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} = {value} (expected a positive number of metres)")
    sets, centres, owners, grids = [], [], [], []
    for owner, one in enumerate(surfaces):
        extent = _extent(one, half_length, half_width)
        length, width = min(half_length, extent.half_length), min(half_width, extent.half_width)
        xs = extent.middle[0] + _places(extent.half_length - length, spacing)
        ys = extent.middle[1] + _places(extent.half_width - width, spacing)
        for x in xs:
            for y in ys:
                centre, rotation = extent.spot(x, y)
                sets.append(rectangle(centre, rotation, length, width, one.friction))
                centres.append(centre)
                owners.append(owner)
        grids.append((len(xs), len(ys)))
    join = lambda field: np.stack([getattr(each, field) for each in sets])
    contacts = ContactSet(join("points"), join("frames"), join("friction"), join("mask"))
    return Candidates(contacts, np.array(centres), np.array(owners), tuple(grids))


def _extent(one: Surface | HeightField, half_length: float, half_width: float) -> _Extent:
    """half_length, half_width: of the hand or foot [m]."""
    if isinstance(one, Surface):
        flat = lambda x, y: _Spot(one.position + one.rotation @ [x, y, 0], one.rotation)
        return _Extent((0.0, 0.0), one.half_length, one.half_width, flat)
    long, wide = ((count - 1) * one.spacing / 2 for count in one.heights.shape)
    length, width = min(half_length, long), min(half_width, wide)

    def spot(x: float, y: float) -> _Spot:
        slope_x = (_height(one, x + length, y) - _height(one, x - length, y)) / (2 * length)
        slope_y = (_height(one, x, y + width) - _height(one, x, y - width)) / (2 * width)
        return _Spot(one.origin + np.array([x, y, _height(one, x, y)]), _facing_up(slope_x, slope_y))

    return _Extent((long, wide), long, wide, spot)


def _height(field: HeightField, x: float, y: float) -> float:
    """Of the place (x, y) from the field's origin [m]; beyond its edge, that of the edge."""
    cells = np.subtract(field.heights.shape, 1)
    place = np.clip(np.array([x, y]) / field.spacing, 0, cells)
    i, j = first = np.minimum(place.astype(int), cells - 1)
    u, v = place - first
    corners = field.heights[i : i + 2, j : j + 2]
    return float(np.array([1 - u, u]) @ corners @ [1 - v, v])


def _facing_up(slope_x: float, slope_y: float) -> np.ndarray:
    """Frame on ground with these slopes: its first column has no part along y, its third is the normal."""
    normal = np.array([-slope_x, -slope_y, 1]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    along = np.array([1, 0, slope_x]) / np.sqrt(1 + slope_x**2)
    return np.stack([along, np.cross(normal, along), normal], axis=1)


def _places(farthest: float, spacing: float) -> np.ndarray:
    """From -farthest to farthest, evenly, no more than `spacing` apart; the middle where that is one place."""
    count = int(np.ceil(2 * farthest / spacing - 1e-9)) + 1
    return np.linspace(-farthest, farthest, count) if count > 1 else np.zeros(1)
