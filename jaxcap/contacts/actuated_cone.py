"""What contacts can exert on a robot whose joints bear only so much, in one posture: by its faces, on the host."""

from itertools import product

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxcap.contacts.actuation import Actuation
from jaxcap.contacts.cone import CentroidalCone, EffortFaces, box_of_all, order_of, stance_of
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, checked_gravity
from jaxcap.contacts.effort import pieces_of_effort, places_of
from jaxcap.contacts.limbs import Loads
from jaxcap.contacts.projection import ProjectionError
from jaxcap.contacts.sums import Halfspaces, TooManyFacesError, faces_of_sum

NOTHING = Halfspaces(np.zeros((1, 6)), np.array([-1.0]))
"""No wrench at all: 0 <= -1."""


def actuated_cone(
    contacts: ContactSet,
    actuation: Actuation,
    sides: int = 4,
    momentum_box: ArrayLike = 0.0,
    gravity: ArrayLike = GRAVITY,
) -> CentroidalCone:
    """What a robot can exert in one posture, by faces: for many states of it; host only, once a posture.

    It answers as `cone_rays(contacts)` with `actuation` does, and goes wherever a cone goes: limits and box are in it. Limbs
    without joints in `actuation` cost nothing; each of the others brings its own vertices (an arm of seven joints 100 to
    400), and the faces are those of their sum.

    Args:
        contacts: one set, with at least one contact that is not masked.
        actuation: of one posture, for these contacts. Limbs, which are contacts that share joints, touch with one link each.
        sides: edges of each friction pyramid, >= 3.
        momentum_box: as for `centroidal_cone` [m^2/s^2].
        gravity: (3,) that `actuation.gravity_torque` is for [m/s^2]; the effort holds for it alone.

    Returns:
        The faces and their offsets, in double precision, and the effort by faces over the places of the CoM; where these are
        no more than a line, the effort is NaN.

    Raises:
        ValueError: for an empty set, sides < 3, a box that is negative or not finite, an actuation of many postures or of
            other contacts, or one that is not finite, contacts of one limb on several links, gravity that is zero, and under
            a JAX transformation.
        ProjectionError: a ValueError, where the faces found do not pass their check, or are more than 50,000: `cone_rays`
            with `actuation` takes such a posture.
    """
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((contacts, actuation, momentum_box, gravity))):
        raise ValueError("actuated_cone works on the host, once for each posture: call it outside jit, vmap and grad")
    box, stance = box_of_all(momentum_box), stance_of(contacts, sides)
    touching = np.asarray(contacts.mask)
    _check_actuation(actuation, touching)
    pull = np.asarray(checked_gravity(gravity), np.float64)
    weight = float(np.linalg.norm(pull))
    if weight == 0:
        raise ValueError("gravity = 0 (expected a direction, as (0, 0, -9.81))")
    loads = Loads.of(stance, touching, actuation, weight)
    scale = np.array([1, 1, 1, stance.length, stance.length, stance.length])
    try:
        found, effort = faces_of(loads, box / (weight * float(stance.length))), _effort(loads, pull / weight)
    except TooManyFacesError as error:
        raise TooManyFacesError(f"{error} (expected fewer joints: cone_rays(contacts) with actuation takes all)") from error
    except ProjectionError as error:
        raise ProjectionError(f"faces of {len(stance.touching)} contacts with a robot's limits: {error}") from error
    order = order_of(found.normals)
    return CentroidalCone(
        faces=found.normals[order] / scale,
        origin=stance.origin,
        length=stance.length,
        offsets=weight * found.offsets[order],
        effort=None
        if effort is None
        else effort._replace(
            per_wrench=effort.per_wrench / scale / weight, held=effort.held / scale, room=weight * effort.room
        ),
    )


def faces_of(loads: Loads, box: float = 0.0) -> Halfspaces:
    """All that the limbs can exert together, in weights, and how far a box of torques goes beyond."""
    limbs = loads.limbs()
    if loads.sagging or any(len(limb.vertices) == 0 for limb in limbs):
        return NOTHING
    corners = [np.pad(np.array(list(product((-box, box), repeat=3))), ((0, 0), (3, 0)))] if box else []
    polytopes = [limb.vertices for limb in limbs]
    return faces_of_sum([*polytopes, *corners], np.concatenate([limb.rays for limb in limbs]))


def _effort(loads: Loads, down: Float[np.ndarray, "3"]) -> EffortFaces | None:
    """In weights and sizes; None where the places at which the robot can stand are no more than a line."""
    passive = loads.limit == 0  # what torques do not hold, contacts do or nothing does
    held = faces_of(loads.only(passive))
    axes = np.linalg.svd(down[None])[2][1:]
    places = places_of(held, -down, axes)
    if places is None:
        return None
    pieces = pieces_of_effort(loads, places)
    return EffortFaces(pieces.per_wrench, pieces.constant, held.normals, held.offsets)


def _check_actuation(actuation: Actuation, touching: Bool[np.ndarray, " k"]) -> None:
    """Raises ValueError."""
    if actuation.batched:
        raise ValueError(f"actuation has {len(actuation.limit)} postures (expected one: cone_rays(contacts) takes many)")
    if len(actuation.jacobians) != len(touching):
        raise ValueError(f"actuation.jacobians: {len(actuation.jacobians)} contacts (expected {len(touching)}, those given)")
    counts = np.asarray(actuation.mask)
    for name in ("jacobians", "gravity_torque", "limit"):
        values = np.asarray(getattr(actuation, name))[..., counts]
        if not np.isfinite(values[touching] if name == "jacobians" else values).all():
            raise ValueError(f"actuation.{name} is not finite")
