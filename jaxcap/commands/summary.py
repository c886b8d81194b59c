"""The closing table: counts of cases and statuses, quantiles of the margin, in memory that does not grow."""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxcap.files.fields import CASES, STATUSES
from jaxcap.one_state.result import Capturability

QUANTILES = (0.05, 0.25, 0.50, 0.75, 0.95)

COARSE = 1e-4
"""Positions that are rounded to more than this are worth a word [m]."""
ENOUGH = 1000
"""So many rows of a batch, evenly spread, tell how far away all are."""


def rounding(coms: Float[np.ndarray, "n 3"]) -> str:
    """What there is to say where half of the positions are so far from the origin that single precision rounds them; else
    nothing.
    """
    far = np.abs(coms[:: max(1, len(coms) // ENOUGH)]).max(axis=1)
    far = far[np.isfinite(far)]
    typical = np.median(far) if len(far) else far.dtype.type(0)  # a single row that is far off is no matter
    step = np.spacing(typical)
    if coms.dtype != np.float32 or step <= COARSE:
        return ""
    return f"positions {typical:.3g} m from the origin are rounded to {step:.2g} m (--dtype float64 keeps them)"


class Quantiles:
    """Quantiles of a stream of numbers, to within 0.025 % of the value; NaN is left out.

    A file of states may be larger than memory, and so may the margins of it. So the numbers are rounded to 12 bits, 2,048
    values for each power of two, and equal ones are kept once, with how many they are. Zero and infinities are exact, and
    the order of the numbers does not matter. bits: fewer where many of these are kept.
    """

    def __init__(self, bits: int = 12) -> None:
        self._bits = bits
        self._values, self._weights = np.zeros(0), np.zeros(0, np.int64)

    def add(self, values: Float[np.ndarray, " n"], weights: Int[np.ndarray, " n"] | None = None) -> None:
        """Takes these values as well. weights: how often each; by default once."""
        weights = np.ones(len(values), np.int64) if weights is None else weights
        known = ~np.isnan(values)
        mantissa, exponent = np.frexp(values[known].astype(np.float64))
        rounded = np.ldexp(np.rint(mantissa * (1 << self._bits)), exponent - self._bits)
        self._values, places = np.unique(np.concatenate([self._values, rounded]), return_inverse=True)
        weights = np.concatenate([self._weights, weights[known]])
        self._weights = np.bincount(places, weights, minlength=len(self._values)).astype(np.int64)

    def histogram(self, bits: int) -> dict[str, list]:
        """The numbers rounded to so many bits, and how many of each there are, as JSON can hold it."""
        coarse = Quantiles(bits)
        coarse.add(self._values, self._weights)
        return {"values": [_plain(value) for value in coarse._values], "numbers": coarse._weights.tolist()}

    @classmethod
    def of(cls, histograms: Iterable[Mapping[str, list]], bits: int) -> "Quantiles":
        """Of all numbers of these histograms."""
        found, all_of_them = cls(bits), list(histograms)
        values = [float(value) for one in all_of_them for value in one["values"]]
        found.add(np.array(values), np.array([n for one in all_of_them for n in one["numbers"]], np.int64))
        return found

    def named(self) -> dict[str, float | str]:
        """Each of QUANTILES by its share in percent, as JSON can hold it; none of no numbers."""
        return {f"{share:.0%}": _plain(self(share)) for share in QUANTILES} if len(self) else {}

    def table(self, words: str) -> str:
        """Lines of text. words: about what they are."""
        lines = [f"margin [m/s], of {len(self)} states{words}"]
        if len(self):
            lines += ["  " + "".join(f"{share:>10.0%}" for share in QUANTILES)]
            lines += ["  " + "".join(f"{self(share):>10.3g}" for share in QUANTILES)]
        return "\n".join(lines)

    def __len__(self) -> int:
        """How many numbers there were."""
        return int(self._weights.sum())

    def __call__(self, share: float) -> float:
        """Smallest of the numbers that at least this share of them does not exceed; NaN if there are none."""
        if not len(self):
            return float("nan")
        wanted = max(1, np.ceil(share * len(self)))
        return float(self._values[np.searchsorted(np.cumsum(self._weights), wanted)])


def _plain(value: float) -> float | str:
    """JSON knows no infinity."""
    return float(value) if math.isfinite(value) else str(float(value))


class Summary:
    """What is counted while a file is scored."""

    def __init__(self) -> None:
        self.states = 0
        self.capturable = 0
        self.cases = dict.fromkeys(CASES, 0)
        self.statuses = dict.fromkeys(STATUSES, 0)
        self.margin = Quantiles()

    def add(self, out: Capturability) -> None:
        """Counts a batch of answers, arrays (n,)."""
        case, status = np.asarray(out.case), np.asarray(out.status)
        self.states += len(case)
        self.capturable += int(np.asarray(out.capturable).sum())
        for ending in self.cases:
            self.cases[ending] += int((case == ending).sum())
        for trust in self.statuses:
            self.statuses[trust] += int((status == trust).sum())
        self.margin.add(np.asarray(out.margin))

    @property
    def counts(self) -> "Counts":
        """Without the margin, by names."""
        statuses = {status.name.lower(): n for status, n in self.statuses.items()}
        return Counts(self.states, self.capturable, {case.name: n for case, n in self.cases.items()}, statuses)

    def table(self) -> str:
        """Counts and quantiles, as lines of text."""
        return f"{self.counts.table()}\n\n{self.margin.table('')}"


class Counts(NamedTuple):
    """How many states ended how, by names, as JSON can hold it."""

    states: int
    capturable: int
    cases: dict[str, int]
    statuses: dict[str, int]

    def table(self) -> str:
        """Lines of text."""
        lines = [self._line("states", "", self.states), self._line("capturable", "", self.capturable), "", "case"]
        lines += [self._line(f"  {case.name}", CASES[case], self.cases[case.name]) for case in CASES]
        lines += ["", "status"]
        names = {status: status.name.lower() for status in STATUSES}
        lines += [self._line(f"  {name}", STATUSES[status], self.statuses[name]) for status, name in names.items()]
        return "\n".join(lines)

    def _line(self, name: str, words: str, n: int) -> str:
        share = f"{n / self.states:9.2%}" if self.states else f"{'-':>9}"
        return f"{name:<16}{words:<30}{n:>14}{share}"


def together(counts: Iterable[Counts]) -> Counts:
    """The sums of all; zeros of none."""
    both = lambda one, other: {name: one.get(name, 0) + other.get(name, 0) for name in one | other}
    total = Summary().counts
    for one in counts:
        cases, statuses = both(total.cases, one.cases), both(total.statuses, one.statuses)
        total = Counts(total.states + one.states, total.capturable + one.capturable, cases, statuses)
    return total
