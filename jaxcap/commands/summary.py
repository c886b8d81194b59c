"""The closing table: counts of cases and statuses, quantiles of the margin, in memory that does not grow."""

import numpy as np
from jaxtyping import Float, UInt32

from jaxcap.one_state.result import Capturability, Case, Status

CASES = {
    Case.C1: "diverges",
    Case.C2: "leaves the contacts",
    Case.C3_1: "stops where it can stand",
    Case.C3_2_1: "the same, decelerating less",
    Case.C3_2_2: "stops too early, falls back",
    Case.C3_3: "stops beyond, swings back",
    Case.EMPTY: "nowhere to stand on its line",
    Case.UNDECIDED: "see the status",
}

STATUSES = {
    Status.OK: "",
    Status.NO_DIRECTION: "zero velocity: no margin",
    Status.MAX_STEPS: "undecided",
    Status.MAX_SWINGS: "verdict and margin stand",
    Status.NONFINITE: "NaN or infinity in the state",
}

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
    typical = np.median(far) if len(far) else far.dtype.type(0)   # a single row that is far off is no matter
    step = np.spacing(typical)
    if coms.dtype != np.float32 or step <= COARSE:
        return ""
    return f"positions {typical:.3g} m from the origin are rounded to {step:.2g} m (--dtype float64 keeps them)"


class Quantiles:
    """Quantiles of a stream of numbers in constant memory, to within 0.025 % of the value.

    The numbers are counted by the leading bits of their float32 pattern: sign, exponent, 11 bits of mantissa. Zero and
    infinities are exact, NaN is left out, and the order of the numbers does not matter.
    """

    BITS = 20

    def __init__(self):
        self._counts = np.zeros(1 << self.BITS, dtype=np.int64)

    def add(self, values: Float[np.ndarray, " n"]) -> None:
        """Counts these values."""
        with np.errstate(over="ignore"):
            single = values[~np.isnan(values)].astype(np.float32)
        keys, counts = np.unique(self._keys(single), return_counts=True)
        self._counts[keys] += counts

    def count(self) -> int:
        """How many numbers there were."""
        return int(self._counts.sum())

    def __call__(self, share: float) -> float:
        """Smallest of the numbers that at least this share of them does not exceed; NaN if there are none."""
        total = self.count()
        if total == 0:
            return float("nan")
        key = int(np.searchsorted(np.cumsum(self._counts), max(1, np.ceil(share * total))))
        return self._value(key)

    def _keys(self, single: Float[np.ndarray, " n"]) -> UInt32[np.ndarray, " n"]:
        """Leading bits, turned so that they are ordered as the numbers are."""
        pattern = single.view(np.uint32)
        negative = pattern >> 31 == 1
        return np.where(negative, ~pattern, pattern | np.uint32(1 << 31)) >> (32 - self.BITS)

    def _value(self, key: int) -> float:
        """The middle of the numbers that share these leading bits."""
        pattern = (key << (32 - self.BITS)) | (1 << (31 - self.BITS))
        positive = pattern >> 31 == 1
        pattern = pattern & 0x7FFFFFFF if positive else ~pattern & 0xFFFFFFFF
        value = float(np.uint32(pattern).view(np.float32))
        if np.isnan(value):  # the bits of infinity, and a mantissa that it does not have
            return float("inf") if positive else float("-inf")
        return value if abs(value) >= np.finfo(np.float32).tiny else 0.0


class Summary:
    """What is counted while a file is scored."""

    def __init__(self):
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
        for code in self.cases:
            self.cases[code] += int((case == code).sum())
        for code in self.statuses:
            self.statuses[code] += int((status == code).sum())
        self.margin.add(np.asarray(out.margin))

    def table(self) -> str:
        """Counts and quantiles, as lines of text."""
        lines = [self._line("states", "", self.states), self._line("capturable", "", self.capturable), "", "case"]
        lines += [self._line(f"  {case.name}", CASES[case], n) for case, n in self.cases.items()]
        lines += ["", "status"]
        lines += [self._line(f"  {status.name.lower()}", STATUSES[status], n) for status, n in self.statuses.items()]
        lines += ["", f"margin [m/s], of {self.margin.count()} states"]
        lines += ["  " + "".join(f"{share:>10.0%}" for share in QUANTILES)]
        lines += ["  " + "".join(f"{self.margin(share):>10.3g}" for share in QUANTILES)]
        return "\n".join(lines)

    def _line(self, name: str, meaning: str, count: int) -> str:
        share = f"{count / self.states:9.2%}" if self.states else f"{'-':>9}"
        return f"{name:<16}{meaning:<30}{count:>14}{share}"
