"""What a campaign's file holds, as arrays: states, contacts, and what became of each robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int, Shaped
from scipy.spatial.transform import Rotation

from reference.tsid.table import Unreadable, columns

BEST = "best of 3"
"""Name of the outcome of V-A: the best one of standard, straight and fast."""

FOUR = "best of 4"
"""The best one of these and "brake"."""

ABLATIONS = "standard straight no_torque no_position no_position_torque no_position_velocity no_limits"

FILES = {
    "two_coplanar": "--samples 10000",
    "two": "--samples 10000",
    "three": "--samples 10000",
    "four": "--samples 10000",
    "four_strong": "--samples 2000",
    "two_ablations": f"--samples 2000 --all --controllers {ABLATIONS}",
    "three_ablations": f"--samples 2000 --all --controllers {ABLATIONS}",
    "two_zero_momentum": "--samples 2000 --all --zero-momentum --controllers standard constant_momentum",
    "three_zero_momentum": "--samples 2000 --all --zero-momentum --controllers standard constant_momentum",
    "three_strong_arms": "--samples 1000 --robot talos_strong_arms --states 1000",
    "four_strong_arms": "--samples 1000 --robot talos_strong_arms --states 1000",
    "two_coplanar_g1": "--samples 250 --robot g1 --states 1000",
    "two_g1": "--samples 250 --robot g1 --states 1000",
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


class Samples(NamedTuple):
    """The samples of one file whose simulation did not fail. World frame: z up, origin at the centre of the left sole."""

    name: str
    """The file's, without its suffix."""
    scenario: str
    """One of `sampling.SCENARIOS`."""
    robot: str
    """Its name."""
    seed: int
    zero_momentum: bool
    """Whether pushes have no angular momentum."""
    controllers: tuple[str, ...]
    """In the order in which they ran."""
    index: Int[np.ndarray, " n"]
    """Number of the sample: the same posture in all files of a scenario."""
    q: Float[np.ndarray, "n nq"]
    """Base position [m] and orientation (quaternion x, y, z, w), joints [rad]; NaN where the file does not hold them."""
    v: Float[np.ndarray, "n nv"]
    """Base velocity in its own frame [m/s, rad/s], joints [rad/s], just after the push; NaN as q is."""
    com: Float[np.ndarray, "n 3"]
    """[m]"""
    com_velocity: Float[np.ndarray, "n 3"]
    """[m/s]"""
    angular_momentum: Float[np.ndarray, "n 3"]
    """About the CoM [kg m^2/s]."""
    contacts: Contacts
    effort: Float[np.ndarray, " n"]
    """Share of the torque limits that holding the posture takes [-]: above 1 it cannot be held."""
    outcomes: dict[str, Shaped[np.ndarray, " n"]]
    """What a margin is held against, by name: BEST and FOUR, unless every controller ran on all, and each that did so."""
    runs: dict[str, Runs]
    """By controller."""
    failed: int
    """How many rows hold an error in place of a result: in none of the arrays."""


def read(path: Path, first: int | None = None) -> Samples:
    """Samples of a file that `python -m reference.tsid.campaign` wrote, of its first rows only if `first` says how many.

    Raises `reference.tsid.table.Unreadable` if it is another, or if no row holds a result.
    """
    settings, _, table = columns(Path(path), first)
    rows = len(table)
    table = table.filter(table["error"].is_null()).combine_chunks()
    if not len(table):
        raise Unreadable(f"{path}: none of its {rows} rows holds a result")
    vector = lambda name: _numbers(table[name].combine_chunks())
    runs = {name: _runs(table, name, settings["options"]["dt"]) for name in settings["controllers"]}
    best = {BEST: "outcome", FOUR: "best_of_four"}
    outcomes = {name: _words(table[column]) for name, column in best.items() if column in table.column_names}
    outcomes |= {name: run.outcomes for name, run in runs.items() if (run.outcomes != "").all()}
    return Samples(
        name=Path(path).stem,
        scenario=settings["scenario"],
        robot=settings["robot"],
        seed=settings["seed"],
        zero_momentum=settings["zero_momentum"],
        controllers=tuple(settings["controllers"]),
        index=table["index"].to_numpy(),
        q=vector("q"),
        v=vector("v"),
        com=vector("com"),
        com_velocity=vector("com_velocity"),
        angular_momentum=vector("angular_momentum"),
        contacts=_contacts(table["contacts"].combine_chunks(), settings),
        effort=table["effort"].to_numpy().astype(float),
        outcomes=outcomes,
        runs=runs,
        failed=rows - len(table),
    )


def _numbers(column: pa.FixedSizeListArray) -> Float[np.ndarray, "n m"]:
    """A column of vectors; NaN where it is null."""
    size = column.type.list_size
    found = np.full((len(column), size), np.nan)
    found[~column.is_null().to_numpy(zero_copy_only=False)] = column.flatten().to_numpy().reshape(-1, size)
    return found


def _words(column: pa.ChunkedArray) -> Shaped[np.ndarray, " n"]:
    """A column of words; empty where it is null."""
    return np.array(["" if word is None else word for word in column.to_pylist()])


def _contacts(column: pa.ListArray, settings: dict[str, Any]) -> Contacts:
    """As many in each row: that is what a scenario is."""
    flat, n = column.flatten(), len(column)
    effectors = np.array(flat.field("effector").to_pylist()).reshape(n, -1)
    size = lambda name: np.vectorize(lambda effector: settings["effectors"][effector][name], otypes=[float])(effectors)
    quaternions = _numbers(flat.field("quaternion"))
    return Contacts(
        effectors=effectors,
        positions=_numbers(flat.field("position")).reshape(*effectors.shape, 3),
        rotations=Rotation.from_quat(quaternions).as_matrix().reshape(*effectors.shape, 3, 3),
        half_lengths=size("half_length"),
        half_widths=size("half_width"),
        friction=np.full(effectors.shape, settings["sampling"]["friction"]),
    )


def _runs(table: pa.Table, controller: str, dt: float) -> Runs:
    words = (_words(table[f"{controller}_{name}"]) for name in ("outcome", "reason"))
    return Runs(*words, dt * table[f"{controller}_steps"].cast(pa.float64()).to_numpy())


def command(name: str) -> str:
    """What makes the file of that name."""
    kinds = ("_ablations", "_zero_momentum", "_strong_arms", "_g1")
    scenario = next((name.removesuffix(kind) for kind in kinds if name.endswith(kind)), name)
    return f"python -m reference.tsid.campaign {scenario} -o {name}.parquet --jobs 2 --seed 2018 {FILES[name]}"


def paths_of(folder: Path) -> list[Path]:
    """All files of a folder: first those of FILES, in that order."""
    paths = {path.stem: path for path in sorted(Path(folder).glob("*.parquet"))}
    return [paths[name] for name in FILES if name in paths] + [paths[name] for name in paths if name not in FILES]


def read_all(folder: Path, first: int | None = None) -> dict[str, Samples]:
    """All files of a folder, by name, in the order of `paths_of`. Raises as `read` does."""
    return {path.stem: read(path, first) for path in paths_of(folder)}


def among(samples: dict[str, Samples], *names: str) -> list[Samples]:
    """Those of these names that are there. Raises MissingFile if none is."""
    found = [samples[name] for name in names if name in samples]
    if not found:
        raise MissingFile("; ".join(f"no {name}.parquet, made by: {command(name)}" for name in names))
    return found
