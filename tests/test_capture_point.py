"""Capture point, support polygon, hull of the contact points: laws first, then linear programs, then special cases."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import random_contacts, rotation
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from states import contact_set, stack

import jaxcap
from bench.fuzz_kinds import draw
from jaxcap.regions.capture_point import height_above_contacts
from jaxcap.regions.plane import across
from reference.contacts import wrench_rays

pytestmark = pytest.mark.usefixtures("x64")
UP, G = np.eye(3), 9.81
SETS, POINTS, SIZE, SEED = 48, 6, 16, 41
HEIGHTS = np.tile([0.4, 0.7, 1.2, 0.5, 0.6, 1.0], (2, 1))


def foot(x, y, z=0.0, frame=UP, friction=0.5):
    return jaxcap.rectangle([x, y, z], frame, 0.1, 0.05, friction)


def points(*positions, frames=UP, friction=0.5):
    return jaxcap.ContactSet(np.array(positions, float), frames, friction)


def hidden(contacts):
    return jaxcap.ContactSet(contacts.points, contacts.frames, contacts.friction, np.zeros(len(contacts), bool))


def facing(y, sign):
    """The frame of a palm at y on a wall; its normal is along sign * y."""
    return rotation(-sign * np.pi / 2, 0, 0)


FEET = foot(0, 0.1) + foot(0, -0.1)
PALMS = foot(0, 0.3, 1, facing(0.3, -1)) + foot(0, -0.3, 1, facing(-0.3, 1))
NAMED = {
    "one point": points([0.1, 0.2, 0]),
    "two points": points([-0.2, 0.1, 0], [0.2, -0.1, 0.1]),
    "three collinear points": points([-0.2, 0, 0], [0.05, 0, 0], [0.2, 0, 0]),
    "the same point twice": points([0, 0, 0], [0, 0, 0], [0.3, 0, 0]),
    "coplanar feet": FEET,
    "feet on a slope": foot(0, 0.2, 0, rotation(0.3, 0, 0)) + foot(0, -0.2, 0, rotation(0.3, 0, 0)),
    "a steep wall": foot(0, 0, 0, rotation(0, 1.4, 0)),
    "on a ceiling": foot(0, 0.1, 2, rotation(np.pi, 0, 0)),
    "opposing palms": PALMS,
    "opposing points": points([0, -0.2, 1], frames=facing(-0.2, 1)) + points([0, 0.2, 1], frames=facing(0.2, -1)),
    "masked out in the middle": foot(0, 0.1) + hidden(foot(0.5, 0.5, 1)) + foot(0.3, -0.1, 0.2, rotation(0.2, -0.3, 0)),
    "almost the same frames": foot(0, 0.1, 0, rotation(1e-8, 0, 0)) + foot(0.3, -0.1, 0, rotation(0, 2e-8, 0.4)),
}
EMPTY, PLANE = {"a steep wall", "on a ceiling"}, {"opposing palms"}


def sets():
    """Random sets of two to four rectangles, and the named ones."""
    rng = np.random.default_rng(SEED)
    return [contact_set(*random_contacts(rng, 2 + i % 3)) for i in range(SETS)] + list(NAMED.values())


def rays_of(contacts):
    """One batched ConeRays for a list of contact sets, all of one size: compiled once."""
    return jaxcap.cone_rays(stack([one.padded(SIZE) for one in contacts]))


def distance_by_rays(contacts, at):
    """Of points (n, 2), n a multiple of POINTS, to the polygon of one set, by rays: as many rows and points as elsewhere."""
    at = at.reshape(-1, POINTS, 2)
    return jaxcap.support_distance(rays_of([contacts] * len(at)), at).reshape(-1)


@pytest.fixture(scope="module")
def batch():
    """Sets, as many random points around each, their distances by faces and by rays, and the polygons."""
    rng, contacts = np.random.default_rng(SEED + 1), sets()
    where = rng.uniform(-0.6, 0.6, (len(contacts), POINTS, 2))
    with jax.enable_x64(True):
        by_rays = np.asarray(jaxcap.support_distance(rays_of(contacts), where))
        polygons = [jaxcap.support_polygon(jaxcap.centroidal_cone(one)) for one in contacts]
        by_faces = np.array([jaxcap.support_distance(one, at) for one, at in zip(polygons, where, strict=True)])
    return contacts, where, polygons, by_faces, by_rays


def linear_program(contacts, direction):
    """How far out in a direction (2,) the CoM can be in equilibrium, Bretl and Lall's program, by HiGHS [m]."""
    active = jax.tree.map(lambda x: x[contacts.mask], contacts)
    rays, origin = wrench_rays(active.points, active.frames, active.friction)[:2]
    # Force and vertical torque balance the weight; the horizontal torque says where the CoM is.
    matrix, weight = rays[[0, 1, 2, 5]], np.array([0, 0, 1.0, 0])
    result = linprog(-(direction @ np.array([-rays[4], rays[3]])), A_eq=matrix, b_eq=weight, method="highs-ds")
    if result.status in (2, 3):
        return -np.inf if result.status == 2 else np.inf
    assert result.status == 0, result.message
    return -result.fun + direction @ origin[:2]


