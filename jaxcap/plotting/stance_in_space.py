"""The stance in space: contacts, friction pyramids, support polygon, CoM and its velocity."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from jaxcap.contacts.cone import CentroidalCone, centroidal_cone
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import ArrayLike
from jaxcap.contacts.friction import pyramid_edges
from jaxcap.plotting.patches import patches
from jaxcap.plotting.region import clipped
from jaxcap.plotting.style import BLUE, DARK, GREY, ORANGE, RED, axes_or_new
from jaxcap.regions.support_polygon import support_polygon

PYRAMID = 0.07
"""Height of a friction pyramid, relative to the size of the picture."""
SMALLEST = 0.3
"""Least size of the picture [m]."""
AROUND = 0.6
"""A support polygon that goes on farther than this from contacts and CoM is cut, relative to the size of the picture."""
THINNEST, ROOM = 0.5, 1.1
"""Least side of the picture relative to its size; free space around what there is to see."""
LABELS = 7
"""Between the numbers and the name of an axis [points]."""
CORNER = 0.1
"""Share of x and y that has no numbers at either end, where those of the other stand."""
SMALLER = 0.85
"""Zoom in axes that were given: no layout may make room for the names of the axes, which then end outside of the figure."""
TALLEST = 1.5
"""Half width of a pyramid, relative to its height, beyond which it is drawn smaller."""


def stance(
    contacts: ContactSet,
    com: ArrayLike | None = None,
    com_velocity: ArrayLike | None = None,
    *,
    sides: int = 4,
    scale: float = 0.35,
    ax: Axes3D | None = None,
) -> Axes3D:
    """The contacts with their friction pyramids, the support polygon on the level of the lowest contact, and the CoM.

    Gravity is along -z. The support polygon holds the horizontal positions at which a CoM can stand; there is none for
    contacts that cannot carry the robot. Where it goes far beyond contacts and CoM, or on for ever, it is cut, has no edge,
    and the legend says so.

    Args:
        contacts: One set; masked contacts are left out.
        com: (3,) [m].
        com_velocity: (3,) [m/s], drawn as an arrow.
        sides: Edges of the friction pyramids.
        scale: Length of that arrow [m per m/s].
        ax: Axes to draw into, in three dimensions; by default those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For a set without active contact, or values that are not finite.
    """
    cone = centroidal_cone(contacts, sides)
    axes = ax if ax is not None else axes_or_new(None, (6.4, 6.0), "3d")
    if not isinstance(axes, Axes3D):
        raise ValueError(f"ax has the projection {getattr(ax, 'name', None)!r} (expected '3d')")
    active = np.asarray(contacts.mask)
    points = np.asarray(contacts.points, float)[active]
    place = None if com is None else _vector("com", com)
    tip = None if place is None or com_velocity is None else place + scale * _vector("com_velocity", com_velocity)
    shown = np.stack([*points, *(point for point in (place, tip) if point is not None)])
    size = max(SMALLEST, np.ptp(shown, axis=0).max())
    ground = points[:, 2].min()
    region, cut = _support(cone, shown, size, ground)
    if len(region):
        label = "support polygon, goes on" if cut else "support polygon"
        _faces(axes, [region], facecolor=BLUE, edgecolor=BLUE, alpha=0.2, linewidth=0 if cut else 1.5, label=label)
    _draw_contacts(axes, contacts, sides, size)
    if place is not None:
        _draw_state(axes, place, tip, ground, scale)
    _window(axes, np.concatenate([shown, region]), size, 1.0 if ax is None else SMALLER)
    axes.legend(loc="upper left", bbox_to_anchor=(-0.12, 1.05))
    return axes


def _support(
    cone: CentroidalCone, shown: Float[np.ndarray, "n 3"], size: float, ground: float
) -> tuple[Float[np.ndarray, "k 3"], bool]:
    """Vertices of the support polygon on the ground, perhaps none, and whether it is cut there."""
    (left, front), (right, back) = shown.min(axis=0)[:2] - AROUND * size, shown.max(axis=0)[:2] + AROUND * size
    support = support_polygon(cone)
    if support.empty:
        return np.zeros((0, 3)), False
    normals, offsets, origin = (np.asarray(field) for field in (support.normals, support.offsets, support.origin))
    region = clipped((left, right, front, back), normals, offsets + normals @ origin)
    cut = np.isclose(region, [left, front]).any() or np.isclose(region, [right, back]).any()
    return np.column_stack([region, np.full(len(region), ground)]), bool(cut)


def _draw_contacts(ax: Axes3D, contacts: ContactSet, sides: int, size: float) -> None:
    """Friction pyramids, feet and hands as areas, every contact as a dot."""
    style = {"facecolor": ORANGE, "edgecolor": ORANGE, "alpha": 0.3, "linewidth": 0.5, "label": "friction pyramids"}
    _faces(ax, _pyramids(contacts, sides, PYRAMID * size), **style)
    soles = [corners for corners in patches(contacts) if len(corners) > 1]
    if soles:
        _faces(ax, soles, facecolor=DARK, edgecolor=DARK, alpha=0.75, linewidth=1.0, label="contacts")
    points = np.asarray(contacts.points, float)[np.asarray(contacts.mask)]
    _dots(ax, points, s=8, color=DARK, label=None if soles else "contacts")


def _draw_state(
    ax: Axes3D, com: Float[np.ndarray, "3"], tip: Float[np.ndarray, "3"] | None, ground: float, scale: float
) -> None:
    """The CoM, where it is above the ground, and its velocity."""
    below = np.array([*com[:2], ground])
    ax.plot(*np.stack([com, below]).T, color=GREY, linewidth=1.2, linestyle="--")
    _dots(ax, below[None], s=25, color=GREY, marker="x")
    _dots(ax, com[None], s=70, color="white", edgecolor=RED, linewidth=2, label="CoM")
    if tip is not None:
        speed = np.linalg.norm(tip - com) / scale
        ax.quiver(*com, *(tip - com), color=RED, linewidth=2.5, arrow_length_ratio=0.25, label=f"velocity, {speed:.2f} m/s")


def _window(ax: Axes3D, shown: Float[np.ndarray, "n 3"], size: float, zoom: float) -> None:
    """Limits around what there is to see, to scale, with numbers that keep clear of each other. zoom: of the box."""
    low, high = shown.min(axis=0), shown.max(axis=0)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2 * ROOM, size * THINNEST / 2)
    for axis, name, centre, length in zip((ax.xaxis, ax.yaxis, ax.zaxis), "xyz", middle, half, strict=True):
        ax.set(**{f"{name}lim": (centre - length, centre + length), f"{name}label": f"{name} [m]"})
        ticks = MaxNLocator(max(4, round(5 * length / half.max()))).tick_values(centre - length, centre + length)
        axis.set_ticks(ticks[np.abs(ticks - centre) < (1 if name == "z" else 1 - CORNER) * length])
        axis.labelpad = LABELS
    ax.set_aspect("equal")
    ax.set_box_aspect(half, zoom=zoom)  # the same shape, smaller


def _pyramids(contacts: ContactSet, sides: int, height: float) -> list[Float[np.ndarray, "3 3"]]:
    """The sides of the friction pyramids of active contacts; small on a small hand, so that they stand apart."""
    active = np.asarray(contacts.mask)
    fields = contacts.points, contacts.frames, contacts.friction
    points, frames, friction = (np.asarray(field, float)[active] for field in fields)
    largest = [np.linalg.norm(corners[0] - corners[1:], axis=1).max(initial=0) for corners in patches(contacts)]
    sizes = np.repeat(largest, [len(corners) for corners in patches(contacts)])
    heights = np.where(sizes > 0, np.minimum(height, sizes / 2), height) / np.maximum(1, friction / TALLEST)
    around = points[:, None] + heights[:, None, None] * np.asarray(pyramid_edges(frames, friction, sides))
    sides_of = lambda point, tips: [np.stack([point, tips[j], tips[j - 1]]) for j in range(sides)]
    return [side for point, tips in zip(points, around, strict=True) for side in sides_of(point, tips)]


def _faces(ax: Axes3D, polygons: list[Float[np.ndarray, "c 3"]], **style: Any) -> None:
    """Polygons in space. Thin ones are seen by their edge."""
    ax.add_collection3d(Poly3DCollection(polygons, **style))


def _dots(ax: Axes3D, points: Float[np.ndarray, "n 3"], **style: Any) -> None:
    x, y, z = points.T
    ax.scatter(x, y, z, depthshade=False, **style)


def _vector(name: str, value: ArrayLike) -> Float[np.ndarray, "3"]:
    vector = np.asarray(value, float)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{name} = {value!r} (expected 3 finite numbers)")
    return vector
