"""The state after a time of braking: against an oracle that shares no code, and by its laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from states import POINTS, contact_set, random_states

import jaxcap
from jaxcap import Case, Progress, Status
from reference.braking import braked

pytestmark = pytest.mark.usefixtures("x64")
G = 9.81
HEIGHT = 0.8
OMEGA = np.sqrt(G / HEIGHT)
TIMES = (0.05, 0.2, 0.4)  # [s]
SAMPLE = 120  # states in a test
FEET = jaxcap.rectangle([0, 0.1, 0], np.eye(3), 0.1, 0.05, 2.0) + jaxcap.rectangle([0, -0.1, 0], np.eye(3), 0.1, 0.05, 2.0)
ENDINGS = {"on the way": [Progress.ON_THE_WAY], "rests": [Progress.RESTS, Progress.TURNS], "leaves": [Progress.LEAVES]}
FORMS = {
    "faces": lambda contacts, count: jaxcap.centroidal_cone(contacts),
    "rays": lambda contacts, count: alike(contacts, count),
}
"""The cone of some states on these contacts; by rays each state has its own, of the size of the random ones: one program."""


def alike(contacts, count):
    return jax.tree.map(
        lambda leaf: np.stack([leaf] * count), jax.tree.map(np.asarray, jaxcap.cone_rays(contacts.padded(POINTS)))
    )


@pytest.fixture(scope="module")
def sample():
    """Random states with a contact set of their own, in ray form, and their contacts."""
    contacts, cones, coms, velocities = random_states(SAMPLE // 2, 2, 5, "rays")
    return contacts, cones, coms, velocities


@pytest.fixture(scope="module")
def scored(sample):
    with jax.enable_x64(True):
        return jax.tree.map(np.asarray, jaxcap.score(*sample[1:]))


def after(sample, duration, **options):
    return jax.tree.map(np.asarray, jaxcap.advance(*sample[1:], duration, **options))


@pytest.fixture(scope="module")
def momenta():
    """Such as robots have, 0.2 m^2/s, and some ten times as large [m^2/s]."""
    rng = np.random.default_rng(7)
    return rng.normal(size=(SAMPLE, 3)) * np.where(rng.random((SAMPLE, 1)) < 0.8, 0.15, 1.5)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("speed", "time"), [(0.2, 0.1), (0.6, 0.3)])
def test_the_inverted_pendulum_in_closed_form(form, speed, time):
    """Braking and diverging on flat ground: the pendulum about the toes."""
    rows = jaxcap.advance(FORMS[form](FEET, 1), np.array([[0, 0, HEIGHT]]), np.array([[speed, 0, 0]]), time)
    found = jax.tree.map(lambda field: np.asarray(field)[0], rows)
    cosh, sinh = np.cosh(OMEGA * time), np.sinh(OMEGA * time)
    np.testing.assert_allclose(found.com, [0.1 - 0.1 * cosh + speed / OMEGA * sinh, 0, HEIGHT], rtol=1e-12)
    np.testing.assert_allclose(found.com_velocity, [speed * cosh - 0.1 * OMEGA * sinh, 0, 0], rtol=1e-12)
    assert (found.progress, found.status, found.time) == (Progress.ON_THE_WAY, Status.OK, time)


@pytest.mark.parametrize("time", TIMES)
def test_it_is_where_steps_of_linear_programs_lead(sample, scored, time):
    """To three times what halving the step changes, and the rounding of HiGHS."""
    found, compared = after(sample, time), set()
    speeds = np.linalg.norm(found.com_velocity, axis=1)
    for i in np.flatnonzero(scored.case != Case.C3_2_1)[:30]:  # those brake later
        (points, frames, friction), com, velocity = sample[0][i], sample[2][i], sample[3][i]
        oracle = braked(points, frames, friction, com, velocity, time)
        alpha = found.displacement[i] @ velocity / np.linalg.norm(velocity)
        assert found.progress[i] in ENDINGS[oracle.ending]
        if oracle.ending == "leaves":  # it sees that a step late or early
            assert abs(found.time[i] - oracle.time) < 0.003
        else:
            bound = 3 * oracle.error + 1e-7
            np.testing.assert_allclose([alpha, speeds[i]], [oracle.alpha, oracle.speed], atol=bound)
            np.testing.assert_allclose(found.time[i], oracle.time, atol=max(1e-9, 0.004 * (oracle.ending == "rests")))
        compared.add(oracle.ending)
    assert compared == {"on the way", "rests", "leaves"}


def test_it_comes_to_rest_where_and_when_the_decision_says(sample, scored):
    """The ride in time against the ride in energy; also where less than hardest braking is right (C3.2.1)."""
    stops = np.isin(scored.case, [Case.C3_1, Case.C3_2_1])
    found = after(sample, np.where(stops, scored.time + 0.01, 0.1))
    assert (found.progress[stops] == Progress.RESTS).all()
    assert {Case.C3_1, Case.C3_2_1} <= set(scored.case[stops].tolist())
    np.testing.assert_allclose(found.time[stops], scored.time[stops], rtol=1e-7, atol=1e-9)
    distance = np.linalg.norm(found.displacement[stops], axis=1)
    np.testing.assert_allclose(distance, scored.distance[stops], rtol=1e-7, atol=1e-9)


def test_no_time_changes_nothing(sample):
    found = after(sample, 0.0)
    np.testing.assert_array_equal(found.com, sample[2])
    np.testing.assert_array_equal(found.com_velocity, sample[3])
    assert (found.time == 0).all() and (found.progress == Progress.ON_THE_WAY).all()


def test_two_times_are_one_after_the_other(sample):
    whole, first = after(sample, 0.3), after(sample, 0.1)
    second = jax.tree.map(np.asarray, jaxcap.advance(sample[1], first.com, first.com_velocity, 0.2))
    np.testing.assert_allclose(second.com, whole.com, atol=1e-9)
    np.testing.assert_allclose(second.com_velocity, whole.com_velocity, atol=1e-7)


@pytest.mark.parametrize("time", TIMES)
def test_what_is_capturable_stays_so(sample, scored, time):
    sure = scored.capturable & (scored.margin > 1e-6)
    found = after(sample, np.where(sure, np.minimum(time, 0.99 * np.nan_to_num(scored.time, nan=np.inf)), 0.0))
    moving = sure & (found.progress == Progress.ON_THE_WAY)
    assert moving.sum() > 10
    then = jax.tree.map(np.asarray, jaxcap.score(sample[1], found.com, found.com_velocity))
    assert then.capturable[moving].all()


def test_one_state_is_a_row_of_many(sample):
    """And under jit and vmap."""
    rows = after(sample, 0.2)
    one = jax.jit(jaxcap.advance)
    alone = [one(jax.tree.map(lambda leaf, i=i: leaf[i], sample[1]), sample[2][i], sample[3][i], 0.2) for i in range(10)]
    side_by_side = jax.jit(jax.vmap(jaxcap.advance, in_axes=(0, 0, 0, None)))(*sample[1:], 0.2)
    assert rows.specific_angular_momentum is None
    for name in [name for name in rows._fields if name != "specific_angular_momentum"]:
        np.testing.assert_allclose(np.array([getattr(row, name) for row in alone]), getattr(rows, name)[:10], atol=1e-9)
        np.testing.assert_allclose(np.asarray(getattr(side_by_side, name)), getattr(rows, name), atol=1e-9)


def test_gradients_equal_central_differences(sample):
    """With respect to place, velocity and time, forwards and backwards, where two steps of the differences agree."""
    cones, states = jax.tree.map(lambda leaf: leaf[:40], (sample[1], np.column_stack([*sample[2:], np.full(SAMPLE, 0.15)])))
    figures = lambda cone, x: jnp.concatenate([(a := jaxcap.advance(cone, x[:3], x[3:6], x[6])).com, a.com_velocity])
    backwards = np.asarray(jax.jit(jax.vmap(jax.jacrev(figures, argnums=1)))(cones, states))
    forwards = np.asarray(jax.jit(jax.vmap(jax.jacfwd(figures, argnums=1)))(cones, states))
    np.testing.assert_allclose(backwards, forwards, rtol=1e-9, atol=1e-9)

    def value(x):  # by the program of the other tests
        found = jaxcap.advance(cones, x[:, :3], x[:, 3:6], x[:, 6])
        return np.concatenate([found.com, found.com_velocity], axis=1)

    differences = [
        np.stack([(value(states + d) - value(states - d)) / (2 * h) for d in h * np.eye(7)], axis=-1) for h in (1e-6, 2e-6)
    ]
    smooth = np.abs(differences[0] - differences[1]) < 1e-5 * (1 + np.abs(differences[0]))
    assert smooth.mean() > 0.95
    np.testing.assert_allclose(backwards[smooth], differences[0][smooth], rtol=1e-4, atol=1e-4)


def test_with_angular_momentum_it_is_where_steps_of_linear_programs_lead(sample, momenta):
    """The program of each step has L's rate, in proportion to the acceleration, beside c x v; no closed form."""
    scored = jaxcap.score(*sample[1:], specific_angular_momentum=momenta)
    found, without = after(sample, 0.2, specific_angular_momentum=momenta), after(sample, 0.2)
    speeds, started = np.linalg.norm(found.com_velocity, axis=1), np.linalg.norm(sample[3], axis=1)
    compared = set()
    for i in np.flatnonzero(np.asarray(scored.case) != Case.C3_2_1)[:30]:
        (points, frames, friction), com, velocity = sample[0][i], sample[2][i], sample[3][i]
        oracle = braked(points, frames, friction, com, velocity, 0.2, specific_angular_momentum=momenta[i])
        assert found.progress[i] in ENDINGS[oracle.ending]
        if oracle.ending != "leaves":
            alpha, bound = found.displacement[i] @ velocity / started[i], 3 * oracle.error + 1e-7
            np.testing.assert_allclose([alpha, speeds[i]], [oracle.alpha, oracle.speed], atol=bound)
        compared.add(oracle.ending)
    assert {"on the way", "rests"} <= compared
    moved = (found.progress == Progress.ON_THE_WAY) & (without.progress == Progress.ON_THE_WAY)
    assert (np.abs(found.com_velocity - without.com_velocity)[moved].max(axis=1) > 1e-3).mean() > 0.5
    expected = momenta * (speeds / started)[:, None]
    np.testing.assert_allclose(found.specific_angular_momentum, expected, rtol=1e-9, atol=1e-12)


