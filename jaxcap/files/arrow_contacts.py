"""Arrow lists of contacts, ragged or not, as padded arrays. Importing this module needs pyarrow (extra `data`)."""

import math
from collections.abc import Mapping

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Float, Int

from jaxcap.errors import InputError
from jaxcap.files.arrow_columns import is_list, is_number, numbers
from jaxcap.files.bad_rows import BadRows
from jaxcap.files.contact_columns import (
    INNER,
    MASK,
    MOST,
    Padded,
    RowChoices,
    RowContacts,
    content_of,
    row_contacts,
    size_by_shape,
)


def size_by_type(where: str, name: str, kind: pa.DataType) -> int | None:
    """Number of contacts by the type of a column, None if each row says it. Raises InputError for a wrong type."""
    row, inner = [], kind
    while is_list(inner):
        row.append(inner.list_size if pa.types.is_fixed_size_list(inner) else None)
        inner = inner.value_type
    empty = row and pa.types.is_null(inner)  # no row has a contact
    if not (empty or (pa.types.is_boolean(inner) if name == MASK else is_number(inner))):
        raise InputError(f"{where} has type {kind} (expected {content_of(name)})")
    return size_by_shape(where, name, row)


def check_choice(where: str, kind: pa.DataType) -> None:
    """Raises InputError unless such a column can hold numbers or names of contact sets."""
    inner = kind.value_type if pa.types.is_dictionary(kind) else kind
    if not (pa.types.is_integer(kind) or pa.types.is_string(inner) or pa.types.is_large_string(inner)):
        raise InputError(f"{where} has type {kind} (expected integers or names)")


def choices(column: pa.Array) -> RowChoices:
    """The numbers or names of contact sets, from a column that passed `check_choice`."""
    names = None
    missing = column.is_null().to_numpy(zero_copy_only=False)
    if not pa.types.is_integer(column.type):
        texts = column.dictionary_decode() if pa.types.is_dictionary(column.type) else column
        missing, encoded = texts.is_null().to_numpy(zero_copy_only=False), texts.dictionary_encode()
        names, column = tuple(encoded.dictionary.to_pylist()), encoded.indices
    return RowChoices(pc.fill_null(column, 0).to_numpy(zero_copy_only=False), names, missing)


def contacts(columns: Mapping[str, pa.Array], dtype: np.dtype) -> RowContacts:
    """Contacts for each row, from columns that passed `size_by_type`. dtype: float32 or float64, of the result."""
    bad = BadRows(len(next(iter(columns.values()))))
    return row_contacts({name: _padded(column, name, bad) for name, column in columns.items()}, dtype, bad)


def _padded(column: pa.Array, name: str, bad: BadRows) -> Padded:
    """The lists of a column, all as long as the longest one that can be used."""
    if not is_list(column.type):
        return Padded(numbers(column, np.dtype(np.float64)), np.zeros(len(column), dtype=int))
    missing = column.is_null().to_numpy(zero_copy_only=False)
    bad.add(missing, lambda row: f"{name} is null (expected {content_of(name)})")
    nested = is_list(column.type.value_type)
    size = 1 if nested else math.prod(INNER[name])
    lengths, entries = _lengths(column), column.flatten()
    bad.add(lengths % size != 0, lambda row: f"{name} has {lengths[row]} numbers (expected a multiple of {size})")
    long = lengths > MOST * size
    bad.add(long, lambda row: f"{name} has {lengths[row] // size} contacts (expected at most {MOST})")
    values, wrong = _filled(entries, INNER[name] if nested else ())
    rows = np.repeat(np.arange(len(column)), lengths)
    uneven = np.bincount(rows[wrong], minlength=len(column)) > 0
    bad.add(
        uneven,
        lambda row: f"{name}[{np.argmax(wrong[rows == row])}] does not hold {' x '.join(map(str, INNER[name]))} numbers",
    )
    lengths_used = np.where(long, 0, lengths)
    width = -(-int(lengths_used.max(initial=0)) // size) * size
    values = _scattered(values, lengths, width)
    return Padded(values.reshape(len(column), width // size, *INNER[name]), lengths // size)


def _filled(column: pa.Array, shape: tuple[int, ...]) -> tuple[Float[np.ndarray, "m ..."], Bool[np.ndarray, " m"]]:
    """Lists in lists as an array (m, *shape), nulls as NaN; and which of them have another shape."""
    if not shape:
        return numbers(column, np.dtype(np.float64)), np.zeros(len(column), dtype=bool)
    lengths = _lengths(column)
    wrong = (lengths != shape[0]) & column.is_valid().to_numpy(zero_copy_only=False)
    values, inner_wrong = _filled(column.flatten(), shape[1:])
    if inner_wrong.any():
        wrong |= np.bincount(np.repeat(np.arange(len(column)), lengths)[inner_wrong], minlength=len(column)) > 0
    return _scattered(values, lengths, shape[0]), wrong


def _scattered(values: np.ndarray, lengths: Int[np.ndarray, " m"], width: int) -> np.ndarray:
    """Lists, one after the other, as an array (m, width, ...): shorter ones are filled up with NaN, longer ones cut."""
    shape = (len(lengths), width, *values.shape[1:])
    if (lengths == width).all():
        return values.reshape(shape)
    rows = np.repeat(np.arange(len(lengths)), lengths)
    places = np.arange(len(values)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    out = np.full(shape, np.nan)
    fits = places < width
    out[rows[fits], places[fits]] = values[fits]
    return out


def _lengths(column: pa.Array) -> Int[np.ndarray, " m"]:
    return pc.fill_null(pc.list_value_length(column), 0).to_numpy(zero_copy_only=False).astype(np.int64)
