"""The capture point and what it says about capturability: the baselines of Section IV.

In multi-contact the height in (14) is ambiguous, and nothing in the model settles it; so it is an argument everywhere. The
default is the height of the CoM above the contacts' centroid: that is the height above ground on level ground, it prefers no
contact to another, and it changes neither with the frame nor with the order of the contacts. Where the CoM is not above that
plane, (14) has no meaning, and the answer is NaN.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num

from jaxcap.contacts.cone import CentroidalCone, ConeRays, centred
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, FloatArray, checked_gravity
from jaxcap.contacts.scoring_input import relative
from jaxcap.regions.plane import across, upward
from jaxcap.regions.support_distance import hull_distance, support_distance


class Baselines(NamedTuple):
    """How far the capture point lies inside two regions [m]; negative outside."""

    capture_point_support: Float[Array, "..."]
    """The support polygon: everything the contacts can do at rest."""
    capture_point_hull: Float[Array, "..."]
    """The convex hull of the contact points, projected along gravity."""


def capture_point(
    com: Num[FloatArray, "*#n 3"],
    com_velocity: Num[FloatArray, "*#n 3"],
    height: Num[FloatArray, "*#n"] | float | int,
    gravity: ArrayLike = GRAVITY,
) -> Float[Array, "*n 2"]:
    """Point on the ground where the linear inverted pendulum would have to step to come to rest, (14).

    Leading axes are broadcast, so that one call takes many heights.

    Args:
        com: (..., 3) CoM position [m].
        com_velocity: (..., 3) [m/s], in the frame of `com`.
        height: (...) of the CoM above that ground [m].
        gravity: (3,) [m/s^2].

    Returns:
        (..., 2) [m] in the frame of `com`, in the plane across gravity (x and y where it points down; else see
        `plane.across`). NaN where the height is not positive.

    Raises:
        TypeError, ValueError: for gravity that is not three finite numbers.

    Source: (14) of the paper; Pratt et al., Capture Point, Humanoids 2006.
    """
    com, com_velocity = jnp.asarray(com), jnp.asarray(com_velocity)
    dtype = jnp.promote_types(jnp.result_type(com, com_velocity), jnp.float32)
    pull, height = jnp.asarray(checked_gravity(gravity), dtype), jnp.asarray(height, dtype)
    return _capture_point(com.astype(dtype), com_velocity.astype(dtype), height, pull)


@jax.jit
def _capture_point(
    com: Float[Array, "*#n 3"], com_velocity: Float[Array, "*#n 3"], height: Float[Array, "*#n"], pull: Float[Array, "3"]
) -> Float[Array, "*n 2"]:
    square = height / jnp.sqrt(jnp.sum(pull * pull))
    # The root of what is not positive has no gradient, not even where it is not chosen: it is taken of 1.
    time = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), jnp.nan)  # 1 / omega [s]
    return _projected(com, pull) + _projected(com_velocity, pull) * time[..., None]


def height_above_contacts(
    cone: CentroidalCone | ConeRays, com: Num[FloatArray, "*n 3"], gravity: ArrayLike = GRAVITY
) -> Float[Array, "*n"]:
    """Height of the CoM above the contacts' centroid, against gravity: the default height of (14).

    Args:
        cone: of one contact set, or rays of a batch of n, one for each CoM.
        com: (..., 3) [m], in the contacts' frame.
        gravity: (3,) [m/s^2].

    Returns:
        (...) [m], negative for a CoM below.

    Raises:
        TypeError, ValueError: for gravity that is not three finite numbers.
    """
    com = jnp.asarray(com)
    com = com.astype(jnp.promote_types(com.dtype, jnp.float32))
    return _height(com, jnp.asarray(cone.origin, com.dtype), jnp.asarray(checked_gravity(gravity), com.dtype))


@jax.jit
def _height(com: Float[Array, "*n 3"], origin: Float[Array, "*#n 3"], pull: Float[Array, "3"]) -> Float[Array, "*n"]:
    return jnp.sum((com - origin) * upward(pull), axis=-1)


def baselines(
    cone: CentroidalCone | ConeRays,
    contacts: ContactSet,
    coms: Num[FloatArray, "n 3"],
    com_velocities: Num[FloatArray, "n 3"],
    height: Num[FloatArray, "..."] | float | int | None = None,
    gravity: ArrayLike = GRAVITY,
) -> Baselines:
    """Signed distance of the capture point to the support polygon and to the hull of the contact points, for many states.

    Args:
        cone: from `centroidal_cone` or `cone_rays`, of these `contacts`; both of one contact set, or both batches of n: a
            set for each state.
        contacts: those of the cone.
        coms: (n, 3) [m], in the contacts' frame.
        com_velocities: (n, 3) [m/s].
        height: of the CoM [m]: one number, (n,), or (n, h) for h heights of each state; by default `height_above_contacts`.
        gravity: (3,) [m/s^2].

    Returns:
        Distances of shape (n,), or (n, h). A state whose distance is not known has NaN: numbers that are not finite, a
        height that is not positive.

    Raises:
        TypeError, ValueError: for gravity that is not three finite numbers.
    """
    if isinstance(coms, np.ndarray) and isinstance(contacts.points, np.ndarray) and isinstance(cone.origin, np.ndarray):
        (cone, coms), (contacts, _) = relative(cone, coms), centred(contacts)  # before anything is rounded
    coms, com_velocities = jnp.asarray(coms), jnp.asarray(com_velocities)
    if height is None:
        height = height_above_contacts(cone, coms, gravity)
    height = jnp.asarray(height)
    if height.ndim == 2:
        coms, com_velocities = coms[:, None], com_velocities[:, None]
    points = capture_point(coms, com_velocities, height, gravity)
    return Baselines(support_distance(cone, points, gravity), hull_distance(contacts, points, gravity))


def _projected(vector: Float[Array, "*n 3"], gravity: Float[Array, "3"]) -> Float[Array, "*n 2"]:
    return jnp.sum(vector[..., None, :] * across(gravity), axis=-1)
