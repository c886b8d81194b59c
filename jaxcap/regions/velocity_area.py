"""The velocities that a robot can still stop from, its CoM where it is: how hard a push it takes, direction by direction.

In each direction the capturable speeds are one interval, so the set is a polar function. It is a star about zero where the
robot can stand; elsewhere a sector that `min_speed` keeps away from zero. It need not be convex: where friction limits the
deceleration, the largest speed is the geometric mean of two radii.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Num

from jaxcap.batch.score import score
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, FloatArray, checked_gravity
from jaxcap.numerics.guarded import direction


class VelocityArea(NamedTuple):
    """The capturable velocities of one CoM, or of several: `speed * direction` for min_speed <= speed <= max_speed.

    Both speeds are zero in a direction in which no speed is capturable, and NaN where that is not known (`Status`).
    """

    directions: Float[Array, "n 3"]
    """Unit vectors."""
    min_speed: Float[Array, "*batch n"]
    """[m/s], zero in every direction where the robot can stand."""
    max_speed: Float[Array, "*batch n"]
    """[m/s], infinite where the contacts can stop any speed."""
    standing: Bool[Array, "*batch"]
    """The CoM is in static equilibrium: zero velocity belongs to the set."""

    def size(self) -> Float[Array, "*batch"]:
        """Area of the horizontal velocities, for directions from `headings`. Differentiable.

        Returns:
            The area inside `outline` [m^2/s^2], infinite where a speed is, NaN where one is not known.

        Raises:
            ValueError: where the directions are not horizontal.
        """
        next_to = lambda x: jnp.roll(x, -1, axis=-1)
        x, y = _headings_of(self.directions, jnp).T
        turn = x * next_to(y) - y * next_to(x)
        between = lambda speed: jnp.where((speed == 0) | (next_to(speed) == 0), 0, speed * next_to(speed))
        open_side = jnp.where(jnp.isinf(self.max_speed), 0, self.min_speed)
        return jnp.sum(turn * (between(self.max_speed) - between(open_side)), axis=-1) / 2

    def outline(self, longest: float = np.inf) -> list[Float[np.ndarray, "m 2"]]:
        """The edges of the horizontal velocities, for directions from `headings` and a single CoM.

        Args:
            longest: a larger speed is cut to this [m/s].

        Returns:
            A closed line (m, 2) [m/s] for each run of neighbouring directions with capturable speeds: out along the largest
            and back along the smallest. Directions that are not known count as having none.

        Raises:
            ValueError: where the directions are not horizontal, or for several CoMs.
        """
        directions = _headings_of(np.asarray(self.directions), np)
        low, high = self._finite(longest)
        some = high > 0
        inner, outer = low[:, None] * directions, high[:, None] * directions
        if some.all():
            return [outer, inner[::-1]] if low.any() else [outer]
        first = int(np.argmin(some))  # a direction without speeds: no run goes across it
        order = np.roll(np.arange(len(some)), -first)
        runs = np.split(order, np.flatnonzero(np.diff(some[order])) + 1)
        back = lambda run: inner[run[::-1]] if low[run].any() else np.zeros((1, 2))
        return [np.concatenate([outer[run], back(run)]) for run in runs if some[run[0]]]

    def mesh(self, longest: float) -> tuple[Float[np.ndarray, "m 3"], Int[np.ndarray, "t 3"]]:
        """The surface of the velocities in space, for directions all around (`sphere`) and a single CoM.

        Args:
            longest: a larger speed is cut to this [m/s]: straight up and down, most contacts stop any speed.

        Returns:
            Vertices (m, 3) [m/s] and triangles (t, 3), counted counter-clockwise from outside; closed, and empty where
            nothing is capturable. Triangles with a direction that has no capturable speed, or none that is known, are not
            among them.

        Raises:
            ValueError: where the directions do not surround zero, or for several CoMs.
        """
        directions = np.asarray(self.directions)
        triangles = _triangles(directions)
        low, high = self._finite(longest)
        triangles = triangles[(high[triangles] > 0).all(axis=1)]
        sides = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
        n = len(directions)  # the inner vertices follow the outer ones
        # A side from a to b is the number n a + b; without a triangle that has it from b to a, it is rim.
        rim = sides[~np.isin(sides @ [n, 1], sides @ [1, n])]
        down = np.concatenate([rim[:, ::-1], rim[:, :1] + n], axis=1)
        up = np.concatenate([rim[:, 1:], rim + n], axis=1)
        vertices = np.concatenate([high[:, None] * directions, low[:, None] * directions])
        triangles = np.concatenate([triangles, triangles[:, ::-1] + n, down, up])
        a, b, c = np.moveaxis(vertices[triangles], 1, 0)
        used, numbers = np.unique(triangles[np.any(np.cross(b - a, c - a) != 0, axis=1)], return_inverse=True)
        return vertices[used], numbers.reshape(-1, 3)

    def _finite(self, longest: float) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Smallest and largest speeds of a single CoM (n,), cut to `longest`; zero where they are not known."""
        if self.max_speed.ndim != 1:
            raise ValueError(f"max_speed has shape {self.max_speed.shape} (expected that of a single CoM, (n,))")
        known = np.isfinite(self.min_speed) & ~np.isnan(self.max_speed)
        low, high = (np.where(known, np.asarray(x), 0) for x in (self.min_speed, self.max_speed))
        reached = low <= longest
        return np.where(reached, low, 0), np.where(reached, np.minimum(high, longest), 0)


