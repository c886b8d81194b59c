"""The work of a campaign as it is sent to other processes: a sample's row, and what such a process has to be like."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from jaxcap.errors import InputError
from reference.tsid.labels import Row, Settings, labeller
from reference.tsid.robot import entries_of

LIBRARIES = ("numpy", "scipy", "pin", "coal", "example-robot-data", "daqp", "proxsuite", "numba", "pyarrow")

THREADS = "OMP_NUM_THREADS"
"""The environment variable that NumPy and SciPy take the number of their threads from."""

ONE_CORE = dict.fromkeys((THREADS, "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a process whose linear algebra uses one core."""


def versions() -> dict[str, str]:
    """Of the libraries."""
    return {name: version(name) for name in LIBRARIES}


def _digest(files: list[Path]) -> str:
    return hashlib.sha256(b"".join(file.read_bytes() for file in sorted(files))).hexdigest()[:12]


SOURCES = _digest([*Path(__file__).parent.glob("*.py")])
"""Of the simulator, as this process has read them: a worker that was started before they changed is told from others."""


def about() -> dict[str, str]:
    """What rows depend on besides the settings: the libraries, the simulator, and how many threads they use."""
    return {**versions(), "reference.tsid": SOURCES, THREADS: os.environ.get(THREADS, "not set")}


def robot_hash(robot: str) -> str:
    """SHA-256 of a robot's configuration."""
    return hashlib.sha256(json.dumps(entries_of(robot), sort_keys=True).encode()).hexdigest()


class Labelling(NamedTuple):
    """The work on a sample."""

    settings: Settings
    robot: str
    """A name, or a file that all processes see."""
    key: str
    """Stands for both."""

    def __call__(self, index: int) -> Row:
        """The row of a sample. The robot is loaded for the first one."""
        if self.key not in _labellers:
            if robot_hash(self.robot) != self.settings.robot_hash:
                raise InputError(f"robot {self.robot}: has another configuration here (expected that of the campaign)")
            _labellers.clear()
            _labellers[self.key] = labeller(self.settings, self.robot)
        return _labellers[self.key](index)


def labelling(settings: Settings, robot: str) -> Labelling:
    """The work on samples of this robot."""
    text = json.dumps([settings._asdict(), robot], sort_keys=True)
    return Labelling(settings, robot, hashlib.sha256(text.encode()).hexdigest())


_labellers: dict[str, Callable[[int], Row]] = {}
"""The last one that this process has made, by its key."""
