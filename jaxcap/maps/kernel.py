"""Kernel maps: capturability over grids of states, as labelled arrays in memory, Zarr or netCDF. Needs the extra `maps`.

Along every direction the capturable speeds are one interval, `min_speed` to `max_speed`: a map of the two over positions and
directions is the whole kernel, of five or six dimensions, not a scatter of verdicts. What the files hold is plain xarray:
`xr.open_dataset` reads them without anything of ours.
"""

import math
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from jaxcap.contacts.conventions import GRAVITY, ArrayLike
from jaxcap.errors import InputError, needs_extra
from jaxcap.files.whole_file import check_output, whole_file
from jaxcap.maps.asked import About, Asked, bar, checked, prepared
from jaxcap.maps.blocks import Answers, regions
from jaxcap.maps.contact_axes import Mapped
from jaxcap.maps.region_work import Elsewhere, RegionWork

with needs_extra("maps", "jaxcap.maps"):
    import xarray as xr

    from jaxcap.maps.store import (
        GrowingMap,
        growing_map,
        recorded,
    )

EXTENSIONS = (".zarr", ".nc")


def kernel_map(
    cone: Mapped,
    axes: Mapping[str, Any],
    quantities: Sequence[str] | None = None,
    *,
    gravity: ArrayLike = GRAVITY,
    sides: int = 4,
    dtype: DTypeLike | None = None,
    progress: bool = False,
) -> xr.Dataset:
    """Capturability at all combinations of the axes' values, in memory.

    An axis is a number, a list or array of different numbers, or text as on the command line: "0.8", "-0.4:0.4:201" (first,
    last, number of values), "0.7,0.8,0.9", angles also as "0:360deg:72". A range of headings over a full circle leaves its
    end out, which is its beginning; lists and arrays are taken as they are. Where `cone` is contacts there may also be axes
    that change them: contact_set; friction, of all contacts; slope [rad], by which all contacts are turned about their
    centroid, the CoM staying where it is, so that the ground goes down towards downhill [rad, 0 if left out].

    Args:
        cone: Contacts, which are projected to faces, or a cone of one contact set from `centroidal_cone` or `cone_rays`, or
            of one posture from `actuated_cone`, or from `actuated` with rays.
            Contacts may be several sets, perhaps with names: then the map has an axis contact_set, of their numbers.
        axes: com_x, com_y, com_z [m]; and either heading, pitch [rad] and speed [m/s], or velocity_x, velocity_y,
            velocity_z [m/s]. heading counts from x towards y, pitch from the horizontal upwards; pitch and velocity_z may be
            left out, and are 0. With a speed perhaps also specific_angular_momentum_x, _y, _z [m^2/s], the robot's angular
            momentum about its CoM over its mass, 0 where left out; see `jaxcap.capturability`.
        quantities: Fields of `Capturability`; effort of a posture only. By default capturable, margin and case; without
            velocity_* and speed, min_speed and max_speed, which do not need one.
        gravity: (3,) [m/s^2].
        sides: Edges of the friction pyramids, for contacts.
        dtype: Of the computation and the figures; by default that of the arrays among the axes, or else float64, as far as
            JAX's x64 switch allows.
        progress: Show a bar on stderr, if that is a terminal.

    Returns:
        A Dataset with the axes with more than one value, or a list of one, as dimensions in the order given, the others as
        coordinates without dimension, and a variable for each quantity; min_speed and max_speed have no dimension `speed`,
        unless there is angular momentum, and effort has the dimensions of positions alone. At speed zero the answers are
        those of a robot that stands still, see `Status.NO_DIRECTION`. Everything has units; `case` and `status` are int8
        with flag_values and flag_meanings, and contact_set has them too if the sets have names. The attributes hold
        contacts, those given, as the text of a contacts file, sides (both only where contacts were given), gravity, dtype,
        conventions and version.

    Raises:
        InputError: Naming the axis, quantity or option that cannot be used, before anything is computed.
    """
    answers, about = prepared(cone, checked(cone, axes, quantities, dtype), gravity, sides, progress)
    return _in_memory(answers, about, progress)


