"""The subcommands of `jaxcap`: parse, call, write. Importing this module needs tyro and tqdm (extra `cli`)."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import jax
import numpy as np
import tyro
from tqdm import tqdm

from jaxcap.commands.compile_cache import compilation_cache
from jaxcap.commands.scorers import scorer_of
from jaxcap.commands.summary import Summary, rounding
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY
from jaxcap.errors import InputError
from jaxcap.files.columns import StateBatch, describe, refuse_clashes
from jaxcap.files.contact_columns import CHOICE, POINTS, BadRows, RowContacts
from jaxcap.files.contact_files import ContactSets, read_contact_sets
from jaxcap.files.fields import BASELINES, FIELDS
from jaxcap.files.records import read_states, write_scores
from jaxcap.files.whole_file import check_output

SCORE = """Score a file of robot states: can the robot stop without moving a contact?

EXAMPLES
  jaxcap score walk.parquet --contacts feet.yaml -o scores.parquet
  jaxcap score steps.parquet -o scores.parquet      # with columns of contacts

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

CONTACTS THAT DIFFER FROM ROW TO ROW
  Either CONTACTS has several sets, of which STATES chooses for each row:
    sets:
      - name: left            # optional
        contacts: [{type: point, position: [0, 0.1, 0], friction: 0.5}]
      - name: flight
        contacts: []          # no contact
    contact_set        integer, or text: the number of the set, from 0, or its
                       name; a file with contacts: is set 0
  Or STATES has the contacts, and there is no --contacts. For k contacts:
    contact_points     k x 3 numbers, or 3 k: positions [m]
    contact_frames     k x 3 x 3 numbers, or 9 k: rotations row by row, whose
                       third column is the normal, pointing at the robot
    contact_friction   k numbers, or one for all
    contact_mask       optional: k booleans, false for padding; without this
                       column, points of three NaN are padding
  In Parquet columns of lists, with another k in each row if need be; in NPZ
  arrays (n, k, 3), (n, k, 3, 3), (n, k). At most 64 contacts a row.
  A row without contacts has the case EMPTY: it is in flight.

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
  and with --baselines, negative outside and infinite for a polygon that is
  everything or nothing:
    capture_point_support   distance of the capture point to the support
                            polygon, where the CoM can stand [m]
    capture_point_hull      to the convex hull of the contact points [m]
  The capture point needs a height of the CoM, --height. By default it is
  that above the mean of the row's contact points; where it is not positive
  there is no capture point, and both columns are NaN.
  Its metadata holds units, conventions, the names of the numbers, contacts,
  gravity and version, as JSON: the key jaxcap of a Parquet schema, the array
  metadata of an NPZ. OUT is written whole or not at all.

BAD ROWS
  A state with NaN, infinity or a null gets the status nonfinite and no
  figures; the others are not affected. Contacts that cannot be used make a bad
  row too: a number that is not finite, a frame that is not a rotation, friction
  that is not positive, a set that is not there, lists that do not match. A note
  says how many there are, and what is wrong with the first (rows from 0).

TABLE
  At the end: counts of cases and statuses, quantiles of the margin (to within
  0.025 %), states per second.

COMPILING
  Takes seconds, once a run. With --cache DIR the programs are kept in DIR,
  which is made if need be, and the next run takes them from there. They are
  code: use no DIR that is written to by anyone whom you do not trust.

EXIT CODES
  0 done; 2 bad input, and one line says which; 130 interrupted.