def test_with_angular_momentum_two_times_are_one_after_the_other(sample, momenta):
    """What comes back is all that is needed to go on, and what is capturable stays so."""
    whole, first = (after(sample, time, specific_angular_momentum=momenta) for time in (0.3, 0.1))
    then = {"specific_angular_momentum": first.specific_angular_momentum}
    second = jax.tree.map(np.asarray, jaxcap.advance(sample[1], first.com, first.com_velocity, 0.2, **then))
    np.testing.assert_allclose(second.com, whole.com, atol=1e-9)
    for name in ("com_velocity", "specific_angular_momentum"):
        np.testing.assert_allclose(getattr(second, name), getattr(whole, name), atol=1e-7, err_msg=name)
    scored = jaxcap.score(*sample[1:], specific_angular_momentum=momenta)
    later = jaxcap.score(sample[1], first.com, first.com_velocity, **then)
    sure = np.asarray(scored.capturable & (scored.margin > 1e-6) & (scored.time > 0.1))
    sure = sure & (first.progress == Progress.ON_THE_WAY)
    assert sure.sum() > 10 and np.asarray(later.capturable)[sure].all()


def test_no_angular_momentum_is_the_answer_of_today_to_the_bit(sample):
    """Zero is none; after no time it is as it was."""
    without, zero = after(sample, 0.2), after(sample, 0.2, specific_angular_momentum=np.zeros((SAMPLE, 3)))
    for name in [name for name in without._fields if name != "specific_angular_momentum"]:
        np.testing.assert_array_equal(getattr(zero, name), getattr(without, name))
    assert (zero.specific_angular_momentum == 0).all()


