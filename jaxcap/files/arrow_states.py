"""Files of states that Arrow reads, whatever their format. Importing this module needs pyarrow (extra `data`)."""

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from jaxcap.errors import InputError
from jaxcap.files import arrow_contacts
from jaxcap.files.arrow_columns import is_list, is_number, numbers, vectors
from jaxcap.files.bad_rows import BadRows
from jaxcap.files.columns import StateBatch, refuse_clashes
from jaxcap.files.contact_columns import CHOICE, RowChoices, RowContacts, agree, contact_columns
from jaxcap.files.state_file import StateFile


class ArrowStates(StateFile):
    """An open file of states, read as record batches. A format says how its header and its batches are read."""

    format = ""
    """Its name, for messages."""

    @abstractmethod
    def _header(self) -> tuple[pa.Schema, int]:
        """The columns and the number of rows."""

    @abstractmethod
    def _batches(self) -> Iterable[pa.RecordBatch]:
        """All rows, in pieces of any size."""

    def _open(self) -> None:
        with readable(self.path, self.format):
            schema, self.rows = self._header()
            names = schema.names
        repeated = next((name for name in names if names.count(name) > 1), None)
        if repeated is not None:
            raise InputError(f"{self.path}: {names.count(repeated)} columns have the name {repeated!r}")
        self._vectors = self._spelt(names)
        for name, listed in ((name, len(parts) == 1) for parts in self._vectors.values() for name in parts):
            self._check(name, schema.field(name).type, listed)
        self.contacts = contact_columns(self.path, names)
        kinds = {name: (f"{self.path}: column {name!r}", schema.field(name).type) for name in self.contacts}
        if self.contacts == (CHOICE,):
            arrow_contacts.check_choice(*kinds[CHOICE])
        else:
            counts = {name: arrow_contacts.size_by_type(where, name, kind) for name, (where, kind) in kinds.items()}
            agree(self.path, counts)
        refuse_clashes(self.path, names)
        self.types = {field.name: field for field in schema}
        self.about = dict(schema.metadata or {})

    def _check(self, name: str, kind: pa.DataType, listed: bool) -> None:
        inner = kind.value_type if listed and is_list(kind) else kind
        if not is_number(inner) or listed != is_list(kind):
            expected = "lists of 3 floats or integers" if listed else "floats or integers"
            raise InputError(f"{self.path}: column {name!r} has type {kind} (expected {expected})")
        if pa.types.is_fixed_size_list(kind) and kind.list_size != 3:
            raise InputError(f"{self.path}: column {name!r} holds {kind.list_size} numbers a row (expected 3)")

    def __iter__(self) -> Iterator[StateBatch]:
        with readable(self.path, self.format):
            for table in regrouped(self._batches(), self.batch_size):
                columns = {name: _whole(table.column(name)) for name in self.types}
                bad = BadRows(table.num_rows)
                vectors = {vector: self._vector(columns, names, bad) for vector, names in self._vectors.items()}
                yield self._batch(vectors, columns, bad, self._row_contacts(columns))

    def _vector(self, columns: Mapping[str, pa.Array], names: tuple[str, ...], bad: BadRows) -> Float[np.ndarray, "n 3"]:
        if len(names) == 1:
            found = vectors(columns[names[0]], self.dtype, bad, names[0])
        else:
            found = np.stack([numbers(columns[name], self.dtype) for name in names], axis=1)
        bad.add_not_finite(names, found)
        return found

    def _row_contacts(self, columns: Mapping[str, pa.Array]) -> RowContacts | RowChoices | None:
        if not self.contacts:
            return None
        if self.contacts == (CHOICE,):
            return arrow_contacts.choices(columns[CHOICE])
        return arrow_contacts.contacts({name: columns[name] for name in self.contacts}, self.dtype)


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


@contextmanager
def readable(path: Path, kind: str) -> Iterator[None]:
    """Turns what a damaged file raises into InputError. kind: name of the format."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:  # besides Arrow's own errors, what Python makes of the bytes: names that are not UTF-8
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: cannot be read as {kind}: {reason}") from error
