"""Options of several commands, and those of the form NAME=VALUE."""

import math
from collections.abc import Iterable

from jaxcap.errors import InputError
from jaxcap.files.columns import MOMENTUM
from jaxcap.files.state_file import StateFile


def named_values(option: str, given: Iterable[str], expected: str) -> dict[str, str]:
    """Names and texts of the values of an option of the command line, NAME=TEXT each, in the order given.

    Raises InputError where there is no name, or one twice.
    """
    values = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"{option} {text} (expected {expected})")
        if name in values:
            raise InputError(f"{option} {name} is given twice")
        values[name] = value
    return values


def check_momentum_box(box: float) -> None:
    """Raises InputError for a box that cannot be used [m^2/s^2]."""
    if not 0 <= box < math.inf:
        raise InputError(f"--momentum-box {box} (expected a number of m^2/s^2, not negative: N m over the mass)")


def check_mass(mass: float | None) -> None:
    """Raises InputError for a mass that cannot be used [kg]."""
    if mass is not None and not 0 < mass < math.inf:
        raise InputError(f"--mass {mass} (expected a positive number of kilograms)")


def check_sides(sides: int) -> None:
    """Raises InputError for too few edges of a friction pyramid."""
    if sides < 3:
        raise InputError(f"--sides {sides} (expected at least 3)")


def without_mass(source: StateFile) -> str | None:
    """What to say of a column of angular momentum that does not count."""
    there = {MOMENTUM, f"{MOMENTUM}_x"} & set(source.types)
    return f"column {MOMENTUM!r} does not count without --mass" if there and not source.momentum else None
