"""A simulator that takes no time: outcomes from the sample's numbers, and failures on demand."""

import enum
import os
import time
from typing import NamedTuple

import numpy as np

CONFIGURATIONS = {"standard": 0.3, "straight": 0.5, "fast": 0.6, "brake": 0.7, "straight_up": 1.0}
"""Each stops the robots whose number is less than this."""


class Outcome(enum.Enum):
    STOPPED = 0
    FALLEN = 1
    UNDECIDED = 2


class Options(NamedTuple):
    delay: float = 0.0
    """Of a run [s]."""
    raises_at: int = -1
    """Index of the sample at which a run raises."""
    dies_at: int = -1
    """Index of the sample at which a run kills its process."""


class Run(NamedTuple):
    outcome: Outcome
    reason: str
    time: float
    steps: int
    counters: dict
    trace: None = None


class Simulator:
    def __init__(self, robot, configuration, options=None):
        if options and not options.delay >= 0:
            raise ValueError(f"delay = {options.delay} (expected at least 0)")
        self.robot, self.stops_below, self.options = robot, configuration, options or Options()

    def run(self, sample, trace=False):
        time.sleep(self.options.delay)
        if sample.index == self.options.raises_at:
            raise ArithmeticError(f"sample {sample.index} is not to my taste")
        if sample.index == self.options.dies_at:
            os.abort()
        number = float(np.abs(sample.v).sum()) % 1.0
        outcome = Outcome.STOPPED if number < self.stops_below else (Outcome.FALLEN, Outcome.UNDECIDED)[sample.index % 2]
        steps = int(3000 * number)
        return Run(outcome, "because", steps * 1e-3, steps, {"refusals": 1} if steps % 2 else {})
