"""Counts and quantiles of the closing table."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from state_files import fake_score, states

from jaxcap.commands.summary import Quantiles, Summary, rounding
from jaxcap.files.fields import CASES, STATUSES
from jaxcap.one_state.result import Case, Status

FLOATS = st.floats(width=32, allow_nan=False)


@given(st.lists(FLOATS, min_size=1, max_size=50), st.floats(0, 1))
def test_quantiles_are_those_of_the_sorted_numbers(values, share):
    quantiles = Quantiles()
    quantiles.add(np.array(values, dtype=np.float32))
    exact = sorted(values)[max(1, int(np.ceil(share * len(values)))) - 1]
    assert quantiles(share) == pytest.approx(exact, rel=2.5e-4, abs=1e-37)


@given(st.lists(FLOATS, max_size=20), st.lists(FLOATS, max_size=20))
def test_quantiles_do_not_depend_on_batches(first, second):
    one, two = Quantiles(), Quantiles()
    one.add(np.array(first + second))
    two.add(np.array(second))
    two.add(np.array(first))
    assert len(one) == len(two) == len(first) + len(second)
    assert one(0.5) == two(0.5) or not len(one)


@given(st.lists(st.lists(FLOATS, max_size=10), min_size=1, max_size=5), st.floats(0, 1))
def test_quantiles_of_many_files_are_those_of_the_sorted_numbers(files, share):
    kept = []
    for values in files:
        one = Quantiles()
        one.add(np.array(values, dtype=np.float32))
        kept.append(json.loads(json.dumps(one.histogram(7), allow_nan=False)))
    both, values = Quantiles.of(kept, 7), sorted(value for one in files for value in one)
    assert len(both) == len(values) and list(both.named()) == (["5%", "25%", "50%", "75%", "95%"] if values else [])
    if values:
        exact = values[max(1, int(np.ceil(share * len(values)))) - 1]
        assert both(share) == pytest.approx(exact, rel=8.1e-3, abs=1e-37)


def test_zero_and_infinity_are_exact_and_nan_is_left_out():
    quantiles = Quantiles()
    quantiles.add(np.array([-np.inf, -0.0, 0.0, np.inf, np.nan]))
    assert [quantiles(share) for share in (0.25, 0.5, 0.75, 1)] == [-np.inf, 0, 0, np.inf]
    assert len(quantiles) == 4


def test_no_numbers_have_no_quantile():
    assert np.isnan(Quantiles()(0.5))


def test_every_case_and_status_is_counted():
    assert set(CASES) == set(Case) and set(STATUSES) == set(Status)
    coms, velocities = states(100)
    velocities[0], velocities[1, 2] = 0, np.nan
    summary = Summary()
    out = fake_score(None, coms, velocities)
    summary.add(out)
    summary.add(out)
    assert summary.states == sum(summary.cases.values()) == sum(summary.statuses.values()) == 200
    assert summary.statuses[Status.NONFINITE] == summary.statuses[Status.NO_DIRECTION] == 2
    assert summary.capturable == 2 * out.capturable.sum()
    assert len(summary.margin) == 196


def test_a_table_of_nothing():
    assert "states" in Summary().table()


def test_positions_that_single_precision_rounds_are_told():
    at = lambda x: np.array([[x, 0, 0.8], [x, 1, 0.8], [np.nan, 0, 0], [0, 0, 0]], np.float32)
    assert rounding(at(0.1)) == rounding(at(900)) == rounding(at(np.inf)) == rounding(np.zeros((0, 3), np.float32)) == ""
    assert rounding(at(5e5)) == "positions 5e+05 m from the origin are rounded to 0.031 m (--dtype float64 keeps them)"
    assert rounding(at(5e5).astype(np.float64)) == ""
    assert rounding(np.concatenate([at(0.1), np.full((1, 3), 1e30, np.float32)])) == ""  # one row is no matter
