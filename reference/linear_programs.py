"""The optimisation problems of the paper, by trusted solvers: (16) by ProxQP, (25)-(29) by SciPy's HiGHS.

Forces are weights on the pyramid edges (see `contacts`), so with x = (acc, weights) the constraints of (25) read
``matrix @ x = constant + alpha * slope``, ``weights >= 0``. All is per unit mass: the mass cancels, the cone being
homogeneous. `com`, `direction` and the contacts are in one inertial frame; moments are about the contacts' centroid.

Beyond the paper, whose angular momentum is constant: `spin`, the state's angular momentum about the CoM over mass and speed
[m], comes to rest in proportion to the speed, L / m = spin * alphadot; so its rate is spin * acc, a moment beside c x v.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import proxsuite
from scipy.optimize import linprog

from reference.contacts import GRAVITY, Wrenches

NO_SPIN = (0.0, 0.0, 0.0)  # [m]
SOLVER = 1e-10  # HiGHS primal and dual feasibility, the least it takes [m/s^2, and -]
RANK = 1e-9  # singular values below this share of the largest count as zero [-]
FLAT_CONE = 1e-9  # a wrench this close to the span of a flat cone counts as inside it, share of gravity [-]
ACTIVE = 1e-8  # weights below this are at their bound: the vertex is degenerate [m/s^2]
DUAL = 1e-9  # an active set is optimal if its multipliers violate no ray by more [-]
CONDITION = 1e9  # largest condition number of K in (27) for which it is inverted [-]
ONE_SIDED_STEP = 1e-8  # where two pieces meet, the right one is looked up this far to the right [m]
FLAT_SLOPE = 1e-8  # |gamma| below this counts as zero [1/s^2]; see `algorithm.integrate_lds`
QP_PRECISION = 1e-12  # ProxQP's eps_abs on (16) scaled by gravity [-]; its alpha then is within 1e-8 m
QP_INFEASIBLE = 1e-6  # a certificate that (16) is infeasible may miss by this; tighter, ProxQP may not end [-]


class LineProgram(NamedTuple):
    """The constraints of (25) along one line, redundant rows removed."""

    matrix: np.ndarray  # (r, 1 + n): columns of the acceleration and of the weights
    constant: np.ndarray  # (r,)
    slope: np.ndarray  # (r,)
    lowest: float  # a flat cone (r < 6) may allow one alpha only [m], else -inf, inf
    highest: float


class Segment(NamedTuple):
    """acc(alpha) = beta + gamma * alpha from the alpha asked for to `alpha_bar`, (26)."""

    feasible: bool  # False: no acceleration is feasible just right of alpha (C2)
    beta: float  # [m/s^2]; -inf (+inf) if the acceleration is unbounded below (above)
    gamma: float  # [1/s^2]
    alpha_bar: float  # [m], may be inf


INFEASIBLE = Segment(False, np.nan, np.nan, np.nan)


def line_terms(com, direction, wrenches: Wrenches, gravity=GRAVITY, spin=NO_SPIN):
    """Wrench (6,) per unit mass along the line: acc * per_acc + constant + alpha * per_alpha, from (10) in (3).

    The sum of moments about the origin is the rate of c x m cdot + L, less that of gravity: the last term of per_acc is L's.
    """
    com, gravity = np.asarray(com, float) - wrenches.origin, np.asarray(gravity, float)
    per_acc = np.concatenate([direction, np.cross(com, direction) + spin])  # m v for the m I3 printed in (25)
    constant = np.concatenate([-gravity, np.cross(gravity, com)])
    per_alpha = np.concatenate([np.zeros(3), np.cross(gravity, direction)])
    return per_acc, constant, per_alpha


def line_program(com, direction, wrenches: Wrenches, gravity=GRAVITY, spin=NO_SPIN) -> LineProgram:
    """Constraints of (25) on the line com + alpha direction; `direction` a unit vector (3,)."""
    per_acc, constant, per_alpha = line_terms(com, direction, wrenches, gravity, spin)
    return _without_redundant_rows(*_with_box(np.column_stack([-per_acc, wrenches.rays]), constant, per_alpha, wrenches.box))


def _with_box(matrix, constant, slope, box):
    """The rows with a moment besides, each component in [-box, box]: y = p - box with p + q = 2 box, p and q >= 0."""
    if box == 0.0:
        return matrix, constant, slope
    moments = np.eye(6)[:, 3:]
    above = np.column_stack([matrix, -moments, np.zeros((6, 3))])
    sums = np.column_stack([np.zeros((3, matrix.shape[1])), np.eye(3), np.eye(3)])
    constant = np.concatenate([constant - box * moments.sum(axis=1), np.full(3, 2.0 * box)])
    return np.vstack([above, sums]), constant, np.concatenate([slope, np.zeros(3)])


def _without_redundant_rows(matrix, constant, slope) -> LineProgram:
    left, values, _ = np.linalg.svd(matrix, full_matrices=True)
    rank = int(np.sum(values > RANK * values[0]))
    keep, null = left[:, :rank].T, left[:, rank:].T
    lowest, highest = -np.inf, np.inf
    tolerance = FLAT_CONE * np.linalg.norm(constant)
    fixed, moving = null @ constant, null @ slope  # must be fixed + alpha moving = 0
    if np.linalg.norm(moving) > tolerance:
        lowest = highest = -(moving @ fixed) / (moving @ moving)
        fixed = fixed + lowest * moving
    if np.linalg.norm(fixed) > tolerance:
        lowest, highest = np.inf, -np.inf
    return LineProgram(keep @ matrix, keep @ constant, keep @ slope, lowest, highest)


def solve(cost, matrix, target):
    """minimise cost @ x, matrix @ x = target, x[0] free, x[1:] >= 0.

    Returns SciPy's result with status 0 (optimal), 2 (infeasible) or 3 (unbounded); a basic solution if optimal.
    Raises ArithmeticError if HiGHS gives no answer.
    """
    bounds = np.zeros((matrix.shape[1], 2))
    bounds[0, 0], bounds[:, 1] = -np.inf, np.inf
    options = {"primal_feasibility_tolerance": SOLVER, "dual_feasibility_tolerance": SOLVER}
    for presolve in (True, False):  # presolve may answer "unbounded or infeasible" (status 4)
        result = linprog(
            cost, A_eq=matrix, b_eq=target, bounds=bounds, method="highs-ds", options={**options, "presolve": presolve}
        )
        if result.status in (0, 2, 3):
            return result
    raise ArithmeticError(f"HiGHS gave no answer: {result.message}")


def solve_acceleration(program: LineProgram, alpha, sign=1.0):
    """LP (25) at one alpha: the least acceleration (sign = 1) or the greatest (sign = -1), as SciPy's result.

    `fun` is sign * acceleration. None if no acceleration is feasible.
    """
    if not program.lowest - FLAT_CONE <= alpha <= program.highest + FLAT_CONE:
        return None
    cost = np.zeros(program.matrix.shape[1])
    cost[0] = sign
    result = solve(cost, program.matrix, program.constant + alpha * program.slope)
    return None if result.status == 2 else result


def compute_min_acc(com, alpha, direction, wrenches: Wrenches, gravity=GRAVITY, spin=NO_SPIN) -> Segment:
    """Least acceleration just right of `alpha` [m] as an affine function of alpha, and how far it holds.

    Unbounded below (the contacts can push against the motion as hard as they like): beta = -inf, the robot can stop
    at once; this does not depend on alpha, so alpha_bar = inf. Infeasible just right of alpha: `feasible` is False.
    """
    return _segment(line_program(com, direction, wrenches, gravity, spin), alpha, 1.0)


def compute_max_acc(com, alpha, direction, wrenches: Wrenches, gravity=GRAVITY, spin=NO_SPIN) -> Segment:
    """Greatest acceleration just right of `alpha` [m]; as `compute_min_acc`, unbounded above: beta = +inf."""
    return _segment(line_program(com, direction, wrenches, gravity, spin), alpha, -1.0)


def _segment(program: LineProgram, alpha, sign) -> Segment:
    """The piece to the right of alpha: from the active set if that is regular, else from the multipliers.

    Where two pieces meet, and at the ends of the polygon, the optimum is degenerate and its active set may belong to
    either side; so the LP is then solved once more, ONE_SIDED_STEP to the right. Either way the line returned is a
    lower bound of sign * acc everywhere (its multipliers are dual feasible) and feasible up to alpha_bar.
    """
    if program.highest < alpha + ONE_SIDED_STEP:
        return INFEASIBLE
    for shift in (0.0, ONE_SIDED_STEP):
        result = solve_acceleration(program, alpha + shift, sign)
        if result is None:
            return INFEASIBLE
        if result.status == 3:
            return Segment(True, -sign * np.inf, 0.0, np.inf)
        segment = _from_active_set(program, result.x, sign)
        if segment is not None and segment.alpha_bar > alpha + ONE_SIDED_STEP:
            return _flattened(segment, alpha)
    return _flattened(_from_multipliers(program, result.eqlin.marginals, alpha, sign), alpha)


def _from_active_set(program: LineProgram, x, sign) -> Segment | None:
    """(27)-(29). The inequalities weights >= 0 that are active drop out of K x = k1 alpha + k2, with their columns."""
    basic = np.concatenate([[0], 1 + np.flatnonzero(x[1:] > ACTIVE)])
    if len(basic) != program.matrix.shape[0]:
        return None  # degenerate: K is not square, whatever the paper says
    active = program.matrix[:, basic]  # K
    if np.linalg.cond(active) > CONDITION:
        return None
    intercept, rate = np.linalg.solve(active, np.column_stack([program.constant, program.slope])).T  # (28)
    multipliers = np.linalg.solve(active.T, sign * np.eye(len(basic))[0])
    if np.max(multipliers @ program.matrix[:, 1:]) > DUAL * max(1.0, np.abs(multipliers).max()):
        return None
    falling = rate[1:] < 0.0
    ends = -intercept[1:][falling] / rate[1:][falling]  # (29): intercept + rate alpha >= 0
    return Segment(True, intercept[0], rate[0], float(ends.min(initial=np.inf)))


def _from_multipliers(program: LineProgram, multipliers, alpha, sign) -> Segment:
    """The line of slope d acc / d alpha given by LP duality; it holds as far as points on it are feasible, an LP too.

    The second LP maximises alpha over (alpha, weights) with the acceleration on the line.
    """
    beta = sign * float(multipliers @ program.constant)
    gamma = sign * float(multipliers @ program.slope)
    matrix = program.matrix.copy()
    matrix[:, 0] = gamma * program.matrix[:, 0] - program.slope
    cost = np.zeros(matrix.shape[1])
    cost[0] = -1.0
    result = solve(cost, matrix, program.constant - beta * program.matrix[:, 0])
    if result.status == 2:
        raise ArithmeticError(f"no point of the piece acc = {beta} + {gamma} alpha at alpha = {alpha} is feasible")
    alpha_bar = np.inf if result.status == 3 else max(float(result.x[0]), alpha + ONE_SIDED_STEP)
    return Segment(True, beta, gamma, min(alpha_bar, program.highest))


def _flattened(segment: Segment, alpha) -> Segment:
    """Slopes within rounding of zero are made zero, keeping the value at alpha."""
    if abs(segment.gamma) > FLAT_SLOPE:
        return segment
    return segment._replace(beta=segment.beta + segment.gamma * alpha, gamma=0.0)


def compute_closest_static_alpha(com, alpha, direction, wrenches: Wrenches, gravity=GRAVITY):
    """QP (16): the alpha closest to `alpha` [m] at which zero acceleration is feasible; None if there is none.

    Accurate to about 1e-8 m (QP_PRECISION bounds the residuals, not alpha).
    Raises ArithmeticError if ProxQP neither solves the QP nor proves it infeasible.
    """
    _, constant, slope = line_terms(com, direction, wrenches, gravity)
    scale = np.linalg.norm(gravity)
    rows = np.column_stack([-slope / scale, wrenches.rays]), constant / scale, 0.0 * slope
    program = _without_redundant_rows(*_with_box(*rows, wrenches.box / scale))
    if program.highest < program.lowest:
        return None
    size = program.matrix.shape[1]
    hessian, linear, rows = np.zeros((size, size)), np.zeros(size), np.eye(size)[1:]
    hessian[0, 0], linear[0] = 1.0, -alpha
    problem = proxsuite.proxqp.dense.QP(size, program.matrix.shape[0], size - 1)
    problem.settings.eps_abs, problem.settings.eps_rel = QP_PRECISION, 0.0
    problem.settings.eps_primal_inf = QP_INFEASIBLE
    problem.init(hessian, linear, program.matrix, program.constant, rows, np.zeros(size - 1), np.full(size - 1, 1e20))
    problem.solve()
    status = problem.results.info.status
    if status == proxsuite.proxqp.PROXQP_SOLVED:
        return float(problem.results.x[0])
    if status == proxsuite.proxqp.PROXQP_PRIMAL_INFEASIBLE:
        return None
    raise ArithmeticError(f"ProxQP gave no answer: {status}")