# laws


def test_margin_over_omega_is_the_distance_of_the_capture_point_along_the_velocity():
    """Coplanar contacts, horizontal velocity, ample friction, from above the polygon: the exact margin is the baseline's."""
    contacts = foot(0.05, 0.12, friction=3.0) + foot(-0.1, -0.1, friction=3.0)
    cone, height = jaxcap.centroidal_cone(contacts), 0.8
    rng = np.random.default_rng(3)
    coms = np.column_stack([rng.uniform(-0.05, 0.05, (200, 2)), np.full(200, height)])
    velocities = np.column_stack([rng.uniform(-0.8, 0.8, (200, 2)), np.zeros(200)])
    margin = jaxcap.score(cone, coms, velocities).margin
    capture = np.asarray(jaxcap.capture_point(coms, velocities, height))
    along = velocities[:, :2] / np.linalg.norm(velocities, axis=1)[:, None]
    omega = np.sqrt(G / height)
    # Where it would leave the polygon, if it went on along the velocity: on the boundary, and no earlier.
    polygon = jaxcap.support_polygon(cone)
    leaves = capture + (np.asarray(margin) / omega)[:, None] * along
    np.testing.assert_allclose(polygon.distance(jnp.asarray(leaves)), 0, atol=1e-9)
    assert (np.sign(margin) == np.sign(polygon.distance(jnp.asarray(capture)))).all()
    assert 20 < (margin > 0).sum() < 180


def test_polygon_of_coplanar_contacts_is_their_hull():
    """With ample friction; so are the signed distances, in both forms."""
    contacts = foot(0.05, 0.12, friction=3.0) + foot(-0.1, -0.1, friction=3.0)
    where = np.random.default_rng(4).uniform(-0.4, 0.4, (300, 2))
    hull = jaxcap.hull_distance(contacts, where)
    polygon = jaxcap.support_polygon(jaxcap.centroidal_cone(contacts))
    assert len(polygon.vertices) == len(ConvexHull(contacts.points[:, :2]).vertices)
    np.testing.assert_allclose(jaxcap.support_distance(polygon, where), hull, atol=1e-10)
    np.testing.assert_allclose(distance_by_rays(contacts, where), hull, atol=1e-9)


def test_faces_and_rays_agree(batch):
    """On random contacts, and on every named set."""
    *_, by_faces, by_rays = batch
    assert not np.isnan(by_rays).any()
    np.testing.assert_allclose(by_rays, by_faces, atol=1e-7)
    assert (by_faces[:SETS] > 0).sum() > 20 and (np.isfinite(by_faces[:SETS]) & (by_faces[:SETS] < 0)).sum() > 20


