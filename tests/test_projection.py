"""Rays to faces: the right faces for every kind of cone, and an error rather than wrong ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samplers import random_contacts, rotation
from scipy.optimize import linprog, nnls
from states import contact_set

import jaxcap
from jaxcap.contacts import projection
from jaxcap.contacts.friction import wrench_rays

UP = np.eye(3)
WIDE = rotation(np.pi / 2, 0, 0), rotation(-np.pi / 2, 0, 0)   # normals along -y, +y


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
        4, 6, 16,
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


@pytest.mark.parametrize("name", NAMED)
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


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.integers(0, 2**32 - 1), st.integers(2, 4), st.sampled_from([0, 1e-14, 1e-12, 1e-10, 1e-8, 1e-6, 1e-3]),
    st.sampled_from([1e-3, 1, 1e3]), st.sampled_from([0.01, 0.5, 10.0]),
)
def test_faces_of_nearly_degenerate_contacts(seed, count, tilt, distance, friction):
    """Feet that are coplanar up to a tilt, far or near: right faces, or a ProjectionError that says why."""
    rng = np.random.default_rng(seed)
    parts = [
        foot(distance * rng.integers(-2, 3, 3) * [1, 1, 0], friction, rotation(*(tilt * rng.normal(size=3))))
        for _ in range(count)
    ]
    contacts = sum(parts[1:], start=parts[0])
    try:
        cone = jaxcap.centroidal_cone(contacts)
    except projection.ProjectionError as error:
        assert "faces of" in str(error) and 0 < tilt <= 1e-6
    else:
        assert_same_cone(contacts, cone, 4, functionals=4)


def test_a_missing_face_is_an_error(monkeypatch):
    hull = projection._hull
    monkeypatch.setattr(projection, "_hull", lambda *arguments: tuple(part[1:] for part in hull(*arguments)))
    with pytest.raises(projection.ProjectionError, match=r"faces of 3 contacts with 4 sides: .* leave a gap"):
        jaxcap.centroidal_cone(NAMED["three points"][0])


def test_wrong_faces_are_an_error(monkeypatch):
    """Qhull that turns a facet: nothing wrong comes out."""
    hull = projection._hull

    def turned(*arguments):
        planes, simplices = hull(*arguments)
        return planes[::-1].copy(), simplices

    monkeypatch.setattr(projection, "_hull", turned)
    monkeypatch.setattr(projection, "HINT_REACH", (1e-6,))
    with pytest.raises(projection.ProjectionError, match=r"faces of 4 contacts with 4 sides: the cone is not closed"):
        jaxcap.centroidal_cone(foot([0, 0, 0]))


def test_no_contact_is_an_error():
    with pytest.raises(ValueError, match=r"none of 2 is active \(expected at least one\)"):
        jaxcap.centroidal_cone(jaxcap.ContactSet(np.zeros((2, 3)), UP, 0.5, mask=np.zeros(2, bool)))


def test_too_few_sides_are_an_error():
    with pytest.raises(ValueError, match=r"sides = 2 \(expected at least 3\)"):
        jaxcap.centroidal_cone(FEET, 2)


def test_faces_do_not_depend_on_the_order_of_contacts():
    swapped = foot([0, -0.1, 0]) + foot([0, 0.1, 0])
    np.testing.assert_allclose(jaxcap.centroidal_cone(FEET).faces, jaxcap.centroidal_cone(swapped).faces, atol=1e-9)
