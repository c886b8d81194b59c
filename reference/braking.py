"""The state after a time of hardest braking, step by step: the least acceleration of the LP (25) at every step.

No piece, no closed form, no walk: velocity Verlet, whose error shrinks with the square of the step. `braked` takes two steps
and states the difference of its two answers, three times the error of the finer one where nothing ends in between.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reference.contacts import GRAVITY, wrench_rays
from reference.linear_programs import NO_SPIN, LineProgram, line_program, solve_acceleration


class Braked(NamedTuple):
    """Where a CoM is on its line after a time of hardest braking."""

    alpha: float  # [m]
    speed: float  # [m/s]
    time: float  # [s], less than was asked for where it came to rest or left
    ending: str  # "on the way", "rests" (anywhere), "leaves": no acceleration keeps the contacts
    error: float  # of alpha and speed: what halving the step changed [m, m/s]


def braked(
    points, frames, friction, com, com_velocity, duration, *, step=0.004, sides=4, gravity=GRAVITY,
    specific_angular_momentum=NO_SPIN,
) -> Braked:  # fmt: skip
    """The state after `duration` [s], by steps of `step` [s] at most and by half of them.

    specific_angular_momentum: (3,) about the CoM, over the mass [m^2/s]; its rate is in proportion to the acceleration.
    """
    speed = float(np.linalg.norm(com_velocity))
    direction = np.asarray(com_velocity, float) / speed
    spin = np.asarray(specific_angular_momentum, float) / speed
    program = line_program(com, direction, wrench_rays(points, frames, friction, sides), gravity, spin)
    steps = max(int(np.ceil(duration / step)), 1)
    coarse, fine = (_stepped(program, speed, duration, n) for n in (steps, 2 * steps))
    return fine._replace(error=max(abs(coarse.alpha - fine.alpha), abs(coarse.speed - fine.speed)))


def _stepped(program: LineProgram, speed: float, duration: float, steps: int) -> Braked:
    dt, alpha, time = duration / steps, 0.0, 0.0
    acceleration = _least(program, alpha)
    if acceleration is None:
        return Braked(alpha, speed, time, "leaves", 0.0)
    if acceleration == -np.inf:  # forces without limit
        return Braked(alpha, 0.0, time, "rests", 0.0)
    for _ in range(steps):
        ahead = alpha + speed * dt + acceleration * dt**2 / 2
        then = _least(program, ahead)
        if then is None:
            return Braked(alpha, speed, time, "leaves", 0.0)
        if then == -np.inf:
            return Braked(ahead, 0.0, time + dt, "rests", 0.0)
        faster = speed + (acceleration + then) / 2 * dt
        if faster <= 0:
            part = speed / (speed - faster)  # of the step
            return Braked(alpha + speed * part * dt / 2, 0.0, time + part * dt, "rests", 0.0)
        alpha, speed, acceleration, time = ahead, faster, then, time + dt
    return Braked(alpha, speed, time, "on the way", 0.0)


def _least(program: LineProgram, alpha: float) -> float | None:
    """The least acceleration [m/s^2], -inf where none is least; None where none is feasible."""
    result = solve_acceleration(program, alpha)
    if result is None:
        return None
    return -np.inf if result.status == 3 else float(result.x[0])