def test_soles_that_are_parallel_but_for_rounding():
    """As recorded in single precision: nearly equal rays, bases next to singular. No lane may be lost, or off."""
    rng = np.random.default_rng(7)
    contacts = []
    for _ in range(SETS):
        tilts, turns = rng.normal(0, 2e-8, (2, 2)), rng.uniform(-0.5, 0.5, 2)
        frames = [rotation(*tilt, turn) for tilt, turn in zip(tilts, turns, strict=True)]
        contacts.append(foot(0, 0.1, 0, frames[0]) + foot(rng.uniform(-0.3, 0.3), -0.15, 1e-8, frames[1]))
    where = rng.uniform(-0.5, 0.5, (SETS, POINTS, 2))
    polygons = [jaxcap.support_polygon(jaxcap.centroidal_cone(one)) for one in contacts]
    by_faces = [one.distance(jnp.asarray(at)) for one, at in zip(polygons, where, strict=True)]
    np.testing.assert_allclose(jaxcap.support_distance(rays_of(contacts), where), by_faces, atol=1e-6)


def test_half_planes_are_those_of_linear_programs(batch):
    """How far out the polygon reaches, along its own normals and in other directions."""
    contacts, _, polygons, *_ = batch
    angles = np.random.default_rng(5).uniform(0, 2 * np.pi, 4)
    for one, polygon in zip(contacts, polygons, strict=True):
        if polygon.empty or len(polygon.offsets) == 0:
            continue
        for normal, offset in zip(polygon.normals[:8], polygon.offsets[:8], strict=False):
            assert abs(linear_program(one, normal) - offset - normal @ polygon.origin) < 1e-6
        for direction in np.column_stack([np.cos(angles), np.sin(angles)]):
            if (reach := linear_program(one, direction)) < np.inf:
                assert abs(reach - (polygon.vertices @ direction).max()) < 1e-6


def test_translation_and_yaw(batch):
    contacts, where, _, by_faces, _ = batch
    turn, shift = rotation(0, 0, 0.7), np.array([100.0, -100.0, 3.0])
    moved = [jaxcap.ContactSet(one.points @ turn.T + shift, turn @ one.frames, one.friction, one.mask) for one in contacts]
    there = where @ turn[:2, :2].T + shift[:2]
    np.testing.assert_allclose(jaxcap.support_distance(rays_of(moved), there), by_faces, atol=1e-7)
    hulls = lambda sets, at: np.asarray(jaxcap.hull_distance(stack([one.padded(SIZE) for one in sets]), at))
    np.testing.assert_allclose(hulls(moved, there), hulls(contacts, where), atol=1e-9)


def test_single_precision_agrees(batch):
    contacts, where, _, by_faces, _ = batch
    single = lambda tree: jax.tree.map(lambda x: x if x.dtype == bool else np.asarray(x, np.float32), tree)
    found = np.asarray(jaxcap.support_distance(single(rays_of(contacts)), where.astype(np.float32)))
    assert found.dtype == np.float32 and not np.isnan(found).any()
    np.testing.assert_allclose(found, by_faces, atol=1e-3)


# oracles


def test_hull_is_that_of_qhull():
    """Inside by Qhull's half-planes, outside by the nearest of a dense row of points on its edges."""
    rng = np.random.default_rng(6)
    corners = rng.normal(size=(SETS, SIZE, 3))
    mask = rng.random((SETS, SIZE)) < 0.7
    where = rng.uniform(-2.5, 2.5, (SETS, POINTS, 2))
    found = np.asarray(jaxcap.hull_distance(jaxcap.ContactSet(corners, UP, 0.5, mask), where))
    for i in range(SETS):
        hull = ConvexHull(corners[i, mask[i], :2])
        room = -(hull.equations[:, :2] @ where[i].T + hull.equations[:, 2:]).max(axis=0)
        a, b = hull.points[hull.simplices].transpose(1, 0, 2)
        dense = (a + np.linspace(0, 1, 2001)[:, None, None] * (b - a)).reshape(-1, 2)
        away = np.linalg.norm(where[i][:, None] - dense, axis=-1).min(axis=1)
        np.testing.assert_allclose(found[i][room > 0], room[room > 0], atol=1e-12)
        np.testing.assert_allclose(found[i][room <= 0], -away[room <= 0], atol=1e-5)


