"""How hard a push in the worst direction: the largest ball of velocities that are all capturable.

Found by a search that needs no gradient, since the largest speed has kinks where the case or the active faces change: a grid
all around, then patches that close in on the weakest directions of the grid, slowly and turning, so that they can slide
along a kink. All patches are scored as one batch, of the same size as the grid.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Num

from jaxcap.batch.score import score
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, FloatArray, checked_gravity
from jaxcap.one_state.capturability import capturability
from jaxcap.regions.velocity_area import headings, sphere

STARTS = 8
"""Directions that are followed, the weakest of the grid that are `APART`."""
APART = 0.25
"""Angle between two of them, at least, and half the width of the first patches [rad]: three times the grid's spacing."""
SIDE = 15
"""Directions along the side of a patch on the sphere; a patch on the circle of headings has as many in a row as that one has
in all."""
KEPT = 3
"""The next patch is as wide as this many of the directions to each side of the weakest."""
TURN = np.pi * (3 - np.sqrt(5))
"""From one patch to the next, the golden angle [rad]: no line through the weakest direction is looked along twice."""


class Robustness(NamedTuple):
    """The weakest direction of a CoM."""

    speed: Float[Array, ""]
    """Any velocity up to this, whatever its direction, is capturable [m/s]; times the robot's mass, the impulse [N s] that
    it takes in any direction. Zero where the CoM is not in static equilibrium, infinite where the contacts stop everything,
    NaN where the state is not finite or a direction is undecided."""
    direction: Float[Array, "3"]
    """Unit vector of the direction with that largest speed; NaN where there is none: from a CoM that is not in static
    equilibrium the robot falls without a push."""


def robustness(
    cone: CentroidalCone | ConeRays, com: Num[FloatArray, "3"], horizontal: bool = False, gravity: ArrayLike = GRAVITY
) -> Robustness:
    """The smallest `max_speed` over all directions, and its direction.

    All in the contacts' frame, z up. The dtype of `com` decides the precision. Pure: works under jit, vmap and grad; the
    gradient of `speed` is that of `max_speed` in the weakest direction (`direction` has none).

    Args:
        cone: from `centroidal_cone` or `cone_rays`.
        com: (3,) [m].
        horizontal: only pushes along the ground count.
        gravity: (3,) [m/s^2].

    Returns:
        The direction, good to the root of the dtype's rounding error, and the speed, which is flat there, to about that
        error. A CoM that is not in static equilibrium has speed zero: on a line that misses every place to stand no speed
        is capturable, and there is such a line through it.

    Raises:
        TypeError: for a wrong shape.
        ValueError: for gravity that is not finite.
    """
    checked_gravity(gravity)
    com = jnp.asarray(com)
    if com.shape != (3,):
        raise TypeError(f"com has shape {com.shape} (expected (3,); `jax.vmap` takes many)")
    com = com.astype(jnp.promote_types(com.dtype, jnp.float32))
    weakest = _weakest(*jax.lax.stop_gradient((cone, com)), horizontal, gravity)
    largest = capturability(cone, com, weakest, gravity).max_speed
    standing = capturability(cone, com, jnp.zeros_like(com), gravity).capturable
    speed = jnp.where(standing | jnp.isnan(largest), largest, 0)
    return Robustness(speed, jnp.where(standing & jnp.isfinite(largest), weakest, jnp.nan))


Patches = tuple[Float[Array, "starts size 3"], Float[Array, "starts 3"], Float[Array, " starts"]]
"""Directions to look at next; the weakest of each patch so far, and its largest speed."""


@jax.jit
def _weakest(
    cone: CentroidalCone | ConeRays, com: Float[Array, "3"], horizontal: Bool[Array, ""], gravity: ArrayLike
) -> Float[Array, "3"]:
    """The direction with the smallest `max_speed`, or one that is undecided."""
    size, dtype = SIDE * SIDE, com.dtype
    along, side = jnp.linspace(-1, 1, size, dtype=dtype), jnp.linspace(-1, 1, SIDE, dtype=dtype)
    row = jnp.stack([along, jnp.zeros_like(along)], axis=1)
    square = jnp.stack(jnp.meshgrid(side, side), axis=-1).reshape(-1, 2)
    shrink = 2 * KEPT / (jnp.where(horizontal, size, SIDE) - 1)
    finest = np.sqrt(jnp.finfo(dtype).eps)
    rounds = jnp.ceil(jnp.log(finest / APART) / jnp.log(shrink)).astype(jnp.int32)

    def closer(step: Int[Array, ""], found: Patches) -> Patches:
        """Looks at the patches, and lays smaller ones around the weakest direction of each."""
        patches, *_ = found
        directions = patches.reshape(-1, 3)
        speeds = score(cone, jnp.broadcast_to(com, directions.shape), directions, gravity).max_speed
        best = jnp.argmin(speeds.reshape(STARTS, size), axis=1) + size * jnp.arange(STARTS)  # NaN counts as the smallest
        best = jnp.where(step == 0, _apart(directions, speeds), best)  # at first the patches are the grid
        offsets = jnp.where(horizontal, row, square @ _rotation(TURN * step, dtype))
        half_width = (APART * shrink**step).astype(dtype)
        return _around(directions[best], half_width * offsets), directions[best], speeds[best]

    grid = jnp.where(horizontal, headings(STARTS * size), sphere(STARTS * size)).astype(dtype)
    start = grid.reshape(STARTS, size, 3), jnp.zeros((STARTS, 3), dtype), jnp.zeros(STARTS, dtype)
    _, directions, speeds = jax.lax.fori_loop(0, rounds + 2, closer, start)
    return directions[jnp.argmin(speeds)]


def _apart(directions: Float[Array, "n 3"], speeds: Float[Array, " n"]) -> Int[Array, " starts"]:
    """The weakest direction, the weakest of those far enough from it, and so on."""
    found: list[Array] = []
    for _ in range(STARTS):
        found.append(jnp.argmin(speeds))
        near = directions @ directions[found[-1]] > np.cos(APART)
        speeds = jnp.where(near, jnp.inf, speeds)
    return jnp.stack(found)


def _around(centres: Float[Array, "starts 3"], offsets: Float[Array, "size 2"]) -> Float[Array, "starts size 3"]:
    """Unit vectors at these offsets, along and up, in the planes that touch the sphere at the centres."""
    upright = jnp.abs(centres[:, 2:]) < 0.9
    up = jnp.where(upright, jnp.array([0, 0, 1], centres.dtype), jnp.array([1, 0, 0], centres.dtype))
    along = jnp.cross(up, centres)
    along = along / jnp.linalg.norm(along, axis=1, keepdims=True)
    tangents = jnp.stack([along, jnp.cross(centres, along)], axis=1)
    moved = centres[:, None] + jnp.einsum("so,poi->psi", offsets, tangents)
    return moved / jnp.linalg.norm(moved, axis=-1, keepdims=True)


def _rotation(angle: Float[Array, ""], dtype: np.dtype) -> Float[Array, "2 2"]:
    """In the plane, (2, 2)."""
    cos, sin = jnp.cos(angle).astype(dtype), jnp.sin(angle).astype(dtype)
    return jnp.stack([jnp.stack([cos, sin]), jnp.stack([-sin, cos])])
