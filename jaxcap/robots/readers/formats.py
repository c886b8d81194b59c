"""Which reader reads a log."""

import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from jaxcap.errors import InputError, needs_extra

EXTENSIONS = {
    ".npz": "npz",
    ".csv": "csv",
    ".parquet": "parquet",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".json": "json",
    ".txt": "json",
    ".pkl": "pickle",
    ".pickle": "pickle",
    ".mcap": "mcap",
}
"""Formats by the extensions of files."""

Fields = dict[str, Any]


def format_of(path: Path) -> str:
    """The format of a log. Raises InputError for a file that is not there, or of no known kind."""
    if path.is_dir() and (path / "meta" / "info.json").is_file():
        return "lerobot"
    if path.is_dir():
        bags = sorted(path.glob("*.mcap"))
        if not bags:
            raise InputError(f"{path}: a folder without meta/info.json (LeRobot) or .mcap files (ROS 2)")
        return "mcap"
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if path.suffix.lower() not in EXTENSIONS:
        raise InputError(f"{path}: unknown extension {path.suffix!r} (expected {', '.join(EXTENSIONS)}, or a folder)")
    return EXTENSIONS[path.suffix.lower()]


def read(path: Path, kind: str, header: bool = True) -> Iterator[tuple[Path, Fields | InputError]]:
    """The fields of every file of a log, one file open at a time.

    Args:
        path: File or folder.
        kind: What `format_of` says.
        header: Whether a CSV file begins with names.

    Returns:
        Name and fields of each file; for one that cannot be read (damaged, cut off, of another kind) the error in their
        place.

    Raises:
        InputError: For a folder that is no dataset.
        MissingExtra: Where the package is missing that reads it.
    """
    files, more = _lerobot(path) if kind == "lerobot" else (_bags(path), {})
    for file in files:
        with ExitStack() as stack:
            try:
                found: Fields | InputError = _one(file, "parquet" if kind == "lerobot" else kind, header, stack) | more
            except InputError as error:
                found = error
            yield file, found


def _bags(path: Path) -> list[Path]:
    """The files of a bag that is a folder; or the one file."""
    return sorted(path.glob("*.mcap")) if path.is_dir() else [path]


def _one(path: Path, kind: str, header: bool, stack: ExitStack) -> Fields:
    """The fields of one file."""
    try:
        return _reader(path, kind, header, stack)
    except (InputError, MemoryError, ImportError):
        raise
    except Exception as error:  # whatever the parsers make of damaged bytes
        reason = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise InputError(f"{path}: cannot be read as {kind}: {reason}") from error


def _reader(path: Path, kind: str, header: bool, stack: ExitStack) -> Fields:
    if kind == "npz":
        from jaxcap.robots.readers.arrays import npz

        return npz(path, stack)
    if kind == "json":
        from jaxcap.robots.readers.arrays import from_json

        return from_json(path)
    if kind == "pickle":
        from jaxcap.robots.readers.pickles import from_pickle

        return from_pickle(path)
    if kind == "hdf5":
        with needs_extra("logs", "reading HDF5"):
            from jaxcap.robots.readers.hdf5 import hdf5
        return hdf5(path, stack)
    if kind == "mcap":
        with needs_extra("logs", "reading MCAP"):
            from jaxcap.robots.readers.bags import bag
        return bag(path, stack)
    with needs_extra("logs", "reading tables"):
        from jaxcap.robots.readers import tables
    return tables.csv_table(path, header, stack) if kind == "csv" else tables.parquet(path, stack)


def _lerobot(folder: Path) -> tuple[list[Path], Fields]:
    """The files of a LeRobot dataset, v2.1 (a file an episode) or v3 (many), and what meta/info.json says of all of them."""
    about = folder / "meta" / "info.json"
    try:
        said = json.loads(about.read_text(encoding="utf-8"))
        features = {str(name): feature for name, feature in said["features"].items() if isinstance(feature, dict)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{about}: cannot be read as LeRobot's info.json: {error!r}") from error
    names = {f"{name} names": _names(feature.get("names")) for name, feature in features.items()}
    files = sorted((folder / "data").glob("chunk-*/*.parquet"))
    if not files:
        raise InputError(f"{folder}: no data/chunk-*/*.parquet")
    return files, {"fps": said.get("fps")} | {name: listed for name, listed in names.items() if listed}


def _names(said: Any) -> tuple[str, ...]:
    """Names of a feature's columns: a list, a list in a list, or a list under a key such as `motors`."""
    if isinstance(said, dict):
        said = next(iter(said.values()), [])
    while isinstance(said, list) and len(said) == 1 and isinstance(said[0], list):
        said = said[0]
    return tuple(map(str, said)) if isinstance(said, list) and all(isinstance(name, str) for name in said) else ()
