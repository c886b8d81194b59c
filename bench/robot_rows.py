"""How fast robot states become rows to score, and how much memory a long log takes.

    python -m bench.robot_rows [--rows N] [--long 100000 1000000 10000000]

Rows a second of `centroidal_states` (q, v to CoM, velocity, momentum), of `states_of` (contacts and checks too), and of
Pinocchio called state by state; best of three, in the same run. `--long`: logs of so many rows are written as HDF5, piece by
piece, and `jaxcap states` is run on each in a process of its own, whose peak of memory should not grow with them.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

from bench.process import in_process
from bench.robot_motion import motion
from jaxcap import robots

TIMES = 100
"""Copies of the motion that are written at a time."""


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
    """A log of one episode in Isaac Lab's layout, without velocities, written by pieces: G1 steps, stands, steps, ..."""
    import h5py

    one, model = motion("g1"), robots.load("g1").model
    order = [list(model.names)[2:].index(name) for name in robots.motion.robot_order(model, "breadth first")]
    fields = {"root_pose": one.q[:, :7], "joint_position": one.q[:, 7:][:, order]}
    with h5py.File(path, "w") as file:
        file.attrs["DATASET_FORMAT_VERSION"] = 1
        group = file.create_group("data/demo_0/states/articulation/robot")
        for name, values in fields.items():
            piece = np.tile(values.astype(np.float32), (TIMES, 1))
            target = group.create_dataset(name, (rows, values.shape[1]), np.float32, chunks=(4000, values.shape[1]))
            for start in range(0, rows, len(piece)):
                target[start : start + len(piece)] = piece[: rows - start]


def memory(rows: int) -> str:
    """What `jaxcap states` of a long log takes, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        log, states = (str(Path(folder) / name) for name in ("long.hdf5", "states.parquet"))
        long_log(Path(log), rows)
        cost = in_process(["states", log, "--robot", "g1", "-o", states])
        return f"| jaxcap states, a log of {rows:,} rows | {rows / cost.seconds:,.0f} | {cost.peak_bytes / 1e6:,.0f} MB |"


def main(arguments: list[str] | None = None) -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description="Rows a second from (q, v) to states.")
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--long", type=int, nargs="*", default=[], help="rows of long logs")
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
    for rows in given.long:
        print(memory(rows), flush=True)


if __name__ == "__main__":
    main()
