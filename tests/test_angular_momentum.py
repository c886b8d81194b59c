"""Angular momentum of the state, one vector beside c x v: both forms of the cone, against the reference, and its laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import rotation
from states import FORMS, TOGETHER, contact_set, random_states, stack

import jaxcap
from jaxcap import Case, Status
from reference import algorithm

pytestmark = pytest.mark.usefixtures("x64")
SETS, STATES, SEED = 100, 3, 21
BAND = 1e-6
"""Margin within which a verdict may differ in double precision [m/s]."""
SPEEDS = ("margin", "min_speed", "max_speed", "residual_speed")
forms = pytest.mark.parametrize("form", FORMS)


def momenta_of(count):
    """Such as robots have, 0.2 m^2/s, and some ten times as large [m^2/s]."""
    rng = np.random.default_rng(7)
    return rng.normal(size=(count, 3)) * np.where(rng.random((count, 1)) < 0.8, 0.15, 1.5)


@jax.jit
def program(cones, coms, velocities, momenta):
    """`capturability` side by side."""
    one = lambda cone, com, velocity, momentum: jaxcap.capturability(cone, com, velocity, specific_angular_momentum=momentum)
    return jax.vmap(one)(cones, coms, velocities, momenta)


def answered(cones, coms, velocities, momenta):
    """The answers on the host, by a program for TOGETHER states."""
    starts = range(0, len(coms), TOGETHER)
    of = lambda i: jax.tree.map(lambda leaf: leaf[i : i + TOGETHER], (cones, coms, velocities, momenta))
    parts = [jax.tree.map(np.asarray, program(*of(i))) for i in starts]
    return jax.tree.map(lambda *fields: np.concatenate(fields), *parts)


def alike(cone, com, velocity, momentum):
    """The answer of one state, by the program for TOGETHER of them."""
    rows = (np.tile(x, (TOGETHER, 1)) for x in (com, velocity, momentum))
    return jax.tree.map(lambda field: field[0], answered(stack([cone] * TOGETHER), *rows))


def restacked(contacts, change):
    """Cones, one for each state, of the contacts after a change of the sampler's arrays."""
    built = {id(arrays): FORMS["faces"](contact_set(*change(*arrays))) for arrays in contacts}
    return stack([built[id(arrays)] for arrays in contacts])


def assert_same(one, other):
    np.testing.assert_array_equal(one.capturable, other.capturable)
    np.testing.assert_array_equal(one.case, other.case)
    for name in SPEEDS:
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-6, atol=1e-7, err_msg=name)


def paper_of(contacts, coms, velocities, momenta):
    return [
        algorithm.is_state_capturable(*arrays, com, velocity, swings=100, specific_angular_momentum=momentum)
        for arrays, com, velocity, momentum in zip(contacts, coms, velocities, momenta, strict=True)
    ]


@forms
def test_verdict_and_case_of_the_reference(form):
    contacts, *states = random_states(SETS, STATES, SEED, form)
    momenta = momenta_of(len(contacts))
    answer = answered(*states, momenta)
    paper = paper_of(contacts, *states[1:], momenta)
    differ = answer.capturable != [result.capturable for result in paper]
    assert np.abs(answer.margin[differ]).max(initial=0) < BAND
    expected = np.array([Case[result.case] for result in paper])
    settled = (answer.case != Case.EMPTY) & (np.abs(answer.margin) >= BAND)
    assert (answer.case == expected)[settled].all()
    assert set(expected) == set(Case) - {Case.UNDECIDED}
    assert (answer.status == Status.OK).all()
    without = answered(*states, np.zeros_like(momenta))
    assert (answer.capturable != without.capturable).sum() > 5, "angular momentum changes too few verdicts to be tested"


def test_limits_are_those_of_the_reference():
    """Just below the largest speed the reference stops, just above it does not: momentum in proportion to the speed."""
    contacts, cones, coms, velocities = random_states(SETS, STATES, SEED)
    momenta = momenta_of(len(contacts))
    answer = answered(cones, coms, velocities, momenta)
    with_limit = np.flatnonzero(np.isfinite(answer.max_speed) & (answer.max_speed > 0) & (answer.min_speed == 0))[:25]
    assert len(with_limit) == 25
    for share, verdict in ((1 - 1e-5, True), (1 + 1e-5, False)):
        factor = (share * answer.max_speed / np.linalg.norm(velocities, axis=1))[:, None]
        at = [
            [contacts[i] for i in with_limit],
            coms[with_limit],
            *((factor * x)[with_limit] for x in (velocities, momenta)),
        ]
        assert [result.capturable for result in paper_of(*at)] == [verdict] * 25


