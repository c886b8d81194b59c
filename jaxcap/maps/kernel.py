"""Kernel maps: capturability over grids of states, as labelled arrays in memory, Zarr or netCDF. Needs the extra `maps`.

Along every direction the capturable speeds are one interval, `min_speed` to `max_speed`: a map of the two over positions and
directions is the whole kernel, of five or six dimensions, not a scatter of verdicts. What the files hold is plain xarray:
`xr.open_dataset` reads them without anything of ours.
"""

import hashlib
import json
import math
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import DTypeLike

from jaxcap.contacts.cone import CentroidalCone, ConeRays, centroidal_cone
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY, ArrayLike
from jaxcap.errors import InputError, needs_extra
from jaxcap.files.fields import MAPPED, output_types
from jaxcap.files.plausibility import Plausibility, Stand
from jaxcap.files.whole_file import check_output, whole_file
from jaxcap.maps.blocks import Answers, regions
from jaxcap.maps.contact_axes import Contacts, contact_sets, given_sets, with_sets
from jaxcap.maps.grid import CARTESIAN, POSITION, Grid, grid_of
from jaxcap.one_state.decision import LIMITS
from jaxcap.version import __version__

with needs_extra("maps", "jaxcap.maps"):
    import xarray as xr
    from tqdm import tqdm

    from jaxcap.maps.labels import CONVENTIONS, as_file, attributes_of, coordinates
    from jaxcap.maps.store import (
        WHOLE,
        GrowingMap,
        Share,
        Variable,
        growing_map,
        partial_path,
        recorded,
        settings_in,
        write_chunks,
    )

EXTENSIONS = (".zarr", ".nc")


