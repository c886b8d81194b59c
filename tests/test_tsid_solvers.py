"""Both solvers find the optimum of what is feasible; what is refused has a proof; no proof, no fall."""

import numpy as np
import pytest
from scipy.optimize import linprog

from reference.tsid.certificate import MARGIN, CertifiedSolver, certify
from reference.tsid.controller import CONFIGURATIONS, Controller
from reference.tsid.robot import load
from reference.tsid.sampling import draw
from reference.tsid.solvers import SOLVERS, Answer, Daqp, Problem, Proxqp, Status

both = pytest.mark.parametrize("solver", [Daqp, Proxqp])


def random_problem(seed, infeasible=0.0):
    """Rows of norm 1, some of them equalities, around a known feasible point.

    infeasible: how far two opposite half-spaces are apart, if they are; the least violation is half of it or more.
    """
    rng = np.random.default_rng(seed)
    size, rows, equal = 20, 50, 6
    matrix = rng.standard_normal((rows, size))
    matrix /= np.linalg.norm(matrix, axis=1, keepdims=True)
    inside = rng.standard_normal(size)
    lower, upper = matrix @ inside - rng.random(rows), matrix @ inside + rng.random(rows)
    lower[:equal] = upper[:equal] = matrix[:equal] @ inside
    upper[equal : equal + 10] = np.inf
    lower[-10:] = -np.inf
    if infeasible > 0.0:
        matrix[-1] = matrix[20]
        lower[-1], upper[-1] = -np.inf, lower[20] - infeasible
    return Problem(np.ascontiguousarray(matrix), lower, upper, 10.0 * rng.standard_normal(size))


def assert_optimal(problem, y, tolerance):
    """The conditions of Karush, Kuhn and Tucker, the multipliers found by a linear program."""
    values = problem.matrix @ y
    assert (values <= problem.upper + tolerance).all() and (values >= problem.lower - tolerance).all()
    at_upper, at_lower = values >= problem.upper - 1e-4, values <= problem.lower + 1e-4
    normals = np.concatenate([problem.matrix[at_upper], -problem.matrix[at_lower]])
    pull = problem.target - y  # has to be a nonnegative sum of the active rows' outward normals
    size = len(y)
    program = np.block([[normals.T, -np.ones((size, 1))], [-normals.T, -np.ones((size, 1))]])
    cost = np.append(np.zeros(len(normals)), 1.0)
    result = linprog(cost, A_ub=program, b_ub=np.concatenate([pull, -pull]), bounds=(0.0, None), method="highs")
    assert result.fun < 1e-3


@both
def test_the_optimum_of_a_sequence_of_problems(solver):
    """Warm-started by unrelated problems."""
    one = solver()
    for seed in range(10):
        problem = random_problem(seed)
        answer = one.solve(problem)
        assert answer.status == Status.OPTIMAL
        assert_optimal(problem, answer.y, 1e-5)


def test_both_solvers_agree():
    for seed in range(20):
        problem = random_problem(seed)
        first, second = (solver().solve(problem).y for solver in (Daqp, Proxqp))
        np.testing.assert_allclose(first, second, atol=1e-3)


@pytest.mark.parametrize("gap", [1e-4, 1e-2, 1.0])
def test_what_is_infeasible_is_proved_so(gap):
    for seed in range(10):
        certificate = certify(random_problem(seed, gap))
        assert certificate.infeasible
        # the least violation of the two half-spaces alone is gap / 2; other rows can only add to it
        assert certificate.proved >= 0.49 * gap
        assert certificate.proved <= certificate.violation + 1e-7


def test_what_is_feasible_is_never_proved_infeasible():
    for seed in range(20):
        certificate = certify(random_problem(seed))
        assert not certificate.infeasible and certificate.proved <= MARGIN


def test_a_gap_within_the_tolerance_is_no_proof():
    assert not certify(random_problem(3, 1e-7)).infeasible


