"""What a step and a sample of the whole-body simulation cost, and which solver can be trusted with its QP.

    python -m bench.simulator [--samples N] [--steps S]     # a small N takes seconds; --samples 20 for figures worth quoting

First table, cost: the first S steps of each scenario's samples 0 to N-1 under the standard controller, on the same states
with the same load of the machine. Microseconds, medians:

    tuned     what `reference/tsid` does: `terms` (Pinocchio; the reduced QP, written in place by numba), `solve` (DAQP from
              the last active set; the answer is checked), `rest` (accelerations, integration, tests of the end)
    plain     (30) as printed, in accelerations, forces and torques, assembled in NumPy, DAQP: `warm` from the last active
              set, `cold` from scratch; its step is assembly + warm + the same `rest`
    ratio     plain step / tuned step
    sample    mean time of a whole run to its end, and what its steps would take at the plain cost [s]
    refused   steps whose plain QP DAQP did not solve, warm: all feasible; it needs another try there, which is not counted
    differ    greatest difference of joint accelerations between tuned and plain, over the greatest acceleration; of the rest

Second table, solvers: every QP of those steps, proved feasible by a solution with a residual below 1e-5, and the last QPs of
falls, proved infeasible by Farkas rays. `right` and `wrong` count verdicts, `none` is neither (an iteration limit, or an
answer with a residual). `us`, `most`: median and greatest time. `far`: greatest excess of the distance |y - target| over
the best solver's, in |target|. Warm: in the order of the run. The infeasible ones are each solved from scratch.

Before the simulator was begun a step had been measured at 700-800 us in plain Python (another day, so not a ratio of this
table): on two contacts 638 us for the solver, 67 us for the assembly, 106 us for the acceleration bounds. Extra: sim.
"""

from __future__ import annotations

import argparse
import time
from statistics import median
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from proxsuite import proxqp

from bench.plain_qp import PlainQP
from reference.tsid.certificate import RESIDUAL, CertifiedSolver, certify
from reference.tsid.controller import CONFIGURATIONS, Controller
from reference.tsid.robot import Robot, Sample, load
from reference.tsid.sampling import SCENARIOS, draw
from reference.tsid.simulator import DEFAULT, Outcome, Simulator
from reference.tsid.solvers import Daqp, Problem, Proxqp, Solver, Status

SEED = 2018


class Plain(Proxqp):
    """ProxQP with its own defaults: tolerances 1e-5, 1e-4 for infeasibility, 10,000 iterations."""

    def _set_up(self, *sizes):
        qp = super()._set_up(*sizes)
        fresh = proxqp.dense.QP(*sizes).settings
        for name in ("eps_abs", "eps_rel", "eps_primal_inf", "max_iter"):
            setattr(qp.settings, name, getattr(fresh, name))
        return qp


class Unscaled(Proxqp):
    """The settings of `Proxqp` without equilibration."""

    def _set_up(self, *sizes):
        qp = super()._set_up(*sizes)
        qp.settings.preconditioner_max_iter = 0
        return qp


class Strict(Proxqp):
    """The settings of `Proxqp`, infeasible at 1e-10."""

    def _set_up(self, *sizes):
        qp = super()._set_up(*sizes)
        qp.settings.eps_primal_inf = 1e-10
        return qp


CONTENDERS: dict[str, tuple[type[Solver], bool]] = {
    "DAQP, warm": (Daqp, True),
    "DAQP, cold": (Daqp, False),
    "ProxQP, warm": (Proxqp, True),
    "ProxQP, cold": (Proxqp, False),
    "ProxQP 1e-10, warm": (Strict, True),
    "ProxQP unequilibrated": (Unscaled, True),
    "ProxQP defaults, warm": (Plain, True),
}


class Steps(NamedTuple):
    """What was measured on the first steps of one sample's run; seconds by step."""

    terms: list[float]
    solve: list[float]
    rest: list[float]
    assembly: list[float]
    warm: list[float]
    cold: list[float]
    differ: float
    refused: int
    """Steps that the plain form did not solve warm."""
    problems: list[Problem]
    """Of those steps."""
    last: Problem | None
    """The QP that ended the run, if it was infeasible."""
    run: float
    """Of the whole run [s]."""
    count: int
    """Steps of the whole run."""


