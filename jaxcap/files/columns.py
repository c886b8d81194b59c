"""The columns of a dataset: how a state is spelt in a file, and what is written beside it."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import DTypeLike

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.errors import InputError
from jaxcap.files.bad_rows import BadRows
from jaxcap.files.contact_columns import POINTS, RowChoices, RowContacts
from jaxcap.files.contact_files import ContactSets
from jaxcap.files.fields import FIELDS, NAMES, Field
from jaxcap.version import __version__

VECTORS = ("com", "com_velocity")
"""The columns that every state file has: `com` (3), or com_x, com_y, com_z; and so on."""

MOMENTUM = "angular_momentum"
"""The robot's angular momentum about its CoM [kg m^2/s]: a column that is read where its mass is given."""
SPECIFIC = "specific_angular_momentum"
"""The same over the mass [m^2/s]: a column that is read wherever there is one."""


class StateBatch(NamedTuple):
    """Consecutive rows of a state file."""

    coms: Float[np.ndarray, "n 3"]
    """CoM positions [m]."""
    com_velocities: Float[np.ndarray, "n 3"]
    """CoM velocities [m/s]."""
    columns: Mapping[str, Any]
    """Every column as it was read, the two above included: NumPy arrays, or Arrow arrays where the file is Parquet."""
    bad: BadRows
    """Rows whose CoM, velocity or angular momentum is not there, or not finite."""
    contacts: RowContacts | RowChoices | None = None
    """What the columns say about the contacts of each row, if there are such columns."""
    specific_angular_momenta: Float[np.ndarray, "n 3"] | None = None
    """About the CoM, over the mass [m^2/s]; None where the file has none, or no mass is given."""


METADATA = "metadata"
"""Name of the NPZ member that holds the metadata."""


def describe(
    contacts: ContactSet | ContactSets | tuple[str, ...],
    gravity: Iterable[float],
    sides: int,
    dtype: DTypeLike,
    fields: Mapping[str, Field] = FIELDS,
    momentum: tuple[str, ...] = (),
    **more: Any,
) -> dict[str, Any]:
    """What the output file says about itself: conventions, units, names of codes, what it was computed from.

    Args:
        contacts: The set of all states, the sets that a column chooses from, or the names of the columns that hold them.
        gravity: (3,) [m/s^2].
        sides: Edges of the friction pyramids.
        dtype: Of the computation.
        fields: The columns that are added.
        momentum: The columns that hold the angular momentum.
        **more: What else there is to say.

    Returns:
        What `to_json` makes text of.
    """
    own = {} if isinstance(contacts, ContactSet | ContactSets) else {POINTS: "m"}
    own |= {name: "m^2/s" if name.startswith(SPECIFIC) else "kg m^2/s" for name in momentum}
    return {
        "written_by": f"jaxcap {__version__}",
        "conventions": "one inertial frame for all positions and velocities, z up, SI units; "
        "frames: columns are tangent, tangent, normal pointing at the robot",
        "units": {"com": "m", "com_velocity": "m/s"} | own | {name: field.unit for name, field in fields.items()},
        "meanings": {name: field.meaning for name, field in fields.items()},
        **NAMES,
        "dtype": np.dtype(dtype).name,
        "gravity": [float(g) for g in gravity],
        "sides": int(sides),
        "contacts": described_contacts(contacts),
        **more,
    }


def described_contacts(contacts: ContactSet | ContactSets | tuple[str, ...]) -> Any:
    """Contacts as text in JSON: those of `describe`."""
    if isinstance(contacts, ContactSet):
        return {name: np.asarray(getattr(contacts, name)).tolist() for name in ("points", "frames", "friction")}
    if isinstance(contacts, ContactSets):
        return [{"name": name, **described_contacts(one)} for name, one in zip(contacts.names, contacts.sets, strict=True)]
    return list(contacts)


def to_json(metadata: Mapping[str, Any]) -> str:
    """The text that is stored in the file."""
    return json.dumps(metadata, allow_nan=False)


def spelling(path: str | Path, vector: str, names: Iterable[str]) -> tuple[str, ...]:
    """The columns that hold `vector`: (com,) or (com_x, com_y, com_z). Raises InputError if none do, or both."""
    names = list(names)
    parts = tuple(f"{vector}_{axis}" for axis in "xyz")
    found = [part for part in parts if part in names]
    if vector in names:
        if found:
            raise InputError(f"{path}: both {vector!r} and {found[0]!r} are there (expected one spelling)")
        return (vector,)
    if len(found) == 3:
        return parts
    if found:
        missing = next(part for part in parts if part not in names)
        raise InputError(f"{path}: no column {missing!r} beside {found[0]!r}")
    listed = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "") if names else "none"
    raise InputError(f"{path}: no column {vector!r} and no {', '.join(parts)} (columns: {listed})")


def momentum_columns(path: str | Path, names: Iterable[str], mass: float | None) -> tuple[str, ...]:
    """The columns that hold the angular momentum; none without such a column, or where MOMENTUM has no mass beside it.

    Raises InputError where the mass has nothing to divide.
    """
    names = list(names)
    if any(name in names for name in (SPECIFIC, f"{SPECIFIC}_x")):
        if mass is not None:
            raise InputError(f"{path}: column {SPECIFIC!r} is per unit mass already (expected no mass, or {MOMENTUM!r})")
        return spelling(path, SPECIFIC, names)
    return () if mass is None else spelling(path, MOMENTUM, names)


def refuse_clashes(path: str | Path, names: Iterable[str], reserved: Iterable[str] = tuple(FIELDS)) -> None:
    """Raises InputError if a column of the file has the name of one that will be written."""
    reserved = set(reserved)
    for name in names:
        if name in reserved:
            raise InputError(f"{path}: column {name!r} has the name of an output column; rename or drop it")
