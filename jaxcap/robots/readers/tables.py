"""CSV and Parquet: columns, read in pieces. Importing this module needs pyarrow."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pyarrow import csv

from jaxcap.errors import InputError
from jaxcap.files.arrow_columns import is_list, is_number
from jaxcap.robots.readers.spool import Spools

BLOCK_BYTES = 1 << 24
"""Bytes of a CSV file that are read at a time."""
ROWS = 1 << 16
"""Rows of a Parquet file that are read at a time."""


def csv_table(path: Path, header: bool, stack: ExitStack) -> dict[str, Any]:
    """The columns of a CSV file by name; without a header one field, `table`."""
    spools = Spools(str(path), stack)
    options = csv.ReadOptions(block_size=BLOCK_BYTES, autogenerate_column_names=not header)
    with csv.open_csv(path, read_options=options) as reader:
        for batch in reader:
            if header:
                _append(spools, batch)
            else:
                wrong = next((i for i, field in enumerate(batch.schema) if not is_number(field.type)), None)
                if wrong is not None:
                    raise InputError(
                        f"{path}: column {wrong} has type {batch.schema[wrong].type} (expected numbers, no header)"
                    )
                spools.append("table", np.stack([_numbers(column) for column in batch.columns], axis=1))
    return spools.arrays()


def parquet(path: Path, stack: ExitStack) -> dict[str, Any]:
    """The columns of a Parquet file that hold numbers, or lists of as many numbers in each row."""
    spools = Spools(str(path), stack)
    with pq.ParquetFile(path, pre_buffer=False, buffer_size=1 << 20) as file:
        wanted = [field.name for field in file.schema_arrow if is_number(field.type) or is_list(field.type) or _flag(field)]
        for batch in file.iter_batches(ROWS, columns=wanted):
            _append(spools, batch)
    return spools.arrays()


def _flag(field: pa.Field) -> bool:
    return pa.types.is_boolean(field.type)


def _append(spools: Spools, batch: pa.RecordBatch) -> None:
    """Adds the columns of numbers of a batch."""
    for field, column in zip(batch.schema, batch.columns, strict=True):
        if is_number(field.type) or _flag(field):
            spools.append(field.name, _numbers(column))
        elif is_list(field.type) and is_number(field.type.value_type):
            lengths = pc.fill_null(pc.list_value_length(column), 0).to_numpy(zero_copy_only=False)
            if len(lengths) and (lengths == lengths[0]).all():
                spools.append(field.name, _numbers(column.flatten()).reshape(len(lengths), -1))


def _numbers(column: pa.Array) -> np.ndarray:
    """As float64; nulls are NaN."""
    return column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
