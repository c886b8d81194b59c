"""The statistics of `reference.evaluation.roc`: laws, then oracles, then examples."""

import numpy as np
import pytest
from sklearn.metrics import roc_auc_score

from reference.evaluation.roc import (
    REPLICATES,
    area,
    areas,
    band,
    curve,
    detection_at,
    difference,
    judged,
    point,
    share,
)

OUTCOMES = np.array(["fallen", "fallen", "stopped", "undecided", "stopped", "fallen", "stopped", ""])
MARGIN = np.array([-0.5, 0.2, 0.3, 9.0, -0.1, -np.inf, np.inf, 0.0])


def drawn(seed, falls=60, stops=90, ties=True):
    """Two margins that know something, some infinite, rounded so that there are ties, and who fell."""
    random = np.random.default_rng(seed)
    fell = random.permutation(np.arange(falls + stops) < falls)
    common = random.normal(size=len(fell)) - fell
    margins = common + random.normal(size=(2, len(fell)))
    margins = np.round(margins, 1) if ties else margins
    margins[:, ::17] = np.inf
    margins[:, 5::31] = -np.inf
    return margins, fell


@pytest.mark.parametrize("seed", range(5))
def test_area_is_the_rank_statistic(seed):
    (margin, _), fell = drawn(seed)
    stops, falls = margin[~fell][:, None], margin[fell][None]
    pairs = (stops > falls) + 0.5 * (stops == falls)
    roc = curve(margin, fell)
    assert area(margin, fell).value == pytest.approx(pairs.mean(), rel=1e-12)
    assert np.trapezoid(roc.detection, roc.false_alarms) == pytest.approx(pairs.mean(), rel=1e-12)
    finite = np.clip(-margin, -1e9, 1e9)
    assert roc_auc_score(fell, finite) == pytest.approx(pairs.mean(), rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_only_the_order_counts(seed):
    (margin, _), fell = drawn(seed)
    warped = np.tanh(margin) ** 3
    assert area(warped, fell) == area(margin, fell)
    np.testing.assert_array_equal(curve(warped, fell), curve(margin, fell))
    assert area(-margin, fell).value == pytest.approx(1 - area(margin, fell).value)


@pytest.mark.parametrize("threshold", [-0.5, 0.0, 0.3])
def test_operating_points_are_on_the_curve(threshold):
    (margin, _), fell = drawn(7)
    at, roc = point(margin, fell, threshold), np.transpose(curve(margin, fell))
    place, steps = np.array([at.false_alarms.value, at.detection.value]), np.diff(roc, axis=0)
    along = np.clip(((place - roc[:-1]) * steps).sum(axis=1) / (steps**2).sum(axis=1), 0, 1)
    assert np.linalg.norm(roc[:-1] + along[:, None] * steps - place, axis=1).min() < 1e-12
    assert sum(at) == len(fell)


def test_area_and_its_variance_agree_with_a_bootstrap():
    margins, fell = drawn(1, ties=False)
    random = np.random.default_rng(0)
    replicates = []
    for _ in range(REPLICATES):
        rows = np.concatenate([random.choice(np.flatnonzero(own), own.sum()) for own in (fell, ~fell)])
        replicates.append(areas(margins[:, rows], fell[rows]).values)
    # the standard deviation of a standard deviation from R replicates is 1 / sqrt(2 R), 2 %; three of them, and the bias 1/n
    spread, expected = np.cov(np.transpose(replicates)), areas(margins, fell).covariance
    np.testing.assert_allclose(np.sqrt(np.diag(spread)), np.sqrt(np.diag(expected)), rtol=0.1)
    assert spread[0, 1] == pytest.approx(expected[0, 1], rel=0.2)


def test_delong_variance_by_its_definition():
    margins, fell = drawn(2)
    pairs = [(m[~fell][:, None] > m[fell]) + 0.5 * (m[~fell][:, None] == m[fell]) for m in margins]
    expected = np.cov([p.mean(axis=0) for p in pairs]) / fell.sum() + np.cov([p.mean(axis=1) for p in pairs]) / (~fell).sum()
    np.testing.assert_allclose(areas(margins, fell).covariance, expected, rtol=1e-10)


def test_interval_of_the_area_covers_the_truth():
    random = np.random.default_rng(3)
    truth = 0.7602499389  # of normal variables one standard deviation apart: Phi(1 / sqrt 2)
    fell = np.arange(120) < 50
    found = [area(random.normal(size=120) - fell, fell) for _ in range(400)]
    covered = np.mean([low <= truth <= high for _, low, high in found])
    assert 0.92 < covered < 0.98  # 0.95, with a standard deviation of 0.011


def test_a_comparison_of_equals_is_fair():
    random = np.random.default_rng(4)
    fell = np.arange(120) < 50
    p = [difference(*(random.normal(size=(2, 120)) - fell), fell).p for _ in range(400)]
    assert 0.02 < np.mean(np.array(p) < 0.05) < 0.08


def test_a_paired_comparison_is_sharper_than_two_intervals():
    margins, fell = drawn(5, ties=False)
    less = difference(margins[0], margins[0] + 0.01 * margins[1].clip(-5, 5), fell).interval
    assert less.high - less.low < 0.1 * (area(margins[0], fell).high - area(margins[0], fell).low)
    one, other = difference(*margins, fell), difference(*margins[::-1], fell)
    assert one.p == pytest.approx(other.p) and one.interval.value == pytest.approx(-other.interval.value)


def test_a_margin_does_not_differ_from_itself():
    (margin, _), fell = drawn(6)
    less = difference(margin, margin, fell)
    assert less.interval == (0.0, 0.0, 0.0) and less.p == 1.0


def test_perfect_reversed_constant():
    fell = np.arange(10) < 4
    perfect = np.arange(10.0)
    assert area(perfect, fell) == (1.0, 1.0, 1.0)
    assert area(-perfect, fell) == (0.0, 0.0, 0.0)
    assert area(np.zeros(10), fell).value == 0.5
    np.testing.assert_array_equal(curve(np.zeros(10), fell), [[0, 1], [0, 1]])
    np.testing.assert_array_equal(detection_at(curve(perfect, fell), np.array([0.0, 0.5, 1.0])), 1.0)
    np.testing.assert_array_equal(detection_at(curve(-perfect, fell), np.array([0.0, 0.5])), 0.0)
    assert difference(perfect, -perfect, fell) == ((1.0, 1.0, 1.0), 0.0)
    np.testing.assert_array_equal(band(perfect, fell, np.array([0.0, 0.5, 1.0]), replicates=20), 1.0)


def test_infinite_margins_are_ordered():
    fell = np.array([True, True, False, False])
    margin = np.array([-np.inf, -1.0, 0.5, np.inf])
    assert area(margin, fell).value == 1.0
    assert point(margin, fell) == (2, 0, 0, 2)
    assert area(np.array([np.inf, -1.0, 0.5, np.inf]), fell).value == pytest.approx(2.5 / 4)


def test_the_star_of_a_margin_of_exactly_zero_is_a_predicted_stop():
    assert point(np.zeros(3), np.array([True, False, False])) == (0, 1, 0, 2)


@pytest.mark.parametrize("fell", [np.ones(4, bool), np.zeros(4, bool), np.zeros(0, bool)])
def test_without_falls_or_without_stops(fell):
    margin = np.arange(len(fell), dtype=float)
    assert np.isnan(area(margin, fell).value) and np.isnan(difference(margin, margin, fell).p)
    roc = curve(margin, fell)
    assert np.isnan(roc.detection).all() == (not fell.any()) and np.isnan(roc.false_alarms).all() == bool(fell.all())
    assert np.isnan(band(margin, fell, np.array([0.5]), replicates=3)).all()
    at = point(margin, fell)
    assert np.isnan(at.detection.value) == (not fell.any()) and np.isnan(at.false_alarms.value) == bool(fell.all())


def test_of_a_single_fall_the_area_has_no_interval():
    margin, fell = np.array([0.1, 0.5, 0.0, 0.7]), np.array([True, False, False, False])
    found = area(margin, fell)
    assert found.value == pytest.approx(2 / 3) and np.isnan([found.low, found.high]).all()
    assert np.isnan(difference(margin, -margin, fell).p)


def test_band_holds_the_curve_and_narrows():
    grid = np.linspace(0.05, 0.95, 10)
    widths = []
    for size in (40, 640):
        (margin, _), fell = drawn(8, size, size, ties=False)
        low, high = band(margin, fell, grid, replicates=300)
        middle = detection_at(curve(margin, fell), grid)
        assert (low <= middle).all() and (middle <= high).all()
        widths.append((high - low).mean())
    assert widths[1] < 0.4 * widths[0]  # a quarter, were the points of the grid steps of neither


def test_band_is_the_same_again():
    (margin, _), fell = drawn(9)
    grid = np.array([0.1, 0.5])
    np.testing.assert_array_equal(band(margin, fell, grid, 50), band(margin, fell, grid, 50))
    assert not np.array_equal(band(margin, fell, grid, 50), band(margin, fell, grid, 50, seed=1))


def test_the_four_cells_hold_every_decided_sample_once():
    used, fell = judged(OUTCOMES)
    assert used.tolist() == [True, True, True, False, True, True, True, False]
    assert point(MARGIN[used], fell) == (2, 1, 1, 2)


def test_undecided_outcomes_count_either_way():
    stars = {
        kind: point(MARGIN[used], fell)
        for kind in ("excluded", "fallen", "stopped")
        for used, fell in [judged(OUTCOMES, kind)]
    }
    assert stars == {"excluded": (2, 1, 1, 2), "fallen": (2, 3, 1, 2), "stopped": (2, 1, 1, 4)}


def test_judged_among_some():
    known = np.arange(8) > 0
    for kind, expected in (("excluded", 5), ("fallen", 7)):
        used, fell = judged(OUTCOMES, kind, known)
        assert used.sum() == len(fell) == expected and not used[0]


def test_share_is_wilsons():
    assert np.isnan(share(0, 0).value) and share(0, 0)[1:] == (0.0, 1.0)
    assert share(0, 10) == pytest.approx((0, 0, 0.2775), abs=1e-4)  # tabulated
    for hits in range(11):
        value, low, high = share(hits, 10)
        assert low <= value <= high and value == hits / 10
        assert (low, high) == pytest.approx((1 - share(10 - hits, 10).high, 1 - share(10 - hits, 10).low))