def write_map(
    path: str | Path,
    cone: Mapped,
    axes: Mapping[str, Any],
    quantities: Sequence[str] | None = None,
    *,
    gravity: ArrayLike = GRAVITY,
    sides: int = 4,
    dtype: DTypeLike | None = None,
    progress: bool = False,
    force: bool = False,
    elsewhere: Elsewhere | None = None,
    said: Mapping[str, str] | None = None,
) -> int:
    """`kernel_map` into a file: Zarr (.zarr), region by region and larger than memory if need be, or netCDF (.nc).

    A Zarr map grows in the directory PATH.partial and takes its name when it is complete; when the same call finds that
    directory, it goes on where the other ended, however that was. The bytes are the same in the end. A netCDF map has to fit
    into memory, and is written whole or not at all.

    In Zarr `capturable` is int8, 0 or 1: a piece whose file is lost reads as -1 there and in case and status, as NaN in
    figures.

    Args:
        path: Map to write.
        cone: As in `kernel_map`, and so are the arguments that follow.
        axes: Values by name; text, numbers or arrays.
        quantities: Fields of `Capturability`.
        gravity: (3,) [m/s^2].
        sides: Edges of the friction pyramids, for contacts.
        dtype: Of the computation and the figures.
        progress: Show a bar on stderr, if that is a terminal.
        force: Replace a file that is there.
        elsewhere: What computes the regions of a Zarr map, if not this process, or which of them; the bytes are the same.
        said: What else the map says of itself, as attributes.

    Returns:
        How many states were computed; without a speed, lines of travel.

    Raises:
        InputError: Before anything is computed, as in `kernel_map`; also for a file that is there, a disk that is too small,
            or a PATH.partial that holds another map.
    """
    path = Path(path)
    _check_path(path, force)
    asked = checked(cone, axes, quantities, dtype)
    if path.suffix.lower() == ".nc":
        return _written_whole(path, cone, asked, gravity, sides, progress, force, elsewhere, said)
    _check_disk(path, asked.bytes * (1 - len(recorded(path)) / len(regions(asked.grid))))
    other = elsewhere or Elsewhere()
    answers, about = prepared(cone, asked, gravity, sides, progress, other.backend, said)
    growing: dict[str, Any] = {"regions": len(answers.regions), "force": force, "shard": other.shard}
    with growing_map(path, about.coordinates, about.variables, about.settings, **growing) as store:
        ours = other.shard.part(list(range(len(answers.regions))))
        todo = [number for number in ours if number not in store.done]
        total, computed = (sum(answers.states(answers.regions.region(number)) for number in some) for some in (ours, todo))
        work = RegionWork(
            path.absolute(), cone, dict(axes), asked.quantities, gravity, sides, asked.dtype.name, about.settings, said
        )
        with bar("states", total, total - computed, progress) as shown:
            for number in _grown(answers, store, todo) if other.run is None else other.run(work, todo):
                if other.run is not None:
                    store.record(number)
                shown.update(answers.states(answers.regions.region(number)))
    return computed


def _grown(answers: Answers, store: GrowingMap, todo: list[int]) -> Iterator[int]:
    """Computes regions in this process, and writes them."""
    for region, values in answers.over(todo):
        store.write(region.number, {name: answers.place(region, name) for name in values}, values)
        yield region.number


def _written_whole(
    path: Path,
    cone: Mapped,
    asked: Asked,
    gravity: ArrayLike,
    sides: int,
    progress: bool,
    force: bool,
    elsewhere: Elsewhere | None,
    said: Mapping[str, str] | None,
) -> int:
    """A netCDF map."""
    if elsewhere is not None:
        raise InputError(f"{path}: a netCDF map is computed in one process (expected .zarr, or no other place)")
    with needs_extra("maps", "writing netCDF"):
        import h5netcdf  # noqa: F401
        import h5py  # noqa: F401
    _check_disk(path, asked.bytes)
    answers, about = prepared(cone, asked, gravity, sides, progress, said=said)
    dataset = _in_memory(answers, about, progress)
    with whole_file(path, force=force) as handle:
        dataset.to_netcdf(handle.name, engine="h5netcdf")
    return asked.grid.size


def _in_memory(answers: Answers, about: About, progress: bool) -> xr.Dataset:
    needed = sum(variable.bytes for variable in about.variables.values())
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else math.inf
    if needed > memory:
        raise InputError(f"the map has {needed / 1e9:.3g} GB, and memory {memory / 1e9:.3g} GB (write it to Zarr instead)")
    arrays = {name: np.empty(variable.shape, variable.dtype) for name, variable in about.variables.items()}
    with bar("states", answers.grid.size, 0, progress) as shown:
        for region, values in answers.over(range(len(answers.regions))):
            for name, value in values.items():
                arrays[name][answers.place(region, name)] = value
            shown.update(answers.states(region))
    return about.coordinates.assign(
        {name: (variable.dims, arrays[name], variable.attributes) for name, variable in about.variables.items()}
    )


def _check_path(path: Path, force: bool) -> None:
    """Raises InputError if the map cannot be written there."""
    if path.suffix.lower() == ".zarr":
        is_group = lambda path: (path / "zarr.json").is_file() or (path / ".zgroup").is_file()
        check_output(path, force=force, extensions=EXTENSIONS, is_ours=is_group, kind="Zarr group")
    else:
        check_output(path, force=force, extensions=EXTENSIONS)


def _check_disk(path: Path, size: float) -> None:
    free = shutil.disk_usage(path.parent).free
    if size > free:
        raise InputError(f"{path}: the map may take {size / 1e9:.3g} GB, and the disk has {free / 1e9:.3g} GB left")
