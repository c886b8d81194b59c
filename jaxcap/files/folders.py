"""Datasets of many Parquet files: which there are, and whether they are alike; and one large file, cut into parts."""

import glob
import hashlib
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxcap.errors import InputError, needs_extra
from jaxcap.files.records import read_states
from jaxcap.files.state_file import StateFile

MAGIC = re.compile(r"[*?\[]")
SUFFIX = ".parquet"
TOLD = 10
"""Files that a message lists at most."""
CUT_ROWS = 1 << 19
"""Rows of a part of one file at most, unless a row group alone has more."""
FOOTER_END = 8
"""Bytes after a Parquet file's footer: its length, and four letters."""


class Part(NamedTuple):
    """One file of a dataset, or row groups of a large one that follow each other."""

    name: str
    """Below the dataset's folder, of what is made of it; with slashes."""
    file: str
    """Which file below the dataset's folder."""
    rows: int
    bytes: int
    """Of the whole file."""
    footer: str
    """SHA-256 of the file's footer, where Parquet keeps sizes and bounds of every column: another file has another."""
    first_group: int = 0
    groups: int | None = None
    """How many row groups; None: all."""

    @property
    def row_groups(self) -> range | None:
        """Which row groups; None: all."""
        return None if self.groups is None else range(self.first_group, self.first_group + self.groups)


class Dataset(NamedTuple):
    """Files of states with the same columns, or parts of one."""

    folder: Path
    parts: tuple[Part, ...]
    """By name."""


def is_glob(path: Path) -> bool:
    """Whether it is a pattern: no file has that name."""
    return bool(MAGIC.search(str(path))) and not path.exists()


def dataset(path: Path, mass: float | None) -> Dataset:
    """The files of a folder, however deep, or of a glob (in which ** stands for any folders).

    Names that begin with a dot or an underscore are left out, as all readers of datasets do.

    Args:
        path: Folder or glob.
        mass: As for `read_states`.

    Raises:
        InputError: If there is none, and for files that are not Parquet, no states, or have other columns than the first:
            they are listed.
    """
    folder, files = _found(path)
    if not files:
        raise InputError(f"{path}: no Parquet files")
    strange = [f"{file.relative_to(folder)}: not {SUFFIX}" for file in files if file.suffix.lower() != SUFFIX]
    parts: list[Part] = []
    first: StateFile | None = None
    for file in files if not strange else ():
        name = file.relative_to(folder).as_posix()
        try:
            with read_states(file, 1, np.float64, mass) as source:
                first = first or source
                if other := _difference(first, source):
                    raise InputError(f"{file}: {other} (expected as in {first.path})")
                parts.append(Part(name, name, source.rows, file.stat().st_size, _footer(file)))
        except InputError as error:
            strange.append(str(error).removeprefix(f"{folder}/"))
    if strange:
        more = f"; and {len(strange) - TOLD} more" if len(strange) > TOLD else ""
        raise InputError(
            f"{path}: {len(strange)} of {len(files)} files cannot be used (a glob leaves files out): "
            f"{'; '.join(strange[:TOLD])}{more}"
        )
    return Dataset(folder, tuple(parts))


def cut(path: Path, mass: float | None) -> Dataset:
    """A Parquet file in parts of whole row groups, several small ones together: what is read by one at a time.

    Args:
        path: The file.
        mass: As for `read_states`.

    Raises:
        InputError: As `read_states`.
    """
    with read_states(path, 1, np.float64, mass) as source, needs_extra("data", "reading Parquet"):
        import pyarrow.parquet as pq

        metadata = pq.read_metadata(path)
        rows = [metadata.row_group(number).num_rows for number in range(metadata.num_row_groups)]
    ends = [0]  # where a part begins
    for number in range(1, len(rows)):
        if sum(rows[ends[-1] : number + 1]) > CUT_ROWS:
            ends.append(number)
    width, about = max(5, len(str(len(ends)))), (path.stat().st_size, _footer(path))
    spans = enumerate(pairwise([*ends, len(rows)]))
    parts = [
        Part(f"part-{i:0{width}}{SUFFIX}", path.name, sum(rows[first:end]), *about, first, end - first)
        for i, (first, end) in spans
    ]
    return Dataset(source.path.parent, tuple(parts))


def _found(path: Path) -> tuple[Path, list[Path]]:
    """The folder of a dataset, and its files by name."""
    if not is_glob(path):
        return path, sorted(_visible(path, path.rglob("*")))
    steps = path.parts
    first = next(i for i, step in enumerate(steps) if MAGIC.search(step))
    folder = Path(*steps[:first])
    return folder, sorted(_visible(folder, map(Path, glob.iglob(str(path), recursive=True))))


def _visible(folder: Path, paths: Iterator[Path]) -> Iterator[Path]:
    for path in paths:
        if not any(step.startswith((".", "_")) for step in path.relative_to(folder).parts) and path.is_file():
            yield path


def _difference(first: StateFile, other: StateFile) -> str:
    """The first column in which two files differ; nothing if none."""
    if list(first.types) != list(other.types):
        extra = [name for name in other.types if name not in first.types]
        missing = [name for name in first.types if name not in other.types]
        return f"column {extra[0]!r} more" if extra else f"no column {missing[0]!r}" if missing else "columns in other order"
    for name, field in first.types.items():
        if field.type != other.types[name].type:
            return f"column {name!r} has type {other.types[name].type}, not {field.type}"
    return ""


def _footer(file: Path) -> str:
    with open(file, "rb") as handle:
        handle.seek(-FOOTER_END, 2)
        length = int.from_bytes(handle.read(4), "little")
        handle.seek(-FOOTER_END - length, 2)
        return hashlib.sha256(handle.read(length)).hexdigest()
