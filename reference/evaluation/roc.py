"""ROC curves and what they are worth. A fall is what is to be detected, and a margin below the threshold predicts one.

Only the order of margins matters, so that they may be infinite; only operating points look at their values. Detection is the
share of falls that are predicted, false alarms the share of stops that are predicted to fall. Shares of nothing are NaN.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.stats import norm, rankdata
from sklearn.metrics import roc_curve

CONFIDENCE = 0.95
"""Of all intervals and bands."""

DEVIATIONS = float(norm.ppf((1 + CONFIDENCE) / 2))
"""Standard deviations of an interval's half."""

REPLICATES = 1000
"""Of a bootstrap."""

SEED = 2018
"""Of a bootstrap."""

Undecided = Literal["excluded", "fallen", "stopped"]
"""What an outcome counts as that is neither a stop nor a fall."""


class Judged(NamedTuple):
    """Samples whose outcome counts."""

    used: Bool[np.ndarray, " n"]
    """Which of all samples they are, m of them."""
    fell: Bool[np.ndarray, " m"]


class Interval(NamedTuple):
    """A figure and its confidence interval."""

    value: float
    low: float
    high: float


class Roc(NamedTuple):
    """A curve from (0, 0) to (1, 1)."""

    false_alarms: Float[np.ndarray, " p"]
    detection: Float[np.ndarray, " p"]


class Point(NamedTuple):
    """The four cells of a threshold."""

    detected: int
    missed: int
    false: int
    right: int

    @property
    def detection(self) -> Interval:
        """Share of the falls that are predicted."""
        return share(self.detected, self.detected + self.missed)

    @property
    def false_alarms(self) -> Interval:
        """Share of the stops that are predicted to fall."""
        return share(self.false, self.false + self.right)


class Areas(NamedTuple):
    """Areas under the curves of k margins on the same samples."""

    values: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]


class Difference(NamedTuple):
    """Of two areas on the same samples."""

    interval: Interval
    p: float
    """Of a difference at least as large, were there none."""


def judged(
    outcomes: Shaped[np.ndarray, " n"], undecided: Undecided = "excluded", among: Bool[np.ndarray, " n"] | None = None
) -> Judged:
    """Which samples count, and which of them fell.

    outcomes: `fallen`, `stopped`; anything else is undecided. among: samples that may count, by default all.
    """
    among = np.ones(len(outcomes), dtype=bool) if among is None else among
    fell = outcomes == "fallen"
    decided = fell | (outcomes == "stopped")
    used = among & decided if undecided == "excluded" else among
    return Judged(used, (fell | ~decided if undecided == "fallen" else fell)[used])


def curve(margin: Float[np.ndarray, " n"], fell: Bool[np.ndarray, " n"]) -> Roc:
    """The ROC curve; without falls or without stops one of the two shares is NaN. margin: not NaN."""
    if fell.all() or not fell.any():
        nothing, ends = np.full(2, np.nan), np.array([0.0, 1.0])
        return Roc(*(ends if some else nothing for some in (not fell.all(), fell.any())))
    false_alarms, detection, _ = roc_curve(fell, -_ranks(margin))
    return Roc(false_alarms, detection)


def detection_at(roc: Roc, false_alarms: Float[np.ndarray, " g"]) -> Float[np.ndarray, " g"]:
    """Detection at given rates of false alarms: on straight lines between the curve's points, the upper end of a step."""
    return np.interp(false_alarms, roc.false_alarms, roc.detection)


def band(
    margin: Float[np.ndarray, " n"],
    fell: Bool[np.ndarray, " n"],
    false_alarms: Float[np.ndarray, " g"],
    replicates: int = REPLICATES,
    seed: int = SEED,
) -> Float[np.ndarray, "2 g"]:
    """Lower and upper end of detection at given rates of false alarms, each with CONFIDENCE: stratified bootstrap.

    Each replicate draws as many falls from the falls, and stops from the stops, as there are. NaN without either.
    """
    if fell.all() or not fell.any():
        return np.full((2, len(false_alarms)), np.nan)
    random = np.random.default_rng(seed)
    ranks = _ranks(margin)
    levels = int(ranks.max()) + 1
    drawn = lambda own: np.cumsum(np.bincount(random.choice(own, len(own)), minlength=levels)) / len(own)
    curves = np.empty((replicates, len(false_alarms)))
    for replicate in curves:
        detection, alarms = drawn(ranks[fell]), drawn(ranks[~fell])  # at level 0 both are 0: no rank is
        replicate[:] = detection_at(Roc(alarms, detection), false_alarms)
    return np.quantile(curves, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], axis=0)