def test_angular_momentum_after_no_time_at_rest_and_in_a_fall(sample, momenta):
    at_once = after(sample, 0.0, specific_angular_momentum=momenta)
    np.testing.assert_array_equal(at_once.specific_angular_momentum, momenta)
    bad = momenta[:2] * [[1], [np.nan]]
    cone = jax.tree.map(lambda leaf: leaf[:2], sample[1])
    none = cone._replace(mask=np.zeros_like(cone.mask), rays=np.zeros_like(cone.rays))
    falls = jaxcap.advance(none, sample[2][:2], sample[3][:2], 0.3, specific_angular_momentum=bad)
    np.testing.assert_array_equal(falls.specific_angular_momentum[0], momenta[0])
    assert falls.progress.tolist() == [Progress.FLIES, Progress.UNDECIDED] and falls.status[1] == Status.NONFINITE


def test_a_momentum_box_by_rays_is_that_of_faces(sample):
    """Two producers; and zero is today's answer to the bit. Contacts on the floor, where faces are quick to make."""
    coms, velocities = np.array([[0, 0, HEIGHT], [0.05, 0.02, 0.8], [-0.04, 0, 0.9]]), np.array([[0.5, 0, 0]] * 3)
    rays, plain = jaxcap.cone_rays(FEET), jaxcap.centroidal_cone(FEET)
    boxed = jaxcap.advance(jaxcap.centroidal_cone(FEET, momentum_box=0.3), coms, velocities, 0.15)
    by_rays = jaxcap.advance(rays, coms, velocities, 0.15, momentum_box=0.3)
    for name in ("com", "com_velocity", "time"):
        np.testing.assert_allclose(getattr(by_rays, name), getattr(boxed, name), atol=1e-9, err_msg=name)
    np.testing.assert_array_equal(by_rays.progress, boxed.progress)
    without = jaxcap.advance(plain, coms, velocities, 0.15)
    assert (np.linalg.norm(boxed.com_velocity, axis=1) < np.linalg.norm(without.com_velocity, axis=1) - 0.01).all()
    zero = after(sample, 0.2, momentum_box=0.0)
    jax.tree.map(np.testing.assert_array_equal, zero, after(sample, 0.2))


