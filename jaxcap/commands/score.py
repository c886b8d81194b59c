"""`jaxcap score`: parse, call, write. Importing this module needs tyro and tqdm (extra `cli`)."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import jax
import numpy as np
import tyro

from jaxcap.commands.compile_cache import compilation_cache
from jaxcap.commands.options import check_mass, check_momentum_box, check_sides
from jaxcap.commands.robot_limits import counted
from jaxcap.commands.score_file import Settings, score_file
from jaxcap.commands.score_folder import is_many, score_folder
from jaxcap.commands.states import LogOptions, check_plain, states_of_log
from jaxcap.commands.where import Where, check_where
from jaxcap.errors import InputError
from jaxcap.files.contact_files import read_contact_sets
from jaxcap.files.whole_file import check_output


def score(
    states: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATES")],
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT")],
    contacts: Annotated[Path | None, tyro.conf.arg(metavar="CONTACTS")] = None,
    robot: Annotated[str | None, tyro.conf.arg(metavar="ROBOT")] = None,
    log: tyro.conf.OmitArgPrefixes[LogOptions] = LogOptions(),  # noqa: B008
    where: tyro.conf.OmitArgPrefixes[Where] = Where(),  # noqa: B008
    dtype: Literal["float32", "float64"] = "float32",
    sides: int = 4,
    batch_size: int = 65536,
    neighbours: bool = False,
    baselines: bool = False,
    height: Annotated[float | None, tyro.conf.arg(metavar="H")] = None,
    mass: Annotated[float | None, tyro.conf.arg(metavar="M")] = None,
    momentum_box: Annotated[float, tyro.conf.arg(metavar="BOX")] = 0.0,
    point_mass: bool = False,
    cache: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    no_cache: bool = False,
    strict: bool = False,
    force: bool = False,
) -> None:
    """Scores a file of states, writes the answers beside them and prints a summary; see SCORE.

    Raises InputError before anything is computed if an option, a file or a column cannot be used, and MissingExtra.

    Args:
        states: File of states, .parquet, .npz or .csv; or a folder or a glob of Parquet files.
        output: File to write, .parquet or .npz; or a folder, if STATES is many files, or one that is scored in parts.
        contacts: File of contacts, .yaml or .json; not needed if STATES has them.
        robot: STATES is the log of this robot: its name, or URDF or MJCF file. See jaxcap states --help. Its torque limits
            and its angular momentum count.
        log: How it is read.
        where: Where many files are scored.
        dtype: Precision of the computation and of the figures written.
        sides: Edges of the pyramid that replaces each friction cone, at least 3.
        batch_size: States that are read, scored and written at a time.
        neighbours: Rows that follow each other are similar states: saves work where each has its own contacts.
        baselines: Also write how far the capture point lies inside support polygon and hull of the contacts.
        height: CoM height for the capture point [m]; by default that above the contacts of each row.
        mass: Of the robot [kg]: the column angular_momentum counts then. With --robot the robot's by default.
        momentum_box: How much the rate of angular momentum over mass may differ, in each component, from what
            braking brings about [m^2/s^2].
        point_mass: With --robot, neither its torque limits nor its angular momentum count: the paper's model.
        cache: Keep compiled programs in this directory, not in your cache folder.
        no_cache: Keep none and take none.
        strict: What is hardly plausible is an error, not a note.
        force: Overwrite OUT if it exists.
    """
    _check_options(sides, batch_size, baselines, height, mass)
    _check_box(momentum_box, point_mass)
    check_where(where)
    if many := robot is None and is_many(states, output):
        check_plain(log)
    else:
        if where != Where():
            raise InputError(f"{where.given} (expected with many Parquet files as STATES, or one and a folder as OUT)")
        check_output(output, force=force, inputs=tuple(path for path in (states, contacts) if path))
    sets = read_contact_sets(contacts) if contacts else None
    how = Settings(
        contacts, sets, dtype, sides, batch_size, neighbours, baselines, height, mass, momentum_box, strict, cache, no_cache
    )
    if many:
        with compilation_cache(cache, no_cache):
            score_folder(states, output, how, counted(None, point_mass, mass), where, force=force)
        return
    with (
        jax.enable_x64(dtype == "float64"),
        states_of_log(states, robot, log, output, strict) as (file, whose),
    ):
        say = lambda words: print(f"note: {states}: {words}", file=sys.stderr)
        run = score_file(file, output, how, counted(whose, point_mass, mass), named=states, force=force, say=say)
    for note in run.notes():
        print(f"note: {states}: {note}", file=sys.stderr)
    print(run.summary.table())
    rate = f"{run.summary.states / run.seconds:.3g} states/s" if run.summary.states else "no states"
    print(f"\n{rate} ({run.seconds:.2f} s, after {run.compiled:.2f} s of compiling; {dtype}, {jax.default_backend()})")


def _check_options(sides: int, batch_size: int, baselines: bool, height: float | None, mass: float | None) -> None:
    """Raises InputError for an option that cannot be used."""
    if height is not None and not baselines:
        raise InputError(f"--height {height} (expected with --baselines, which alone needs it)")
    if height is not None and not 0 < height < np.inf:
        raise InputError(f"--height {height} (expected a positive number of metres)")
    check_mass(mass)
    check_sides(sides)
    if batch_size < 1:
        raise InputError(f"--batch-size {batch_size} (expected at least 1)")


def _check_box(momentum_box: float, point_mass: bool) -> None:
    """Raises InputError for a box that cannot be used."""
    check_momentum_box(momentum_box)
    if momentum_box and point_mass:
        raise InputError(f"--momentum-box {momentum_box} (expected without --point-mass, which is the paper's model)")
