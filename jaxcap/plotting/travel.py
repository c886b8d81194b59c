"""One state's line of travel, evaluated for drawing: polygon, static region, walk. Draws nothing."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int8, Shaped

from jaxcap.batch.blocks import ROWS
from jaxcap.contacts.cone import CentroidalCone
from jaxcap.contacts.conventions import ArrayLike, FloatArray
from jaxcap.files.fields import CASES
from jaxcap.numerics.guarded import direction, root
from jaxcap.numerics.whole import round_up
from jaxcap.one_state.boundary import Boundary, End
from jaxcap.one_state.capturability import capturability
from jaxcap.one_state.face_polygon import polygon
from jaxcap.one_state.result import Capturability, Case, Status
from jaxcap.plotting.region import clipped

STEPS = 256
"""Stretches into which a walk is cut."""
STEEPEST = 3.0
"""Accelerations beyond this many times gravity are not shown."""
BESIDE = 0.4
"""How much is shown on either side of the line's landmarks, relative to the distance between them."""
BEYOND = 0.1
"""How far the polygon goes on out of the picture, relative to its size: so that no edge is seen where there is none."""
NARROWEST = 0.1
"""Least distance between the landmarks that is shown as such [m]."""


class Walk(NamedTuple):
    """The CoM's way along the line, point by point."""

    alpha: Float[FloatArray, "n"]
    """[m]"""
    speed: Float[FloatArray, "n"]
    """[m/s]"""
    acceleration: Float[FloatArray, "n"]
    """[m/s^2]; minus infinity where the CoM stops at once."""


class Travel(NamedTuple):
    """The line of travel of one state, and the answer of `jaxcap.capturability`."""

    along: Float[np.ndarray, "3"]
    """Direction of travel."""
    speed: float
    """[m/s]"""
    out: Capturability
    normals: Float[np.ndarray, "m 2"]
    """Half-planes `normals @ (alpha, acceleration) <= bounds`, (11)."""
    bounds: Float[np.ndarray, "m"]
    static: tuple[float, float] | None
    """The static region [m], infinite where nothing bounds it; None where it is empty."""
    walk: Walk | None
    """None where no acceleration keeps the contacts at the start, or where the state is undecided."""
    window: tuple[float, float]
    """The alphas to show [m]."""
    steepest: float
    """The largest acceleration to show [m/s^2]."""

    @property
    def case(self) -> Case:
        """How the state ends."""
        return Case(int(self.out.case))

    @property
    def verdict(self) -> str:
        """The answer in one line."""
        if self.case == Case.UNDECIDED:
            return f"{CASES[self.case]}: {Status(int(self.out.status)).name.lower()}"
        said = "capturable" if self.out.capturable else "not capturable"
        effort = float(self.out.effort)
        if 1 < effort < np.inf:
            return f"{said}: to hold still takes {effort:.2f} of the torque limits"
        return f"{said}: {CASES[self.case]}, margin {float(self.out.margin):+.2f} m/s"

    def region(self) -> Float[np.ndarray, "k 2"]:
        """Vertices of the polygon, as far as it is shown and a little farther; perhaps none."""
        low, high = self.window
        beyond = BEYOND * (high - low)
        top = (1 + BEYOND) * self.steepest
        return clipped((low - beyond, high + beyond, -top, top), self.normals, self.bounds)


