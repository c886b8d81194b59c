"""No verdict without a proof: a refusal is confirmed by a Farkas ray, an answer by its residual."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numba
import numpy as np
from scipy.optimize import linprog

from reference.tsid.solvers import SOLVERS, Answer, Problem, Solver, Status

MARGIN = 1e-6
"""Least violation that counts as one, of rows of norm 1: the solvers' own tolerance."""

RESIDUAL = 1e-5
"""Greatest violation of a row, of norm 1, by what counts as a solution."""

RADIUS = 1e5
"""A ray has to exclude all |y_i| up to this: 1e5 rad/s^2, or 1e8 N, far beyond what any robot does."""


INDEPENDENT = 1e-6
"""Singular values of a ray's rows below this share of the largest count as zero."""


class Certificate(NamedTuple):
    """Whether a problem was proved infeasible, and by how much."""

    infeasible: bool
    violation: float
    """Least possible greatest violation of a row, as the linear program found it."""
    proved: float
    """What the ray proves: no |y_i| <= RADIUS violates every row by less than this."""


def certify(problem: Problem) -> Certificate:
    """Phase 1: the least t such that lower - t <= matrix y <= upper + t, by HiGHS; its dual is a Farkas ray.

    A multiplier m_i, positive for the upper bound and negative for the lower, sum |m_i| = 1, proves of any y that some row
    is violated by at least m' matrix y - sum of m_i times its bound >= `proved`, computed from the multipliers alone.
    Infeasible is what is proved to be violated by more than MARGIN. The program always has a solution; should HiGHS not find
    it, nothing is proved.
    """
    matrix, lower, upper, _ = problem
    above, below = np.isfinite(upper), np.isfinite(lower)
    size = matrix.shape[1]
    program = np.concatenate([matrix[above], -matrix[below]])
    program = np.column_stack([program, -np.ones(len(program))])
    bounds = np.concatenate([upper[above], -lower[below]])
    cost = np.zeros(size + 1)
    cost[-1] = 1.0
    result = linprog(cost, A_ub=program, b_ub=bounds, bounds=[(None, None)] * size + [(0.0, None)], method="highs")
    if result.status != 0:
        return Certificate(False, np.nan, 0.0)
    multipliers = np.zeros(len(upper))
    multipliers[above] -= result.ineqlin.marginals[: above.sum()]
    multipliers[below] += result.ineqlin.marginals[above.sum() :]
    used = multipliers != 0.0
    # HiGHS balances the rows, m' matrix = 0, to 1e-10 or so; the nearest multipliers that balance them prove more.
    nearest = multipliers.copy()
    nearest[used] -= np.linalg.lstsq(matrix[used].T, multipliers[used] @ matrix[used], rcond=INDEPENDENT)[0]
    proved = max(_proved(problem, multipliers), _proved(problem, nearest))
    return Certificate(proved > MARGIN, float(result.fun), proved)


def _proved(problem: Problem, multipliers: np.ndarray) -> float:
    """What multipliers prove about all |y_i| <= RADIUS; those of bounds that do not exist are left out."""
    bound = np.where(multipliers > 0.0, problem.upper, problem.lower)
    exists = np.isfinite(bound) & (multipliers != 0.0)
    if not exists.any():
        return 0.0
    m = multipliers[exists] / np.abs(multipliers[exists]).sum()
    return float(-m @ bound[exists] - RADIUS * np.abs(m @ problem.matrix[exists]).sum())


class CertifiedSolver:
    """A solver whose INFEASIBLE is proved and whose OPTIMAL is feasible; FAILED is what nobody could settle.

    What the solver refuses, or answers badly, it is asked again from scratch. What it refuses again goes to `certify`; what
    that does not prove infeasible, to the other solver. `counters` has how often each happened: "refused" (warm), "badly"
    (answers with a residual), "again" (solved from scratch), "certified" (proved infeasible), "overturned" (infeasible said
    the solver, not so the proof), "other" (settled by the other solver), "unsolved".
    """

    def __init__(self, name: str) -> None:
        self._solver: Solver = SOLVERS[name]()
        self._other: Solver = next(solver for other, solver in SOLVERS.items() if other != name)()
        self.counters: Counter[str] = Counter()

    def solve(self, problem: Problem) -> Answer:
        answer = self._attempt(self._solver, problem)
        if answer.status == Status.OPTIMAL:
            return answer
        self.counters["refused"] += 1
        self._solver.forget()
        answer = self._attempt(self._solver, problem)
        if answer.status == Status.OPTIMAL:
            self.counters["again"] += 1
            return answer
        self._solver.forget()
        if certify(problem).infeasible:
            self.counters["certified"] += 1
            return answer._replace(status=Status.INFEASIBLE)
        self.counters["overturned"] += answer.status == Status.INFEASIBLE
        self._other.forget()
        answer = self._attempt(self._other, problem)
        self.counters["other" if answer.status == Status.OPTIMAL else "unsolved"] += 1
        return answer if answer.status == Status.OPTIMAL else answer._replace(status=Status.FAILED)

    def _attempt(self, solver: Solver, problem: Problem) -> Answer:
        """The solver's answer; FAILED where what it calls optimal violates a row by more than RESIDUAL."""
        answer = solver.solve(problem)
        if answer.status == Status.OPTIMAL and not _violation(*problem[:3], answer.y) <= RESIDUAL:
            self.counters["badly"] += 1
            return answer._replace(status=Status.FAILED)
        return answer


@numba.njit(cache=True)
def _violation(matrix, lower, upper, y):
    """Greatest violation of a row; not a number where y is none."""
    worst = 0.0
    for row in range(matrix.shape[0]):
        value = 0.0
        for j in range(matrix.shape[1]):
            value += matrix[row, j] * y[j]
        worst = max(worst, value - upper[row], lower[row] - value)
    return worst
