"""The stance in space: contacts, friction pyramids, support polygon, CoM and its velocity."""

import numpy as np
from jaxtyping import Float
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from jaxcap.contacts.cone import centroidal_cone
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.friction import pyramid_edges
from jaxcap.plotting.footprint import patches
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
TALLEST = 1.5
"""Half width of a pyramid, relative to its height, beyond which it is drawn smaller."""


def stance(
    contacts: ContactSet,
    com=None,
    com_velocity=None,
    *,
    sides: int = 4,
    scale: float = 0.35,
    ax: Axes3D | None = None,
) -> Axes3D:
    """The contacts with their friction pyramids, the support polygon on the level of the lowest contact, and the CoM.

    contacts: one set; masked contacts are left out. com: (3,) [m]. com_velocity: (3,) [m/s], an arrow of `scale` [m per
    m/s]. sides: edges of the friction pyramids. Gravity is along -z. The support polygon holds the horizontal positions
    at which a CoM can stand; there is none for contacts that cannot carry the robot. Where it goes far beyond contacts and
    CoM, or on for ever, it is cut, has no edge, and the legend says so.

    Returns the axes, in three dimensions. Raises ValueError for a set without active contact, or values that are not finite.
    """
    cone = centroidal_cone(contacts, sides)
    ax = axes_or_new(ax, (6.4, 6.0), "3d")
    active = np.asarray(contacts.mask)
    fields = contacts.points, contacts.frames, contacts.friction
    points, frames, friction = (np.asarray(field, float)[active] for field in fields)
    com = None if com is None else _vector("com", com)
    tip = None if com is None or com_velocity is None else com + scale * _vector("com_velocity", com_velocity)
    shown = np.stack([*points, *(point for point in (com, tip) if point is not None)])
    size = max(SMALLEST, np.ptp(shown, axis=0).max())
    low, high = shown.min(axis=0), shown.max(axis=0)
    ground = points[:, 2].min()

    (left, front), (right, back) = low[:2] - AROUND * size, high[:2] + AROUND * size
    support = support_polygon(cone)
    bounds = support.offsets + support.normals @ support.origin
    region = clipped((left, right, front, back), support.normals, bounds) if not support.empty else np.zeros((0, 2))
    if len(region):
        cut = np.isclose(region, [left, front]).any() or np.isclose(region, [right, back]).any()
        name = "support polygon, goes on" if cut else "support polygon"
        region = np.column_stack([region, np.full(len(region), ground)])
        low, high = np.minimum(low, region.min(axis=0)), np.maximum(high, region.max(axis=0))
        _faces(ax, [region], facecolor=BLUE, edgecolor=BLUE, alpha=0.2, linewidth=0 if cut else 1.5, label=name)
    _faces(ax, _pyramids(contacts, points, frames, friction, sides, PYRAMID * size), facecolor=ORANGE, edgecolor=ORANGE,
           alpha=0.3, linewidth=0.5, label="friction pyramids")
    soles = [corners for corners in patches(contacts) if len(corners) > 1]
    if soles:
        _faces(ax, soles, facecolor=DARK, edgecolor=DARK, alpha=0.75, linewidth=1.0, label="contacts")
    ax.scatter(*points.T, s=8, color=DARK, depthshade=False, label=None if soles else "contacts")
    if com is not None:
        ax.plot(*np.stack([com, [*com[:2], ground]]).T, color=GREY, linewidth=1.2, linestyle="--")
        ax.scatter(*[[x] for x in (*com[:2], ground)], s=25, color=GREY, marker="x", depthshade=False)
        ax.scatter(*[[x] for x in com], s=70, color="white", edgecolor=RED, linewidth=2, depthshade=False, label="CoM")
    if tip is not None:
        speed = np.linalg.norm(tip - com) / scale
        ax.quiver(*com, *(tip - com), color=RED, linewidth=2.5, arrow_length_ratio=0.25, label=f"velocity, {speed:.2f} m/s")
    middle, half = (low + high) / 2, np.maximum((high - low) / 2 * ROOM, size * THINNEST / 2)
    for axis, name, centre, reach in zip((ax.xaxis, ax.yaxis, ax.zaxis), "xyz", middle, half, strict=True):
        ax.set(**{f"{name}lim": (centre - reach, centre + reach), f"{name}label": f"{name} [m]"})
        ticks = MaxNLocator(max(4, round(5 * reach / half.max()))).tick_values(centre - reach, centre + reach)
        axis.set_ticks(ticks[np.abs(ticks - centre) < (1 if name == "z" else 1 - CORNER) * reach])
        axis.labelpad = LABELS
    ax.set_aspect("equal")
    ax.legend(loc="upper left", bbox_to_anchor=(-0.12, 1.05))
    return ax


def _pyramids(contacts: ContactSet, points, frames, friction, sides: int, height: float) -> list[Float[np.ndarray, "3 3"]]:
    """The sides of the friction pyramids of active contacts; small on a small hand, so that they stand apart."""
    sizes = [np.linalg.norm(corners[0] - corners[1:], axis=1).max(initial=0) for corners in patches(contacts)]
    sizes = np.repeat(sizes, [len(corners) for corners in patches(contacts)])
    heights = np.where(sizes > 0, np.minimum(height, sizes / 2), height) / np.maximum(1, friction / TALLEST)
    around = points[:, None] + heights[:, None, None] * pyramid_edges(frames, friction, sides)
    sides_of = lambda point, tips: [np.stack([point, tips[j], tips[j - 1]]) for j in range(sides)]
    return [side for point, tips in zip(points, around, strict=True) for side in sides_of(point, tips)]


def _faces(ax: Axes3D, polygons: list[Float[np.ndarray, "c 3"]], **style) -> None:
    """Polygons in space. Thin ones are seen by their edge."""
    ax.add_collection3d(Poly3DCollection(polygons, **style))


def _vector(name: str, value) -> Float[np.ndarray, "3"]:
    vector = np.asarray(value, float)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{name} = {value} (expected 3 finite numbers)")
    return vector
