"""The CoM positions from which a robot can still stop, its velocity being given: the velocity area turned about.

Across the velocity the plane is cut into lines. Along one line the capturable states (alpha, alphadot) are a convex set: the
motion is linear, and both the (alpha, acceleration) polygon and the places of rest are convex. So the positions on a line
are one interval, its ends are found by bisection, and the room for more speed is concave in between, which is how a first
position is found. Nothing is assumed from one line to the next.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Num

from jaxcap.batch.score import score
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, FloatArray, checked_gravity
from jaxcap.one_state.line import survey_of_lanes

PLACES = 48
"""Positions on a line that are looked at together: a third of them behind, among and beyond the places of rest at first."""
ZOOMS = 4
"""Times that they close in on the one with the most room."""
CUTS = 12
"""Times that they close in on the ends: half of them at each end, so that the last are apart by rounding."""


Places = Float[np.ndarray, "lines m"]
"""Of positions on the lines, counted from their starts, along the velocity [m]."""
Room = Callable[[Places], Places]
"""Speed that could be added or shed at these places [m/s]."""


class ComArea(NamedTuple):
    """Positions in a horizontal plane, line by line: those between `rear` and `front`, along the velocity."""

    rear: Float[np.ndarray, "n 2"]
    """[m], NaN where a line has no such position."""
    front: Float[np.ndarray, "n 2"]
    """[m], NaN where a line has no such position."""

    def outline(self) -> list[Float[np.ndarray, "m 2"]]:
        """A closed line (m, 2) [m], counter-clockwise, for each run of neighbouring lines with positions."""
        some = np.isfinite(self.rear).all(axis=1)
        runs = np.split(np.arange(len(some)), np.flatnonzero(np.diff(some)) + 1)
        return [np.concatenate([self.front[run], self.rear[run[::-1]]]) for run in runs if some[run[0]]]

    def size(self) -> float:
        """Area inside the outlines [m^2]."""
        cross = lambda a, b: a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        return float(sum(cross(ring, np.roll(ring, -1, axis=0)).sum() / 2 for ring in self.outline()))


def com_area(
    cone: CentroidalCone | ConeRays,
    com_velocity: Num[FloatArray, "3"],
    height: float,
    lines: int = 64,
    reach: float = 2.0,
    gravity: ArrayLike = GRAVITY,
    *,
    specific_angular_momentum: ArrayLike | None = None,
) -> ComArea:
    """From where, in the horizontal plane at `height`, is this velocity capturable? Host only.

    All in the contacts' frame, z up. In double precision under JAX's x64 switch, else in single.

    Args:
        cone: from `centroidal_cone` or `cone_rays`, of one contact set.
        com_velocity: (3,) [m/s], horizontal, not zero (a robot at rest has its support polygon).
        height: z of the CoM [m].
        lines: how many are cut, parallel to the velocity, closer together at the sides; >= 2.
        reach: positions are looked for within this of the contacts' centroid, along the velocity and across [m]; a set that
            goes farther is cut there.
        gravity: (3,) [m/s^2].
        specific_angular_momentum: (3,) about the CoM, over the mass [m^2/s]; None for zero. See `capturability`.

    Returns:
        Where each line has such positions.

    Raises:
        ValueError: for a velocity that is zero, not horizontal or not finite, for fewer than 2 lines, or for gravity
            that is not finite.
        TypeError: for gravity that is not three numbers.
    """
    checked_gravity(gravity)
    momentum = None if specific_angular_momentum is None else np.asarray(specific_angular_momentum, float)
    if momentum is not None and not (momentum.shape == (3,) and np.isfinite(momentum).all()):
        raise ValueError(f"specific_angular_momentum = {specific_angular_momentum} (expected three finite numbers [m^2/s])")
    com_velocity = np.asarray(com_velocity, float)
    speed = np.linalg.norm(com_velocity)
    if com_velocity.shape != (3,) or not np.isfinite(speed) or speed == 0 or com_velocity[2] != 0:
        raise ValueError(f"com_velocity = {com_velocity} (expected three numbers, horizontal and not zero)")
    if lines < 2:
        raise ValueError(f"lines = {lines} (expected at least 2)")
    along = com_velocity / speed
    across = np.array([-along[1], along[0], 0])
    base = np.array([*np.asarray(cone.origin)[:2], height])
    sides = np.clip(_sides(cone, across, np.asarray(gravity, float)), -reach, reach)
    spread = -np.cos(np.pi * (np.arange(lines) + 0.5) / lines)
    starts = base + (sides.mean() + np.diff(sides) / 2 * spread)[:, None] * across

    def room(places: Places) -> Places:
        """Speed that could be added or shed at these places [m/s]; minus infinity where none is capturable."""
        coms = starts[:, None] + places[..., None] * along
        flat = coms.reshape(-1, 3)
        momenta = None if momentum is None else np.broadcast_to(momentum, flat.shape)
        velocities = np.broadcast_to(com_velocity, flat.shape)
        out = score(cone, flat, velocities, gravity, specific_angular_momentum=momenta)
        low, high = np.asarray(out.min_speed), np.asarray(out.max_speed)
        both_ways = np.minimum(high - speed, np.where(low > 0, speed - low, np.inf))
        return np.where(~np.isnan(high) & (high > 0), both_ways, -np.inf).reshape(places.shape)

    low, high = _rest(cone, starts, along, reach, gravity)
    inside, most = _roomiest(room, low, high, reach)
    ends = np.where(most[:, None] >= 0, _ends(room, inside, reach), np.nan)
    return ComArea(*(starts[:, :2] + ends[:, [i]] * along[:2] for i in (0, 1)))


def _sides(
    cone: CentroidalCone | ConeRays, across: Float[np.ndarray, "3"], gravity: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "2"]:
    """How far the places of rest extend to both sides of the contacts' centroid [m]; NaN where there are none.

    Linear programs over the arm of the CoM, in sizes of the stance, and the rays' weights, in units of the robot's weight.
    """
    length = float(cone.length)
    up = -gravity / np.linalg.norm(gravity)
    turn = np.cross(np.eye(3), up).T  # the torque of a robot at rest on its CoM's arm
    arm: list[tuple[float | None, float | None]] = [(None, None)] * 3
    if isinstance(cone, CentroidalCone):
        faces = np.asarray(cone.faces, float)
        box = 0 if cone.offsets is None else np.asarray(cone.offsets, float) / np.linalg.norm(gravity)
        limits = {"A_ub": faces[:, 3:] * length @ turn, "b_ub": box - faces[:, :3] @ up}
        bounds = arm
    else:
        rays = np.asarray(cone.rays, float).T / np.array([1, 1, 1, length, length, length])[:, None]
        balanced = np.concatenate([np.zeros((3, 3)), -turn])
        limits = {"A_eq": np.concatenate([balanced, rays], axis=1), "b_eq": np.concatenate([up, np.zeros(3)])}
        bounds = arm + [(0, None)] * rays.shape[1]
    from scipy.optimize import linprog  # a heavy import, as in `cone_hull`

    found = []
    for sign in (-1, 1):
        cost = np.zeros(len(bounds))
        cost[:3] = -sign * across
        result = linprog(cost, bounds=bounds, method="highs-ds", **limits)
        farthest = -result.fun * length if result.status == 0 else np.inf if result.status == 3 else np.nan
        found.append(sign * farthest)
    return np.array(found)


def _rest(
    cone: CentroidalCone | ConeRays,
    starts: Float[np.ndarray, "lines 3"],
    along: Float[np.ndarray, "3"],
    reach: float,
    gravity: ArrayLike,
) -> tuple[Float[np.ndarray, " lines"], Float[np.ndarray, " lines"]]:
    """Places of rest on each line, from and to (lines,) [m]; NaN where there are none within reach."""
    known = np.where(np.isfinite(starts), starts, 0)
    survey = survey_of_lanes(cone, jnp.asarray(known.T), jnp.asarray(np.tile(along[:, None], len(starts))), gravity)
    low, high = np.maximum(survey.s_min, -reach), np.minimum(survey.s_max, reach)
    some = np.asarray(survey.standing & survey.known) & (low <= high) & np.isfinite(starts).all(axis=1)
    return np.where(some, low, np.nan), np.where(some, high, np.nan)


def _roomiest(
    room: Room, low: Float[np.ndarray, " lines"], high: Float[np.ndarray, " lines"], reach: float
) -> tuple[Float[np.ndarray, " lines"], Float[np.ndarray, " lines"]]:
    """The place (lines,) on each line with the most room, and that room; low, high: places of rest, NaN without."""
    end = np.full_like(low, reach)
    places = np.concatenate([_between(a, b, 3) for a, b in ((-end, low), (low, high), (high, end))], axis=1)
    for _ in range(ZOOMS + 1):
        rooms = room(places)
        best = np.argmax(rooms, axis=1)[:, None]
        at = lambda index, places=places: np.take_along_axis(places, np.clip(index, 0, PLACES - 1), 1)[:, 0]
        inside = at(best)
        # two to each side: a neighbour may be the same place
        places = np.concatenate([_between(at(best - 2), inside, 2), _between(inside, at(best + 2), 2)], axis=1)
    return inside, np.take_along_axis(rooms, best, 1)[:, 0]


def _ends(room: Room, inside: Float[np.ndarray, " lines"], reach: float) -> Float[np.ndarray, "lines 2"]:
    """The rear and the front end (lines, 2) of the positions with room, which hold `inside` (lines,)."""
    inside = np.stack([inside, inside], axis=1)
    outside = np.broadcast_to([-reach, reach], inside.shape)
    half = PLACES // 2
    for _ in range(CUTS):
        places = np.concatenate([_between(inside[:, i], outside[:, i], 2) for i in (0, 1)], axis=1)
        holds = (room(places) >= 0).reshape(-1, 2, half)
        last = np.argmin(np.concatenate([holds, np.zeros((len(holds), 2, 1), bool)], axis=-1), axis=-1) - 1
        places = places.reshape(-1, 2, half)
        pick = lambda index, places=places: np.take_along_axis(places, np.clip(index, 0, half - 1)[..., None], -1)[..., 0]
        inside, outside = pick(last), pick(last + 1)
    return inside


def _between(start: Float[np.ndarray, " lines"], stop: Float[np.ndarray, " lines"], parts: int) -> Places:
    """Places (lines, PLACES / parts) from start (lines,) to stop (lines,)."""
    return start[:, None] + np.linspace(0, 1, PLACES // parts) * (stop - start)[:, None]
