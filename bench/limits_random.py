"""Verdict, largest speed and effort with random limits against linear programs: contacts, Jacobians, limits of no robot.

Two kinds, both of `tests.samplers`: `feet and hand`, two feet nearly flat and a hand nearly upright, three hinges to each,
as a robot stands; `any`, two to four rectangles whichever way they face, three hinges to each, with a CoM around or above
them. Half of the states have a momentum box.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxcap
from jaxcap import Actuation, ContactSet, Status
from reference import robot_limits as programs
from tests.samplers import hinges, limited_samples, random_samples

MOST_CONTACTS, HINGES = 16, 3
BOX = 0.1
"""Momentum box of half of the states [m^2/s^2]."""
HOLDING = 1e-7
"""A polygon that goes on by more beyond the static region [m] lets the robot swing: the programs then know no speeds."""
CLEAR = {"float64": 1e-6, "float32": 1e-3}
"""Verdicts of states whose margin is larger [m/s] have to agree."""
SMALL = 1e-3
"""Differences of figures below this are relative to it."""
UNHELD = 0.5
"""Margin of a posture that cannot be held, for each part of the limits that it lacks [m/s]; as DESIGN has it."""


class Sample(NamedTuple):
    """A state with contacts and limits of its own."""

    contacts: tuple[np.ndarray, np.ndarray, np.ndarray]
    """Points, frames, friction."""
    posture: tuple[np.ndarray, np.ndarray, np.ndarray]
    """Jacobians, gravity torque, limits, per unit mass."""
    com: np.ndarray
    velocity: np.ndarray
    box: float

    @property
    def padded(self) -> tuple[ContactSet, Actuation]:
        """Contacts and limits in rows that all samples have."""
        actuation = Actuation(*self.posture)
        joints = HINGES * MOST_CONTACTS // 4
        return ContactSet(*self.contacts).padded(MOST_CONTACTS), actuation.padded(MOST_CONTACTS, joints)

    @property
    def program(self) -> programs.State:
        """Its rows."""
        limits = programs.Limits(*self.posture, np.ones(len(self.posture[1]), bool))
        return programs.state_of(*self.contacts, self.com, self.velocity, limits, box=self.box)


def feet_and_hand(rng: np.random.Generator, count: int) -> list[Sample]:
    """As a robot stands."""
    return [Sample(*sample, BOX * (i % 2)) for i, sample in enumerate(limited_samples(rng, count))]


def any_contacts(rng: np.random.Generator, count: int) -> list[Sample]:
    """Whichever way they face."""
    found = []
    for i, (contacts, com, velocity) in enumerate(random_samples(rng, count)):
        points = contacts[0]
        jacobians = np.concatenate([hinges(rng, points, first, HINGES) for first in range(0, len(points), 4)], axis=2)
        joints = jacobians.shape[2]
        posture = jacobians, rng.normal(size=joints), rng.uniform(1, 6, joints)
        found.append(Sample(contacts, posture, com, velocity, BOX * (i % 2)))
    return found


KINDS: dict[str, Callable[[np.random.Generator, int], list[Sample]]] = {
    "feet and hand": feet_and_hand,
    "any": any_contacts,
}


class Expected(NamedTuple):
    """What the programs say of a state."""

    effort: float
    min_speed: float
    """[m/s]; NaN where the programs do not say, and so is the next one."""
    max_speed: float

    def margin(self, speed: float) -> float:
        """Not negative if and only if capturable, but for postures that cannot be held [m/s]."""
        walk = min(self.max_speed - speed, speed - self.min_speed if self.min_speed > 0 else np.inf)
        return min(walk, UNHELD * (1 - self.effort)) if 1 < self.effort < np.inf else walk


UNSOLVED = Expected(np.nan, np.nan, np.nan)
"""HiGHS gives up on a program."""


def expected(state: programs.State) -> Expected:
    """By linear programs; of states that may swing the effort alone."""
    try:
        return _expected(state)
    except ArithmeticError:
        return UNSOLVED


def _expected(state: programs.State) -> Expected:
    effort, (s_min, s_max) = programs.effort(state), programs.static_interval(state)
    first = programs.least_acceleration(state, 0.0)
    if first is None or s_min > s_max:
        return Expected(effort, 0.0, 0.0)
    if first.value < 0 and s_max < programs.farthest(state, 0.0) - HOLDING:
        return Expected(effort, np.nan, np.nan)
    largest = programs.max_speed(state)
    smallest = programs.min_speed(state, s_min) if s_min > 0 and first.value <= 0 else 0.0
    return Expected(effort, min(smallest, largest), largest)


def lines(count: int, seed: int, dtypes: list[str]) -> Any:
    """The table, line by line."""
    for kind, draw in KINDS.items():
        samples = draw(np.random.default_rng(seed), count)
        start = time.perf_counter()
        known = [expected(sample.program) for sample in samples]
        spent = time.perf_counter() - start
        for dtype in dtypes:
            yield {"kind": kind, "dtype": dtype, "states": count, **_compared(samples, known, dtype), "HiGHS s": spent}


def scored(samples: list[Sample], dtype: str) -> jaxcap.Capturability:
    """The answers, as NumPy's arrays in double precision."""
    padded = [sample.padded for sample in samples]
    contacts, actuation = jax.tree.map(lambda *leaves: np.stack(leaves), *padded)
    cast = lambda tree: jax.tree.map(lambda x: np.asarray(x, dtype) if x.dtype.kind == "f" else x, tree)
    rays = cast(jax.tree.map(np.asarray, jaxcap.cone_rays(contacts)))
    coms, velocities, box = (np.array([getattr(s, name) for s in samples], dtype) for name in ("com", "velocity", "box"))
    found = jaxcap.score(rays, coms, velocities, actuation=cast(actuation), momentum_box=box)
    return jax.tree.map(lambda x: np.asarray(x, float) if x.dtype.kind == "f" else np.asarray(x), found)


def _compared(samples: list[Sample], known: list[Expected], dtype: str) -> dict[str, Any]:
    """How far the answers are from the programs'."""
    ours = scored(samples, dtype)
    speeds = np.array([np.linalg.norm(sample.velocity) for sample in samples])
    effort, smallest, largest = (np.array(column) for column in zip(*known, strict=True))
    margin = np.array([one.margin(speed) for one, speed in zip(known, speeds, strict=True)])
    decided = ours.status == Status.OK
    clear = decided & (np.abs(margin) > CLEAR[dtype])  # NaN is not
    unheld = np.isfinite(effort) & (effort > 1)
    wrong = clear & (ours.capturable != ((margin >= 0) & ~unheld))
    off = lambda figure, value: _farthest(figure[decided], value[decided])
    return {
        "undecided": int((~decided).sum()),
        "unsolved": int(np.isnan(effort).sum()),
        "swinging": int((np.isnan(margin) & ~np.isnan(effort)).sum()),
        "unheld": int(unheld.sum()),
        "capturable": int(ours.capturable.sum()),
        "clear": int(clear.sum()),
        "verdicts": int(wrong.sum()),
        "max_speed": off(ours.max_speed, largest),
        "min_speed": off(ours.min_speed, smallest),
        "effort": off(ours.effort, effort),
    }


def _farthest(found: np.ndarray, value: np.ndarray) -> float:
    """The largest relative difference, where a program knows; infinite if only one of the two is infinite."""
    known = ~np.isnan(value) & (found != value)
    finite = known & np.isfinite(value)
    differences = np.abs(found[finite] - value[finite]) / np.maximum(value[finite], SMALL)
    return float(np.inf if (known & ~finite).any() else differences.max(initial=0))