def kernel_map(
    cone: Contacts | CentroidalCone | ConeRays,
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
        cone: Contacts, which are projected to faces, or a cone of one contact set from `centroidal_cone` or `cone_rays`.
            Contacts may be several sets, perhaps with names: then the map has an axis contact_set, of their numbers.
        axes: com_x, com_y, com_z [m]; and either heading, pitch [rad] and speed [m/s], or velocity_x, velocity_y,
            velocity_z [m/s]. heading counts from x towards y, pitch from the horizontal upwards; pitch and velocity_z may be
            left out, and are 0. With a speed perhaps also specific_angular_momentum_x, _y, _z [m^2/s], the robot's angular
            momentum about its CoM over its mass, 0 where left out; see `jaxcap.capturability`.
        quantities: Fields of `Capturability`. By default capturable, margin and case; without velocity_* and speed,
            min_speed and max_speed, which do not need one.
        gravity: (3,) [m/s^2].
        sides: Edges of the friction pyramids, for contacts.
        dtype: Of the computation and the figures; by default that of the arrays among the axes, or else float64, as far as
            JAX's x64 switch allows.
        progress: Show a bar on stderr, if that is a terminal.

    Returns:
        A Dataset with the axes with more than one value, or a list of one, as dimensions in the order given, the others as
        coordinates without dimension, and a variable for each quantity; min_speed and max_speed have no dimension `speed`,
        unless there is angular momentum. At speed zero the answers are those of a robot that stands still, see
        `Status.NO_DIRECTION`. Everything has units;
        `case` and `status` are int8 with flag_values and flag_meanings, and contact_set has them too if the sets have
        names. The attributes hold contacts, those given, as the text of a contacts file, sides (both only where contacts
        were given), gravity, dtype, conventions and version.

    Raises:
        InputError: Naming the axis, quantity or option that cannot be used, before anything is computed.
    """
    answers, about = _prepared(cone, _checked(cone, axes, quantities, dtype), gravity, sides, progress)
    return _in_memory(answers, about, progress)


def write_map(
    path: str | Path,
    cone: Contacts | CentroidalCone | ConeRays,
    axes: Mapping[str, Any],
    quantities: Sequence[str] | None = None,
    *,
    gravity: ArrayLike = GRAVITY,
    sides: int = 4,
    dtype: DTypeLike | None = None,
    progress: bool = False,
    force: bool = False,
    elsewhere: "Elsewhere | None" = None,
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

    Returns:
        How many states were computed; without a speed, lines of travel.

    Raises:
        InputError: Before anything is computed, as in `kernel_map`; also for a file that is there, a disk that is too small,
            or a PATH.partial that holds another map.
    """
    path = Path(path)
    _check_path(path, force)
    asked = _checked(cone, axes, quantities, dtype)
    if path.suffix.lower() == ".nc":
        return _written_whole(path, cone, asked, gravity, sides, progress, force, elsewhere)
    _check_disk(path, asked.bytes * (1 - len(recorded(path)) / len(regions(asked.grid))))
    other = elsewhere or Elsewhere()
    answers, about = _prepared(cone, asked, gravity, sides, progress, other.backend)
    growing: dict[str, Any] = {"regions": len(answers.regions), "force": force, "share": other.share}
    with growing_map(path, about.coordinates, about.variables, about.settings, **growing) as store:
        ours = range(other.share.number, len(answers.regions), other.share.of)
        todo = [number for number in ours if number not in store.done]
        total, computed = (sum(answers.states(answers.regions.region(number)) for number in some) for some in (ours, todo))
        work = RegionWork(
            path.absolute(), cone, dict(axes), asked.quantities, gravity, sides, asked.dtype.name, about.settings
        )
        with _bar("states", total, total - computed, progress) as bar:
            for number in _grown(answers, store, todo) if other.run is None else other.run(work, todo):
                if other.run is not None:
                    store.record(number)
                bar.update(answers.states(answers.regions.region(number)))
    return computed


def _grown(answers: Answers, store: GrowingMap, todo: list[int]) -> Iterator[int]:
    """Computes regions in this process, and writes them."""
    for region, values in answers.over(todo):
        store.write(region.number, {name: answers.place(region, name) for name in values}, values)
        yield region.number


def _written_whole(
    path: Path,
    cone: Contacts | CentroidalCone | ConeRays,
    asked: "_Asked",
    gravity: ArrayLike,
    sides: int,
    progress: bool,
    force: bool,
    elsewhere: "Elsewhere | None",
) -> int:
    """A netCDF map."""
    if elsewhere is not None:
        raise InputError(f"{path}: a netCDF map is computed in one process (expected .zarr, or no other place)")
    with needs_extra("maps", "writing netCDF"):
        import h5netcdf  # noqa: F401
        import h5py  # noqa: F401
    _check_disk(path, asked.bytes)
    answers, about = _prepared(cone, asked, gravity, sides, progress)
    dataset = _in_memory(answers, about, progress)
    with whole_file(path, force=force) as handle:
        dataset.to_netcdf(handle.name, engine="h5netcdf")
    return asked.grid.size


class Elsewhere(NamedTuple):
    """Where the regions of a map are computed, if not all in this process."""

    run: Callable[["RegionWork", list[int]], Iterable[int]] | None = None
    """Calls what it is given, which can be pickled, with each of these numbers in any process that sees the file, and yields
    those that are done. None: this process does."""
    backend: str | None = None
    """Of JAX, there."""
    share: Share = WHOLE
    """The part of the map that is grown."""


@dataclass(frozen=True)
class RegionWork:
    """What computes a region of an unfinished map and writes its chunks. It can be sent to other processes."""

    path: Path
    cone: Contacts | CentroidalCone | ConeRays
    axes: dict[str, Any]
    quantities: tuple[str, ...]
    gravity: ArrayLike
    sides: int
    dtype: str
    settings: dict[str, Any]

    def __call__(self, number: int) -> int:
        """Computes the region with this number, and writes it. Returns the number."""
        with jax.enable_x64(self.dtype == "float64"):
            (region, values), *_ = (answers := self._answers()).over([number])
        write_chunks(self.path, {name: answers.place(region, name) for name in values}, values)
        return number

    def _answers(self) -> Answers:
        """Kept from region to region: cones and programs are made once a process."""
        settings = json.loads(json.dumps(self.settings))
        key = f"{self.path} {json.dumps(settings, sort_keys=True)}"
        if key not in _KEPT:
            asked = _checked(self.cone, self.axes, self.quantities, self.dtype)
            answers, about = _prepared(self.cone, asked, self.gravity, self.sides, progress=False)
            here = json.loads(json.dumps(about.settings))
            other = next((name for name in {**settings, **here} if settings.get(name) != here.get(name)), None)
            if other is not None:
                raise InputError(
                    f"{self.path}: {other} of the map is {settings.get(other)} (a worker has {here.get(other)})"
                )
            _KEPT.clear()
            _KEPT[key] = answers
        if settings_in(self.path) != settings:
            raise InputError(f"{partial_path(self.path)}: is another map now")
        return _KEPT[key]


_KEPT: dict[str, Answers] = {}
"""The one map that this process last computed a region of, for `RegionWork`."""


class _Asked(NamedTuple):
    """What is to be computed, checked."""

    grid: Grid
    quantities: tuple[str, ...]
    dtype: np.dtype

    @property
    def bytes(self) -> int:
        """Of the map at most, without compression."""
        types = output_types(self.dtype)
        return self.grid.size * sum(types[name].itemsize for name in self.quantities)


class _About(NamedTuple):
    """What the map says of itself."""

    coordinates: xr.Dataset
    """Without variables."""
    variables: dict[str, Variable]
    settings: dict[str, Any]
    """All that the answers depend on."""


def _checked(
    cone: Contacts | CentroidalCone | ConeRays,
    axes: Mapping[str, Any],
    quantities: Sequence[str] | None,
    dtype: DTypeLike | None,
) -> _Asked:
    points = grid_of(with_sets(cone, axes))
    if quantities is None:
        quantities = ("capturable", "margin", "case") if points.has_speed else LIMITS
    quantities = (quantities,) if isinstance(quantities, str) else tuple(quantities)
    if not quantities:
        raise InputError("quantities: none (expected at least one)")
    for name in quantities:
        if name not in MAPPED:
            raise InputError(f"quantity {name!r} is not known (expected {', '.join(MAPPED)})")
        if quantities.count(name) > 1:
            raise InputError(f"quantity {name!r} is given twice")
        if name not in LIMITS and not points.has_speed:
            raise InputError(f"quantity {name!r} needs a speed (expected an axis 'speed', or {', '.join(CARTESIAN)})")
    given = [values.dtype for values in axes.values() if hasattr(values, "dtype") and values.dtype.kind == "f"]
    wanted = np.result_type(*given or [np.float64], np.float32) if dtype is None else np.dtype(dtype)
    if wanted not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise InputError(f"dtype = {wanted} (expected float32 or float64)")
    able = np.dtype(jax.dtypes.canonicalize_dtype(wanted))
    if dtype is not None and able != wanted:
        raise InputError("dtype = float64 while JAX is restricted to single precision (expected jax.enable_x64(True))")
    return _Asked(points, quantities, able)


def _prepared(
    cone: Contacts | CentroidalCone | ConeRays,
    asked: _Asked,
    gravity: ArrayLike,
    sides: int,
    progress: bool,
    backend: str | None = None,
) -> tuple[Answers, _About]:
    """What computes the map, and what the map says of itself."""
    gravity = np.asarray(gravity, np.float64)
    if gravity.shape != (3,) or not np.isfinite(gravity).all():
        raise InputError(f"gravity = {gravity} (expected 3 finite numbers)")
    cones, origin = _cones(cone, asked.grid, sides, progress)
    answers = Answers(cones, asked.grid, asked.quantities, gravity, asked.dtype)
    dims = asked.grid.dims
    over = f" over {', '.join(dims)}" if dims else ""
    notes = notes_of(list(given_sets(cone).values()), asked.grid)
    attributes = {
        "title": f"zero-step capturability{over}: {', '.join(asked.quantities)}",
        "source": f"jaxcap {__version__}",
        "conventions": CONVENTIONS,
        "gravity": gravity.tolist(),
        "dtype": asked.dtype.name,
        **origin,
        **({"notes": "; ".join(notes)} if notes else {}),
    }
    types = output_types(asked.dtype)
    steps = answers.regions.steps
    variables = {
        name: Variable(
            dims=answers.dims(name),
            shape=tuple(answers.regions.sizes[dim] for dim in answers.dims(name)),
            chunks=tuple(steps[dim] for dim in answers.dims(name)),
            dtype=types[name],
            attributes=attributes_of(name),
        )
        for name in asked.quantities
    }
    settings = {
        **attributes,
        "axes": {name: values.tolist() for name, values in asked.grid.axes.items()},
        "quantities": list(asked.quantities),
        "regions": steps,
        "cone": hashlib.sha256(b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(cones))).hexdigest(),
        "jax": f"{jax.__version__} on {backend or jax.default_backend()}",
    }
    return answers, _About(coordinates(asked.grid, given_sets(cone), attributes), variables, settings)


