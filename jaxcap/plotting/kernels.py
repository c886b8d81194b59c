"""Slices of a map, as filled contours with the zero level drawn; where there is no number, the picture says so."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Shaped
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from jaxcap.files.fields import CASES
from jaxcap.one_state.result import Case, Status
from jaxcap.plotting.style import BLUE, DARK, GREY, ORANGE, RED, axes_or_new, halo
from jaxcap.plotting.words import DEGREES, label_of, place_of, unit_of, values_of

if TYPE_CHECKING:
    import xarray as xr

Beyond = Literal["neither", "min", "max", "both"]
"""On which side of its levels a field goes on."""
LEVELS = 12
"""Contours, more or less."""
OUTLIERS = 0.98
"""Where the largest figures are far above the rest, colours end at this quantile."""
FAR = 2.0
"""How far above: this many times that quantile."""
BESIDE = (1.03, 0.0, 0.045, 1.0)
"""Place of the colour bar, relative to the axes: as high as they are, whatever their aspect."""
EMPTY = "#e8e8e8"
"""Colour of the area where a field that is nowhere negative is zero."""
ROUND_ANGLES = [1, 1.5, 3, 4.5, 6, 9, 10]
"""Ticks of angles are at multiples of these, and of ten times these."""
ROUND_NUMBERS = [1, 2, 2.5, 5, 10]
"""Ticks of other figures are at multiples of these and their powers of ten, as Matplotlib's own are."""
THICK = 2.2
"""Width of the line where the verdict flips."""
TICKS = 6
"""At most, beside each other: of a range of a few centimetres the numbers are as long as the way between Matplotlib's."""
BORDERS = {"effort": (1.0, "the most that torques hold")}
"""Levels at which a verdict flips, where these are not zero, and what the legend says of them."""
ENDLESS = {"effort": "no torques hold it"}
"""What an infinite figure means, where it is no speed."""
TO_SCALE = ("m", "m/s")
"""Where both axes are of one of these units, the picture is to scale."""
HATCHES = {"undecided": "xx", "at rest": "\\\\"}
"""Where a field is no number, by the reason; dots for any other."""


def _named(case: Case, colour: str) -> tuple[str, str]:
    return f"{case.name}: {CASES[case]}", colour


CODES: dict[str, dict[Any, tuple[str, str]]] = {
    "capturable": {False: ("falls, or has to step", EMPTY), True: ("capturable", BLUE)},
    "case": {
        Case.UNDECIDED: (CASES[Case.UNDECIDED], "#ffffff"),
        Case.C1: _named(Case.C1, "#f0c37c"),
        Case.C2: _named(Case.C2, ORANGE),
        Case.C3_1: _named(Case.C3_1, BLUE),
        Case.C3_2_1: _named(Case.C3_2_1, "#5f9fcf"),
        Case.C3_2_2: _named(Case.C3_2_2, "#b0653a"),
        Case.C3_3: _named(Case.C3_3, "#083050"),
        Case.EMPTY: _named(Case.EMPTY, EMPTY),
    },
    "status": {
        Status.OK: ("OK", EMPTY),
        Status.NO_DIRECTION: ("NO_DIRECTION", "#9ec5e6"),
        Status.MAX_STEPS: ("MAX_STEPS", RED),
        Status.MAX_SWINGS: ("MAX_SWINGS", BLUE),
        Status.NONFINITE: ("NONFINITE", DARK),
    },
}
"""Legend and colour of the values of fields that are codes."""


def kernel_slice(
    dataset: "xr.Dataset",
    quantity: str = "max_speed",
    *,
    x: str = "com_x",
    y: str = "com_y",
    levels: int | Sequence[float] | None = None,
    bar: bool = True,
    ax: Axes | None = None,
    **selection: float,
) -> Axes:
    """A plane of a map: a field of `Capturability` over two of its axes.

    The zero level is a thick line (of the effort, the level one), and contours below it are dashed. A field that is nowhere
    negative is grey where it is zero, as far as the cell beside, where the others, continued in a straight line, would
    vanish. Infinite figures are hatched, and so is, in another way, whatever is no number; the legend says why.
    `capturable`, `case` and `status` are areas of colour. Angles are in degrees, in `selection` in radians.

    Args:
        dataset: From `jaxcap.maps`, or one like it: the coordinates and `quantity` with attributes `units` and `long_name`.
        quantity: Field to draw.
        x: Axis of the map that goes to the right.
        y: Axis of the map that goes up.
        levels: Of the contours, in the field's unit, or about how many.
        bar: Draw the colour bar.
        ax: Axes to draw into; by default those of a new figure.
        **selection: A value for each other axis of the map, of which the nearest grid point is taken.

    Returns:
        The axes.

    Raises:
        ValueError: Naming the axis or field, for what the dataset does not hold, an axis that is left over, or a value
            outside of the grid.
    """
    plane = at_selection(dataset, quantity, (x, y), selection)
    ax = axes_or_new(ax, (7.0, 5.0))
    across, along = values_of(plane[x]), values_of(plane[y])
    values = np.asarray(plane[quantity].transpose(y, x))
    if quantity in CODES:
        _draw_codes(ax, across, along, values, quantity)
    else:
        gaps, shown = _gaps(plane, quantity, x, y), bar and label_of(plane[quantity])
        _draw_figures(ax, across, along, values.astype(float), gaps, quantity, levels, shown)
    for axis, array in ((ax.xaxis, plane[x]), (ax.yaxis, plane[y])):
        axis.set_label_text(label_of(array))
        if unit_of(array) == DEGREES:
            axis.set_major_locator(MaxNLocator(steps=ROUND_ANGLES))
        elif axis is ax.xaxis:
            axis.set_major_locator(MaxNLocator(TICKS, steps=ROUND_NUMBERS))
    to_scale = unit_of(plane[x]) == unit_of(plane[y]) in TO_SCALE
    ax.set(aspect="equal" if to_scale else "auto", title=place_of(plane))
    ax.set(xlim=np.sort(across)[[0, -1]], ylim=np.sort(along)[[0, -1]])
    return ax


