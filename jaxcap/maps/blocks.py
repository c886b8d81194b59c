"""Answers all over a grid: regions for the file, blocks for the cores and the devices, chunks for the cache.

A region is a box of the grid with one contact set, small enough to be held in memory several times; it becomes one chunk of
every variable of the file. Its lines of travel are numbered, and a block of them is unravelled, looked up and answered on
the device; several devices take a block each. Each line is answered at all speeds of the region.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, partial
from itertools import chain
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import DTypeLike

from jaxcap.batch.blocks import BLOCK, LANES, padded_cone, side_by_side
from jaxcap.batch.devices import Spread, spread_over
from jaxcap.batch.kept_executables import Kept
from jaxcap.batch.rounds import Shared, States, in_two_rounds
from jaxcap.contacts.actuation import ActuatedRays
from jaxcap.contacts.cone import CentroidalCone
from jaxcap.contacts.conventions import ArrayLike, FloatArray
from jaxcap.maps.grid import CONTACTS, POSITION, Grid, look_up, look_up_momentum
from jaxcap.numerics.whole import ceil_div
from jaxcap.one_state.decision import AT_ANY_SPEED, capturability_along, capturability_at
from jaxcap.one_state.line import Cone, Motion

REGION = 1 << 20
"""Most states of a region: a few megabytes of each figure."""
OF_EFFORT = (*POSITION, *CONTACTS)
"""Axes that the effort depends on."""
SPEEDS = 1 << 9
"""Most speeds of a region: more would save nothing."""
AHEAD = 4
"""Blocks that are begun beyond the one that is waited for."""


class Region(NamedTuple):
    """A box of the grid."""

    number: int
    """In the order of the grid's dimensions, the last one fastest."""
    slices: dict[str, slice]
    """For each dimension, its part."""

    def shape(self, dims: Iterable[str]) -> tuple[int, ...]:
        """Number of values along these dimensions."""
        return tuple(self.slices[name].stop - self.slices[name].start for name in dims)


class Regions(NamedTuple):
    """How a grid is divided."""

    sizes: dict[str, int]
    """Values along each dimension."""
    steps: dict[str, int]
    """Values of a region along each dimension; the last region may have fewer."""

    @property
    def counts(self) -> tuple[int, ...]:
        """Regions along each dimension."""
        return tuple(ceil_div(self.sizes[name], step) for name, step in self.steps.items())

    def __len__(self) -> int:
        return math.prod(self.counts)

    def region(self, number: int) -> Region:
        """The region with this number."""
        places = np.unravel_index(number, self.counts) if self.steps else ()
        first = {name: int(place) * step for (name, step), place in zip(self.steps.items(), places, strict=True)}
        last = {name: min(start + self.steps[name], self.sizes[name]) for name, start in first.items()}
        return Region(number, {name: slice(first[name], last[name]) for name in first})


def regions(grid: Grid) -> Regions:
    """Regions of one contact set and at most REGION states: the longest dimension is halved until they are, and speeds stay
    together.
    """
    sizes = dict(zip(grid.dims, grid.shape, strict=True))
    parts = {name: size if name in CONTACTS else 1 for name, size in sizes.items()}
    if "speed" in parts:
        parts["speed"] = ceil_div(sizes["speed"], SPEEDS)
    step = lambda name: ceil_div(sizes[name], parts[name])
    while math.prod(map(step, sizes)) > REGION:
        longest = max((name for name in sizes if name != "speed"), key=step)
        parts[longest] *= 2
    return Regions(sizes, {name: step(name) for name in sizes})


