"""`jaxcap score`: parse, call, write. Importing this module needs tyro and tqdm (extra `cli`)."""

import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import jax
import numpy as np
import tyro
from tqdm import tqdm

from jaxcap.commands.compile_cache import compilation_cache
from jaxcap.commands.robot_limits import TorqueLimits, counted
from jaxcap.commands.scorers import Scorer, scorer_of
from jaxcap.commands.states import LogOptions, said_of_log, states_of_log
from jaxcap.commands.summary import Summary
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY
from jaxcap.errors import InputError
from jaxcap.files.bad_rows import BadRows
from jaxcap.files.columns import MOMENTUM, StateBatch, describe, refuse_clashes
from jaxcap.files.contact_columns import CHOICE, POINTS, RowContacts
from jaxcap.files.contact_files import ContactSets, read_contact_sets
from jaxcap.files.fields import BASELINES, FIELDS
from jaxcap.files.plausibility import Plausibility, some
from jaxcap.files.records import ScoreWriter, read_states, write_scores
from jaxcap.files.state_file import StateFile
from jaxcap.files.whole_file import check_output
from jaxcap.one_state.result import Capturability
from jaxcap.regions.capture_point import Baselines

ABOVE_CONTACTS = "of the CoM above the mean of the contact points"
"""What the metadata say about the default height."""


def score(
    states: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATES")],
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT")],
    contacts: Annotated[Path | None, tyro.conf.arg(metavar="CONTACTS")] = None,
    robot: Annotated[str | None, tyro.conf.arg(metavar="ROBOT")] = None,
    log: tyro.conf.OmitArgPrefixes[LogOptions] = LogOptions(),  # noqa: B008
    dtype: Literal["float32", "float64"] = "float32",
    sides: int = 4,
    batch_size: int = 65536,
    neighbours: bool = False,
    baselines: bool = False,
    height: Annotated[float | None, tyro.conf.arg(metavar="H")] = None,
    mass: Annotated[float | None, tyro.conf.arg(metavar="M")] = None,
    point_mass: bool = False,
    cache: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    no_cache: bool = False,
    strict: bool = False,
    force: bool = False,
) -> None:
    """Scores a file of states, writes the answers beside them and prints a summary; see SCORE.

    Raises InputError before anything is computed if an option, a file or a column cannot be used, and MissingExtra.

    Args:
        states: File of states, .parquet, .npz or .csv.
        output: File to write, .parquet or .npz.
        contacts: File of contacts, .yaml or .json; not needed if STATES has them.
        robot: STATES is the log of this robot: its name, or URDF or MJCF file. See jaxcap states --help. Its torque limits
            and its angular momentum count.
        log: How it is read.
        dtype: Precision of the computation and of the figures written.
        sides: Edges of the pyramid that replaces each friction cone, at least 3.
        batch_size: States that are read, scored and written at a time.
        neighbours: Rows that follow each other are similar states: saves work where each has its own contacts.
        baselines: Also write how far the capture point lies inside support polygon and hull of the contacts.
        height: CoM height for the capture point [m]; by default that above the contacts of each row.
        mass: Of the robot [kg]: the column angular_momentum counts then. With --robot the robot's by default.
        point_mass: With --robot, neither its torque limits nor its angular momentum count: the paper's model.
        cache: Keep compiled programs in this directory, not in your cache folder.
        no_cache: Keep none and take none.
        strict: What is hardly plausible is an error, not a note.
        force: Overwrite OUT if it exists.
    """
    _check_options(sides, batch_size, baselines, height, mass)
    check_output(output, force=force, inputs=tuple(path for path in (states, contacts) if path))
    sets = read_contact_sets(contacts) if contacts else None
    with (
        jax.enable_x64(dtype == "float64"),
        states_of_log(states, robot, log, output, strict) as (file, whose),
        nullcontext(counted(whose, point_mass, mass)) as known,
        read_states(file, rows := known.rows(batch_size), np.float64, known.mass) as source,
        compilation_cache(cache, no_cache),
    ):
        if known.words:
            print(f"note: {states}: {known.words}", file=sys.stderr)
        for name in source.skipped:
            print(f"note: {states}: {name!r} is not carried through: not one value for each state", file=sys.stderr)
        if whose is None and not source.momentum and {MOMENTUM, f"{MOMENTUM}_x"} & set(source.types):
            print(f"note: {states}: column {MOMENTUM!r} does not count without --mass", file=sys.stderr)
        described = _contacts(states, source.contacts, contacts, sets)
        size = min(rows, source.rows)
        fields = dict(FIELDS)
        more: dict[str, Any] = {} if known.mass is None else {"mass": known.mass}
        more |= {"counted": known.words} if known.words else {}
        if baselines:
            refuse_clashes(states, source.types, BASELINES)
            fields = FIELDS | BASELINES
            more["capture_point_height"] = ABOVE_CONTACTS if height is None else height
        scorer = scorer_of(described, contacts, size, sides, neighbours)
        answer = partial(_answered, scorer, limits=known.limits, baselines=baselines, height=height)
        metadata = describe(described, GRAVITY, sides, np.dtype(dtype), fields, source.momentum, **more)
        run = _Run(answer, scorer, strict)
        options: dict[str, Any] = {"fields": fields, "about": source.about, "force": force}
        with write_scores(output, source.types, metadata | said_of_log(source.about), dtype, **options) as sink:
            run.all(source, sink)
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
    if mass is not None and not 0 < mass < np.inf:
        raise InputError(f"--mass {mass} (expected a positive number of kilograms)")
    if sides < 3:
        raise InputError(f"--sides {sides} (expected at least 3)")
    if batch_size < 1:
        raise InputError(f"--batch-size {batch_size} (expected at least 1)")


