"""NPZ state files, read and written in pieces: memory does not grow with the file, and nothing is ever unpickled."""

import math
import tempfile
import zipfile
from collections.abc import Generator, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import IO, Any, BinaryIO, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.lib import format as npy

from jaxcap.errors import InputError
from jaxcap.files.bad_rows import BadRows
from jaxcap.files.columns import METADATA, SPECIFIC, VECTORS, StateBatch, refuse_clashes, to_json
from jaxcap.files.contact_columns import (
    CHOICE,
    MASK,
    RowChoices,
    RowContacts,
    agree,
    chosen,
    contact_columns,
    from_arrays,
    size_by_shape,
)
from jaxcap.files.state_file import StateFile

PIECE = 1 << 24
"""Bytes that are copied or converted at a time."""


class Member(NamedTuple):
    """One array of the archive, by its header."""

    name: str
    dtype: np.dtype
    shape: tuple[int, ...]
    fortran: bool
    start: int
    """Length of the header [bytes]."""

    @property
    def row(self) -> tuple[int, ...]:
        """Shape of one row."""
        return self.shape[1:]

    @property
    def width(self) -> int:
        """Length of one row [bytes]."""
        return math.prod(self.row) * self.dtype.itemsize


class NpzStates(StateFile):
    """An open NPZ file of states."""

    def _opened(self) -> zipfile.ZipFile:
        with readable(self.path):
            return zipfile.ZipFile(self.path)

    def _open(self) -> None:
        with readable(self.path):
            members = {
                name.removesuffix(".npy"): _header(self._file, name)
                for name in self._file.namelist()
                if name.endswith(".npy")
            }
        for member in members.values():
            if member.dtype.hasobject:
                raise InputError(f"{self.path}: {member.name!r} holds pickled objects, which are never unpickled")
        self._vectors = self._spelt(list(members))
        required = [name for names in self._vectors.values() for name in names]
        for name, row in ((name, (3,) if len(names) == 1 else ()) for names in self._vectors.values() for name in names):
            self._check(members[name], row)
        self.rows = members[required[0]].shape[0]
        self.contacts = contact_columns(self.path, members)
        self._check_contacts(members)
        for name in (*required[1:], *self.contacts):
            n = members[name].shape[0]
            if n != self.rows:
                raise InputError(f"{self.path}: {name!r} has {n} rows (expected {self.rows}, as {required[0]!r} has)")
        self._members = {name: m for name, m in members.items() if m.shape[:1] == (self.rows,) and m.width}
        self.skipped = [name for name in members if name not in self._members]
        refuse_clashes(self.path, self._members)
        for name, member in self._members.items():
            if member.dtype.kind not in "biufcSUmM":
                raise InputError(f"{self.path}: {name!r} has dtype {member.dtype} (expected numbers, strings or times)")
        self.types = {name: np.dtype((m.dtype, m.row)) for name, m in self._members.items()}

    def _check(self, member: Member, row: tuple[int, ...]) -> None:
        if len(member.shape) != 1 + len(row) or member.row != row:
            expected = "(n, 3)" if row else "(n,)"
            raise InputError(f"{self.path}: {member.name!r} has shape {member.shape} (expected {expected})")
        if member.dtype.kind not in "iuf":
            raise InputError(f"{self.path}: {member.name!r} has dtype {member.dtype} (expected floats or integers)")

    def _check_contacts(self, members: Mapping[str, Member]) -> None:
        counts = {}
        for name in self.contacts:
            member, where = members[name], f"{self.path}: {name!r}"
            kinds, expected = ("iuU", "integers or names") if name == CHOICE else ("iuf", "floats or integers")
            kinds, expected = ("b", "booleans") if name == MASK else (kinds, expected)
            if member.dtype.kind not in kinds:
                raise InputError(f"{where} has dtype {member.dtype} (expected {expected})")
            if not member.shape or (name == CHOICE and member.row):
                raise InputError(f"{where} has shape {member.shape} (expected {'(n,)' if name == CHOICE else 'n rows'})")
            if name != CHOICE:
                counts[name] = size_by_shape(where, name, member.row)
        agree(self.path, counts)
        self._empty = {name: members[name] for name in self.contacts if not members[name].width}

    def __iter__(self) -> Iterator[StateBatch]:
        with ExitStack() as stack, readable(self.path):
            streams = [stack.enter_context(closing(self._stream(m))) for m in self._members.values()]
            for pieces in zip(*streams, strict=True):
                columns = dict(zip(self._members, pieces, strict=True))
                bad = BadRows(len(pieces[0]))
                vectors = {vector: self._vector(columns, names) for vector, names in self._vectors.items()}
                for vector, names in self._vectors.items():
                    bad.add_not_finite(names, vectors[vector])
                yield self._batch(vectors, columns, bad, self._row_contacts(columns))

    def _row_contacts(self, columns: Mapping[str, np.ndarray]) -> RowContacts | RowChoices | None:
        if not self.contacts:
            return None
        n = len(next(iter(columns.values())))
        if self.contacts == (CHOICE,):
            return chosen(columns[CHOICE])
        empty = {name: np.empty((n, *member.row), member.dtype) for name, member in self._empty.items()}
        return from_arrays({name: columns[name] if name in columns else empty[name] for name in self.contacts}, self.dtype)

    def _vector(self, columns: Mapping[str, np.ndarray], names: tuple[str, ...]) -> Float[np.ndarray, "n 3"]:
        with np.errstate(over="ignore"):  # too large for float32: infinite, hence status nonfinite
            parts = [columns[name].astype(self.dtype) for name in names]
        return parts[0] if len(parts) == 1 else np.stack(parts, axis=1)

    def _stream(self, member: Member) -> Generator[np.ndarray, None, None]:
        """Rows of one array, `batch_size` at a time. An array in Fortran order is read at several places at once."""
        places = math.prod(member.row) if member.fortran else 1
        width = member.width // places
        with ExitStack() as stack:
            files = [stack.enter_context(self._file.open(f"{member.name}.npy")) for _ in range(places)]
            for place, file in enumerate(files):
                file.seek(member.start + place * self.rows * width)
            for first in range(0, self.rows, self.batch_size):
                n = min(self.batch_size, self.rows - first)
                pieces = [np.frombuffer(_read(file, n * width), member.dtype) for file in files]
                if member.fortran:
                    yield np.stack(pieces).reshape(*reversed(member.row), n).T
                else:
                    yield pieces[0].reshape(n, *member.row)
            files[-1].read(1)  # reaching the end makes zipfile compare the checksum