def test_a_momentum_box_needs_contacts():
    """Without force there is no acceleration, whatever the limbs do: it falls freely."""
    none = jaxcap.cone_rays(jaxcap.ContactSet(np.zeros((8, 3)), np.eye(3), 1.0, mask=np.zeros(8, bool)))
    falls = jaxcap.advance(none, np.array([[0, 0, 0.9]]), np.array([[0.5, 0, 0.1]]), 0.2, momentum_box=0.3)
    assert falls.progress.tolist() == [Progress.FLIES]
    np.testing.assert_allclose(falls.com, [[0.1, 0, 0.9 + 0.02 - 9.81 * 0.02]], atol=1e-12)


def test_without_contacts_it_falls():
    """Also at rest, and among others that stand."""
    none = jaxcap.ContactSet(np.zeros((2, POINTS, 3)), np.eye(3), 1.0, mask=np.zeros((2, POINTS), bool))
    com, velocity = np.array([[0, 0, 1.0], [1, 2, 3.0]]), np.array([[0.3, 0, 0.1], [0, 0, 0]])
    found = jaxcap.advance(jaxcap.cone_rays(none), com, velocity, 0.5)
    fall = np.array([0, 0, -G])
    np.testing.assert_allclose(found.com, com + 0.5 * velocity + fall / 8, rtol=1e-12)
    np.testing.assert_allclose(found.com_velocity, velocity + fall / 2, rtol=1e-12)
    assert (found.progress == Progress.FLIES).all() and (found.status == Status.OK).all()


@pytest.mark.parametrize("form", FORMS)
def test_states_that_go_nowhere(form):
    """At rest on and off the feet; NaN, which spoils no other."""
    com = np.array([[0, 0, HEIGHT], [0.5, 0, HEIGHT], [0, 0, np.nan], [0, 0, HEIGHT]])
    velocity = np.array([[0, 0, 0], [0, 0, 0], [0.1, 0, 0], [0.1, 0, 0.0]])
    found = jaxcap.advance(FORMS[form](FEET, len(com)), com, velocity, 0.02)
    assert found.progress.tolist() == [Progress.RESTS, Progress.TURNS, Progress.UNDECIDED, Progress.ON_THE_WAY]
    assert found.status.tolist() == [Status.NO_DIRECTION, Status.NO_DIRECTION, Status.NONFINITE, Status.OK]
    np.testing.assert_array_equal(found.com[:2], com[:2])
    assert np.isnan(found.com_velocity[2]).all() and not np.isnan(found.com_velocity[3]).any()


def test_far_from_the_origin_nothing_is_lost():
    """Positions of a map in NumPy, in single precision."""
    far = np.array([5e5, 5e6, 0])
    moved = jaxcap.ContactSet(FEET.points + far, FEET.frames, FEET.friction)
    state = np.array([0, 0, HEIGHT]), np.array([0.3, 0.1, 0])
    with jax.enable_x64(False):
        here = jaxcap.advance(jaxcap.cone_rays(FEET), *state, 0.1)
        there = jaxcap.advance(jaxcap.cone_rays(moved), state[0] + far, state[1], 0.1)
    np.testing.assert_allclose(there.com - far, here.com, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"duration": -0.1}, ValueError, r"duration = -0.1 \(expected a finite number of seconds, not negative\)"),
        ({"duration": np.inf}, ValueError, "duration = inf"),
        ({"duration": np.zeros(3)}, TypeError, r"duration has shape \(3,\) \(expected one number\)"),
        ({"com": np.zeros(2)}, TypeError, r"com has shape \(2,\)"),
        ({"com_velocity": np.zeros((1, 3))}, TypeError, "com_velocity has shape"),
        ({"specific_angular_momentum": np.zeros(2)}, TypeError, r"specific_angular_momentum has shape \(2,\)"),
    ],
)
def test_what_cannot_be_is_named(change, error, words):
    given = {"cone": jaxcap.centroidal_cone(FEET), "com": np.zeros(3), "com_velocity": np.ones(3), "duration": 0.1}
    with pytest.raises(error, match=words):
        jaxcap.advance(**given | change)


def test_the_oracle_agrees_with_the_pendulum():
    contacts = contact_set(FEET.points, FEET.frames, FEET.friction)
    oracle = braked(contacts.points, contacts.frames, contacts.friction, [0, 0, HEIGHT], [0.6, 0, 0], 0.3)
    cosh, sinh = np.cosh(OMEGA * 0.3), np.sinh(OMEGA * 0.3)
    assert abs(oracle.alpha - (0.1 - 0.1 * cosh + 0.6 / OMEGA * sinh)) < max(oracle.error, 1e-9)
    assert oracle.error < 1e-4
