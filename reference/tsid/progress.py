"""What is known of a campaign's rows: from its file, and from the journals of all who work on it.

OUT.parquet               samples 0 to N - 1, when all are there
OUT.parquet.journal       of a run of the whole
OUT.parquet.journal-1-of-3   of shard 1/3, a run of its own
"""

from __future__ import annotations

import glob
import json
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, NamedTuple

from jaxcap.engine import Shard
from reference.tsid.journal import Busy, Journal, records_of
from reference.tsid.labels import Row, Settings
from reference.tsid.table import read


class Refused(Exception):
    """The campaign cannot run as asked; nothing was touched."""


class Progress(NamedTuple):
    """What is known of a campaign's rows."""

    rows: dict[int, Row]
    """By index, from file and journals."""
    written: int
    """How many of them the file holds: 0 to written - 1."""
    versions: list[dict[str, str]]
    """Of the libraries that made the rows; more than one entry if they changed in between."""


class Journals:
    """The journals of a campaign, to be used in a `with` block.

    A run of the whole holds all that there are. A shard holds its own, and reads the others'.
    """

    def __init__(self, output: Path, shard: Shard):
        """Raises Busy naming a journal that somebody else writes: a run of the same part, or of the whole."""
        self._output = output
        self._whole = output.with_name(f"{output.name}.journal")
        with ExitStack() as held:
            if shard.of == 1:
                self.own = held.enter_context(Journal(self._whole))
                self._others = [held.enter_context(Journal(path)) for path in self._paths() if path != self._whole]
            else:
                if self._whole.exists():
                    Journal(self._whole).close()  # nobody writes it
                self.own = held.enter_context(Journal(output.with_name(f"{self._whole.name}-{shard.number}-of-{shard.of}")))
                self._others = []
            self._held = held.pop_all()

    def __enter__(self) -> Journals:
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    def _paths(self) -> list[Path]:
        return sorted(self._output.parent.glob(f"{glob.escape(self._whole.name)}*"))

    def records(self) -> Iterator[tuple[Path, Any]]:
        """All records of all journals, as they are now."""
        for path in self._paths():
            for record in records_of(path):
                yield path, record

    def remove(self) -> None:
        """Deletes all but those that others hold: they do it when they end."""
        self.own.remove()
        for journal in self._others:
            journal.remove()
        for path in self._paths():
            with suppress(Busy):
                Journal(path).remove()

    def leave(self) -> None:
        """Deletes the own one if nothing is in it."""
        if not records_of(self.own.path):
            self.own.remove()


def known(output: Path, journals: Journals, settings: Settings) -> Progress:
    """Rows from earlier runs, and from others that run. Raises Refused naming what differs if these had other settings."""
    rows: dict[int, Row] = {}
    versions: list[dict[str, str]] = []
    written = 0
    if output.exists():
        found, versions, old = read(output)
        _compare(output, found, settings)
        rows, written = {row["index"]: row for row in old}, len(old)
    for path, record in journals.records():
        if "settings" in record:
            _compare(path, record["settings"], settings)
            versions += [record["versions"]] if record["versions"] not in versions else []
        else:
            rows[record["index"]] = record
    return Progress(rows, written, versions)


def _compare(path: Path, found: dict[str, Any], settings: Settings) -> None:
    there, here = _flat(found), _flat(json.loads(json.dumps(settings._asdict())))
    keys = [key for key in {**here, **there} if there.get(key) != here.get(key)]
    if keys:
        differences = "; ".join(f"{key} is {there.get(key)!r} there and {here.get(key)!r} now" for key in keys)
        raise Refused(f"{path} was made with other settings: {differences}. Name another output, or move it away")


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    """Every value by its path."""
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        flat |= {f"{key}.{name}": inner for name, inner in value.items()} if isinstance(value, dict) else {key: value}
    return flat
