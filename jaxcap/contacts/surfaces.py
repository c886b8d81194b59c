"""Surfaces that a hand or a foot may be put on, and the candidates that a grid over them gives.

Every surface is made of flat rectangles: a floor or a wall is one, a rail a narrow one, a box six.
"""

from collections.abc import Sequence
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


class Candidates(NamedTuple):
    """Places for a new contact, one set of four corners each."""

    contacts: ContactSet
    """A batch of m sets."""
    centres: Float[np.ndarray, "m 3"]
    """[m]"""
    surface: Int[np.ndarray, "m"]
    """Which of the surfaces."""


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


def candidates_on(surfaces: Sequence[Surface], half_length: Number, half_width: Number, spacing: Number) -> Candidates:
    """A grid of places for a hand or a foot on surfaces, each with its four corners on them.

    Args:
        surfaces: from `surface`, `rail` and `box`.
        half_length: of the hand or foot, along the surface's length [m].
        half_width: along its width [m]. Where a surface is narrower than that, only so much of the hand bears.
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
    sets, centres, owners = [], [], []
    for owner, one in enumerate(surfaces):
        length, width = min(half_length, one.half_length), min(half_width, one.half_width)
        for x in _places(one.half_length - length, spacing):
            for y in _places(one.half_width - width, spacing):
                centre = one.position + one.rotation @ [x, y, 0]
                sets.append(rectangle(centre, one.rotation, length, width, one.friction))
                centres.append(centre)
                owners.append(owner)
    join = lambda field: np.stack([getattr(each, field) for each in sets])
    contacts = ContactSet(join("points"), join("frames"), join("friction"), join("mask"))
    return Candidates(contacts, np.array(centres), np.array(owners))


def _places(farthest: float, spacing: float) -> np.ndarray:
    """From -farthest to farthest, evenly, no more than `spacing` apart; the middle where that is one place."""
    count = int(np.ceil(2 * farthest / spacing - 1e-9)) + 1
    return np.linspace(-farthest, farthest, count) if count > 1 else np.zeros(1)