def test_faces_and_rays_agree():
    _, *faces = random_states(SETS, STATES, SEED, "faces")
    _, *rays = random_states(SETS, STATES, SEED, "rays")
    momenta = momenta_of(len(faces[1]))
    assert_same(answered(*faces, momenta), answered(*rays, momenta))


@forms
def test_none_is_zero_to_the_bit(form):
    _, cones, coms, velocities = random_states(20, 3, SEED, form)
    if form == "faces":
        cones, coms, velocities = jax.tree.map(lambda leaf: leaf[0], cones), coms[:3], velocities[:3]
    without = jaxcap.score(cones, coms, velocities)
    for zero in (np.zeros_like(coms), jnp.zeros_like(coms)):
        jax.tree.map(
            np.testing.assert_array_equal, without, jaxcap.score(cones, coms, velocities, specific_angular_momentum=zero)
        )


@forms
def test_a_row_of_zeros_among_others_is_as_without(form):
    _, *states = random_states(SETS, STATES, SEED, form)
    momenta = momenta_of(len(states[1]))
    mixed = answered(*states, np.where(np.arange(len(momenta))[:, None] % 2, momenta, 0))
    without = answered(*states, np.zeros_like(momenta))
    assert_same(*jax.tree.map(lambda leaf: leaf[::2], (mixed, without)))


def test_yaw_and_translation():
    contacts, *states = random_states(SETS, STATES, SEED)
    momenta = momenta_of(len(contacts))
    answer, turn, shift = answered(*states, momenta), rotation(0, 0, 2.1), np.array([100.0, -100.0, 3.0])
    turned = restacked(contacts, lambda points, frames, friction: (points @ turn.T, turn @ frames, friction))
    assert_same(answer, answered(turned, *(x @ turn.T for x in (*states[1:], momenta))))
    moved = restacked(contacts, lambda points, frames, friction: (points + shift, frames, friction))
    assert_same(answer, answered(moved, states[1] + shift, states[2], momenta))


@forms
def test_score_is_capturability_side_by_side(form):
    """By the batched path: chunks, two rounds, rows that are neighbours."""
    _, cones, coms, velocities = random_states(SETS, STATES, SEED, form)
    momenta = momenta_of(len(coms))
    if form == "faces":
        cones = jax.tree.map(lambda leaf: leaf[0], cones)
        each = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(coms), *np.shape(leaf))), cones)
    else:
        each = cones
    expected = answered(each, coms, velocities, momenta)
    for neighbours in (False, True) if form == "rays" else (False,):
        found = jaxcap.score(cones, coms, velocities, neighbours=neighbours, specific_angular_momentum=momenta)
        assert_same(expected, jax.tree.map(np.asarray, found))


@forms
def test_gradients_against_central_differences(form):
    """Of the margin and both limits in the angular momentum; of three steps one has to agree: kinks lie about."""
    _, cones, coms, velocities = random_states(SETS, STATES, SEED, form)
    momenta = momenta_of(len(coms))
    answer = answered(cones, coms, velocities, momenta)
    some = np.flatnonzero((answer.max_speed > 0) & np.isfinite(answer.max_speed))[:TOGETHER]
    states = jax.tree.map(lambda leaf: leaf[some], (cones, coms, velocities))

    def margin(cone, com, velocity, momentum):
        return jaxcap.capturability(cone, com, velocity, specific_angular_momentum=momentum).margin

    slopes = np.asarray(jax.jit(jax.vmap(jax.grad(margin, argnums=3)))(*states, momenta[some]))
    assert np.isfinite(slopes).all()
    towards = np.random.default_rng(3).normal(size=(len(some), 3))
    worst = []
    for step in (1e-4, 1e-5, 1e-6):
        ahead, behind = (answered(*states, momenta[some] + sign * step * towards).margin for sign in (1, -1))
        difference, slope = (ahead - behind) / (2 * step), np.sum(slopes * towards, axis=1)
        worst.append(np.abs(difference - slope) / (1 + np.abs(slope)))
    assert np.median(np.min(worst, axis=0)) < 1e-8
    assert np.mean(np.min(worst, axis=0) < 1e-5) > 0.95
    assert np.abs(slopes).max() > 0.1


