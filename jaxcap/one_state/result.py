"""What the predictor answers: how a state ends, whether to trust it, and the figures."""

from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int8

from jaxcap.errors import needs_extra

if TYPE_CHECKING:
    import pandas as pd


class Case(IntEnum):
    """How the state ends: the leaves of the decision tree (Fig. 3), and EMPTY."""

    UNDECIDED = -1
    """No answer was found; `Status` says why."""
    C1 = 0
    """Diverges: the smallest feasible acceleration turns non-negative while rising. Not capturable."""
    C2 = 1
    """Leaves the polygon: no acceleration keeps the contacts. Not capturable."""
    C3_1 = 2
    """Under maximum deceleration it stops where it can stand. Capturable."""
    C3_2_1 = 3
    """Could stop too early, and decelerating less it reaches a place where it can stand. Capturable."""
    C3_2_2 = 4
    """Stops too early however little it decelerates, and falls back. Not capturable."""
    C3_3 = 5
    """Stops beyond the places where it can stand and swings back (a hanging robot). Either verdict."""
    EMPTY = 6
    """Nowhere along its line could the robot stand still: there is no contact, or nowhere to stand. Not capturable."""


class Status(IntEnum):
    """Whether to trust the answer. The verdict is never positive unless the status is OK, NO_DIRECTION or MAX_SWINGS."""

    OK = 0
    NO_DIRECTION = 1
    """Zero velocity, or one that is lost beside the angular momentum: capturable if and only if the CoM is in static
    equilibrium; margin and speeds are NaN."""
    MAX_STEPS = 2
    """The polygon has more edges than are walked, or the simplex takes too many pivots; undecided."""
    MAX_SWINGS = 3
    """The verdict and margins stand, but the robot still swings when the bound on swings is reached: no time, distance."""
    NONFINITE = 4
    """The state, its contacts or gravity hold NaN or infinity, or are beyond what the precision holds: a CoM so far from the
    contacts that their size is lost in rounding, or faster than light; undecided."""


CODES: dict[str, np.dtype] = {"capturable": np.dtype(bool), "case": np.dtype(np.int8), "status": np.dtype(np.int8)}
"""The fields of an answer that are no figures, by their types: all others have that of the state."""


class Capturability(NamedTuple):
    """The answer for one state, or arrays of answers with one leading axis for many.

    Speeds are along the direction of the given velocity. Where no speed in that direction is capturable, `min_speed` and
    `max_speed` are both zero, and the margin is minus the whole speed. Figures of states that are undecided are NaN.
    Gradients are exact away from kinks and never NaN where the figure is a number; `distance`, `time` and `residual_speed`
    are not differentiated in C3.3.
    """

    capturable: Bool[Array, "..."]
    """Whether the robot can come to rest without moving a contact."""
    case: Int8[Array, "..."]
    """A `Case`."""
    status: Int8[Array, "..."]
    """A `Status`."""
    margin: Float[Array, "..."]
    """Speed that could be added, or that would have to be shed or added, before the verdict flips [m/s]. Exact; not
    negative if and only if capturable. Infinite where every speed is capturable."""
    min_speed: Float[Array, "..."]
    """Smallest capturable speed [m/s]: below it the robot does not reach a place where it can stand."""
    max_speed: Float[Array, "..."]
    """Largest capturable speed [m/s], possibly infinite."""
    paper_margin: Float[Array, "..."]
    """The proxy of Section III-D: where capturable, the largest deceleration at the place where the CoM stops under
    maximum deceleration [m/s^2]; where not, minus the speed that is left [m/s]."""
    distance: Float[Array, "..."]
    """Path length to the stop [m], NaN where there is no stop."""
    time: Float[Array, "..."]
    """Duration of that manoeuvre [s], NaN where there is no stop."""
    residual_speed: Float[Array, "..."]
    """Speed that is left where the walk ends in C1 or C2 [m/s], zero where it stops."""
    effort: Float[Array, "..."]
    """Share of the robot's torque limits that holding still takes where it is; above one the posture cannot be held, and
    is not capturable. Infinite where no torques hold it; NaN without actuation."""

    def __repr__(self) -> str:
        """A line: one state's answer, or how many of many can stop, and their margins."""
        arrays = np.ndarray | np.generic | jax.Array
        if any(isinstance(field, jax.core.Tracer) or not isinstance(field, arrays) for field in self):
            return f"Capturability({', '.join(f'{name}={field}' for name, field in zip(self._fields, self, strict=True))})"
        capturable, margin, status = (np.asarray(field) for field in (self.capturable, self.margin, self.status))
        if capturable.ndim == 0:
            figures = {name: float(getattr(self, name)) for name in self._fields[3:]}
            if np.isnan(figures["effort"]):
                del figures["effort"]  # it was not asked for
            said = "".join(f", {name}={value:.4g}" for name, value in figures.items())
            case, said_of = Case(int(self.case)).name, Status(int(status)).name
            return f"Capturability(capturable={bool(capturable)}, case={case}, status={said_of}{said})"
        known = margin[~np.isnan(margin)]
        low, middle, high = np.quantile(known, [0, 0.5, 1], method="nearest") if known.size else (np.nan,) * 3
        sound = np.isin(status, [Status.OK, Status.NO_DIRECTION, Status.MAX_SWINGS])
        doubt = "" if sound.all() else f", {np.sum(~sound):,} without an answer (see status)"
        return (
            f"Capturability({capturable.size:,} states: {capturable.sum():,} capturable, "
            f"margin {low:.3g} to {high:.3g} m/s, median {middle:.3g}{doubt}; {margin.dtype})"
        )

    def to_pandas(self, index: Any = None) -> "pd.DataFrame":
        """A row for each state, with the names of cases and statuses as categoricals.

        Args:
            index: of the rows, such as that of the frame that the states came from; by default 0, 1, ...

        Returns:
            A DataFrame with the columns of `_fields`, with the units that they have here.

        Raises:
            MissingExtra: without pandas (extra `data`).
        """
        with needs_extra("data", "Capturability.to_pandas"):
            import pandas as pd
        columns = {name: np.atleast_1d(np.asarray(field)) for name, field in zip(self._fields, self, strict=True)}
        for name, kind in (("case", Case), ("status", Status)):
            names = [code.name.lower() if kind is Status else code.name for code in kind]
            columns[name] = pd.Categorical.from_codes(columns[name].astype(int) - min(kind), names)
        return pd.DataFrame(columns, index=index)
