"""A sample's row: drawn, described, simulated under each controller. Rows are flat dicts of what JSON can hold."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from reference.tsid.controller import CONFIGURATIONS
from reference.tsid.holding import effort
from reference.tsid.robot import Robot, Sample, load
from reference.tsid.sampling import draw

Row = dict[str, Any]

BEST_FIRST = ("stopped", "undecided", "fallen")
"""Outcomes in the order in which the best of several controllers is taken."""

RESCUE = "brake"
"""The controller that the paper does not have: it counts in `best_of_four` and not in `outcome`."""

BEST_OF_FOUR = ("standard", "straight", "fast", RESCUE)
"""What runs by default."""

PLACE = 2.0**-20
"""Positions of contacts are rounded to this [m]."""

TURN = 2.0**-22
"""Their quaternions are rounded to this [-]."""


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
    effectors: dict[str, dict[str, float]]
    """What the rectangles of contacts are, by name: half_length, half_width [m]."""
    states: int
    """Rows before this one hold q and v."""


class Toolbox(NamedTuple):
    """What labels a sample."""

    simulator: Any
    """simulator(robot, configuration, options).run(sample) returns outcome, reason, steps, counters."""
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
            "steps": int(run.steps),
            **{name: int(value) for name, value in run.counters.items()},
        }
        return {f"{controller}_{key}": value for key, value in row.items()}

    def label(index: int) -> Row:
        row: Row = {"index": index}
        try:
            sample = draw(robot, settings.scenario, settings.seed, index, settings.zero_momentum)
            row |= describe(robot, sample)
            row |= {"q": _single(sample.q), "v": _single(sample.v)} if index < settings.states else {}
            return row | judge(settings, lambda controller: simulate(sample, controller))
        except Exception as error:  # one bad sample must not end a campaign: its row says what happened
            return row | {"error": f"{type(error).__name__}: {error}"}

    return label


def labels_of(settings: Settings) -> tuple[str, ...]:
    """Columns of the best outcome among several controllers: none where all of them run."""
    if settings.every:
        return ()
    return ("outcome", "best_of_four") if RESCUE in settings.controllers else ("outcome",)


def judge(settings: Settings, simulate: Callable[[str], Row]) -> Row:
    """The columns of the controllers that run and, unless every one has to, the best outcomes among them.

    `outcome` is the best without RESCUE, as in the paper; `best_of_four` the best with it.
    """
    row: Row = {}
    outcomes: dict[str, str] = {}
    for controller in settings.controllers:
        row |= simulate(controller)
        outcomes[controller] = row[f"{controller}_outcome"]
        if outcomes[controller] == "stopped" and not settings.every:
            break
    best = lambda names: min((outcomes[name] for name in names), key=BEST_FIRST.index)
    found = {"outcome": best(set(outcomes) - {RESCUE} or outcomes), "best_of_four": best(outcomes)}
    return row | {name: found[name] for name in labels_of(settings)}


def describe(robot: Robot, sample: Sample) -> Row:
    """Centroidal quantities (world frame; angular momentum about the CoM [kg m^2/s]), contacts and effort."""
    data = robot.model.createData()
    momentum = pin.computeCentroidalMomentum(robot.model, data, sample.q, sample.v)
    return {
        "com": _single(data.com[0]),
        "com_velocity": _single(data.vcom[0]),
        "angular_momentum": _single(momentum.angular),
        "contacts": [
            {
                "effector": contact.effector,
                "position": _rounded(contact.placement.translation, PLACE),
                "quaternion": _rounded(_quaternion(contact.placement.rotation), TURN),
            }
            for contact in sample.contacts
        ],
        "effort": _single(effort(robot, sample.q, sample.contacts)),
    }


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """x, y, z, w of a rotation, w not negative."""
    found = pin.Quaternion(rotation).coeffs()
    return -found if found[3] < 0 else found


def _rounded(values: np.ndarray, unit: float) -> list[float]:
    return _single(unit * np.round(np.asarray(values) / unit) + 0.0)  # + 0.0: no negative zeros


def _single(values: np.ndarray | float) -> Any:
    return np.asarray(values).astype(np.float32).tolist()
