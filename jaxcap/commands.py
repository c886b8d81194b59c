"""The subcommands of `jaxcap`: parse, call, write. Importing this module needs tyro and tqdm (extra `cli`)."""

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import jax
import numpy as np
import tyro
from tqdm import tqdm

import jaxcap
from jaxcap.capturability import GRAVITY
from jaxcap.columns import describe
from jaxcap.contact_files import read_contacts
from jaxcap.errors import InputError
from jaxcap.records import check_output, read_states, write_scores
from jaxcap.summary import Summary

SCORE = """Score a file of robot states: can the robot stop without moving a contact?

EXAMPLE
  jaxcap score walk.parquet --contacts feet.yaml -o scores.parquet

STATES is Parquet (.parquet) or NPZ (.npz), with one row for each state:
    com            3 numbers   centre of mass [m]
    com_velocity   3 numbers   its velocity [m/s]
  Floats or integers; in Parquet a column of lists, in NPZ an array (n, 3). Or
  one column for each axis: com_x, com_y, com_z, com_velocity_x, and so on.
  All in one inertial frame with z up, the frame of the contacts as well.
  Other columns are carried through. The file is read in pieces and may be
  larger than memory.

CONTACTS is YAML (.yaml, .yml) or JSON (.json):
    contacts:
      - type: rectangle       # a sole or a hand: contacts at its 4 corners
        name: left_sole       # optional
        position: [0, 0.1, 0] # centre [m]
        rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
        half_length: 0.105    # along the first column of the rotation [m]
        half_width: 0.065     # along the second column [m]
        friction: 0.5
      - type: point
        position: [0.5, 0, 1]
        friction: 0.7
  The third column of the rotation is the contact's normal, pointing at the
  robot. Without a rotation the axes are x, y, z.

OUT is Parquet or NPZ: all columns of STATES, and for each state
    capturable       whether it can come to rest
    case             how it ends: C1, C2, C3_1, ..., as a number
    status           whether to trust that: ok, no_direction, ..., as a number
    margin           speed to add or to shed before the verdict flips, exact,
                     negative where not capturable [m/s]
    min_speed        smallest and
    max_speed        largest capturable speed in that direction [m/s]
    paper_margin     the paper's own proxy: deceleration at the stop [m/s^2];
                     where not capturable, minus the speed left [m/s]
    distance, time   to the stop [m], [s]
    residual_speed   speed left where there is no stop [m/s]
  Its metadata holds units, conventions, the names of the numbers, contacts,
  gravity and version, as JSON: the key jaxcap of a Parquet schema, the array
  metadata of an NPZ. OUT is written whole or not at all.

BAD ROWS
  A state with NaN, infinity or a null gets the status nonfinite and no
  figures; the others are not affected.

TABLE
  At the end: counts of cases and statuses, quantiles of the margin (to within
  0.025 %), states per second.

EXIT CODES
  0 done; 2 bad input, and one line says which; 130 interrupted.
"""
"""What `jaxcap score --help` says above the list of options; its first line also stands in `jaxcap --help`."""


def score(
    states: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATES")],
    *,
    contacts: Annotated[Path, tyro.conf.arg(metavar="CONTACTS")],
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT")],
    dtype: Literal["float32", "float64"] = "float32",
    sides: int = 4,
    batch_size: int = 65536,
    force: bool = False,
) -> None:
    """Scores a file of states, writes the answers beside them and prints a summary; see SCORE.

    Raises InputError before anything is computed if an option, a file or a column cannot be used, and MissingExtra.

    Args:
        states: File of states, .parquet or .npz.
        contacts: File of contacts, .yaml or .json.
        output: File to write, .parquet or .npz.
        dtype: Precision of the computation and of the figures written.
        sides: Edges of the pyramid that replaces each friction cone, at least 3.
        batch_size: States that are read, scored and written at a time.
        force: Overwrite OUT if it exists.
    """
    if sides < 3:
        raise InputError(f"--sides {sides} (expected at least 3)")
    if batch_size < 1:
        raise InputError(f"--batch-size {batch_size} (expected at least 1)")
    check_output(output, force=force, inputs=(states, contacts))
    contact_set = read_contacts(contacts)
    with _precision(dtype), read_states(states, batch_size, dtype) as source:
        for name in source.skipped:
            print(f"note: {states}: {name!r} is not carried through: not one value for each state", file=sys.stderr)
        try:
            cone = jaxcap.centroidal_cone(contact_set, sides=sides)
        except ValueError as error:
            raise InputError(f"{contacts}: {error}") from error
        metadata = describe(contact_set, GRAVITY, sides, np.dtype(dtype))
        with write_scores(output, source.types, metadata, dtype, force=force) as sink:
            size = min(batch_size, source.rows)
            compiled = _compile(cone, size, dtype)
            summary, seconds = _score_all(cone, source, sink, size)
    print(summary.table())
    rate = f"{summary.states / seconds:.3g} states/s" if summary.states else "no states"
    print(f"\n{rate} ({seconds:.2f} s, after {compiled:.2f} s of compiling; {dtype}, {jax.default_backend()})")


COMMANDS = {"score": (score, SCORE)}


def run(arguments: Sequence[str]) -> None:
    """Parses the arguments and runs the subcommand. Raises SystemExit after --help and for wrong usage."""
    app = tyro.extras.SubcommandApp()
    for name, (command, text) in COMMANDS.items():
        chosen = name in arguments[:1]  # the list of commands gives each one line
        app.command(command, name=name, help=text if chosen else text.partition("\n")[0])
    app.cli(
        prog="jaxcap",
        description="Can this robot still stop? Zero-step capturability in multi-contact.\n\n"
        "jaxcap --version prints the version.",
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )


def _score_all(cone, source, sink, size: int) -> tuple[Summary, float]:
    """Scores and writes every batch. Returns what was counted, and the time spent scoring [s]."""
    summary, seconds = Summary(), 0.0
    with tqdm(total=source.rows, unit=" states", unit_scale=True, disable=not sys.stderr.isatty()) as bar:
        for batch in source:
            start = time.perf_counter()
            out = _score(cone, batch.coms, batch.com_velocities, size)
            seconds += time.perf_counter() - start
            sink.write(batch.columns, out)
            summary.add(out)
            bar.update(len(batch.coms))
    return summary, seconds


def _score(cone, coms, com_velocities, size: int):
    """Scores, and waits for the answers. Zeros fill up to `size` rows, so that the last batch needs no compiling."""
    n = len(coms)
    padding = ((0, size - n), (0, 0))
    out = jaxcap.score(cone, np.pad(coms, padding), np.pad(com_velocities, padding), gravity=GRAVITY)
    return jax.tree.map(lambda field: np.asarray(field)[:n], out)


def _compile(cone, n: int, dtype: str) -> float:
    """Compiles for batches of n states, by scoring n states at rest. Returns the time it took [s]."""
    start = time.perf_counter()
    if n:
        _score(cone, np.zeros((0, 3), dtype), np.zeros((0, 3), dtype), n)
    return time.perf_counter() - start


@contextmanager
def _precision(dtype: str) -> Iterator[None]:
    """Allows float64 in JAX where asked for, and puts the switch back: only the command line may turn it."""
    before = jax.config.jax_enable_x64
    if dtype == "float64":
        jax.config.update("jax_enable_x64", True)
    try:
        yield
    finally:
        jax.config.update("jax_enable_x64", before)
