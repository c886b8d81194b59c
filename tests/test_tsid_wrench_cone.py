"""The 16-row wrench cone of a rectangle is its four friction pyramids; static equilibrium on several rectangles."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import nnls

import reference.tsid.wrench_cone as wrench_cone_module
from reference.contacts import wrench_rays
from reference.tsid.robot import Contact
from reference.tsid.wrench_cone import corner_points, equilibrium, wrench_cone

SHAPES = [(0.105, 0.065, 0.5), (0.034, 0.023, 0.5), (0.02, 0.3, 0.05), (1.0, 1.0, 1.5)]


def contact(half_length=0.105, half_width=0.065, friction=0.5, placement=None):
    return Contact("foot", placement or pin.SE3.Identity(), half_length, half_width, friction)


def corner_rays(half_length, half_width, friction):
    """(6, 16): the pyramids' edges at the corners, as wrenches about the centre."""
    points = corner_points(contact(half_length, half_width, friction))
    rays, origin = wrench_rays(points, np.repeat(np.eye(3)[None], 4, axis=0), np.full(4, friction))[:2]
    np.testing.assert_allclose(origin, 0.0, atol=1e-15)
    return rays


@pytest.mark.parametrize("shape", SHAPES)
def test_the_cone_is_the_span_of_the_corner_edges(shape):
    rng = np.random.default_rng(1)
    cone, rays = wrench_cone(*shape), corner_rays(*shape)
    assert cone.shape == (16, 6)
    assert np.max(cone @ rays) < 1e-12
    scale = np.abs(rays).max(axis=1)
    inside = 0
    for spread in rng.uniform(0.1, 0.9, 400):  # around the axis, both sides of the boundary
        wrench = scale * np.array([0, 0, 1, 0, 0, 0]) + spread * scale * rng.uniform(-1, 1, 6)
        slack = np.max(cone @ (wrench / scale[2]))
        residual = nnls(rays / scale[:, None], wrench / scale, maxiter=1000)[1]
        assert (residual < 1e-9) == (slack < 1e-9), (slack, residual)
        inside += slack < 1e-9
    assert 40 < inside < 360


@pytest.mark.parametrize("shape", SHAPES)
def test_every_row_is_a_face(shape):
    """Each of the 16 rows is reached by five independent edges: none is redundant, none is too tight."""
    cone, rays = wrench_cone(*shape), corner_rays(*shape)
    for row in cone:
        assert np.linalg.matrix_rank(rays[:, np.abs(row @ rays) < 1e-12], tol=1e-9) == 5


def test_the_pyramid_is_inscribed_in_the_cone():
    rays = corner_rays(0.1, 0.05, 0.5)
    np.testing.assert_allclose(np.hypot(rays[0], rays[1]), 0.5 * rays[2])
    np.testing.assert_allclose(np.abs(rays[0]), 0.5 / np.sqrt(2) * rays[2])


def test_one_flat_foot_holds_exactly_what_is_above_it():
    flat = [contact()]
    for x, y, held in [(0.1049, 0.0649, True), (0.1051, 0.0, False), (0.0, -0.0651, False), (-0.1, -0.06, True)]:
        assert equilibrium(flat, np.array([x, y, 0.9])) is held


@pytest.mark.parametrize("angle, held", [(0.999, True), (1.001, False)])
def test_one_tilted_foot_holds_until_its_pyramid_is_vertical(angle, held):
    """Tilted about its first tangent, gravity leaves the pyramid where tan(angle) = mu / sqrt(2)."""
    tilt = pin.SE3(pin.exp3(np.array([angle * np.arctan(0.5 / np.sqrt(2)), 0, 0])), np.array([1.0, 2.0, 0.5]))
    assert equilibrium([contact(placement=tilt)], np.array([1.0, 2.0, 1.5])) is held


def test_equilibrium_does_not_depend_on_the_frame():
    rng = np.random.default_rng(2)
    agreed = set()
    for _ in range(20):
        moved = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        placements = [pin.SE3(pin.exp3(0.4 * rng.normal(size=3)), rng.normal(size=3) * 0.3) for _ in range(2)]
        com, gravity = rng.normal(size=3) * 0.1, np.array([0, 0, -9.81])
        here = equilibrium([contact(placement=p) for p in placements], com, gravity)
        there = equilibrium([contact(placement=moved * p) for p in placements], moved.act(com), moved.rotation @ gravity)
        assert here == there
        agreed.add(here)
    assert agreed == {True, False}


@pytest.mark.parametrize(
    "name, shape", [("half_length", (0, 1, 1)), ("half_width", (1, -1, 1)), ("friction", (1, 1, np.nan))]
)
def test_bad_shapes_are_named(name, shape):
    with pytest.raises(ValueError, match=f"{name} = .* \\(expected a positive number\\)"):
        wrench_cone(*shape)


def test_least_squares_and_the_linear_program_say_the_same(monkeypatch):
    """Near the edge of what a foot holds and far from it: least squares decide nearly all, and as the program does."""
    rng = np.random.default_rng(4)
    flat = [contact(), contact(placement=pin.SE3(np.eye(3), np.array([0.0, 0.2, 0.0])))]
    proved, found, cases = wrench_cone_module._proved, [], []
    monkeypatch.setattr(wrench_cone_module, "_proved", lambda *given: found.append(proved(*given)))  # returns None
    for _ in range(60):
        cases.append(equilibrium(flat, rng.uniform([-0.12, -0.1, 0.8], [0.12, 0.3, 0.9])))
    decided = [(one, other) for one, other in zip(found, cases, strict=True) if one is not None]
    assert len(decided) > 50 and all(one == other for one, other in decided) and {True, False} == set(cases)