def travel(cone: CentroidalCone, com: ArrayLike, com_velocity: ArrayLike, gravity: ArrayLike) -> Travel:
    """The line of travel of one state.

    Args:
        cone: From `centroidal_cone`.
        com: (3,) [m], in the contacts' frame, and so are velocity and gravity.
        com_velocity: (3,) [m/s].
        gravity: (3,) [m/s^2].

    Raises:
        TypeError: For rays.
        ValueError: For values that are not finite, and for a velocity of zero, which has no line.
    """
    if not isinstance(cone, CentroidalCone):
        raise TypeError(f"cone is a {type(cone).__name__} (expected a CentroidalCone, from `centroidal_cone`)")
    where, velocity = (jnp.asarray(np.asarray(value), jnp.result_type(float)) for value in (com, com_velocity))
    for name, value in (("com", where), ("com_velocity", velocity)):
        if value.shape != (3,) or not np.isfinite(value).all():
            raise ValueError(f"{name} = {np.asarray(value)} (expected 3 finite numbers)")
    if not np.any(velocity):
        raise ValueError("com_velocity is zero (expected a direction of travel)")
    faces, pull = cone.padded(round_up(max(len(cone.faces), 1), ROWS)), np.asarray(gravity)
    out = capturability(faces, where, velocity, pull)
    found = _computed(faces, where, velocity, jnp.asarray(pull), out.case)
    (normals, bounds), survey, way, end, along, speed = jax.device_get(found)
    known = bool(survey.feasible) and Case(int(out.case)) != Case.UNDECIDED
    static = (float(survey.s_min), float(survey.s_max)) if survey.standing else None
    walk = Walk(*(field.astype(float) for field in way)) if known else None
    landmarks = np.array([0, end if known else 0, *(static or ()), *(walk.alpha if walk else ())])
    landmarks = landmarks[np.isfinite(landmarks)]
    margin = BESIDE * max(NARROWEST, np.ptp(landmarks))
    return Travel(
        along=along.astype(float),
        speed=float(speed),
        out=out,
        normals=normals.astype(float),
        bounds=bounds.astype(float),
        static=static,
        walk=walk,
        window=(float(landmarks.min() - margin), float(landmarks.max() + margin)),
        steepest=STEEPEST * float(np.linalg.norm(pull)),
    )


@jax.jit
def _computed(
    cone: CentroidalCone,
    com: Float[Array, "3"],
    com_velocity: Float[Array, "3"],
    gravity: Shaped[Array, "3"],
    case: Int8[Array, ""],
) -> Any:
    """What `capturability` finds on its way, and the walk of a state that ends like this."""
    along, speed = direction(com_velocity)
    rows = polygon(cone, com, along, gravity.astype(com.dtype))
    survey = rows.survey()
    lower = rows.boundary(jnp.where(survey.feasible, jnp.inf, 0))
    ahead = survey.standing & survey.feasible & (survey.s_min > 0) & survey.pulled_back
    upper = rows.seen(jnp.zeros_like(speed), 1, -1).boundary(jnp.where(ahead, survey.s_min, 0))
    walk = _walk(lower, upper, jnp.where(ahead, survey.s_min, 0), speed * speed / 2, case)
    normals = jnp.stack([rows.on_alpha, rows.on_acceleration], axis=1)
    return (normals, rows.bound), survey, walk, lower.end, along, speed


def _walk(
    lower: Boundary, upper: Boundary, s_min: Float[Array, ""], energy: Float[Array, ""], case: Int8[Array, ""]
) -> Walk:
    """The way under maximum deceleration to the first stop or to the end of the boundary; in C3_2_1 the fastest way to rest
    at s_min, least deceleration and then the largest; in C3_2_2 the way under least deceleration to the stop.

    upper: minus the largest acceleration, to s_min.
    """
    at_once = lower.ending == End.FLOORLESS
    short, reaching = case == Case.C3_2_2, case == Case.C3_2_1
    endless = at_once | (lower.ending == End.NEVER)
    stops = endless | (energy <= root(-lower.gain(lower.end)) ** 2)
    last = jnp.where(stops, jnp.where(at_once, 0, lower.ride(energy).alpha), lower.end)
    last = jnp.where(short, upper.negated().ride(energy).alpha, jnp.where(reaching, s_min, last))
    knots = jnp.concatenate([lower.pieces.left, upper.pieces.left, jnp.linspace(0, last, STEPS + 1)])
    alpha = jnp.sort(jnp.clip(knots, 0, last))
    hardest = energy + lower.gain(alpha)
    softest = energy - upper.gain(alpha)
    to_rest = jnp.where(at_once, jnp.inf, lower.gain(alpha) - lower.gain(s_min))
    least = short | reaching & (softest < to_rest)
    left = jnp.where(short, softest, jnp.where(reaching, jnp.minimum(softest, to_rest), hardest))
    still = (stops | short | reaching) & (jnp.arange(len(alpha)) == len(alpha) - 1)
    acceleration = jnp.where(least, -upper.at(alpha), jnp.where(at_once, -jnp.inf, lower.at(alpha)))
    return Walk(alpha, jnp.where(still, 0, root(2 * left)), acceleration)
