"""The paper's algorithm in `reference/` on its own: closed forms, pieces, static region, named states."""

import numpy as np
import pytest
from samplers import join, random_contacts, random_samples, random_state, rectangle
from scipy.integrate import solve_ivp
from scipy.spatial import ConvexHull

from reference import algorithm
from reference.algorithm import is_state_capturable
from reference.contacts import grasp_matrix, pyramid_edges, wrench_rays
from reference.linear_programs import (
    compute_closest_static_alpha,
    compute_max_acc,
    compute_min_acc,
    line_program,
    solve_acceleration,
)
from reference.oracles import static_interval

G = 9.81
UP = np.eye(3)


def feet(distance=0.4, friction=2.0):
    """Two equal coplanar feet at z = 0."""
    left, right = ([0.0, side * distance / 2, 0.0] for side in (1.0, -1.0))
    return join(rectangle(left, UP, friction=friction), rectangle(right, UP, friction=friction))


def point_contacts(points, frame=UP, friction=1.0):
    points = np.atleast_2d(np.asarray(points, float))
    return points, np.repeat(np.asarray(frame)[None], len(points), axis=0), np.full(len(points), friction)


def facing(normal):
    """A rotation whose third column is `normal`, horizontal, and whose first column is vertical."""
    up = np.array([0.0, 0.0, 1.0])
    return np.column_stack([up, np.cross(normal, up), normal])


# Contacts


def test_pyramid_edges_lie_on_the_cone_at_the_stated_angles():
    _, frames, friction = random_contacts(np.random.default_rng(0), 3)
    edges = pyramid_edges(frames, friction, sides=5)
    local = np.einsum("kji,ksj->ksi", frames, edges)
    np.testing.assert_allclose(np.linalg.norm(edges, axis=2), 1.0)
    np.testing.assert_allclose(np.hypot(local[..., 0], local[..., 1]), friction[:, None] * local[..., 2])
    angles = np.pi / 5 + 2 * np.pi * np.arange(5) / 5
    np.testing.assert_allclose(np.cos(np.arctan2(local[..., 1], local[..., 0]) - angles), 1.0)


def test_rays_are_wrenches_of_single_edges():
    points, frames, friction = random_contacts(np.random.default_rng(1), 2)
    wrenches, edges = wrench_rays(points, frames, friction), pyramid_edges(frames, friction)
    moments = np.cross((points - wrenches.origin)[:, None], edges)
    expected = np.concatenate([edges, moments], axis=2).reshape(-1, 6).T
    np.testing.assert_allclose(wrenches.rays, expected, atol=1e-15)
    assert grasp_matrix(points).shape == (6, 24)


@pytest.mark.parametrize("sides, count", [(2, 1), (4, 0)])
def test_wrench_rays_refuse(sides, count):
    with pytest.raises(ValueError, match="at least 1 point and 3 sides"):
        wrench_rays(np.zeros((count, 3)), np.zeros((count, 3, 3)), np.ones(count), sides)


# Algorithm 3: closed forms (18)-(24)


def integrate_numerically(alpha, alphadot, beta, gamma, alpha_bar):
    """Algorithm 3 by `solve_ivp`: (alpha, alphadot, duration)."""
    rest, end = (lambda _, s: s[1]), (lambda _, s: s[0] - alpha_bar)
    rest.terminal = end.terminal = True
    rest.direction, end.direction = -1.0, 1.0
    solution = solve_ivp(
        lambda _, s: (s[1], beta + gamma * s[0]),
        (0.0, 50.0), (alpha, alphadot), events=[rest, end], rtol=1e-11, atol=1e-12,
    )  # fmt: skip
    return *solution.y[:, -1], solution.t[-1]


@pytest.mark.parametrize("curvature", [0.0, 1.0, -1.0])
@pytest.mark.parametrize("push", [0.0, 1.0, -1.0])
def test_integrate_lds_agrees_with_numerical_integration(curvature, push):
    rng = np.random.default_rng(2)
    for _ in range(15):
        alpha, alphadot, reach = rng.uniform(-0.5, 0.5), rng.uniform(0.05, 2.0), rng.uniform(0.05, 1.0)
        gamma = curvature * 10.0 ** rng.uniform(-3.0, 2.0)
        beta = push * 10.0 ** rng.uniform(-2.0, 1.0) - gamma * alpha  # acceleration at alpha of the sign of `push`
        arguments = (alpha, alphadot, beta, gamma, alpha + reach)
        np.testing.assert_allclose(algorithm.integrate_lds(*arguments), integrate_numerically(*arguments), atol=2e-7)


