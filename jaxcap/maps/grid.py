"""Grids of states: named axes, and the states at their points, made where and when they are needed.

A grid is never one array of states. Of every axis there is a table of its values, and a state is looked up in the tables
by its indices, on the host and on the device in the same arithmetic.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import DTypeLike

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import FloatArray
from jaxcap.errors import InputError

POSITION = ("com_x", "com_y", "com_z")
CARTESIAN = ("velocity_x", "velocity_y", "velocity_z")
POLAR = ("heading", "pitch", "speed")
MOMENTUM = tuple(f"specific_angular_momentum_{axis}" for axis in "xyz")
CONTACTS = ("contact_set", "friction", "slope", "downhill")
"""Axes along which the contacts change; see `contact_axes`."""


class About(NamedTuple):
    """What files and pictures say about an axis."""

    unit: str
    label: str
    """Beside an axis of a picture."""
    meaning: str


AXES = {
    "com_x": About("m", "CoM position x", "CoM position, x"),
    "com_y": About("m", "CoM position y", "CoM position, y"),
    "com_z": About("m", "CoM position z", "CoM position, z, up"),
    "velocity_x": About("m/s", "CoM velocity x", "CoM velocity, x"),
    "velocity_y": About("m/s", "CoM velocity y", "CoM velocity, y"),
    "velocity_z": About("m/s", "CoM velocity z", "CoM velocity, z, up"),
    "heading": About("rad", "heading", "direction of the CoM velocity in the horizontal plane, from x towards y"),
    "pitch": About("rad", "pitch", "elevation of the CoM velocity above the horizontal plane"),
    "speed": About("m/s", "CoM speed", "norm of the CoM velocity"),
    **{
        name: About(
            "m^2/s", f"angular momentum {name[-1]} / mass", f"angular momentum about the CoM over the mass, {name[-1]}"
        )
        for name in MOMENTUM
    },
    "contact_set": About("1", "contact set", "contact set, counted from 0"),
    "friction": About("1", "friction coefficient", "friction coefficient of all contacts"),
    "slope": About("rad", "slope", "tilt of all contacts, about a level axis through their centroid"),
    "downhill": About("rad", "downhill", "direction in which the slope goes down, from x towards y"),
}
"""Every axis that a grid may have."""

DEFAULTS = {"pitch": 0.0, "velocity_z": 0.0}
"""Values of axes that may be left out: the velocity is horizontal."""
LARGEST = {"heading": 2 * math.pi, "pitch": math.pi / 2, "slope": math.pi, "downhill": 2 * math.pi}
"""Angles are no larger than this [rad]: more is likely to be degrees."""

LONGEST = 10_000_000
"""Most values of an axis."""
FULL_CIRCLE = 1e-4
"""A range of directions whose length differs from 2 pi by less than this [rad] is a full circle."""
MARGIN, ABOVE, PLACES, HEADINGS = 0.1, 0.8, 41, 72
"""Axes around a stance: how far beyond the contacts [m], how far above the lowest [m], values of x and y, headings."""


@dataclass(frozen=True, eq=False)
class Grid:
    """The states at all combinations of the axes' values; `grid_of` makes one."""

    axes: dict[str, Float[np.ndarray, "..."]]
    """Values of each axis in float64: (n,), or () for an axis with one value, along which the grid has no dimension."""

    @property
    def dims(self) -> tuple[str, ...]:
        """The axes along which the grid extends, in the order in which they were given."""
        return tuple(name for name, values in self.axes.items() if values.ndim)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each of `dims`."""
        return tuple(len(self.axes[name]) for name in self.dims)

    @property
    def size(self) -> int:
        """Number of states; without a speed, of lines of travel."""
        return math.prod(self.shape)

    @property
    def polar(self) -> bool:
        """Whether directions are given by heading and pitch."""
        return "heading" in self.axes

    @property
    def spins(self) -> bool:
        """Whether states have angular momentum: what goes with it depends on the speed, so speeds are no more one line."""
        return any(name in self.axes for name in MOMENTUM)

    @property
    def has_speed(self) -> bool:
        """Whether the points are states; otherwise they are lines of travel."""
        return not self.polar or "speed" in self.axes

    def tables(self, dtype: DTypeLike) -> dict[str, Float[np.ndarray, "..."]]:
        """What states are looked up in: values, (n,), and for angles cosine and sine, (2, n)."""
        table = lambda name: _table(name, np.atleast_1d(self.axes[name])).astype(dtype)
        with np.errstate(over="ignore"):  # beyond the largest number there is infinity, and the states are marked
            return {name: table(name) for name in self.axes if name not in CONTACTS}

    def states(
        self, index: Int[np.ndarray, " n"], dtype: DTypeLike = np.float64
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """The states that the map's answers are the answers to. Along axes of `CONTACTS` they are the same.

        Args:
            index: (n,) points, counted in the order of `dims`, the last one fastest.
            dtype: Of the states.

        Returns:
            CoM positions (n, 3) [m] and velocities (n, 3) [m/s].

        Raises:
            IndexError: For a point that is not there.
        """
        index = np.asarray(index)
        if len(index) and not 0 <= index.min() <= index.max() < self.size:
            raise IndexError(f"index from {index.min()} to {index.max()} (expected 0 to {self.size - 1})")
        places = dict(zip(self.dims, np.unravel_index(index, self.shape), strict=True)) if self.dims else {}
        nowhere = np.zeros_like(index)
        tables = self.tables(dtype)
        com, along = look_up(tables, {name: places.get(name, nowhere) for name in tables})
        return np.asarray(com.T), np.asarray(along.T)

    def momenta(self, index: Int[np.ndarray, " n"], dtype: DTypeLike = np.float64) -> Float[np.ndarray, "n 3"] | None:
        """The angular momenta over the mass that go with `states`, (n, 3) [m^2/s]; None without such axes."""
        places = dict(zip(self.dims, np.unravel_index(index, self.shape), strict=True)) if self.dims else {}
        tables = self.tables(dtype)
        found = look_up_momentum(tables, {name: places.get(name, np.zeros_like(index)) for name in tables})
        return None if found is None else np.asarray(found.T)


def grid_of(axes: Mapping[str, Any]) -> Grid:
    """The grid with these axes.

    Args:
        axes: See `jaxcap.maps.kernel_map`, which says what they may be.

    Raises:
        InputError: Naming the axis that cannot be used.
    """
    unknown = next((name for name in axes if name not in AXES), None)
    if unknown is not None:
        raise InputError(f"axis {unknown!r} is not known (expected {', '.join(AXES)})")
    cartesian, polar = ([name for name in group if name in axes] for group in (CARTESIAN, POLAR))
    if cartesian and polar:
        raise InputError(
            f"axes {cartesian[0]} and {polar[0]}: the velocity is given twice (expected {', '.join(CARTESIAN)}, "
            f"or {', '.join(POLAR)})"
        )
    needed = (*POSITION, *(CARTESIAN[:2] if cartesian else POLAR[:1]))
    missing = next((name for name in needed if name not in axes), None)
    if missing is not None:
        raise InputError(f"axis {missing!r} is missing (expected {', '.join(needed)}, and perhaps others)")
    if "downhill" in axes and "slope" not in axes:
        raise InputError("axis downhill: there is no slope (expected an axis 'slope')")
    given = {name: _values(name, values) for name, values in axes.items()}
    if polar and "speed" not in axes and set(axes) & set(MOMENTUM):
        name = next(name for name in axes if name in MOMENTUM)
        raise InputError(f"axis {name} needs a speed (expected an axis 'speed', or {', '.join(CARTESIAN)})")
    horizontal = CARTESIAN[2] if cartesian else "pitch"
    return Grid(given | ({} if horizontal in given else {horizontal: np.array(DEFAULTS[horizontal])}))


def axes_around(contacts: ContactSet | Iterable[ContactSet], axes: Mapping[str, Any]) -> dict[str, Any]:
    """These axes, and for those that are missing a useful choice around the contacts, of one set or of several.

    com_x, com_y: 41 values from 0.1 m before the first contact to 0.1 m beyond the last. com_z: 0.8 m above the lowest
    contact. heading: 72 values all around, unless the velocity is given by its components.

    Args:
        contacts: One set, or several.
        axes: Those that are given.

    Raises:
        InputError: If there is no contact to be around.
    """
    sets = [contacts] if isinstance(contacts, ContactSet) else contacts
    points = np.concatenate([np.asarray(one.points)[np.asarray(one.mask)] for one in sets])
    if len(points) == 0:
        raise InputError("contacts: none is active (expected at least one)")
    low, high = points.min(axis=0), points.max(axis=0)
    around = lambda i: np.linspace(low[i] - MARGIN, high[i] + MARGIN, PLACES)
    choice = {"com_x": around(0), "com_y": around(1), "com_z": low[2] + ABOVE}
    if not set(axes) & set(CARTESIAN):
        choice["heading"] = f"0:360deg:{HEADINGS}"
    return {**{name: value for name, value in choice.items() if name not in axes}, **axes}


def look_up(
    tables: Mapping[str, FloatArray], places: Mapping[str, Int[FloatArray, " n"]]
) -> tuple[Float[FloatArray, "3 n"], Float[FloatArray, "3 n"]]:
    """CoM (3, n) [m], and velocity [m/s] or, of polar axes without a speed, direction (3, n), at these places."""
    xp = np if isinstance(next(iter(places.values())), np.ndarray) else jnp
    at = lambda name: tables[name][..., places[name]]
    if "heading" not in tables:
        return xp.stack([at(name) for name in POSITION]), xp.stack([at(name) for name in CARTESIAN])
    heading, pitch = at("heading"), at("pitch")
    along = xp.stack([heading[0] * pitch[0], heading[1] * pitch[0], pitch[1]])
    return xp.stack([at(name) for name in POSITION]), along * at("speed") if "speed" in tables else along


def look_up_momentum(
    tables: Mapping[str, FloatArray], places: Mapping[str, Int[FloatArray, " n"]]
) -> Float[FloatArray, "3 n"] | None:
    """Angular momentum over the mass (3, n) [m^2/s] at these places of the tables; None if no axis gives any."""
    given = [name for name in MOMENTUM if name in tables]
    if not given:
        return None
    xp = np if isinstance(places[given[0]], np.ndarray) else jnp
    nothing = xp.zeros_like(tables[given[0]][..., places[given[0]]])
    return xp.stack([tables[name][..., places[name]] if name in given else nothing for name in MOMENTUM])


def _table(name: str, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, "..."]:
    if AXES[name].unit != "rad":
        return values
    turned = np.stack([np.cos(values), np.sin(values)])
    return np.where(np.abs(turned) < 1e-15, 0, turned)  # rounding of pi: a heading of 90 degrees is along y exactly


def _values(name: str, given: Any) -> Float[np.ndarray, "..."]:
    """The values of an axis, checked."""
    if isinstance(given, str):
        values = _from_text(name, given)
    else:
        try:
            values = np.array(given, np.float64)
        except (TypeError, ValueError):
            raise InputError(f"axis {name}: {given!r:.60} (expected a number, a list of numbers, or text)") from None
    if values.ndim > 1 or values.size == 0:
        raise InputError(f"axis {name} has shape {values.shape} (expected a number, or a list of at least one)")
    bad = values[~np.isfinite(values)]
    if bad.size:
        raise InputError(f"axis {name} holds {bad[0]} (expected finite numbers)")
    if values.ndim and len(np.unique(values)) < len(values):
        twice = next(value for value in values if np.sum(values == value) > 1)
        raise InputError(f"axis {name} holds {twice:g} twice (expected different values)")
    if name == "speed" and values.min() < 0:
        raise InputError(f"axis speed holds {values.min():g} m/s (expected no negative speed; turn the heading)")
    if name == "friction" and values.min() <= 0:
        raise InputError(f"axis friction holds {values.min():g} (expected positive numbers)")
    most = LARGEST.get(name, math.inf)
    if np.abs(values).max() > most + FULL_CIRCLE:
        worst = values.flat[np.abs(values).argmax()]
        raise InputError(f"axis {name} holds {worst:g} rad (expected at most {most:.4f}; write {worst:g}deg for degrees)")
    return values


def _from_text(name: str, text: str) -> Float[np.ndarray, "..."]:
    """VALUE, FIRST:LAST:COUNT or A,B,C; angles may end in `deg`."""
    degrees = AXES[name].unit == "rad" and "deg" in text
    unit = math.radians(1) if degrees else 1.0
    bare = re.sub(r"deg(?=$|[:,])", "", text) if degrees else text
    number = lambda part: unit * float(part)
    try:
        if ":" not in bare:
            return np.array([number(part) for part in bare.split(",")]) if "," in bare else np.array(number(bare))
        start, end, size = bare.split(":")
        first, last, n = number(start), number(end), int(size)
    except ValueError:
        example = "0:360deg:72" if AXES[name].unit == "rad" else "-0.4:0.4:201"
        expected = f"a value, FIRST:LAST:COUNT or A,B,C; for example {name}={example}"
        raise InputError(f"axis {name}: {text!r:.60} (expected {expected})") from None
    if not 2 <= n <= LONGEST:
        raise InputError(f"axis {name}: {text!r} has {n} values (expected 2 to {LONGEST})")
    if name in ("heading", "downhill") and abs(abs(last - first) - 2 * math.pi) < FULL_CIRCLE:
        return first + math.copysign(2 * math.pi, last - first) * np.arange(n) / n  # its end is its beginning
    return np.linspace(first, last, n)