def test_gradient_is_the_unit_normal():
    """Of polygon and hull with respect to the point: by finite differences, and of length one."""
    contacts = foot(0, 0.1) + foot(0.3, -0.1, 0.2, rotation(0.2, -0.3, 0))
    polygon = jaxcap.support_polygon(jaxcap.centroidal_cone(contacts))
    at = jnp.array([[0.1, 0.02], [0.5, 0.4], [-0.3, 0.1], [0.2, 0.0], [0.3, -0.3], [0.2, -0.05]])
    for distance in (polygon.distance, lambda p: jaxcap.hull_distance(contacts, p)):
        slopes = jax.grad(lambda p, distance=distance: jnp.sum(distance(p)))(at)
        differences = [(distance(at + step) - distance(at - step)) / 2e-6 for step in 1e-6 * jnp.eye(2)]
        np.testing.assert_allclose(slopes, np.transpose(differences), atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(slopes, axis=1), 1, atol=1e-9)


# special cases


def test_capture_point_by_hand():
    com, velocity = np.array([0.1, 0.2, 0.981]), np.array([0.5, -1.0, 7.0])
    expected = [0.1 + 0.5 * np.sqrt(0.1), 0.2 - np.sqrt(0.1)]
    np.testing.assert_allclose(jaxcap.capture_point(com, velocity, 0.981), expected, rtol=1e-12)
    heights = np.array([[0.5], [0.981], [2.0]])
    many = jaxcap.capture_point(np.tile(com, (4, 1)), np.tile(velocity, (4, 1)), heights)
    assert many.shape == (3, 4, 2)
    np.testing.assert_allclose(many[1, 2], expected, rtol=1e-12)
    assert jaxcap.capture_point(com.astype(np.float32), velocity.astype(np.float32), 1).dtype == np.float32


def test_at_rest_the_capture_point_is_the_com():
    np.testing.assert_array_equal(jaxcap.capture_point(np.array([0.3, -0.2, 0.8]), np.zeros(3), 0.8), [0.3, -0.2])


@pytest.mark.parametrize("height", [0.0, -0.5, np.nan])
def test_without_a_positive_height_there_is_no_capture_point(height):
    point = lambda h: jaxcap.capture_point(np.ones(3), np.ones(3), h)
    assert np.isnan(point(height)).all()
    both = point(np.array([height, 0.8]))
    assert np.isnan(both[0]).all() and np.isfinite(both[1]).all()


def test_gradient_with_respect_to_height():
    """One over two omega height times the velocity."""
    slope = jax.jacobian(lambda h: jaxcap.capture_point(jnp.zeros(3), jnp.array([1.0, 2.0, 0]), h))(0.8)
    np.testing.assert_allclose(slope, np.array([1, 2]) / (2 * np.sqrt(G * 0.8)), rtol=1e-12)


@pytest.mark.parametrize("gravity", [(0, 0, -9.81), (0, 0, 3.0), (1.0, -2.0, -9.0), (4.0, 0, 0)])
def test_axes_across_gravity(gravity):
    axes = np.asarray(across(np.array(gravity, float)))
    up = -np.array(gravity) / np.linalg.norm(gravity)
    np.testing.assert_allclose(np.vstack([axes, up]) @ np.vstack([axes, up]).T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.cross(*axes), up, atol=1e-15)


