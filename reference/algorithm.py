"""Algorithms 1, 2 and 3 of the paper, line by line, with its closed forms (18)-(24); see `ERRATA.md` for the slips.

Comments give the printed line numbers. Where the printed text is corrected the comment says E and the number of the
entry in ERRATA.md. Motion is on the line com + alpha v, v the unit velocity; alpha [m], alphadot [m/s], acc [m/s^2].

Beyond the paper: angular momentum that comes to rest in proportion to the speed, `spin` of `linear_programs`. L / m is
spin * alphadot wherever the CoM is; when it swings back along -v at the speed -alphadot, L is what it was in these terms:
the spin is minus that of the first pass.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np

from reference.contacts import GRAVITY, wrench_rays
from reference.linear_programs import NO_SPIN, compute_closest_static_alpha, compute_max_acc, compute_min_acc

MAX_ITER = 200  # pieces in one pass; a pass that needs more raises
SAME_ALPHA = 1e-7  # "alpha = alpha_s" of Algorithm 1, line 8 [m]; ten times the error of the QP's alpha


class Result(NamedTuple):
    """What Algorithm 1 says of one state. Final alpha, alphadot and time are those of its own (first, braking) pass."""

    capturable: bool | None  # None: CaseNotHandled (C3.3 without swings, or not decided by them)
    case: str  # C1, C2, C3_1, C3_2_1, C3_2_2, C3_3, or EMPTY: the QP (16) is infeasible
    # III-D. Capturable: the maximum deceleration at alpha_final [m/s^2], >= 0, inf if unbounded. Not capturable: minus
    # the speed left when the answer fell [m/s], <= 0; it is 0 in C3_2_2 and EMPTY, which end at rest. Not decided: nan.
    margin: float
    alpha_final: float  # [m]
    alphadot_final: float  # [m/s]
    time: float  # [s], inf for a stop that is only approached
    swings: int = 0  # passes made beyond the paper's, C3.3 only


class Walk(NamedTuple):
    """The end of one pass with minimum acceleration."""

    stop: str  # C1, C2 or C3
    alpha: float  # [m]
    alphadot: float  # [m/s]
    acc: float  # minimum acceleration there [m/s^2]
    time: float  # [s]


def is_state_capturable(
    points,
    frames,
    friction,
    com,
    com_velocity,
    *,
    sides=4,
    gravity=GRAVITY,
    swings=0,
    wrenches=None,
    specific_angular_momentum=NO_SPIN,
    momentum_box=0.0,
) -> Result:
    """Algorithm 1: can the CoM be brought to rest along its own velocity, contacts fixed?

    points: (k, 3) [m]. frames: (k, 3, 3), third column the normal. friction: (k,). com: (3,) [m]. com_velocity: (3,)
    [m/s]. sides: edges of the friction pyramids. swings: at most so many further passes in C3.3, which the paper does
    not handle (0, the default: capturable is None). wrenches: `contacts.wrench_rays` of these contacts, if at hand.
    specific_angular_momentum: (3,) about the CoM, over the mass [m^2/s].
    momentum_box: by how much each component of its rate may differ from what the spin says [m^2/s^2].
    Raises ValueError at zero velocity, where v is undefined.
    """
    com, com_velocity = np.asarray(com, float), np.asarray(com_velocity, float)
    speed = float(np.linalg.norm(com_velocity))
    if not speed > 0.0:
        raise ValueError(f"com_velocity = {com_velocity} has no direction")
    direction, spin = com_velocity / speed, np.asarray(specific_angular_momentum, float) / speed
    if wrenches is None:
        wrenches = wrench_rays(points, frames, friction, sides)
    wrenches = wrenches._replace(box=momentum_box)
    walk = brake(com, speed, direction, wrenches, gravity, spin=spin)
    final = (walk.alpha, walk.alphadot, walk.time)
    if walk.stop != "C3":
        return Result(False, walk.stop, -walk.alphadot, *final)
    alpha_s = compute_closest_static_alpha(com, walk.alpha, direction, wrenches, gravity)  # line 7
    if alpha_s is None:  # Appendix A, last sentence, E10
        return Result(False, "EMPTY", 0.0, *final)
    if abs(walk.alpha - alpha_s) <= SAME_ALPHA:  # line 8: C3.1
        return Result(True, "C3_1", max(-walk.acc, 0.0), *final)  # line 9
    if walk.alpha < alpha_s:  # line 10: C3.2
        if is_static_region_reachable(com, speed, direction, wrenches, gravity, spin):  # line 11
            return Result(True, "C3_2_1", -walk.acc, *final)
        return Result(False, "C3_2_2", 0.0, *final)
    capturable, residual, passes = None, 0.0, 0  # line 12: C3.3, CaseNotHandled
    if swings > 0:
        stop = com + walk.alpha * direction
        capturable, residual, passes = swing(stop, -direction, wrenches, gravity, swings, -spin)
    margin = math.nan if capturable is None else -walk.acc if capturable else 0.0 - residual
    return Result(capturable, "C3_3", margin, *final, passes)


def brake(com, alphadot, direction, wrenches, gravity=GRAVITY, from_rest=False, spin=NO_SPIN) -> Walk:
    """The loop of Algorithm 1 up to C1, C2 or C3. `from_rest` (swings only): the first test for C3 is left out."""
    alpha, acc, time, last_iteration = 0.0, math.nan, 0.0, False  # lines 2, 4
    for i in range(MAX_ITER):  # line 5
        if alphadot == 0.0 and not (from_rest and i == 0):  # line 6; integrate_lds returns an exact 0
            return Walk("C3", alpha, alphadot, acc, time)
        if last_iteration:  # line 13
            return Walk("C1", alpha, alphadot, acc, time)  # line 14
        feasible, beta, gamma, alpha_bar = compute_min_acc(com, alpha, direction, wrenches, gravity, spin)  # line 15, E3
        if not feasible:  # line 16: C2
            return Walk("C2", alpha, alphadot, acc, time)  # line 17
        if beta == -math.inf:  # opposing contacts: any deceleration is feasible, here and everywhere on the line
            return Walk("C3", alpha, 0.0, beta, time)
        if gamma >= 0.0 and beta + gamma * alpha >= 0.0:  # C1 holds already: line 19 would step back, E7
            return Walk("C1", alpha, alphadot, beta + gamma * alpha, time)
        if gamma > 0.0 and beta + gamma * alpha_bar >= 0.0:  # line 18: C1, E4
            alpha_bar = -beta / gamma  # line 19
            last_iteration = True  # line 20
        alpha, alphadot, duration = integrate_lds(alpha, alphadot, beta, gamma, alpha_bar)  # line 21
        acc, time = beta + gamma * alpha, time + duration
    raise ArithmeticError(f"no end after {MAX_ITER} pieces: alpha = {alpha}, alphadot = {alphadot}")


def is_static_region_reachable(com, alphadot, direction, wrenches, gravity=GRAVITY, spin=NO_SPIN) -> bool:
    """Algorithm 2: does maximum acceleration carry the CoM from its initial state into the static region ahead?

    True is C3.2.1, False is C3.2.2. To be called in C3.2 only.
    """
    alpha, last_iteration = 0.0, False  # lines 2, 3
    for _ in range(MAX_ITER):  # line 4
        if alphadot == 0.0:  # line 5: C3.2.2
            return False
        if last_iteration:  # line 7
            return True
        feasible, beta, gamma, alpha_bar = compute_max_acc(com, alpha, direction, wrenches, gravity, spin)  # line 9, E3
        if not feasible:  # the static region is ahead or here, and nothing is ahead: it is here, to ONE_SIDED_STEP
            return True
        if beta + gamma * alpha >= 0.0:  # already static, to rounding, or unbounded (beta = inf)
            return True
        if gamma > 0.0 and beta + gamma * alpha_bar >= 0.0:  # line 10: C3.2.1
            alpha_bar = -beta / gamma  # E11
            last_iteration = True  # line 11
        alpha, alphadot, _ = integrate_lds(alpha, alphadot, beta, gamma, alpha_bar)  # line 12
    raise ArithmeticError(f"no end after {MAX_ITER} pieces: alpha = {alpha}, alphadot = {alphadot}")


def swing(com, direction, wrenches, gravity=GRAVITY, swings=20, spin=NO_SPIN):
    """C3.3 continued, NOT in the paper: from rest at `com`, beyond the static region, back along `direction`.

    Each pass brakes as hard as it can; if it too stops beyond the static region the direction is inverted again.
    Returns (capturable, speed left [m/s], passes made); capturable is None if `swings` passes did not decide.
    """
    for count in range(1, swings + 1):
        walk = brake(com, 0.0, direction, wrenches, gravity, from_rest=True, spin=spin)
        if walk.stop != "C3":
            return False, walk.alphadot, count
        alpha_s = compute_closest_static_alpha(com, walk.alpha, direction, wrenches, gravity)
        if walk.alpha <= alpha_s + SAME_ALPHA:  # it cannot stop before the region: its push is towards it all the way
            return True, 0.0, count
        com, direction, spin = com + walk.alpha * direction, -direction, -np.asarray(spin)
    return None, 0.0, swings


def integrate_lds(alpha, alphadot, beta, gamma, alpha_bar):
    """Algorithm 3: (alpha, alphadot, duration) where first alphadot = 0 or alpha = alpha_bar, acc = beta + gamma alpha.

    alphadot >= 0, alpha <= alpha_bar, and one of the two ends must exist. An alphadot of 0 is returned exactly. (18) to
    (20) lose digits as gamma goes to 0, with beta/gamma; a segment's slope is 0 or larger than `FLAT_SLOPE`, at
    which they are good to 1e-7 m/s.
    """
    stop = zero_velocity_time(alpha, alphadot, beta, gamma)  # lines 2-3, 8-11
    if stop is not None:
        if stop == math.inf:  # |arg| = 1: rest is approached, at the unstable equilibrium, and never reached
            alpha_t = -beta / gamma
        else:
            alpha_t, _ = flow(stop, alpha, alphadot, beta, gamma)  # lines 3, 12
        if alpha_t <= alpha_bar:  # lines 4, 13
            return alpha_t, 0.0, stop  # lines 5, 14
    t = position_time(alpha, alphadot, beta, gamma, alpha_bar)  # lines 6, 15-19
    _, alphadot_t = flow(t, alpha, alphadot, beta, gamma)  # lines 7, 20
    return alpha_bar, max(alphadot_t, 0.0), t  # lines 7, 21; below 0 by rounding only


def flow(t, alpha, alphadot, beta, gamma):
    """(18), or (22) for gamma = 0: position and velocity after t seconds."""
    if gamma == 0.0:
        return alpha + alphadot * t + 0.5 * beta * t**2, alphadot + beta * t
    omega = cmath.sqrt(gamma)  # imaginary for gamma < 0
    cosh, sinh = cmath.cosh(omega * t), cmath.sinh(omega * t)
    position = cosh * alpha + sinh * alphadot / omega + (cosh - 1.0) * (beta / gamma)
    velocity = omega * sinh * alpha + cosh * alphadot + omega * sinh * (beta / gamma)
    return position.real, velocity.real


def zero_velocity_time(alpha, alphadot, beta, gamma):
    """(19), or (23) for gamma = 0: the first t > 0 (or t = 0 if the speed is zero and not about to grow) of rest.

    None if there is none ahead; inf if the velocity tends to zero.
    """
    acc = beta + gamma * alpha
    if gamma == 0.0:
        return -alphadot / beta if beta < 0.0 else None  # (23); for beta >= 0 its root lies behind, E8
    omega = cmath.sqrt(gamma)
    if gamma > 0.0:
        if acc >= 0.0:
            return None  # the root of (19) lies behind, E8
        arg = (-alphadot / (omega * (alpha + beta / gamma))).real  # line 9
        if abs(arg) > 1.0:  # line 10
            return None
        return math.inf if arg == 1.0 else (cmath.atanh(arg) / omega).real  # line 11
    if alpha + beta / gamma == 0.0:
        return math.pi / (2.0 * abs(omega))  # quarter of a period, where arg is infinite
    arg = -alphadot / (omega * (alpha + beta / gamma))  # line 9: imaginary, so that line 10 does not apply, E9
    t = (cmath.atanh(arg) / omega).real  # line 11
    return t + math.pi / abs(omega) if acc > 0.0 else t  # the branch of atanh that lies ahead, E9


def position_time(alpha, alphadot, beta, gamma, alpha_bar):
    """(20), or (24) for gamma = 0: the first t > 0 at which alpha_bar is reached, which must exist."""
    if gamma == 0.0:
        if beta == 0.0:
            return (alpha_bar - alpha) / alphadot  # E8
        return (-alphadot + math.sqrt(max(alphadot**2 - 2.0 * beta * (alpha - alpha_bar), 0.0))) / beta  # (24)
    omega = cmath.sqrt(gamma)
    a, b, c = alpha + beta / gamma, alphadot / omega, -alpha_bar - beta / gamma  # (21), line 15
    root = b * b + c * c - a * a  # alphadot(t)^2 / gamma: real, of the sign of gamma or zero
    root = cmath.sqrt(max(root.real, 0.0) if gamma > 0.0 else min(root.real, 0.0))
    ratio = (root - c) / (a + b) if gamma > 0.0 else (-root - c) / (a + b)  # lines 16-19
    return max((cmath.log(ratio) / omega).real, 0.0)
