"""What an answer is made of: one table of fields, from which every description takes its words.

The list in `jaxcap score --help`, the closing table, the metadata of scores and maps, the labels of pictures and the table
in the README (`python -m jaxcap.files.fields` prints it) are this table in other shapes. Tests hold the README and the
docstrings of `Capturability` against it.
"""

import textwrap
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from jaxcap.one_state.result import CODES, Capturability, Case, Status
from jaxcap.regions.capture_point import Baselines


class Field(NamedTuple):
    """What there is to say about one field of an answer, which is one column of the output."""

    unit: str
    """Empty for pure numbers and codes."""
    label: str
    """Beside an axis or a colour bar."""
    brief: str
    """In a list on the terminal."""
    meaning: str
    """In full: in the README, and in files."""


FIELDS = {
    "capturable": Field(
        "", "capturable", "whether it can come to rest", "whether the robot can come to rest without moving a contact"
    ),
    "case": Field(
        "",
        "case",
        "how it ends: C1, C2, C3_1, ..., as a number",
        "how the state ends (`jaxcap.Case`: the leaves of the paper's decision tree; EMPTY: no contact or nowhere to stand)",
    ),
    "status": Field(
        "",
        "status",
        "whether to trust that: ok, no_direction, ..., as a number",
        "whether to trust the answer (`jaxcap.Status`)",
    ),
    "margin": Field(
        "m/s",
        "margin",
        "speed to add or to shed before the verdict flips, exact, negative where not capturable; NaN at rest",
        "speed that could be added, or would have to be shed, before the verdict flips; exact; not negative if and only if "
        "capturable; infinite where every speed is; NaN at rest, where `robustness` is the answer",
    ),
    "min_speed": Field(
        "m/s",
        "smallest capturable speed",
        "smallest capturable speed in that direction",
        "smallest capturable speed along the given velocity",
    ),
    "max_speed": Field(
        "m/s",
        "largest capturable speed",
        "largest capturable speed in that direction",
        "largest capturable speed along the given velocity, possibly infinite",
    ),
    "paper_margin": Field(
        "m/s^2 or m/s",
        "margin of the paper",
        "the paper's own proxy: deceleration at the stop [m/s^2]; where not capturable, minus the speed left [m/s]",
        "the paper's own, cheaper proxy for the margin (Section III-D): where capturable, the largest deceleration at the "
        "stop [m/s^2]; where not, minus the speed that is left [m/s]",
    ),
    "distance": Field(
        "m", "distance to the stop", "path length to the stop", "path length to the stop; NaN where there is no stop"
    ),
    "time": Field(
        "s", "time to the stop", "duration of that manoeuvre", "duration of that manoeuvre; NaN where there is no stop"
    ),
    "residual_speed": Field(
        "m/s",
        "speed that is left",
        "speed left where there is no stop",
        "speed that is left where contact is lost or the motion diverges; 0 at a stop",
    ),
    "effort": Field(
        "",
        "effort",
        "share of the torque limits that holding still takes, above 1: cannot be held; NaN without them",
        "share of the robot's torque limits that holding still takes where it is; above 1 the posture cannot be held, and "
        "is not capturable; infinite where no torques hold it; NaN without `actuation`",
    ),
}
"""The columns that are added to each row: the fields of `Capturability`, in that order."""
BASELINES = {
    "capture_point_support": Field(
        "m",
        "capture point in support polygon",
        "distance of the capture point to the support polygon, where the CoM can stand",
        "signed distance of the capture point to the support polygon; negative outside",
    ),
    "capture_point_hull": Field(
        "m",
        "capture point in hull of contacts",
        "distance of the capture point to the convex hull of the contact points",
        "signed distance of the capture point to the convex hull of the contact points; negative outside",
    ),
}
"""The columns that are added on request: the fields of `capture_point.Baselines`, in that order."""

CASES = {
    Case.C1: "diverges",
    Case.C2: "leaves the contacts",
    Case.C3_1: "stops where it can stand",
    Case.C3_2_1: "stops, decelerating less",
    Case.C3_2_2: "stops too early, falls back",
    Case.C3_3: "stops beyond, swings back",
    Case.EMPTY: "no contact or nowhere to stand",
    Case.UNDECIDED: "undecided",
}
"""How a state ends, in words."""
STATUSES = {
    Status.OK: "",
    Status.NO_DIRECTION: "zero velocity: no margin",
    Status.MAX_STEPS: "undecided",
    Status.MAX_SWINGS: "verdict and margin stand",
    Status.NONFINITE: "NaN or infinity in the state",
}
"""What there is to know beside the verdict, in words."""
NAMES = {
    "case": {case.name: case.value for case in Case},
    "status": {status.name.lower(): status.value for status in Status},
}
"""Names of the values of the columns that hold codes."""

LINE_WIDTH = 79
"""Of the list on the terminal."""


def output_types(dtype: DTypeLike, fields: Iterable[str] = tuple(FIELDS)) -> dict[str, np.dtype]:
    """NumPy type of each column that is added, with figures in `dtype`."""
    return {name: CODES.get(name, np.dtype(dtype)) for name in fields}


def output_columns(answers: Capturability | Baselines, dtype: DTypeLike) -> dict[str, np.ndarray]:
    """The columns that are added, on the host."""
    types = output_types(dtype, answers._fields)
    return {name: np.asarray(getattr(answers, name)).astype(kind, copy=False) for name, kind in types.items()}


def field_list(fields: Mapping[str, Field]) -> str:
    """The fields and their brief meanings as two columns of text, for the terminal."""
    lines, width = [], max(map(len, fields)) + 3
    for name, field in fields.items():
        first = f"{'':4}{name:<{width}}"
        text = _with_unit(field.brief, field.unit)
        lines += textwrap.wrap(text, LINE_WIDTH, initial_indent=first, subsequent_indent=" " * len(first))
    return "\n".join(lines)


def markdown_table(fields: Mapping[str, Field] = FIELDS) -> str:
    """The fields and their full meanings as a table of the README."""
    rows = (f"| `{name}` | {_with_unit(field.meaning, field.unit)} |" for name, field in fields.items())
    return "\n".join(("| field | meaning |", "|---|---|", *rows))


def _with_unit(text: str, unit: str) -> str:
    """Text and unit, unless the text tells units itself."""
    return text if not unit or "[" in text else f"{text} [{unit}]"


if __name__ == "__main__":
    print(markdown_table())