class NpzWriter:
    """Writes an NPZ file row by row. An NPZ holds column after column, so each column waits in an unnamed file.

    Args:
        handle: The file, empty.
        directory: Place for the unnamed files.
        types: NumPy type, or Arrow field, of each column.
        metadata: See `columns.describe`.

    Raises:
        InputError: Here or in `write`, if a column does not fit into an NPZ.
    """

    def __init__(self, handle: BinaryIO, directory: Path, types: Mapping[str, Any], metadata: Mapping[str, Any]):
        refuse_clashes("input", types, (METADATA,))
        self._handle, self._metadata = handle, metadata
        kinds = {name: kind if isinstance(kind, np.dtype) else _from_arrow(kind) for name, kind in types.items()}
        self._spools = {}
        with ExitStack() as stack:
            for name, kind in kinds.items():
                file = stack.enter_context(tempfile.TemporaryFile(dir=directory))
                self._spools[name] = Spool(file, kind)
            self._files = stack.pop_all()

    def write(self, columns: Mapping[str, Any]) -> None:
        """Appends rows. columns: one array for each of `types`, all with the same number of rows."""
        for name, spool in self._spools.items():
            column = columns[name]
            spool.append(column if isinstance(column, np.ndarray) else _to_numpy(name, column))

    def finish(self) -> None:
        """Assembles the archive. The caller flushes and closes the handle."""
        with zipfile.ZipFile(self._handle, "w") as archive:
            with _member(archive, METADATA) as target:
                npy.write_array(target, np.array(to_json(self._metadata)), allow_pickle=False)
            for name, spool in self._spools.items():
                with _member(archive, name) as target:
                    spool.copy_to(target)
                spool.file.close()  # gives its disk space back before the next one is copied

    def discard(self) -> None:
        """Removes the unnamed files."""
        self._files.close()


