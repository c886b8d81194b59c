"""What of a folder is done: the settings that it belongs to, and a record beside each output.

    OUT/_jaxcap/settings.json      what all outputs depend on
    OUT/_jaxcap/done/NAME.json     a record, written when OUT/NAME is there
    OUT/_SUMMARY.json              when all are

Readers of datasets leave out names with an underscore. Any number of processes may write at a time: nothing is appended to.
"""

import hashlib
import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from jaxcap.errors import InputError
from jaxcap.files.settings import differences
from jaxcap.files.whole_file import whole_file, whole_folder, write_errors_of

OURS, SETTINGS, DONE, SUMMARY = "_jaxcap", "settings.json", "done", "_SUMMARY.json"


class Ledger(NamedTuple):
    """The records of a folder. It can be sent to workers."""

    folder: Path

    def done(self, name: str) -> dict[str, Any] | None:
        """The record of an output; None unless both are there."""
        if not (self.folder / name).is_file():
            return None
        try:
            return json.loads(self._path(name).read_text())
        except (OSError, ValueError):
            return None

    def write(self, name: str, record: Mapping[str, Any]) -> None:
        """Writes the record of an output, which is there."""
        path = self._path(name)
        with write_errors_of(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path, force=True, lasting=False) as handle:  # one that is lost costs doing its output again
            handle.write(json.dumps(record).encode())

    def summarise(self, summary: Mapping[str, Any]) -> None:
        """All is done: writes the summary, and removes what processes that were killed have left."""
        for stray in self.folder.rglob(".jaxcap-*.tmp"):
            with suppress(OSError):
                stray.unlink()
        with whole_file(self.folder / SUMMARY, force=True) as handle:
            handle.write(json.dumps(summary, indent=1).encode())

    def _path(self, name: str) -> Path:
        return self.folder / OURS / DONE / f"{name}.json"


def open_ledger(folder: Path, settings: Mapping[str, Any], *, force: bool) -> Ledger:
    """The records of a folder, which is made if need be.

    Args:
        folder: Of outputs.
        settings: All that they depend on besides their inputs, for JSON.
        force: Do everything again, whatever the settings were. Outputs stay until they are replaced.

    Raises:
        InputError: For outputs of other settings, for a folder with something else in it, and if it cannot be written.
    """
    settings, ours = json.loads(json.dumps(settings)), folder / OURS
    with write_errors_of(folder):
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder}: exists and is not a folder")
        if not ours.exists() and folder.exists() and any(map(_is_foreign, folder.iterdir())):
            raise InputError(f"{folder}: is not empty, and no earlier run of this command (expected a new or empty folder)")
        folder.mkdir(parents=True, exist_ok=True)
        if force and ours.exists():
            (folder / SUMMARY).unlink(missing_ok=True)
            shutil.rmtree(ours)
        if not ours.exists():
            _begin(ours, settings)
    _check(ours / SETTINGS, settings)
    return Ledger(folder)


def _is_foreign(path: Path) -> bool:
    return not path.name.startswith(".jaxcap-")  # another shard is just beginning


def hash_of(settings: Mapping[str, Any]) -> str:
    """SHA-256 of settings."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def _begin(ours: Path, settings: Mapping[str, Any]) -> None:
    """The settings appear together with their folder; where two processes begin at a time, one does."""
    with whole_folder(ours) as folder:
        (folder / SETTINGS).write_text(json.dumps(settings, indent=1))


def _check(path: Path, settings: Mapping[str, Any]) -> None:
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        raise InputError(f"{path}: cannot be read (expected the settings of an earlier run)") from None
    if other := differences(settings, found):
        shown = ", ".join(
            f"{name} {_short(found.get(name))} there and {_short(settings.get(name))} now" for name in other[:3]
        )
        raise InputError(f"{path}: made with other settings: {shown} (name another folder, or --force does all again)")


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
