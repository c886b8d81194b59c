"""The episodes of a log, and its fields as a layout names them."""

import fnmatch
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxcap.errors import InputError
from jaxcap.robots.layouts import Layout, Where, known_layouts
from jaxcap.robots.readers.formats import Fields, format_of, read

_PART = re.compile(r"(?P<name>[^\[\]]+?)(?:\[(?P<inner>[^\[\]]+)\])?")


class Column:
    """A field of an episode, as the layout names it: sliced by rows, in float64, (m, k) or (m,)."""

    def __init__(self, parts: list[tuple[Any, Any]], first: int, rows: int):
        self._parts, self._first, self._rows = parts, first, rows

    def __len__(self) -> int:
        return self._rows

    def __getitem__(self, rows: slice) -> np.ndarray:
        start, stop, _ = rows.indices(self._rows)
        found = []
        for array, inner in self._parts:
            piece = np.asarray(array[self._first + start : self._first + stop], dtype=np.float64)
            piece = piece if inner is None else piece[:, inner]
            found.append(piece[:, None] if piece.ndim == 1 and len(self._parts) > 1 else piece)
        return found[0] if len(found) == 1 else np.concatenate(found, axis=1)


class Episode(NamedTuple):
    """The fields of one episode."""

    path: Path
    name: str
    fields: Fields
    first: int = 0
    """Where its rows begin in the arrays."""
    rows: int | None = None
    """How many they are; None: all."""

    @property
    def where(self) -> str:
        """For messages."""
        return f"{self.path}: {self.name}" if self.name else str(self.path)

    def has(self, where: Where | None) -> bool:
        """Whether the log has such a field."""
        if where is None:
            return False
        return all(_split(self.where, one)[0] in self.fields for one in _each(where))

    def column(self, what: str, where: Where) -> Column:
        """A field. what: its meaning, for messages. Raises InputError if it is not there or not made of numbers."""
        parts = [self._part(what, one) for one in _each(where)]
        lengths = {len(array) for array, _ in parts}
        if len(lengths) > 1:
            raise InputError(f"{self.where}: {what} {where!r} has fields of {min(lengths)} and {max(lengths)} rows")
        return Column(parts, self.first, lengths.pop() - self.first if self.rows is None else self.rows)

    def number(self, what: str, given: float | str) -> float:
        """A number, or the field that holds it."""
        value = given
        if isinstance(given, str):
            if given not in self.fields:
                raise InputError(f"{self.where}: {what}: no field {given!r} (fields: {_listed(self.fields)})")
            value = self.fields[given]
        try:
            number = float(np.asarray(value, dtype=np.float64).reshape(-1)[0])
        except (TypeError, ValueError, IndexError):
            number = float("nan")
        if not (np.isfinite(number) and number > 0):
            raise InputError(f"{self.where}: {what} = {value!r} (expected a positive number)")
        return number

    def texts(self, what: str, where: Where) -> tuple[str, ...]:
        """A list of names, or the field that holds one."""
        if not isinstance(where, str):
            return tuple(map(str, where))
        value = self.fields.get(where)
        if not isinstance(value, tuple):
            raise InputError(f"{self.where}: {what}: no field {where!r} that holds names (fields: {_listed(self.fields)})")
        return value

    def _part(self, what: str, one: str) -> tuple[Any, Any]:
        """Array and index of one field."""
        name, inner = _split(self.where, one)
        array = self.fields.get(name)
        if array is None:
            raise InputError(f"{self.where}: {what}: no field {name!r} (fields: {_listed(self.fields)})")
        if not hasattr(array, "shape") or not hasattr(array, "dtype") or array.dtype.kind not in "iufb" or not array.shape:
            raise InputError(f"{self.where}: {what}: {name!r} is {_kind(array)} (expected an array of numbers)")
        if inner is None:
            return array, None
        if len(array.shape) < 2:
            raise InputError(f"{self.where}: {what}: {one!r}: {name!r} has shape {array.shape} (expected a second axis)")
        return array, self._inner(what, name, inner, array.shape[1])

    def _inner(self, what: str, name: str, inner: str, width: int) -> Any:
        """The index of the second axis."""
        if ":" in inner:
            low, high = (int(text) if text.strip() else None for text in inner.split(":"))
            if max(abs(low or 0), abs(high or 0)) > width:
                raise InputError(f"{self.where}: {what}: {name!r} has {width} columns (expected {inner})")
            return slice(low, high)
        wanted = [text.strip() for text in inner.split(",")]
        if len(wanted) == 1 and wanted[0].lstrip("-").isdigit():
            if not -width <= int(wanted[0]) < width:
                raise InputError(f"{self.where}: {what}: {name!r} has {width} entries (expected one of number {inner})")
            return int(wanted[0])
        names = self.fields.get(f"{name} names", ())
        missing = next((one for one in wanted if one not in names), None)
        if missing is not None:
            raise InputError(
                f"{self.where}: {what}: {name!r} has no column {missing!r} (columns: {', '.join(names) or 'no names'})"
            )
        return [names.index(one) for one in wanted]