def feet():
    return jaxcap.rectangle((0.0, 0.1, 0.0), np.eye(3), 0.1, 0.06, 0.7) + jaxcap.rectangle(
        (0.0, -0.1, 0.0), np.eye(3), 0.1, 0.06, 0.7
    )


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_row_that_is_not_finite_leaves_the_others_alone(dtype):
    cone = jaxcap.centroidal_cone(feet())
    coms = np.tile(np.array([0.0, 0.0, 0.9], dtype), (6, 1))
    velocities = np.tile(np.array([0.2, 0.05, 0.0], dtype), (6, 1))
    momenta = np.full((6, 3), 0.05, dtype)
    bad = momenta.copy()
    bad[2, 1], bad[4, 0] = np.nan, np.inf
    whole = jaxcap.score(cone, coms, velocities, specific_angular_momentum=momenta)
    found = jaxcap.score(cone, coms, velocities, specific_angular_momentum=bad)
    assert found.margin.dtype == dtype
    assert np.asarray(found.status).tolist() == [
        Status.OK,
        Status.OK,
        Status.NONFINITE,
        Status.OK,
        Status.NONFINITE,
        Status.OK,
    ]
    assert np.isnan(np.asarray(found.margin)[[2, 4]]).all() and not np.asarray(found.capturable)[[2, 4]].any()
    jax.tree.map(lambda one, other: np.testing.assert_array_equal(one[::5], other[::5]), whole, found)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@forms
def test_at_rest_it_does_not_count(form, dtype):
    """At zero velocity, and where the CoM's momentum is lost beside it, the question is whether the robot can stand."""
    places = np.array([[0.0, 0.0, 0.9], [0.5, 0.0, 0.9]], dtype)  # the robot can stand at the first
    speeds = np.array([0.0, 1e-14, 1e-30, 1e-4], dtype)
    # as many states as the program of the other tests has
    rows = np.arange(TOGETHER) % 8
    velocities = speeds[rows % 4, None] * np.array([1, 0, 0], dtype)
    momenta = np.tile(np.array([0.1, -0.2, 0.3], dtype), (TOGETHER, 1))
    cones = stack([FORMS[form](feet())] * TOGETHER)
    found = jax.tree.map(lambda field: field[:8].reshape(2, 4), answered(cones, places[rows // 4], velocities, momenta))
    # also just above: the way to rest is short
    np.testing.assert_array_equal(found.capturable, [[True] * 4, [False] * 4])
    assert (found.status[:, :3] == Status.NO_DIRECTION).all() and np.isnan(found.margin[:, :3]).all()
    assert 0 < found.distance[0, 3] < 1e-4


def test_angular_momentum_that_brakes_and_that_does_not():
    """By hand: a point foot bears no torque about itself. With spin = -(c x v) the wrench of an acceleration is force alone,
    as that of a mass at the foot; a CoM whose angular momentum about the foot is zero can be stopped at any speed that
    friction allows, one with none of its own not at all.
    """
    height, speed = 1.0, 0.3
    point = jaxcap.ContactSet(points=np.zeros((1, 3)), frames=np.eye(3)[None], friction=np.array([0.5]))
    com, velocity = np.array([0.0, 0.0, height]), np.array([speed, 0.0, 0.0])
    momentum = -np.cross(com, velocity)
    for form in FORMS:
        # about the foot: c x cdot + L/m = 0 for ever, so gravity may have no torque there either: it must stop at once
        for share in (0, 1):
            assert not alike(FORMS[form](point), com, velocity, share * momentum).capturable
    pair = jaxcap.rectangle((0.0, 0.0, 0.0), np.eye(3), 0.1, 0.1, 0.5)
    behind = np.array([-0.05, 0.0, height])
    speeds = [float(alike(FORMS["faces"](pair), behind, velocity, k * momentum).max_speed) for k in (-0.5, 0.0, 0.5)]
    assert speeds[0] < speeds[1] < speeds[2]


@pytest.mark.parametrize(
    ("momentum", "said"),
    [
        (np.zeros((2, 3)), r"specific_angular_momentum 2 \(expected as many\)"),
        (np.ones((3, 2)), r"specific_angular_momentum has shape \(3, 2\) \(expected \(n, 3\)\)"),
        (np.ones(3), r"specific_angular_momentum has shape \(3,\) \(expected \(n, 3\)\)"),
    ],
)
def test_wrong_shapes_are_named(momentum, said):
    cone, states = jaxcap.centroidal_cone(feet()), np.ones((3, 3))
    with pytest.raises(TypeError, match=said):
        jaxcap.score(cone, states, states, specific_angular_momentum=momentum)
    with pytest.raises(TypeError, match=r"specific_angular_momentum has shape \(1, 3\)"):
        jaxcap.capturability(cone, states[0], states[0], specific_angular_momentum=np.ones((1, 3)))
