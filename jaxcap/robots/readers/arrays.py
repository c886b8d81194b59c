"""NPZ and JSON."""

import json
import tempfile
import zipfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from jaxcap.errors import InputError

PIECE = 1 << 24
"""Bytes that are copied at a time."""


def npz(path: Path, stack: ExitStack) -> dict[str, Any]:
    """The arrays of an NPZ file, each mapped from an unnamed copy. Objects are never unpickled."""
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    found: dict[str, Any] = {}
    with zipfile.ZipFile(path) as archive:
        for number, member in enumerate(name for name in archive.namelist() if name.endswith(".npy")):
            copy = folder / f"{number}.npy"
            with archive.open(member) as source, open(copy, "wb") as target:
                while piece := source.read(PIECE):
                    target.write(piece)
            try:
                array = np.load(copy, mmap_mode="r", allow_pickle=False)
            except ValueError as error:
                if "allow_pickle" not in str(error) and "Python objects" not in str(error):
                    raise
                raise InputError(f"{path}: {member[:-4]!r} holds pickled objects, which are never unpickled") from error
            found[member[:-4]] = plain(array)
    return found


def from_json(path: Path) -> dict[str, Any]:
    """The fields of a JSON file: lists of numbers are arrays."""
    with open(path, encoding="utf-8") as file:
        said = json.load(file)
    if not isinstance(said, dict):
        raise InputError(f"{path}: holds a {type(said).__name__} (expected fields by name)")
    return flat(said)


def flat(fields: dict[Any, Any], before: str = "") -> dict[str, Any]:
    """Fields of nested dictionaries by their joined names."""
    found: dict[str, Any] = {}
    for name, value in fields.items():
        if isinstance(value, dict):
            found |= flat(value, f"{before}{name}/")
        else:
            found[f"{before}{name}"] = plain(value)
    return found


def plain(value: Any) -> Any:
    """An array, a number, a text or a tuple of texts."""
    if isinstance(value, list | tuple):
        if value and all(isinstance(text, str) for text in value):
            return tuple(value)
        try:
            value = np.array(value, dtype=float)
        except (TypeError, ValueError):
            return None  # ragged, or objects: no field of a motion
    if isinstance(value, np.ndarray | np.generic):
        if value.dtype.kind in "US":
            return str(value) if value.ndim == 0 else tuple(map(str, value.astype(str).ravel()))
        return value.item() if value.ndim == 0 else value
    return value