def copied(problem: Problem) -> Problem:
    return Problem(*(array.copy() for array in problem))


def measure(robot: Robot, sample: Sample, steps: int) -> Steps:
    """One sample, run to its end, and step by step over its first steps."""
    simulator = Simulator(robot, CONFIGURATIONS["standard"])
    start = time.perf_counter()
    run = simulator.run(sample)
    whole = time.perf_counter() - start
    trace = simulator.run(sample, trace=True).trace
    states = list(zip(trace.q[: min(steps, run.steps)], trace.v, strict=False))
    controller, solver = Controller(robot, CONFIGURATIONS["standard"], sample, DEFAULT.dt), CertifiedSolver("daqp")
    plain, afresh = PlainQP(robot, sample, DEFAULT.dt), PlainQP(robot, sample, DEFAULT.dt)
    out = Steps([], [], [], [], [], [], 0.0, 0, [], None, whole, run.steps)
    joints = []
    for q, v in states:  # one after the other, as in a run: the caches are part of what is measured
        marks = [time.perf_counter()]
        problem = controller.problem_at(q, v)
        marks.append(time.perf_counter())
        answer = solver.solve(problem)
        marks.append(time.perf_counter())
        command = controller.command(answer.y)
        controller.slip()
        pin.integrate(robot.model, q, DEFAULT.dt * (v + DEFAULT.dt * command.acceleration))
        marks.append(time.perf_counter())
        for seconds, spent in zip(out[:3], np.diff(marks), strict=True):
            seconds.append(spent)
        joints.append(command.acceleration[6:])
    differ, refused = 0.0, 0
    for warm in (True, False):
        for (q, v), expected in zip(states, joints, strict=True):
            marks = [time.perf_counter()]
            full = plain.assemble(q, v)
            marks.append(time.perf_counter())
            solved, acceleration = (plain if warm else afresh).solve(full, warm)
            marks.append(time.perf_counter())
            (out.warm if warm else out.cold).append(marks[2] - marks[1])
            if warm:
                out.assembly.append(marks[1] - marks[0])
                refused += not solved
            if warm and solved:
                differ = max(differ, np.abs(acceleration[6:] - expected).max() / np.abs(expected).max())
    out.problems.extend(copied(controller.problem_at(q, v)) for q, v in states)
    last = copied(controller.problem_at(trace.q[-1], trace.v[-1])) if run.outcome == Outcome.FALLEN else None
    return out._replace(differ=differ, refused=refused, last=last if last is not None and certify(last).infeasible else None)


COSTS = (
    f"{'scenario':14}{'steps':>7}{'terms':>8}{'solve':>8}{'rest':>6}{'step us':>9} | "
    f"{'assembly':>9}{'warm':>7}{'cold':>7}{'step us':>9}{'ratio':>7} | "
    f"{'sample s':>9}{'plain s':>9}{'refused':>8}{'differ':>9}"
)


def cost(scenario: str, all_steps: list[Steps]) -> str:
    """A line of the first table: medians over steps, means over samples."""
    # Samples that fall at once have no steps.
    micro = lambda field: 1e6 * median([spent for steps in all_steps for spent in getattr(steps, field)] or [float("nan")])
    terms, solve, rest, assembly, warm, cold = map(micro, Steps._fields[:6])
    tuned, plain = terms + solve + rest, assembly + warm + rest
    sample = float(np.mean([steps.run for steps in all_steps]))
    slow = float(np.mean([steps.count for steps in all_steps])) * plain / 1e6
    number, refused = (
        sum(counts) for counts in zip(*((len(steps.terms), steps.refused) for steps in all_steps), strict=True)
    )
    return (
        f"{scenario:14}{number:7}{terms:8.0f}{solve:8.0f}{rest:6.0f}{tuned:9.0f} | "
        f"{assembly:9.0f}{warm:7.0f}{cold:7.0f}{plain:9.0f}{plain / tuned:7.1f} | "
        f"{sample:9.3f}{slow:9.3f}{refused:8}{max(steps.differ for steps in all_steps):9.1e}"
    )


