"""Two oracles that do not use the paper's algorithm.

`event_integration` integrates the accelerations of the LP (25) with SciPy's `solve_ivp` and watches for events: no
segment, no closed form. `speed_interval`, `discretised_stop` and `capturable_by_discretisation` discretise problem (12)
in time as a linear program: no walk, no case, and the velocity may change sign, so that C3.3 is covered.

Discretisation. The feasible (alpha, acc) polygon comes from the contacts by support LPs (`feasible_polygon`). On each
time step the acceleration is linear in time, so alpha is a cubic and t -> (alpha, acc) a cubic curve; it lies in the
hull of its four Bezier points, which are required to lie in the polygon. At the end the CoM rests in S, where it can
wait. So every solution satisfies (12) at all times, not just at the knots: a speed found capturable is capturable, to
the LP solver's tolerance. A speed not found capturable may still be, within an error that shrinks with the square of
the step and exponentially with the horizon. Splitting every step never loses a solution.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import linprog
from scipy.sparse import csr_array

from reference.contacts import GRAVITY, wrench_rays
from reference.linear_programs import line_program, line_terms, solve_acceleration

SOLVER = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}  # of HiGHS
RTOL, ATOL, MAX_STEP = 1e-8, 1e-9, 0.05  # of solve_ivp; final alpha and alphadot are good to 1e-5 [-; m, m/s; s]
SLOPE_STEP = 1e-6  # the slope of acc_min is a forward difference over this [m],
FLAT_SLOPE = 1e-6  # which is good to this [1/s^2]
LONGEST = 60.0  # event integration gives up after this long [s]
INSIDE = 1e-6  # a stop this close to S counts as in S, and an end of the polygon this close as reached [m]
FARTHEST, HARDEST = 10.0, 100.0  # the polygon is cut to |alpha| <= FARTHEST [m], |acc| <= HARDEST [m/s^2]
NEW_VERTEX = 1e-9  # a support point no farther than this beyond an edge lies on it [m or m/s^2]
SAME_VERTEX = 1e-7  # vertices this close are one [m or m/s^2]
HORIZON, STEPS = 6.0, 60  # default time to come to rest [s], and number of steps
GROWTH = 4.0  # the last time step is about exp(GROWTH) times the first [-]


class EventResult(NamedTuple):
    """How the event integration ended; cases as in `algorithm.Result`, capturable None in C3_3."""

    capturable: bool | None
    case: str
    alpha_final: float  # [m], of the braking pass, as is:
    alphadot_final: float  # [m/s]


class Stop(NamedTuple):
    """A motion to rest that satisfies (12)."""

    times: np.ndarray  # (steps + 1,) [s]
    alpha: np.ndarray  # (steps + 1,) [m]
    alphadot: np.ndarray  # (steps + 1,) [m/s]
    acc: np.ndarray  # (steps, 2) at the start and at the end of each step [m/s^2]


class SpeedInterval(NamedTuple):
    """Capturable speeds along a direction: [low, high], both attained; the true interval contains it."""

    low: float  # [m/s]
    high: float
    low_error: float  # bound on the distance to the true end, see `speed_interval` [m/s]
    high_error: float


class _Line:
    """The contacts seen along one line: support LPs over (alpha, acc, weights)."""

    def __init__(self, points, frames, friction, com, direction, sides=4, gravity=GRAVITY):
        direction = np.asarray(direction, float) / np.linalg.norm(direction)
        wrenches = wrench_rays(points, frames, friction, sides)
        per_acc, self.target, per_alpha = line_terms(com, direction, wrenches, gravity)
        self.matrix = np.column_stack([-per_alpha, -per_acc, wrenches.rays])
        self.program = line_program(com, direction, wrenches, gravity)

    def support(self, normal, hardest=HARDEST):
        """The feasible (alpha, acc) farthest along `normal`, (2,), with |acc| <= hardest; None if none is feasible."""
        cost, bounds = np.zeros(self.matrix.shape[1]), np.zeros((self.matrix.shape[1], 2))
        cost[:2], bounds[:, 1] = -np.asarray(normal), np.inf
        bounds[0], bounds[1] = (-FARTHEST, FARTHEST), (-hardest, hardest)
        for presolve in (True, False):
            result = linprog(
                cost, A_eq=self.matrix, b_eq=self.target, bounds=bounds, method="highs-ds",
                options={**SOLVER, "presolve": presolve},
            )  # fmt: skip
            if result.status in (0, 2):
                return result.x[:2] if result.status == 0 else None
        raise ArithmeticError(f"HiGHS gave no answer: {result.message}")

    def extent(self, hardest):
        """Least and greatest alpha [m] feasible with |acc| <= hardest; the static interval S for 0. None if empty."""
        low, high = self.support((-1.0, 0.0), hardest), self.support((1.0, 0.0), hardest)
        return None if low is None or high is None else (float(low[0]), float(high[0]))

    def acceleration(self, alpha, sign):
        """The least (sign = 1) or greatest (sign = -1) acceleration at alpha, by (25); nan if none is feasible."""
        result = solve_acceleration(self.program, alpha, sign)
        if result is None:
            return np.nan
        return -sign * np.inf if result.status == 3 else float(result.x[0])


def static_interval(points, frames, friction, com, direction, *, sides=4, gravity=GRAVITY):
    """S = [s_min, s_max] [m] on the line com + alpha direction, cut at +-FARTHEST; None if it is empty."""
    return _Line(points, frames, friction, com, direction, sides, gravity).extent(hardest=0.0)


def feasible_polygon(points, frames, friction, com, direction, *, sides=4, gravity=GRAVITY):
    """Rows (a, b, d) of a * acc + b * alpha <= d, the polygon of (11) cut to FARTHEST and HARDEST; None if empty.

    Found from outside by support LPs: an edge between two vertices is pushed outwards until it no longer moves.
    """
    return _polygon(_Line(points, frames, friction, com, direction, sides, gravity))


def _polygon(line: _Line):
    axes = [np.array(normal) for normal in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))]
    vertices = [line.support(normal) for normal in axes]
    if any(vertex is None for vertex in vertices):
        return None
    rows = [(*normal, normal @ vertex) for normal, vertex in zip(axes, vertices, strict=True)]
    edges = [(vertices[i], vertices[(i + 1) % 4]) for i in range(4)]  # anticlockwise
    while edges:
        first, second = edges.pop()
        length = np.linalg.norm(second - first)
        if length <= SAME_VERTEX:
            continue
        normal = np.array([second[1] - first[1], first[0] - second[0]]) / length
        vertex = line.support(normal)
        if normal @ vertex > normal @ first + NEW_VERTEX:
            edges += [(first, vertex), (vertex, second)]
        else:
            rows.append((*normal, normal @ vertex))
    b, a, d = np.array(rows).T
    return a, b, d


def event_integration(points, frames, friction, com, com_velocity, *, sides=4, gravity=GRAVITY) -> EventResult:
    """The paper's decision tree (its Fig. 3) by integration in time; arguments as `algorithm.is_state_capturable`."""
    speed = float(np.linalg.norm(com_velocity))
    line = _Line(points, frames, friction, com, com_velocity, sides, gravity)
    case, alpha, alphadot = _brake(line, speed)
    if case != "C3":
        return EventResult(False, case, alpha, alphadot)
    static = line.extent(hardest=0.0)
    if static is None:
        return EventResult(False, "EMPTY", alpha, 0.0)
    if alpha > static[1] + INSIDE:
        return EventResult(None, "C3_3", alpha, 0.0)
    if alpha >= static[0] - INSIDE:
        return EventResult(True, "C3_1", alpha, 0.0)
    reached = _reaches(line, speed, static[0])
    return EventResult(reached, "C3_2_1" if reached else "C3_2_2", alpha, 0.0)


