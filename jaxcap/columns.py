"""The columns of a dataset: how a state is spelt in a file, and what is written beside it."""

import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import jaxcap
from jaxcap.capture_point import Baselines
from jaxcap.contact_columns import POINTS, RowChoices, RowContacts
from jaxcap.contact_files import ContactSets
from jaxcap.contacts import ContactSet
from jaxcap.errors import InputError
from jaxcap.result import Capturability, Case, Status

VECTORS = ("com", "com_velocity")
"""The columns that every state file has: `com` (3), or com_x, com_y, com_z; and so on."""


class StateBatch(NamedTuple):
    """Consecutive rows of a state file."""

    coms: Float[np.ndarray, "n 3"]
    """CoM positions [m]."""
    com_velocities: Float[np.ndarray, "n 3"]
    """CoM velocities [m/s]."""
    columns: Mapping[str, Any]
    """Every column as it was read, the two above included: NumPy arrays, or Arrow arrays where the file is Parquet."""
    contacts: RowContacts | RowChoices | None = None
    """What the columns say about the contacts of each row, if there are such columns."""


class Field(NamedTuple):
    """What the output says about one of its own columns."""

    unit: str
    meaning: str


FIELDS = {
    "capturable": Field("", "whether the robot can come to rest without moving a contact"),
    "case": Field("", "how the state ends"),
    "status": Field("", "whether to trust the answer"),
    "margin": Field("m/s", "speed to add or to shed before the verdict flips; exact; negative where not capturable"),
    "min_speed": Field("m/s", "smallest capturable speed along the given velocity"),
    "max_speed": Field("m/s", "largest capturable speed along the given velocity, possibly infinite"),
    "paper_margin": Field(
        "m/s^2 or m/s",
        "proxy of Section III-D of the paper: where capturable, the largest deceleration at the stop [m/s^2]; "
        "where not, minus the speed that is left [m/s]",
    ),
    "distance": Field("m", "path length to the stop; NaN where there is no stop"),
    "time": Field("s", "duration of that manoeuvre; NaN where there is no stop"),
    "residual_speed": Field("m/s", "speed that is left where contact is lost or the motion diverges; 0 at a stop"),
}
"""The columns that are added to each row: the fields of `Capturability`, in that order."""

BASELINES = {
    "capture_point_support": Field("m", "signed distance of the capture point to the support polygon; negative outside"),
    "capture_point_hull": Field(
        "m", "signed distance of the capture point to the convex hull of the contact points; negative outside"
    ),
}
"""The columns that are added on request: the fields of `capture_point.Baselines`, in that order."""

NAMES = {
    "case": {case.name: case.value for case in Case},
    "status": {status.name.lower(): status.value for status in Status},
}
"""Names of the values of the columns that hold codes."""

METADATA = "metadata"
"""Name of the NPZ member that holds the metadata."""


def output_types(dtype: np.dtype, fields: Iterable[str] = tuple(FIELDS)) -> dict[str, np.dtype]:
    """NumPy type of each column that is added, with figures in `dtype`."""
    codes = {"capturable": np.dtype(bool), "case": np.dtype(np.int8), "status": np.dtype(np.int8)}
    return {name: codes.get(name, np.dtype(dtype)) for name in fields}


def output_columns(answers: Capturability | Baselines, dtype: np.dtype) -> dict[str, np.ndarray]:
    """The columns that are added, on the host."""
    types = output_types(dtype, answers._fields)
    return {name: np.asarray(getattr(answers, name)).astype(kind, copy=False) for name, kind in types.items()}


def describe(
    contacts: ContactSet | ContactSets | tuple[str, ...], gravity: Iterable[float], sides: int, dtype: np.dtype,
    fields: Mapping[str, Field] = FIELDS, **more: Any,
) -> dict[str, Any]:
    """What the output file says about itself: conventions, units, names of codes, what it was computed from.

    contacts: the set of all states, the sets that a column chooses from, or the names of the columns that hold them. fields:
    the columns that are added. more: what else there is to say.
    """
    own = {} if isinstance(contacts, ContactSet | ContactSets) else {POINTS: "m"}
    return {
        "written_by": f"jaxcap {jaxcap.__version__}",
        "conventions": "one inertial frame for all positions and velocities, z up, SI units; "
        "frames: columns are tangent, tangent, normal pointing at the robot",
        "units": {"com": "m", "com_velocity": "m/s"} | own | {name: field.unit for name, field in fields.items()},
        "meanings": {name: field.meaning for name, field in fields.items()},
        **NAMES,
        "dtype": np.dtype(dtype).name,
        "gravity": [float(g) for g in gravity],
        "sides": int(sides),
        "contacts": _described(contacts),
        **more,
    }


def _described(contacts: ContactSet | ContactSets | tuple[str, ...]) -> Any:
    if isinstance(contacts, ContactSet):
        return {name: np.asarray(getattr(contacts, name)).tolist() for name in ("points", "frames", "friction")}
    if isinstance(contacts, ContactSets):
        return [{"name": name, **_described(one)} for name, one in zip(contacts.names, contacts.sets, strict=True)]
    return list(contacts)


def to_json(metadata: Mapping[str, Any]) -> str:
    """The text that is stored in the file."""
    return json.dumps(metadata, allow_nan=False)


def spelling(path, vector: str, names: Iterable[str]) -> tuple[str, ...]:
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


def refuse_clashes(path, names: Iterable[str], reserved: Iterable[str] = tuple(FIELDS)) -> None:
    """Raises InputError if a column of the file has the name of one that will be written."""
    reserved = set(reserved)
    for name in names:
        if name in reserved:
            raise InputError(f"{path}: column {name!r} has the name of an output column; rename or drop it")
