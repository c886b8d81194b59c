"""A Zarr map that grows region by region. Importing this module needs zarr and xarray (extra `maps`).

PATH.partial holds the map while it grows, the settings that it belongs to, and a journal: the number of each region that
has been written, a line each, added when all its chunks are there. A run that is killed at any moment leaves at most chunks
of which the journal does not know; they are written again. The last step is to rename the map.
"""

import json
import math
import os
import shutil
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import xarray as xr
import zarr
from zarr.codecs import BloscCodec

from jaxcap.errors import InputError
from jaxcap.files.whole_file import refuse_late_comer, temporary_beside, write_errors_of

MAP, SETTINGS, JOURNAL = "map.zarr", "settings.json", "journal"
ABSENT = -1
"""What codes are where a chunk is lost; `Case.UNDECIDED`, and no `Status`."""


class Variable(NamedTuple):
    """A quantity of the map."""

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    """A chunk is what a region has of the quantity."""
    dtype: np.dtype
    attributes: dict[str, Any]

    @property
    def bytes(self) -> int:
        """Without compression."""
        return math.prod(self.shape) * self.dtype.itemsize


class GrowingMap:
    """Takes the regions of a map, in any order; see `growing_map`."""

    def __init__(self, arrays: Mapping[str, zarr.Array], journal: BinaryIO, done: set[int]):
        self._arrays, self._journal = arrays, journal
        self.done = done
        """Numbers of the regions that have been written."""

    def write(self, number: int, places: Mapping[str, tuple[slice, ...]], values: Mapping[str, np.ndarray]) -> None:
        """Writes a region: of every quantity its place, whole chunks, and its values."""
        for name, value in values.items():
            self._arrays[name][places[name] or ...] = value
        self._journal.write(b"%d\n" % number)
        self._journal.flush()
        self.done.add(number)


@contextmanager
def growing_map(
    path: Path, coordinates: xr.Dataset, variables: Mapping[str, Variable], settings: Mapping[str, Any], *, force: bool
) -> Iterator[GrowingMap]:
    """The map at `path`, in a `with` block; it takes its name when the block ends without an error.

    Args:
        path: Where the map goes.
        coordinates: Its axes and attributes.
        variables: Its quantities by name.
        settings: What the map depends on, for JSON. If there is a partial map with the same settings, it is continued.
        force: Replace a map that is there, at the end.

    Raises:
        InputError: For a partial map with other settings, one that another process is writing, and for an error of the
            file system, a full disk for one. Then, and for any other exception, the partial map can be continued.
    """
    partial = partial_path(path)
    settings = json.loads(json.dumps(settings))
    with write_errors_of(path):
        if not partial.exists():
            _begin(partial, settings)
        with _claimed(partial, settings), _journal(partial, coordinates, variables) as journal:
            arrays = dict(zarr.open_group(partial / MAP, mode="r+").arrays())
            yield GrowingMap({name: arrays[name] for name in variables}, journal, recorded(path))
        _publish(partial / MAP, path, force)
        shutil.rmtree(partial)


def partial_path(path: Path) -> Path:
    """Where the map is until it is complete."""
    return path.with_name(path.name + ".partial")


def recorded(path: Path) -> set[int]:
    """Numbers of the regions of the map at `path` that an unfinished run has written."""
    partial = partial_path(path)
    if not (partial / MAP).exists() or not (partial / JOURNAL).exists():
        return set()
    whole, _, _ = (partial / JOURNAL).read_bytes().rpartition(b"\n")  # a line without an end is not to be trusted
    return set(map(int, whole.split()))


def _begin(partial: Path, settings: Mapping[str, Any]) -> None:
    """Makes the directory, with the settings in it from the first moment on."""
    temporary = temporary_beside(partial)
    try:
        temporary.mkdir()
        (temporary / SETTINGS).write_text(json.dumps(settings))
        os.rename(temporary, partial)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def _claimed(partial: Path, settings: Mapping[str, Any]) -> Iterator[None]:
    """Raises InputError unless the directory belongs to this map, and to no other process."""
    try:
        found = json.loads((partial / SETTINGS).read_text())
    except (OSError, ValueError):
        raise InputError(f"{partial}: is in the way: not an unfinished map (move it elsewhere)") from None
    other = next((name for name in {**settings, **found} if settings.get(name) != found.get(name)), None)
    if other is not None:
        raise InputError(
            f"{partial}: an unfinished map with other {other} (finish it with the same settings, or remove the directory)"
        )
    with open(partial / SETTINGS, "rb") as handle:
        with suppress(ImportError):  # where the system has no such locks, the user has to take care
            import fcntl

            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f"{partial}: another process is writing it") from None
        yield


@contextmanager
def _journal(partial: Path, coordinates: xr.Dataset, variables: Mapping[str, Variable]) -> Iterator[BinaryIO]:
    """The journal, open for more lines; beside it the map, which is made if it is not there."""
    journal = partial / JOURNAL
    if not (partial / MAP).exists():
        journal.unlink(missing_ok=True)
    if not journal.exists():
        _make(partial / MAP, coordinates, variables)
        journal.touch()
    for stray in (partial / MAP).rglob("*.partial"):  # of chunks, by a run that was killed
        stray.unlink()
    with open(journal, "r+b") as handle:
        handle.truncate(handle.read().rfind(b"\n") + 1)
        handle.seek(0, os.SEEK_END)
        yield handle


def _make(path: Path, coordinates: xr.Dataset, variables: Mapping[str, Variable]) -> None:
    """The map without the values of its quantities."""
    shutil.rmtree(path, ignore_errors=True)
    coordinates.to_zarr(path, mode="w", zarr_format=3, consolidated=False)
    group = zarr.open_group(path, mode="r+")
    for name, variable in variables.items():
        kind = _stored(variable.dtype)
        group.create_array(
            name,
            shape=variable.shape,
            chunks=variable.chunks,
            dtype=kind,
            dimension_names=variable.dims,
            attributes={
                key: value.tolist() if isinstance(value, np.ndarray) else value
                for key, value in {**variable.attributes, **_of_booleans(variable.dtype)}.items()
            },
            fill_value=np.nan if kind.kind == "f" else ABSENT,
            compressors=BloscCodec(cname="zstd", clevel=1, shuffle="bitshuffle", typesize=kind.itemsize),
            config={"write_empty_chunks": False},
        )
    with warnings.catch_warnings():  # format 3 has no word for it yet; xarray warns of its absence
        warnings.filterwarnings("ignore", message="Consolidated metadata")
        zarr.consolidate_metadata(path)


def _stored(dtype: np.dtype) -> np.dtype:
    """The type in the file: where a chunk is lost, no verdict may stand, and a boolean has no third value."""
    return np.dtype(np.int8) if dtype.kind == "b" else dtype


def _of_booleans(dtype: np.dtype) -> dict[str, Any]:
    """What booleans that became codes say of themselves, in the words of the CF conventions."""
    return {"flag_values": [0, 1], "flag_meanings": "no yes"} if dtype.kind == "b" else {}


def _publish(source: Path, path: Path, force: bool) -> None:
    """Gives the map its name, in place of an old one if need be."""
    refuse_late_comer(path, force)
    old = temporary_beside(path)
    if path.exists():  # a directory, unlike a file, cannot be renamed over another
        os.rename(path, old)
    os.rename(source, path)
    shutil.rmtree(old, ignore_errors=True)
