"""Rays to faces: laws, the right faces for every kind of cone, and an error rather than wrong ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samplers import random_contacts, rotation
from scipy.optimize import linprog, nnls
from states import contact_set

import jaxcap
from bench.fuzz_kinds import draw
from bench.projection_kinds import KINDS, sample
from jaxcap.contacts import cone_hull, lines, projection, rationals
from jaxcap.contacts.friction import wrench_rays

UP = np.eye(3)
WIDE = rotation(np.pi / 2, 0, 0), rotation(-np.pi / 2, 0, 0)  # normals along -y, +y


def foot(position, friction=0.5, frame=UP, half_length=0.1, half_width=0.07):
    return jaxcap.rectangle(position, frame, half_length, half_width, friction)


def points(*positions, frames=UP, friction=0.5):
    return jaxcap.ContactSet(np.array(positions, float), frames, friction)


FEET = foot([0, 0.1, 0]) + foot([0, -0.1, 0])
PALMS = foot([0, 0.2, 1], frame=WIDE[0]) + foot([0, -0.2, 1], frame=WIDE[1])
# name: contacts, sides, rank of the cone, faces that are not equalities
NAMED = {
    "one point": (points([0.3, 0.1, 0]), 4, 3, 4),
    "one point, three sides": (points([0, 0, 0]), 3, 3, 3),
    "one point 1 km away": (points([1000, 1000, 0]), 4, 3, 4),
    "two points": (points([0, 0, 0], [1, 0, 0]), 4, 5, 6),
    "two points aslant": (points([0, 0, 0], [1, 0.3, 0.2]), 4, 5, None),
    "three collinear points": (points([0, 0, 0], [0.5, 0, 0], [1, 0, 0]), 4, 5, 6),
    "three points": (points([0, 0, 0], [0.5, 0.1, 0], [1, 0, 0]), 4, 6, None),
    "opposing palms": (PALMS, 4, 6, 0),
    "opposing palms and a foot": (PALMS + foot([0, 0, 0]), 4, 6, 0),
    "opposing points": (points([0, 0.2, 1], [0, -0.2, 1], frames=np.array(WIDE)), 4, 5, 0),
    "opposing points without grip": (points([0, 0.2, 1], [0, -0.2, 1], frames=np.array(WIDE[::-1])), 4, 5, None),
    "coplanar feet": (FEET, 4, 6, 16),
    "the same foot twice": (FEET + foot([0, 0.1, 0]), 4, 6, 16),
    "a foot with a point on its edge": (FEET + points([0.05, 0.17, 0]), 4, 6, 16),
    "coplanar feet, slippery": (foot([0, 0.1, 0], 0.01) + foot([0, -0.1, 0], 0.01), 4, 6, 16),
    "coplanar feet, sticky": (foot([0, 0.1, 0], 10.0) + foot([0, -0.1, 0], 10.0), 4, 6, 16),
    "coplanar feet, mixed friction": (foot([0, 0.1, 0], 0.01) + foot([0, -0.1, 0], 10.0), 4, 6, None),
    "coplanar feet 1 km away": (foot([1000, 1000.1, 0]) + foot([1000, 999.9, 0]), 4, 6, 16),
    "contacts 1 mm apart": (
        foot([0, 5e-4, 0], half_length=2e-4, half_width=2e-4) + foot([0, -5e-4, 0], half_length=2e-4, half_width=2e-4),
        4,
        6,
        16,
    ),
    "contacts 1 mm and 1 m apart": (FEET + points([0, 1.0, 0], [0, 1.001, 0]), 4, 6, None),
    "three sides": (FEET, 3, 6, None),
    "eight sides": (FEET, 8, 6, None),
    "sixteen sides": (FEET, 16, 6, None),
}


def scaled(contacts, cone, sides):
    """Rays and faces in the units in which both have length one."""
    units = np.array([1, 1, 1, cone.length, cone.length, cone.length])
    rays = wrench_rays(contacts, sides, cone.origin) / units
    rays = rays[np.linalg.norm(rays, axis=1) > 0]
    return rays / np.linalg.norm(rays, axis=1, keepdims=True), cone.faces * units


def assert_same_cone(contacts, cone, sides, functionals=12):
    """Rays within the faces; and the farthest points within the faces, in seeded directions, spanned by the rays."""
    rays, faces = scaled(contacts, cone, sides)
    assert (faces @ rays.T).max(initial=-1) < 1e-9
    np.testing.assert_allclose(np.linalg.norm(faces, axis=1), 1, rtol=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(functionals):
        bounds = {"A_ub": faces, "b_ub": np.zeros(len(faces))} if len(faces) else {}
        farthest = linprog(-rng.normal(size=6), bounds=[(-1, 1)] * 6, **bounds).x
        assert nnls(rays.T, farthest)[1] < 1e-7


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == "sixteen sides" else name for name in NAMED]
)
def test_faces_of_named_cones(name):
    contacts, sides, rank, proper = NAMED[name]
    cone = jaxcap.centroidal_cone(contacts, sides)
    assert_same_cone(contacts, cone, sides)
    equalities = [any(np.allclose(face, -other, atol=1e-9) for other in cone.faces) for face in cone.faces]
    assert sum(equalities) == 2 * (6 - rank)
    if proper is not None:
        assert len(cone.faces) - sum(equalities) == proper


@pytest.mark.parametrize("count", [2, 3, 4])
def test_faces_of_random_contacts(count):
    rng = np.random.default_rng(count)
    for sides in (3, 4, 8):
        contacts = contact_set(*random_contacts(rng, count))
        assert_same_cone(contacts, jaxcap.centroidal_cone(contacts, sides), sides)


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(2, 4),
    st.sampled_from([0, 1e-14, 1e-12, 1e-10, 1e-8, 1e-6, 1e-3]),
    st.sampled_from([1e-3, 1, 1e3]),
    st.sampled_from([0.01, 0.5, 10.0]),
)
def test_faces_of_nearly_degenerate_contacts(seed, count, tilt, distance, friction):
    """Feet that are coplanar up to a tilt, far or near: right faces, always."""
    rng = np.random.default_rng(seed)
    parts = [
        foot(distance * rng.integers(-2, 3, 3) * [1, 1, 0], friction, rotation(*(tilt * rng.normal(size=3))))
        for _ in range(count)
    ]
    contacts = sum(parts[1:], start=parts[0])
    assert_same_cone(contacts, jaxcap.centroidal_cone(contacts), 4, functionals=4)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "touching edges"])
def test_no_contact_set_is_refused(kind):
    """Walls, ladders, rails, near-flat soles, 3 to 16 sides, both precisions: as in `bench.projection`, other seeds."""
    for number in range(6):
        contacts, sides, _ = sample(kind, 77, number)
        assert_same_cone(contacts, jaxcap.centroidal_cone(contacts, sides), sides, functionals=2)


def test_soles_given_in_single_precision():
    """Rounding makes faces nearly coplanar: eight contacts of eight sides, and soles that are parallel but for rounding."""
    rng = np.random.default_rng(8)
    single = lambda arrays: contact_set(*(x.astype(np.float32) for x in arrays))
    for _ in range(10):
        contacts = single(random_contacts(rng, 2))
        assert_same_cone(contacts, jaxcap.centroidal_cone(contacts, 8), 8, functionals=2)
        yaw = rotation(0, 0, rng.uniform(-3, 3))
        flat = FEET + foot([*rng.uniform(-1, 1, 2), 0], frame=rotation(0, 0, 0.3))
        contacts = single((flat.points @ yaw.T, yaw @ flat.frames, flat.friction))
        assert_same_cone(contacts, jaxcap.centroidal_cone(contacts), 4, functionals=2)


# laws


def unit_faces(cone):
    """In the order of their values, so that two cones can be compared."""
    faces = cone.faces * np.array([1, 1, 1, cone.length, cone.length, cone.length])
    return faces[np.lexsort(np.round(faces, 6).T)]


def wrenches(contacts, rng, size):
    """Random ones about the origin, some of which the contacts can give: combinations of rays, and noise."""
    rays = wrench_rays(contacts, 4, np.zeros(3))
    weights = rng.exponential(size=(size, len(rays))) * (rng.random((size, len(rays))) < 0.1)
    return weights @ rays + rng.normal(size=(size, 6)) * 10 ** rng.uniform(-3, 0.5, (size, 1))


def violated(cone, about_zero):
    """How far wrenches about the world's origin stand out of the cone."""
    force, torque = about_zero[:, :3], about_zero[:, 3:] - np.cross(cone.origin, about_zero[:, :3])
    return (np.concatenate([force, torque], axis=1) @ cone.faces.T).max(axis=1, initial=-1)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_another_contact_removes_no_wrench(count):
    rng = np.random.default_rng(20 + count)
    for _ in range(8):
        contacts = contact_set(*random_contacts(rng, count))
        more = contacts + foot(rng.uniform(-0.5, 0.5, 3), frame=rotation(*rng.uniform(-1, 1, 3)))
        few, many = jaxcap.centroidal_cone(contacts), jaxcap.centroidal_cone(more)
        tried = wrenches(contacts, rng, 200)
        can, could = violated(few, tried) < -1e-9, violated(many, tried) < 1e-9
        assert can.any() and not can.all()
        assert could[can].all()
        # the rays of the contacts that stay
        rays = wrench_rays(contacts, 4, many.origin)
        assert (many.faces @ rays.T).max(initial=-1) < 1e-9