def test_tilted_gravity_is_tilted_contacts():
    """The whole scene turned, gravity included: the same distances."""
    turn = rotation(0.2, -0.3, 0.5)
    contacts, gravity = foot(0, 0.1) + foot(0.3, -0.1, 0.2), np.array([0, 0, -G])
    turned = jaxcap.ContactSet(contacts.points @ turn.T, turn @ contacts.frames, contacts.friction)
    com, velocity = np.array([[0.1, 0.05, 0.7]]), np.array([[0.3, 0.2, -0.1]])
    expected = jaxcap.baselines(jaxcap.centroidal_cone(contacts), contacts, com, velocity, HEIGHTS[:1], gravity)
    state = com @ turn.T, velocity @ turn.T, HEIGHTS[:1]
    for cone, sets in ((jaxcap.centroidal_cone(turned), turned), (rays_of([turned]), stack([turned.padded(SIZE)]))):
        np.testing.assert_allclose(jaxcap.baselines(cone, sets, *state, gravity=turn @ gravity), expected, atol=1e-9)


@pytest.mark.parametrize("name", NAMED)
def test_named_polygons(batch, name):
    """Empty, everything, a point, a segment, a line without ends; distances outside are negative and Euclidean."""
    _, where, polygons, by_faces, _ = batch
    i = SETS + list(NAMED).index(name)
    polygon, at = polygons[i], where[i]
    assert polygon.empty == (name in EMPTY)
    if name in EMPTY | PLANE:
        assert (by_faces[i] == (-np.inf if name in EMPTY else np.inf)).all() and len(polygon.vertices) == 0
    if name == "one point":
        np.testing.assert_allclose(polygon.vertices, [[0.1, 0.2]], atol=1e-9)
        np.testing.assert_allclose(by_faces[i], -np.linalg.norm(at - [0.1, 0.2], axis=1), atol=1e-9)
    if name in ("two points", "three collinear points", "the same point twice"):
        assert len(polygon.vertices) == 2 and (by_faces[i] <= 1e-9).all()
    if name == "opposing points":
        assert len(polygon.vertices) == 0
        np.testing.assert_allclose(by_faces[i], -np.abs(at[:, 0]), atol=1e-9)


def test_on_the_straight_continuation_of_a_segment():
    """Where no half-plane is left by more than rounding, the distance is still that to the nearer end."""
    contacts = points([-0.2, 0.1, 0], [0.2, -0.1, 0])
    at = np.array([[0.6, -0.3], [0.0, 0.0], [-0.2, 0.1]] * 2)
    expected = [-np.hypot(0.4, 0.2), 0, 0] * 2
    for found in (
        jaxcap.hull_distance(contacts, at),
        jaxcap.support_distance(jaxcap.centroidal_cone(contacts), at),
        distance_by_rays(contacts, at),
    ):
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_vertices_go_round_counterclockwise(batch):
    _, _, polygons, *_ = batch
    for polygon in polygons[:SETS]:
        following = np.roll(polygon.vertices, -1, axis=0) - polygon.vertices
        turn = np.cross(*(np.pad(x, ((0, 0), (0, 1))) for x in (following, np.roll(following, -1, axis=0))))[:, 2]
        assert polygon.empty or (turn >= -1e-12).all()


def test_masked_contacts_and_none():
    far = hidden(foot(5, 5, 5))
    both, at = [FEET + far, hidden(FEET) + far], np.zeros((2, POINTS, 2))
    assert jaxcap.hull_distance(stack(both), at)[:, 0].tolist() == pytest.approx([0.1, -np.inf])
    assert jaxcap.support_distance(rays_of(both), at)[:, 0].tolist() == pytest.approx([0.1, -np.inf])


def test_rows_that_are_not_finite_leave_the_others_alone():
    contacts, rays = stack([FEET.padded(SIZE)] * 4), rays_of([FEET] * 4)
    rays = rays._replace(rays=rays.rays.at[2].set(np.nan))
    coms = np.tile([0.0, 0.0, 0.8], (4, 1))
    coms[1] = np.nan
    found = jaxcap.baselines(rays, contacts, coms, np.zeros((4, 3)), np.tile(HEIGHTS, (2, 1)))
    found = jax.tree.map(lambda x: np.asarray(x)[:, 0], found)
    np.testing.assert_array_equal(np.isnan(found.capture_point_support), [False, True, True, False])
    np.testing.assert_array_equal(np.isnan(found.capture_point_hull), [False, True, False, False])
    np.testing.assert_allclose(found.capture_point_support[::3], 0.1, atol=1e-9)


