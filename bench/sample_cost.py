"""What a sample of the campaign costs, beside another version of the code: the same samples, drawn and labelled by both.

    git worktree add --detach /tmp/before COMMIT
    python -m bench.sample_cost --before /tmp/before [--samples N] [--scenarios ...]

Each version runs in a process of its own, and they take turns, sample by sample, so that both meet the same load. Seconds
are of the processor, not of the clock: means over the samples, the median of the whole without brake, and the ratio of the
means of the whole without brake with its standard error from the pairs. `draw` is the sample, `three` its best of three
controllers, `brake` the fourth, where this version runs it. `labels` says on how many samples all outcomes of the three are
the same. Extra: sim.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

SEED = 2018
SCENARIOS = ("two_coplanar", "two", "three", "four")
HERE = Path(__file__).parents[1]

WORK = """
import json, sys, time
from reference.tsid.controller import CONFIGURATIONS
from reference.tsid.robot import load
from reference.tsid.sampling import draw
from reference.tsid.simulator import Simulator

robot = load("talos")

def timed(make):
    start = time.process_time()
    return make(), time.process_time() - start

def run(name, sample):
    return Simulator(robot, CONFIGURATIONS[name]).run(sample).outcome.name.lower()

for line in sys.stdin:
    scenario, seed, index = json.loads(line)
    sample, drawing = timed(lambda: draw(robot, scenario, seed, index))
    outcomes, three, brake = [], 0.0, 0.0
    for name in ("standard", "straight", "fast", "brake"):
        if name in CONFIGURATIONS and "stopped" not in outcomes:
            outcome, seconds = timed(lambda: run(name, sample))
            if name == "brake":
                brake = seconds
            else:
                outcomes.append(outcome)
                three += seconds
    print(json.dumps([drawing, three, brake, outcomes]), flush=True)
"""
"""What a version runs: only what both have is asked of it."""


class Cost(NamedTuple):
    """Of one sample, in seconds of the processor."""

    draw: float
    three: float
    brake: float
    outcomes: list[str]
    """Of the three controllers, as far as they ran."""


class Version:
    """A process that draws and labels samples by the code in a folder."""

    def __init__(self, folder: Path):
        settings = {"PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-P", "-c", WORK]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "cwd": folder}
        self.folder = folder
        self.process = subprocess.Popen(command, env=os.environ | settings, **pipes)

    def cost(self, scenario: str, index: int) -> Cost:
        """Of the sample of that number. Raises RuntimeError if the process has ended."""
        self.process.stdin.write(json.dumps([scenario, SEED, index]) + "\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"the process of {self.folder} has ended at {scenario} {index}")
        return Cost(*json.loads(line))

    def end(self) -> None:
        self.process.stdin.close()
        self.process.wait()


HEADER = (
    f"{'scenario':14}{'samples':>8} | {'before: draw':>13}{'three':>8}{'median':>8} | "
    f"{'now: draw':>10}{'three':>8}{'median':>8}{'brake':>8} | {'before / now':>13}{'+-':>6}{'labels':>10}"
)


def line(scenario: str, before: list[Cost], now: list[Cost]) -> str:
    """A line of the table; draw, three and brake are means."""
    old, new = (np.array([[cost.draw, cost.three, cost.brake] for cost in costs]) for costs in (before, now))
    one, other = old[:, :2].sum(axis=1), new[:, :2].sum(axis=1)
    ratio = one.mean() / other.mean()
    error = np.std(one - ratio * other, ddof=1) / np.sqrt(len(one)) / other.mean() if len(one) > 1 else np.nan
    same = sum(a.outcomes == b.outcomes for a, b in zip(before, now, strict=True))
    return (
        f"{scenario:14}{len(old):8} | {old[:, 0].mean():13.3f}{old[:, 1].mean():8.3f}{np.median(one):8.3f} | "
        f"{new[:, 0].mean():10.3f}{new[:, 1].mean():8.3f}{np.median(other):8.3f}{new[:, 2].mean():8.3f} | "
        f"{ratio:13.2f}{error:6.2f}{f'{same}/{len(old)}':>10}"
    )


def main(arguments: list[str] | None = None) -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.sample_cost", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--before", type=Path, required=True, metavar="FOLDER", help="a checkout of another version")
    parser.add_argument("--samples", type=int, default=2, metavar="N", help="of each scenario (default: 2)")
    parser.add_argument("--scenarios", nargs="+", choices=SCENARIOS, default=list(SCENARIOS), metavar="SCENARIO")
    options = parser.parse_args(arguments)
    if options.samples < 1 or not (options.before / "reference" / "tsid").is_dir():
        parser.error(f"--samples {options.samples} --before {options.before} (expected 1 or more; a checkout)")
    versions = [Version(folder) for folder in (options.before.resolve(), HERE)]
    for version in versions:  # compiles
        version.cost("two", 0)
    print(HEADER, flush=True)
    for scenario in options.scenarios:
        pairs = [[version.cost(scenario, index) for version in versions] for index in range(options.samples)]
        print(line(scenario, *map(list, zip(*pairs, strict=True))), flush=True)
    for version in versions:
        version.end()


if __name__ == "__main__":
    main()
