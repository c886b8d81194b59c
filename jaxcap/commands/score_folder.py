"""`jaxcap score` of a dataset: many files in, as many out, each a unit of the engine. Needs tqdm (extra `cli`)."""

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
from tqdm import tqdm

from jaxcap.commands.robot_limits import Counted
from jaxcap.commands.score_file import Settings, score_file
from jaxcap.commands.summary import Counts, Quantiles, together
from jaxcap.commands.where import Where, place_of
from jaxcap.engine import Ledger, Place, Unit, open_ledger, over_units, shard_of
from jaxcap.engine.ledger import hash_of
from jaxcap.errors import InputError
from jaxcap.files.columns import described_contacts
from jaxcap.files.folders import SUFFIX, Dataset, Part, cut, dataset, is_glob
from jaxcap.version import __version__

MARGIN_BITS = 7
"""Of the margins in a record: 64 values for each power of two, a few kilobytes a file."""
NOTED = 20
"""Lines of notes, and of errors, that are printed at most."""


def is_many(states: Path, output: Path) -> bool:
    """Whether states are a folder or a glob, or one Parquet file that is scored into a folder.

    A folder may be named like a Parquet file, as some writers do.
    """
    if states.is_dir():
        return states.suffix.lower() not in (".npz", ".csv")
    return is_glob(states) or (states.suffix.lower() == SUFFIX and (output.is_dir() or not output.suffix))


@dataclass(frozen=True)
class Scoring:
    """The work on a file of a dataset. It can be sent to workers."""

    folder: Path
    """Of inputs."""
    ledger: Ledger
    how: Settings
    known: Counted

    def __call__(self, part: Part) -> dict[str, Any]:
        """Scores the file, or row groups of it, and returns the record of it."""
        target, said = self.ledger.folder / part.name, list[str]()
        target.parent.mkdir(parents=True, exist_ok=True)
        with jax.enable_x64(self.how.dtype == "float64"):
            options: dict[str, Any] = {"force": True, "alone": False, "say": said.append, "row_groups": part.row_groups}
            run = score_file(self.folder / part.file, target, self.how, self.known, **options)
        counts, margin = run.summary.counts._asdict(), run.summary.margin.histogram(MARGIN_BITS)
        record = {"input": part._asdict(), "counts": counts, "margin": margin, "notes": [*said, *run.notes()]}
        self.ledger.write(part.name, record)
        return record


def score_folder(states: Path, output: Path, how: Settings, known: Counted, where: Where, *, force: bool) -> None:
    """Scores a dataset, and prints a summary.

    Args:
        states: Folder or glob of Parquet files, or one, which is read by row groups.
        output: Folder for as many.
        how: The settings.
        known: What of the robot counts.
        where: Where, and which part of them.
        force: Do again what is done.

    Raises:
        InputError: Before anything is computed, for files, options or an output that cannot be used; after all else is done,
            for files that failed.
    """
    shard = shard_of(where.shard)
    if force and shard.of > 1:
        raise InputError(f"--shard {shard} (expected without --force: one part would undo what the others have done)")
    files = cut(states, known.mass) if states.is_file() else dataset(states, known.mass)
    if not states.is_file() and output.resolve().is_relative_to(files.folder.resolve()):
        raise InputError(f"{output}: lies in {files.folder}, which is read (expected another folder)")
    with place_of(where) as place:
        settings = _settings(how, known, place)
        ledger = open_ledger(output, settings, force=force)
        records = _known(ledger, files)
        units = shard.part([Unit(number, part) for number, part in enumerate(files.parts)])
        todo = [unit for unit in units if unit.what.name not in records]
        before, start = len(records), time.perf_counter()
        work = Scoring(files.folder.absolute(), ledger._replace(folder=output.absolute()), _portable(how), known)
        failed = _scored(place, work, todo, sum(unit.what.rows for unit in units), records)
        seconds = time.perf_counter() - start
        where_it_ran = f"{place.words}; {how.dtype}, {place.about['backend']}"
    _tell(files, records, settings, ledger, f"shard {shard}" if shard.of > 1 else "")
    scored = sum(unit.what.rows for unit in todo) - sum(unit.what.rows for unit in failed)
    there = f"; {before} files were there" if before else ""
    print(f"\n{scored / seconds:.3g} states/s ({seconds:.2f} s with compiling; {where_it_ran}){there}")
    if failed:
        raise InputError(f"{states}: {len(failed)} of {len(files.parts)} files failed, the others are scored (see above)")


