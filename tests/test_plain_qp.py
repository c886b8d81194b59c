"""The baseline of the simulator's benchmark solves the same problem as the simulator."""

import numpy as np
import pytest

from bench.plain_qp import PlainQP
from reference.tsid.controller import CONFIGURATIONS, Controller
from reference.tsid.robot import load
from reference.tsid.sampling import SCENARIOS, draw
from reference.tsid.solvers import Daqp, Status


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_baseline_commands_the_same_accelerations(scenario):
    robot = load("talos")
    sample = draw(robot, scenario, 5, 0)
    sample = sample._replace(v=0.3 * sample.v)
    controller = Controller(robot, CONFIGURATIONS["standard"], sample, 1e-3)
    answer = Daqp().solve(controller.problem_at(sample.q, sample.v))
    assert answer.status == Status.OPTIMAL
    expected = controller.command(answer.y).acceleration
    plain = PlainQP(robot, sample, 1e-3)
    problem = plain.assemble(sample.q, sample.v)
    for warm in (False, True):
        solved, acceleration = plain.solve(problem, warm)
        assert solved
        np.testing.assert_allclose(acceleration, expected, atol=2e-3 * np.abs(expected).max())
