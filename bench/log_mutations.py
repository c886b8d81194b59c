"""Logs that are not what they seem: 200 mutations of good ones, and what becomes of each.

    python -m bench.log_mutations

Each mutation is one that is on record: a quaternion in the other order, degrees, joints permuted in positions and velocities
alike, velocities in the other frame, y up, millimetres, a glitch in a row, a floating or sunken clip, an upside-down
base, times that jump. It is `refused`, `noted`, or `corrected`: without a word, but the states are those of the good log.
A mutation that changes the states and is met with silence is a failure, and the exit code is 1.
"""

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from bench.robot_motion import Motion, motion, write_mujoco
from jaxcap import robots
from jaxcap.errors import InputError
from jaxcap.robots.differences import differences

SAME = 1e-6
"""States that differ less are those of the good log [m, m/s]."""
EACH = 20
"""Mutations of each kind."""


class Fields(NamedTuple):
    """A log as MuJoCo writes it."""

    time: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray


class Fate(NamedTuple):
    """What became of a mutation."""

    word: str
    """refused, noted, corrected or silent."""
    why: str


def rolled(log: Fields, rng: np.random.Generator) -> Fields:
    """Quaternions in another order."""
    log.qpos[:, 3:7] = log.qpos[:, 3:7][:, [[1, 2, 3, 0], [3, 0, 1, 2], [2, 3, 0, 1]][rng.integers(3)]]
    return log


def degrees(log: Fields, rng: np.random.Generator) -> Fields:
    """Joints in degrees, and their velocities."""
    log.qpos[:, 7:] *= 180 / np.pi
    log.qvel[:, 6:] *= 180 / np.pi
    return log


def permuted(log: Fields, rng: np.random.Generator) -> Fields:
    """Joints permuted in positions and velocities alike."""
    order = rng.permutation(log.qpos.shape[1] - 7)
    log.qpos[:, 7:], log.qvel[:, 6:] = log.qpos[:, 7:][:, order], log.qvel[:, 6:][:, order]
    return log


def other_frame(log: Fields, rng: np.random.Generator) -> Fields:
    """The base's linear velocity in its own frame, the angular one in the world."""
    for row, pose in zip(log.qvel, log.qpos, strict=True):
        turn = pin.Quaternion(*pose[3:7]).toRotationMatrix()
        row[:3], row[3:6] = turn.T @ row[:3], turn @ row[3:6]
    return log


def y_up(log: Fields, rng: np.random.Generator) -> Fields:
    """The world with y up."""
    turn = pin.rpy.rpyToMatrix(-np.pi / 2, 0, 0)
    log.qpos[:, :3], log.qvel[:, :3] = log.qpos[:, :3] @ turn.T, log.qvel[:, :3] @ turn.T
    for row in log.qpos:
        row[3:7] = np.roll(pin.Quaternion(turn @ pin.Quaternion(*row[3:7]).toRotationMatrix()).coeffs(), 1)
    return log


def millimetres(log: Fields, rng: np.random.Generator) -> Fields:
    """The base in millimetres."""
    log.qpos[:, :3] *= 1000
    log.qvel[:, :3] *= 1000
    return log


def glitch(log: Fields, rng: np.random.Generator) -> Fields:
    """In the first row, the last, or any, the velocity is position / step."""
    row = [0, len(log.time) - 1, int(rng.integers(1, len(log.time) - 1))][rng.integers(3)]
    log.qvel[row, :3] = log.qpos[row, :3] / 0.02
    return log


def floating(log: Fields, rng: np.random.Generator) -> Fields:
    """The clip floats, or sinks, by 3 to 7 cm."""
    log.qpos[:, 2] += rng.uniform(0.03, 0.07) * rng.choice([-1, 1])
    return log


def upside_down(log: Fields, rng: np.random.Generator) -> Fields:
    """The base's frame points down."""
    flip = pin.rpy.rpyToMatrix(np.pi, 0, rng.uniform(-3, 3))
    for row in log.qpos:
        row[3:7] = np.roll(pin.Quaternion(pin.Quaternion(*row[3:7]).toRotationMatrix() @ flip).coeffs(), 1)
    return log


