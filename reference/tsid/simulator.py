"""A pushed robot under its balance controller, until it has stopped, fallen, or time is up (V-A, V-B)."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from reference.tsid.certificate import CertifiedSolver
from reference.tsid.controller import Command, Configuration, Controller
from reference.tsid.robot import Robot, Sample
from reference.tsid.solvers import SOLVERS, Status


class Outcome(IntEnum):
    """What became of the robot."""

    STOPPED = 0
    """|v| fell below the stop speed and stayed there for the dwell."""
    FALLEN = 1
    """The controller's QP was proved to have no solution, or a contact slipped."""
    UNDECIDED = 2
    """Neither within the time limit, or no solver solved a QP that no proof calls infeasible."""


class Options(NamedTuple):
    """How to simulate."""

    dt: float = 1e-3
    """[s]; also in the CoM task's gain, 1/dt."""
    stabilisation: tuple[float, float] = (100.0, 20.0)
    """Baumgarte's stiffness [1/s^2] and damping [1/s] of the contacts, and of the constraints of "straight" and
    "constant_momentum"; (0, 0) is none, and drift then keeps many runs from stopping."""
    time_limit: float = 4.0
    """[s]: at 3 s, 7 of 160 standard runs were still moving, 2 of them about to stop; at 10 s, 2 were."""
    solver: str = "daqp"
    """The first to try: "daqp" or "proxqp"."""
    stop_speed: float = 0.01
    """Norm of v, in m/s and rad/s, below which the robot has stopped."""
    dwell: float = 0.0
    """How long |v| has to stay below the stop speed [s]. 0 is the paper's criterion, which takes a dip for a stop; 0.2 s
    changes one label in fifty of the best of three."""
    slip: float = 0.10
    """How far a contact may move [m]."""


DEFAULT = Options()


class Trace(NamedTuple):
    """N states, at the beginning of steps; at the last the run ended, without a command (NaN)."""

    t: np.ndarray
    """(N,) [s]"""
    q: np.ndarray
    """(N, nq)"""
    v: np.ndarray
    """(N, nv)"""
    a: np.ndarray
    """(N, nv)"""
    tau: np.ndarray
    """(N, n) [N m]"""
    wrenches: np.ndarray
    """(N, k, 6), exerted on the robot, in the contacts' frames [N, N m]"""
    com: np.ndarray
    """(N, 3) [m]"""
    com_velocity: np.ndarray
    """(N, 3) [m/s]"""
    status: np.ndarray
    """(N,): `Status` of the QP; -1 where none was posed."""


class Run(NamedTuple):
    """How a run ended."""

    outcome: Outcome
    reason: str
    """"stopped"; "infeasible" or "slip"; "time" or "unsolved"."""
    time: float
    """[s]"""
    steps: int
    com_end: np.ndarray
    """(3,) [m]"""
    counters: dict[str, int]
    """Of `CertifiedSolver`; and "dips", how often the robot was slow for less than the dwell: without a dwell it would have
    stopped at the first of them."""
    trace: Trace | None


class Simulator:
    """Runs samples of one robot under one configuration of the controller. A run depends on its sample alone."""

    controller: type[Controller] = Controller
    """What makes the commands."""

    def __init__(self, robot: Robot, configuration: Configuration, options: Options = DEFAULT):
        if options.solver not in SOLVERS:
            raise ValueError(f"solver = {options.solver!r} (expected one of: {', '.join(SOLVERS)})")
        for name in ("dt", "time_limit", "stop_speed", "slip"):
            if not getattr(options, name) > 0:
                raise ValueError(f"{name} = {getattr(options, name)} (expected a positive number)")
        if not options.dwell >= 0:
            raise ValueError(f"dwell = {options.dwell} (expected at least 0)")
        self.robot, self.configuration, self.options = robot, configuration, options

    def run(self, sample: Sample, trace: bool = False) -> Run:
        """Simulate a sample: v+ = v + dt a, q+ = q (+) dt v+, with the controller's a, until it is decided."""
        options, model = self.options, self.robot.model
        controller = self.controller(self.robot, self.configuration, sample, options.dt, options.stabilisation)
        solver = CertifiedSolver(options.solver)
        record = _Recorder(controller) if trace else None
        limit = round(options.time_limit / options.dt)
        dwell = round(options.dwell / options.dt)
        q, v, moving, dips = sample.q.copy(), sample.v.copy(), -1, 0  # moving: the last step at which it was not slow
        for step in range(limit + 1):
            problem = controller.problem_at(q, v)
            if not v @ v < options.stop_speed**2:
                dips += step - moving > 1
                moving = step
            end = self._end(controller, step - moving > dwell, step == limit)
            answer = None if end else solver.solve(problem)
            if answer is not None and answer.status != Status.OPTIMAL:
                infeasible = answer.status == Status.INFEASIBLE
                end = (Outcome.FALLEN, "infeasible") if infeasible else (Outcome.UNDECIDED, "unsolved")
            command = None if end else controller.command(answer.y)
            if record:
                record.add(step * options.dt, q, v, command, answer)
            if end:
                break
            v = v + options.dt * command.acceleration
            q = pin.integrate(model, q, options.dt * v)
        com = controller.memory.centroid.com.copy()
        counters = dict(solver.counters) | ({"dips": dips} if dips else {})
        return Run(*end, step * options.dt, step, com, counters, record.trace() if record else None)

    def _end(self, controller: Controller, stopped: bool, last: bool) -> tuple[Outcome, str] | None:
        """Outcome and reason where the state last posed is one; None where the run goes on."""
        if stopped:
            return Outcome.STOPPED, "stopped"
        if controller.slip() > self.options.slip:
            return Outcome.FALLEN, "slip"
        return (Outcome.UNDECIDED, "time") if last else None


class _Recorder:
    """Collects a trace."""

    def __init__(self, controller: Controller):
        self._controller, self._rows = controller, []
        k, n = len(controller.sample.contacts), controller.robot.model.nv - 6
        self._none = Command(np.full(n + 6, np.nan), np.full(n, np.nan), np.full((k, 6), np.nan))

    def add(self, t, q, v, command: Command | None, answer) -> None:
        centre = self._controller.memory.centroid
        status = -1 if answer is None else int(answer.status)
        command = command or self._none
        self._rows.append((t, q, v, *command, centre.com.copy(), centre.velocity.copy(), status))

    def trace(self) -> Trace:
        return Trace(*(np.array(column) for column in zip(*self._rows, strict=True)))
