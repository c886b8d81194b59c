"""`advance` against steps of linear programs: position and speed of random states, by how they end.

    python -m bench.braking_oracle [--states 1000] [--step 0.002] [--float32]

Each state has contacts of its own, two to four rectangles anywhere, a time from 0.05 to 0.2 s, and every second one an
angular momentum; one in twenty has lost its contacts. The oracle (`reference/braking.py`) solves an LP for every step, of
`step` [s] and of half that, and states what halving it changed. Ratios are to that error and to FLOOR, the rounding of its
solver, together. It brakes at once, as hard as it can: states that have to brake later (C3.2.1) are counted, not compared.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxcap
from jaxcap import Case, Progress
from jaxcap.batch.blocks import LANES
from reference.braking import Braked, braked
from reference.contacts import GRAVITY
from tests.samplers import random_samples

SEED = 11
POINTS = 16
"""Contacts of the largest set."""
TIMES = 0.05, 0.2
"""Shortest and longest that is asked for [s]."""
FLYING = 20
"""One state of so many has no contacts."""
FLOOR = 1e-7
"""What HiGHS's tolerances are worth in alpha and speed after such a time [m, m/s]."""
ENDINGS = {
    "on the way": {Progress.ON_THE_WAY},
    "rests": {Progress.RESTS, Progress.TURNS},
    "leaves": {Progress.LEAVES},
    "falls": {Progress.FLIES},
}
"""What the oracle calls them, and `Progress`."""


class Sample(NamedTuple):
    """States, each with contacts of its own."""

    arrays: list
    """Of the contacts, for the oracle."""
    contacts: Any
    """The same, a batch."""
    coms: np.ndarray
    velocities: np.ndarray
    momenta: np.ndarray
    """Over the mass [m^2/s]."""
    times: np.ndarray
    """[s]"""


class Against(NamedTuple):
    """One state's answer beside the oracle's."""

    agree: bool
    """In how it ends."""
    alpha: float
    """Difference [m]."""
    speed: float
    """[m/s]"""
    ratio: float
    """The larger of the two, over the oracle's own error and the rounding of its solver."""
    time: float
    """Difference of the times at which it ended [s]."""


def drawn(count: int) -> Sample:
    """Random states of `tests.samplers`."""
    rng = np.random.default_rng(SEED)
    arrays, coms, velocities = zip(*random_samples(rng, count), strict=True)
    flies = np.arange(count) % FLYING == FLYING - 1
    sets = [jaxcap.ContactSet(*each).padded(POINTS) for each in arrays]
    contacts = jax.tree.map(lambda *leaves: np.stack(leaves), *sets)
    contacts.mask[flies] = False
    momenta = rng.normal(size=(count, 3)) * 0.15 * (np.arange(count)[:, None] % 2)
    times = rng.uniform(*TIMES, count)
    return Sample(list(arrays), contacts, np.array(coms), np.array(velocities), momenta, times)


def fallen(velocity: np.ndarray, duration: float, step: float) -> Braked:
    """Of a state without contacts, along its velocity: by steps as well, whose error is rounding."""
    along, steps = velocity / np.linalg.norm(velocity), int(np.ceil(duration / step))
    dt, where, now = duration / steps, np.zeros(3), velocity.copy()
    for _ in range(steps):
        where, now = where + now * dt + np.asarray(GRAVITY) * dt**2 / 2, now + np.asarray(GRAVITY) * dt
    return Braked(float(where @ along), float(np.linalg.norm(now)), duration, "falls", 0.0)


def compared(sample: Sample, found: Any, i: int, step: float) -> tuple[str, Against]:
    """How the oracle ends, and how far `advance` is from it."""
    velocity, duration = sample.velocities[i], sample.times[i]
    if not sample.contacts.mask[i].any():
        oracle = fallen(velocity, duration, step)
    else:
        oracle = braked(
            *sample.arrays[i], sample.coms[i], velocity, duration, step=step, specific_angular_momentum=sample.momenta[i]
        )
    alpha = abs(found.displacement[i] @ velocity / np.linalg.norm(velocity) - oracle.alpha)
    speed = abs(np.linalg.norm(found.com_velocity[i]) - oracle.speed)
    agree = Progress(found.progress[i]) in ENDINGS[oracle.ending]
    ratio = max(alpha, speed) / (oracle.error + FLOOR)
    return oracle.ending, Against(agree, alpha, speed, ratio, abs(found.time[i] - oracle.time))


def answered(sample: Sample, dtype: Any) -> tuple[np.ndarray, Any]:
    """Each state's `Case`, and what `advance` says."""
    cones = jax.tree.map(np.asarray, jaxcap.cone_rays(sample.contacts))
    states = [field.astype(dtype) for field in (sample.coms, sample.velocities, sample.momenta)]
    parts = []
    for start in range(0, len(sample.coms), LANES):  # one program, however many states there are
        own, (coms, velocities, momenta), times = jax.tree.map(
            lambda field, start=start: field[start : start + LANES], (cones, states, sample.times)
        )
        case = jaxcap.score(own, coms, velocities, specific_angular_momentum=momenta).case
        found = jaxcap.advance(own, coms, velocities, times, specific_angular_momentum=momenta)
        parts.append(jax.tree.map(np.asarray, (case, found)))
    return jax.tree.map(lambda *fields: np.concatenate(fields), *parts)


def table(rows: dict[tuple[str, str], list[Against]]) -> None:
    """Prints it."""
    print(
        f"{'case':>8} {'then':>11} {'states':>7} {'agree':>6} {'position [m]':>13} {'speed [m/s]':>12} {'/ error':>8} "
        f"{'time [s]':>9}"
    )
    for (case, ending), answers in sorted(rows.items()):
        worst = [max(getattr(one, name) for one in answers) for name in ("alpha", "speed", "ratio", "time")]
        agree = sum(one.agree for one in answers)
        print(
            f"{case:>8} {ending:>11} {len(answers):7} {agree:6} {worst[0]:13.1e} {worst[1]:12.1e} {worst[2]:8.2f} "
            f"{worst[3]:9.1e}"
        )


def main() -> None:
    """Prints agreement and worst differences, by case and by how the oracle ends."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.braking_oracle",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--states", type=int, default=1000)
    parser.add_argument("--step", type=float, default=0.002, help="[s]")
    parser.add_argument("--float32", action="store_true", help="`advance` in single precision")
    options = parser.parse_args()
    sample = drawn(options.states)
    dtype = np.float32 if options.float32 else np.float64
    with jax.enable_x64(not options.float32):
        case, found = answered(sample, dtype)
    rows, later = defaultdict(list), 0
    for i in range(options.states):
        if case[i] == Case.C3_2_1:
            later += 1
            continue
        ending, against = compared(sample, found, i, options.step)
        rows["flying" if ending == "falls" else Case(int(case[i])).name, ending].append(against)
    table(rows)
    answers = [one for each in rows.values() for one in each]
    agree = sum(one.agree for one in answers)
    print(f"{agree} of {len(answers)} end alike; {later} have to brake later (C3_2_1) and are not compared")
    print(f"{dtype.__name__}; steps of {1e3 * options.step:g} ms and of half that; worst figures of each line")


if __name__ == "__main__":
    main()
