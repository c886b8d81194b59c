"""A robot's limits by linear programs: what its contacts and joints can do together, one state at a time, by SciPy's HiGHS.

Per unit mass, with the state's own angular momentum L about the CoM, l = L / |cdot|, and C the joints on a path from the
base to a contact:

    R lambda - (0; y) = (v; c x v + l/m) accel + (0; g x v) alpha + (-g; -c x g)      lambda >= 0, |y| <= box
    tau + Q lambda    = gravity_torque,   Q = (J' G)_C,                               |tau| <= limit

R are the wrenches of the pyramids' edges G, c the CoM relative to the contacts' centroid. Written down plainly: every
question is a program of its own, and the speed is found by cutting the convex acc_min(alpha) into its pieces.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

from reference.contacts import GRAVITY, pyramid_edges, wrench_rays

SOLVER = 1e-10
"""HiGHS's primal and dual feasibility."""
MEETS = 1e-9
"""Where two tangents of acc_min meet, it is on both if it is no more than this above [m/s^2]."""
SHORTEST = 1e-7
"""Two places this near each other are not cut any further [m]."""
FARTHEST = 1e3
"""Alphas beyond this are not asked for [m]."""


class Limits(NamedTuple):
    """What a robot's joints can bear in one posture, per unit mass."""

    jacobians: np.ndarray  # (k, 3, n): velocities of the contact points over joint speeds
    gravity_torque: np.ndarray  # (n,) [N m/kg]
    limit: np.ndarray  # (n,) [N m/kg]
    mask: np.ndarray  # (n,): joints that count


class State(NamedTuple):
    """The rows of one state: columns @ (lambda, y, tau) = per_acc * accel + per_alpha * alpha + constant."""

    columns: np.ndarray
    rays: int  # of the columns, so many are edges' weights
    per_acc: np.ndarray
    per_alpha: np.ndarray
    constant: np.ndarray
    bounds: np.ndarray  # (columns, 2)


class Tangent(NamedTuple):
    """acc_min at a place, and how it changes there."""

    alpha: float
    value: float  # [m/s^2]
    slope: float  # [1/s^2]


def state_of(points, frames, friction, com, velocity, limits: Limits, spin=(0, 0, 0), box=0.0, sides=4, gravity=GRAVITY):
    """The rows of one state. spin: L / m [m^2/s]. box: on |y| [m^2/s^2]."""
    wrenches = wrench_rays(points, frames, friction, sides)
    edges = pyramid_edges(frames, friction, sides)
    speed = np.linalg.norm(velocity)
    along, c, g = np.asarray(velocity) / speed, np.asarray(com) - wrenches.origin, np.asarray(gravity, float)
    joints = np.flatnonzero(limits.mask)
    jacobians = np.asarray(limits.jacobians)[:, :, joints]
    torques = np.concatenate([jacobian.T @ edge.T for jacobian, edge in zip(jacobians, edges, strict=True)], axis=1)
    n, rays = len(joints), wrenches.rays.shape[1]
    columns = np.zeros((6 + n, rays + 3 + n))
    columns[:6, :rays], columns[6:, :rays] = wrenches.rays, torques
    columns[3:6, rays : rays + 3] = -np.eye(3)
    columns[6:, rays + 3 :] = np.eye(n)
    limit = np.asarray(limits.limit)[joints]
    bounds = np.zeros((columns.shape[1], 2))
    bounds[:rays, 1] = np.inf
    bounds[rays:, 1] = np.concatenate([np.full(3, box), limit])
    bounds[rays:, 0] = -bounds[rays:, 1]
    nothing = np.zeros(n)
    return State(
        columns,
        rays,
        np.concatenate([along, np.cross(c, along) + np.asarray(spin) / speed, nothing]),
        np.concatenate([np.zeros(3), np.cross(g, along), nothing]),
        np.concatenate([-g, -np.cross(c, g), np.asarray(limits.gravity_torque)[joints]]),
        bounds,
    )


def _solve(cost, matrix, target, bounds):
    """SciPy's result with status 0 (optimal), 2 (infeasible) or 3 (unbounded). Raises ArithmeticError without an answer."""
    options = {"primal_feasibility_tolerance": SOLVER, "dual_feasibility_tolerance": SOLVER}
    for presolve in (True, False):
        result = linprog(
            cost, A_eq=matrix, b_eq=target, bounds=bounds, method="highs-ds", options={**options, "presolve": presolve}
        )
        if result.status in (0, 2, 3):
            return result
    raise ArithmeticError(f"HiGHS gave no answer: {result.message}")


def _with_free(state: State, *free, bounds=None):
    """Matrix and bounds with these columns before the others, unbounded unless said."""
    matrix = np.column_stack([*(-column for column in free), state.columns])
    own = [(-np.inf, np.inf)] * len(free) if bounds is None else bounds
    return matrix, np.concatenate([np.array(own, float).reshape(-1, 2), state.bounds])


