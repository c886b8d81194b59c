"""The fuzz commands of `bench/`: what they draw is valid, and a wrong answer is found. Nothing is compiled here."""

import numpy as np
import pytest

import jaxcap
from bench import fuzz, fuzz_judge, gradients
from bench.fuzz_kinds import CONTACTS, KINDS, SPEEDS, Sample, draw

SOLE = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) * [0.1, 0.05, 0]
FIST = np.array([[0, 0, 0.98], [0, 0, 1.02]])


def sample_of(points, frames, com, velocity, friction=0.5):
    k = len(points)
    states = (np.array([array], float) for array in (com, velocity))
    return Sample("sole", 0, 4, points, np.broadcast_to(frames, (k, 3, 3)), np.full(k, friction), *states)


@pytest.mark.parametrize("kind", KINDS)
def test_contact_sets_are_valid_and_the_same_again(kind):
    for index in range(12):
        sample = draw(5, index, kind, 30)
        assert 1 <= len(sample.points) <= CONTACTS
        jaxcap.ContactSet(sample.points, sample.frames, sample.friction)
        speeds = np.linalg.norm(sample.velocities, axis=1)
        assert np.isfinite(sample.coms).all() and (speeds > 0.99 * SPEEDS[0]).all() and (speeds < 1.01 * SPEEDS[1]).all()
        for one, other in zip(sample[3:], draw(5, index, kind, 30)[3:], strict=True):
            np.testing.assert_array_equal(one, other)


def test_rounded_to_single_precision_the_numbers_are_singles():
    for one in draw(1, 0, "mixed", 10).rounded("float32")[3:]:
        np.testing.assert_array_equal(one, one.astype(np.float32).astype(np.float64))


@pytest.mark.parametrize(
    ("points", "frames", "com", "velocity", "expected"),
    [
        (SOLE, np.eye(3), [0, 0, 0.8], [0.1, 0, 0], True),
        (SOLE, np.eye(3), [0, 0, 0.8], [0.5, 0, 0], False),
        (SOLE, np.eye(3), [0.2, 0, 0.8], [-0.5, 0, 0], True),  # runs into the region
        (SOLE, np.eye(3), [0.2, 0, 0.8], [-0.1, 0, 0], False),  # falls back
        (SOLE, np.eye(3), [0, 0, 0.8], [0, 0, -1], True),
        (FIST, np.stack([np.eye(3), np.diag([1, -1, -1])]), [0.2, 0, 0.8], [0, 0.5, 0], False),  # no moment about its axis
        (FIST, np.stack([np.eye(3), np.diag([1, -1, -1])]), [0, 0, 0.8], [0, 0, 0.5], True),
    ],
)
def test_the_judge_knows_states_with_a_plain_answer(points, frames, com, velocity, expected):
    state = fuzz_judge.state_of(sample_of(points, frames, com, velocity), 0, "float64")
    assert fuzz_judge.capturable(state) is expected
    assert fuzz_judge.true_of_some(state, expected) is True
    assert fuzz_judge.true_of_some(state, not expected) is False


def test_on_an_edge_both_claims_are_right_and_beside_it_one():
    for off, both in ((0.0, True), (3e-6, True), (1e-4, False)):
        state = fuzz_judge.state_of(sample_of(SOLE, np.eye(3), [0.1 - off, 0, 0.8], [0.1, 0, 0]), 0, "float32")
        state = state._replace(band=1.0) if both else state._replace(band=0.0, speed=1e-6)
        assert fuzz_judge.true_of_some(state, True)
        assert bool(fuzz_judge.true_of_some(state, False)) is both


def answers(n, **fields):
    values = dict.fromkeys(fuzz.FIELDS, 0.0) | {"capturable": True, "margin": 0.1, "max_speed": 0.2, "min_speed": 0.0}
    return fuzz.Claims({name: np.full(n, value) for name, value in (values | fields).items()})


def test_differences_outside_the_band_are_found():
    right = answers(3)
    other = answers(3)
    other.capturable[:] = [True, False, False]
    other.margin[:] = [0.1, -1e-9, -0.1]
    right.margin[1] = 1e-9
    assert fuzz.difference(right, other, np.full(3, 0.1), np.full(3, 0.2), 1e-6).verdicts.tolist() == [2]
    other = answers(3)
    other.max_speed[:] = [0.2, 0.2 * (1 + 1e-7), 0.3]
    ((row, speed),) = fuzz.difference(right, other, np.full(3, 0.1), np.full(3, 0.2), 1e-6).limits
    assert row == 2 and speed == pytest.approx(0.25)


def test_a_wrong_claim_is_counted_kept_and_fails():
    sample = sample_of(SOLE, np.eye(3), [0, 0, 0.8], [0.1, 0, 0])
    report = fuzz.Report("float64", judged=5, kept=5)
    report.compare(sample, answers(1, capturable=False, margin=-0.1), answers(1))
    total = report.totals()
    assert (total["differ"], total["wrong faces"], total["wrong rays"], total["unjudged"]) == (1, 1, 0, 0)
    assert report.failed() and report.failures[0]["what"] == "differ, wrong faces"
    assert "wrong faces" in report.table()


def test_undecided_states_fail():
    sample = sample_of(SOLE, np.eye(3), [0, 0, 0.8], [0.1, 0, 0])
    report = fuzz.Report("float32", judged=5, kept=5)
    report.compare(sample, answers(1), answers(1, status=jaxcap.Status.MAX_STEPS))
    assert report.totals()["undecided rays"] == 1 and report.failed()


def test_derivatives_are_told_apart():
    ahead = np.array([[1.0, 1, 1, 1, 1, 5, 0], [1, 1, 1, 1, 1, 9, 0], [1, 1, 1, 1, 1, 9, 3]])
    behind = np.array([[1.0, 1, 2, 2, 2, 1, 0], [1, 1, 2, 2, 2, 1, 0], [1, 1, 2, 2, 2, 1, 0]])
    derivative = np.array([1.0, 1.5, 2.0, 1.5, 7.0, 7.0, 3.0])
    column = gradients.verdicts(derivative, gradients.Differences(ahead, behind), np.zeros(7), np.ones(7))
    assert column.tolist() == ["right", "wrong", "kinks right", "kinks between", "kinks wrong", "unclear", "narrow"]
    same = gradients.Differences(ahead[:, :2], ahead[:, :2])
    none = gradients.verdicts(np.array([np.nan, 1]), same, np.array([1, np.inf]), 1)
    assert none.tolist() == ["nan", "no margin"]


def test_frames_are_turned_as_far_as_their_derivative_says():
    vector = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose((gradients.turned(1e-7 * vector) - np.eye(3)) / 1e-7, gradients.skew(np, vector), atol=1e-6)
    whole = gradients.turned(vector) @ gradients.turned(-vector)
    np.testing.assert_allclose(whole, np.broadcast_to(np.eye(3), (5, 3, 3)), atol=1e-12)
