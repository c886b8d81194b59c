"""A scored log over time: margin, how each state ends, which contacts there are; episodes side by side."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from jaxcap.files.fields import CASES
from jaxcap.one_state.result import Case
from jaxcap.plotting.style import BLUE, DARK, GREY, ORANGE, PALE, RED

COLORS = {
    Case.C1: RED,
    Case.C2: "#c04a20",
    Case.C3_1: BLUE,
    Case.C3_2_1: "#4a90c0",
    Case.C3_2_2: ORANGE,
    Case.C3_3: "#90c0e0",
    Case.EMPTY: DARK,
    Case.UNDECIDED: GREY,
}
"""Of cases: capturable ones are blue."""


def timeline(
    scores: Mapping[str, Any],
    patches: Mapping[str, int] | None = None,
    axes: tuple[Axes, Axes, Axes] | None = None,
) -> tuple[Axes, Axes, Axes]:
    """Draws margin, case and contacts of the rows of a scored log over time, with the episodes marked.

    Args:
        scores: Columns of what `jaxcap score` wrote of a log, arrays (n,): `margin` [m/s] and `case`; `t` [s] and `episode`
            if they are there (else rows are counted); and `contact_mask` (n, k) for the contacts.
        patches: Names of patches and how many contacts each has, in the order of the columns of `contact_mask`; by default
            contacts are numbered.
        axes: Three, from top to bottom; by default of a new figure.

    Returns:
        The axes of margin, case and contacts.

    Raises:
        ValueError: If a column is missing or of another length, or patches do not fit.
    """
    columns = {name: np.asarray(scores[name]) for name in ("margin", "case") if name in scores}
    if len(columns) < 2 or len(columns["margin"]) != len(columns["case"]):
        raise ValueError(f"scores has the columns {', '.join(scores)} (expected 'margin' and 'case', of one length)")
    rows = len(columns["margin"])
    named = np.asarray(scores["episode"]) if "episode" in scores else np.full(rows, "")
    time = _in_a_row(np.asarray(scores["t"], float) if "t" in scores else np.arange(rows, dtype=float), named)
    mask = np.asarray(scores.get("contact_mask", np.zeros((rows, 0))), dtype=bool)
    margin_axes, case_axes, contact_axes = axes or _new()
    _margin(margin_axes, time, columns["margin"].astype(float))
    _bands(case_axes, time, columns["case"])
    _contacts(contact_axes, time, mask, patches)
    for axis in (margin_axes, case_axes, contact_axes):
        for row in np.flatnonzero(named[1:] != named[:-1]):
            axis.axvline((time[row] + time[row + 1]) / 2, color=DARK, linewidth=0.8, linestyle=":", gid="episode")
        axis.set_xlim(*_ends(time))
    contact_axes.set_xlabel("time [s]" if "t" in scores else "row")
    return margin_axes, case_axes, contact_axes


def _new() -> tuple[Axes, Axes, Axes]:
    figure = Figure(figsize=(7.2, 4.8), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(4, 1, 1.6))
    return top, middle, bottom


def _ends(time: Float[np.ndarray, " n"]) -> tuple[float, float]:
    return (float(time[0]), float(time[-1])) if len(time) > 1 else (-0.5, 0.5)


def _in_a_row(time: Float[np.ndarray, " n"], named: np.ndarray) -> Float[np.ndarray, " n"]:
    """Times that go on from episode to episode, each of which begins at its own zero."""
    time = time.copy()
    for start in np.flatnonzero(named[1:] != named[:-1]) + 1:
        step = time[start - 1] - time[start - 2] if start > 1 else 1.0
        time[start:] += time[start - 1] + step - time[start]
    return time


def _margin(axes: Axes, time: Float[np.ndarray, " n"], margin: Float[np.ndarray, " n"]) -> None:
    """The margin, filled towards zero; where it is infinite or no number there is a gap."""
    shown = np.where(np.isfinite(margin), margin, np.nan)
    axes.axhline(0, color=DARK, linewidth=0.8)
    axes.fill_between(time, shown, 0, where=shown >= 0, color=PALE, linewidth=0)
    axes.fill_between(time, shown, 0, where=shown < 0, color="#f2d9d0", linewidth=0)
    axes.plot(time, shown, color=BLUE, linewidth=1.2)
    axes.set_ylabel("margin [m/s]")
    axes.set_title("can it still stop, without a step?", loc="left", fontsize="medium")


def _bands(axes: Axes, time: Float[np.ndarray, " n"], case: np.ndarray) -> None:
    """How each state ends, as a band of colours."""
    present = [one for one in COLORS if (case == one).any()]
    places = np.array([present.index(Case(int(one))) for one in case]).reshape(1, -1)
    if places.size:
        shades = ListedColormap([COLORS[one] for one in present])
        axes.pcolormesh(_edges(time), [0, 1], places, cmap=shades, vmin=-0.5, vmax=len(present) - 0.5)
    for one in present:
        axes.plot([], [], "s", color=COLORS[one], label=f"{one.name}: {CASES[one]}")
    if present:
        axes.legend(fontsize="x-small", ncols=2, loc="lower left", bbox_to_anchor=(0, 1), frameon=False, borderaxespad=0.1)
    axes.set_yticks([])
    axes.set_ylabel("case")


def _contacts(
    axes: Axes, time: Float[np.ndarray, " n"], mask: Bool[np.ndarray, "n k"], patches: Mapping[str, int] | None
) -> None:
    """Which patches touch: dark with all contacts, pale with some."""
    sizes = {f"{i}": 1 for i in range(mask.shape[1])} if patches is None else dict(patches)
    if sum(sizes.values()) != mask.shape[1]:
        raise ValueError(f"patches have {sum(sizes.values())} contacts (expected {mask.shape[1]}, as contact_mask has)")
    ends = np.cumsum(list(sizes.values()), dtype=int)
    shares = [mask[:, end - size : end].mean(axis=1) for end, size in zip(ends, sizes.values(), strict=True)]
    if shares and len(time):
        shades = ListedColormap(["white", "#9ab8d0", DARK])
        level = np.stack([np.where(share == 0, 0, np.where(share < 1, 1, 2)) for share in shares])
        axes.pcolormesh(_edges(time), np.arange(len(sizes) + 1), level, cmap=shades, vmin=-0.5, vmax=2.5)
    axes.set_yticks(np.arange(len(sizes)) + 0.5, list(sizes), fontsize="small")
    axes.set_ylabel("contacts")


def _edges(time: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n+1"]:
    """Between the rows, and half a step beyond the first and the last."""
    if len(time) == 1:
        return np.array([time[0] - 0.5, time[0] + 0.5])
    middle = (time[1:] + time[:-1]) / 2
    return np.concatenate([[2 * time[0] - middle[0]], middle, [2 * time[-1] - middle[-1]]])
