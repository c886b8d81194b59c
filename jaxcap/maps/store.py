"""A Zarr map that grows region by region. Importing this module needs zarr and xarray (extra `maps`).

PATH.partial holds the map while it grows, the settings that it belongs to, and a journal: the number of each region that
has been written, a line each, added when all its chunks are there. A run that is killed at any moment leaves at most chunks
of which the journal does not know; they are written again. The last step is to rename the map.

Regions may be written by other processes, while this one keeps the journal. Or each part of them by a process with a
journal of its own: then whoever ends last renames the map.
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

from jaxcap.engine.shards import WHOLE, Shard
from jaxcap.errors import InputError
from jaxcap.files.settings import differences
from jaxcap.files.whole_file import refuse_late_comer, temporary_beside, whole_folder, write_errors_of

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
        self.record(number)

    def record(self, number: int) -> None:
        """Notes that a region has been written, here or by `write_chunks`."""
        self._journal.write(b"%d\n" % number)
        self._journal.flush()
        self.done.add(number)


def _journal_of(shard: Shard) -> str:
    """Name of the journal of a part of the map, grown by a command of its own."""
    return JOURNAL if shard.of == 1 else f"{JOURNAL}.{shard.number}-{shard.of}"


@contextmanager
def growing_map(
    path: Path,
    coordinates: xr.Dataset,
    variables: Mapping[str, Variable],
    settings: Mapping[str, Any],
    *,
    regions: int,
    force: bool,
    shard: Shard = WHOLE,
) -> Iterator[GrowingMap]:
    """The map at `path`, in a `with` block; when that ends without an error and all is there, it takes its name.

    Args:
        path: Where the map goes.
        coordinates: Its axes and attributes.
        variables: Its quantities by name.
        settings: What the map depends on, for JSON. If there is a partial map with the same settings, it is continued.
        regions: How many there are.
        force: Replace a map that is there, at the end.
        shard: The part that is grown here, while other processes grow the others.

    Raises:
        InputError: For a partial map with other settings, one that another process is writing, and for an error of the
            file system, a full disk for one. Then, and for any other exception, the partial map can be continued.
    """
    partial = partial_path(path)
    settings = json.loads(json.dumps(settings))
    with write_errors_of(path):
        if not partial.exists():
            _begin(partial, settings, coordinates, variables)
        with _claimed(partial, settings, shard), _journal(partial, coordinates, variables, shard) as journal:
            arrays = dict(zarr.open_group(partial / MAP, mode="r+").arrays())
            yield GrowingMap({name: arrays[name] for name in variables}, journal, recorded(path))
        if len(recorded(path)) == regions:
            # Of parts that end at a time, each has given up its claim before it looks: one finds all there, and no other
            with _last(partial, shard) as publish:
                if publish:
                    _sweep(partial)
                    _publish(partial / MAP, path, force)
                    shutil.rmtree(partial)


def settings_in(path: Path) -> dict[str, Any]:
    """The settings of the unfinished map at `path`."""
    return json.loads((partial_path(path) / SETTINGS).read_text())


def write_chunks(path: Path, places: Mapping[str, tuple[slice, ...]], values: Mapping[str, np.ndarray]) -> None:
    """Writes a region of the unfinished map at `path`, for the process that keeps its journal."""
    with write_errors_of(path):
        arrays = dict(zarr.open_group(partial_path(path) / MAP, mode="r+").arrays())
        for name, value in values.items():
            arrays[name][places[name] or ...] = value


def partial_path(path: Path) -> Path:
    """Where the map is until it is complete."""
    return path.with_name(path.name + ".partial")


def recorded(path: Path) -> set[int]:
    """Numbers of the regions of the map at `path` that an unfinished run has written."""
    partial, found = partial_path(path), set[int]()
    for journal in partial.glob(f"{JOURNAL}*") if (partial / MAP).exists() else ():
        whole, _, _ = journal.read_bytes().rpartition(b"\n")  # a line without an end is not to be trusted
        found |= set(map(int, whole.split()))
    return found


def _begin(partial: Path, settings: Mapping[str, Any], coordinates: xr.Dataset, variables: Mapping[str, Variable]) -> None:
    """Makes the directory, with all that it needs in it from the first moment on; of processes that do so at a time, one
    does.
    """
    with whole_folder(partial) as folder:
        (folder / SETTINGS).write_text(json.dumps(settings))
        _make(folder / MAP, coordinates, variables)
        (folder / JOURNAL).touch()


@contextmanager
def _claimed(partial: Path, settings: Mapping[str, Any], shard: Shard) -> Iterator[None]:
    """Raises InputError unless the directory belongs to this map, and this part of it to no other process."""
    try:
        found = json.loads((partial / SETTINGS).read_text())
    except (OSError, ValueError):
        raise InputError(f"{partial}: is in the way: not an unfinished map (move it elsewhere)") from None
    for name in differences(settings, found)[:1]:
        raise InputError(
            f"{partial}: an unfinished map with other {name} (finish it with the same settings, or remove the directory)"
        )
    with open(partial / SETTINGS, "rb") as handle:
        if not _locked(handle, shared=shard.of > 1):
            raise InputError(f"{partial}: another process is writing it")
        yield


@contextmanager
def _last(partial: Path, shard: Shard) -> Iterator[bool]:
    """Whether this process is the one that ends the map: no other is writing it."""
    try:
        handle = open(partial / SETTINGS, "rb")  # noqa: SIM115
    except FileNotFoundError:
        if shard.of == 1:
            raise
        yield False  # it has been ended
        return
    with handle:
        yield _locked(handle, shared=False)


def _locked(handle: BinaryIO, *, shared: bool) -> bool:
    """Whether the lock is ours until the file is closed; where the system has no such locks, the user has to take care."""
    with suppress(ImportError):
        import fcntl

        try:
            fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


@contextmanager
def _journal(partial: Path, coordinates: xr.Dataset, variables: Mapping[str, Variable], shard: Shard) -> Iterator[BinaryIO]:
    """The journal, open for more lines; beside it the map, which is made if it is not there."""
    journal = partial / _journal_of(shard)
    if shard.of == 1:
        if not (partial / MAP).exists():
            for old in partial.glob(f"{JOURNAL}*"):
                old.unlink()
        if not journal.exists():
            _make(partial / MAP, coordinates, variables)
        _sweep(partial)
    journal.touch()
    with open(journal, "r+b") as handle:
        if not _locked(handle, shared=False):
            raise InputError(f"{journal}: another process is writing it")
        handle.truncate(handle.read().rfind(b"\n") + 1)
        handle.seek(0, os.SEEK_END)
        yield handle


def _sweep(partial: Path) -> None:
    """Removes what a run that was killed has left of chunks."""
    for stray in (partial / MAP).rglob("*.partial"):
        stray.unlink()


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