def test_integrate_lds_where_printed_algorithm_3_errs():
    # E9: |arg| > 1 with gamma < 0, alphadot = 2 > 1 = sqrt(-gamma) (alpha + beta/gamma): an oscillator that turns first
    alpha, alphadot, t = algorithm.integrate_lds(0.0, 2.0, -1.0, -1.0, 5.0)
    np.testing.assert_allclose((alpha, alphadot, t), (np.sqrt(5.0) - 1.0, 0.0, np.arctan(2.0)), rtol=1e-12)
    # E9: still accelerating (gamma < 0, acc > 0): the principal branch lies in the past
    alpha, alphadot, t = algorithm.integrate_lds(0.0, 1.0, 1.0, -1.0, 5.0)
    np.testing.assert_allclose((alpha, alphadot, t), (1.0 + np.sqrt(2.0), 0.0, 3 * np.pi / 4), rtol=1e-12)
    # E8: accelerating with gamma = 0: rest lies in the past
    np.testing.assert_allclose(algorithm.integrate_lds(0.0, 1.0, 1.0, 0.0, 1.5), (1.5, 2.0, 1.0), rtol=1e-12)
    # From rest, gamma < 0: half a period
    np.testing.assert_allclose(algorithm.integrate_lds(0.0, 0.0, 1.0, -1.0, 5.0), (2.0, 0.0, np.pi), rtol=1e-12)
    # |arg| = 1: the unstable equilibrium is approached for ever
    assert algorithm.integrate_lds(0.0, 1.0, -1.0, 1.0, 5.0) == (1.0, 0.0, np.inf)


# (16), (25)-(29)


@pytest.mark.slow
@pytest.mark.parametrize("flat", [False, True])
def test_pieces_hold_and_join(flat):
    rng = np.random.default_rng(3)
    pieces = 0
    for i in range(40):
        contacts = feet(friction=0.5) if flat else random_contacts(rng, 2 + i % 3)
        com, velocity = random_state(rng, contacts[0])
        if flat and i % 2:
            com, velocity = np.array([0.0, 0.0, 1.0]), np.array([1.0, i % 3 - 1.0, 0.0])  # ties in every way
        direction, wrenches = velocity / np.linalg.norm(velocity), wrench_rays(*contacts)
        program = line_program(com, direction, wrenches)
        for compute, sign in ((compute_min_acc, 1.0), (compute_max_acc, -1.0)):
            alpha, slope = 0.0, -np.inf
            for _ in range(20):
                feasible, beta, gamma, alpha_bar = compute(com, alpha, direction, wrenches)
                if not feasible or np.isinf(beta):
                    break
                assert alpha_bar > alpha
                assert sign * gamma > slope - 1e-6  # acc_min is convex, acc_max concave
                ends = [alpha, min(0.5 * (alpha + alpha_bar), alpha + 1.0), min(alpha_bar, alpha + 2.0)]
                values = [sign * solve_acceleration(program, end, sign).fun for end in ends]
                np.testing.assert_allclose([beta + gamma * end for end in ends], values, rtol=1e-7, atol=1e-6)
                pieces, alpha, slope = pieces + 1, alpha_bar, sign * gamma
                if np.isinf(alpha):
                    break
            else:
                pytest.fail("more than 20 pieces")
    assert pieces > 40


def test_closest_static_alpha_is_the_nearest_point_of_the_static_interval():
    rng = np.random.default_rng(4)
    seen = set()
    for contacts, com, velocity in random_samples(rng, 120):
        direction, alpha = velocity / np.linalg.norm(velocity), rng.uniform(0.0, 1.0)
        alpha_s = compute_closest_static_alpha(com, alpha, direction, wrench_rays(*contacts))
        interval = static_interval(*contacts, com, direction)
        if interval is None:
            assert alpha_s is None
            seen.add("empty")
        else:
            assert abs(alpha_s - np.clip(alpha, *interval)) < 0.5 * algorithm.SAME_ALPHA
            seen.add(float(np.sign(alpha_s - alpha)) if abs(alpha_s - alpha) > 1e-6 else 0.0)
    assert seen == {"empty", -1.0, 0.0, 1.0}


