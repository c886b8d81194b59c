"""Parquet state files, read and written in pieces. Importing this module needs pyarrow (extra `data`)."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float

from jaxcap.errors import InputError
from jaxcap.files import arrow_contacts
from jaxcap.files.arrow_columns import arrow_field, is_list, is_number, numbers, to_arrow, vectors
from jaxcap.files.columns import VECTORS, StateBatch, refuse_clashes, spelling, to_json
from jaxcap.files.contact_columns import CHOICE, RowChoices, RowContacts, agree, contact_columns
from jaxcap.files.fields import NAMES
from jaxcap.files.state_file import StateFile

READ_AHEAD = 1 << 20
"""Bytes of each column that are read at a time."""

ROW_GROUP = 1 << 16
"""Rows that a row group of the output holds at least, so that the footer stays small whatever the batch size."""


class ParquetStates(StateFile):
    """An open Parquet file of states."""

    def _opened(self) -> pq.ParquetFile:
        with _readable(self.path):
            # without pre_buffer=False the bytes of every row group are kept until the end
            return pq.ParquetFile(
                self.path, pre_buffer=False, buffer_size=READ_AHEAD, page_checksum_verification=True
            )

    def _open(self) -> None:
        with _readable(self.path):
            schema, self.rows = self._file.schema_arrow, self._file.metadata.num_rows
        repeated = next((name for name in schema.names if schema.names.count(name) > 1), None)
        if repeated is not None:
            raise InputError(f"{self.path}: {schema.names.count(repeated)} columns have the name {repeated!r}")
        self._vectors = {vector: spelling(self.path, vector, schema.names) for vector in VECTORS}
        for name in (name for names in self._vectors.values() for name in names):
            self._check(name, schema.field(name).type, listed=name in VECTORS)
        self.contacts = contact_columns(self.path, schema.names)
        kinds = {name: (f"{self.path}: column {name!r}", schema.field(name).type) for name in self.contacts}
        if self.contacts == (CHOICE,):
            arrow_contacts.check_choice(*kinds[CHOICE])
        else:
            counts = {name: arrow_contacts.size_by_type(where, name, kind) for name, (where, kind) in kinds.items()}
            agree(self.path, counts)
        refuse_clashes(self.path, schema.names)
        self.types = {field.name: field for field in schema}

    def _check(self, name: str, kind: pa.DataType, listed: bool) -> None:
        inner = kind.value_type if listed and is_list(kind) else kind
        if not is_number(inner) or listed != is_list(kind):
            expected = "lists of 3 floats or integers" if listed else "floats or integers"
            raise InputError(f"{self.path}: column {name!r} has type {kind} (expected {expected})")
        if pa.types.is_fixed_size_list(kind) and kind.list_size != 3:
            raise InputError(f"{self.path}: column {name!r} holds {kind.list_size} numbers a row (expected 3)")

    def __iter__(self) -> Iterator[StateBatch]:
        row = 0
        with _readable(self.path):
            for table in regrouped(self._file.iter_batches(self.batch_size), self.batch_size):
                columns = {name: _whole(table.column(name)) for name in self.types}
                com, com_velocity = (self._vector(columns, names, row) for names in self._vectors.values())
                yield StateBatch(com, com_velocity, columns, self._row_contacts(columns))
                row += table.num_rows

    def _vector(self, columns: Mapping[str, pa.Array], names: tuple[str, ...], row: int) -> Float[np.ndarray, "n 3"]:
        if len(names) == 1:
            return vectors(columns[names[0]], self.dtype, f"{self.path}: column {names[0]!r}", row)
        return np.stack([numbers(columns[name], self.dtype) for name in names], axis=1)

    def _row_contacts(self, columns: Mapping[str, pa.Array]) -> RowContacts | RowChoices | None:
        if not self.contacts:
            return None
        if self.contacts == (CHOICE,):
            return arrow_contacts.choices(columns[CHOICE])
        return arrow_contacts.contacts({name: columns[name] for name in self.contacts}, self.dtype)


class ParquetWriter:
    """Writes a Parquet file row by row.

    Args:
        handle: The file, empty.
        types: NumPy type, or Arrow field, of each column.
        metadata: See `columns.describe`.

    Raises:
        InputError: If a column does not fit into a Parquet file.
    """

    def __init__(self, handle: BinaryIO, types: Mapping[str, Any], metadata: Mapping[str, Any]):
        fields = [
            arrow_field(name, kind, _about(name, metadata)) if isinstance(kind, np.dtype) else kind
            for name, kind in types.items()
        ]
        self._schema = pa.schema(fields, metadata={"jaxcap": to_json(metadata)})
        self._waiting: list[pa.Table] = []
        self._writer = pq.ParquetWriter(handle, self._schema)

    def write(self, columns: Mapping[str, Any]) -> None:
        """Appends rows. columns: one array for each of `types`, all with the same number of rows."""
        arrays = [columns[name] for name in self._schema.names]
        arrays = [
            to_arrow(array, field.type) if isinstance(array, np.ndarray) else array
            for array, field in zip(arrays, self._schema, strict=True)
        ]
        self._waiting.append(pa.table(arrays, schema=self._schema))
        if sum(table.num_rows for table in self._waiting) >= ROW_GROUP:
            self._flush()

    def _flush(self) -> None:
        if self._waiting:
            self._writer.write_table(pa.concat_tables(self._waiting).unify_dictionaries())
            self._waiting = []

    def finish(self) -> None:
        """Writes what is left and the footer. The caller flushes and closes the handle."""
        self._flush()
        self._writer.close()

    def discard(self) -> None:
        """Lets go of the handle; what was written is of no use."""
        with suppress(Exception):  # the footer may meet the same full disk
            self._writer.close()


def regrouped(batches: Iterable[pa.RecordBatch], size: int) -> Iterator[pa.Table]:
    """The same rows in tables of `size` rows, and a last one of what is left: Arrow ends a batch at each row group."""
    waiting, rows = [], 0
    for batch in batches:
        waiting.append(batch)
        rows += batch.num_rows
        while rows >= size:
            table = pa.Table.from_batches(waiting)
            yield table.slice(0, size)
            rows -= size
            waiting = table.slice(size).to_batches() if rows else []
    if rows:
        yield pa.Table.from_batches(waiting)


def _whole(column: pa.ChunkedArray) -> pa.Array:
    """The column in one piece."""
    chunks = column.unify_dictionaries().chunks
    return chunks[0] if len(chunks) == 1 else pa.concat_arrays(chunks)


def _about(name: str, metadata: Mapping[str, Any]) -> dict[str, str] | None:
    """Metadata of a field of the output: unit, meaning, names of codes."""
    if name not in metadata["meanings"]:
        return None
    about = {"unit": metadata["units"][name], "meaning": metadata["meanings"][name]}
    return about | ({"names": to_json(NAMES[name])} if name in NAMES else {})


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turns what a damaged file raises into InputError."""
    try:
        yield
    except InputError:
        raise
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path}: cannot be read as Parquet: {str(error).splitlines()[0]}") from error
