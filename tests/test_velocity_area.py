"""Velocity areas, robustness and CoM areas: laws on random contact sets, closed forms, and degenerate sets by name."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import random_contacts, rotation
from scipy.spatial import ConvexHull
from states import POINTS, ROWS, contact_set, pieces

import jaxcap
from jaxcap.regions.com_area import com_area
from jaxcap.regions.robustness import robustness
from jaxcap.regions.velocity_area import headings, sphere, velocity_area

pytestmark = pytest.mark.usefixtures("x64")
G, HEIGHT = 9.81, 0.8
OMEGA = np.sqrt(G / HEIGHT)
UP = np.eye(3)
FEW = 5
"""Lines of a CoM area: as many states as there are `MANY` directions, once they are padded."""
MANY = 255
"""Directions: with the one that `velocity_area` adds, as many states as `pieces` has."""


def foot(x, y, friction=2.0, z=0.0, frame=UP, half=(0.1, 0.05)):
    return jaxcap.rectangle([x, y, z], frame, *half, friction)


def points(*positions, friction=0.5):
    return jaxcap.ContactSet(np.array(positions, float), UP, friction)


def faces(contacts):
    return jaxcap.centroidal_cone(contacts).padded(ROWS)


def rays(contacts):
    return jax.tree.map(np.asarray, jaxcap.cone_rays(contacts.padded(POINTS)))


FEET = foot(0, 0.1) + foot(0, -0.1)
CORNERS = np.array([[0.1, 0.15], [-0.1, 0.15], [-0.1, -0.15], [0.1, -0.15]])
PALMS = foot(0, 0.2, 0.5, 1, rotation(np.pi / 2, 0, 0)) + foot(0, -0.2, 0.5, 1, rotation(-np.pi / 2, 0, 0))
forms = pytest.mark.parametrize("form", [faces, rays])


def shoelace(polygon):
    return np.sum(polygon[:, 0] * np.roll(polygon[:, 1], -1) - polygon[:, 1] * np.roll(polygon[:, 0], -1)) / 2


def standing_samples(seed, count, rectangles=(2, 3, 4)):
    """Random contact sets, each with a CoM position at which the robot can stand."""
    rng = np.random.default_rng(seed)
    while count:
        arrays = random_contacts(rng, rectangles[count % len(rectangles)])
        cone = faces(contact_set(*arrays))
        low, high = arrays[0].min(axis=0), arrays[0].max(axis=0)
        coms = rng.uniform(low - np.array([0, 0, 0.3]), high + np.array([0, 0, 1.2]), (64, 3))
        stands = pieces(cone, coms, np.zeros_like(coms)).capturable
        if stands.any():
            count -= 1
            yield arrays, cone, coms[np.argmax(stands)]


@pytest.fixture(scope="module")
def samples():
    with jax.enable_x64(True):
        return list(standing_samples(5, 9))


# velocity areas


@forms
def test_the_area_over_flat_ground_is_that_of_the_feet(form):
    """From where it can stand, and from beside the feet, where it is a sector with a hole towards zero."""
    cone = form(FEET)
    for x, standing in ((0.02, True), (0.25, False)):
        area = velocity_area(cone, np.array([x, 0.03, HEIGHT]), headings(MANY))
        assert area.standing == standing
        (outline,) = area.outline()
        inside = (CORNERS - [x, 0.03]) * OMEGA  # the feet's hull, seen from the CoM
        hull = ConvexHull(inside)
        on_edge = (outline @ hull.equations[:, :2].T + hull.equations[:, 2]).max(axis=1)
        np.testing.assert_allclose(on_edge, 0, atol=1e-8)
        assert area.size() == pytest.approx(hull.volume, rel=5e-3)
        assert shoelace(outline) == pytest.approx(float(area.size()))
        assert (np.asarray(area.min_speed) > 0).any() != standing


@forms
def test_contact_sets_side_by_side_are_the_sets_one_by_one(form):
    """A batch of contact sets, or of CoM positions, gives what each alone gives."""
    coms = np.array([[0, 0, 0.8], [0.05, 0.1, 0.7], [0.2, 0, 0.9]])
    towards = sphere(MANY)
    if form is rays:
        cones = [rays(foot(0, 0.1, mu) + foot(0, -0.1, mu)) for mu in (0.2, 0.5, 0.9)]
        cone = jax.tree.map(lambda *leaves: np.stack(leaves), *cones)
        same_com = velocity_area(cone, coms[0], towards)
        assert same_com.max_speed.shape == (3, MANY)
    else:
        cones, cone = [faces(FEET)] * 3, faces(FEET)
    together = velocity_area(cone, coms, towards)
    for i in range(3):
        alone = velocity_area(cones[i], coms[i], towards)
        np.testing.assert_allclose(together.max_speed[i], alone.max_speed, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(together.min_speed[i], alone.min_speed, rtol=1e-7, atol=1e-9)
        assert together.standing[i] == alone.standing


def test_the_mesh_is_closed_and_holds_the_volume_of_its_cones(samples):
    """Each side of a triangle is the side of one other, the other way round; sectors and whole stars alike."""
    towards = sphere(MANY)
    for _, cone, com in samples[:3]:
        for moved in ([0, 0, 0], [0.6, 0, 0]):
            area = velocity_area(cone, com + np.array(moved), towards)
            vertices, triangles = area.mesh(longest=3.0)
            sides = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
            places = {tuple(p): i for i, p in enumerate(vertices)}  # at zero several vertices are one place
            same = np.array([places[tuple(p)] for p in vertices]) if len(vertices) else np.zeros(0, int)
            count = {}
            for a, b in same[sides]:
                count[a, b] = count.get((a, b), 0) + 1
            assert all(count.get((b, a), 0) == n for (a, b), n in count.items() if a != b)
            a, b, c = np.moveaxis(vertices[triangles], 1, 0)
            volume = np.sum(np.cross(a, b) * c) / 6
            assert volume >= 0
            if moved == [0, 0, 0]:
                assert len(vertices) == len(towards)
                assert volume > 0


def test_the_mesh_of_a_ball_has_its_volume():
    """Opposing palms stop any speed: the cut is all there is."""
    vertices, triangles = velocity_area(faces(PALMS), np.array([0.1, 0, 1.2]), sphere(MANY)).mesh(longest=2.0)
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    assert np.sum(np.cross(a, b) * c) / 6 == pytest.approx(4 / 3 * np.pi * 8, rel=0.03)


def test_single_precision_gives_nearly_the_same_area(samples):
    for _, cone, com in samples[:3]:
        double, single = (velocity_area(cone, com.astype(dtype), headings(MANY)) for dtype in (np.float64, np.float32))
        assert single.max_speed.dtype == np.float32
        np.testing.assert_allclose(single.size(), double.size(), rtol=2e-3, atol=1e-4)


def test_directions_that_do_not_fit_are_errors():
    cone, com = faces(FEET), np.array([0, 0, HEIGHT])
    with pytest.raises(TypeError, match="com has shape"):
        velocity_area(cone, np.zeros((1, 2, 3)))
    with pytest.raises(ValueError, match="not horizontal"):
        velocity_area(cone, com, sphere(40)).outline()
    with pytest.raises(ValueError, match="do not span"):
        velocity_area(cone, com, headings(40)).mesh(1.0)
    upper = sphere(40)
    upper[:, 2] = np.abs(upper[:, 2]) + 0.1
    with pytest.raises(ValueError, match="surround"):
        velocity_area(cone, com, upper).mesh(1.0)
    with pytest.raises(ValueError, match="single CoM"):
        velocity_area(cone, np.stack([com, com])).outline()
    with pytest.raises(ValueError, match="count"):
        headings(2)
    with pytest.raises(ValueError, match="count"):
        sphere(3)


# robustness


@forms
def test_robustness_over_flat_ground_is_the_nearest_edge(form):
    """Level pushes: omega times the distance to the nearest edge, straight at it; a rising CoM is a little weaker still."""
    cone, com = form(FEET), np.array([0.04, 0.03, HEIGHT])
    level = robustness(cone, com, horizontal=True)
    assert level.speed == pytest.approx(OMEGA * 0.06, rel=1e-9)
    np.testing.assert_allclose(level.direction, [1, 0, 0], atol=1e-6)
    weakest = robustness(cone, com)
    assert 0.98 * level.speed < weakest.speed < level.speed
    assert weakest.direction[2] > 0
    out = jaxcap.capturability(cone, com, np.asarray(weakest.direction))
    assert out.max_speed == pytest.approx(float(weakest.speed), rel=1e-12)


def test_robustness_is_the_smallest_of_many_directions(samples):
    """A finer grid all around, and directions ever closer to the one found, have nothing that is weaker."""
    rng = np.random.default_rng(0)
    for _, cone, com in samples[:6]:
        for horizontal, grid in ((False, sphere(8192)), (True, headings(8192))):
            found = robustness(cone, com, horizontal)
            near = 10.0 ** rng.uniform(-8, -1, (8192, 1)) * rng.normal(size=(8192, 3)) * [1, 1, not horizontal]
            directions = np.concatenate([grid, found.direction + near])
            least = jaxcap.score(cone, np.tile(com, (len(directions), 1)), directions).max_speed.min()
            assert found.speed <= least * (1 + 1e-9) + 1e-12
            assert found.speed >= least * (1 - 1e-3) - 1e-9
            assert jnp.linalg.norm(found.direction) == pytest.approx(1)
            assert not horizontal or found.direction[2] == 0


def test_robustness_along_a_kink_of_the_largest_speed():
    """C1 meets C2 at this weakest direction, between a steep side and a flat one: a hasty search sticks to the kink."""
    *_, (arrays, cone, com) = standing_samples(5, 15, (3,))  # the first of them with such a kink
    towards = robustness(cone, com).direction + 1e-4 * sphere(MANY)
    cases = np.asarray(jaxcap.score(cone, np.tile(com, (MANY, 1)), 100 * towards).case)
    assert set(cases) == {jaxcap.Case.C1, jaxcap.Case.C2}
    test_robustness_is_the_smallest_of_many_directions([(arrays, cone, com)])


def test_yaw_and_translation_turn_and_keep_robustness(samples):
    turn, shift = rotation(0, 0, 2.1), np.array([10.0, -5.0, 1.0])
    for (points, frames, friction), cone, com in samples[:4]:
        one = robustness(cone, com)
        moved = faces(contact_set(points @ turn.T + shift, turn @ frames, friction))
        other = robustness(moved, turn @ com + shift)
        assert other.speed == pytest.approx(float(one.speed), rel=1e-6)
        np.testing.assert_allclose(turn @ one.direction, other.direction, atol=1e-4)


def test_lengths_times_four_double_robustness(samples):
    for (points, frames, friction), cone, com in samples[:4]:
        larger = robustness(faces(contact_set(4 * points, frames, friction)), 4 * com)
        assert larger.speed == pytest.approx(2 * float(robustness(cone, com).speed), rel=1e-6)


def test_more_contacts_and_more_friction_never_hurt(samples):
    """Neither the robustness nor the largest speed in any direction; and somewhere they help."""
    added = random_contacts(np.random.default_rng(6), 1)
    helped = np.zeros(2, int)
    for arrays, cone, com in samples[:6]:
        hand = tuple(np.concatenate(pair) for pair in zip(arrays, added, strict=True))
        grip = (*arrays[:2], 1.3 * arrays[2])
        less, before = robustness(cone, com).speed, velocity_area(cone, com, sphere(MANY)).max_speed
        for i, more in enumerate((hand, grip)):
            cone_of_more = faces(contact_set(*more))
            after = velocity_area(cone_of_more, com, sphere(MANY)).max_speed
            assert (after >= before * (1 - 1e-7) - 1e-7).all()
            speed = robustness(cone_of_more, com).speed
            assert speed >= less * (1 - 1e-7) - 1e-7
            helped[i] += speed > 1.001 * less
    assert (helped > 0).all()


def test_both_forms_have_the_same_robustness(samples):
    for arrays, cone, com in samples[:3]:
        one, other = robustness(cone, com), robustness(rays(contact_set(*arrays)), com)
        assert other.speed == pytest.approx(float(one.speed), rel=1e-6)


def test_gradient_of_robustness_is_its_finite_difference(samples):
    for _, cone, com in samples[:3]:
        gradient = jax.grad(lambda com, cone=cone: robustness(cone, com).speed)(com)
        for axis in np.eye(3):
            ends = [float(robustness(cone, com + sign * 1e-5 * axis).speed) for sign in (-1, 1)]
            assert float(gradient @ axis) == pytest.approx((ends[1] - ends[0]) / 2e-5, rel=1e-3, abs=1e-4)


def test_robustness_under_jit_and_vmap(samples):
    _, cone, com = samples[0]
    coms = com + np.array([[0, 0, 0], [0.01, 0, 0], [5, 0, 0]])
    many = jax.jit(jax.vmap(lambda com: robustness(cone, com, horizontal=True)))(coms)
    for i in range(3):
        alone = robustness(cone, coms[i], horizontal=True)
        assert many.speed[i] == pytest.approx(float(alone.speed), rel=1e-9)


# degenerate sets


@forms
def test_one_point_contact_has_no_robustness(form):
    """Above the point it stands and stops any fall straight down; sideways nothing."""
    cone, com = form(points([0.3, -0.2, 0.1])), np.array([0.3, -0.2, 0.9])
    area = velocity_area(cone, com, headings(MANY))
    assert area.standing
    assert area.size() == pytest.approx(0, abs=1e-5)
    assert robustness(cone, com, horizontal=True).speed < 1e-3
    assert robustness(cone, com).speed < 1e-3


@forms
def test_two_points_have_an_area_without_width(form):
    cone, com = form(points([-0.2, 0, 0], [0.2, 0, 0], friction=2.0)), np.array([0.0, 0, HEIGHT])
    area = velocity_area(cone, com, np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]] * 63 + [[1, 1, 0]] * 3, float))
    np.testing.assert_allclose(area.max_speed[:4], [0.2 * OMEGA, 0, 0.2 * OMEGA, 0], atol=1e-3)
    assert robustness(cone, com).speed < 1e-3


@forms
def test_opposing_palms_are_robust_without_end(form):
    cone, com = form(PALMS), np.array([0.3, 0.1, 0.2])
    area = velocity_area(cone, com, headings(MANY))
    assert np.isinf(area.size())
    (outline,) = area.outline(longest=2.0)
    np.testing.assert_allclose(np.linalg.norm(outline, axis=1), 2.0)
    weakest = robustness(cone, com)
    assert np.isinf(weakest.speed)
    assert np.isnan(weakest.direction).all()


@forms
def test_a_com_that_cannot_stand_has_no_robustness(form):
    cone = form(FEET)
    for com in ([0.15, 0, HEIGHT], [5.0, 0, HEIGHT]):
        for horizontal in (False, True):
            weakest = robustness(cone, np.array(com), horizontal)
            assert weakest.speed == 0
            assert np.isnan(weakest.direction).all()


@forms
def test_contacts_without_a_place_to_stand_have_an_empty_area(form):
    """A single hand on a wall."""
    cone, com = form(foot(0.5, 0, 0.5, 1, rotation(0, -np.pi / 2, 0))), np.array([0.0, 0, 1])
    area = velocity_area(cone, com, headings(MANY))
    assert not area.standing
    assert area.size() == 0
    assert area.outline() == []
    assert robustness(cone, com).speed == 0


@forms
def test_a_com_exactly_on_the_boundary(form):
    """It stands, a push outwards takes nothing, and inwards there is an area."""
    cone, com = form(FEET), np.array([0.1, 0, HEIGHT])
    area = velocity_area(cone, com, headings(MANY))
    assert area.standing
    assert area.size() == pytest.approx(0.2 * 0.3 * OMEGA**2, rel=1e-2)
    weakest = robustness(cone, com, horizontal=True)
    assert weakest.speed == pytest.approx(0, abs=1e-6)


@forms
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_com_that_is_not_finite_is_unknown(form, bad):
    cone, com = form(FEET), np.array([0, bad, HEIGHT])
    area = velocity_area(cone, com, headings(MANY))
    assert np.isnan(area.max_speed).all()
    assert np.isnan(area.size())
    assert area.outline() == []
    weakest = robustness(cone, com)
    assert np.isnan(weakest.speed)
    assert np.isnan(weakest.direction).all()


def test_masked_contacts_do_nothing():
    hidden = jaxcap.ContactSet(foot(1, 1).points, UP, 0.5, mask=np.zeros(4, bool))
    com = np.array([0.02, 0, HEIGHT])
    one, other = (robustness(rays(contacts), com) for contacts in (FEET, FEET + hidden))
    assert other.speed == pytest.approx(float(one.speed), rel=1e-9)
    nothing = jaxcap.ContactSet(FEET.points, UP, 0.5, mask=np.zeros(8, bool))
    assert robustness(rays(nothing), com).speed == 0


# where the CoM may be


@forms
def test_the_com_area_over_flat_ground_is_the_feet_shifted_back(form):
    """By velocity / omega; every vertex lies on an edge."""
    velocity = np.array([0.3, 0.2, 0])
    area = com_area(form(FEET), velocity, HEIGHT, lines=FEW)
    (outline,) = area.outline()
    ahead = np.abs(outline + velocity[:2] / OMEGA) - [0.1, 0.15]
    np.testing.assert_allclose(ahead.max(axis=1), 0, atol=1e-9)
    assert area.size() == pytest.approx(0.2 * 0.3, rel=0.1)  # a few lines cut the corners


def test_the_com_area_is_where_the_verdict_is_yes(samples):
    """Verdicts on random places of the plane, off the edges."""
    rng = np.random.default_rng(3)
    found = np.zeros(2, int)
    for arrays, cone, com in samples[:4]:
        velocity = np.array([*rng.normal(size=2), 0]) * 0.3
        area = com_area(cone, velocity, com[2])
        low, high = arrays[0].min(axis=0)[:2] - 0.4, arrays[0].max(axis=0)[:2] + 0.4
        places = np.concatenate([rng.uniform(low, high, (2000, 2)), (area.rear + area.front) / 2])
        places = places[np.isfinite(places).all(axis=1)]
        coms = np.column_stack([places, np.full(len(places), com[2])])
        verdict = pieces(cone, coms, np.tile(velocity, (len(coms), 1))).capturable
        inside, distance = in_polygons(area.outline(), places)
        clear = distance > 0.01  # between two lines an edge is a chord
        np.testing.assert_array_equal(verdict[clear], inside[clear])
        found += (verdict & clear).sum(), (~verdict & clear).sum()
    assert (found > 200).all()


def in_polygons(polygons, places):
    """Whether each place lies in one of the polygons, and its distance from their edges [m]."""
    inside, distance = np.zeros(len(places), bool), np.full(len(places), np.inf)
    for polygon in polygons:
        a, b = polygon, np.roll(polygon, -1, axis=0)
        side, arm = b - a, places[:, None] - a
        share = np.clip((arm * side).sum(-1) / np.maximum((side**2).sum(-1), 1e-30), 0, 1)
        distance = np.minimum(distance, np.linalg.norm(arm - share[..., None] * side, axis=-1).min(axis=1))
        spans = (a[:, 1] > places[:, None, 1]) != (b[:, 1] > places[:, None, 1])
        at = a[:, 0] + (places[:, None, 1] - a[:, 1]) * side[:, 0] / np.where(side[:, 1] == 0, 1, side[:, 1])
        inside |= (spans & (places[:, None, 0] < at)).sum(axis=1) % 2 == 1
    return inside, distance


@forms
def test_com_areas_of_degenerate_sets(form):
    velocity = np.array([0.3, 0, 0])
    everywhere = com_area(form(PALMS), velocity, 1.0, FEW, reach=1.0)
    assert everywhere.size() == pytest.approx(4, rel=0.1)
    one = com_area(form(points([0, 0, 0])), velocity, HEIGHT, FEW)
    assert one.size() == pytest.approx(0, abs=1e-4)
    wall = com_area(form(foot(0.5, 0, 0.5, 1, rotation(0, -np.pi / 2, 0))), velocity, 1.0, FEW)
    assert wall.outline() == []
    assert wall.size() == 0


@pytest.mark.parametrize("velocity", [[0, 0, 0], [0.1, 0, 0.1], [np.nan, 0, 0]])
def test_a_com_area_needs_a_level_velocity(velocity):
    with pytest.raises(ValueError, match="com_velocity"):
        com_area(faces(FEET), np.array(velocity, float), HEIGHT)
    with pytest.raises(ValueError, match="lines"):
        com_area(faces(FEET), np.array([0.1, 0, 0]), HEIGHT, lines=1)
