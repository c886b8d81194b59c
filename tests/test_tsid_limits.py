"""Joint acceleration bounds: they keep a viable joint viable for ever, do not cross, and are no tighter than that needs."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from reference.tsid.limits import acceleration_bounds, viable_speed

ROUNDING = 1e-9

COMPILING = settings(deadline=None)
"""The first call compiles the bounds, which takes as long as the machine lets it."""


def bounds(position, velocity, speed, deceleration, dt, lower=-1.0, upper=2.0, largest=np.inf):
    """Bounds of one joint."""
    least, greatest = np.empty(1), np.empty(1)
    one = [np.array([float(value)]) for value in (position, velocity, lower, upper, speed)]
    acceleration_bounds(*one, deceleration, largest, dt, least, greatest)
    return least[0], greatest[0]


share = st.floats(0.0, 1.0)
brakes = st.sampled_from([1.0, 10.0, 30.0])
steps = st.sampled_from([5e-4, 1e-3, 5e-3, 0.05])


def viable(place, pace, speed, deceleration, lower=-1.0, upper=2.0):
    """A viable state: anywhere between the limits, with a velocity within (15) and the speed limit."""
    position = lower + place * (upper - lower)
    fastest = min(speed, np.sqrt(2 * deceleration * (upper - position)))
    slowest = -min(speed, np.sqrt(2 * deceleration * (position - lower)))
    return position, slowest + pace * (fastest - slowest)


@COMPILING
@given(share, share, brakes, steps, st.floats(0.1, 10.0), st.lists(share, min_size=1, max_size=50), st.booleans())
def test_a_viable_joint_stays_viable_whatever_is_chosen(place, pace, deceleration, dt, speed, choices, capped):
    position, velocity = viable(place, pace, speed, deceleration)
    for choice in choices:
        least, greatest = bounds(position, velocity, speed, deceleration, dt, largest=deceleration if capped else np.inf)
        assert least <= greatest + ROUNDING
        acceleration = least + choice * (greatest - least)
        if capped:
            assert abs(acceleration) <= deceleration + ROUNDING
        velocity += dt * acceleration
        position += dt * velocity
        assert -1.0 - ROUNDING <= position <= 2.0 + ROUNDING
        assert abs(velocity) <= speed + ROUNDING
        room = 2.0 - position if velocity > 0 else position + 1.0
        assert velocity**2 <= 2 * deceleration * room + 1e-6


@COMPILING
@given(share, share, brakes, steps)
def test_braking_is_always_allowed(place, pace, deceleration, dt):
    position, velocity = viable(place, pace, 5.0, deceleration)
    least, greatest = bounds(position, velocity, 5.0, deceleration, dt)
    assert least <= deceleration and greatest >= -deceleration


@COMPILING
@given(share, brakes, steps, st.floats(0.01, 1.0))
def test_more_than_the_bound_cannot_be_stopped(place, deceleration, dt, excess):
    """From just beyond the bound the next state is not viable."""
    position, velocity = viable(place, 1.0, np.inf, deceleration)
    _, greatest = bounds(position, velocity, np.inf, deceleration, dt)
    velocity += dt * greatest + excess
    position += dt * velocity
    assert velocity**2 > 2 * deceleration * (2.0 - position)


def test_no_limits_no_bounds():
    assert bounds(0.3, 7.0, np.inf, 10.0, 1e-3, -np.inf, np.inf) == (-np.inf, np.inf)


def test_speed_limits_alone():
    least, greatest = bounds(0.3, 1.0, 2.0, 10.0, 1e-3, -np.inf, np.inf)
    np.testing.assert_allclose((least, greatest), (-3000.0, 1000.0))


def test_beyond_a_limit_a_joint_is_asked_to_brake_and_no_more():
    least, greatest = bounds(2.5, 3.0, 5.0, 10.0, 1e-3)
    assert greatest == -10.0 and least < greatest
    assert viable_speed(-0.5, 10.0, 1e-3) == -0.01


def test_the_next_speed_is_the_root_of_the_viability_bound():
    """V is where (15) holds with equality after the step."""
    for room in (0.0, 1e-6, 0.01, 1.0):
        speed = viable_speed(room, 10.0, 1e-3)
        np.testing.assert_allclose(speed**2, 2 * 10.0 * (room - 1e-3 * speed), atol=1e-12)
