"""Runs of a campaign again, from its files, for the path of the CoM that the files do not hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from reference.evaluation.samples import Samples
from reference.tsid.controller import CONFIGURATIONS
from reference.tsid.robot import Contact, Robot, Sample, load
from reference.tsid.sampling import restore
from reference.tsid.simulator import Simulator
from reference.tsid.workers import Died, answers

ROBOT = "talos"

JOBS = 2


class Path(NamedTuple):
    """The CoM in one run of N - 1 steps."""

    outcome: str
    """As in the files; another processor than the file's may change one in a hundred."""
    t: Float[np.ndarray, " N"]
    """[s]"""
    com: Float[np.ndarray, "N 3"]
    """[m]"""


def sample_of(samples: Samples, row: int, model: pin.Model) -> Sample:
    """What was simulated: the sample of one row."""
    contacts = [
        Contact(str(effector), pin.SE3(rotation, position), float(length), float(width), float(friction))
        for effector, position, rotation, length, width, friction in zip(*(f[row] for f in samples.contacts), strict=True)
    ]
    q = restore(model, samples.q[row])
    return Sample(samples.scenario, samples.seed, int(samples.index[row]), q, samples.v[row], tuple(contacts))


def paths(samples: Samples, rows: Sequence[int], controllers: Sequence[str], jobs: int = JOBS) -> list[Path]:
    """The runs of these rows, each under its controller, in their order.

    Raises ArithmeticError naming a sample whose process died.
    """
    model = load(ROBOT).model
    runs = [(sample_of(samples, row, model), controller) for row, controller in zip(rows, controllers, strict=True)]
    found: list[Path | None] = [None] * len(runs)
    for number, answer in answers(_runner, (runs,), range(len(runs)), jobs):
        if isinstance(answer, Died):
            raise ArithmeticError(f"{samples.name}, sample {samples.index[rows[number]]}: {answer}")
        found[number] = answer
    return found


def _runner(runs: list[tuple[Sample, str]]) -> Callable[[int], Path]:
    """In a process of its own: simulates the run of a number."""
    robot: Robot = load(ROBOT)

    def run(number: int) -> Path:
        sample, controller = runs[number]
        done = Simulator(robot, CONFIGURATIONS[controller]).run(sample, trace=True)
        return Path(done.outcome.name.lower(), done.trace.t, done.trace.com)

    return run