def _brake(line: _Line, speed):
    """(case, alpha, alphadot) at the end of minimum acceleration: C1, C2, or C3 at rest."""
    extent = line.extent(hardest=np.inf)
    if extent is None or not extent[0] - INSIDE <= 0.0 < extent[1] - INSIDE:
        return "C2", 0.0, speed
    inner = (extent[0] + 1e-3 * INSIDE, extent[1] - 1e-3 * INSIDE)
    if line.acceleration(np.clip(0.0, *inner), 1.0) == -np.inf:
        return "C3", 0.0, 0.0

    def acceleration(alpha):
        return line.acceleration(np.clip(alpha, *inner), 1.0)

    def diverges(_, state):  # C1: acceleration and slope both at least 0
        acc, left = acceleration(state[0]), min(state[0], inner[1] - SLOPE_STEP)
        slope = (acceleration(left + SLOPE_STEP) - acceleration(left)) / SLOPE_STEP if acc >= 0.0 else -1.0
        return min(acc, slope + FLAT_SLOPE)

    if diverges(0.0, (0.0, speed)) >= 0.0:
        return "C1", 0.0, speed
    events = [_at_rest, lambda _, state: state[0] - extent[1], diverges]
    which, state = _integrate(acceleration, speed, events)
    return ("C3", "C2", "C1")[which], float(state[0]), float(state[1]) if which else 0.0


