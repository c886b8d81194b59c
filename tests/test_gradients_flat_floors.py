"""Derivatives in the contact points of floors, by rays: coplanar contacts with equal frames have many optimal bases."""

import jax
import numpy as np
import pytest

import jaxcap

pytestmark = pytest.mark.usefixtures("x64")
POINTS, SETS, STEP = 8, 240, 1e-6
LEVEL = np.tile(np.eye(3), (POINTS, 1, 1))
HEXAGON = (
    (0.00530609408, -0.06195326537, -0.07122364462),
    (0.00396986537, 0.41859177467, -0.00838195422),
    ((1.1, 1, 0.2), (1, 2, 2.5), (-0.4, -3, 0.9), (0.1, 0.9, -1.1), (-0.9, 1.6, 1.3), (1.3, -1.3, -0.2)),
)
"""CoM, its velocity, and how the points move: over point contacts with a radius of 0.3 m."""


def margin(points, mask, friction, com, velocity):
    rays = jaxcap.cone_rays(jaxcap.ContactSet.unchecked(points, LEVEL, friction, mask))
    return jaxcap.capturability(rays, com, velocity).margin


def moved(points, way, mask, *state):
    """How the margin moves as the points do."""
    return jax.jvp(lambda points: margin(points, mask, *state), (points,), (way,))[1]


def ring(count):
    turns = 2 * np.pi * np.arange(count) / count
    return 0.3 * np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=1)


def soles():
    corners = np.array([(0.1, 0.06, 0), (0.1, -0.06, 0), (-0.1, -0.06, 0), (-0.1, 0.06, 0)])
    aside = np.array((0, 0.1, 0))
    return np.concatenate([corners + aside, corners - aside])


def padded(rows):
    return np.concatenate([rows, np.zeros((POINTS - len(rows), 3))])


@pytest.fixture(scope="module")
def floors():
    """States above and below rings and soles of any friction, directions of their points, and the known hexagon first."""
    rng = np.random.default_rng(3)
    com, velocity, way = map(np.array, HEXAGON)
    rows = [(padded(ring(6)), padded(way), np.arange(POINTS) < 6, np.full(POINTS, 0.8414517274474085), com, velocity)]
    while len(rows) < SETS:
        points = soles() if len(rows) % 2 else ring(rng.integers(3, POINTS + 1))
        mask = np.arange(POINTS) < len(points)
        com = np.append(rng.normal(size=2) * 0.08, rng.choice([-1, 1]) * rng.uniform(0.03, 1))
        friction = np.full(POINTS, np.exp(rng.uniform(-1.5, 0.5)))
        way = rng.normal(size=(POINTS, 3)) * mask[:, None]
        rows.append((padded(points), way, mask, friction, com, rng.normal(size=3) * (0.4, 0.4, 0.05)))
    return tuple(map(np.array, zip(*rows, strict=True)))


def test_floors_have_one_derivative_where_both_sides_agree_and_else_one_between(floors):
    points, ways, *rest = floors
    with jax.enable_x64(True):
        value, found = jax.jit(jax.vmap(margin)), np.array(jax.jit(jax.vmap(moved))(*floors))
        at = lambda step: np.array(value(points + step * ways, *rest))
        ahead, behind = (at(STEP) - at(0)) / STEP, (at(0) - at(-STEP)) / STEP
    assert found[0] == pytest.approx(1.941072965, abs=1e-8)  # by central differences with steps of 1e-6
    far = 1e-3 * (1 + np.abs(ahead))
    smooth = np.abs(ahead - behind) < far
    assert SETS / 2 < smooth.sum() < SETS  # there are kinks, too
    least, most = np.minimum(ahead, behind), np.maximum(ahead, behind)
    outside = (found < least - far) | (found > most + far)
    assert not outside.any()
