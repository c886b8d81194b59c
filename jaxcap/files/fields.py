"""What an answer is made of: one table of fields, with types, units and words."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from jaxcap.one_state.result import Capturability, Case, Status
from jaxcap.regions.capture_point import Baselines


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

def output_types(dtype: np.dtype, fields: Iterable[str] = tuple(FIELDS)) -> dict[str, np.dtype]:
    """NumPy type of each column that is added, with figures in `dtype`."""
    codes = {"capturable": np.dtype(bool), "case": np.dtype(np.int8), "status": np.dtype(np.int8)}
    return {name: codes.get(name, np.dtype(dtype)) for name in fields}


def output_columns(answers: Capturability | Baselines, dtype: np.dtype) -> dict[str, np.ndarray]:
    """The columns that are added, on the host."""
    types = output_types(dtype, answers._fields)
    return {name: np.asarray(getattr(answers, name)).astype(kind, copy=False) for name, kind in types.items()}
