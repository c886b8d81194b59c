"""Contacts in the columns of a state file: each row its own, or the number or name of a set in a contacts file."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Shaped

from jaxcap.contacts.conventions import ROTATION_ERROR
from jaxcap.errors import InputError
from jaxcap.files.bad_rows import BadRows
from jaxcap.numerics.whole import round_up

OWN = POINTS, FRAMES, FRICTION, MASK = ("contact_points", "contact_frames", "contact_friction", "contact_mask")
"""The columns that give each row its own contacts; only the mask may be absent."""

CHOICE = "contact_set"
"""The column that says which set of the contacts file a row has."""

INNER = {POINTS: (3,), FRAMES: (3, 3), FRICTION: (), MASK: ()}
"""What each column holds for one contact."""

MULTIPLE = 4
"""Contacts are padded to a multiple of this number, so that few sizes are compiled; a foot has as many."""

MOST = 64
"""Most contacts of a row: one long list pads all rows of its batch, and memory shall stay bounded."""


class Padded(NamedTuple):
    """One column of a batch, in lists of equal length."""

    values: Float[np.ndarray, "n k ..."]
    """What the row's contacts have; anything from the row's own number of contacts on."""
    counts: Shaped[np.ndarray, " n"]
    """Number of contacts of each row."""


class RowContacts(NamedTuple):
    """Contacts for each row of a batch. Rows with none, and rows that cannot be used, are masked altogether."""

    points: Float[np.ndarray, "n k 3"]
    """Positions [m]."""
    frames: Float[np.ndarray, "n k 3 3"]
    """Rotations; columns tangent, tangent, normal pointing at the robot."""
    friction: Float[np.ndarray, "n k"]
    """Friction coefficients."""
    mask: Bool[np.ndarray, "n k"]
    """False for padding."""
    bad: BadRows
    """Rows that cannot be used."""

    def padded(self, size: int) -> "RowContacts":
        """The same contacts in `size` places a row, at least as many as there are; those added are masked."""
        n, k = self.mask.shape
        if size == k:
            return self

        def fill(values: np.ndarray, value: Any) -> np.ndarray:
            added = np.broadcast_to(np.asarray(value, values.dtype), (n, size - k, *values.shape[2:]))
            return np.concatenate([values, added], axis=1)

        points, frames, friction, mask, bad = self
        return RowContacts(fill(points, 0), fill(frames, np.eye(3)), fill(friction, 1), fill(mask, False), bad)


class RowChoices(NamedTuple):
    """The set of the contacts file that each row of a batch asks for."""

    numbers: Shaped[np.ndarray, " n"]
    """Integers: the number of the set, from 0; with `names`, a place in those."""
    names: tuple[str, ...] | None
    """The names that occur, if the column holds names."""
    missing: Bool[np.ndarray, " n"]
    """Rows without a value."""

    def shown(self, row: int) -> str:
        """What the column says in a row, for messages."""
        number = self.numbers[row]
        return str(number) if self.names is None else repr(self.names[number])


def contact_columns(path: str | Path, names: Iterable[str]) -> tuple[str, ...]:
    """The columns that speak of contacts: those of OWN, or CHOICE, or none. Raises InputError for both, or for a part."""
    names = set(names)
    own = tuple(name for name in OWN if name in names)
    if own and CHOICE in names:
        raise InputError(f"{path}: both {own[0]!r} and {CHOICE!r} are there (expected one way to give contacts)")
    missing = next((name for name in (POINTS, FRAMES, FRICTION) if name not in names), None)
    if own and missing:
        raise InputError(f"{path}: no column {missing!r} beside {own[0]!r}")
    return own or ((CHOICE,) if CHOICE in names else ())


def content_of(name: str) -> str:
    """What a column holds in each row, in words."""
    if name == MASK:
        return "a list of k booleans"
    if name == FRICTION:
        return "k numbers, or one"
    return f"{' x '.join(map(str, ('k', *INNER[name])))} or {math.prod(INNER[name])} k numbers"


def size_by_shape(where: str, name: str, row: Sequence[int | None]) -> int | None:
    """Number of contacts by the shape of a row, None if the rows say it (or there is one friction for all).

    row: sizes of the axes, None for one that differs from row to row. Raises InputError if the column cannot be this one.
    """
    inner, size = INNER[name], math.prod(INNER[name])
    nested = len(row) == 1 + len(inner) and all(n in (None, m) for n, m in zip(row[1:], inner, strict=True))
    flat = len(row) == 1 and (row[0] is None or row[0] % size == 0)
    if not (nested or flat or (name == FRICTION and len(row) == 0)):
        shape = ", ".join("any" if n is None else str(n) for n in row)
        raise InputError(f"{where} has rows of shape ({shape}) (expected {content_of(name)})")
    if not row or row[0] is None:
        return None
    k = row[0] if nested else row[0] // size
    if k > MOST:
        raise InputError(f"{where} has {k} contacts a row (expected at most {MOST})")
    return k


def agree(path: str | Path, counts: Mapping[str, int | None]) -> None:
    """Raises InputError if two columns are made for different numbers of contacts."""
    known = {name: k for name, k in counts.items() if k is not None}
    for name, k in known.items():
        first = next(iter(known))
        if k != known[first]:
            raise InputError(f"{path}: {name!r} has {k} contacts a row (expected {known[first]}, as {first!r} has)")


def chosen(column: Shaped[np.ndarray, " n"]) -> RowChoices:
    """The choices of an array of integers or texts."""
    missing = np.zeros(len(column), dtype=bool)
    if column.dtype.kind != "U":
        return RowChoices(column, None, missing)
    names, numbers = np.unique(column, return_inverse=True)
    return RowChoices(numbers, tuple(names.tolist()), missing)


def from_arrays(columns: Mapping[str, np.ndarray], dtype: np.dtype) -> RowContacts:
    """Contacts for each row, from arrays.

    Args:
        columns: contact_points (n, k, 3) [m], contact_frames (n, k, 3, 3), contact_friction (n, k) or (n,), and perhaps
            contact_mask (n, k) bool, False for padding; without it, points of three NaN are padding. The axes of a row
            may be joined into one: the shapes are those that `size_by_shape` accepts.
        dtype: float32 or float64, of the result.

    Returns:
        The contacts; rows whose values cannot be used are named in it.
    """
    n = len(columns[POINTS])
    padded = {}
    for name, values in columns.items():
        shape = (n, -1, *INNER[name]) if values.size else (n, 0, *INNER[name])
        values = values.astype(np.float64) if name == FRICTION and values.ndim == 1 else values.reshape(shape)
        padded[name] = Padded(values.astype(np.float64), np.full(n, values.shape[1] if values.ndim > 1 else 0))
    return row_contacts(padded, dtype, BadRows(n))


def row_contacts(columns: Mapping[str, Padded], dtype: np.dtype, bad: BadRows) -> RowContacts:
    """Contacts for each row, from columns in float64 that may disagree on how many there are.

    Args:
        columns: By name, as in `from_arrays`; a friction for all contacts of a row has the shape (n,).
        dtype: float32 or float64, of the result.
        bad: Rows that were found unusable when reading; more are added here.
    """
    counts = columns[POINTS].counts
    for name, column in columns.items():
        if name != POINTS and column.values.ndim > 1:
            bad.add(np.not_equal(column.counts, counts), partial(_disagree, name, column.counts, counts))
    counts = np.where(bad.rows, 0, counts)
    k = round_up(int(counts.max(initial=1)), MULTIPLE)
    with np.errstate(over="ignore"):  # too large for float32: infinite, hence unusable
        points, friction = (_sized(columns[name].values, k).astype(dtype) for name in (POINTS, FRICTION))
    frames = _sized(columns[FRAMES].values, k)
    mask = np.arange(k) < counts[:, None]
    if MASK in columns:
        given = _sized(columns[MASK].values, k)
        unknown = mask & np.isnan(given)
        bad.add(unknown.any(axis=1), lambda row: f"{MASK}[{np.argmax(unknown[row])}] is null (expected true or false)")
        mask &= given == 1
    else:
        mask &= ~np.isnan(points).all(axis=-1)
    _check_values(points, frames, friction, mask, bad)
    mask &= ~bad.rows[:, None]

    def neutral(values: np.ndarray, value: Any) -> np.ndarray:
        used = mask.reshape(*mask.shape, *(1,) * (values.ndim - 2))
        return np.where(used, values.astype(dtype, copy=False), np.asarray(value, dtype))

    return RowContacts(neutral(points, 0), neutral(frames, np.eye(3)), neutral(friction, 1), mask, bad)


def _disagree(name: str, found: Shaped[np.ndarray, " n"], wanted: Shaped[np.ndarray, " n"], row: int) -> str:
    return f"{name} has {found[row]} contacts (expected {wanted[row]}, as {POINTS} has)"


def _sized(values: np.ndarray, k: int) -> np.ndarray:
    """With k contacts in every row: one number is for all of them, and zeros fill up."""
    if values.ndim == 1:
        return np.repeat(values[:, None], k, axis=1)
    values = values[:, :k]
    return np.pad(values, ((0, 0), (0, k - values.shape[1]), *[(0, 0)] * (values.ndim - 2)))


def _check_values(
    points: Float[np.ndarray, "n k 3"],
    frames: Float[np.ndarray, "n k 3 3"],
    friction: Float[np.ndarray, "n k"],
    mask: Bool[np.ndarray, "n k"],
    bad: BadRows,
) -> None:
    """Adds the rows in which a contact that is not masked cannot be used.

    These are the contacts that `ContactSet` raises for, and a test holds the two against each other; but here one bad row
    must not cost the others, so what is wrong is an array, and the first such row is put into words.
    """

    def add(wrong: Any, why: Callable[[int, int], str]) -> None:
        wrong = wrong & mask
        bad.add(wrong.any(axis=1), lambda row: why(row, int(np.argmax(wrong[row]))))

    add(
        ~np.isfinite(points).all(axis=-1),
        lambda row, i: f"{POINTS}[{i}] = {points[row, i].tolist()} (expected finite numbers)",
    )
    error, determinant = np.zeros(mask.shape), np.ones(mask.shape)
    error[mask], determinant[mask] = _rotation_error(frames[mask])
    add(
        np.logical_not((error <= ROTATION_ERROR) & (determinant > 0)),
        lambda row, i: (
            f"{FRAMES}[{i}] is not a rotation: det = {determinant[row, i]:.3f} (expected +1), "
            f"columns orthonormal to {error[row, i]:.1e} (expected {ROTATION_ERROR:.0e})"
        ),
    )
    add(
        np.logical_not(np.isfinite(friction) & (friction > 0)),
        lambda row, i: f"{FRICTION}[{i}] = {friction[row, i]} (expected a positive finite number)",
    )


def _rotation_error(frames: Float[np.ndarray, "m 3 3"]) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Largest entry of |R'R - 1|, and the determinant, by columns: for a million frames, LAPACK takes a second."""
    a, b, c = (frames[:, :, i] for i in range(3))
    with np.errstate(over="ignore", invalid="ignore"):
        products = [np.einsum("mi,mi->m", u, v) - (u is v) for u, v in ((a, a), (b, b), (c, c), (a, b), (a, c), (b, c))]
        return np.max(np.abs(products), axis=0), np.einsum("mi,mi->m", np.cross(a, b), c)
