"""The momentum box in faces: a polyhedron, checked against its vertices and rays, the reference, and by its laws."""

from itertools import pairwise, product

import jax
import numpy as np
import pytest
from samplers import random_contacts, random_state
from scipy.optimize import linprog
from states import TOGETHER, contact_set, stack

import jaxcap
from jaxcap import Case, Status
from jaxcap.contacts.friction import wrench_rays
from jaxcap.contacts.projection import boxed_faces, cone_faces
from reference import algorithm

pytestmark = pytest.mark.usefixtures("x64")
ROWS = 1100
"""At least as many faces as any of the cones with a box has."""
BOXES = (0.0, 0.05, 0.5)
"""[m^2/s^2]; 10 N m over 90 kg are 0.11."""
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
POINT = jaxcap.ContactSet(points=np.zeros((1, 3)), frames=np.eye(3)[None], friction=np.array([0.5]))
PAIR = jaxcap.ContactSet(points=[[0, 0.1, 0], [0, -0.1, 0]], frames=np.stack([np.eye(3)] * 2), friction=[0.5, 0.5])
PALM = jaxcap.rectangle([0, -0.3, 0.8], [[1, 0, 0], [0, 0, 1], [0, -1, 0]], 0.1, 0.05, 0.5)
PALMS = PALM + jaxcap.rectangle([0, 0.3, 0.8], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], 0.1, 0.05, 0.5)
FOOT = jaxcap.rectangle([0, 0.1, 0], np.eye(3), 0.1, 0.05, 0.5)
STANCES = {"point": POINT, "pair": PAIR, "foot": FOOT, "palms": PALMS}