def test_default_height_and_many_heights():
    """Above the mean of the contacts; as a second axis, several heights for each state in one call."""
    contacts = FEET + foot(0.4, 0, 0.6)
    cone = jaxcap.centroidal_cone(contacts)
    coms, velocities = np.array([[0.05, 0, 0.9], [0.1, 0, 0.1]]), np.array([[0.2, 0.1, 0], [0.1, 0, 0]])
    np.testing.assert_allclose(height_above_contacts(cone, coms), [0.7, -0.1], atol=1e-12)
    default = jaxcap.baselines(cone, contacts, coms, velocities)
    assert np.isnan(np.array(default)[:, 1]).all()
    many = jaxcap.baselines(cone, contacts, coms, velocities, HEIGHTS)
    assert many.capture_point_support.shape == (2, 6)
    np.testing.assert_allclose(np.array(many)[:, 0, 1], np.array(default)[:, 0], atol=1e-12)
    rays = jaxcap.baselines(rays_of([contacts] * 2), stack([contacts.padded(SIZE)] * 2), coms, velocities, HEIGHTS)
    np.testing.assert_allclose(rays, many, atol=1e-9)


def test_inside_jit_and_vmap():
    """And under grad: rays of one set each, against the polygons."""
    contacts, at = [FEET, foot(0, 0.1) + foot(0.3, -0.1, 0.2)], jnp.array([[0.02, 0.1], [0.3, 0.3]])
    found, slopes = jax.jit(jax.vmap(jax.value_and_grad(jaxcap.support_distance, 1)))(rays_of(contacts), at)
    for i, one in enumerate(contacts):
        distance = jaxcap.support_polygon(jaxcap.centroidal_cone(one)).distance
        np.testing.assert_allclose(found[i], distance(at[i]), atol=1e-9)
        np.testing.assert_allclose(slopes[i], jax.grad(distance)(at[i]), atol=1e-9)
    with pytest.raises(ValueError, match="support_polygon works on the host"):
        jax.jit(jaxcap.support_polygon)(jaxcap.centroidal_cone(FEET))


def test_wrong_shapes_are_type_errors():
    with pytest.raises(TypeError):
        jaxcap.support_distance(jaxcap.centroidal_cone(FEET), np.zeros(3))
    with pytest.raises(TypeError, match="rays 2 contact sets"):
        jaxcap.support_distance(jaxcap.cone_rays(stack([FEET] * 2)), np.zeros((3, 2)))


def test_what_rays_do_not_find_faces_say():
    """A pole, walls and palms, on which the programs of rays have no answer in single precision."""
    drawn = [draw(77, *which, 32) for which in ((65, "pole"), (79, "walls"), (197, "palms"))]
    contacts = [jaxcap.ContactSet(one.points, one.frames, one.friction) for one in drawn]
    rays = rays_of([one.padded(8) for one in contacts])
    places = np.stack([one.coms[:, :2] for one in drawn]).astype(np.float32)
    found, traced = (np.asarray(ask(rays, places)) for ask in (jaxcap.support_distance, jax.jit(jaxcap.support_distance)))
    assert np.isnan(traced).all() and found.dtype == np.float32  # under jit there is no host to ask
    by_faces = [jaxcap.support_polygon(jaxcap.centroidal_cone(one)) for one in contacts]
    exact = np.stack([polygon.distance(jnp.asarray(where, float)) for polygon, where in zip(by_faces, places, strict=True)])
    np.testing.assert_allclose(found, exact, rtol=1e-6, atol=1e-9)
