"""Named states whose answer is known, and degenerate ones, which are the normal case in this field."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import rotation
from scipy.spatial import ConvexHull
from states import POINTS, ROWS, each, pieces, random_states

import jaxcap
from jaxcap import Case, Status

pytestmark = pytest.mark.usefixtures("x64")
UP, DOWN = np.eye(3), rotation(np.pi, 0, 0)
G = 9.81


def foot(x, y, friction=0.5, z=0.0, frame=UP):
    return jaxcap.rectangle([x, y, z], frame, 0.1, 0.05, friction)


def points(*positions, frames=UP, friction=0.5):
    return jaxcap.ContactSet(np.array(positions, float), frames, friction)


FORMS = {  # of the sizes that other files have: compiled once
    "faces": lambda contacts: jaxcap.centroidal_cone(contacts).padded(ROWS),
    "rays": lambda contacts: jaxcap.cone_rays(contacts.padded(POINTS)),
}


@pytest.fixture(params=FORMS, autouse=True)
def form(request):
    """Every case in both forms of the cone."""
    global cone_of
    cone_of = FORMS[request.param]


def answer(contacts, com, velocity, dtype=np.float64):
    return jaxcap.capturability(cone_of(contacts), jnp.asarray(com, dtype), jnp.asarray(velocity, dtype))


FEET = foot(0, 0.1) + foot(0, -0.1)
PALMS = jaxcap.rectangle([0, 0.2, 1], rotation(np.pi / 2, 0, 0), 0.1, 0.05, 0.5) + jaxcap.rectangle(
    [0, -0.2, 1], rotation(-np.pi / 2, 0, 0), 0.1, 0.05, 0.5
)
precisions = pytest.mark.parametrize(("dtype", "rtol"), [(np.float64, 1e-9), (np.float32, 2e-4)])


def test_flat_ground_is_the_capture_point_in_the_hull_of_the_contacts():
    """Ample friction, horizontal velocity: for every state of a grid off the very edge, in both precisions."""
    contacts = foot(0.05, 0.12, 2.0) + foot(-0.1, -0.1, 2.0)
    height = 0.8
    grid = np.stack(np.meshgrid(*[np.linspace(-0.3, 0.3, 13)] * 2, *[np.linspace(-0.8, 0.8, 9)] * 2), axis=-1).reshape(-1, 4)
    coms = np.column_stack([grid[:, :2], np.full(len(grid), height)])
    velocities = np.column_stack([grid[:, 2:], np.zeros(len(grid))])
    cone = cone_of(contacts)
    capture_points = grid[:, :2] + grid[:, 2:] / np.sqrt(G / height)
    sides = ConvexHull(contacts.points[:, :2]).equations
    outside = (capture_points @ sides[:, :2].T + sides[:, 2]).max(axis=1)  # distance [m], negative inside
    expected = outside <= 0
    assert 0.05 < expected.mean() < 0.95
    for dtype, band in ((np.float64, 1e-9), (np.float32, 1e-3)):
        found = pieces(cone, coms.astype(dtype), velocities.astype(dtype))
        clear = np.abs(outside) > band
        assert clear.mean() > 0.9
        np.testing.assert_array_equal(np.asarray(found.capturable)[clear], expected[clear])


@precisions
def test_inverted_pendulum_in_closed_form(dtype, rtol):
    """From the middle of a foot: speed omega x edge; back from beside it: at least omega x gap."""
    omega = np.sqrt(G / 0.8)
    inside = answer(FEET, [0, 0, 0.8], [0.2, 0, 0], dtype)
    assert inside.max_speed == pytest.approx(0.1 * omega, rel=rtol)
    assert inside.min_speed == 0
    stop = 0.1 - np.sqrt(0.1**2 - (0.2 / omega) ** 2)
    assert inside.distance == pytest.approx(stop, rel=rtol)
    assert inside.time == pytest.approx(np.arctanh(0.2 / omega / 0.1) / omega, rel=rtol)
    assert inside.paper_margin == pytest.approx(omega**2 * (0.1 - stop), rel=rtol)
    beside = answer(FEET, [-0.15, 0, 0.8], [0.4, 0, 0], dtype)
    assert beside.min_speed == pytest.approx(0.05 * omega, rel=rtol)
    assert beside.max_speed == pytest.approx(0.25 * omega, rel=rtol)
    assert beside.case == Case.C3_2_1
    assert beside.distance == pytest.approx(0.05, rel=1e-3)
    assert answer(FEET, [-0.15, 0, 0.8], [0.1, 0, 0], dtype).case == Case.C3_2_2
    falling = answer(FEET, [0, 0, 0.8], [0.5, 0, 0], dtype)
    assert falling.case == Case.C1
    assert falling.residual_speed == pytest.approx(np.sqrt(0.5**2 - (0.1 * omega) ** 2), rel=rtol)


@precisions
def test_the_fastest_way_to_a_rest_at_the_edge(dtype, rtol):
    """C3.2.1 of the inverted pendulum: with the foot's far edge as pivot, then braking; time against bisection by hand."""
    omega, speed, gap = np.sqrt(G / 0.8), 0.4, 0.05
    contacts = foot(0, 0, 5.0)
    found = answer(contacts, [-0.1 - gap, 0, 0.8], [speed, 0, 0], dtype)
    near, far = gap, gap + 0.2  # the centres of pressure, alpha
    slow = lambda a, centre: omega**2 * ((a - centre) ** 2)
    # energy under least deceleration from the start, and under most deceleration to rest at the edge
    early = lambda a: speed**2 + slow(a, near) - slow(0, near)
    late = lambda a: slow(a, far) - slow(gap, far)
    low, high = 0.0, gap
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if early(middle) < late(middle) else (low, middle)
    alphas = np.linspace(0, low, 200001)
    integral = lambda square, a: np.trapezoid(1 / np.sqrt(square), a)
    first = integral(early(alphas), alphas)
    v = np.sqrt(late(low))
    second = np.arctanh(v / (omega * (far - low))) / omega
    assert found.case == Case.C3_2_1
    assert found.time == pytest.approx(first + second, rel=max(rtol, 1e-6))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_zero_velocity_is_static_equilibrium(dtype):
    for com, standing in (([0, 0, 0.8], True), ([0.099, 0, 0.8], True), ([0.101, 0, 0.8], False), ([5, 0, 0.8], False)):
        found = answer(FEET, com, [0, 0, 0], dtype)
        assert found.status == Status.NO_DIRECTION
        assert found.capturable == standing
        assert found.case == (Case.C3_1 if standing else Case.EMPTY)
        assert np.isnan([found.margin, found.min_speed, found.max_speed, found.paper_margin]).all()
        assert found.distance == 0 if standing else np.isnan(found.distance)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_com_exactly_on_the_boundary(dtype):
    """The cone is closed: at rest on the edge it stands, inwards it may move, outwards it falls at any speed."""
    com = [0.1, 0, 0.8]
    assert answer(FEET, com, [0, 0, 0], dtype).capturable
    assert answer(FEET, com, [-0.3, 0, 0], dtype).capturable
    outwards = answer(FEET, com, [0.3, 0, 0], dtype)
    assert not outwards.capturable
    assert outwards.margin == pytest.approx(-0.3, abs=1e-2)
    along = answer(FEET, com, [0, 0.3, 0], dtype)
    assert along.capturable
    assert along.max_speed == pytest.approx(0.15 * np.sqrt(G / 0.8), rel=1e-2)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_one_point_contact(dtype):
    """The CoM can stand only straight above the point; there it moves up and down as it likes, and falls to the side."""
    contacts = points([0.3, -0.2, 0.1])
    above = [0.3, -0.2, 0.9]
    assert answer(contacts, above, [0, 0, 0], dtype).capturable
    assert not answer(contacts, [0.31, -0.2, 0.9], [0, 0, 0], dtype).capturable
    assert answer(contacts, above, [0, 0, 1], dtype).capturable
    assert answer(contacts, above, [0, 0, -1], dtype).capturable
    sideways = answer(contacts, above, [0.2, 0, 0], dtype)
    assert not sideways.capturable
    assert sideways.case in (Case.C1, Case.C2)
    assert answer(contacts, [0.5, 0.5, 0.9], [1, 0.3, 0.2], dtype).case == Case.EMPTY


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_one_point_contact_is_a_rod_without_damping(dtype):
    """Towards the point, exactly one speed comes to rest above it."""
    contacts = points([0, 0, 0], friction=1.0)
    omega = np.sqrt(G / 0.8)
    found = answer(contacts, [-0.1, 0, 0.8], [0.3, 0, 0], dtype)
    assert found.min_speed == pytest.approx(0.1 * omega, rel=1e-3)
    assert found.max_speed == pytest.approx(0.1 * omega, rel=1e-3)
    assert not found.capturable


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_two_points_are_a_flat_cone(dtype):
    """Between the points it can stand and stop; off the line it falls sideways."""
    contacts = points([-0.2, 0, 0], [0.2, 0, 0])
    omega = np.sqrt(G / 0.8)
    found = answer(contacts, [0, 0, 0.8], [0.1, 0, 0], dtype)
    assert found.case == Case.C3_1
    assert found.max_speed == pytest.approx(0.2 * omega, rel=1e-3)
    assert answer(contacts, [0.1, 0, 0.8], [0, 0, 0], dtype).capturable
    assert not answer(contacts, [0.1, 0.01, 0.8], [0, 0, 0], dtype).capturable
    assert not answer(contacts, [0, 0, 0.8], [0, 0.1, 0], dtype).capturable
    assert not answer(contacts, [0, 0.05, 0.8], [0.1, 0, 0], dtype).capturable


