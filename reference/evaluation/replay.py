"""Runs of a campaign again, from its files, for the path of the CoM that the files do not hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from reference.evaluation.samples import Samples
from reference.tsid.controller import CONFIGURATIONS
from reference.tsid.robot import Robot, Sample, load
from reference.tsid.sampling import draw, place, restore
from reference.tsid.simulator import Simulator
from reference.tsid.workers import Died, answers

JOBS = 2


class Path(NamedTuple):
    """The CoM in one run of N - 1 steps."""

    outcome: str
    """As in the files; another processor than the file's may change one in a hundred."""
    t: Float[np.ndarray, " N"]
    """[s]"""
    com: Float[np.ndarray, "N 3"]
    """[m]"""


def sample_of(samples: Samples, row: int, robot: Robot) -> Sample:
    """What was simulated: the sample of one row, from q and v where the file holds them, else drawn again."""
    index, effectors = int(samples.index[row]), samples.contacts.effectors[row].tolist()
    if np.isnan(samples.q[row]).any():
        return draw(robot, samples.scenario, samples.seed, index, samples.zero_momentum)
    q = restore(robot.model, samples.q[row])
    contacts = place(robot, robot.model.createData(), q, effectors)
    return Sample(samples.scenario, samples.seed, index, q, samples.v[row], contacts)


def paths(samples: Samples, rows: Sequence[int], controllers: Sequence[str], jobs: int = JOBS) -> list[Path]:
    """The runs of these rows, each under its controller, in their order.

    Raises ArithmeticError naming a sample whose process died.
    """
    robot = load(samples.robot)
    runs = [(sample_of(samples, row, robot), controller) for row, controller in zip(rows, controllers, strict=True)]
    found: list[Path | None] = [None] * len(runs)
    for number, answer in answers(_runner, (samples.robot, runs), range(len(runs)), jobs):
        if isinstance(answer, Died):
            raise ArithmeticError(f"{samples.name}, sample {samples.index[rows[number]]}: {answer}")
        found[number] = answer
    return found


def _runner(name: str, runs: list[tuple[Sample, str]]) -> Callable[[int], Path]:
    """In a process of its own: simulates the run of a number."""
    robot: Robot = load(name)

    def run(number: int) -> Path:
        sample, controller = runs[number]
        done = Simulator(robot, CONFIGURATIONS[controller]).run(sample, trace=True)
        return Path(done.outcome.name.lower(), done.trace.t, done.trace.com)

    return run