# Named states


def test_zero_velocity_is_refused():
    with pytest.raises(ValueError, match="no direction"):
        is_state_capturable(*feet(), [0.0, 0.0, 1.0], np.zeros(3))


@pytest.mark.parametrize("height", [0.4, 1.0])
def test_flat_ground_is_the_capture_point_in_the_hull(height):
    contacts = feet()
    hull = ConvexHull(contacts[0][:, :2]).equations
    omega = np.sqrt(G / height)
    verdicts = []
    for angle in np.linspace(0.1, 2 * np.pi, 9):
        for speed in np.linspace(0.05, 1.2, 6):
            velocity = speed * np.array([np.cos(angle), np.sin(angle), 0.0])
            for com in ([0.0, 0.0, height], [0.13, 0.1, height]):
                distance = np.max(hull[:, :2] @ (com[:2] + velocity[:2] / omega) + hull[:, 2])
                result = is_state_capturable(*contacts, com, velocity)
                if abs(distance) < 1e-6:
                    continue
                assert result.capturable == (distance < 0)
                verdicts.append(result.capturable)
    assert 0.1 < np.mean(verdicts) < 0.9


def test_flat_ground_figures():
    """Braking with the centre of pressure at the toes: acc = omega^2 (alpha - 0.1), exactly."""
    omega = np.sqrt(G)
    result = is_state_capturable(*feet(), [0.0, 0.0, 1.0], [0.2, 0.0, 0.0])
    stop = 0.1 - np.sqrt(0.1**2 - (0.2 / omega) ** 2)
    assert result[:2] == (True, "C3_1")
    np.testing.assert_allclose(
        result[2:6], (G * (0.1 - stop), stop, 0.0, np.arctanh(0.2 / (0.1 * omega)) / omega), rtol=1e-9
    )
    result = is_state_capturable(*feet(), [0.0, 0.0, 1.0], [0.4, 0.0, 0.0])
    left = np.sqrt(0.4**2 - G * 0.1**2)
    assert result[:2] == (False, "C1")
    np.testing.assert_allclose(result[2:5], (-left, 0.1, left), rtol=1e-9)


def test_static_region_ahead_is_reached_or_not():
    """The CoM starts 5 cm behind the heels: the heels' orbital energy decides."""
    needed = np.sqrt(G) * 0.05
    for speed, case in ((0.99 * needed, "C3_2_2"), (1.01 * needed, "C3_2_1")):
        result = is_state_capturable(*feet(), [-0.15, 0.0, 1.0], [speed, 0.0, 0.0])
        assert (result.case, result.capturable) == (case, case == "C3_2_1")


def test_line_past_the_feet():
    """Up, gravity alone brings the CoM to rest, but not to stay; along the feet, nothing holds it even at the start."""
    assert is_state_capturable(*feet(), [0.11, 0.0, 1.0], [0.0, 0.0, 0.5])[:3] == (False, "EMPTY", 0.0)
    assert is_state_capturable(*feet(), [0.11, 0.0, 1.0], [0.0, 0.5, 0.0])[:3] == (False, "C2", -0.5)


def hooks(half=0.1, friction=5.0):
    """Hooks on a rail one metre above the CoM, normals upwards."""
    return point_contacts([[x, y, 1.0] for x in (-half, half) for y in (-0.2, 0.2)], friction=friction)


@pytest.mark.parametrize("reach, swings", [(0.15, 1), (0.29, 1), (0.31, 2), (0.52, 3)])
def test_hanging_robot_swings_until_it_stops_in_the_static_region(reach, swings):
    """A pendulum about a pivot anywhere in +-0.1 m: each swing can take 0.2 m off its reach."""
    speed = np.sqrt(G * ((reach + 0.1) ** 2 - 0.1**2))
    state = (*hooks(), np.zeros(3), [speed, 0.0, 0.0])
    assert is_state_capturable(*state)[:2] == (None, "C3_3")
    np.testing.assert_allclose(is_state_capturable(*state).alpha_final, reach, rtol=1e-9)
    result = is_state_capturable(*state, swings=10)
    assert (result.capturable, result.case, result.swings) == (True, "C3_3", swings)
    if swings > 1:
        result = is_state_capturable(*state, swings=swings - 1)
        assert (result.capturable, result.swings) == (None, swings - 1)