def shuffled(log: Fields, rng: np.random.Generator) -> Fields:
    """Rows that are missing, or come in another order."""
    keep = np.delete(np.arange(len(log.time)), np.arange(a := int(rng.integers(20, 100)), a + int(rng.integers(2, 20))))
    if rng.random() < 0.5:
        keep[[a - 5, a - 4]] = keep[[a - 4, a - 5]]
    return Fields(*(field[keep] for field in log))


MUTATIONS: dict[str, Callable[[Fields, np.random.Generator], Fields]] = {
    mutation.__name__: mutation
    for mutation in (
        rolled,
        degrees,
        permuted,
        other_frame,
        y_up,
        millimetres,
        glitch,
        floating,
        upside_down,
        shuffled,
    )
}


def turned(one: Motion, model: pin.Model, angle: float) -> Motion:
    """The motion on another heading: at zero some conventions cannot be told apart."""
    turn = pin.SE3(pin.rpy.rpyToMatrix(0, 0, angle), np.array([0.5, -0.3, 0.0]))
    q = one.q.copy()
    for row in q:
        row[:7] = pin.SE3ToXYZQUAT(turn * pin.XYZQUATToSE3(row[:7]))
    return Motion(one.time, q, differences(model, one.time, q))


def fate(path: Path, robot: robots.Robot, wanted: robots.States) -> Fate:
    """What becomes of a log."""
    log = robots.Log(path, robot)
    try:
        pieces = list(log)
    except InputError as error:
        return Fate("refused", str(error).removeprefix(f"{path}: "))
    if log.notes:
        return Fate("noted", log.notes[0].removeprefix(f"{path}: "))
    found = robots.States(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))
    same = len(found.t) == len(wanted.t) and all(
        np.abs(one - other).max() < SAME
        for one, other in ((found.com, wanted.com), (found.com_velocity, wanted.com_velocity))
    )
    return Fate("corrected" if same else "silent", "")


def table(each: int = EACH, seed: int = 0) -> dict[str, list[Fate]]:
    """The fates of this many mutations of each kind, on two robots and as many headings."""
    found: dict[str, list[Fate]] = {name: [] for name in MUTATIONS}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.npz"
        for kind, name in enumerate(("g1", "anymal")):
            robot, one = robots.load(name), motion(name, seconds=4.0)
            for number in range(kind, each, 2):
                rng = np.random.default_rng([seed, number])
                good = turned(one, robot.model, rng.uniform(0.5, 5.5))
                wanted = robots.states_of(robot, good.time, good.q, good.v)
                for mutation, change in MUTATIONS.items():
                    write_mujoco(path, good)
                    with np.load(path) as said:
                        log = change(Fields(said["time"], said["qpos"], said["qvel"]), rng)
                    np.savez(path, **log._asdict())
                    found[mutation].append(fate(path, robot, wanted))
    return found


def main(arguments: list[str] | None = None) -> int:
    """Prints the table."""
    parser = argparse.ArgumentParser(description="Mutate good logs and print what becomes of them.")
    parser.add_argument("--each", type=int, default=EACH, help="mutations of each kind")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    found = table(options.each, options.seed)
    print("| mutation | of | refused | noted | corrected | silent | for example |\n|---|---|---|---|---|---|---|")
    for name, fates in found.items():
        counts = Counter(one.word for one in fates)
        cells = [str(counts[word]) for word in ("refused", "noted", "corrected", "silent")]
        words = (MUTATIONS[name].__doc__ or "").strip().rstrip(".")
        print(f"| {words} | {len(fates)} | {' | '.join(cells)} | {next((one.why for one in fates if one.why), '')} |")
    return int(any(one.word == "silent" for fates in found.values() for one in fates))


if __name__ == "__main__":
    sys.exit(main())
