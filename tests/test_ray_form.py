"""The ray form, a contact set for each state: consistent with the face form, and with the linear program."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import random_state, rectangle, rotation
from states import FORMS, POINTS, contact_set, each, pieces, random_states, stack

import jaxcap
from jaxcap import Case, Status
from jaxcap.numerics.guarded import direction
from jaxcap.one_state.boundary import End
from jaxcap.one_state.face_polygon import polygon
from jaxcap.one_state.ray_polygon import ray_polygon
from reference import oracles
from reference.contacts import wrench_rays
from reference.linear_programs import line_program, solve_acceleration

pytestmark = pytest.mark.usefixtures("x64")
SETS, STATES, SEED = 1200, 3, 21
FIGURES = ("margin", "min_speed", "max_speed", "paper_margin", "distance", "time", "residual_speed")


def rays_of(contacts, sides=4):
    """One batched ConeRays for a list of contact sets, padded: to POINTS contacts, with more sides to 256 rays."""
    size = POINTS if sides == 4 else 256 // sides
    return jaxcap.cone_rays(stack([one.padded(size) for one in contacts]), sides)


def single(tree):
    """In single precision."""
    return jax.tree.map(lambda x: x if x.dtype == bool else x.astype(np.float32), tree)


@pytest.fixture(scope="module")
def both():
    """Face form and ray form of 3,600 random states, the latter a thousand contact sets a call."""
    contacts, cones, coms, velocities = random_states(SETS, STATES, SEED)
    with jax.enable_x64(True):
        faces = jax.tree.map(np.asarray, each()(cones, coms, velocities))
        sets = stack([contact_set(*arrays).padded(POINTS) for arrays in contacts])
        rays = pieces(jaxcap.cone_rays(sets), coms, velocities)
    return faces, rays


def assert_consistent(faces, rays):
    """Equal answers, outside 1e-6 m/s of a flip."""
    assert (faces.status == rays.status).all()
    away = ~(np.abs(faces.margin) < 1e-6)
    np.testing.assert_array_equal(faces.capturable[away], rays.capturable[away])
    np.testing.assert_array_equal(faces.case[away], rays.case[away])
    for name in FIGURES[:3]:
        np.testing.assert_allclose(getattr(rays, name), getattr(faces, name), rtol=1e-6, atol=1e-6, err_msg=name)
    clear = away & ~(np.abs(faces.margin) < 1e-4)  # a stop at the very limit moves with the root of a change
    for name in FIGURES[3:]:
        np.testing.assert_allclose(
            getattr(rays, name)[clear], getattr(faces, name)[clear], rtol=1e-5, atol=1e-6, err_msg=name
        )


def test_consistent_with_the_face_form(both):
    assert_consistent(*both)
    assert set(np.unique(both[1].case)) == set(Case) - {Case.UNDECIDED}


def test_single_precision_gives_the_verdict_of_double(both):
    contacts, _, coms, velocities = random_states(SETS, STATES, SEED)
    sets = stack([contact_set(*arrays).padded(POINTS) for arrays in contacts])
    found = pieces(single(jaxcap.cone_rays(sets)), coms.astype(np.float32), velocities.astype(np.float32))
    assert (found.status == Status.OK).all()
    assert found.margin.dtype == np.float32
    differ = found.capturable != both[1].capturable
    assert np.abs(both[1].margin[differ]).max(initial=0) < 1e-3


def test_consistent_with_the_linear_program(both):
    """s_min, s_max, and the smallest acceleration at places along the line, by HiGHS."""
    contacts, _, coms, velocities = random_states(SETS, STATES, SEED)

    @jax.jit
    def sampled(rays, com, along):
        """Static region, and the lower boundary with its values at seven places."""
        polygon = ray_polygon(rays, com, along, jnp.array([0, 0, -9.81]))
        survey = polygon.survey()
        lower = polygon.knowing(survey).boundary(jnp.asarray(np.inf))
        alphas = jnp.linspace(0, 0.999 * jnp.minimum(lower.end, 2.0), 7)
        return survey, alphas, jnp.stack([lower.at(alpha) for alpha in alphas]), lower.ending

    for i in np.flatnonzero(np.isin(both[1].case, [Case.C1, Case.C3_1, Case.C3_2_1, Case.C3_2_2, Case.C3_3]))[:120:2]:
        along = direction(jnp.asarray(velocities[i]))[0]
        rays = jaxcap.cone_rays(contact_set(*contacts[i]).padded(POINTS))
        survey, alphas, lowest, ending = sampled(rays, jnp.asarray(coms[i]), along)
        expected = oracles.static_interval(*contacts[i], coms[i], np.asarray(along))
        np.testing.assert_allclose([survey.s_min, survey.s_max], expected, rtol=1e-6, atol=1e-6)
        program = line_program(coms[i], np.asarray(along), wrench_rays(*contacts[i]))
        expected = [solve_acceleration(program, float(alpha), 1).fun for alpha in alphas]
        if ending == End.FLOORLESS:
            assert expected == [None] * len(alphas)
        else:
            np.testing.assert_allclose(lowest, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("form", ["faces", "rays"])
def test_a_walk_may_end_where_it_has_taken_enough(form):
    """It has the first pieces of the whole walk, and no more of them than it takes."""
    _, cones, coms, velocities = random_states(60, 1, SEED, form)

    @jax.jit
    def walked(cone, com, along):
        """The whole walk, one for less energy than it takes, that energy, and what is taken up to each of its knots."""
        cut = ray_polygon if form == "rays" else polygon
        rows = cut(cone, com, along, jnp.array([0, 0, -9.81]))
        survey = rows.survey()
        rows, limit = rows.knowing(survey), jnp.where(survey.feasible, jnp.inf, 0)
        whole = rows.boundary(limit)
        enough = -0.4 * whole.gain(whole.end)
        return whole, rows.boundary(limit, enough=enough), enough, -whole.gain(whole.pieces.right)

    early = 0
    for i, (com, velocity) in enumerate(zip(coms, velocities, strict=True)):
        cone, along = jax.tree.map(lambda leaf, i=i: jnp.asarray(leaf[i]), cones), direction(jnp.asarray(velocity))[0]
        whole, short, enough, taken = walked(cone, jnp.asarray(com), along)
        if whole.ending not in (End.DIVERGES, End.POLYGON) or not enough > 0:
            continue
        used = int((whole.pieces.right > whole.pieces.left).sum())
        expected = min(int(np.sum(np.asarray(taken)[: used - 1] < enough)) + 1, used)
        kept = int((short.pieces.right > short.pieces.left).sum())
        assert kept == expected
        for one, other in zip(short.pieces, whole.pieces, strict=True):
            np.testing.assert_allclose(one[: kept - 1], other[: kept - 1], rtol=1e-12)
        assert short.ending == (whole.ending if kept == used else End.LIMIT)
        early += kept < used
    assert early > 5


UP = np.eye(3)


def foot(x, y, z=0.0, frame=UP, friction=0.5):
    return contact_set(*rectangle([x, y, z], frame, friction=friction))


def points(*positions, frames=UP, friction=0.5):
    return jaxcap.ContactSet(np.array(positions, float), frames, friction)


def hidden(contacts):
    """The same contacts, masked out."""
    return jaxcap.ContactSet(contacts.points, contacts.frames, contacts.friction, np.zeros(len(contacts), bool))


DEGENERATE = {
    "one point": points([0.1, 0.2, 0]),
    "two points": points([-0.2, 0, 0], [0.2, 0, 0]),
    "two points, one above the other": points([0, 0, 0], [0, 0, 1.0], frames=rotation(0, np.pi / 2, 0)),
    "three collinear points": points([-0.2, 0, 0], [0.05, 0, 0], [0.2, 0, 0]),
    "the same point twice": points([0, 0, 0], [0, 0, 0], [0.3, 0, 0]),
    "opposing palms": foot(0, 0.2, 1, rotation(np.pi / 2, 0, 0)) + foot(0, -0.2, 1, rotation(-np.pi / 2, 0, 0)),
    "coplanar feet with equal frames": foot(0, 0.1) + foot(0, -0.1),
    "coplanar feet side by side": foot(0, 0.07) + foot(0, -0.07),
    "four coplanar feet": foot(0.3, 0.1) + foot(0.3, -0.1) + foot(-0.3, 0.1) + foot(-0.3, -0.1),
    "one foot": foot(0, 0),
    "feet on a slope": foot(0, 0.2, 0, rotation(0.3, 0, 0)) + foot(0, -0.2, 0, rotation(0.3, 0, 0)),
    "a steep wall": foot(0, 0, 0, rotation(0, 1.4, 0)),
    "mixed friction": foot(0, 0.1, friction=1.5) + foot(0, -0.1, friction=0.05),
    "almost no friction": foot(0, 0.1, friction=1e-3) + foot(0.2, -0.1, friction=1e-3),
    "masked out in the middle": foot(0, 0.1) + hidden(foot(0.5, 0.5, 1)) + foot(0.3, -0.1, 0.2, rotation(0.2, -0.3, 0)),
    "on a ceiling": foot(0, 0.1, 2, rotation(np.pi, 0, 0)) + foot(0, -0.1, 2, rotation(np.pi, 0, 0)),
}


def degenerate_states(contacts, seed, count=60):
    """States around a contact set: random ones, ones right above its centre, and ones at rest or along an axis."""
    rng = np.random.default_rng(seed)
    active = contacts.points[contacts.mask]
    coms, velocities = (np.array(x) for x in zip(*(random_state(rng, active) for _ in range(count)), strict=True))
    centre = active.mean(axis=0)
    coms[: count // 3, :2] = centre[:2]
    coms[count // 3 : count // 2, 0] = centre[0]
    for i, axis in enumerate([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [-1, 0, 0], [0, 0, 0], [1, 1, 0]]):
        velocities[i * 6 : i * 6 + 4] = 0.4 * np.array(axis)
    return coms, velocities


@functools.cache
def degenerate_batch():
    """All of them: one contact set, CoM and velocity for each state; and the name of the set."""
    batch = [(name, contacts, *degenerate_states(contacts, i)) for i, (name, contacts) in enumerate(DEGENERATE.items())]
    names = np.repeat(list(DEGENERATE), len(batch[0][2]))
    sets = [contacts for _, contacts, coms, _ in batch for _ in coms]
    return names, sets, np.concatenate([coms for *_, coms, _ in batch]), np.concatenate([v for *_, v in batch])


@pytest.mark.parametrize("sides", [4, 8, 16])
def test_degenerate_sets_are_consistent_in_one_call(sides):
    """All degenerate contact sets, padded to one size, against a cone each."""
    names, sets, coms, velocities = degenerate_batch()
    faces = []
    for name, contacts in DEGENERATE.items():
        cone = jaxcap.centroidal_cone(contacts, sides).padded(1500 if sides == 16 else 500)
        faces.append(jaxcap.score(cone, coms[names == name], velocities[names == name]))
    faces = jax.tree.map(lambda *parts: np.concatenate(parts), *faces)
    assert_consistent(faces, pieces(rays_of(sets, sides), coms, velocities))


def test_degenerate_sets_in_single_precision():
    """Every state is decided, and as in double precision outside the band."""
    _, sets, coms, velocities = degenerate_batch()
    rays = rays_of(sets)
    double = pieces(rays, coms, velocities)
    found = pieces(single(rays), coms.astype(np.float32), velocities.astype(np.float32))
    assert np.isin(found.status, [Status.OK, Status.NO_DIRECTION, Status.MAX_SWINGS]).all()
    outside = np.abs(double.margin) > 1e-3
    np.testing.assert_array_equal(found.capturable[outside], double.capturable[outside])


def test_no_contact_at_all_is_empty():
    """A robot in the air cannot stop, whichever way it moves; the others in the batch are not affected."""
    feet = (foot(0, 0.1) + foot(0, -0.1)).padded(POINTS)
    sets = [feet, hidden(feet), feet] * 4
    velocities = np.repeat([[0.1, 0, 0], [0, 0, 1.0], [0, 0, -1.0], [0, 0, 0]], 3, axis=0)
    found = pieces(rays_of(sets), np.tile([0, 0, 0.8], (12, 1)), velocities)
    air = np.arange(12) % 3 == 1
    assert (found.case[air] == Case.EMPTY).all()
    np.testing.assert_array_equal(found.capturable, ~air)
    np.testing.assert_array_equal(found.status, np.repeat([Status.OK, Status.OK, Status.OK, Status.NO_DIRECTION], 3))
    np.testing.assert_allclose(found.margin[air][:3], [-0.1, -1, -1])


def test_contacts_that_are_not_finite_cost_no_other_row():
    feet = stack([(foot(0, 0.1) + foot(0, -0.1)).padded(POINTS)] * 3)
    coms, velocities = np.tile([0, 0, 0.8], (3, 1)), np.tile([0.1, 0, 0], (3, 1))
    rays = jaxcap.cone_rays(feet)
    bad = jaxcap.ConeRays(rays.rays.at[1, 5, 2].set(np.nan), rays.mask, rays.origin, rays.length)
    found = pieces(bad, coms, velocities)
    np.testing.assert_array_equal(found.status, [Status.OK, Status.NONFINITE, Status.OK])
    np.testing.assert_array_equal(found.capturable, [True, False, True])


def test_rays_of_another_number_of_states_are_a_type_error():
    with pytest.raises(TypeError, match="rays of 2 contact sets"):
        jaxcap.score(rays_of([foot(0, 0)] * 2), np.zeros((3, 3)), np.zeros((3, 3)))


def test_shared_rays_are_the_same_as_rays_for_each_state():
    _, _, coms, velocities = random_states(SETS, STATES, SEED)
    contacts = foot(0, 0.1) + foot(0.2, -0.2, 0.3, rotation(0.3, 0.2, 0.1))
    shared = pieces(jaxcap.cone_rays(contacts.padded(POINTS)), coms[:900], velocities[:900])
    own = pieces(rays_of([contacts] * 900), coms[:900], velocities[:900])
    for one, other in zip(shared, own, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("own", [False, True])
def test_a_warm_start_changes_no_answer(own):
    """Neighbours along a trajectory through many cases, and rows that are no neighbours at all."""
    rng = np.random.default_rng(8)
    contacts = foot(0, 0.1) + foot(0.2, -0.2, 0.3, rotation(0.3, 0.2, 0.1))
    steps = np.linspace(0, 8, 1000)[:, None]
    coms = np.array([0.1, 0, 0.7]) + 0.25 * np.sin(steps * [1.0, 1.3, 0.4])
    velocities = 0.4 * np.cos(steps * [1.0, 1.7, 2.1])
    coms[700:], velocities[700:] = rng.permutation(coms[700:]), rng.permutation(velocities[700:])
    rays = rays_of([contacts] * 1000) if own else jaxcap.cone_rays(contacts.padded(POINTS))
    cold = jaxcap.score(rays, coms, velocities)
    warm = jaxcap.score(rays, coms, velocities, neighbours=True)
    assert len(np.unique(cold.case)) > 3
    assert_consistent(jax.tree.map(np.asarray, cold), jax.tree.map(np.asarray, warm))


def test_padding_and_vmap_of_cone_rays():
    """`cone_rays` of a batch is that of each set; traced contacts give the same; padding is neutral."""
    contacts = [foot(0, 0.1) + foot(0.2, -0.2, 0.3), foot(0.1, 0.3, 0, rotation(0.1, 0, 0.3)) + foot(0, 0)]
    batched = jaxcap.cone_rays(stack(contacts))
    mapped = jax.jit(jax.vmap(jaxcap.cone_rays))(stack(contacts))
    for i, one in enumerate(contacts):
        alone = jaxcap.cone_rays(one)
        padded = jaxcap.cone_rays(one.padded(11))
        assert padded.rays.shape == (44, 6) and padded.mask.sum() == 32
        for field in ("rays", "mask", "origin", "length"):
            np.testing.assert_allclose(getattr(batched, field)[i], getattr(alone, field), atol=1e-15)
            np.testing.assert_allclose(getattr(mapped, field)[i], getattr(alone, field), atol=1e-15)
        np.testing.assert_allclose(padded.rays[:32], alone.rays, atol=1e-15)
        assert (padded.rays[32:] == 0).all()


def test_too_few_sides():
    with pytest.raises(ValueError, match="sides = 2"):
        jaxcap.cone_rays(foot(0, 0), sides=2)


def test_along_the_edge_of_the_support_all_is_decided():
    """By rays alone, however little a line turns from the edge that the CoM stands on: pivots are as small as that angle."""
    angles = 10.0 ** np.arange(-12, -9, 0.01)
    towards = np.array([[side * angle, along, 0] for angle in angles for side in (1, -1) for along in (1, -1)])
    soles = [jaxcap.rectangle([0, side * 0.1, 0], np.eye(3), 0.1, 0.05, 2.0) for side in (1, -1)]
    cones = stack([FORMS["rays"](soles[0] + soles[1])] * len(towards))
    found = each()(cones, np.tile([0.1, 0, 0.8], (len(towards), 1)), towards)
    assert (found.status == Status.OK).all()