def least_acceleration(state: State, alpha: float) -> Tangent | None:
    """acc_min at alpha and its slope there; -inf where nothing bounds it; None where no acceleration is feasible."""
    matrix, bounds = _with_free(state, state.per_acc)
    result = _solve(np.eye(matrix.shape[1])[0], matrix, state.constant + alpha * state.per_alpha, bounds)
    if result.status == 2:
        return None
    if result.status == 3:
        return Tangent(alpha, -np.inf, 0.0)
    return Tangent(alpha, float(result.fun), float(result.eqlin.marginals @ state.per_alpha))


def farthest(state: State, highest_acceleration: float = np.inf, sign: float = 1.0) -> float:
    """The largest alpha (sign 1; -1: the smallest) of the polygon with no more than this acceleration [m]; NaN if none."""
    matrix, bounds = _with_free(
        state, state.per_alpha, state.per_acc, bounds=[(-FARTHEST, FARTHEST), (-np.inf, highest_acceleration)]
    )
    result = _solve(-sign * np.eye(matrix.shape[1])[0], matrix, state.constant, bounds)
    if result.status == 2:
        return np.nan
    found = sign * np.inf if result.status == 3 else float(result.x[0])
    return found if abs(found) < 0.999 * FARTHEST else np.copysign(np.inf, found)


def static_interval(state: State) -> tuple[float, float]:
    """The alphas at which zero acceleration is feasible [m]; (inf, -inf) if there are none."""
    still = state._replace(per_acc=0 * state.per_acc)
    ends = farthest(still, sign=-1.0), farthest(still)
    return (np.inf, -np.inf) if np.isnan(ends[0]) else ends


def effort(state: State) -> float:
    """Least share of the limits with which the robot stands still where it is, without y; infinite if no torques do."""
    torques = state.columns[:, state.rays + 3 :]
    limit = state.bounds[state.rays + 3 :, 1]
    # |tau| <= t limit as tau = t limit - slack, and slack <= 2 t limit: with a slack of its own.
    n, rays = len(limit), state.columns[:, : state.rays]
    size = 1 + state.rays + 2 * n
    matrix = np.zeros((len(rays) + n, size))
    matrix[: len(rays), 0] = torques @ limit
    matrix[: len(rays), 1 : 1 + state.rays] = rays
    matrix[: len(rays), 1 + state.rays : 1 + state.rays + n] = -torques
    matrix[len(rays) :, 0] = 2 * limit
    matrix[len(rays) :, 1 + state.rays :] = np.hstack([-np.eye(n), -np.eye(n)])
    target = np.concatenate([state.constant, np.zeros(n)])
    bounds = np.column_stack([np.zeros(size), np.full(size, np.inf)])
    result = _solve(np.eye(size)[0], matrix, target, bounds)
    return np.inf if result.status == 2 else float(result.x[0])


def pieces(state: State, first: Tangent, last: Tangent) -> list[Tangent]:
    """Tangents of acc_min at the kinks between two places, by cutting where the tangents meet."""
    apart = last.alpha - first.alpha
    bend = last.slope - first.slope
    if apart <= SHORTEST or bend <= 0:
        return [first, last]
    meet = (first.value - last.value - first.slope * first.alpha + last.slope * last.alpha) / bend
    meet = float(np.clip(meet, first.alpha, last.alpha))
    below = first.value + first.slope * (meet - first.alpha)
    middle = least_acceleration(state, meet)
    if middle is None or middle.value <= below + MEETS or min(meet - first.alpha, last.alpha - meet) <= SHORTEST:
        return [first, Tangent(meet, below, last.slope), last]
    return pieces(state, first, middle) + pieces(state, middle, last)[1:]


def max_speed(state: State) -> float:
    """Largest speed that maximum deceleration brings to rest anywhere on the line [m/s], as `stops` in C1 and C2.

    It is sqrt(-2 min over [0, end] of the integral of acc_min); the end is where acc_min turns positive, or the polygon's.
    """
    first = least_acceleration(state, 0.0)
    if first is None:
        return 0.0
    if first.value == -np.inf:
        return np.inf if farthest(state) > 0 else 0.0
    end = farthest(state, 0.0)
    if np.isnan(end) or end <= 0:
        return 0.0
    if end == np.inf:
        return np.inf
    last = least_acceleration(state, end)
    if last is None:  # by rounding, beyond the end
        last = least_acceleration(state, end - SHORTEST)
    assert last is not None
    knots = pieces(state, first, last)
    energy, least = 0.0, 0.0
    for one, other in itertools.pairwise(knots):
        energy += (other.alpha - one.alpha) * (one.value + other.value) / 2
        least = min(least, energy)
    return float(np.sqrt(-2 * least))


def min_speed(state: State, s_min: float) -> float:
    """Smallest speed that reaches a static region ahead at s_min > 0 [m/s]: by the largest acceleration."""
    turned = state._replace(per_acc=-state.per_acc)
    first, last = least_acceleration(turned, 0.0), least_acceleration(turned, s_min - SHORTEST)
    if first is None or last is None or not (np.isfinite(first.value) and np.isfinite(last.value)):
        return np.nan
    knots = pieces(turned, first, last)
    gained = sum((b.alpha - a.alpha) * (a.value + b.value) / 2 for a, b in itertools.pairwise(knots))
    return float(np.sqrt(max(0.0, 2 * gained)))