def _each(where: Where) -> tuple[str, ...]:
    return (where,) if isinstance(where, str) else where


def _split(place: str, one: str) -> tuple[str, str | None]:
    """Name and index of a field."""
    found = _PART.fullmatch(str(one).strip())
    if not found:
        raise InputError(f"{place}: {one!r} (expected a field, as name, name[0:3], name[2] or name[x, y])")
    return found["name"], found["inner"]


def _kind(value: Any) -> str:
    return f"{value.dtype} of shape {value.shape}" if hasattr(value, "dtype") else f"a {type(value).__name__}"


def _listed(fields: Mapping[str, Any]) -> str:
    """Names of fields, not too many."""
    names = [name for name in fields if not name.endswith(" names")]
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "") if names else "none"


def recognised(path: Path) -> Layout:
    """The one layout that fits a log by its fields.

    Raises:
        InputError: If none does, or several do: it has to be said which.
    """
    kind = format_of(path)
    fitting: list[Layout] = []
    seen: Fields = {}
    damaged: InputError | None = None
    for header in (True, False) if kind == "csv" else (True,):
        layouts = [layout for layout in known_layouts().values() if layout.format == kind and layout.header == header]
        _, fields = next(read(path, kind, header))
        if isinstance(fields, InputError):
            damaged = fields
            continue
        fitting += [layout for layout in layouts if _fits(layout, fields)]
        seen = seen or dict.fromkeys(fields)
    if damaged is not None and not seen:
        raise damaged
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        words = "; ".join(f"{layout.name}: {layout.about}" for layout in fitting)
        raise InputError(f"{path}: fits more than one layout, say which with --layout ({words})")
    raise InputError(f"{path}: no known layout fits its fields ({_listed(seen)}); say what they are with --layout FILE.yaml")


def _fits(layout: Layout, fields: Fields) -> bool:
    """Whether the fields of a file are those by which a layout is recognised."""
    if layout.columns is not None:
        table = fields.get("table")
        return table is not None and table.shape[1] == layout.columns
    groups = _groups(layout, fields) if _grouped(layout) else {"": fields}
    one = next(iter(groups.values()), {})
    said = {name.rpartition("@")[2]: value for name, value in fields.items() if "@" in name}
    wanted = layout.attributes or {}
    return (
        bool(layout.has)
        and all(name in one for name in layout.has)
        and all(said.get(name) in values for name, values in wanted.items())
    )


def _grouped(layout: Layout) -> bool:
    """Whether its episodes are groups of fields."""
    return layout.episodes is not None and "*" in layout.episodes


def _groups(layout: Layout, fields: Fields) -> dict[str, Fields]:
    """The fields of each group that is an episode, by its name; in the order of their numbers, if they have some."""
    pattern = str(layout.episodes)
    depth = pattern.count("/") + 1
    groups: dict[str, Fields] = {}
    for name, value in fields.items():
        parts = name.split("/")
        group = "/".join(parts[:depth])
        if len(parts) > depth and fnmatch.fnmatchcase(group, pattern):
            groups.setdefault(group, {})["/".join(parts[depth:])] = value
    number = lambda name: [int(text) if text.isdigit() else text for text in re.split(r"(\d+)", name)]
    return {name: groups[name] for name in sorted(groups, key=number)}


def episodes(path: Path, layout: Layout) -> Iterator[Episode | InputError]:
    """The episodes of a log, in the order of the file; in place of a file that cannot be used the error.

    Raises:
        InputError: For a log of another format.
    """
    kind = format_of(path)
    if kind != layout.format:
        raise InputError(f"{path}: is {kind}, but layout {layout.name!r} is for {layout.format}")
    for file, fields in read(path, kind, layout.header):
        if isinstance(fields, InputError):
            yield fields
            continue
        try:
            yield from _of_file(file, layout, fields)
        except InputError as error:
            yield error


def _of_file(file: Path, layout: Layout, fields: Fields) -> Iterator[Episode]:
    """The episodes of one file."""
    if layout.episodes is None:
        yield Episode(file, "", fields)
    elif not _grouped(layout):
        yield from _runs(file, layout.episodes, fields)
    else:
        groups = _groups(layout, fields)
        if not groups:
            raise InputError(f"{file}: no episodes {layout.episodes!r} (fields: {_listed(fields)})")
        yield from (Episode(file, name, inner) for name, inner in groups.items())


def _runs(file: Path, numbers: str, fields: Fields) -> Iterator[Episode]:
    """Episodes that a column numbers: rows that follow each other with the same number."""
    if numbers not in fields:
        raise InputError(f"{file}: no column {numbers!r} that numbers episodes (fields: {_listed(fields)})")
    column = np.asarray(fields[numbers]).reshape(len(fields[numbers]), -1)[:, 0]
    starts = np.r_[0, np.flatnonzero(np.diff(column)) + 1][: len(column)]
    for start, end in zip(starts, np.r_[starts[1:], len(column)], strict=True):
        yield Episode(file, f"{column[start]:.0f}", fields, int(start), int(end - start))
