"""Arrow columns as NumPy arrays and back. Importing this module needs pyarrow (extra `data`)."""

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float

from jaxcap.errors import InputError
from jaxcap.files.bad_rows import BadRows


def is_list(kind: pa.DataType) -> bool:
    """Whether each entry of such a column is a list."""
    return pa.types.is_fixed_size_list(kind) or pa.types.is_list(kind) or pa.types.is_large_list(kind)


def is_number(kind: pa.DataType) -> bool:
    """Whether such a column can be part of a state: floats and integers, but not decimals or booleans."""
    return pa.types.is_floating(kind) or pa.types.is_integer(kind)


def is_ragged(kind: pa.DataType) -> bool:
    """Whether each entry of such a column is a list, of any length."""
    return is_list(kind) and not pa.types.is_fixed_size_list(kind)


def vector_type(kind: pa.DataType) -> np.dtype:
    """The NumPy type of numbers in such lists: integers become floats, for nulls are NaN."""
    return np.dtype(kind.value_type.to_pandas_dtype() if pa.types.is_floating(kind.value_type) else np.float64)


def vectors(column: pa.Array, dtype: np.dtype, bad: BadRows | None = None, name: str = "") -> Float[np.ndarray, "n 3"]:
    """A column of lists of three numbers. Nulls, and lists of another length, become NaN; `bad` is told of them."""
    lengths = pc.fill_null(pc.list_value_length(column), 0).to_numpy(zero_copy_only=False)
    if bad is not None:
        bad.add(column.is_null().to_numpy(zero_copy_only=False), lambda row: f"{name} is null (expected 3 numbers)")
        bad.add(lengths != 3, lambda row: f"{name} has {lengths[row]} numbers (expected 3)")
    if (lengths == 3).all() and not column.null_count:
        return numbers(column.flatten(), dtype).reshape(-1, 3)
    out = np.full((len(column), 3), np.nan, dtype)
    whole = pa.array((lengths == 3) & column.is_valid().to_numpy(zero_copy_only=False))
    out[whole.to_numpy(zero_copy_only=False)] = numbers(column.filter(whole).flatten(), dtype).reshape(-1, 3)
    return out


def numbers(column: pa.Array, dtype: np.dtype) -> Float[np.ndarray, " n"]:
    """A column of numbers. Nulls become NaN, and what is too large for `dtype` becomes infinite."""
    wide = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
    with np.errstate(over="ignore"):
        return wide.astype(dtype)


def numpy_type(kind: pa.DataType, where: str) -> np.dtype:
    """The NumPy type that `to_numpy` gives for such a column. Raises InputError if there is none."""
    types = pa.types
    if types.is_dictionary(kind):
        return numpy_type(kind.value_type, where)
    if types.is_string(kind) or types.is_large_string(kind):
        return np.dtype("U1")
    if types.is_fixed_size_list(kind) and kind.list_size:
        inner = numpy_type(kind.value_type, where)
        return np.dtype((inner.base, (kind.list_size, *inner.shape)))
    timed = types.is_date32(kind) or types.is_duration(kind) or (types.is_timestamp(kind) and kind.tz is None)
    if types.is_boolean(kind) or is_number(kind) or timed:
        return np.asarray(pa.array([], kind).to_numpy(zero_copy_only=False)).dtype
    raise InputError(f"{where} has type {kind}, which an NPZ cannot hold; write Parquet, or drop the column")


def to_numpy(column: pa.Array, where: str) -> np.ndarray:
    """A column as an array whose first axis are the rows. Raises InputError for nulls that have no NumPy value."""
    kind = column.type
    if pa.types.is_dictionary(kind):
        return to_numpy(column.dictionary_decode(), where)
    if pa.types.is_fixed_size_list(kind):
        if not column.null_count:
            inner = to_numpy(column.flatten(), where)
            return inner.reshape(len(column), kind.list_size, *inner.shape[1:])
        return np.stack([to_numpy(pc.list_element(column, i), where) for i in range(kind.list_size)], axis=1)
    text = pa.types.is_string(kind) or pa.types.is_large_string(kind)
    if column.null_count and (text or pa.types.is_boolean(kind) or pa.types.is_integer(kind)):
        raise InputError(f"{where} has nulls, which an NPZ cannot hold for {kind}; write Parquet, or drop the column")
    if text:
        return np.array(column.to_pylist(), dtype=str)
    return column.to_numpy(zero_copy_only=False)


def arrow_field(name: str, dtype: np.dtype, metadata: dict[str, str] | None = None) -> pa.Field:
    """The Arrow field for a NumPy type; arrays in rows become fixed-size lists. Raises InputError if none fits."""
    try:
        kind = pa.from_numpy_dtype(dtype.base.newbyteorder("="))
    except pa.ArrowException:
        raise InputError(f"column {name!r} has dtype {dtype.base}, which Parquet cannot hold; write NPZ") from None
    for size in reversed(dtype.shape):
        kind = pa.list_(kind, size)
    return pa.field(name, kind, metadata=metadata)


def to_arrow(rows: np.ndarray, kind: pa.DataType) -> pa.Array:
    """An array as a column of the type that `arrow_field` gave; the first axis are the rows."""
    flat = np.ascontiguousarray(rows).reshape(-1)
    column = pa.array(flat.astype(flat.dtype.newbyteorder("="), copy=False))
    sizes = []
    while pa.types.is_fixed_size_list(kind):
        sizes.append(kind.list_size)
        kind = kind.value_type
    column = column.cast(kind)
    for size in reversed(sizes):
        column = pa.FixedSizeListArray.from_arrays(column, size)
    return column
