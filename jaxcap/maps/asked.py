"""What a map is asked for, checked, and what then computes it and says what it is. Needs the extra `maps`."""

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import DTypeLike

from jaxcap.contacts.actuation import ActuatedRays
from jaxcap.contacts.cone import CentroidalCone, ConeRays, centroidal_cone
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import ArrayLike
from jaxcap.errors import InputError, needs_extra
from jaxcap.files.fields import FIELDS, output_types
from jaxcap.files.plausibility import Plausibility, Stand
from jaxcap.maps.blocks import Answers
from jaxcap.maps.contact_axes import Mapped, contact_sets, given_sets, with_sets
from jaxcap.maps.grid import CARTESIAN, POSITION, Grid, grid_of
from jaxcap.one_state.decision import AT_ANY_SPEED, LIMITS
from jaxcap.version import __version__

with needs_extra("maps", "jaxcap.maps"):
    import xarray as xr
    from tqdm import tqdm

    from jaxcap.maps.labels import CONVENTIONS, as_file, attributes_of, coordinates
    from jaxcap.maps.store import Variable


class Asked(NamedTuple):
    """What is to be computed, checked."""

    grid: Grid
    quantities: tuple[str, ...]
    dtype: np.dtype

    @property
    def bytes(self) -> int:
        """Of the map at most, without compression."""
        types = output_types(self.dtype)
        return self.grid.size * sum(types[name].itemsize for name in self.quantities)


class About(NamedTuple):
    """What the map says of itself."""

    coordinates: xr.Dataset
    """Without variables."""
    variables: dict[str, Variable]
    settings: dict[str, Any]
    """All that the answers depend on."""


def checked(
    cone: Mapped,
    axes: Mapping[str, Any],
    quantities: Sequence[str] | None,
    dtype: DTypeLike | None,
) -> Asked:
    """Raises InputError, naming the axis, quantity or option that cannot be used."""
    points = grid_of(with_sets(cone, axes))
    if quantities is None:
        quantities = ("capturable", "margin", "case") if points.has_speed else LIMITS
    quantities = (quantities,) if isinstance(quantities, str) else tuple(quantities)
    if not quantities:
        raise InputError("quantities: none (expected at least one)")
    for name in quantities:
        if name not in FIELDS:
            raise InputError(f"quantity {name!r} is not known (expected {', '.join(FIELDS)})")
        if quantities.count(name) > 1:
            raise InputError(f"quantity {name!r} is given twice")
        if name == "effort" and not _bears_effort(cone):
            raise InputError("quantity 'effort' needs a robot's posture (expected --robot, or a cone from `actuated_cone`)")
        if name not in AT_ANY_SPEED and not points.has_speed:
            raise InputError(f"quantity {name!r} needs a speed (expected an axis 'speed', or {', '.join(CARTESIAN)})")
    given = [values.dtype for values in axes.values() if hasattr(values, "dtype") and values.dtype.kind == "f"]
    wanted = np.result_type(*given or [np.float64], np.float32) if dtype is None else np.dtype(dtype)
    if wanted not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise InputError(f"dtype = {wanted} (expected float32 or float64)")
    able = np.dtype(jax.dtypes.canonicalize_dtype(wanted))
    if dtype is not None and able != wanted:
        raise InputError("dtype = float64 while JAX is restricted to single precision (expected jax.enable_x64(True))")
    return Asked(points, quantities, able)


def prepared(
    cone: Mapped,
    asked: Asked,
    gravity: ArrayLike,
    sides: int,
    progress: bool,
    backend: str | None = None,
    said: Mapping[str, str] | None = None,
) -> tuple[Answers, About]:
    """What computes the map, and what the map says of itself; `said` is what else it says."""
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
        **(said or {}),
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
    return answers, About(coordinates(asked.grid, given_sets(cone), attributes), variables, settings)


def notes_of(sets: Sequence[ContactSet], points: Grid) -> tuple[str, ...]:
    """What is hardly plausible about most of the map: its CoM positions at the quartiles of their axes, with each set."""
    quartiles = [np.quantile(points.axes[name], [0.25, 0.5, 0.75]) for name in POSITION]
    coms = np.stack(np.meshgrid(*quartiles), axis=-1).reshape(-1, 3)
    plausible = Plausibility()
    for contacts in sets:
        fields = contacts.points, contacts.frames[..., 2], contacts.mask
        plausible.add(Stand(*(np.repeat(np.asarray(field)[None], len(coms), axis=0) for field in fields)), coms)
    return plausible.notes("of the map")


def _bears_effort(cone: Mapped) -> bool:
    """Whether it is of a posture whose joints bear only so much."""
    if isinstance(cone, ActuatedRays):
        return cone.actuation.joints > 0
    return isinstance(cone, CentroidalCone) and cone.effort is not None


def _cones(cone: Mapped, points: Grid, sides: int, progress: bool) -> tuple[list, dict[str, Any]]:
    """The cones at all points of the grid's axes of contacts, and what the map says of their origin."""
    sets = given_sets(cone)
    if not sets:
        if isinstance(cone, ConeRays) and cone.rays.ndim != 2:
            raise InputError(f"cone has rays of {len(cone.rays)} contact sets (expected one)")
        return [cone], {}
    cones, changed = [], contact_sets(list(sets.values()), points)
    with bar("contact sets", len(changed), 0, progress and len(changed) > 1) as shown:
        for where, contacts in changed:
            try:
                cones.append(centroidal_cone(contacts, sides=sides))
            except ValueError as error:
                raise InputError(f"{where}: {str(error).removeprefix('contacts: ')}") from error
            shown.update()
    return cones, {"sides": int(sides), "contacts": as_file(sets)}


def bar(unit: str, total: int, done: int, progress: bool) -> tqdm:
    """On stderr; hidden where it is not wanted, or stderr is no terminal."""
    hidden = None if progress else True  # None: as stderr is
    return tqdm(total=total, initial=done, unit=f" {unit}", unit_scale=True, disable=hidden)
