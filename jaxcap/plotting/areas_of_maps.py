"""Velocity areas out of a map, and the push that is stopped in every direction."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Int
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from jaxcap.plotting.areas import velocity_areas
from jaxcap.plotting.kernels import at_selection
from jaxcap.plotting.style import BLUE
from jaxcap.regions.velocity_area import VelocityArea

if TYPE_CHECKING:
    import xarray as xr

POLAR = ("com_x", "com_y", "heading")
"""Axes of a map of velocity areas."""


def map_areas(
    dataset: "xr.Dataset",
    *,
    places: int = 4,
    color: ColorType = BLUE,
    ax: Axes | None = None,
    **selection: float,
) -> Axes:
    """Velocity areas at a few CoM positions of a map; see `velocity_areas`.

    Args:
        dataset: From `jaxcap.maps`, with max_speed, and perhaps min_speed, over com_x, com_y and heading.
        places: Positions along each axis, evenly spread over where the robot can stand, or over the map.
        color: Of the areas.
        ax: Axes to draw into; by default those of a new figure.
        **selection: A value for each other axis, of which the nearest grid point is taken.

    Returns:
        The axes.

    Raises:
        ValueError: For a map without these axes or fields, or with others that are not selected.
    """
    plane = _polar(dataset, selection)
    field = lambda name: np.asarray(plane[name].transpose(*POLAR), float)
    largest = field("max_speed")
    smallest = field("min_speed") if "min_speed" in plane else np.zeros_like(largest)
    standing = (largest > 0).all(axis=-1) & (smallest == 0).all(axis=-1)
    rows, columns = _spread(standing.any(axis=1), places), _spread(standing.any(axis=0), places)
    angle = np.asarray(plane["heading"], float)
    directions = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    x, y = np.asarray(plane["com_x"], float)[rows], np.asarray(plane["com_y"], float)[columns]
    coms = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)

    def chosen(values: np.ndarray) -> Any:
        return values[np.ix_(rows, columns)].reshape(len(coms), *values.shape[2:])

    of_map: Any = directions
    areas = VelocityArea(of_map, chosen(smallest), chosen(largest), chosen(standing))
    return velocity_areas(areas, coms, color=color, ax=ax)


def weakest(dataset: "xr.Dataset", **selection: float) -> "xr.Dataset":
    """The largest speed that can be stopped whatever its heading.

    Args:
        dataset: As in `map_areas`.
        **selection: As in `map_areas`.

    Returns:
        A map `weakest` of com_x and com_y, for `kernel_slice`; where a heading is undecided there is no figure.

    Raises:
        ValueError: As in `map_areas`.
    """
    plane = _polar(dataset, selection)
    least = plane[["max_speed"]].min("heading", skipna=False, keep_attrs=True).rename(max_speed="weakest")
    least["weakest"].attrs["long_name"] = "largest capturable speed, weakest heading"
    return least


def _polar(dataset: "xr.Dataset", selection: dict[str, float]) -> "xr.Dataset":
    """The map at the selection, if it has the axes and fields of velocity areas."""
    if "max_speed" not in dataset.data_vars:
        raise ValueError(f"'max_speed' is not in the map (it holds {', '.join(map(str, dataset.data_vars)) or 'nothing'})")
    missing = [name for name in POLAR if name not in dataset["max_speed"].dims]
    if missing:
        raise ValueError(f"{missing[0]!r} is not an axis of the map (expected {', '.join(POLAR)})")
    return at_selection(dataset, "max_speed", POLAR, selection)


def _spread(wanted: Bool[np.ndarray, " n"], places: int) -> Int[np.ndarray, " k"]:
    """Indices of a few grid points, evenly spread from the first to the last that is wanted, not at the ends themselves."""
    known = np.flatnonzero(wanted)
    first, last = (known[0], known[-1]) if len(known) else (0, len(wanted) - 1)
    return np.unique(np.round(first + (np.arange(places) + 0.5) * (last - first) / places).astype(int))
