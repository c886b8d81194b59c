"""Parquet state files, read and written in pieces. Importing this module needs pyarrow (extra `data`)."""

import base64
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import DTypeLike

from jaxcap.files.arrow_columns import arrow_field, is_list, to_arrow
from jaxcap.files.arrow_states import ArrowStates, readable
from jaxcap.files.columns import VECTORS, to_json
from jaxcap.files.fields import NAMES

READ_AHEAD = 1 << 20
"""Bytes of each column that are read at a time."""

ROW_GROUP = 1 << 16
"""Rows that a row group of the output holds at least, so that the footer stays small whatever the batch size."""


class ParquetStates(ArrowStates):
    """An open Parquet file of states; or some of its row groups, as if they were all."""

    format = "Parquet"

    def __init__(
        self, path: Path, batch_size: int, dtype: DTypeLike, mass: float | None = None, row_groups: range | None = None
    ):
        self._row_groups = row_groups
        super().__init__(path, batch_size, dtype, mass)

    def _opened(self) -> pq.ParquetFile:
        with readable(self.path, self.format):
            # without pre_buffer=False the bytes of every row group are kept until the end
            return pq.ParquetFile(self.path, pre_buffer=False, buffer_size=READ_AHEAD, page_checksum_verification=True)

    def _header(self) -> tuple[pa.Schema, int]:
        rows = self._file.metadata.num_rows
        if self._row_groups is not None:
            rows = sum(self._file.metadata.row_group(number).num_rows for number in self._row_groups)
        return self._file.schema_arrow, rows

    def _batches(self) -> Iterable[pa.RecordBatch]:
        groups = None if self._row_groups is None else list(self._row_groups)
        return self._file.iter_batches(self.batch_size, row_groups=groups)


class ParquetWriter:
    """Writes a Parquet file row by row.

    Args:
        handle: The file, empty.
        types: NumPy type, or Arrow field, of each column.
        metadata: See `columns.describe`; it is written at the end.
        about: What the input said of itself, and the output says again.

    Raises:
        InputError: If a column does not fit into a Parquet file.
    """

    def __init__(
        self, handle: BinaryIO, types: Mapping[str, Any], metadata: Mapping[str, Any], about: Mapping[bytes, bytes]
    ):
        fields = [
            arrow_field(name, kind, _about(name, metadata)) if isinstance(kind, np.dtype) else kind
            for name, kind in types.items()
        ]
        self._metadata, self._about = metadata, about
        self._schema = pa.schema(fields)
        self._waiting: list[pa.Table] = []
        others = [field for field in self._schema if not _is_figure(field, metadata)]
        # To look for figures that occur twice, where hardly any do, would take most of the time, and space too
        repeated = [leaf for field in others for leaf in _leaves(field.name, field.type)]
        self._writer = pq.ParquetWriter(handle, self._schema, use_dictionary=repeated, store_schema=False)

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
        said = {**self._about, b"jaxcap": to_json(self._metadata).encode()}
        # Arrow would store the schema when the file is opened, but what there is to say is known at the end
        schema = base64.b64encode(self._schema.with_metadata(said).serialize().to_pybytes())
        self._writer.add_key_value_metadata({**said, b"ARROW:schema": schema})
        self._writer.close()

    def discard(self) -> None:
        """Lets go of the handle; what was written is of no use."""
        with suppress(Exception):  # the footer may meet the same full disk
            self._writer.close()


def _is_figure(field: pa.Field, metadata: Mapping[str, Any]) -> bool:
    """Whether it is part of a state, or a figure of the answer: floats that differ from row to row."""
    kind = field.type.value_type if is_list(field.type) else field.type
    ours = field.name in metadata["units"] or field.name in VECTORS or field.name[:-2] in VECTORS
    return ours and pa.types.is_floating(kind)


def _leaves(name: str, kind: pa.DataType) -> list[str]:
    """The Parquet columns that a column becomes."""
    if pa.types.is_struct(kind):
        return [leaf for field in kind for leaf in _leaves(f"{name}.{field.name}", field.type)]
    if pa.types.is_map(kind):
        parts = (("key", kind.key_type), ("value", kind.item_type))
        return [leaf for part, inner in parts for leaf in _leaves(f"{name}.key_value.{part}", inner)]
    return _leaves(f"{name}.list.element", kind.value_type) if is_list(kind) else [name]


def _about(name: str, metadata: Mapping[str, Any]) -> dict[str, str] | None:
    """Metadata of a field of the output: unit, meaning, names of codes."""
    if name not in metadata["meanings"]:
        return None
    about = {"unit": metadata["units"][name], "meaning": metadata["meanings"][name]}
    return about | ({"names": to_json(NAMES[name])} if name in NAMES else {})