def notes_of(sets: Sequence[ContactSet], points: Grid) -> tuple[str, ...]:
    """What is hardly plausible about most of the map: its CoM positions at the quartiles of their axes, with each set."""
    quartiles = [np.quantile(points.axes[name], [0.25, 0.5, 0.75]) for name in POSITION]
    coms = np.stack(np.meshgrid(*quartiles), axis=-1).reshape(-1, 3)
    plausible = Plausibility()
    for contacts in sets:
        fields = contacts.points, contacts.frames[..., 2], contacts.mask
        plausible.add(Stand(*(np.repeat(np.asarray(field)[None], len(coms), axis=0) for field in fields)), coms)
    return plausible.notes("of the map")


def _cones(
    cone: Contacts | CentroidalCone | ConeRays, points: Grid, sides: int, progress: bool
) -> tuple[list, dict[str, Any]]:
    """The cones at all points of the grid's axes of contacts, and what the map says of their origin."""
    sets = given_sets(cone)
    if not sets:
        if isinstance(cone, ConeRays) and cone.rays.ndim != 2:
            raise InputError(f"cone has rays of {len(cone.rays)} contact sets (expected one)")
        return [cone], {}
    cones, changed = [], contact_sets(list(sets.values()), points)
    with _bar("contact sets", len(changed), 0, progress and len(changed) > 1) as bar:
        for where, contacts in changed:
            try:
                cones.append(centroidal_cone(contacts, sides=sides))
            except ValueError as error:
                raise InputError(f"{where}: {str(error).removeprefix('contacts: ')}") from error
            bar.update()
    return cones, {"sides": int(sides), "contacts": as_file(sets)}


def _in_memory(answers: Answers, about: _About, progress: bool) -> xr.Dataset:
    needed = sum(variable.bytes for variable in about.variables.values())
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else math.inf
    if needed > memory:
        raise InputError(f"the map has {needed / 1e9:.3g} GB, and memory {memory / 1e9:.3g} GB (write it to Zarr instead)")
    arrays = {name: np.empty(variable.shape, variable.dtype) for name, variable in about.variables.items()}
    with _bar("states", answers.grid.size, 0, progress) as bar:
        for region, values in answers.over(range(len(answers.regions))):
            for name, value in values.items():
                arrays[name][answers.place(region, name)] = value
            bar.update(answers.states(region))
    return about.coordinates.assign(
        {name: (variable.dims, arrays[name], variable.attributes) for name, variable in about.variables.items()}
    )


def _bar(unit: str, total: int, done: int, progress: bool) -> tqdm:
    hidden = None if progress else True  # None: where stderr is no terminal
    return tqdm(total=total, initial=done, unit=f" {unit}", unit_scale=True, disable=hidden)


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