class Answers:
    """The answers over a grid, region by region. Several devices share the work, as in `score`.

    Args:
        cones: Of one contact set each, at the points of the grid's axes of contacts, the last one fastest.
        grid: Whose points are answered.
        quantities: Fields of `Capturability`; without a speed in the grid, those `AT_ANY_SPEED` only.
        gravity: (3,) [m/s^2].
        dtype: Of the computation.
    """

    def __init__(
        self,
        cones: Sequence[Cone],
        grid: Grid,
        quantities: tuple[str, ...],
        gravity: ArrayLike,
        dtype: DTypeLike,
    ):
        self.grid, self.quantities, self.regions = grid, quantities, regions(grid)
        self._ready = False
        tables = grid.tables(np.float64)
        # With angular momentum each speed has a polygon of its own: it is then an axis like the others.
        self._shared_lines = grid.polar and not grid.spins
        self._speeds = _cast(tables.pop("speed", np.zeros(0)), dtype) if self._shared_lines else None
        self._names = tuple(tables)
        self._dims = tuple(name for name in grid.dims if name in (*self._names, *CONTACTS))
        self._sets = {name: size for name, size in self.regions.sizes.items() if name in CONTACTS}
        lines = math.prod(self.regions.region(0).shape(self._dims))
        devices = spread_over(cones)
        self._shares = max(len(devices), 1)
        blocks = ceil_div(lines, BLOCK * self._shares) * self._shares
        self._size = ceil_div(lines, blocks * LANES) * LANES
        gravity = jnp.asarray(gravity, np.dtype(dtype))
        arguments = [(*_about_contacts(cone, tables, dtype), gravity) for cone in _equally_long(cones)]
        options = _Options(self._names, self._size, self.quantities)
        if self._shares == 1:
            self._programs = [partial(_compiled, *common, options=options) for common in arguments]
        else:
            spread = _spread(devices, options)
            self._programs = [partial(_on_all, spread, spread.everywhere(common)) for common in arguments]

    def dims(self, quantity: str) -> tuple[str, ...]:
        """The dimensions of a quantity: those of the grid, without the speed where it does not depend on that."""
        if quantity == "effort":
            return tuple(name for name in self.grid.dims if name in OF_EFFORT)
        return self._dims if self._shared_lines and quantity in AT_ANY_SPEED else self.grid.dims

    def held(self, region: Region) -> tuple[str, ...]:
        """The quantities that a region has chunks of: the effort is written by the first of the regions that share it."""
        first = all(part.start == 0 for name, part in region.slices.items() if name not in OF_EFFORT)
        return tuple(name for name in self.quantities if first or name != "effort")

    def states(self, region: Region) -> int:
        """How many points of the grid lie in it."""
        return math.prod(region.shape(self.grid.dims))

    def place(self, region: Region, quantity: str) -> tuple[slice, ...]:
        """The part of a quantity's array that belongs to the region."""
        return tuple(region.slices[name] for name in self.dims(quantity))

    def over(self, numbers: Sequence[int]) -> Iterator[tuple[Region, dict[str, np.ndarray]]]:
        """These regions, in order, and their quantities, arrays with the dimensions that `dims` says. While a region is in
        the hands of the caller, blocks of the next are being computed.
        """
        chosen = map(self.regions.region, numbers)
        starts = lambda region: range(0, math.prod(region.shape(self._dims)), self._size * self._shares)
        items, blocks = chain.from_iterable(((region, start) for start in starts(region)) for region in chosen), []
        if numbers and not self._ready:
            jax.block_until_ready(self._answered(self.regions.region(0), 0))  # compiles, once for all threads
            self._ready = True
        for region, block in side_by_side(lambda item: (item[0], self._answered(*item)), items, ahead=AHEAD):
            blocks.append(block)
            if len(blocks) == len(starts(region)):
                yield region, {name: self._assembled(region, name, blocks) for name in self.held(region)}
                blocks = []

    def _answered(self, region: Region, start: int) -> dict[str, Array | np.ndarray]:
        """The quantities of the block of a region that begins with this line; with several devices, of one block each."""
        first = np.int32(start) if self._shares == 1 else start + self._size * np.arange(self._shares, dtype=np.int32)
        places = [region.slices[name].start for name in self._sets]
        number = np.ravel_multi_index(places, tuple(self._sets.values())) if places else 0
        return self._programs[number](first, *self._of(region))

    def _of(self, region: Region) -> tuple:
        """What the program has to know of a region: where it begins, its shape, its speeds."""
        whole = {name: region.slices.get(name, slice(0, 1)) for name in self._names}
        first = np.array([part.start for part in whole.values()], np.int32)
        shape = np.array([part.stop - part.start for part in whole.values()], np.int32)
        if self._speeds is None:
            return first, shape, None
        part, step = region.slices.get("speed", slice(0, None)), self.regions.steps.get("speed", 0)
        speeds = self._speeds[part]
        return first, shape, np.pad(speeds, (0, max(step - len(speeds), 0)))

    def _assembled(self, region: Region, name: str, blocks: list[dict[str, Array | np.ndarray]]) -> np.ndarray:
        """A quantity of a region from those of its blocks."""
        shape, dims = region.shape(self._dims), self.dims(name)
        values = np.concatenate([block[name] for block in blocks])[: math.prod(shape)]
        if name == "effort":  # where one direction is undecided, another says it
            others = tuple(axis for axis, of in enumerate(self._dims) if of not in OF_EFFORT)
            return np.fmax.reduce(values.reshape(shape), axis=others)
        if self._shared_lines and "speed" in dims:
            at_speeds = values[:, : region.shape(["speed"])[0]].reshape(*shape, -1)
            return np.ascontiguousarray(np.moveaxis(at_speeds, -1, dims.index("speed")))
        return values.reshape(shape)  # drops the axis of a single speed


