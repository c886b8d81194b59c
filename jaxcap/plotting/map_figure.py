"""The figure of a whole map, with choices for whatever is not asked for."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.maps.contact_axes import contacts_at
from jaxcap.maps.grid import CONTACTS
from jaxcap.plotting.areas_of_maps import POLAR, map_areas, weakest
from jaxcap.plotting.kernels import at_selection, kernel_slice
from jaxcap.plotting.patches import footprint

if TYPE_CHECKING:
    import xarray as xr

PREFERRED = ("margin", "max_speed")
"""Quantities of which the first that is there is drawn where none is asked for."""
FROM_THE_FIRST = ("heading", "downhill", "contact_set")
"""Axes that have no middle."""


def map_figure(
    dataset: "xr.Dataset",
    sets: Sequence[ContactSet],
    quantity: str | None,
    axes: tuple[str | None, str | None],
    selection: dict[str, float],
) -> tuple[Figure, dict[str, float]]:
    """An overview of a map of velocity areas; of another map, or if something is asked for, a slice.

    Args:
        dataset: The map.
        sets: Its contact sets, none if they are not known: drawn where it is seen from above, as they are at the values of
            its axes of contacts.
        quantity: What is drawn; None for a choice.
        axes: Over what; None for a choice.
        selection: Values of other axes. Those that are left are taken at their middle, `FROM_THE_FIRST` at the first.

    Returns:
        The figure, and the values that were chosen.

    Raises:
        ValueError: As `kernel_slice`, before anything is drawn.
    """
    polar = "max_speed" in dataset.data_vars and set(POLAR) <= set(dataset["max_speed"].dims)
    if polar and quantity is None and axes == (None, None) and not set(POLAR) & set(selection):
        chosen = _choice(dataset, "max_speed", POLAR, selection)
        return _overview(dataset, sets, {**selection, **chosen}), chosen
    names = [str(name) for name in dataset.data_vars]
    quantity = quantity or next(name for name in (*PREFERRED, *names) if name in names)
    x, y = _free_axes(dataset, quantity, axes, selection)
    chosen = _choice(dataset, quantity, (x, y), selection)
    figure = Figure(figsize=(7.0, 5.0), layout="compressed")
    values: Any = {**selection, **chosen}
    ax = kernel_slice(dataset, quantity, x=x, y=y, ax=figure.add_subplot(), **values)
    if (x, y) == POLAR[:2]:
        _below(ax, _stance(dataset, sets, {**selection, **chosen}))
    return figure, chosen


def _overview(dataset: "xr.Dataset", sets: Sequence[ContactSet], selection: dict[str, float]) -> Figure:
    """The speed that is stopped whatever its heading, and velocity areas, over the stance."""
    figure = Figure(figsize=(12.5, 5), layout="compressed")
    left, right = figure.subplots(1, 2)
    kernel_slice(weakest(dataset, **selection), "weakest", ax=left)
    limits: Any = {"xlim": left.get_xlim(), "ylim": left.get_ylim()}
    values: Any = selection
    map_areas(dataset, ax=right, **values).set(**limits)
    stance = _stance(dataset, sets, selection)
    for ax in (left, right):
        _below(ax, stance)
    figure.suptitle(left.get_title().replace("\n", " "))
    left.set_title("largest speed that can be stopped\nwhatever its heading")
    right.set_title("velocities that can be stopped,\nfrom where the dots are")
    return figure


def _stance(dataset: "xr.Dataset", sets: Sequence[ContactSet], selection: dict[str, float]) -> ContactSet | None:
    """The contacts at the grid point that is nearest to the selection, if they are known."""
    place = dataset.sel({name: value for name, value in selection.items() if name in CONTACTS}, method="nearest")
    return contacts_at(sets, **{name: float(place[name]) for name in CONTACTS if name in place}) if sets else None


def _below(ax: Axes, contacts: ContactSet | None) -> None:
    """The contacts, as far as they are in the picture."""
    limits: Any = {"xlim": ax.get_xlim(), "ylim": ax.get_ylim()}
    if contacts is not None:
        footprint(contacts, ax=ax)
    ax.set(**limits)


def _free_axes(
    dataset: "xr.Dataset", quantity: str, axes: tuple[str | None, str | None], selection: dict[str, float]
) -> tuple[str, str]:
    """The axes asked for; for those that are not, the first that are free."""
    dims = [str(name) for name in dataset[quantity].dims] if quantity in dataset.data_vars else list(POLAR)
    free = [name for name in dims if name not in (*axes, *selection) and dataset.sizes.get(name, 0) > 1]
    x = axes[0] or next(iter(free), None)
    y = axes[1] or next((name for name in free if name != x), None)
    if quantity in dataset.data_vars and None in (x, y):
        where = f" at a value of {', '.join(selection)}" if selection else ""
        raise ValueError(f"{quantity} has the axes {', '.join(dims) or 'none'}{where} (expected two for a picture)")
    return str(x), str(y)


def _choice(dataset: "xr.Dataset", quantity: str, kept: tuple[str, ...], selection: dict[str, float]) -> dict[str, float]:
    """Values for the axes that are left over. Raises ValueError for what cannot be drawn."""
    dims = map(str, dataset[quantity].dims) if quantity in dataset.data_vars else ()
    left_over = {name: np.asarray(dataset[name], float) for name in dims if name not in (*kept, *selection)}
    chosen = {name: float(axis[0 if name in FROM_THE_FIRST else len(axis) // 2]) for name, axis in left_over.items()}
    at_selection(dataset, quantity, kept, {**selection, **chosen})
    return chosen
