"""Inputs that are not the state, or are far away: a status or a clear error, never a verdict that rounding made."""

import jax
import numpy as np
import pytest
from states import POINTS, ROWS, pieces, stack

import jaxcap
from jaxcap import Case, Status
from jaxcap.contacts.scoring_input import check_cone

SOLES = [(0, 0.1, 0), (0, -0.1, 0)]
UTM = np.array([512_345.678, 5_403_210.987, 312.5])
"""Coordinates of a map grid [m]: single precision rounds them to half a metre."""


def feet(shift=(0.0, 0.0, 0.0)) -> jaxcap.ContactSet:
    soles = (jaxcap.rectangle(np.add(place, shift), np.eye(3), 0.105, 0.065, 0.5) for place in SOLES)
    return next(soles) + next(soles)


FORMS = {
    "faces": lambda contacts: jaxcap.centroidal_cone(contacts).padded(ROWS),
    "rays": lambda contacts: jaxcap.cone_rays(contacts.padded(POINTS)),
}
"""Of the sizes that other files have: compiled already."""


@pytest.fixture(scope="module")
def states():
    rng = np.random.default_rng(14)
    return rng.uniform([-0.15, -0.2, 0.7], [0.15, 0.2, 1.0], (256, 3)), rng.uniform(-0.6, 0.6, (256, 3))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("x64", [False, True])
def test_far_from_the_origin_as_near_it(form, x64, states):
    coms, velocities = states
    with jax.enable_x64(x64):
        here = jaxcap.score(FORMS[form](feet()), coms, velocities)
        there = jaxcap.score(FORMS[form](feet(UTM)), coms + UTM, velocities)
    assert here.margin.dtype == there.margin.dtype == (np.float64 if x64 else np.float32)
    assert (here.capturable == there.capturable).all()
    np.testing.assert_allclose(there.margin, here.margin, rtol=0, atol=1e-6 if x64 else 1e-4)


@pytest.mark.parametrize("form", FORMS)
def test_one_state_far_from_the_origin(form, states):
    coms, velocities = states
    with jax.enable_x64(False):
        here = jaxcap.capturability(FORMS[form](feet()), coms[0], velocities[0])
        there = jaxcap.capturability(FORMS[form](feet(UTM)), coms[0] + UTM, velocities[0])
    assert float(there.margin) == pytest.approx(float(here.margin), abs=1e-4)


def test_each_state_its_own_contacts_far_from_the_origin(states):
    coms, velocities = (x[:64] for x in states)
    shifts = np.random.default_rng(15).uniform(-1, 1, (64, 1, 3)) * [1000, 1000, 1] + UTM
    both = feet()
    with jax.enable_x64(False):
        here = pieces(FORMS["rays"](both), coms, velocities)
        sets = stack([feet(shift[0]).padded(POINTS) for shift in shifts])
        there = pieces(jaxcap.cone_rays(sets), coms + shifts[:, 0], velocities)
    assert (here.capturable == there.capturable).all()
    np.testing.assert_allclose(there.margin, here.margin, rtol=0, atol=1e-4)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("axis", [0, 2])
def test_gravity_that_is_not_finite(form, bad, axis, states):
    gravity = np.array([0, 0, -9.81])
    gravity[axis] = bad
    out = jaxcap.score(FORMS[form](feet()), *states, gravity=gravity)
    assert (out.status == Status.NONFINITE).all() and (out.case == Case.UNDECIDED).all()
    assert not out.capturable.any() and np.isnan(out.margin).all()


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("scorer", [jaxcap.score, jaxcap.capturability])
def test_gravity_as_a_number(form, scorer, states):
    given = states if scorer is jaxcap.score else (states[0][0], states[1][0])
    with pytest.raises(TypeError, match=r"gravity has shape \(\) \(expected \(3,\)"):
        scorer(FORMS[form](feet()), *given, gravity=9.81)


def test_faces_that_are_not_finite(states):
    cone = FORMS["faces"](feet())
    faces = np.array(cone.faces)
    faces[3, 2] = np.nan
    out = jaxcap.score(cone._replace(faces=faces), *states)
    assert (out.status == Status.NONFINITE).all() and not out.capturable.any()


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("scale", [1e30, 1e15])
def test_magnitudes_beyond_the_precision(form, dtype, scale, states):
    coms, velocities = (x.astype(dtype) for x in states)
    cone = FORMS[form](feet())
    far, fast = jaxcap.score(cone, dtype(scale) * coms, velocities), jaxcap.score(cone, coms, dtype(scale) * velocities)
    for out in (far, fast):
        assert (out.status == Status.NONFINITE).all() and not out.capturable.any()


def test_contacts_in_place_of_a_cone():
    expected = r"\(expected centroidal_cone\(contacts\) or cone_rays\(contacts\)\)"
    with pytest.raises(TypeError, match=rf"cone: a ContactSet {expected}"):
        check_cone(feet())
    with pytest.raises(TypeError, match=rf"cone: ndarray {expected}"):
        check_cone(np.eye(6))


def test_an_answer_in_a_line(states):
    out = jaxcap.score(FORMS["faces"](feet()), *states)
    assert repr(out).startswith(f"Capturability(256 states: {int(out.capturable.sum())} capturable, margin ")
    one = jax.tree.map(lambda field: field[0], out)
    assert f"case={Case(int(one.case)).name}" in repr(one) and len(repr(out)) < 200
    bad = jaxcap.score(FORMS["faces"](feet()), states[0] * np.nan, states[1])
    assert "256 without an answer" in repr(bad)
    assert "Capturability(" in str(jax.eval_shape(lambda: one))


def test_answers_as_a_frame(states):
    pytest.importorskip("pandas")
    out = jaxcap.score(FORMS["faces"](feet()), *states)
    frame = out.to_pandas(index=range(100, 356))
    assert list(frame.columns) == list(out._fields) and list(frame.index[:2]) == [100, 101]
    assert (frame.case == [Case(code).name for code in out.case.tolist()]).all()
    assert set(frame.status.cat.categories) == {status.name.lower() for status in Status}
    np.testing.assert_array_equal(frame.margin, out.margin)
