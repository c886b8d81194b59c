"""CSV files of states. Importing this module needs pyarrow (extra `data`).

A table of text has no lists: a state is spelt com_x, com_y, com_z, com_velocity_x, ... The types of other columns are those
of the first megabytes.
"""

from collections.abc import Iterable
from contextlib import ExitStack
from typing import Any

import pyarrow as pa
from pyarrow import csv

from jaxcap.files.arrow_states import ArrowStates
from jaxcap.files.columns import VECTORS

BLOCK_BYTES = 1 << 24
"""Bytes that are read at a time."""
NUMBERS = tuple(f"{vector}_{axis}" for vector in VECTORS for axis in "xyz")
"""Columns that are numbers whatever the first rows look like."""


class CsvStates(ArrowStates):
    """An open CSV file of states. It is read twice: how many rows it has is known at its end only."""

    format = "CSV"

    def _opened(self) -> ExitStack:
        return ExitStack()

    def _reader(self) -> Any:
        return csv.open_csv(
            self.path,
            read_options=csv.ReadOptions(block_size=BLOCK_BYTES, use_threads=False),
            convert_options=csv.ConvertOptions(column_types=dict.fromkeys(NUMBERS, pa.float64())),
        )

    def _header(self) -> tuple[pa.Schema, int]:
        with self._reader() as reader:
            return reader.schema, sum(batch.num_rows for batch in reader)

    def _batches(self) -> Iterable[pa.RecordBatch]:
        with self._reader() as reader:
            yield from reader
