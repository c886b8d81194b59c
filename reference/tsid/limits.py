"""Joint accelerations after which a joint can still stop: position and velocity limits in discrete time.

With semi-implicit Euler steps, qd+ = qd + dt qdd and q+ = q + dt qd+, a joint that can brake at a [rad/s^2] keeps clear of
its upper limit for ever if and as long as it is viable: qd^2 <= 2 a (upper - q) while qd > 0, (15). The next state is viable
if and only if

    qd+ <= V(upper - q),  V(s) = -a dt + sqrt((a dt)^2 + 2 a s),

the greatest root of qd+^2 = 2 a (s - dt qd+). Position limits need no bound of their own: V(s) <= s / dt. From a viable
state qd - a dt <= V(upper - q), so braking at a is always allowed, and with the lower limit and the speed limit, which allow
zero, the bounds never cross: intervals that meet in pairs meet. Nor do they with |qdd| <= a.

Source: Del Prete, "Joint position and velocity bounds in discrete-time acceleration/torque control of robot manipulators",
RA-L 2018, whose algorithm is for the exact integrator q+ = q + dt qd + dt^2/2 qdd. The simulator's integrator makes it one
formula; the viable set, (15), is the same.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def viable_speed(room: float, deceleration: float, dt: float) -> float:
    """V: greatest speed [rad/s] towards a limit for the next step from a distance `room` [rad]; -a dt from beyond it."""
    step = deceleration * dt
    return -step + np.sqrt(max(step * step + 2.0 * deceleration * room, 0.0))


@numba.njit(cache=True)
def acceleration_bounds(position, velocity, lower, upper, speed, deceleration, largest, dt, least, greatest):
    """Bounds of n joint accelerations, written to `least` and `greatest` (n,) [rad/s^2].

    position, velocity: (n,) [rad], [rad/s]. lower, upper, speed: (n,) limits, infinite where there are none.
    deceleration: what every joint can brake at [rad/s^2]. largest: bound on any acceleration [rad/s^2], at least
    `deceleration`; may be infinite. dt: time step [s].
    From a state that is not viable, by rounding or because it was put there, a joint is asked to brake at `deceleration`,
    never harder: a limit just passed must not by itself make the robot fall.
    """
    for i in range(position.shape[0]):
        up = min(speed[i], viable_speed(upper[i] - position[i], deceleration, dt))
        down = min(speed[i], viable_speed(position[i] - lower[i], deceleration, dt))
        greatest[i] = min(max((up - velocity[i]) / dt, -deceleration), largest)
        least[i] = max(min((-down - velocity[i]) / dt, deceleration), -largest)