def _settings(how: Settings, known: Counted, place: Place) -> dict[str, Any]:
    """All that answers depend on besides the states."""
    contacts = None if how.sets is None else described_contacts(how.sets)
    left_out = ("sets", "contacts", "cache", "no_cache", *(() if how.momentum_box else ("momentum_box",)))
    rest = {name: value for name, value in how._asdict().items() if name not in left_out}
    return {"contacts": contacts, **rest, "mass": known.mass, **place.about}


def _portable(how: Settings) -> Settings:
    """Paths that hold from any working directory."""
    return how._replace(cache=None if how.cache is None else how.cache.absolute())


def _known(ledger: Ledger, files: Dataset) -> dict[str, dict[str, Any]]:
    """Records of what is done. Raises InputError for outputs of other inputs."""
    records = {part.name: record for part in files.parts if (record := ledger.done(part.name)) is not None}
    changed = [part.name for part in files.parts if part.name in records and records[part.name]["input"] != part._asdict()]
    if changed:
        raise InputError(
            f"{ledger.folder}: {len(changed)} files were made from other states, {changed[0]} for one "
            "(remove them, or --force does all again)"
        )
    return records


def _scored(place: Place, work: Scoring, todo: list[Unit], rows: int, records: dict[str, dict[str, Any]]) -> list[Unit]:
    """Fills `records`; returns the units that failed, of which it tells."""
    failed = []
    done = rows - sum(unit.what.rows for unit in todo)
    with tqdm(total=rows, initial=done, unit=" states", unit_scale=True, disable=None) as bar:
        for unit, record, error, _ in over_units(place, work, todo):
            bar.update(unit.what.rows)
            if error:
                failed.append(unit)
                if len(failed) <= NOTED:
                    bar.write(f"failed: number {unit.number}, {unit.what.name}: {error}", file=sys.stderr)
            else:
                records[unit.what.name] = record
    return failed


def _tell(
    files: Dataset, records: Mapping[str, Mapping[str, Any]], settings: Mapping[str, Any], ledger: Ledger, shard: str
) -> None:
    """Notes and counts; in a file too, when all is done."""
    names = [part.name for part in files.parts if part.name in records]
    notes = [f"{name}: {note}" for name in names for note in records[name]["notes"]]
    for note in notes[:NOTED]:
        print(f"note: {note}", file=sys.stderr)
    if len(notes) > NOTED:
        print(f"note: {len(notes) - NOTED} notes more, in the files' metadata", file=sys.stderr)
    counts = together(Counts(**records[name]["counts"]) for name in names)
    margin = Quantiles.of((records[name]["margin"] for name in names), MARGIN_BITS)
    print(f"{counts.table()}\n\n{margin.table(' (to within 0.8 %)')}")
    missing = len(files.parts) - len(names)
    rest = f", {missing} to come" if missing else ""
    print(f"\n{ledger.folder}: {len(names)} of {len(files.parts)} files{rest}{f' ({shard})' if shard else ''}")
    if not missing:
        summary = {"written_by": f"jaxcap {__version__}", "settings_sha256": hash_of(settings), "settings": settings}
        found = {"files": len(names), **counts._asdict(), "margin_quantiles": margin.named(), "notes": len(notes)}
        ledger.summarise({**summary, **found})
