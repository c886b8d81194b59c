"""Surfaces and the candidates on them."""

import numpy as np
import pytest
from samplers import rotation

from jaxcap.contacts.surfaces import box, candidates_on, height_field, rail, surface

UP = np.eye(3)
WALL = rotation(0, -np.pi / 2, 0)


def test_a_grid_covers_the_surface_and_stays_on_it():
    found = candidates_on([surface([1, 2, 3], WALL, 0.5, 0.3, 0.7)], 0.1, 0.05, 0.1)
    assert len(found.centres) == 9 * 6
    local = (found.contacts.points.reshape(-1, 3) - [1, 2, 3]) @ WALL
    np.testing.assert_allclose(np.abs(local).max(axis=0), [0.5, 0.3, 0], atol=1e-12)
    steps = np.unique(np.round((found.centres - [1, 2, 3]) @ WALL, 9)[:, 0])
    np.testing.assert_allclose(np.diff(steps), 0.1)
    np.testing.assert_allclose(found.contacts.frames[..., 2], np.broadcast_to([-1, 0, 0], (54, 4, 3)), atol=1e-12)
    assert (found.contacts.friction == 0.7).all()


def test_a_rail_is_gripped_over_its_own_width():
    found = candidates_on([rail([0, 0, 1], [0, 0.6, 1], [0, 0, 1], 0.02, 0.6)], 0.05, 0.05, 0.25)
    np.testing.assert_allclose(found.centres, [[0, y, 1] for y in (0.05, 0.3, 0.55)])
    assert np.ptp(found.contacts.points[..., 0]) == pytest.approx(0.04)


def test_a_box_has_six_sides_that_face_outwards():
    sides = box([1, 0, 0], rotation(0.1, 0.2, 0.3), [0.3, 0.2, 0.1], 0.5)
    assert len(sides) == 6
    for side in sides:
        assert np.linalg.det(side.rotation) == pytest.approx(1)
        outwards = (side.position - [1, 0, 0]) @ side.rotation
        assert outwards[2] > 0 and np.abs(outwards[:2]).max() < 1e-12
    areas = sum(4 * side.half_length * side.half_width for side in sides)
    assert areas == pytest.approx(8 * (0.06 + 0.03 + 0.02))


def test_a_field_of_heights_that_is_a_plane_is_that_plane():
    """With slopes along both axes, and between its points."""
    x, y = np.meshgrid(0.1 * np.arange(11), 0.1 * np.arange(7), indexing="ij")
    found = candidates_on([height_field(0.3 * x - 0.2 * y, [1, 2, 3], 0.1, 0.7)], 0.12, 0.06, 0.07)
    height = lambda points: 3 + 0.3 * (points[..., 0] - 1) - 0.2 * (points[..., 1] - 2)
    np.testing.assert_allclose(found.centres[:, 2], height(found.centres), atol=1e-12)
    np.testing.assert_allclose(found.contacts.points[..., 2], height(found.contacts.points), atol=1e-12)
    normal = np.array([-0.3, 0.2, 1]) / np.sqrt(1.13)
    np.testing.assert_allclose(
        found.contacts.frames[..., 2], np.broadcast_to(normal, (len(found.centres), 4, 3)), atol=1e-12
    )
    low, high = found.centres[:, :2].min(axis=0), found.centres[:, :2].max(axis=0)
    np.testing.assert_allclose([low, high], [[1.12, 2.06], [1.88, 2.54]], atol=1e-12)
    assert (found.contacts.friction == 0.7).all()


def test_a_foot_is_flat_on_ground_that_is_not():
    """A ridge is passed through with the mean slope under the foot; a larger foot sees a step as less steep."""
    heights = np.repeat([[0.0], [0.0], [0.1], [0.1]], 4, axis=1)
    slope = {}
    for half in (0.05, 0.1):
        found = candidates_on([height_field(heights, [0, 0, 0], 0.1, 0.5)], half, 0.05, 0.01)
        at = np.argmin(np.abs(found.centres[:, 0] - 0.15))
        normal = found.contacts.frames[at, 0, :, 2]
        slope[half] = -normal[0] / normal[2]
        assert found.centres[at, 2] == pytest.approx(0.05) and normal[1] == 0
    assert slope[0.05] == pytest.approx(1) and slope[0.1] == pytest.approx(0.5)


def test_candidates_come_on_grids_row_by_row():
    """Each surface's; rows along its width."""
    field = height_field(np.zeros((3, 4)), [0, 5, 0], 0.5, 0.5)
    found = candidates_on([surface([0, 0, 0], UP, 0.3, 0.2, 0.5), field], 0.1, 0.1, 0.1)
    assert found.grids == ((5, 3), (9, 14))
    for owner, shape in enumerate(found.grids):
        x, y, _ = np.moveaxis(found.centres[found.surface == owner].reshape(*shape, 3), -1, 0)
        assert (np.ptp(x, axis=1) < 1e-12).all() and (np.diff(x[:, 0]) > 0).all()
        assert (np.ptp(y, axis=0) < 1e-12).all() and (np.diff(y[0]) > 0).all()


def test_surfaces_are_told_apart():
    found = candidates_on([surface([0, 0, 0], UP, 0.1, 0.1, 0.5), *box([1, 0, 0], UP, [0.1] * 3, 0.5)], 0.1, 0.1, 0.5)
    np.testing.assert_array_equal(found.surface, np.arange(7))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: surface([0, 0, 0], UP, 0, 0.1, 0.5), r"half_length = 0 \(expected a positive number of metres\)"),
        (lambda: surface([0, 0, 0], 2 * UP, 1, 0.1, 0.5), "is not a rotation"),
        (lambda: rail([0, 0, 0], [0, 0, 0], [0, 0, 1], 0.1, 0.5), "start, end are 0.0 m apart"),
        (lambda: rail([0, 0, 0], [1, 0, 0], [0, 0, 2], 0.1, 0.5), r"normal has length 2.000000 \(expected 1\)"),
        (lambda: rail([0, 0, 0], [1, 0, 0], [1, 0, 0], 0.1, 0.5), "along the rail"),
        (lambda: box([0, 0, 0], UP, [1, 0, 1], 0.5), "half_sizes"),
        (
            lambda: height_field([0, 1], [0, 0, 0], 0.1, 0.5),
            r"heights: int64 of shape \(2,\) \(expected numbers of shape \(nx",
        ),
        (lambda: height_field([[0, 1], [0, np.nan]], [0, 0, 0], 0.1, 0.5), r"heights\[1, 1\] = nan \(expected a finite"),
        (lambda: height_field(np.zeros((2, 2)), [0, 0], 0.1, 0.5), r"origin: int64 of shape \(2,\)"),
        (lambda: height_field(np.zeros((2, 2)), [0, 0, 0], 0, 0.5), r"spacing = 0 \(expected a positive number of metres\)"),
        (lambda: height_field(np.zeros((2, 2)), [0, 0, 0], 0.1, -1), r"friction = -1 \(expected a positive number\)"),
        (lambda: candidates_on([], 0.1, 0.1, 0.1), "surfaces: none"),
        (lambda: candidates_on([surface([0, 0, 0], UP, 1, 1, 0.5)], 0.1, 0.1, 0), "spacing = 0"),
    ],
)
def test_what_cannot_be_is_named(make, words):
    with pytest.raises(ValueError, match=words):
        make()