def sampled():
    """Contacts, states and angular momenta, TOGETHER of each."""
    rng, contacts, states = np.random.default_rng(2), [], []
    for i in range(TOGETHER // 3):
        one = random_contacts(rng, 2 + i % 3)
        contacts += [one] * 3
        states += [random_state(rng, one[0]) for _ in range(3)]
    coms, velocities = (np.array(vectors) for vectors in zip(*states, strict=True))
    return contacts, coms, velocities, rng.normal(size=coms.shape) * 0.15


@pytest.fixture(scope="module")
def answers():
    """Of the sampled states with each box, and what the reference says."""
    contacts, *states = sampled()

    def one(cone, com, velocity, momentum):
        return jaxcap.capturability(cone, com, velocity, specific_angular_momentum=momentum)

    program, found = jax.jit(jax.vmap(one)), {}
    with jax.enable_x64(True):
        for box in BOXES:
            cones = [jaxcap.centroidal_cone(contact_set(*one), momentum_box=box).padded(ROWS) for one in contacts]
            found[box] = jax.tree.map(np.asarray, program(stack(cones), *states))
    return contacts, states, found


@pytest.mark.parametrize("box", BOXES[1:])
def test_verdict_and_case_of_the_reference(answers, box):
    contacts, states, found = answers
    paper = [
        algorithm.is_state_capturable(*one, com, velocity, swings=100, specific_angular_momentum=momentum, momentum_box=box)
        for one, com, velocity, momentum in zip(contacts, *states, strict=True)
    ]
    assert found[box].capturable.tolist() == [result.capturable for result in paper]
    known = found[box].case != Case.EMPTY
    assert (found[box].case == [Case[result.case] for result in paper])[known].all()
    assert 10 < found[box].capturable.sum() < TOGETHER - 10
    assert (found[box].status == Status.OK).all()


def test_a_larger_box_never_lowers_the_speeds(answers):
    _, _, found = answers
    for smaller, larger in pairwise(BOXES):
        assert (found[larger].max_speed >= found[smaller].max_speed - 1e-9).all()
        assert (found[larger].max_speed > found[smaller].max_speed + 1e-3).sum() > 5


def test_a_box_alone_has_no_effort():
    """Which is of joints: NaN by rays as by faces, of one state, of many, and in a program; the verdict is the same."""
    com, velocity = np.array([0, 0.1, 0.8]), np.array([0.3, 0, 0])
    rays, faces = jaxcap.cone_rays(FOOT), jaxcap.centroidal_cone(FOOT, momentum_box=0.3)
    one = lambda cone, **options: jaxcap.capturability(cone, com, velocity, **options)
    by_rays, by_faces = one(rays, momentum_box=0.3), one(faces)
    program = jax.jit(lambda: one(rays, momentum_box=0.3))()
    many = jaxcap.score(rays, com[None], velocity[None], momentum_box=0.3)
    for found in (by_rays, by_faces, program, many):
        assert np.isnan(found.effort).all()
        np.testing.assert_allclose(found.margin, by_faces.margin, rtol=1e-9)
        assert np.all(found.capturable == by_faces.capturable)


def test_at_rest_a_box_counts_by_rays_as_by_faces():
    """Beyond the edge of the sole, where the limbs alone hold the robot: 0.3 / 9.81 m farther."""
    x = np.array([-0.12, 0, 0.09, 0.11, 0.13, 0.132, 0.2])
    coms, still = np.stack([x, 0.1 + 0 * x, 0.8 + 0 * x], axis=1), np.zeros((len(x), 3))
    by_rays = jaxcap.score(jaxcap.cone_rays(FOOT), coms, still, momentum_box=0.3)
    by_faces = jaxcap.score(jaxcap.centroidal_cone(FOOT, momentum_box=0.3), coms, still)
    stands = (np.abs(x) < 0.1 + 0.3 / 9.81).tolist()
    assert stands == by_rays.capturable.tolist() == by_faces.capturable.tolist()
    assert by_rays.case.tolist() == by_faces.case.tolist() == [Case.C3_1 if one else Case.EMPTY for one in stands]


def test_no_box_is_today_to_the_bit():
    for contacts in STANCES.values():
        one, other = jaxcap.centroidal_cone(contacts), jaxcap.centroidal_cone(contacts, momentum_box=0.0)
        assert one.offsets is None and other.offsets is None
        np.testing.assert_array_equal(one.faces, other.faces)


def scaled_rays(contacts, cone):
    """The rays of the contacts, torques over the size of the stance."""
    length = float(cone.length)
    return np.asarray(wrench_rays(contacts, 4, cone.origin)) / np.array([1, 1, 1, length, length, length])


@pytest.mark.parametrize("stance", STANCES)
def test_the_polyhedron_is_the_sum_of_cone_and_box(stance):
    """By linear programs: a wrench is within the faces if and only if rays and a corner's share of the box make it up."""
    contacts, box = STANCES[stance], 0.3
    cone = jaxcap.centroidal_cone(contacts, momentum_box=box)
    assert (cone.offsets >= 0).all()
    length = float(cone.length)
    scale = np.array([1, 1, 1, length, length, length])
    rays, normals = scaled_rays(contacts, cone), cone.faces * scale
    size = np.linalg.norm(normals, axis=1)
    np.testing.assert_allclose(size, 1, atol=1e-9)
    rng = np.random.default_rng(0)
    most = 0.0
    for _ in range(60):
        weights = rng.exponential(size=len(rays)) * (rng.random(len(rays)) < 4 / len(rays))
        corner = CORNERS[rng.integers(8)] * box / length
        inside = weights @ rays + np.concatenate([np.zeros(3), corner])
        assert (normals @ inside <= cone.offsets + 1e-9).all()
        outside = inside + rng.normal(size=6)
        within = (normals @ outside <= cone.offsets).all()
        # distance, in the largest component of torque and force, of the wrench from the sum
        matrix = np.column_stack([rays.T, np.eye(6)[:, 3:], np.eye(6), -np.eye(6)])
        bounds = [(0, None)] * len(rays) + [(-box / length, box / length)] * 3 + [(0, None)] * 12
        found = linprog(
            np.r_[np.zeros(len(rays) + 3), np.ones(12)], A_eq=matrix, b_eq=outside, bounds=bounds, method="highs"
        )
        assert within == (found.fun < 1e-7) or abs(found.fun) < 1e-5
        most = max(most, found.fun)
    assert most > 0.1 or stance == "palms"


def test_the_normals_of_the_cone_are_among_those_with_a_box():
    rays = scaled_rays(FOOT, jaxcap.centroidal_cone(FOOT))
    boxed, plain = boxed_faces(rays), cone_faces(rays)
    assert (boxed @ rays.T).max() < 1e-9
    assert np.linalg.norm(plain[:, None] - boxed[None], axis=-1).min(axis=1).max() < 1e-7
    assert len(boxed) > len(plain)
    everything = scaled_rays(PALMS, jaxcap.centroidal_cone(PALMS))
    assert len(boxed_faces(everything)) == len(cone_faces(everything)) == 0


def test_standing_is_the_support_polygon():
    """By hand: a box of torque moves the edges of the support polygon out by box / gravity."""
    cone = jaxcap.centroidal_cone(FOOT, momentum_box=0.981)
    vertices = jaxcap.support_polygon(cone).vertices
    np.testing.assert_allclose(np.sort(np.unique(np.round(vertices[:, 0], 9))), [-0.2, 0.2], atol=1e-9)
    np.testing.assert_allclose(np.sort(np.unique(np.round(vertices[:, 1], 9))), [-0.05, 0.25], atol=1e-9)
    for x, stands in ((0.19, True), (0.21, False)):
        answer = jaxcap.capturability(cone, np.array([x, 0.1, 0.8]), np.zeros(3))
        assert bool(answer.capturable) == stands and answer.status == Status.NO_DIRECTION


def test_score_and_com_area_take_the_box():
    cone, small = jaxcap.centroidal_cone(FOOT, momentum_box=0.2), jaxcap.centroidal_cone(FOOT)
    rng = np.random.default_rng(3)
    coms, velocities = rng.uniform([-0.1, 0, 0.7], [0.1, 0.2, 0.9], (70, 3)), rng.uniform(-0.5, 0.5, (70, 3))
    found, without = jaxcap.score(cone, coms, velocities), jaxcap.score(small, coms, velocities)
    one = jax.jit(jax.vmap(lambda com, velocity: jaxcap.capturability(cone, com, velocity)))(coms, velocities)
    np.testing.assert_allclose(found.max_speed, one.max_speed, rtol=1e-9)
    assert (np.asarray(found.max_speed) >= without.max_speed).all()
    velocity = np.array([0.2, 0.0, 0.0])
    areas = [jaxcap.com_area(each, velocity, 0.8, lines=8).size() for each in (small, cone)]
    assert areas[0] < areas[1]


def test_one_state_takes_the_box_by_rays():
    """The answer of the faces with that box."""
    faces, rays = jaxcap.centroidal_cone(FOOT, momentum_box=0.2), jaxcap.cone_rays(FOOT)
    rng = np.random.default_rng(5)
    for _ in range(5):
        state = rng.uniform([-0.1, 0, 0.7], [0.1, 0.2, 0.9]), rng.uniform(-0.5, 0.5, 3)
        ours, theirs = jaxcap.capturability(rays, *state, momentum_box=0.2), jaxcap.capturability(faces, *state)
        assert ours.capturable == theirs.capturable
        np.testing.assert_allclose(ours.max_speed, theirs.max_speed, rtol=1e-6)
    with pytest.raises(TypeError, match="the robot's limits need the rays"):
        jaxcap.capturability(faces, *state, momentum_box=0.2)
    with pytest.raises(ValueError, match="momentum_box = -1"):
        jaxcap.capturability(rays, *state, momentum_box=-1.0)


@pytest.mark.parametrize("box", [-1.0, np.nan, np.inf, [0.1, 0.1, 0.1]])
def test_boxes_that_are_none(box):
    with pytest.raises(ValueError, match=r"momentum_box = .* \(expected a number of m\^2/s\^2, not negative\)"):
        jaxcap.centroidal_cone(FOOT, momentum_box=box)


def test_an_offset_that_is_not_finite_marks_the_state():
    cone = jaxcap.centroidal_cone(FOOT, momentum_box=0.2)
    spoilt = cone._replace(offsets=np.where(np.arange(len(cone.faces)) == 3, np.nan, cone.offsets))
    found = jaxcap.capturability(spoilt, np.array([0, 0.1, 0.8]), np.array([0.1, 0, 0]))
    assert found.status == Status.NONFINITE and not found.capturable
