"""A sample's row: drawn, described, simulated under each controller. Rows are flat dicts of what JSON can hold."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from reference.tsid.controller import CONFIGURATIONS
from reference.tsid.robot import Robot, Sample, load
from reference.tsid.sampling import draw

Row = dict[str, Any]

BEST_FIRST = ("stopped", "undecided", "fallen")
"""Outcomes in the order in which the best of several controllers is taken."""


class Settings(NamedTuple):
    """What a file's rows depend on, but for their index."""

    scenario: str
    robot: str
    """Its name: that of its configuration's file."""
    robot_hash: str
    """SHA-256 of the robot's configuration."""
    seed: int
    zero_momentum: bool
    controllers: tuple[str, ...]
    """In the order in which they run."""
    configurations: dict[str, str]
    """What each of them is, as text."""
    every: bool
    """All of them run. Otherwise a controller runs if those before it did not stop the robot, and the best counts."""
    simulator: str
    """A module as `toolbox` takes it."""
    options: dict[str, Any]
    """Fields of the simulator's options."""
    sampling: dict[str, float]
    """Numbers of the samples' distribution: `sampling.DISTRIBUTION`."""


class Toolbox(NamedTuple):
    """What labels a sample."""

    simulator: Any
    """simulator(robot, configuration, options).run(sample) returns outcome, reason, time, steps, com_end, counters."""
    options: Any
    """A named tuple with defaults."""
    configurations: dict[str, Any]
    """Of the controller, by name."""


def toolbox(module: str) -> Toolbox:
    """`Simulator`, `Options` and, if it does not simulate our controllers, `CONFIGURATIONS` of a module."""
    found = importlib.import_module(module)
    return Toolbox(found.Simulator, found.Options, getattr(found, "CONFIGURATIONS", CONFIGURATIONS))


def labeller(settings: Settings, path: str) -> Callable[[int], Row]:
    """A function from a sample's index to its row, for the robot at `path` (or of that name).

    What goes wrong for a sample is text in its row's `error`.
    """
    robot = load(path)
    tools = toolbox(settings.simulator)
    options = tools.options(**settings.options)

    def simulate(sample: Sample, controller: str) -> Row:
        run = tools.simulator(robot, tools.configurations[controller], options).run(sample)
        row = {
            "outcome": run.outcome.name.lower(),
            "reason": str(run.reason),
            "time": float(run.time),
            "steps": int(run.steps),
            "com_end": _single(run.com_end),
            **{name: int(value) for name, value in run.counters.items()},
        }
        return {f"{controller}_{key}": value for key, value in row.items()}

    def label(index: int) -> Row:
        row: Row = {"index": index}
        try:
            sample = draw(robot, settings.scenario, settings.seed, index, settings.zero_momentum)
            row |= describe(robot, sample)
            return row | judge(settings, lambda controller: simulate(sample, controller))
        except Exception as error:  # one bad sample must not end a campaign: its row says what happened
            return row | {"error": f"{type(error).__name__}: {error}"}

    return label


def judge(settings: Settings, simulate: Callable[[str], Row]) -> Row:
    """The columns of the controllers that run and, unless every one has to, the best outcome among them."""
    row: Row = {}
    outcomes = []
    for controller in settings.controllers:
        row |= simulate(controller)
        outcomes.append(row[f"{controller}_outcome"])
        if outcomes[-1] == "stopped" and not settings.every:
            break
    return row if settings.every else row | {"outcome": min(outcomes, key=BEST_FIRST.index)}


def describe(robot: Robot, sample: Sample) -> Row:
    """State, contacts and centroidal quantities (world frame; angular momentum about the CoM [kg m^2/s])."""
    data = robot.model.createData()
    momentum = pin.computeCentroidalMomentum(robot.model, data, sample.q, sample.v)
    return {
        "q": _single(sample.q),
        "v": _single(sample.v),
        "contacts": [
            {
                "effector": contact.effector,
                "position": contact.placement.translation.tolist(),
                "rotation": contact.placement.rotation.ravel().tolist(),
                "half_length": contact.half_length,
                "half_width": contact.half_width,
                "friction": contact.friction,
            }
            for contact in sample.contacts
        ],
        "com": data.com[0].tolist(),
        "com_velocity": data.vcom[0].tolist(),
        "angular_momentum": momentum.angular.tolist(),
    }


def _single(values: np.ndarray) -> list[float]:
    return np.asarray(values).astype(np.float32).tolist()