@both
def test_neither_solver_calls_the_infeasible_optimal(solver):
    """ProxQP need not find the infeasibility within its iterations; it may not find a solution."""
    for seed in range(10):
        assert solver().solve(random_problem(seed, 0.1)).status != Status.OPTIMAL


def test_daqp_finds_the_infeasibility():
    for seed in range(10):
        assert Daqp().solve(random_problem(seed, 0.1)).status == Status.INFEASIBLE


@pytest.mark.parametrize("name", sorted(SOLVERS))
def test_certified_verdicts(name):
    solver = CertifiedSolver(name)
    for seed in range(6):
        assert solver.solve(random_problem(seed)).status == Status.OPTIMAL
        assert solver.solve(random_problem(seed, 0.1)).status == Status.INFEASIBLE
    assert solver.counters["certified"] == 6 and solver.counters["unsolved"] == 0


class Liar:
    """Says what it is told to."""

    def __init__(self, *statuses):
        self.statuses = list(statuses)

    def forget(self):
        pass

    def solve(self, problem):
        return Answer(self.statuses.pop(0), np.zeros(len(problem.target)), 1)


def certified(first, other):
    solver = CertifiedSolver("daqp")
    solver._solver, solver._other = first, other
    return solver


def test_a_false_infeasibility_is_overturned_by_the_other_solver():
    solver = certified(Liar(Status.INFEASIBLE, Status.INFEASIBLE), Proxqp())
    problem = random_problem(1)
    answer = solver.solve(problem)
    assert answer.status == Status.OPTIMAL
    assert_optimal(problem, answer.y, 1e-5)
    assert solver.counters == {"refused": 1, "overturned": 1, "other": 1}


def test_a_feasible_problem_that_nobody_solves_is_not_infeasible():
    solver = certified(Liar(Status.INFEASIBLE, Status.FAILED), Liar(Status.INFEASIBLE))
    assert solver.solve(random_problem(1)).status == Status.FAILED
    assert solver.counters["unsolved"] == 1


def test_a_failure_is_proved_infeasible_where_it_is():
    solver = certified(Liar(Status.FAILED, Status.FAILED), Liar())
    assert solver.solve(random_problem(1, 0.1)).status == Status.INFEASIBLE


def test_a_bad_answer_is_not_an_answer():
    """Zero is no solution of a problem whose equalities are not met there."""
    solver = certified(Liar(Status.OPTIMAL, Status.OPTIMAL), Daqp())
    assert_optimal(random_problem(2), solver.solve(random_problem(2)).y, 1e-5)
    assert solver.counters == {"refused": 1, "badly": 2, "overturned": 0, "other": 1}


def test_a_warm_refusal_is_retried_from_scratch():
    class Tired(Daqp):
        """Refuses until told to forget."""

        fresh = False

        def forget(self):
            super().forget()
            self.fresh = True

        def solve(self, problem):
            return super().solve(problem) if self.fresh else Answer(Status.INFEASIBLE, problem.target, 1)

    solver = certified(Tired(), Liar())
    assert solver.solve(random_problem(4)).status == Status.OPTIMAL
    assert solver.counters == {"refused": 1, "again": 1}


def test_the_controllers_problems_have_one_optimum():
    """On the robot's own problems: the solvers agree on accelerations and on what has no solution."""
    robot = load("talos")
    decided = set()
    for scenario in ("two", "three", "four"):
        for index in range(4):
            sample = draw(robot, scenario, 9, index)
            controller = Controller(robot, CONFIGURATIONS["standard"], sample, 1e-3)
            problem = controller.problem_at(sample.q, sample.v)
            first, second = CertifiedSolver("daqp").solve(problem), CertifiedSolver("proxqp").solve(problem)
            assert first.status == second.status != Status.FAILED
            decided.add(first.status)
            if first.status == Status.OPTIMAL:
                one, two = controller.command(first.y), controller.command(second.y)
                np.testing.assert_allclose(one.acceleration, two.acceleration, atol=0.05)
    assert Status.OPTIMAL in decided