"""
"""What `jaxcap score --help` says above the list of options; its first line also stands in `jaxcap --help`."""

ABOVE_CONTACTS = "of the CoM above the mean of the contact points"
"""What the metadata say about the default height."""


def score(
    states: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATES")],
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT")],
    contacts: Annotated[Path | None, tyro.conf.arg(metavar="CONTACTS")] = None,
    dtype: Literal["float32", "float64"] = "float32",
    sides: int = 4,
    batch_size: int = 65536,
    neighbours: bool = False,
    baselines: bool = False,
    height: Annotated[float | None, tyro.conf.arg(metavar="H")] = None,
    cache: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    force: bool = False,
) -> None:
    """Scores a file of states, writes the answers beside them and prints a summary; see SCORE.

    Raises InputError before anything is computed if an option, a file or a column cannot be used, and MissingExtra.

    Args:
        states: File of states, .parquet or .npz.
        output: File to write, .parquet or .npz.
        contacts: File of contacts, .yaml or .json; not needed if STATES has them.
        dtype: Precision of the computation and of the figures written.
        sides: Edges of the pyramid that replaces each friction cone, at least 3.
        batch_size: States that are read, scored and written at a time.
        neighbours: Rows that follow each other are similar states: saves work where each has its own contacts.
        baselines: Also write how far the capture point lies inside support polygon and hull of the contacts.
        height: CoM height for the capture point [m]; by default that above the contacts of each row.
        cache: Keep compiled programs in this directory.
        force: Overwrite OUT if it exists.
    """
    if height is not None and not baselines:
        raise InputError(f"--height {height} (expected with --baselines, which alone needs it)")
    if height is not None and not 0 < height < np.inf:
        raise InputError(f"--height {height} (expected a positive number of metres)")
    if sides < 3:
        raise InputError(f"--sides {sides} (expected at least 3)")
    if batch_size < 1:
        raise InputError(f"--batch-size {batch_size} (expected at least 1)")
    check_output(output, force=force, inputs=(states, contacts) if contacts else (states,))
    sets = read_contact_sets(contacts) if contacts else None
    with _precision(dtype), read_states(states, batch_size, dtype) as source, compilation_cache(cache):
        for name in source.skipped:
            print(f"note: {states}: {name!r} is not carried through: not one value for each state", file=sys.stderr)
        described = _contacts(states, source.contacts, contacts, sets)
        size = min(batch_size, source.rows)
        fields, more = FIELDS, {}
        if baselines:
            refuse_clashes(states, source.types, BASELINES)
            fields, more = FIELDS | BASELINES, {"capture_point_height": ABOVE_CONTACTS if height is None else height}
        scorer = scorer_of(described, contacts, size, sides, neighbours)
        answer = partial(_answers, scorer, baselines=baselines, height=height)
        metadata = describe(described, GRAVITY, sides, np.dtype(dtype), fields, **more)
        with write_scores(output, source.types, metadata, dtype, fields=fields, force=force) as sink:
            done = _score_all(answer, source, sink)
    for note in done.notes:
        print(f"note: {states}: {note}", file=sys.stderr)
    print(done.summary.table())
    rate = f"{done.summary.states / done.seconds:.3g} states/s" if done.summary.states else "no states"
    print(f"\n{rate} ({done.seconds:.2f} s, after {done.compiled:.2f} s of compiling; {dtype}, {jax.default_backend()})")


def _contacts(
    states, columns: tuple[str, ...], path, sets: ContactSets | None
) -> ContactSet | ContactSets | tuple[str, ...]:
    """What the contacts are: one set for all states, sets that CHOICE chooses from, or columns. Raises InputError."""
    if columns and columns != (CHOICE,):
        if sets is not None:
            raise InputError(f"{states}: column {columns[0]!r} gives each row its contacts (expected no --contacts {path})")
        return columns
    if sets is None:
        expected = f"--contacts, in which {CHOICE!r} chooses" if columns else f"--contacts, or columns {POINTS!r}, ..."
        raise InputError(f"{states}: no contacts (expected {expected})")
    if columns:
        return sets
    if len(sets.sets) > 1:
        raise InputError(f"{states}: no column {CHOICE!r}, which chooses among the {len(sets.sets)} sets of {path}")
    return sets.sets[0]


def _answers(scorer, batch: StateBatch, baselines: bool, height: float | None) -> tuple[tuple, BadRows | None]:
    """The scores of a batch, perhaps the baselines, and the rows whose contacts cannot be used."""
    rows = batch.contacts, batch.coms, batch.com_velocities
    out, bad = scorer.score(*rows)
    return ((out, scorer.baselines(*rows, height)) if baselines else (out,)), bad


class _Run(NamedTuple):
    """What there is to say at the end."""

    summary: Summary
    seconds: float
    """Time spent scoring [s]."""
    compiled: float
    """Time spent compiling [s]."""
    notes: tuple[str, ...]
    """How many rows have contacts that cannot be used, and why the first; that positions are rounded. Perhaps none."""


def _score_all(answer, source, sink) -> _Run:
    """Scores and writes every batch."""
    summary, seconds, compiled, widest, unusable, first, coarse = Summary(), 0.0, 0.0, -1, 0, "", ""
    with tqdm(total=source.rows, unit=" states", unit_scale=True, disable=not sys.stderr.isatty()) as bar:
        for batch in source:
            width = batch.contacts.mask.shape[1] if isinstance(batch.contacts, RowContacts) else 0
            if width > widest:  # compiles, by scoring states that are soon done with
                widest = width
                compiled += _timed(answer, batch._replace(coms=np.full_like(batch.coms, np.nan)))[1]
            (answers, bad), spent = _timed(answer, batch)
            seconds += spent
            if bad is not None and bad.rows.any():
                first = first or f"first row {summary.states + bad.first}: {bad.why}"
                unusable += int(bad.rows.sum())
            sink.write(batch.columns, *answers)
            summary.add(answers[0])
            coarse = coarse or rounding(batch.coms)
            bar.update(len(batch.coms))
    without = f"the contacts of {unusable} rows cannot be used, these have status nonfinite; {first}" if unusable else ""
    return _Run(summary, seconds, compiled, tuple(filter(None, (without, coarse))))


def _timed(answer, batch: StateBatch):
    """The answers for a batch, and the time they took [s]."""
    start = time.perf_counter()
    return answer(batch), time.perf_counter() - start


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