def velocity_area(
    cone: CentroidalCone | ConeRays,
    com: Num[FloatArray, "*batch 3"],
    directions: Num[FloatArray, "n 3"] | None = None,
    gravity: ArrayLike = GRAVITY,
    *,
    push_arm: ArrayLike | None = None,
) -> VelocityArea:
    """Which velocities of this CoM are capturable? In every direction the smallest and the largest speed.

    All in the contacts' frame, z up. The dtype of `com` decides the precision.

    Args:
        cone: from `centroidal_cone` or `cone_rays`; rays may be those of k contact sets.
        com: (3,) [m], or (k, 3).
        directions: (n, 3), of any length but zero; `headings()` if not given, `sphere()` for all of space.
        gravity: (3,) [m/s^2].
        push_arm: (3,) from the CoM to where a push gives the robot its velocity [m]: it gives it angular momentum too, in
            proportion, push_arm x velocity over the mass. None for a push through the CoM. (With angular momentum that is
            the same at every speed the capturable speeds need not be one interval: for that, `score` them.)

    Returns:
        The speeds in each direction. With k contact sets or CoM positions every field but `directions` has a leading axis of
        k: how the set changes with friction, with a slope, with a hand.

    Raises:
        TypeError: for wrong shapes.
        ValueError: for gravity that is not finite.
    """
    checked_gravity(gravity)
    com, towards = jnp.asarray(com), headings() if directions is None else directions
    if com.ndim not in (1, 2) or com.shape[-1] != 3:
        raise TypeError(f"com has shape {com.shape} (expected (3,) or (k, 3))")
    if jnp.ndim(towards) != 2 or jnp.shape(towards)[1] != 3:
        raise TypeError(f"directions has shape {jnp.shape(towards)} (expected (n, 3))")
    towards = direction(jnp.asarray(towards, jnp.promote_types(com.dtype, jnp.float32)).T)[0].T
    sets = len(cone.rays) if isinstance(cone, ConeRays) and cone.rays.ndim == 3 else None
    batch = com.shape[:-1] if sets is None else (sets,)
    if com.ndim == 2 and len(com) != batch[0]:
        raise TypeError(f"com has {len(com)} rows for {batch[0]} contact sets (expected as many, or one CoM)")
    velocities = jnp.concatenate([towards, jnp.zeros((1, 3), towards.dtype)])  # the last for `standing`
    states = len(velocities)
    coms = jnp.repeat(jnp.broadcast_to(com, (*batch, 3)).reshape(-1, 3), states, axis=0)
    cone = cone if sets is None else jax.tree.map(lambda leaf: jnp.repeat(leaf, states, axis=0), cone)
    velocities = jnp.tile(velocities, (len(coms) // states, 1))
    momenta = None if push_arm is None else jnp.cross(_arm(push_arm, velocities), velocities)
    out = score(cone, coms, velocities, gravity, specific_angular_momentum=momenta)
    field = lambda values: values.reshape(*batch, states)
    return VelocityArea(
        towards, field(out.min_speed)[..., :-1], field(out.max_speed)[..., :-1], field(out.capturable)[..., -1]
    )


def _arm(push_arm: ArrayLike, like: Array) -> Float[Array, "3"]:
    """The arm as an array, or TypeError for another shape."""
    arm = jnp.asarray(push_arm, like.dtype)
    if arm.shape != (3,):
        raise TypeError(f"push_arm has shape {arm.shape} (expected (3,) [m])")
    return arm


def headings(count: int = 360) -> Float[np.ndarray, "{count} 3"]:
    """Horizontal unit vectors, evenly spaced, counter-clockwise from x.

    Args:
        count: how many, >= 3.

    Returns:
        (count, 3).

    Raises:
        ValueError: for fewer than 3.
    """
    if count < 3:
        raise ValueError(f"count = {count} (expected at least 3)")
    angles = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)


def sphere(count: int = 1000) -> Float[np.ndarray, "{count} 3"]:
    """Unit vectors all around, spread evenly on a spiral (Fibonacci).

    Args:
        count: how many, >= 4.

    Returns:
        (count, 3).

    Raises:
        ValueError: for fewer than 4.
    """
    if count < 4:
        raise ValueError(f"count = {count} (expected at least 4)")
    height = 1 - (2 * np.arange(count) + 1) / count
    angles = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([np.sqrt(1 - height**2)[:, None] * around, height[:, None]], axis=1)


def _headings_of(directions: Num[FloatArray, "n 3"], xp: Any) -> Any:
    """Their first two columns (n, 2), or ValueError where they are seen not to be horizontal."""
    if not isinstance(directions, jax.core.Tracer) and np.any(np.asarray(directions[:, 2]) != 0):
        raise ValueError("directions are not horizontal (expected those of `headings`)")
    return xp.asarray(directions[:, :2])


def _triangles(directions: Num[np.ndarray, "n 3"]) -> Int[np.ndarray, "t 3"]:
    """Triangles (t, 3) of the hull of unit vectors, counter-clockwise from outside."""
    from scipy.spatial import ConvexHull, QhullError  # a heavy import, as in `cone_hull`

    try:
        hull = ConvexHull(directions)
    except (QhullError, ValueError) as error:
        raise ValueError(f"directions do not span space: {str(error).splitlines()[0]}") from error
    if (hull.equations[:, -1] >= 0).any():
        raise ValueError("directions do not surround zero (expected some all around, as those of `sphere`)")
    a, b, c = np.moveaxis(directions[hull.simplices], 1, 0)
    outwards = np.sum(np.cross(b - a, c - a) * hull.equations[:, :3], axis=1) > 0
    return np.where(outwards[:, None], hull.simplices, hull.simplices[:, ::-1])
