"""Dataset files in and out: states read in batches, scores written beside them, whole or not at all."""

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import reduce
from operator import or_
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import DTypeLike

from jaxcap.errors import InputError, needs_extra
from jaxcap.files.fields import FIELDS, output_columns, output_types
from jaxcap.files.npz import NpzStates, NpzWriter
from jaxcap.files.state_file import StateFile
from jaxcap.files.whole_file import extension_of, whole_file
from jaxcap.one_state.result import Capturability
from jaxcap.regions.capture_point import Baselines

if TYPE_CHECKING:
    from jaxcap.files.parquet import ParquetWriter

READABLE = (".parquet", ".npz", ".csv")
"""Extensions of files of states."""


def read_states(
    path: str | Path,
    batch_size: int,
    dtype: DTypeLike = np.float32,
    mass: float | None = None,
    row_groups: range | None = None,
) -> StateFile:
    """Opens a file of states, and checks what can be checked without reading its rows.

    The file has the columns `com` [m] and `com_velocity` [m/s]: three floats or integers a row (Parquet: lists; NPZ: arrays
    (n, 3)), or com_x, com_y, com_z and com_velocity_x, ... (CSV: always). Nulls, and lists of another length, are read as
    NaN, and `StateBatch.bad` names these rows. NPZ files are never unpickled.

    A column specific_angular_momentum [m^2/s], spelt as these, is read too; or, where the robot's mass is given, a column
    angular_momentum [kg m^2/s].

    The file may also say what the contacts of each row are: columns contact_points (k x 3) [m], contact_frames (k x 3 x 3),
    contact_friction (k, or one number) and perhaps contact_mask (k booleans), as lists that may differ in length from row
    to row, nested or flat, or as arrays (n, k, ...); or a column contact_set of integers or names. See `contact_columns`.

    Args:
        path: Parquet (.parquet), NPZ (.npz) or CSV (.csv).
        batch_size: Rows at a time, > 0.
        dtype: float32 or float64, of the vectors and contacts.
        mass: Of the robot, > 0 [kg].
        row_groups: Those of a Parquet file that are read, from 0; None: all.

    Returns:
        An open file, to be used in a `with` block: see `StateFile`. Memory does not grow with the file.

    Raises:
        InputError: When opening or while iterating, naming file and column: a file that is missing, damaged or of another
            kind; a column that is missing, spelt twice, of the wrong shape or dtype, or named like an output column.
            Contacts of a row that cannot be used are no error: `StateBatch.contacts` names these rows.
        MissingExtra: For Parquet or CSV without pyarrow.
    """
    path = Path(path)
    extension = extension_of(path, READABLE)
    if batch_size < 1:
        raise InputError(f"batch size = {batch_size} (expected at least 1)")
    if mass is not None and not 0 < mass < np.inf:
        raise InputError(f"mass = {mass} (expected a positive number of kilograms)")
    if not path.is_file():
        raise InputError(f"{path}: {'not a file' if path.exists() else 'no such file'}")
    if extension == ".npz":
        return NpzStates(path, batch_size, np.dtype(dtype), mass)
    if extension == ".csv":
        with needs_extra("data", "reading CSV"):
            from jaxcap.files.csv import CsvStates
        return CsvStates(path, batch_size, np.dtype(dtype), mass)
    with needs_extra("data", "reading Parquet"):
        from jaxcap.files.parquet import ParquetStates
    return ParquetStates(path, batch_size, np.dtype(dtype), mass, row_groups)


class ScoreWriter:
    """Appends scored batches to a file that is being written; see `write_scores`."""

    def __init__(self, writer: "ParquetWriter | NpzWriter", dtype: np.dtype, metadata: dict[str, Any]):
        self._writer, self._dtype, self._metadata = writer, dtype, metadata

    def write(self, columns: Mapping[str, Any], *answers: Capturability | Baselines) -> None:
        """Appends n rows. columns: `StateBatch.columns`. answers: their scores and what else was asked for, arrays (n,)."""
        added = [output_columns(answer, self._dtype) for answer in answers]
        self._writer.write(reduce(or_, added, dict(columns)))

    def remark(self, notes: Iterable[str]) -> None:
        """What the metadata say beside the rest, known when all rows were seen."""
        self._metadata["notes"] = list(notes)


@contextmanager
def write_scores(
    path: str | Path,
    types: Mapping[str, Any],
    metadata: Mapping[str, Any],
    dtype: DTypeLike = np.float32,
    *,
    fields: Iterable[str] = tuple(FIELDS),
    about: Mapping[bytes, bytes] = MappingProxyType({}),
    force: bool = False,
) -> Iterator[ScoreWriter]:
    """Writes a Parquet or NPZ file of scores, in a `with` block. The file appears when the block ends without an error.

    Memory does not grow with the number of rows. A process that is killed may leave a file `.jaxcap-*.tmp` beside `path`.

    Args:
        path: Parquet (.parquet) or NPZ (.npz).
        types: The columns carried through, as `read_states` gives them.
        metadata: See `columns.describe`; stored as JSON under the key `jaxcap` of the Parquet schema, or as the NPZ array
            `metadata`.
        dtype: Of the figures.
        fields: The columns that are added.
        about: What the input says of itself, `StateFile.about`: Parquet says it again.
        force: Replace a file that is there.

    Raises:
        InputError: If the file cannot be written, also for a full disk, or cannot hold a column. Then, and for any other
            exception, `path` is left as it was.
    """
    path = Path(path)
    extension = extension_of(path)
    types, metadata = {**types, **output_types(np.dtype(dtype), fields)}, dict(metadata)
    with whole_file(path, force=force) as handle:
        writer = _writer(extension, handle, Path(os.path.realpath(path)).parent, types, metadata, about)
        try:
            yield ScoreWriter(writer, np.dtype(dtype), metadata)
            writer.finish()
        finally:
            writer.discard()


def _writer(
    extension: str,
    handle: BinaryIO,
    directory: Path,
    types: Mapping[str, Any],
    metadata: Mapping[str, Any],
    about: Mapping[bytes, bytes],
) -> "ParquetWriter | NpzWriter":
    if extension == ".npz":
        return NpzWriter(handle, directory, types, metadata)
    with needs_extra("data", "writing Parquet"):
        from jaxcap.files.parquet import ParquetWriter
    return ParquetWriter(handle, types, metadata, about)