def test_three_collinear_points_are_their_ends():
    ends, middle = points([-0.2, 0, 0], [0.2, 0, 0]), points([0.05, 0, 0])
    for com, velocity in (([0, 0, 0.8], [0.1, 0, 0]), ([0.1, 0, 0.8], [0.6, 0, 0]), ([0, 0, 0.8], [0.1, 0.1, 0])):
        one, other = answer(ends, com, velocity), answer(ends + middle, com, velocity)
        assert one.case == other.case
        assert one.max_speed == pytest.approx(float(other.max_speed), abs=1e-6)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_opposing_palms_hold_anything(dtype):
    found = answer(PALMS, [0.3, 0.1, 0.2], [2, -1, 3], dtype)
    assert found.capturable
    assert found.margin == np.inf
    assert found.distance == 0
    assert found.time == 0
    assert answer(PALMS, [0.3, 0.1, 0.2], [0, 0, 0], dtype).capturable


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("friction", [1e3, 1e5, 1e9, 1e300])
@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
def test_contacts_that_never_slip(dtype, friction):
    """On feet the centre of pressure decides, whatever the friction; between a wall and the ground anything can be held."""
    out = answer(foot(0, 0.1, friction) + foot(0, -0.1, friction), [0.02, 0, 0.8], [0.2, 0, 0], dtype)
    assert out.max_speed == pytest.approx(0.08 * np.sqrt(G / 0.8), rel=1e-3) and out.case == Case.C3_1
    wall = jaxcap.rectangle([0.5, 0, 1], np.array(rotation(0, -np.pi / 2, 0)), 0.1, 0.05, friction)
    out = answer(foot(0, 0, friction) + wall, [0.02, 0, 0.8], [0.2, 0.3, 0], dtype)
    assert out.capturable and out.max_speed == np.inf


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_straight_up_gravity_stops_it(dtype):
    found = answer(FEET, [0, 0, 0.8], [0, 0, 1], dtype)
    assert found.max_speed == np.inf
    assert found.distance == pytest.approx(1 / (2 * G), rel=1e-4)
    assert found.time == pytest.approx(1 / G, rel=1e-4)


