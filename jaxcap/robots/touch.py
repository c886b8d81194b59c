"""Which patches of a robot touch the ground: by height and speed, with hysteresis and a dwell.

A patch begins to touch when its lowest point is low and slow, and ceases when that is high or fast; between the two
thresholds it stays what it was. What lasts less than the dwell did not happen: first gaps are closed, then contacts as short
are dropped. Of a patch that touches, the points that are level with the lowest one do: a foot on its heel has two, not four.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int8


class Touching(NamedTuple):
    """When a patch touches."""

    low: float = 0.03
    """Below this height above the ground, and slower than `slow`, it begins [m] ..."""
    high: float = 0.05
    """... and above this it ends [m]."""
    slow: float = 0.4
    """[m/s]"""
    fast: float = 0.8
    """[m/s]"""
    dwell: float = 0.05
    """Shortest contact, and shortest gap [s]."""
    level: float = 0.03
    """Points of the patch that are less than this above the lowest one touch with it [m]: clips tilt their soles a
    little.
    """


def decided(
    heights: Float[np.ndarray, "n p"], speeds: Float[np.ndarray, "n p"], rules: Touching, before: Bool[np.ndarray, " p"]
) -> Bool[np.ndarray, "n p"]:
    """Whether each patch touches, by hysteresis alone.

    Args:
        heights: Of the lowest points above the ground [m]; NaN, where there is none, is high.
        speeds: Of these points [m/s].
        rules: The thresholds.
        before: What was decided in the row before the first.
    """
    begins = (heights < rules.low) & (speeds < rules.slow)
    ends = ~((heights < rules.high) & (speeds < rules.fast))
    said = np.where(begins, 1, np.where(ends, 0, -1)).astype(np.int8)
    return _carried(said, before)


def _carried(said: Int8[np.ndarray, "n p"], before: Bool[np.ndarray, " p"]) -> Bool[np.ndarray, "n p"]:
    """What was said last: 1, 0, or, where nothing was (-1), what was said in an earlier row, or before."""
    rows = np.arange(len(said))[:, None]
    last = np.maximum.accumulate(np.where(said >= 0, rows, -1), axis=0)
    found = np.take_along_axis(said, np.maximum(last, 0), axis=0) == 1
    return np.where(last < 0, before, found)


def lasting(touching: Bool[np.ndarray, "n p"], rows: int) -> Bool[np.ndarray, "n p"]:
    """Without gaps, then without contacts, of fewer rows than these; those at the first and last row are left, for nobody
    knows how long they are.
    """
    touching = touching.copy()
    for short in (False, True):
        for column in touching.T:
            edges = np.flatnonzero(np.diff(column)) + 1
            for start, end in pairwise(edges):
                if column[start] == short and end - start < rows:
                    column[start:end] = not short
    return touching