SOLVER = (
    f"{'scenario':14}{'solver':24}{'feasible':>9}{'right':>7}{'wrong':>7}{'none':>6}{'us':>8}{'most':>9}{'far':>9} | "
    f"{'infeasible':>11}{'right':>7}{'wrong':>7}{'none':>6}{'us':>8}{'most':>9}"
)


class Tally(NamedTuple):
    """A solver's answers to a list of problems."""

    statuses: list[Status]
    seconds: list[float]
    distances: list[float]


def tally(kind: type[Solver], warm: bool, series: list[list[Problem]]) -> Tally:
    """Answers to series of problems, each begun from scratch; an answer with a residual is none."""
    out = Tally([], [], [])
    for problems in series:
        solver = kind()
        for problem in problems:
            if not warm:
                solver.forget()
            start = time.perf_counter()
            answer = solver.solve(problem)
            out.seconds.append(time.perf_counter() - start)
            bad = answer.status == Status.OPTIMAL and not residual(problem, answer.y) <= RESIDUAL
            out.statuses.append(Status.FAILED if bad else answer.status)
            solved = out.statuses[-1] == Status.OPTIMAL
            out.distances.append(float(np.linalg.norm(answer.y - problem.target)) if solved else np.inf)
    return out


def residual(problem: Problem, y: np.ndarray) -> float:
    """Greatest violation of a row."""
    value = problem.matrix @ y
    return float(max(0.0, (value - problem.upper).max(), (problem.lower - value).max()))


def solvers(scenario: str, all_steps: list[Steps]) -> list[str]:
    """Lines of the second table."""
    infeasible = [[steps.last] for steps in all_steps if steps.last is not None]
    feasible = [steps.problems for steps in all_steps if steps.problems]
    tallies = {name: (tally(*how, feasible), tally(*how, infeasible)) for name, how in CONTENDERS.items()}
    best = np.min([np.array(some.distances) for some, _ in tallies.values()], axis=0)
    lines = []
    for name, (some, none) in tallies.items():
        far = (np.array(some.distances) - best) / np.maximum(
            [np.linalg.norm(p.target) for ps in feasible for p in ps], 1e-12
        )
        far = far[np.isfinite(far)].max(initial=0.0)
        lines.append(
            f"{scenario:14}{name:24}{_verdicts(some, Status.OPTIMAL, Status.INFEASIBLE, 9)}{far:9.1e} | "
            f"{_verdicts(none, Status.INFEASIBLE, Status.OPTIMAL, 11)}"
        )
    return lines


def _verdicts(answers: Tally, right: Status, wrong: Status, width: int) -> str:
    count = lambda status: sum(answer == status for answer in answers.statuses)
    number, seconds = len(answers.statuses), answers.seconds or [np.nan]
    verdicts = f"{count(right):7}{count(wrong):7}{count(Status.FAILED):6}"
    return f"{number:{width}}{verdicts}{1e6 * median(seconds):8.0f}{1e6 * max(seconds):9.0f}"


def main(arguments: list[str] | None = None) -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.simulator", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=2, metavar="N", help="of each scenario (default: 2)")
    parser.add_argument("--steps", type=int, default=50, metavar="S", help="of each sample (default: 50)")
    parser.add_argument("--scenarios", nargs="+", choices=SCENARIOS, default=list(SCENARIOS), metavar="SCENARIO")
    parser.add_argument("--robot", default="talos")
    options = parser.parse_args(arguments)
    if options.samples < 1 or options.steps < 1:
        parser.error(f"--samples {options.samples} --steps {options.steps} (expected at least 1)")
    robot = load(options.robot)
    measure(robot, draw(robot, "two", SEED, 0), 2)  # compiles
    measured = {}
    print(COSTS)
    for scenario in options.scenarios:
        samples = [draw(robot, scenario, SEED, index) for index in range(options.samples)]
        measured[scenario] = [measure(robot, sample, options.steps) for sample in samples]
        print(cost(scenario, measured[scenario]), flush=True)
    print(f"\n{SOLVER}")
    for scenario in options.scenarios:
        print(*solvers(scenario, measured[scenario]), sep="\n", flush=True)


if __name__ == "__main__":
    main()