@pytest.mark.parametrize("count", [1, 2, 3])
def test_faces_do_not_change_with_scale_and_shift(count):
    rng = np.random.default_rng(30 + count)
    points_, frames, friction = random_contacts(rng, count)
    faces = unit_faces(jaxcap.centroidal_cone(contact_set(points_, frames, friction)))
    for scale, shift in ((1e-3, 0), (1e3, 0), (1, rng.normal(size=3)), (0.37, 100 * rng.normal(size=3))):
        moved = jaxcap.centroidal_cone(contact_set(scale * points_ + shift, frames, friction))
        np.testing.assert_allclose(unit_faces(moved), faces, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_verdicts_turn_with_the_world(count):
    rng = np.random.default_rng(40 + count)
    points_, frames, friction = random_contacts(rng, count)
    turn = rotation(*rng.uniform(-3, 3, 3))
    cone = jaxcap.centroidal_cone(contact_set(points_, frames, friction))
    turned = jaxcap.centroidal_cone(contact_set(points_ @ turn.T, turn @ frames, friction))
    tried = wrenches(contact_set(points_, frames, friction), rng, 300)
    there = np.concatenate([tried[:, :3] @ turn.T, tried[:, 3:] @ turn.T], axis=1)
    np.testing.assert_allclose(violated(turned, there), violated(cone, tried), atol=1e-8)


@pytest.mark.parametrize("kind", ["soles", "quadruped", "opposite walls", "rails", "near a line", "round numbers"])
def test_faces_say_what_linear_programs_say(kind):
    """Of wrenches that are clearly in or out: can non-negative multiples of the rays give it?"""
    rng, inside, outside = np.random.default_rng(50), 0, 0
    for number in range(6):
        contacts, sides, _ = sample(kind, 5, number)
        rays, faces = scaled(contacts, jaxcap.centroidal_cone(contacts, sides), sides)
        tried = rng.exponential(size=(12, len(rays))) * (rng.random((12, len(rays))) < 0.05) @ rays
        tried += rng.normal(size=tried.shape) * 10 ** rng.uniform(-2, 1, (12, 1))
        for wrench in tried / np.linalg.norm(tried, axis=1, keepdims=True):
            out = (faces @ wrench).max(initial=-1)
            if abs(out) > 1e-5:
                program = linprog(np.zeros(len(rays)), A_eq=rays.T, b_eq=wrench, method="highs-ds")
                assert (program.status == 0) == (out < 0), (number, out)
                inside, outside = inside + (out < 0), outside + (out > 0)
    assert inside and (outside or kind == "opposite walls")


# the check


def test_a_missing_simplex_is_an_error(monkeypatch):
    hull = cone_hull._hull
    monkeypatch.setattr(cone_hull, "_hull", lambda *arguments: cone_hull.Simplices(*(x[1:] for x in hull(*arguments))))
    with pytest.raises(projection.ProjectionError, match=r"faces of 3 contacts with 4 sides: .* leave a gap"):
        jaxcap.centroidal_cone(NAMED["three points"][0])


def test_twice_around_is_an_error(monkeypatch):
    hull = cone_hull._hull
    twice = lambda *arguments: cone_hull.Simplices(*(np.concatenate([x, x]) for x in hull(*arguments)))
    monkeypatch.setattr(cone_hull, "_hull", twice)
    with pytest.raises(projection.ProjectionError, match=r"simplices do not go around it once"):
        jaxcap.centroidal_cone(NAMED["three points"][0])


def test_wrong_faces_are_an_error(monkeypatch):
    """Qhull that mixes its facets up: nothing wrong comes out."""
    hull = cone_hull._hull

    def mixed(*arguments):
        planes, corners = hull(*arguments)
        return cone_hull.Simplices(planes[::-1].copy(), corners)

    monkeypatch.setattr(cone_hull, "_hull", mixed)
    monkeypatch.setattr(cone_hull, "REFINEMENTS", 0)
    with pytest.raises(projection.ProjectionError, match=r"faces of 4 contacts with 4 sides: "):
        jaxcap.centroidal_cone(foot([0, 0, 0]))


@pytest.mark.parametrize("missing", range(0, 16, 3))
def test_a_missing_face_is_an_error(monkeypatch, missing):
    """The surface is closed, one face is not there: its simplices lie on no other face."""
    needed = cone_hull._needed

    def fewer(*arguments):
        kept, owner = needed(*arguments)
        return np.delete(kept, missing), np.where(owner == missing, 0, owner - (owner > missing))

    monkeypatch.setattr(cone_hull, "_needed", fewer)
    monkeypatch.setattr(projection, "QHULL_OPTIONS", ("Qt",))  # joggled points have more faces than are needed
    with pytest.raises(projection.ProjectionError, match=r"is not closed: its faces make it .* larger \(at most 1e-06\)"):
        jaxcap.centroidal_cone(foot([0, 0, 0]))


def test_a_line_that_is_not_there_is_an_error(monkeypatch):
    """Were the edges of a steep pyramid taken for opposites, the cone would be a half-space or more."""
    monkeypatch.setattr(projection, "ATTEMPTS", (projection.Attempt(0.9, 1e-11),))
    with pytest.raises(projection.ProjectionError, match=r"a line is .* from the cone \(at most 1e-06\)"):
        jaxcap.centroidal_cone(foot([0, 0, 0], friction=3.0))


def test_lines_in_the_cone_are_found():
    """Palms that press against each other hold any wrench; opposed points all but a torque about their axis."""
    for name, expected in (("opposing palms", 6), ("opposing points", 5), ("coplanar feet", 0)):
        contacts, sides, *_ = NAMED[name]
        rays = scaled(contacts, jaxcap.centroidal_cone(contacts, sides), sides)[0]
        span, _ = lines.split(rays, np.eye(6))
        found = lines.parts(rays, span, *projection.ATTEMPTS[0])
        assert len(found.lines) == expected
        assert lines.distance_of_parts(rays, found, 1e-6) < 1e-12


def test_no_contact_is_an_error():
    with pytest.raises(ValueError, match=r"none of 2 is active \(expected at least one\)"):
        jaxcap.centroidal_cone(jaxcap.ContactSet(np.zeros((2, 3)), UP, 0.5, mask=np.zeros(2, bool)))


def test_too_few_sides_are_an_error():
    with pytest.raises(ValueError, match=r"sides = 2 \(expected at least 3\)"):
        jaxcap.centroidal_cone(FEET, 2)


def test_faces_do_not_depend_on_the_order_of_contacts():
    swapped = foot([0, -0.1, 0]) + foot([0, 0.1, 0])
    np.testing.assert_allclose(jaxcap.centroidal_cone(FEET).faces, jaxcap.centroidal_cone(swapped).faces, atol=1e-9)


def test_the_exact_program_says_what_least_squares_say():
    rng = np.random.default_rng(60)
    rays = scaled(FEET, jaxcap.centroidal_cone(FEET), 4)[0]
    for _ in range(6):
        inside = rng.exponential(size=len(rays)) @ rays
        assert rationals.distance(rays, inside) < 1e-15
        outside = rng.normal(size=6) - 3 * rays.mean(axis=0)
        nearest = nnls(rays.T, outside)[1]
        assert nearest <= rationals.distance(rays, outside) <= np.sqrt(6) * nearest + 1e-12


def test_the_exact_program_sees_what_only_large_weights_show():
    """Three rays that nearly oppose each other hold the plane, with weights of 1e12."""
    rays = np.array([[1, 0], [-1, 1e-12], [-1, -1e-12]])
    assert rationals.distance(rays, np.array([0.3, -0.7])) == 0
    assert rationals.distance(rays[:2], np.array([0.3, -0.7])) == 0.7


def test_fists_around_a_rail_given_in_single_precision():
    """Opposed contacts on one line but for rounding: what torque they hold about it is a matter of weights of 1e8."""
    contacts, sides, single = sample("rails", 0, 180)
    assert single and len(contacts) == 6
    cone = jaxcap.centroidal_cone(contacts, sides)
    rays, faces = scaled(contacts, cone, sides)
    assert (faces @ rays.T).max(initial=-1) < 1e-10
    for wrench in np.random.default_rng(0).normal(size=(5, 6)):
        if (faces @ wrench).max(initial=-1) < 0:
            assert rationals.distance(rays, wrench) < 1e-6


def test_two_soles_of_a_slope_whose_shortest_combination_has_weights_of_rounding():
    """Two weights of 1e-16 beside four of a quarter: those rays take no part, and say nothing of where a plane cuts all."""
    drawn = draw(2611, 397, "slope", 64)
    contacts = contact_set(drawn.points, drawn.frames, drawn.friction)
    assert_same_cone(contacts, jaxcap.centroidal_cone(contacts, drawn.sides), drawn.sides, functionals=4)
