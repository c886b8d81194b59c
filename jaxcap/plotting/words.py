"""What is written beside the picture of a map: names, units, places; the words are those of `FIELDS` and `AXES`."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from jaxcap.files.fields import FIELDS
from jaxcap.maps.grid import AXES

if TYPE_CHECKING:
    import xarray as xr

DEGREES = "deg"
"""Angles of a map are in radians, those of a picture in degrees."""
WIDEST = 56
"""Longest line of a title, in letters."""


def place_of(plane: "xr.Dataset") -> str:
    """Where the plane lies: the axes of the map that are not in the picture, in the order of `AXES` (a file has none)."""
    scalars = [plane.coords[name] for name in AXES if name in plane.coords and plane.coords[name].ndim == 0]
    lines = [""]
    for place in (f"{scalar.name} = {value_of(scalar)}" for scalar in scalars):
        if len(lines[-1]) + len(place) > WIDEST:
            lines.append("")
        lines[-1] += f", {place}" if lines[-1] else place
    return ",\n".join(lines)


def value_of(scalar: "xr.DataArray") -> str:
    """A coordinate's one value: with its unit, angles in degrees; or its name, if it has one."""
    codes, names = scalar.attrs.get("flag_values", ()), scalar.attrs.get("flag_meanings", "").split()
    named = dict(zip(np.atleast_1d(codes).tolist(), names, strict=False)).get(float(scalar))
    return named or f"{float(values_of(scalar)):.3g} {unit_of(scalar)}".strip()


def unit_of(array: "xr.DataArray") -> str:
    """As it is shown: empty for pure numbers."""
    unit = array.attrs.get("units", "1")
    return {"1": "", "rad": DEGREES}.get(unit, unit)


def values_of(array: "xr.DataArray") -> Float[np.ndarray, "..."]:
    """In that unit."""
    values = np.asarray(array, float)
    return np.degrees(values) if unit_of(array) == DEGREES else values


def label_of(array: "xr.DataArray") -> str:
    """What an axis or a field is called, with its unit. Of a field that is not ours the map says it."""
    known = FIELDS.get(str(array.name)) or AXES.get(str(array.name))
    name, unit = known.label if known else array.attrs.get("long_name", array.name), unit_of(array)
    return f"{name} [{unit}]" if unit else str(name)
