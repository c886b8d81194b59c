"""How fast robot states become rows to score, and how much memory a long log takes.

    python -m bench.robot_rows [--rows N] [--long N]

Rows a second of `centroidal_states` (q, v to CoM, velocity, momentum), of `states_of` (contacts and checks too), and of
Pinocchio called state by state; best of three, in the same run. `--long`: a log of so many rows is written as HDF5 and read
as `jaxcap states` reads it; memory is what the process grew by.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import psutil

from bench.robot_motion import motion
from jaxcap import robots


def best(call: Callable[[], object], rows: int, rounds: int = 3) -> float:
    """Rows a second."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return rows / min(times)


def by_pinocchio(model: pin.Model, q: np.ndarray, v: np.ndarray) -> None:
    """One state a call."""
    data = model.createData()
    for one_q, one_v in zip(q, v, strict=True):
        pin.computeCentroidalMomentum(model, data, one_q, one_v)


def long_log(path: Path, rows: int) -> None:
    """A log of one episode, written piece by piece in Isaac Lab's layout."""
    import h5py

    one, model = motion("g1"), robots.load("g1").model
    order = [list(model.names)[2:].index(name) for name in robots.motion.robot_order(model, "breadth first")]
    fields = {"root_pose": one.q[:, :7], "joint_position": one.q[:, 7:][:, order]}
    with h5py.File(path, "w") as file:
        file.attrs["DATASET_FORMAT_VERSION"] = 1
        group = file.create_group("data/demo_0/states/articulation/robot")
        for name, values in fields.items():
            target = group.create_dataset(name, (rows, values.shape[1]), np.float32, chunks=(4000, values.shape[1]))
            for start in range(0, rows, len(values)):
                target[start : start + len(values)] = values[: rows - start]


def memory(rows: int) -> str:
    """What reading a long log takes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.hdf5"
        long_log(path, rows)
        process, robot = psutil.Process(), robots.load("g1")
        before, most, seen, start = process.memory_info().rss, 0, 0, time.perf_counter()
        for piece in robots.Log(path, robot):
            seen += len(piece.t)
            most = max(most, process.memory_info().rss - before)
        return f"| a log of {seen:,} rows | {seen / (time.perf_counter() - start):,.0f} | {most / 1e6:,.0f} MB |"


def main(arguments: list[str] | None = None) -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description="Rows a second from (q, v) to states.")
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--long", type=int, default=0, help="rows of a long log")
    given = parser.parse_args(arguments)
    robot, one = robots.load("g1"), motion("g1", seconds=4.0)
    times = -(-given.rows // len(one.q))
    q, v = np.tile(one.q, (times, 1))[: given.rows], np.tile(one.v, (times, 1))[: given.rows]
    clock = np.arange(given.rows) / 50
    print("| G1, 29 joints | rows/s | memory |\n|---|---|---|")
    calls = {
        "Pinocchio, state by state": lambda: by_pinocchio(robot.model, q, v),
        "centroidal_states": lambda: robots.centroidal_states(robot.model, q, v),
        "states_of: contacts and checks too": lambda: robots.states_of(robot, clock, q, v),
    }
    for name, call in calls.items():
        print(f"| {name} | {best(call, given.rows):,.0f} | |")
    if given.long:
        print(memory(given.long))


if __name__ == "__main__":
    main()
