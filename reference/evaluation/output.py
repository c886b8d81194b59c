"""Files of the evaluation's folder: written whole, and never over what is not its own."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

LIST = "made.json"
"""In the folder: hashes of the files that were written there, by name; of each its own and the one before it."""


class Foreign(Exception):
    """A file with a name that is to be written is not the one that was written before."""


def write(path: Path, content: bytes) -> None:
    """Write a file whole, in place of an earlier version of it. Raises Foreign if what is there is anything else."""
    made = path.parent / LIST
    path.parent.mkdir(parents=True, exist_ok=True)
    hashes = json.loads(made.read_text(encoding="utf-8")) if made.exists() else {}
    there = {_hash(path.read_bytes())} if path.exists() else set()
    if not there <= set(hashes.get(path.name, [])):
        raise Foreign(f"{path}: was not written by this command, or changed since (expected none; move it away)")
    hashes[path.name] = sorted(there | {_hash(content)})  # both: if we are killed on the way, the earlier file is there
    _replace(made, json.dumps(hashes, indent=1, sort_keys=True).encode())
    _replace(path, content)


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _replace(path: Path, content: bytes) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(content)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