def _contacts(
    states: Path, columns: tuple[str, ...], path: Path | None, sets: ContactSets | None
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


class _Answered(NamedTuple):
    """A batch, answered."""

    scores: Capturability
    baselines: tuple[Baselines, ...]
    """One, if it was asked for."""
    bad: BadRows
    """Rows whose contacts cannot be used."""
    seconds: float
    """Time it took [s]."""


def _answered(
    scorer: Scorer, batch: StateBatch, limits: TorqueLimits | None, baselines: bool, height: float | None
) -> _Answered:
    """Scores a batch."""
    start = time.perf_counter()
    rows = batch.contacts, batch.coms, batch.com_velocities
    actuation = None if limits is None else limits.of(batch)
    scores, bad = scorer.score(*rows, batch.specific_angular_momenta, actuation)
    beside = (scorer.baselines(*rows, height),) if baselines else ()
    return _Answered(scores, beside, bad, time.perf_counter() - start)


class _Unusable:
    """Counts rows that cannot be used, of all batches."""

    def __init__(self, what: str):
        self._what, self._n, self._first = what, 0, ""

    def add(self, bad: BadRows, start: int) -> None:
        """Takes a batch that begins with this row of the file."""
        self._n += int(bad.rows.sum())
        if bad.first is not None:
            self._first = self._first or f"first row {start + bad.first}: {bad.why}"

    def note(self) -> str:
        """How many there are, and why the first; nothing if there is none."""
        if not self._n:
            return ""
        return f"{self._what} of {self._n} rows cannot be used, these have status nonfinite; {self._first}"


class _Run:
    """Scores and writes every batch, and keeps what there is to say at the end."""

    def __init__(self, answer: Callable[[StateBatch], _Answered], scorer: Scorer, strict: bool):
        self._answer, self._scorer, self._strict = answer, scorer, strict
        self.summary = Summary()
        self.seconds, self.compiled = 0.0, 0.0
        """Time spent scoring, and compiling [s]."""
        self._states, self._contacts = _Unusable("the states"), _Unusable("the contacts")
        self._plausible = Plausibility()

    def all(self, source: StateFile, sink: ScoreWriter) -> None:
        """Scores a file. Raises InputError for what is hardly plausible, if that is asked for."""
        widest = -1
        with tqdm(total=source.rows, unit=" states", unit_scale=True, disable=None) as bar:
            for batch in source:
                width = batch.contacts.mask.shape[1] if isinstance(batch.contacts, RowContacts) else 0
                if width > widest:  # compiles, by scoring states that are soon done with
                    widest = width
                    self.compiled += self._answer(batch._replace(coms=np.full_like(batch.coms, np.nan))).seconds
                self._look(batch)
                sink.write(batch.columns, *self._scored(batch))
                bar.update(len(batch.coms))
        sink.remark(self.notes())

    def _look(self, batch: StateBatch) -> None:
        """Whether the batch is plausible."""
        rows = some(len(batch.coms))
        self._plausible.add(self._scorer.stand(batch.contacts, len(batch.coms), rows), batch.coms[rows])
        if self._strict and self._plausible.notes():
            raise InputError(f"--strict: {'; '.join(self._plausible.notes())}")

    def _scored(self, batch: StateBatch) -> tuple[Capturability | Baselines, ...]:
        scores, beside, unusable, spent = self._answer(batch)
        self.seconds += spent
        self._states.add(batch.bad, self.summary.states)
        self._contacts.add(unusable, self.summary.states)
        self.summary.add(scores)
        return scores, *beside

    def notes(self) -> tuple[str, ...]:
        """Lines for stderr and the output's metadata. Perhaps none."""
        empty = "" if self.summary.states else "no rows: there is nothing to score"
        found = (empty, self._states.note(), self._contacts.note(), *self._plausible.notes())
        return tuple(filter(None, found))
