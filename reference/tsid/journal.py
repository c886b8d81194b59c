"""A journal: results appended as they come, kept through a SIGKILL, held by one process at a time.

Format: records of a little-endian header (length of the payload, its CRC-32) and a payload, UTF-8 JSON. A record torn by a
kill fails its CRC and is dropped, with what follows it, when the journal is opened again. Every record is handed to the
operating system at once, so a killed process loses nothing; a power cut may lose the last seconds.
"""

from __future__ import annotations

import fcntl
import json
import os
import struct
import zlib
from pathlib import Path
from typing import Any

HEADER = struct.Struct("<II")


class Busy(Exception):
    """Another process holds the journal."""


def records_of(path: Path) -> list[Any]:
    """What a journal holds now, whoever writes it; nothing if there is none."""
    try:
        return _records(path.read_bytes())[0]
    except FileNotFoundError:
        return []


class Journal:
    """An open journal, to be used in a `with` block; `records` holds what was in it when it was opened."""

    def __init__(self, path: Path):
        """Opens or creates the file. Raises `Busy` naming it if another process has it open."""
        self.path = path
        self._file = _locked(path)
        content = self._file.read()
        self.records, good = _records(content)
        self._file.seek(good)
        self._file.truncate(good)

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def append(self, record: Any) -> None:
        """Appends one record, anything that JSON can hold."""
        payload = json.dumps(record, separators=(",", ":")).encode()
        self._file.write(HEADER.pack(len(payload), zlib.crc32(payload)) + payload)
        self._file.flush()

    def sync(self) -> None:
        """Everybody sees what was appended, also from another machine."""
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Leaves the file for a later run."""
        if not self._file.closed:
            self.sync()
            self._file.close()

    def remove(self) -> None:
        """Deletes the file: what it held is safe elsewhere."""
        self.path.unlink()
        self._file.close()


def _locked(path: Path):
    """The file, open for reading and writing at its start, locked; the lock goes with the process, however that ends."""
    while True:
        file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o644), "r+b")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise Busy(f"{path}: another campaign is writing it") from None
        try:  # between opening and locking, its owner may have finished and deleted it
            if os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                return file
        except FileNotFoundError:
            pass
        file.close()


def _records(content: bytes) -> tuple[list[Any], int]:
    """The records up to the first that is torn, and the number of bytes they take."""
    records, start = [], 0
    while start + HEADER.size <= len(content):
        length, crc = HEADER.unpack_from(content, start)
        payload = content[start + HEADER.size : start + HEADER.size + length]
        if len(payload) < length or zlib.crc32(payload) != crc:
            break
        records.append(json.loads(payload))
        start += HEADER.size + length
    return records, start
