"""The oracles in `reference/` on their own, and the paper's algorithm against both of them."""

from itertools import pairwise

import numpy as np
import pytest
from samplers import join, random_contacts, random_state, rectangle

from reference.algorithm import is_state_capturable
from reference.contacts import wrench_rays
from reference.linear_programs import compute_max_acc, compute_min_acc
from reference.oracles import (
    capturable_by_discretisation,
    discretised_stop,
    event_integration,
    feasible_polygon,
    speed_interval,
    static_interval,
)

G = 9.81
HEIGHT = 1.0
OMEGA = np.sqrt(G / HEIGHT)


def feet():
    """Two equal coplanar feet at z = 0, heels at x = -0.1 m, toes at x = 0.1 m."""
    return join(*(rectangle([0.0, side, 0.0], np.eye(3), friction=2.0) for side in (-0.2, 0.2)))


def hooks():
    """Hooks on a rail one metre above the origin, normals upwards."""
    points = np.array([[x, y, 1.0] for x in (-0.1, 0.1) for y in (-0.2, 0.2)])
    return points, np.repeat(np.eye(3)[None], 4, axis=0), np.full(4, 5.0)


def states(seed, count):
    """Random (contacts, com, velocity), without those that cannot hold their contacts even at the start."""
    rng, made = np.random.default_rng(seed), 0
    while made < count:
        contacts = random_contacts(rng, 2 + made % 3)
        com, velocity = random_state(rng, contacts[0])
        direction = velocity / np.linalg.norm(velocity)
        if compute_min_acc(com, 0.0, direction, wrench_rays(*contacts)).feasible:
            made += 1
            yield contacts, com, velocity


# Event-based integration


def test_algorithm_agrees_with_event_integration():
    cases = set()
    for contacts, com, velocity in states(10, 30):
        result, oracle = is_state_capturable(*contacts, com, velocity), event_integration(*contacts, com, velocity)
        assert result[:2] == oracle[:2]
        np.testing.assert_allclose((result.alpha_final, result.alphadot_final), oracle[2:], atol=2e-5)
        cases.add(result.case)
    assert {"C1", "C2", "C3_1", "C3_2_1", "C3_2_2"} <= cases


@pytest.mark.parametrize("ratio", [0.999, 1.001])
def test_event_integration_on_flat_ground(ratio):
    verdict = event_integration(*feet(), [0.0, 0.0, HEIGHT], [ratio * OMEGA * 0.1, 0.0, 0.0])
    assert verdict[:2] == ((True, "C3_1") if ratio < 1.0 else (False, "C1"))
    verdict = event_integration(*feet(), [-0.15, 0.0, HEIGHT], [ratio * OMEGA * 0.05, 0.0, 0.0])
    assert verdict[:2] == ((False, "C3_2_2") if ratio < 1.0 else (True, "C3_2_1"))


def test_event_integration_of_a_hanging_robot():
    assert event_integration(*hooks(), np.zeros(3), [1.0, 0.0, 0.0])[:2] == (None, "C3_3")


# The polygon and the static interval


def test_polygon_agrees_with_the_accelerations():
    for contacts, com, velocity in states(11, 15):
        direction, wrenches = velocity / np.linalg.norm(velocity), wrench_rays(*contacts)
        a, b, d = feasible_polygon(*contacts, com, direction)
        low, high = compute_min_acc(com, 0.0, direction, wrenches), compute_max_acc(com, 0.0, direction, wrenches)
        if np.isfinite(low.beta):
            np.testing.assert_allclose(np.max(d[a < 0] / a[a < 0]), low.beta, atol=1e-6)
        if np.isfinite(high.beta):
            np.testing.assert_allclose(np.min(d[a > 0] / a[a > 0]), high.beta, atol=1e-6)
        static = static_interval(*contacts, com, direction)
        upper = np.min(d[b > 0] / b[b > 0]) if np.all(d[b == 0] >= 0) else -np.inf
        lower = np.max(d[b < 0] / b[b < 0])
        if static is None:
            assert lower > upper - 1e-6 or np.any(d[b == 0] < 0)
        else:
            np.testing.assert_allclose(static, (lower, upper), atol=1e-6)


def test_static_interval_of_flat_feet_is_their_hull():
    np.testing.assert_allclose(static_interval(*feet(), [0.0, 0.0, HEIGHT], [1.0, 0.0, 0.0]), (-0.1, 0.1), atol=1e-9)
    assert static_interval(*feet(), [0.2, 0.0, HEIGHT], [0.0, 1.0, 0.0]) is None