@precisions
def test_swings_below_a_support_in_closed_form(dtype, rtol):
    """C3.3: feet on a beam, CoM below it: a pendulum whose pivot can be anywhere under the soles, in [-w, w].

    Maximum deceleration swings about -w, the way back about +w.
    """
    w, depth, speed = 0.1, 0.8, 1.0
    omega = np.sqrt(G / depth)
    contacts = foot(0, 0, 5.0, z=2.0)
    found = answer(contacts, [0, 0, 2.0 - depth], [speed, 0, 0], dtype)
    amplitude = np.hypot(w, speed / omega)
    stop = amplitude - w
    assert w < stop < 3 * w  # beyond where it can stand, and so near that one swing back is enough
    assert found.case == Case.C3_3
    assert found.capturable
    assert found.distance == pytest.approx(stop + 2 * (stop - w), rel=rtol)
    assert found.time == pytest.approx((np.arccos(w / amplitude) + np.pi) / omega, rel=rtol)
    # friction ends the polygon: there even a swing about the far edge needs the steepest force there is
    inside = answer(contacts, [0, 0, 2.0 - depth], [0.9 * np.sqrt(3) * omega * w, 0, 0], dtype)
    assert inside.case == Case.C3_1
    assert inside.max_speed == pytest.approx(float(found.max_speed), rel=1e-3)


