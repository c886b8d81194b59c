"""Friction cone -> pyramid edges -> wrench rays."""

import math
from typing import Any

from jaxtyping import Float

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import FloatArray

STICKIEST = 1e4
"""A larger coefficient counts as this: edges closer to the tangent plane would lose their normal part to rounding."""


def pyramid_edges(
    frames: Float[FloatArray, "*batch k 3 3"], friction: Float[FloatArray, "*batch k"], sides: int
) -> Float[FloatArray, "*batch k {sides} 3"]:
    """Edges of the pyramids inscribed in the friction cones (4), (5), not normalised: each has normal component 1.

    Args:
        frames: (..., k, 3, 3) rotations, columns tangent, tangent, normal.
        friction: (..., k), > 0; at most STICKIEST counts.
        sides: edges of each pyramid, >= 3.

    Returns:
        (..., k, sides, 3). Edge j stands at the angle pi/sides + 2 pi j/sides from the first tangent; with 4 sides the
        pyramid's faces are aligned with the tangents.

    Raises:
        ValueError: if sides < 3.
    """
    if sides < 3:
        raise ValueError(f"sides = {sides} (expected at least 3)")
    xp: Any = frames.__array_namespace__()
    angles = [math.pi / sides + 2 * math.pi * j / sides for j in range(sides)]
    around = xp.asarray([[math.cos(a), math.sin(a)] for a in angles], dtype=frames.dtype)
    tangents, normal = frames[..., :2], frames[..., None, :, 2]
    friction = xp.minimum(friction, STICKIEST)
    return normal + friction[..., None, None] * xp.einsum("sa,...ia->...si", around, tangents)


def wrench_rays(
    contacts: ContactSet, sides: int, origin: Float[FloatArray, "*batch 3"]
) -> Float[FloatArray, "*batch rays 6"]:
    """Rays (f, (p - origin) x f) that span the centroidal cone: the generators of (6), with unit forces.

    Args:
        contacts: one set, or a batch.
        sides: edges of each friction pyramid, >= 3.
        origin: (..., 3), the point that torques are taken about [m].

    Returns:
        (..., k * sides, 6): force [-] of unit length, torque [m]; contact by contact, edge by edge. Rays of masked contacts
        are zero.

    Raises:
        ValueError: if sides < 3.
    """
    forces = pyramid_edges(contacts.frames, contacts.friction, sides)
    xp: Any = forces.__array_namespace__()
    forces = forces / xp.linalg.norm(forces, axis=-1, keepdims=True)
    arms = (contacts.points - origin[..., None, :])[..., None, :]
    rays = xp.concatenate([forces, xp.cross(xp.broadcast_to(arms, forces.shape), forces)], axis=-1)
    rays = xp.where(contacts.mask[..., None, None], rays, 0)
    return rays.reshape(*rays.shape[:-3], rays.shape[-3] * sides, 6)