def at_selection(dataset: "xr.Dataset", quantity: str, kept: tuple[str, ...], selection: dict[str, float]) -> "xr.Dataset":
    """The part of a map with these axes only: the others at the grid points nearest to their values.

    Raises ValueError, naming the axis or field, for what the dataset does not hold, an axis that is left over, or a value
    outside of the grid.
    """
    if quantity not in dataset.data_vars:
        raise ValueError(f"{quantity!r} is not in the map (it holds {', '.join(map(str, dataset.data_vars)) or 'nothing'})")
    if len(set(kept)) < len(kept):
        raise ValueError(f"the axis {kept[0]} is asked for twice (expected two axes of the map)")
    axes = [str(name) for name in dataset[quantity].dims]
    for name in (*kept, *selection):
        if name not in axes:
            raise ValueError(f"{name!r} is not an axis of {quantity} (expected one of {', '.join(axes) or 'none'})")
    for name in kept:
        if name in selection:
            raise ValueError(f"{name} is an axis of the picture (expected no value for it)")
        if dataset.sizes[name] < 2:
            raise ValueError(f"{name} has {dataset.sizes[name]} grid point (expected at least 2)")
    for name in axes:
        values = np.sort(np.asarray(dataset[name], float))
        extent = f"from {values[0]:g} to {values[-1]:g}"
        if name not in (*kept, *selection):
            raise ValueError(f"no value for the axis {name} (expected one {extent})")
        step = np.diff(values).max(initial=0)
        if name in selection and not values[0] - step <= selection[name] <= values[-1] + step:
            raise ValueError(f"{name} = {selection[name]:g} is not on the grid (expected {extent})")
    return dataset.sel(selection, method="nearest")


def _gaps(plane: "xr.Dataset", quantity: str, x: str, y: str) -> dict[str, Bool[np.ndarray, "n m"]]:
    """Where the field is no number, and why."""
    missing = np.isnan(np.asarray(plane[quantity].transpose(y, x), float))
    why = "no stop" if quantity in ("distance", "time") else "no value"
    undecided, still = np.zeros_like(missing), np.zeros_like(missing)
    if "status" in plane and set(plane["status"].dims) == {x, y}:
        status = np.asarray(plane["status"].transpose(y, x))
        undecided = missing & np.isin(status, [Status.MAX_STEPS, Status.NONFINITE])
        still = status == Status.NO_DIRECTION
    elif "speed" in plane[quantity].coords:
        still = np.asarray((plane["speed"] == 0).broadcast_like(plane[quantity]).transpose(y, x))
    still = still & missing & (why == "no value")
    return {"undecided": undecided, "at rest": still, why: missing & ~undecided & ~still}


def _draw_figures(
    ax: Axes,
    across: Float[np.ndarray, " m"],
    along: Float[np.ndarray, " n"],
    values: Float[np.ndarray, "n m"],
    gaps: dict[str, Bool[np.ndarray, "n m"]],
    quantity: str,
    levels: int | Sequence[float] | None,
    bar: str | Literal[False],
) -> None:
    """Contours of the figures, hatches where they are infinite or none. bar: what it says."""
    finite = values[np.isfinite(values)]
    endless = np.isposinf(values)
    signs: dict[str, tuple[Any, dict[str, Any]]] = {
        ENDLESS.get(quantity, "at any speed"): (endless, {"facecolor": "#fff7dc", "edgecolor": ORANGE, "hatch": "//"})
    }
    style_of = lambda why: {"facecolor": "white", "edgecolor": GREY, "hatch": HATCHES.get(why, "..")}
    signs |= {why: (where, style_of(why)) for why, where in gaps.items()}
    handles: list[Artist] = []
    for why, (where, style) in signs.items():
        if not where.any():
            continue
        # every cell that touches such a point: contours of the rest leave them out
        touched = where.astype(float), [1e-9, 1]
        area = ax.contourf(across, along, *touched, colors=[style["facecolor"]], hatches=[style["hatch"]], zorder=1)
        area.set(edgecolor=style["edgecolor"], linewidth=0)
        handles.append(Patch(label=why, linewidth=0, **style))
    if len(finite):
        edges, extend = _levels(finite, levels)
        shown = np.ma.masked_invalid(values)
        filled = ax.contourf(across, along, shown, edges, cmap="cividis", extend=extend, zorder=2)
        if bar:
            ax.figure.colorbar(filled, cax=ax.inset_axes(BESIDE), label=bar)
        thin = edges[edges != 0]
        ax.contour(across, along, shown, thin, colors="white", linewidths=0.5, negative_linestyles="dashed", zorder=3)
        border, said = BORDERS.get(quantity, (0.0, ""))
        if said and finite.min() <= border <= finite.max():
            _thick(ax, across, along, shown, border)
            handles.append(Line2D([], [], color="black", linewidth=THICK, label=said))
        elif not said and (finite <= 0).any() and (values > 0).any():
            handles += _draw_zero(ax, across, along, values)
    if handles:
        ax.legend(handles=handles, loc="upper right", framealpha=0.9).set_zorder(8)