class Spool:
    """One column on its way into the archive: raw rows in a file, and how wide they are."""

    def __init__(self, file: IO[bytes], kind: np.dtype):
        self.file = file
        self._dtype, self._row = kind.base, kind.shape
        self._runs: list[tuple[int, np.dtype]] = []  # rows, dtype: strings may get longer from batch to batch

    def append(self, rows: np.ndarray) -> None:
        """Adds rows at the end."""
        self.file.write(np.ascontiguousarray(rows).reshape(-1).view(np.uint8).data)
        if self._runs and self._runs[-1][1] == rows.dtype:
            self._runs[-1] = (self._runs[-1][0] + len(rows), rows.dtype)
        else:
            self._runs.append((len(rows), rows.dtype))

    def copy_to(self, target: IO[bytes]) -> None:
        """Writes the column in NPY format, in the widest dtype that occurred."""
        dtype = np.result_type(*(run for _, run in self._runs)) if self._runs else self._dtype
        rows = sum(n for n, _ in self._runs)
        header = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": (rows, *self._row)}
        npy.write_array_header_1_0(target, header)
        self.file.seek(0)
        for n, run in self._runs:
            entries = n * math.prod(self._row)
            step = max(1, PIECE // max(1, dtype.itemsize))
            for first in range(0, entries, step):
                data = self.file.read(min(step, entries - first) * run.itemsize)
                target.write(np.frombuffer(data, run).astype(dtype).tobytes())


def _header(archive: zipfile.ZipFile, name: str) -> Member:
    """Reads the NPY header of a member, and holds it against the size that the archive states."""
    with archive.open(name) as file:
        version = npy.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"{name}: NPY version {version} (expected (1, 0) or (2, 0))")
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran, dtype = read(file)
        start = file.tell()
    member = Member(name.removesuffix(".npy"), dtype, shape, fortran and len(shape) > 1, start)
    size = start + dtype.itemsize * math.prod(shape)
    if not dtype.hasobject and archive.getinfo(name).file_size != size:
        raise ValueError(f"{name} holds {archive.getinfo(name).file_size} bytes, its header says {size}")
    return member


def _read(file: IO[bytes], size: int) -> bytes:
    data = file.read(size)
    if len(data) < size:
        raise EOFError("it ends too early")
    return data


@contextmanager
def readable(what: Path | str, kind: str = "NPZ") -> Iterator[None]:
    """Turns what a damaged file of NumPy's raises into InputError."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:  # NumPy's and zipfile's parsers raise whatever their tools do: tokenize, struct, zlib, ast
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise InputError(f"{what}: cannot be read as {kind}: {str(reason) or type(error).__name__}") from error


def _member(archive: zipfile.ZipFile, name: str) -> IO[bytes]:
    return archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True)


def _from_arrow(field: Any) -> np.dtype:
    """The NumPy type of an Arrow column. A vector has three entries, whatever its type says of lengths."""
    from jaxcap.files.arrow_columns import is_ragged, numpy_type, vector_type

    if field.name in (*VECTORS, SPECIFIC) and is_ragged(field.type):
        return np.dtype((vector_type(field.type), (3,)))
    return numpy_type(field.type, f"column {field.name!r}")


def _to_numpy(name: str, column: Any) -> np.ndarray:
    """An Arrow column as an array of that type."""
    from jaxcap.files.arrow_columns import is_ragged, to_numpy, vector_type, vectors

    if name in (*VECTORS, SPECIFIC) and is_ragged(column.type):
        return vectors(column, vector_type(column.type))
    return to_numpy(column, f"column {name!r}")