def test_hanging_robot_that_stops_in_the_static_region_needs_no_swing():
    assert is_state_capturable(*hooks(), np.zeros(3), [0.5, 0.0, 0.0])[:2] == (True, "C3_1")


# Degenerate contacts


def test_one_point():
    one = point_contacts([0.0, 0.0, 0.0])
    up = is_state_capturable(*one, [0.0, 0.0, 1.0], [0.0, 0.0, 0.5])
    assert up[:2] == (True, "C3_1")
    np.testing.assert_allclose(up[2:6], (G, 0.5**2 / (2 * G), 0.0, 0.5 / G), rtol=1e-9)
    down = is_state_capturable(*one, [0.0, 0.0, 1.0], [0.0, 0.0, -0.5])
    assert down[:4] == (True, "C3_1", np.inf, 0.0)
    assert is_state_capturable(*one, [0.1, 0.0, 1.0], [0.0, 0.0, 0.5])[:2] == (False, "EMPTY")  # ballistic
    assert is_state_capturable(*one, [0.1, 0.0, 1.0], [0.0, 0.1, 0.0])[:2] == (False, "C2")
    assert is_state_capturable(*one, [0.0, 0.0, 1.0], [0.1, 0.0, 0.0])[:2] == (False, "C1")


@pytest.mark.parametrize("points", [[[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0]], [[-0.1, 0, 0], [0.03, 0, 0], [0.1, 0, 0]]])
def test_two_points_and_three_collinear_points(points):
    yaw = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([3.0, -2.0, 0.7])
    above = shift + np.array([0.0, 0.0, 1.0])
    contacts = point_contacts(points @ yaw.T + shift)
    for speed, case in ((0.99, "C3_1"), (1.01, "C1")):
        velocity = yaw @ [speed * 0.1 * np.sqrt(G), 0.0, 0.0]
        assert is_state_capturable(*contacts, above, velocity).case == case
    out = shift + yaw @ [0.0, 0.01, 1.0]  # beside the line of contacts: the CoM is on an inverted pendulum about it
    assert is_state_capturable(*contacts, out, yaw @ [0.0, 0.1, 0.0]).capturable is False
    assert is_state_capturable(*contacts, out, yaw @ [0.1, 0.0, 0.0])[:2] == (False, "C2")


def test_opposing_palms_stop_at_once():
    frames = np.stack([facing(np.array([1.0, 0.0, 0.0])), facing(np.array([-1.0, 0.0, 0.0]))])
    palms = join(*(rectangle([x, 0.0, 1.0], frame) for x, frame in zip((-0.3, 0.3), frames, strict=True)))
    rng = np.random.default_rng(5)
    for _ in range(10):
        result = is_state_capturable(*palms, rng.uniform(-0.2, 0.2, 3), rng.uniform(-1.0, 1.0, 3))
        assert result[:5] == (True, "C3_1", np.inf, 0.0, 0.0)


def test_figures_do_not_depend_on_where_the_origin_is():
    rng = np.random.default_rng(6)
    shift = np.array([1000.0, -300.0, 20.0])
    for i in range(40):
        points, *rest = random_contacts(rng, 2 + i % 3)
        com, velocity = random_state(rng, points)
        here = is_state_capturable(points, *rest, com, velocity, swings=10)
        there = is_state_capturable(points + shift, *rest, com + shift, velocity, swings=10)
        assert here[:2] == there[:2]
        np.testing.assert_allclose(here[2:6], there[2:6], rtol=1e-6, atol=1e-6)


def test_every_case_occurs_among_the_samples():
    rng = np.random.default_rng(7)
    cases = set()
    for contacts, com, velocity in random_samples(rng, 400):
        cases.add(is_state_capturable(*contacts, com, velocity).case)
    assert cases == {"C1", "C2", "C3_1", "C3_2_1", "C3_2_2", "C3_3", "EMPTY"}