def _reaches(line: _Line, speed, s_min):
    """Whether maximum acceleration carries the CoM from alpha = 0 to s_min > 0 before it comes to rest."""

    def acceleration(alpha):
        return line.acceleration(np.clip(alpha, 0.0, s_min), -1.0)

    which, _ = _integrate(acceleration, speed, [_at_rest, lambda _, state: state[0] - s_min])
    return which == 1


def _at_rest(_, state):
    return state[1]


def _integrate(acceleration, speed, events):
    """The index of the first event and the state there; the first event falls through zero, the others rise."""
    for i, event in enumerate(events):
        event.terminal, event.direction = True, -1.0 if i == 0 else 1.0
    solution = solve_ivp(
        lambda _, state: (state[1], acceleration(state[0])),
        (0.0, LONGEST), (0.0, speed), events=events, rtol=RTOL, atol=ATOL, max_step=MAX_STEP,
    )  # fmt: skip
    for i, states in enumerate(solution.y_events):
        if len(states):
            return i, states[0]
    raise ArithmeticError(f"no event within {LONGEST} s: {solution.message}")


def speed_interval(
    points, frames, friction, com, direction, *, sides=4, gravity=GRAVITY, horizon=HORIZON, steps=STEPS
) -> SpeedInterval | None:
    """Least and greatest initial speed along `direction` from which (12) has a solution at rest after `horizon`.

    (12) is linear in the initial speed, so each is one LP. None if no speed is found capturable. An error is what
    the end changed by when the steps were halved (the order being two, about three times what is left), plus what
    it had gained when the horizon was doubled; inf if the motion found uses FARTHEST or HARDEST, where the polygon is
    cut. A true greatest speed that is infinite shows in one of the two.
    """
    line = _Line(points, frames, friction, com, direction, sides, gravity)
    polygon, static = _polygon(line), line.extent(hardest=0.0)
    if polygon is None or static is None:
        return None
    ends, errors = [], []
    for sign in (1.0, -1.0):
        grids = ((horizon, steps), (horizon, steps // 2), (0.5 * horizon, steps // 2))
        stops = [_solve_stop(polygon, static, _knots(*grid), cost=sign) for grid in grids]
        if stops[0] is None:
            return None
        fine, coarse, short = (np.inf * sign if stop is None else float(stop.alphadot[0]) for stop in stops)
        ends.append(fine)
        cut = max(np.abs(stops[0].acc).max() / HARDEST, np.abs(stops[0].alpha).max() / FARTHEST) > 1.0 - 1e-6
        gain = max(sign * (short - coarse), 0.0) if np.isfinite(coarse) else 0.0
        errors.append(np.inf if cut else abs(fine - coarse) + gain)
    return SpeedInterval(*ends, *errors)


def discretised_stop(
    points, frames, friction, com, com_velocity, horizon, steps, *, sides=4, gravity=GRAVITY
) -> Stop | None:
    """A solution of (12) at rest from `horizon` [s] on, in `steps` time steps; None if there is none."""
    line = _Line(points, frames, friction, com, com_velocity, sides, gravity)
    polygon, static = _polygon(line), line.extent(hardest=0.0)
    if polygon is None or static is None:
        return None
    return _solve_stop(polygon, static, _knots(horizon, steps), speed=float(np.linalg.norm(com_velocity)))


def capturable_by_discretisation(
    points, frames, friction, com, com_velocity, *, sides=4, gravity=GRAVITY, horizons=(1.5, 3.0, HORIZON), steps=STEPS
) -> bool:
    """Whether (12) has a solution for one of the horizons. True is a proof; False holds up to the error of a step.

    Having come to rest in S the CoM can wait, so a longer horizon loses nothing but the finer steps of a shorter one.
    """
    state = (points, frames, friction, com, com_velocity)
    return any(discretised_stop(*state, T, steps, sides=sides, gravity=gravity) is not None for T in horizons)


def _knots(horizon, steps):
    """Knot times (steps + 1,) [s], dense where the motion is fast; doubling `steps` keeps every knot."""
    return horizon * np.expm1(GROWTH * np.linspace(0.0, 1.0, steps + 1)) / np.expm1(GROWTH)


def _solve_stop(polygon, static, knots, speed=None, cost=0.0) -> Stop | None:
    """The LP. Unknowns: alpha (n+1), alphadot (n+1), acc at the start (n) and at the end (n) of each step.

    speed: initial speed, None if free (but nonnegative). cost: weight of the initial speed in the objective.
    """
    n, h_ = len(knots) - 1, np.diff(knots)[:, None]
    alpha, alphadot, first, last = np.split(np.eye(4 * n + 2), [n + 1, 2 * n + 2, 3 * n + 2])
    a, b, d = polygon
    equalities = np.vstack([
        alpha[1:] - alpha[:-1] - h_ * alphadot[:-1] - h_**2 * (first / 3.0 + last / 6.0),
        alphadot[1:] - alphadot[:-1] - h_ * (first + last) / 2.0,
    ])  # fmt: skip
    bezier = [
        (alpha[:-1], first),
        (alpha[:-1] + h_ * alphadot[:-1] / 3.0, (2.0 * first + last) / 3.0),
        (alpha[1:] - h_ * alphadot[1:] / 3.0, (first + 2.0 * last) / 3.0),
        (alpha[1:], last),
    ]
    inequalities = np.vstack([a_i * acc + b_i * place for place, acc in bezier for a_i, b_i in zip(a, b, strict=True)])
    bounds = np.tile([-np.inf, np.inf], (4 * n + 2, 1))
    bounds[0], bounds[n], bounds[2 * n + 1] = (0.0, 0.0), static, (0.0, 0.0)
    bounds[n + 1] = (0.0, np.inf) if speed is None else (speed, speed)
    # Infeasible states with fast dynamics are hard on the simplex, and a few feasible ones on the interior point.
    for method, presolve in product(("highs-ipm", "highs-ds"), (True, False)):
        result = linprog(
            cost * alphadot[0],
            A_ub=csr_array(inequalities), b_ub=np.tile(np.repeat(d, n), 4),
            A_eq=csr_array(equalities), b_eq=np.zeros(2 * n),
            bounds=bounds, method=method, options={"presolve": presolve},
        )  # fmt: skip
        if result.status == 2:
            return None
        if result.status == 0:
            places, speeds, starts, ends = np.split(result.x, [n + 1, 2 * n + 2, 3 * n + 2])
            return Stop(knots, places, speeds, np.column_stack([starts, ends]))
    raise ArithmeticError(f"HiGHS gave no answer: {result.message}")
