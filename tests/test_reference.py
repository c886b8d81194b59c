"""The library against the reference, which shares no code with it: the paper's algorithm, and two oracles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from states import ROWS, each, random_states

import jaxcap
from jaxcap import Case
from jaxcap.numerics.guarded import direction
from jaxcap.one_state.face_polygon import polygon
from reference import algorithm, oracles
from reference.contacts import wrench_rays
from reference.linear_programs import line_program, solve_acceleration

pytestmark = pytest.mark.usefixtures("x64")
SETS, STATES, SEED = 1200, 3, 21
BAND = 1e-6
"""Margin within which a verdict may differ in double precision [m/s]."""
SWINGS = 100


@pytest.fixture(scope="module")
def compared():
    """Answers of the library and of Algorithms 1-3 for 3,600 random states, C3.3 by the reference's own swings."""
    contacts, cones, coms, velocities = random_states(SETS, STATES, SEED)
    with jax.enable_x64(True):
        answer = jax.tree.map(np.asarray, each()(cones, coms, velocities))
    states = zip(contacts, coms, velocities, strict=True)
    paper = [algorithm.is_state_capturable(*arrays, com, velocity, swings=SWINGS) for arrays, com, velocity in states]
    return answer, paper


def test_verdict_of_the_paper(compared):
    answer, paper = compared
    assert all(result.capturable is not None for result in paper)
    differ = answer.capturable != [result.capturable for result in paper]
    assert np.abs(answer.margin[differ]).max(initial=0) < BAND
    assert (answer.status == jaxcap.Status.OK).all()


def test_single_precision_gives_the_verdict_of_the_paper(compared):
    _, cones, coms, velocities = random_states(SETS, STATES, SEED)
    single = each()(cones, coms.astype(np.float32), velocities.astype(np.float32))
    differ = np.asarray(single.capturable) != [result.capturable for result in compared[1]]
    assert np.abs(compared[0].margin[differ]).max(initial=0) < 1e-3


def test_case_of_the_paper(compared):
    """The same leaf of the decision tree; only where no place to stand exists does the paper say C1 or C2 first."""
    answer, paper = compared
    expected = np.array([Case[result.case] for result in paper])
    known = answer.case != Case.EMPTY
    near = np.abs(answer.margin) < BAND
    assert (answer.case == expected)[known & ~near].all()
    assert np.isin(expected[~known], [Case.EMPTY, Case.C1, Case.C2]).all()
    assert set(expected) == set(Case) - {Case.UNDECIDED}


