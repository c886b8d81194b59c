"""What a campaign's file holds, as arrays: states, contacts, and what became of each robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

from reference.tsid.table import Unreadable
from reference.tsid.table import read as read_rows

BEST = "best of 3"
"""Name of the outcome of V-A: the best one of standard, straight and fast."""

ABLATIONS = "standard straight no_torque no_position no_position_torque no_position_velocity no_limits"

FILES = {
    "two_coplanar": "--samples 10000",
    "two": "--samples 10000",
    "three": "--samples 10000",
    "four": "--samples 10000",
    "two_ablations": f"--samples 2000 --all --controllers {ABLATIONS}",
    "three_ablations": f"--samples 2000 --all --controllers {ABLATIONS}",
    "two_zero_momentum": "--samples 2000 --all --zero-momentum --controllers standard constant_momentum",
    "three_zero_momentum": "--samples 2000 --all --zero-momentum --controllers standard constant_momentum",
}
"""The files of a whole campaign, and the options that made them: `command`."""


class MissingFile(Exception):
    """A figure or table needs a file that is not there; the message says which command makes it."""


class Contacts(NamedTuple):
    """Rectangles of n samples, k of them in each."""

    effectors: Shaped[np.ndarray, "n k"]
    """Names of what touches."""
    positions: Float[np.ndarray, "n k 3"]
    """Centres [m]."""
    rotations: Float[np.ndarray, "n k 3 3"]
    """Frames; columns: along the length, along the width, normal into the robot."""
    half_lengths: Float[np.ndarray, "n k"]
    """[m]"""
    half_widths: Float[np.ndarray, "n k"]
    """[m]"""
    friction: Float[np.ndarray, "n k"]
    """mu [-]."""


class Runs(NamedTuple):
    """What became of n samples under one controller. Where it did not run: empty text and NaN."""

    outcomes: Shaped[np.ndarray, " n"]
    """`stopped`, `undecided`, `fallen`."""
    reasons: Shaped[np.ndarray, " n"]
    """`stopped`; `infeasible` or `slip`; `time` or `unsolved`."""
    times: Float[np.ndarray, " n"]
    """Of the end [s]."""
    com_ends: Float[np.ndarray, "n 3"]
    """CoM at the end [m]."""


class Samples(NamedTuple):
    """The samples of one file whose simulation did not fail. World frame: z up, origin at the centre of the left sole."""

    name: str
    """The file's, without its suffix."""
    scenario: str
    """`two_coplanar`, `two`, `three`, `four`."""
    seed: int
    controllers: tuple[str, ...]
    """In the order in which they ran."""
    index: Int[np.ndarray, " n"]
    """Number of the sample: the same posture in all files of a scenario."""
    q: Float[np.ndarray, "n nq"]
    """Base position [m] and orientation (quaternion x, y, z, w), joints [rad]."""
    v: Float[np.ndarray, "n nv"]
    """Base velocity in its own frame [m/s, rad/s], joints [rad/s], just after the push."""
    com: Float[np.ndarray, "n 3"]
    """[m]"""
    com_velocity: Float[np.ndarray, "n 3"]
    """[m/s]"""
    angular_momentum: Float[np.ndarray, "n 3"]
    """About the CoM [kg m^2/s]."""
    contacts: Contacts
    outcomes: dict[str, Shaped[np.ndarray, " n"]]
    """What a margin is held against, by name: BEST, if not all controllers ran on every sample, and each that did."""
    runs: dict[str, Runs]
    """By controller."""
    failed: int
    """How many rows hold an error in place of a result: in none of the arrays."""


def read(path: Path, first: int | None = None) -> Samples:
    """Samples of a file that `python -m reference.tsid.campaign` wrote, of its first rows only if `first` says how many.

    Raises `reference.tsid.table.Unreadable` if it is another, or if no row holds a result.
    """
    settings, _, rows = read_rows(Path(path))
    rows = rows[:first]
    good = [row for row in rows if "error" not in row]
    if not good:
        raise Unreadable(f"{path}: none of its {len(rows)} rows holds a result")
    vector = lambda name: np.array([row[name] for row in good], dtype=float)
    runs = {name: _runs(good, name) for name in settings["controllers"]}
    outcomes = {} if settings["every"] else {BEST: np.array([row["outcome"] for row in good])}
    outcomes |= {name: run.outcomes for name, run in runs.items() if (run.outcomes != "").all()}
    return Samples(
        name=Path(path).stem,
        scenario=settings["scenario"],
        seed=settings["seed"],
        controllers=tuple(settings["controllers"]),
        index=np.array([row["index"] for row in good]),
        q=vector("q"),
        v=vector("v"),
        com=vector("com"),
        com_velocity=vector("com_velocity"),
        angular_momentum=vector("angular_momentum"),
        contacts=_contacts(good),
        outcomes=outcomes,
        runs=runs,
        failed=len(rows) - len(good),
    )


def _contacts(rows: list[dict[str, Any]]) -> Contacts:
    """As many in each row: that is what a scenario is."""
    column = lambda name: np.array([[contact[name] for contact in row["contacts"]] for row in rows])
    rotations = column("rotation")
    return Contacts(
        effectors=column("effector"),
        positions=column("position"),
        rotations=rotations.reshape(*rotations.shape[:2], 3, 3),
        half_lengths=column("half_length"),
        half_widths=column("half_width"),
        friction=column("friction"),
    )


def _runs(rows: list[dict[str, Any]], controller: str) -> Runs:
    column = lambda name, absent: np.array([row.get(f"{controller}_{name}", absent) for row in rows])
    nowhere = [np.nan] * 3
    return Runs(column("outcome", ""), column("reason", ""), column("time", np.nan), column("com_end", nowhere))


def command(name: str) -> str:
    """What makes the file of that name."""
    scenario = name.removesuffix("_ablations").removesuffix("_zero_momentum")
    return f"python -m reference.tsid.campaign {scenario} -o {name}.parquet --jobs 2 --seed 2018 {FILES[name]}"


def read_all(folder: Path, first: int | None = None) -> dict[str, Samples]:
    """All files of a folder, by name: first those of FILES, in that order. Raises as `read` does."""
    paths = {path.stem: path for path in sorted(Path(folder).glob("*.parquet"))}
    names = [name for name in FILES if name in paths] + [name for name in paths if name not in FILES]
    return {name: read(paths[name], first) for name in names}


def among(samples: dict[str, Samples], *names: str) -> list[Samples]:
    """Those of these names that are there. Raises MissingFile if none is."""
    found = [samples[name] for name in names if name in samples]
    if not found:
        raise MissingFile("; ".join(f"no {name}.parquet, made by: {command(name)}" for name in names))
    return found
