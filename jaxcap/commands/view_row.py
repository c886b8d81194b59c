"""What `jaxcap view` draws of one row, as numbers."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import jaxcap

PYRAMID = 0.12
"""Height of the pyramids of friction that are drawn [m]."""
AHEAD = 0.3
"""Velocities are drawn as the way of this time [s]."""
HEADINGS = 72
"""Directions of the velocity area."""
FASTEST = 3.0
"""The area is cut there [m/s]."""
FACES = 256
"""Cones are padded to this many faces, or a multiple, so that rows share a program."""


class Scene(NamedTuple):
    """What is drawn of one row. World frame."""

    rotations: Float[np.ndarray, "j 3 3"]
    """Of the frames of all joints, the world first."""
    positions: Float[np.ndarray, "j 3"]
    """[m]"""
    rods: Float[np.ndarray, "b 2 3"]
    """From each joint to the one that carries it [m]."""
    pyramids: Float[np.ndarray, "e 2 3"]
    """Edges of the pyramids of the contacts that touch [m]."""
    arrow: Float[np.ndarray, "1 2 3"]
    """The CoM, and where it is soon [m]."""
    area: Float[np.ndarray, "s 2 3"]
    """Outline of the horizontal velocities that can be stopped, around the CoM, as far as the arrow is long [m]."""
    capturable: bool | None
    """None where it was not scored."""
    words: str


def scene(model: Any, columns: dict[str, np.ndarray], row: int, area: bool = False) -> Scene:
    """What is drawn of a row.

    Args:
        model: Pinocchio's.
        columns: Those of the file of states or scores.
        row: Its number.
        area: With the velocity area, which is computed here.
    """
    from jaxcap.robots.tree import links

    found = links(model, columns["configuration"][row : row + 1], np.zeros((1, model.nv)))
    positions = np.array([link.position[:, 0] for link in found])
    rods = np.array([(positions[model.parents[i]], positions[i]) for i in range(2, model.njoints)]).reshape(-1, 2, 3)
    com, velocity = columns["com"][row], columns["com_velocity"][row]
    return Scene(
        rotations=np.array([link.rotation[..., 0] for link in found]),
        positions=positions,
        rods=rods,
        pyramids=_pyramids(columns, row),
        arrow=np.array([[com, com + AHEAD * velocity]]),
        area=_area(columns, row) if area else np.zeros((0, 2, 3)),
        capturable=bool(columns["capturable"][row]) if "capturable" in columns else None,
        words=_words(columns, row),
    )


def _words(columns: dict[str, np.ndarray], row: int) -> str:
    words = f"{columns['t'][row]:.2f} s" if "t" in columns else f"row {row}"
    return words + (f", margin {columns['margin'][row]:+.2f} m/s" if "margin" in columns else "")


def _pyramids(columns: dict[str, np.ndarray], row: int) -> Float[np.ndarray, "e 2 3"]:
    """Four edges of each contact that touches, along the corners of its cone."""
    touching = columns["contact_mask"][row].astype(bool)
    points, frames = columns["contact_points"][row][touching], columns["contact_frames"][row][touching]
    slope = columns["contact_friction"][row][touching] / np.sqrt(2)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    local = np.concatenate([corners * slope[:, None, None], np.ones((len(points), 4, 1))], axis=2) * PYRAMID
    ends = points[:, None] + np.einsum("kij,kcj->kci", frames, local)
    return np.stack([np.broadcast_to(points[:, None], ends.shape), ends], axis=2).reshape(-1, 2, 3)


def _area(columns: dict[str, np.ndarray], row: int) -> Float[np.ndarray, "s 2 3"]:
    """The velocity area's outline; nothing where no contact touches, or the cone has no faces."""
    touching = columns["contact_mask"][row].astype(bool)
    if not touching.any():
        return np.zeros((0, 2, 3))
    contacts = (columns[f"contact_{name}"][row][touching] for name in ("points", "frames", "friction"))
    try:
        cone = jaxcap.centroidal_cone(jaxcap.ContactSet(*contacts))
    except ValueError:  # contacts of a file that someone else wrote, or faces that do not pass their check
        return np.zeros((0, 2, 3))
    cone, com = cone.padded(FACES * -(-cone.faces.shape[0] // FACES)), columns["com"][row]
    found = jaxcap.velocity_area(cone, com, jaxcap.headings(HEADINGS))
    lines = [np.column_stack([AHEAD * line, np.zeros(len(line))]) + com for line in found.outline(FASTEST)]
    return np.concatenate([np.stack([line, np.roll(line, -1, axis=0)], axis=1) for line in lines] or [np.zeros((0, 2, 3))])
