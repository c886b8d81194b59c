"""Laws of the predictor, on random states: invariance, monotonicity, and one answer however it is called."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import random_contacts, rotation
from states import FORMS, contact_set, each, pieces, random_states, stack

import jaxcap

pytestmark = pytest.mark.usefixtures("x64")
SPEEDS = ("margin", "min_speed", "max_speed", "residual_speed")
SETS, STATES = 60, 5
amounts = pytest.mark.parametrize("sets", [100, pytest.param(400, marks=pytest.mark.slow)])


@pytest.fixture(params=FORMS, autouse=True)
def _form(request):
    """Every law in both forms of the cone."""
    global form
    form = request.param


def restacked(contacts, change):
    """Cones, one for each state, of the contacts after a change of the sampler's arrays; equal neighbours built once."""
    built = {}
    for arrays in contacts:
        if id(arrays) not in built:
            built[id(arrays)] = FORMS[form](contact_set(*change(*arrays)))
    return stack([built[id(arrays)] for arrays in contacts])


def assert_same(one, other, scale=1.0, time=1.0, length=1.0):
    """Equal answers, where the second has its speeds, times and lengths scaled."""
    np.testing.assert_array_equal(one.capturable, other.capturable)
    np.testing.assert_array_equal(one.case, other.case)
    np.testing.assert_array_equal(one.status, other.status)
    for name in SPEEDS:
        np.testing.assert_allclose(getattr(one, name) * scale, getattr(other, name), rtol=1e-6, atol=1e-7, err_msg=name)
    # Not so sharp: next to a limit of the speed, a stop moves with the square root of a change
    np.testing.assert_allclose(one.distance * length, other.distance, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(one.time * time, other.time, rtol=1e-4, atol=1e-6)


def test_the_states_are_worth_testing():
    """Every leaf of the decision tree occurs among them."""
    _, *states = random_states(SETS, STATES, 11, form)
    assert set(np.unique(each()(*states).case)) == {c for c in jaxcap.Case if c is not jaxcap.Case.UNDECIDED}


def test_translation():
    contacts, cones, coms, velocities = random_states(SETS, STATES, 11, form)
    for shift in ([100.0, -100.0, 3.0], [1000.0, 0.0, 0.0]):
        moved = restacked(contacts, lambda points, frames, friction, shift=shift: (points + shift, frames, friction))
        assert_same(each()(cones, coms, velocities), each()(moved, coms + shift, velocities))


def test_yaw():
    contacts, cones, coms, velocities = random_states(SETS, STATES, 11, form)
    turn = rotation(0, 0, 2.1)
    turned = restacked(contacts, lambda points, frames, friction: (points @ turn.T, turn @ frames, friction))
    assert_same(each()(cones, coms, velocities), each()(turned, coms @ turn.T, velocities @ turn.T))


def test_order_of_contacts():
    contacts, cones, coms, velocities = random_states(SETS, STATES, 11, form)
    turned = restacked(contacts, lambda *arrays: tuple(array[::-1] for array in arrays))
    assert_same(each()(cones, coms, velocities), each()(turned, coms, velocities))


def test_scale_of_length_and_time():
    """Lengths times 4 under the same gravity: times and speeds double. Stronger gravity: times shorten."""
    contacts, cones, coms, velocities = random_states(SETS, STATES, 11, form)
    answer = each()(cones, coms, velocities)
    larger = restacked(contacts, lambda points, frames, friction: (4 * points, frames, friction))
    assert_same(answer, each()(larger, 4 * coms, 2 * velocities), scale=2.0, time=2.0, length=4.0)
    heavier = each()(cones, coms, 2 * velocities, gravity=(0.0, 0.0, -4 * 9.81))
    assert_same(answer, heavier, scale=2.0, time=0.5)


def test_mask_equals_absence():
    """A masked contact does nothing, wherever it stands among the others."""
    contacts, cones, coms, velocities = random_states(SETS, STATES, 11, form)
    other = contact_set(*random_contacts(np.random.default_rng(5), 1))
    hidden = jaxcap.ContactSet(other.points, other.frames, other.friction, mask=np.zeros(4, bool))
    built = {
        id(arrays): FORMS[form](
            jaxcap.ContactSet(*(x[:4] for x in arrays)) + hidden + jaxcap.ContactSet(*(x[4:] for x in arrays))
        )
        for arrays in contacts
    }
    assert_same(each()(cones, coms, velocities), each()(stack([built[id(arrays)] for arrays in contacts]), coms, velocities))


@pytest.mark.slow
def test_padding_of_faces_is_neutral():
    _, cones, coms, velocities = random_states(SETS, STATES, 11)
    more = jaxcap.CentroidalCone(np.pad(cones.faces, ((0, 0), (0, 7), (0, 0))), cones.origin, cones.length)
    assert_same(each()(cones, coms, velocities), each()(more, coms, velocities))


def test_another_contact_never_hurts():
    contacts, cones, coms, velocities = random_states(SETS, STATES, 11, form)
    added = random_contacts(np.random.default_rng(6), 1)
    more = restacked(contacts, lambda *arrays: tuple(np.concatenate(pair) for pair in zip(arrays, added, strict=True)))
    assert_never_worse(each()(cones, coms, velocities), each()(more, coms, velocities))


def test_more_friction_never_hurts():
    contacts, cones, coms, velocities = random_states(SETS, STATES, 11, form)
    more = restacked(contacts, lambda points, frames, friction: (points, frames, 1.3 * friction))
    assert_never_worse(each()(cones, coms, velocities), each()(more, coms, velocities))


def assert_never_worse(less, more):
    # A state is lost only if it was within rounding of its limit
    assert not (less.capturable & ~more.capturable & (less.margin > 1e-7)).any()
    assert (more.max_speed >= less.max_speed * (1 - 1e-7) - 1e-7).all()
    assert (more.capturable & ~less.capturable).any()


@pytest.mark.slow
def test_jit_vmap_loop_and_score_agree():
    _, cones, coms, velocities = random_states(SETS, STATES, 11, form)
    mapped = each()(cones, coms, velocities)
    single = jax.jit(jaxcap.capturability)
    pick = lambda tree, i: jax.tree.map(lambda leaf: np.asarray(leaf[i]), tree)
    assert_same(mapped, stack([single(pick(cones, i), coms[i], velocities[i]) for i in range(len(coms))]))
    for i in (0, 40, 80):
        cone = pick(cones, i)
        near = slice(i, i + STATES)
        outside = pieces(cone, coms[near], velocities[near])
        assert_same(pick(mapped, near), outside)
        assert_same(jax.jit(jaxcap.score)(cone, coms[near], velocities[near]), outside)
    if form == "rays":  # what follows is of JAX, whatever the form, and takes three times as long with rays
        return
    with jax.disable_jit():
        assert_same(pick(mapped, 0), jaxcap.capturability(pick(cones, 0), jnp.asarray(coms[0]), jnp.asarray(velocities[0])))


@amounts
def test_single_precision_agrees_outside_the_band(sets):
    _, cones, coms, velocities = random_states(sets, 3, 12, form)
    double = each()(cones, coms, velocities)
    single = each()(cones, coms.astype(np.float32), velocities.astype(np.float32))
    assert single.margin.dtype == np.float32
    outside = np.abs(double.margin) > 1e-3
    assert outside.mean() > 0.99
    np.testing.assert_array_equal(double.capturable[outside], single.capturable[outside])


@amounts
def test_margin_is_positive_if_and_only_if_capturable(sets):
    _, cones, coms, velocities = random_states(sets, 3, 12, form)
    answer = each()(cones, coms, velocities)
    np.testing.assert_array_equal(answer.capturable, answer.margin >= 0)
    assert (answer.residual_speed[answer.capturable] == 0).all()
    assert np.isfinite(answer.time[answer.capturable]).all() and np.isfinite(answer.distance[answer.capturable]).all()
    assert np.isnan(answer.time[~answer.capturable]).all()


@amounts
def test_margin_is_the_speed_to_the_flip(sets):
    """Add or shed the margin, and a little more: the verdict flips; a little less: it stands."""
    _, cones, coms, velocities = random_states(sets, 3, 12, form)
    answer = each()(cones, coms, velocities)
    speeds = np.linalg.norm(velocities, axis=1)
    for limit, slower in ((answer.max_speed, True), (answer.min_speed, False)):
        known = np.isfinite(limit) & (limit > 0)
        for sign in (-1, 1):
            target = np.where(known, limit + sign * 1e-6 * np.maximum(1, limit), speeds)
            verdict = each()(cones, coms, velocities * (target / speeds)[:, None]).capturable
            assert (verdict[known] == ((sign < 0) == slower)).all()
