"""What a map says of itself: units, what codes mean, conventions, contacts. Needs xarray (extra `maps`)."""

import json
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import xarray as xr
from numpy.typing import DTypeLike

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.files.fields import FIELDS, NAMES
from jaxcap.maps.contact_axes import Sets
from jaxcap.maps.grid import AXES, Grid

CONVENTIONS = (
    "one inertial frame for all positions and velocities, z up, SI units; heading [rad] from x towards y, pitch [rad] above "
    "the horizontal; frames of contacts: columns are tangent, tangent, normal pointing at the robot"
)


def coordinates(points: Grid, sets: Sets, attributes: Mapping[str, Any]) -> xr.Dataset:
    """The axes of a map, and its attributes, without variables. sets: their names tell the values of contact_set."""
    found = {}
    for name, values in points.axes.items():
        about: dict[str, Any] = {"units": AXES[name].unit, "long_name": AXES[name].label, "comment": AXES[name].meaning}
        if name == "contact_set":
            values = values.astype(np.int32)
            if isinstance(next(iter(sets)), str):
                about |= _flags({str(key): number for number, key in enumerate(sets)}, np.int32)
        found[name] = (name,) if values.ndim else (), values, about
    return xr.Dataset(coords=found, attrs=dict(attributes))


def attributes_of(quantity: str) -> dict[str, Any]:
    """What a variable says of itself."""
    field = FIELDS[quantity]
    codes = _flags(NAMES[quantity], np.int8) if quantity in NAMES else {}
    return {"units": field.unit or "1", "long_name": field.label, "comment": field.meaning, **codes}


def _flags(codes: Mapping[str, int], dtype: DTypeLike) -> dict[str, Any]:
    """What the codes of a field mean, in the words of the CF conventions: words without blanks."""
    meanings = " ".join("_".join(name.split()) for name in codes)
    return {"flag_values": np.array(list(codes.values()), dtype), "flag_meanings": meanings}


def as_file(sets: Sets) -> str:
    """The text of a contacts file with these sets."""
    entries: dict[str | int, Any] = {name: _entries(contacts) for name, contacts in sets.items()}
    if len(sets) == 1:
        return json.dumps({"contacts": next(iter(entries.values()))})
    name_of = lambda name: {"name": name} if isinstance(name, str) else {}
    return json.dumps({"sets": [{**name_of(name), "contacts": contacts} for name, contacts in entries.items()]})


def _entries(contacts: ContactSet) -> list[dict[str, Any]]:
    """Contacts as a contacts file lists them."""
    active = jax.tree.map(lambda leaf: np.asarray(leaf)[np.asarray(contacts.mask)].tolist(), contacts)
    return [
        {"type": "point", "position": position, "rotation": rotation, "friction": friction}
        for position, rotation, friction in zip(active.points, active.frames, active.friction, strict=True)
    ]