def _draw_zero(
    ax: Axes, across: Float[np.ndarray, " m"], along: Float[np.ndarray, " n"], values: Float[np.ndarray, "n m"]
) -> list[Patch]:
    """The zero level. Of a field that is nowhere negative, the area where it is zero, with what the legend says of it."""
    never_negative = np.nanmin(values) == 0
    signed = _continued(values) if never_negative else values
    signed = np.ma.masked_invalid(np.where(np.isposinf(values), 1.0, signed))
    if never_negative:
        ax.contourf(across, along, signed, [-np.inf, 0], colors=[EMPTY], zorder=3)
    handles = [Patch(facecolor=EMPTY, label="zero")] if never_negative else []
    _thick(ax, across, along, signed, 0)
    return handles


def _thick(
    ax: Axes, across: Float[np.ndarray, " m"], along: Float[np.ndarray, " n"], values: Float[np.ndarray, "n m"], level: float
) -> None:
    """The level where the verdict flips."""
    line = ax.contour(across, along, values, [level], colors="black", linewidths=THICK, zorder=4)
    line.set_path_effects([*halo(4)])


def _continued(values: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n m"]:
    """A field that is nowhere negative, its zeros replaced by what the neighbours on either side, continued in a straight
    line, would have there: so its zero level is as straight as the field, and does not leave the cell that it is in.

    Where that would not be negative, as at a jump, the level is in the middle between the grid points.
    """
    finite = np.where(np.isfinite(values), values, 0)
    total, neighbours = np.zeros_like(finite), np.zeros_like(finite)
    for axis in (0, 1):
        for step in (1, -1):
            near, far = (_shifted(finite, n * step, axis) for n in (1, 2))
            beyond = np.where((far > 0) & (2 * near < far), 2 * near - far, -near)
            total += np.where(near > 0, beyond, 0)
            neighbours += near > 0
    return np.where(values == 0, np.where(neighbours > 0, total / np.maximum(neighbours, 1), -1), values)


def _shifted(values: Float[np.ndarray, "n m"], step: int, axis: int) -> Float[np.ndarray, "n m"]:
    """The values `step` grid points further on, zero beyond the edge."""
    out = np.roll(values, -step, axis)
    edge = [slice(None)] * 2
    edge[axis] = slice(-step, None) if step > 0 else slice(None, -step)
    out[tuple(edge)] = 0
    return out


def _levels(finite: Float[np.ndarray, " k"], levels: int | Sequence[float] | None) -> tuple[Float[np.ndarray, " l"], Beyond]:
    """Levels of the contours that surround the figures, and on which side figures lie beyond."""
    if levels is not None and not isinstance(levels, int):
        edges = np.asarray(levels, float)
    else:
        low, high = finite.min(), finite.max()
        most, least = np.quantile(finite, [OUTLIERS, 1 - OUTLIERS])
        high = most if high > FAR * most > 0 else high
        low = least if low < FAR * least < 0 else low
        low, high = (low, high) if low < high else (low - 0.5, high + 0.5)
        edges = np.asarray(MaxNLocator(levels or LEVELS).tick_values(low, high))
    below, above = bool(finite.min() < edges[0]), bool(finite.max() > edges[-1])
    return edges, "both" if below and above else "min" if below else "max" if above else "neither"


def _draw_codes(
    ax: Axes,
    across: Float[np.ndarray, " m"],
    along: Float[np.ndarray, " n"],
    values: Shaped[np.ndarray, "n m"],
    quantity: str,
) -> None:
    """Areas of one colour for each code, with a legend of those that occur."""
    codes = CODES[quantity]
    numbers = sorted(int(code) for code in codes)
    colours = [codes[code][1] for code in sorted(codes)]
    norm = BoundaryNorm(np.arange(numbers[0], numbers[-1] + 2) - 0.5, len(numbers))
    cmap = ListedColormap(colours)
    ax.pcolormesh(across, along, values.astype(int), cmap=cmap, norm=norm, shading="nearest", rasterized=True)
    present = [code for code in sorted(codes) if (values.astype(int) == int(code)).any()]
    handles = [Patch(facecolor=codes[code][1], edgecolor=DARK, linewidth=0.5, label=codes[code][0]) for code in present]
    ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1), borderaxespad=0)