def test_a_pendulum_without_damping_never_stops():
    """C3.3 over a static region without length: two points on a beam, swinging across the line between them."""
    contacts = points([0, -0.2, 2], [0, 0.2, 2], friction=5.0)
    found = answer(contacts, [0, 0, 1.2], [0.5, 0, 0])
    assert found.case == Case.C3_3
    assert not found.capturable
    assert found.max_speed < 1e-3
    assert answer(contacts, [0, 0, 1.2], [0, 0, 0]).capturable


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_many_swings(dtype):
    """A small foot takes little from each swing: the verdict is exact, the path is followed to its end."""
    contacts = jaxcap.rectangle([0, 0, 2], UP, 0.02, 0.02, 5.0)
    found = answer(contacts, [0, 0, 1.2], [1.0, 0, 0], dtype)
    w, omega = 0.02, np.sqrt(G / 0.8)
    rest, path = np.hypot(w, 1 / omega) - w, 0.0
    path += rest
    while abs(rest) > w:  # each swing turns about the edge on the side it comes from
        pivot = np.copysign(w, rest)
        path += 2 * abs(rest - pivot)
        rest = 2 * pivot - rest
    assert found.capturable
    assert found.distance == pytest.approx(path, rel=1e-3)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("size", [1e-30, 1e-12, 1e12, 1e30])
def test_extreme_speeds_get_an_answer(dtype, size):
    found = answer(FEET, [0, 0, 0.8], [size, 0, 0], dtype)
    if size > 3e8:  # faster than light: no state of a robot
        assert found.status == Status.NONFINITE and not found.capturable
        return
    assert found.status == Status.OK
    assert found.capturable == (size < 1)
    assert found.max_speed == pytest.approx(0.1 * np.sqrt(G / 0.8), rel=1e-4)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_state_that_is_not_finite_is_undecided(bad):
    for com, velocity in (([bad, 0, 0.8], [1, 0, 0]), ([0, 0, 0.8], [0, bad, 0])):
        found = answer(FEET, com, velocity)
        assert found.status == Status.NONFINITE
        assert found.case == Case.UNDECIDED
        assert not found.capturable
        assert np.isnan([found.margin, found.max_speed, found.time, found.residual_speed]).all()


def test_too_many_pieces_are_undecided(monkeypatch):
    monkeypatch.setattr(sys.modules["jaxcap.one_state.walk"], "MAX_PIECES", 1)
    monkeypatch.setattr(sys.modules["jaxcap.one_state.boundary"], "MAX_PIECES", 1)
    jax.clear_caches()
    contacts = foot(0, 0.1, frame=rotation(0.2, 0.3, 0.1)) + foot(0.2, -0.1, frame=rotation(-0.3, 0.1, 0.5), z=0.2)
    found = [answer(contacts, [0.1, 0, z], [0.3, 0.3, 0.1]) for z in (0.5, 0.8, 1.1)]
    jax.clear_caches()
    undecided = [a for a in found if a.status == Status.MAX_STEPS]
    assert undecided
    assert not any(a.capturable or a.case != Case.UNDECIDED or not np.isnan(a.margin) for a in undecided)


def test_too_many_swings_keep_the_verdict(monkeypatch):
    _, cones, coms, velocities = random_states(60, 5, 11)
    full = each()(cones, coms, velocities)
    i = int(np.argmax((full.case == Case.C3_3) & full.capturable))
    monkeypatch.setattr(sys.modules["jaxcap.one_state.swings"], "MAX_SWINGS", 0)
    jax.clear_caches()
    cone = jaxcap.CentroidalCone(cones.faces[i], cones.origin[i], np.asarray(cones.length[i]))
    found = jaxcap.capturability(cone, jnp.asarray(coms[i]), jnp.asarray(velocities[i]))
    jax.clear_caches()
    assert found.status == Status.MAX_SWINGS
    assert found.capturable
    assert found.margin == pytest.approx(float(full.margin[i]))
    assert np.isnan(found.time)


def test_wrong_shapes_are_type_errors():
    cone = cone_of(FEET)
    with pytest.raises(TypeError):
        jaxcap.capturability(cone, jnp.zeros((2, 3)), jnp.zeros(3))
    with pytest.raises(TypeError):
        jaxcap.score(cone, jnp.zeros((2, 3)), jnp.zeros((3, 3)))
    with pytest.raises(TypeError):
        jaxcap.score(cone, jnp.zeros(3), jnp.zeros(3))