def point(margin: Float[np.ndarray, " n"], fell: Bool[np.ndarray, " n"], threshold: float = 0.0) -> Point:
    """The four cells at a threshold; at zero, the paper's stars."""
    predicted = margin < threshold
    cells = (fell & predicted, fell & ~predicted, ~fell & predicted, ~fell & ~predicted)
    return Point(*(int(cell.sum()) for cell in cells))


def share(hits: int, of: int) -> Interval:
    """A share with Wilson's interval; of nothing NaN in (0, 1). Source: Wilson, JASA 22(158), 1927."""
    if of == 0:
        return Interval(np.nan, 0.0, 1.0)
    z = DEVIATIONS
    value = hits / of
    middle = value + z * z / (2 * of)
    half = z * np.sqrt(value * (1 - value) / of + z * z / (4 * of * of))
    low, high = (middle - half) / (1 + z * z / of), (middle + half) / (1 + z * z / of)
    return Interval(value, float(np.clip(low, 0, value)), float(np.clip(high, value, 1)))  # rounding errs at both ends


def areas(margins: Float[np.ndarray, "k n"], fell: Bool[np.ndarray, " n"]) -> Areas:
    """Areas under the ROC curves and the covariance of their errors; NaN without falls or stops.

    An area is the probability that a stop's margin exceeds a fall's, ties counted half. Source: DeLong, DeLong,
    Clarke-Pearson, Biometrics 44(3), 1988, by midranks as in Sun, Xu, IEEE Signal Processing Letters 21(11), 2014.
    """
    k, falls, stops = len(margins), int(fell.sum()), int((~fell).sum())
    if not falls or not stops:
        return Areas(np.full(k, np.nan), np.full((k, k), np.nan))
    ranks = rankdata(margins, axis=1)
    above = 1 - (ranks[:, fell] - rankdata(margins[:, fell], axis=1)) / stops  # share of stops above each fall
    below = (ranks[:, ~fell] - rankdata(margins[:, ~fell], axis=1)) / falls  # share of falls below each stop
    return Areas(below.mean(axis=1), _scatter(above) / falls + _scatter(below) / stops)


def area(margin: Float[np.ndarray, " n"], fell: Bool[np.ndarray, " n"]) -> Interval:
    """The area under one curve, with DeLong's interval: of no width where no pair is out of order, NaN of a single fall."""
    values, covariance = areas(margin[None], fell)
    return _interval(values[0], covariance[0, 0], 0.0, 1.0)


def difference(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"], fell: Bool[np.ndarray, " n"]) -> Difference:
    """The area of `one` less that of `other` on the same samples, by DeLong's covariance of the two."""
    values, covariance = areas(np.stack([one, other]), fell)
    value = values[0] - values[1]
    variance = np.maximum(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1], 0.0)  # rounding goes below 0
    deviation = np.sqrt(variance)
    p = float(value == 0) if deviation == 0 else float(2 * norm.sf(abs(value) / deviation))
    return Difference(_interval(value, variance, -1.0, 1.0), p)


def _interval(value: float, variance: float, least: float, most: float) -> Interval:
    half = DEVIATIONS * np.sqrt(variance)
    return Interval(float(value), float(np.maximum(value - half, least)), float(np.minimum(value + half, most)))


def _ranks(margin: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """From 1; equal margins have the same."""
    return rankdata(margin, method="dense").astype(np.int64)


def _scatter(shares: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k k"]:
    """Covariance of the rows; NaN of a single column, which says nothing of how they vary."""
    k, n = shares.shape
    return np.cov(shares).reshape(k, k) if n > 1 else np.full((k, k), np.nan)