def test_distance_time_and_margin_of_the_paper(compared):
    answer, paper = compared
    away = np.abs(answer.margin) > 1e-4  # a stop at the very limit is reached only in the limit of time
    inside = (answer.case == Case.C3_1) & away
    field = lambda name: np.array([getattr(result, name) for result in paper])
    np.testing.assert_allclose(answer.distance[inside], field("alpha_final")[inside], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(answer.time[inside], field("time")[inside], rtol=1e-6, atol=1e-9)
    same = (answer.case == [Case[result.case] for result in paper]) & (answer.case != Case.C3_3) & away
    np.testing.assert_allclose(answer.paper_margin[same], field("margin")[same], rtol=1e-6, atol=1e-6)
    left = same & np.isin(answer.case, [Case.C1, Case.C2])
    np.testing.assert_allclose(answer.residual_speed[left], field("alphadot_final")[left], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("limit", "inner"), [("max_speed", -1), ("min_speed", 1)])
def test_the_paper_flips_at_the_limits(compared, limit, inner):
    """`max_speed` and `min_speed` to 1e-6: a little inside the paper says yes, a little outside no."""
    answer, _ = compared
    contacts, _, coms, velocities = random_states(SETS, STATES, SEED)
    limits = getattr(answer, limit)
    known = np.flatnonzero(np.isfinite(limits) & (limits > 0))[:200]
    assert len(known) > 100
    for i in known:
        along = velocities[i] / np.linalg.norm(velocities[i])
        for side in (inner, -inner):
            speed = limits[i] + side * 1e-6 * max(1.0, limits[i])
            verdict = algorithm.is_state_capturable(*contacts[i], coms[i], along * speed, swings=SWINGS).capturable
            assert verdict == (side == inner), (i, answer.case[i])


def test_verdict_of_event_integration(compared):
    """`solve_ivp` on the linear program's accelerations, good to about 1e-5 m/s."""
    answer, _ = compared
    contacts, _, coms, velocities = random_states(SETS, STATES, SEED)
    chosen = one_of_each(answer, 8)
    for i in chosen:
        event = oracles.event_integration(*contacts[i], coms[i], velocities[i])
        if event.capturable is not None and abs(answer.margin[i]) > 2e-5:
            assert event.capturable == answer.capturable[i], i
            if answer.case[i] in (Case.C1, Case.C2):
                assert event.alphadot_final == pytest.approx(answer.residual_speed[i], abs=2e-5)


def test_speeds_of_the_discretised_problem(compared):
    """(12) as one linear program, velocity free to change sign: its interval lies in ours, and fills it as it is refined."""
    answer, _ = compared
    contacts, _, coms, velocities = random_states(SETS, STATES, SEED)
    for i in one_of_each(answer, 5):
        along = velocities[i] / np.linalg.norm(velocities[i])
        found = oracles.speed_interval(*contacts[i], coms[i], along)
        if found is None:  # no motion to rest at all, at least none that ends within the horizon
            assert not answer.capturable[i] or answer.margin[i] < 1e-2
            continue
        assert found.low >= answer.min_speed[i] - 1e-6
        assert found.high <= answer.max_speed[i] + 1e-6
        if np.isfinite(found.high_error):
            assert answer.max_speed[i] - found.high <= found.high_error + 1e-6
        assert found.low - answer.min_speed[i] <= found.low_error + 1e-6


def test_the_discretised_interval_closes_in(compared):
    """Its gap to `max_speed` shrinks when the step does."""
    answer, _ = compared
    contacts, _, coms, velocities = random_states(SETS, STATES, SEED)
    gaps = []
    for i in np.flatnonzero((answer.case == Case.C3_1) & (answer.max_speed < 3))[:6]:
        along = velocities[i] / np.linalg.norm(velocities[i])
        found = [oracles.speed_interval(*contacts[i], coms[i], along, steps=steps).high for steps in (15, 30, 60)]
        gaps.append(answer.max_speed[i] - found)
    coarse, middle, fine = np.mean(gaps, axis=0)
    assert 0 < fine < middle / 2 < coarse / 4


def one_of_each(answer, count):
    """Indices of the first few states of every case."""
    return np.concatenate([np.flatnonzero(answer.case == case)[:count] for case in set(Case) - {Case.UNDECIDED}])


def test_static_region_and_boundary_are_those_of_the_linear_program(compared):
    """s_min, s_max, and the smallest acceleration at places along the line, by HiGHS."""
    answer, _ = compared
    contacts, cones, coms, velocities = random_states(SETS, STATES, SEED)
    for i in np.flatnonzero(np.isin(answer.case, [Case.C1, Case.C3_1, Case.C3_2_1, Case.C3_2_2, Case.C3_3]))[:60:3]:
        along = direction(jnp.asarray(velocities[i]))[0]
        cone = jax.tree.map(lambda leaf, i=i: np.asarray(leaf[i]), cones)
        rows = polygon(cone, jnp.asarray(coms[i]), along, jnp.array([0, 0, -9.81]))
        survey, lower = rows.survey(), rows.boundary(jnp.asarray(np.inf))
        expected = oracles.static_interval(*contacts[i], coms[i], np.asarray(along))
        np.testing.assert_allclose([survey.s_min, survey.s_max], expected, rtol=1e-6, atol=1e-6)
        program = line_program(coms[i], np.asarray(along), wrench_rays(*contacts[i]))
        far = min(float(lower.end), 2.0)
        for alpha in np.linspace(0, 0.999 * far, 7):
            lowest = solve_acceleration(program, alpha, 1).fun
            np.testing.assert_allclose(lower.at(jnp.asarray(alpha)), lowest, rtol=1e-6, atol=1e-6)


def test_rows_are_enough():
    """No random cone is cut off by the padding that lets them be stacked."""
    cones = random_states(SETS, STATES, SEED)[1]
    assert cones.faces.shape[1] == ROWS