def _about_contacts(cone: Cone, tables: dict[str, np.ndarray], dtype: DTypeLike) -> tuple:
    """Cone and tables on the device, with the contacts' centroid as the origin of positions: subtracted before they are
    cast."""
    origin = dict(zip(POSITION, np.asarray(cone.origin, np.float64), strict=True))
    local = {name: jnp.asarray(_cast(values - origin.get(name, 0), dtype)) for name, values in tables.items()}
    here = np.zeros(3)
    if isinstance(cone, ActuatedRays):
        return jax.tree.map(jnp.asarray, cone._replace(rays=cone.rays._replace(origin=here))), local
    return jax.tree.map(jnp.asarray, cone._replace(origin=here)), local


def _cast(values: np.ndarray, dtype: DTypeLike) -> np.ndarray:
    """Beyond the largest number there is infinity, and the states are marked."""
    with np.errstate(over="ignore"):
        return values.astype(dtype)


def _equally_long(cones: Sequence[Cone]) -> list[Cone]:
    """Cones with equally many faces, for which one program serves."""
    padded = [padded_cone(cone) for cone in cones]
    rows = max(len(cone.faces) for cone in padded if isinstance(cone, CentroidalCone)) if len(padded) > 1 else 0
    return [cone.padded(rows) if rows and isinstance(cone, CentroidalCone) else cone for cone in padded]


class _Options(NamedTuple):
    """What a program is compiled for."""

    names: tuple[str, ...]
    """Axes that states are looked up along."""
    size: int
    """Lines of travel of a block."""
    fields: tuple[str, ...]


def _of_block(
    cone: Cone,
    tables: dict[str, Array],
    gravity: Float[Array, "3"],
    start: Int[FloatArray, ""],
    first: Int[FloatArray, " d"],
    shape: Int[FloatArray, " d"],
    speeds: Float[Array, " s"] | None,
    options: _Options,
) -> dict[str, Array]:
    """The fields of one block of lines of travel."""
    index = jnp.minimum(start + jnp.arange(options.size, dtype=jnp.int32), jnp.prod(shape, dtype=jnp.int32) - 1)
    places = first[:, None] + _unravelled(index, shape)
    of_axes = dict(zip(options.names, places, strict=True))
    (com, along), momenta = look_up(tables, of_axes), look_up_momentum(tables, of_axes)
    answer: Callable[[Motion], dict[str, Array]]
    if speeds is None:
        answer = partial(_at, fields=options.fields)
    else:
        answer = partial(capturability_along, speeds=speeds, fields=options.fields)
    spinning = None if momenta is None else jnp.asarray(momenta.T)
    states = States(jnp.asarray(com.T), jnp.asarray(along.T), specific_angular_momenta=spinning)
    return in_two_rounds(Shared(gravity, cone), states, answer=answer)


def _at(motion: Motion, fields: tuple[str, ...]) -> dict[str, Array]:
    """Fields of `capturability_at`."""
    answer = capturability_at(motion)
    return {name: getattr(answer, name) for name in fields}


def _unravelled(index: Int[Array, " n"], shape: Int[FloatArray, " d"]) -> Int[Array, "d n"]:
    """Indices along each axis, of points counted with the last axis fastest."""
    places = []
    for size in shape[::-1]:
        places.append(index % size)
        index = index // size
    return jnp.stack(places[::-1])


_compiled = Kept(_of_block, "options")


@cache
def _spread(devices: tuple[jax.Device, ...], options: _Options) -> Spread:
    """A program of which each device takes the block that begins with its line."""

    def one(common: Any, start: Int[Array, "1"]) -> dict[str, Array]:
        (cone, tables, gravity), (first, shape, speeds) = common
        return _of_block(cone, tables, gravity, start[0], first, shape, speeds, options)

    return Spread(one, devices)


def _on_all(spread: Spread, arguments: Any, starts: Any, *region: Any) -> dict[str, np.ndarray]:
    return spread((arguments, spread.everywhere(region)), starts)
