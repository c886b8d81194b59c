"""Axes of a grid along which the contacts change: one set or another, their friction, the slope that they stand on."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxcap.contacts.actuation import ActuatedRays
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.errors import InputError
from jaxcap.maps.grid import CONTACTS, Grid

Contacts = ContactSet | Sequence[ContactSet] | Mapping[str, ContactSet]
"""One set, or several, perhaps with names."""
Mapped = Contacts | CentroidalCone | ConeRays | ActuatedRays
"""What a map is of: contacts, or what they can exert."""
Sets = Mapping[Any, ContactSet]
"""Contact sets by their names, or by their numbers."""


def given_sets(cone: Mapped) -> Sets:
    """The contact sets given; none for a cone. Raises InputError for what is no contact set."""
    if isinstance(cone, CentroidalCone | ConeRays | ActuatedRays):
        return {}
    sets = cone if isinstance(cone, Mapping) else dict(enumerate([cone] if isinstance(cone, ContactSet) else cone))
    if not sets:
        raise InputError("contacts: no set (expected at least one)")
    for name, contacts in sets.items():
        if not isinstance(contacts, ContactSet) or contacts.points.ndim != 2:
            found = f"points of shape {contacts.points.shape}" if isinstance(contacts, ContactSet) else f"{contacts!r:.60}"
            raise InputError(f"contacts: set {name}: {found} (expected one set of contacts, points of shape (k, 3))")
    return sets


def with_sets(cone: Mapped, axes: Mapping[str, Any]) -> dict[str, Any]:
    """The axes; for several contact sets also one of their numbers, unless it is there. Raises InputError for axes of
    contacts where there are none.
    """
    sets, fixed = given_sets(cone), next((name for name in axes if name in CONTACTS), None)
    if fixed and not sets:
        raise InputError(f"axis {fixed!r} needs contacts (got a {type(cone).__name__}, whose contacts are what they are)")
    numbers = {"contact_set": np.arange(len(sets))} if len(sets) > 1 and "contact_set" not in axes else {}
    return {**numbers, **axes}


def contacts_at(
    sets: Sequence[ContactSet],
    *,
    contact_set: float = 0,
    friction: float | None = None,
    slope: float = 0.0,
    downhill: float = 0.0,
) -> ContactSet:
    """The contacts at a point of these axes.

    Args:
        sets: Those that there are.
        contact_set: Which of them, from 0.
        friction: Of all contacts; None leaves theirs.
        slope: All contacts are turned by this as one body [rad], about a level axis through their centroid.
        downhill: Where what was level then goes down [rad], from x towards y.

    Raises:
        InputError: For a set that is not there.
    """
    if not (0 <= contact_set < len(sets) and contact_set == int(contact_set)):
        expected = f"0 to {len(sets) - 1}" if len(sets) > 1 else "0: there is one set"
        raise InputError(f"axis contact_set holds {contact_set:g} (expected {expected})")
    chosen = sets[int(contact_set)]
    points, frames, active = (np.asarray(field) for field in (chosen.points, chosen.frames, chosen.mask))
    if slope != 0 and active.any():
        axis = np.array([-np.sin(downhill), np.cos(downhill), 0])
        from scipy.spatial.transform import Rotation  # a heavy import, as in `cone_hull`

        turn = Rotation.from_rotvec(slope * axis).as_matrix()
        centroid = points[active].mean(axis=0)
        points, frames = centroid + (points - centroid) @ turn.T, turn @ frames
    return ContactSet(points, frames, chosen.friction if friction is None else friction, mask=active)


def contact_sets(sets: Sequence[ContactSet], grid: Grid) -> list[tuple[str, ContactSet]]:
    """The contacts at all points of the grid's axes of contacts, in the order of its dimensions, the last one fastest; each
    with the place where it is found, for messages. Raises InputError for a set that is not there.
    """
    axes = {name: np.atleast_1d(values) for name, values in grid.axes.items() if name in CONTACTS}
    points = [dict(zip(axes, point, strict=True)) for point in itertools.product(*axes.values())]
    where = lambda point: ", ".join(f"{name} = {value:g}" for name, value in point.items()) or "contacts"
    return [(where(point), contacts_at(sets, **point)) for point in points]