# Discretisation of (12)


def test_speed_interval_on_flat_ground_and_its_error():
    """Exact: omega times the distances to heel and toe. Steps halved, the error falls fourfold, and by its bound."""
    state = (*feet(), [-0.15, 0.0, HEIGHT], [1.0, 0.0, 0.0])
    exact = OMEGA * np.array([0.05, 0.25])
    errors = []
    for steps in (20, 40, 80):
        found = speed_interval(*state, steps=steps)
        inside = np.array([found.low - exact[0], exact[1] - found.high])
        assert np.all(inside > -1e-7)  # never outside the true interval
        assert np.all(inside <= (found.low_error, found.high_error))
        errors.append(inside)
    assert np.all(np.divide(errors[:-1], errors[1:]) > 3.0)
    assert np.all(errors[-1] < 1e-3)


def test_splitting_every_step_never_loses_a_speed():
    for contacts, com, velocity in states(12, 4):
        found = [speed_interval(*contacts, com, velocity, steps=steps) for steps in (12, 24, 48)]
        for coarse, fine in pairwise(found):
            if coarse is not None:
                assert fine.low <= coarse.low + 1e-6
                assert fine.high >= coarse.high - 1e-6


def test_algorithm_agrees_with_the_speed_interval():
    """Each speed found capturable is; outside by more than the error, none is. Swings handle C3.3."""
    cases = set()
    for contacts, com, velocity in states(13, 12):
        direction = velocity / np.linalg.norm(velocity)
        found = speed_interval(*contacts, com, direction)

        def capturable(speed, contacts=contacts, com=com, direction=direction):
            result = is_state_capturable(*contacts, com, speed * direction, swings=30)
            cases.add(result.case)
            return result.capturable

        if found is None:
            assert not capturable(np.linalg.norm(velocity))
            continue
        assert capturable(found.high - 1e-6)
        if np.isfinite(found.high_error):
            assert not capturable(found.high + found.high_error + 1e-6)
        if found.low > 0.0:
            assert capturable(found.low + 1e-6)
        if found.low > found.low_error:
            assert not capturable(found.low - found.low_error - 1e-6)
        assert capturable((found.low + found.high) / 2)
    assert {"C1", "C3_1", "C3_2_1", "C3_2_2"} <= cases


@pytest.mark.parametrize("reach, capturable", [(0.29, True), (0.52, True)])
def test_discretisation_covers_the_hanging_robot(reach, capturable):
    """A pendulum that must swing back: the velocity changes sign on the way."""
    speed = np.sqrt(G * ((reach + 0.1) ** 2 - 0.1**2))
    stop = discretised_stop(*hooks(), np.zeros(3), [0.98 * speed, 0.0, 0.0], horizon=6.0, steps=100)
    assert (stop is not None) is capturable
    assert stop.alphadot.min() < -0.1 and abs(stop.alphadot[-1]) < 1e-9 and abs(stop.alpha[-1]) < 0.1 + 1e-9


def test_discretised_stop_obeys_the_polygon_between_its_knots():
    state = (*feet(), [0.0, 0.0, HEIGHT], [0.25, 0.0, 0.0])
    stop = discretised_stop(*state, horizon=3.0, steps=20)
    a, b, d = feasible_polygon(*state)
    h, fraction = np.diff(stop.times)[:, None], np.linspace(0.0, 1.0, 11)
    first, last = stop.acc[:, :1], stop.acc[:, 1:]
    t = fraction * h
    acc = first + (last - first) * fraction
    alpha = stop.alpha[:-1, None] + stop.alphadot[:-1, None] * t + first * t**2 / 2 + (last - first) * t**3 / (6 * h)
    np.testing.assert_allclose(alpha[:, -1], stop.alpha[1:], atol=1e-7)
    assert np.max(a * acc[..., None] + b * alpha[..., None] - d) < 1e-6


def test_verdict_by_discretisation():
    at = (*feet(), [0.0, 0.0, HEIGHT])
    assert capturable_by_discretisation(*at, [0.99 * OMEGA * 0.1, 0.0, 0.0])
    assert not capturable_by_discretisation(*at, [1.001 * OMEGA * 0.1, 0.0, 0.0])
    assert not capturable_by_discretisation(*feet(), [0.3, 0.0, HEIGHT], [0.0, 0.1, 0.0])
