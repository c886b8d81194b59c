"""One file of states, scored into another: the work behind `jaxcap score`, of one file or of many."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from jaxcap.commands.compile_cache import compilation_cache
from jaxcap.commands.options import without_mass
from jaxcap.commands.robot_limits import Counted, TorqueLimits
from jaxcap.commands.scorers import Scorer, scorer_of
from jaxcap.commands.states import said_of_log
from jaxcap.commands.summary import Summary
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY
from jaxcap.errors import InputError
from jaxcap.files.bad_rows import BadRows
from jaxcap.files.columns import StateBatch, describe, refuse_clashes
from jaxcap.files.contact_columns import CHOICE, POINTS, RowContacts
from jaxcap.files.contact_files import ContactSets
from jaxcap.files.fields import BASELINES, FIELDS
from jaxcap.files.plausibility import Plausibility, some
from jaxcap.files.records import ScoreWriter, read_states, write_scores
from jaxcap.files.state_file import StateFile
from jaxcap.one_state.result import Capturability
from jaxcap.regions.capture_point import Baselines

ABOVE_CONTACTS = "of the CoM above the mean of the contact points"
"""What the metadata say about the default height."""


class Settings(NamedTuple):
    """How states are scored; the arguments of `jaxcap score` say what they mean."""

    contacts: Path | None
    sets: ContactSets | None
    """What that file holds."""
    dtype: str
    sides: int
    batch_size: int
    neighbours: bool
    baselines: bool
    height: float | None
    mass: float | None
    momentum_box: float
    """[m^2/s^2]"""
    strict: bool
    cache: Path | None
    no_cache: bool


def score_file(
    states: Path,
    output: Path,
    how: Settings,
    known: Counted,
    *,
    named: Path | None = None,
    row_groups: range | None = None,
    force: bool,
    alone: bool = True,
    say: Callable[[str], None],
) -> "Run":
    """Scores a file, writes the answers and returns what there is to say. JAX's x64 switch has to be as `how.dtype` needs.

    Args:
        states: File of states.
        output: File to write.
        how: The settings.
        known: What of the robot counts.
        named: What the user calls the file of states, if it is another.
        row_groups: Those of a Parquet file that are scored; None: all.
        force: Replace `output` if it is there.
        alone: Not one of many files: shows a bar, if stderr is a terminal, and tells compiling from scoring.
        say: Takes what there is to say before anything is computed.

    Raises:
        InputError: For a file or column that cannot be used. Then `output` is left as it was.
    """
    named = named or states
    with (
        read_states(states, rows := known.rows(how.batch_size), np.float64, known.mass, row_groups) as source,
        compilation_cache(how.cache, how.no_cache),
    ):
        if known.words:
            say(known.words)
        for name in source.skipped:
            say(f"{name!r} is not carried through: not one value for each state")
        if not known.words and (words := without_mass(source)):
            say(words)
        described = contacts_of(named, source.contacts, how.contacts, how.sets)
        fields = dict(FIELDS)
        more: dict[str, Any] = {} if known.mass is None else {"mass": known.mass}
        more |= {"counted": known.words} if known.words else {}
        more |= {"momentum_box": how.momentum_box} if how.momentum_box else {}
        if how.baselines:
            refuse_clashes(named, source.types, BASELINES)
            fields = FIELDS | BASELINES
            more["capture_point_height"] = ABOVE_CONTACTS if how.height is None else how.height
        scorer_with = partial(scorer_of, described, how.contacts, min(rows, source.rows), how.sides, how.neighbours)
        scorer = scorer_with(how.momentum_box)
        # The baselines know nothing of a box.
        plain = (scorer_with() if how.momentum_box else scorer) if how.baselines else None
        answer = partial(_answered, scorer, plain, limits=known.limits, height=how.height)
        metadata = describe(described, GRAVITY, how.sides, np.dtype(how.dtype), fields, source.momentum, **more)
        metadata["units"] |= {"momentum_box": "m^2/s^2"} if how.momentum_box else {}
        run = Run(answer, scorer, how.strict, alone)
        options: dict[str, Any] = {"fields": fields, "about": source.about, "force": force}
        with write_scores(output, source.types, metadata | said_of_log(source.about), how.dtype, **options) as sink:
            run.all(source, sink)
    return run


def contacts_of(
    states: Path, columns: tuple[str, ...], path: Path | None, sets: ContactSets | None
) -> ContactSet | ContactSets | tuple[str, ...]:
    """What the contacts are: one set for all states, sets that CHOICE chooses from, or columns. Raises InputError.

    Args:
        states: The file, for messages.
        columns: Those of its columns that say of contacts.
        path: File of contacts.
        sets: What it holds.
    """
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
    scorer: Scorer, plain: Scorer | None, batch: StateBatch, limits: TorqueLimits | None, height: float | None
) -> _Answered:
    """Scores a batch. plain: what computes its baselines, if they are asked for."""
    start = time.perf_counter()
    rows = batch.contacts, batch.coms, batch.com_velocities
    actuation = None if limits is None else limits.of(batch)
    scores, bad = scorer.score(*rows, batch.specific_angular_momenta, actuation)
    beside = () if plain is None else (plain.baselines(*rows, height),)
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


class Run:
    """Scores and writes every batch, and keeps what there is to say at the end."""

    def __init__(self, answer: Callable[[StateBatch], _Answered], scorer: Scorer, strict: bool, alone: bool):
        self._answer, self._scorer, self._strict, self._alone = answer, scorer, strict, alone
        self.summary = Summary()
        self.seconds, self.compiled = 0.0, 0.0
        """Time spent scoring, and compiling [s]; of one of many files both are in the first."""
        self._states, self._contacts = _Unusable("the states"), _Unusable("the contacts")
        self._plausible = Plausibility()

    def all(self, source: StateFile, sink: ScoreWriter) -> None:
        """Scores a file. Raises InputError for what is hardly plausible, if that is asked for."""
        widest, hidden = -1, None if self._alone else True  # None: where stderr is no terminal
        with tqdm(total=source.rows, unit=" states", unit_scale=True, disable=hidden) as bar:
            for batch in source:
                width = batch.contacts.mask.shape[1] if isinstance(batch.contacts, RowContacts) else 0
                if self._alone and width > widest:  # compiles, by scoring states that are soon done with
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
