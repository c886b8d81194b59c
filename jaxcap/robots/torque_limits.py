"""What a robot's joints can bear in its postures: (q, contacts) to `jaxcap.Actuation`, for many states at once.

Only joints on a path from the base to a contact that touches count; of the others a state says nothing. Conventions are
those of `centroidal`.
"""

import warnings
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from jaxcap.contacts.actuation import Actuation
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, checked_gravity
from jaxcap.errors import InputError
from jaxcap.robots.centroidal import check_units, rows_of
from jaxcap.robots.patches import ContactPatch
from jaxcap.robots.tree import BLOCK, Link, cross, links, turned

NO_LIMIT = 1e6
"""An effort limit this large [N m, N] is none."""


class _Joint(NamedTuple):
    """A joint between the base and a contact."""

    number: int
    """In the model."""
    slides: bool
    axis: Float[np.ndarray, "3"]
    """In the frame of its link."""
    carries: Bool[np.ndarray, " k"]
    """Which contacts."""


def actuation(
    model: pin.Model,
    q: ArrayLike,
    contacts: ContactSet,
    frames: Sequence[str] | Mapping[str, ContactPatch],
    *,
    joints: Collection[str] | None = None,
    limits: Mapping[str, float] | None = None,
    unlimited: bool = False,
    gravity: ArrayLike = GRAVITY,
) -> Actuation:
    """What the joints can bear in n postures.

    Args:
        model: Pinocchio's, its base moving freely.
        q: (nq,), or (n, nq), in Pinocchio's conventions.
        contacts: of these postures, in the world frame: one set for all, or one for each.
        frames: for each of the k contacts the frame of the model whose link it belongs to; or the robot's patches, whose
            points the contacts are, in that order.
        joints: names of those that may count; by default all that carry a contact.
        limits: torques by names of joints [N m] (forces of slides [N]), in place of the model's.
        unlimited: whether joints of which no limit is known may bear anything; else they are an error.
        gravity: (3,) [m/s^2].

    Returns:
        Of n postures, or of one where `q` is one: for all joints that carry a contact in any of them, masked where they do
        not. For use with `jaxcap.cone_rays(contacts)`.

    Raises:
        InputError: naming the frame that the model does not have, the joints that have no limit, or a joint between base and
            contact that has more than one axis.
        ValueError: as `centroidal_states`, and for contacts of another number of postures.
    """
    single = np.ndim(q) == 1
    rows = rows_of("q", np.atleast_2d(np.asarray(q)), "nq", model.nq)
    check_units(model, rows)
    names = _frames_of(frames)
    points, mask = _contacts(contacts, len(rows), len(names))
    chain = _joints(model, names, np.asarray(mask.any(axis=0)), joints)
    bound = _limits(model, chain, limits or {}, unlimited)
    pull = np.asarray(checked_gravity(gravity))
    parts = [
        _block(model, rows[i : i + BLOCK], points[i : i + BLOCK], chain, pull) for i in range(0, max(len(rows), 1), BLOCK)
    ]
    jacobians, torque = (np.concatenate(part) for part in zip(*parts, strict=True))
    carries = np.array([joint.carries for joint in chain], bool).reshape(len(chain), len(names))
    touching = (mask[:, None] & carries[None]).any(axis=2) & np.isfinite(bound)
    limit = np.broadcast_to(np.where(np.isfinite(bound), bound, 0), touching.shape)
    found = Actuation(jacobians, torque, limit, touching)
    if single:
        return Actuation.unchecked(*(field[0] for field in (found.jacobians, found.gravity_torque, found.limit, found.mask)))
    return found


def joint_names(
    model: pin.Model,
    contacts: ContactSet,
    frames: Sequence[str] | Mapping[str, ContactPatch],
    *,
    joints: Collection[str] | None = None,
) -> list[str]:
    """Names of the joints that an `actuation` is of, in its order.

    Args:
        model: as `actuation` is given it, and so are the others.
        contacts: of all postures.
        frames: of the contacts.
        joints: those that may count.

    Raises:
        InputError: as `actuation`.
        ValueError: for frames of another number of contacts.
    """
    names = _frames_of(frames)
    _, mask = _contacts(contacts, len(contacts.mask) if contacts.mask.ndim == 2 else 1, len(names))
    return [model.names[joint.number] for joint in _joints(model, names, np.asarray(mask.any(axis=0)), joints)]


def _frames_of(frames: Any) -> list[str]:
    """The frame of each contact."""
    if isinstance(frames, Mapping):
        return [patch.frame for patch in frames.values() for _ in patch.points]
    return [str(name) for name in frames]


def _contacts(contacts: ContactSet, n: int, k: int) -> tuple[Float[np.ndarray, "n k 3"], Bool[np.ndarray, "n k"]]:
    """Points and mask, for each posture."""
    if len(contacts) != k:
        raise ValueError(f"frames: {k} (expected {len(contacts)}, one for each contact)")
    points, mask = np.asarray(contacts.points), np.asarray(contacts.mask)
    if points.ndim == 3 and len(points) != n:
        raise ValueError(f"contacts: {len(points)} sets (expected one, or one for each of {n} postures)")
    return np.broadcast_to(points, (n, k, 3)), np.broadcast_to(mask, (n, k))


def _joints(
    model: pin.Model, frames: list[str], used: Bool[np.ndarray, " k"], wanted: Collection[str] | None
) -> list[_Joint]:
    """The joints between the base and contacts that are used, in the model's order; of those that are wanted."""
    for joint in wanted or ():
        if not model.existJointName(joint):
            raise InputError(f"joints: {joint!r} is no joint of {model.name}")
    found: dict[int, np.ndarray] = {}
    for contact, name in enumerate(frames):
        if not model.existFrame(name):
            raise InputError(f"frames[{contact}] = {name!r} is no frame of {model.name}")
        above = model.supports[model.frames[model.getFrameId(name)].parentJoint] if used[contact] else []
        for joint in above:
            if joint > 1:  # the world, and the base
                found.setdefault(int(joint), np.zeros(len(frames), bool))[contact] = True
    numbers = [number for number in sorted(found) if wanted is None or model.names[number] in wanted]
    return [_joint(model, number, found[number]) for number in numbers]


def _joint(model: pin.Model, number: int, carries: Bool[np.ndarray, " k"]) -> _Joint:
    joint = model.joints[number]
    if joint.nv != 1:
        raise InputError(f"joint {model.names[number]} has {joint.nv} axes (expected joints of one axis up to the contacts)")
    data = joint.createData()
    state = np.zeros(joint.idx_q + joint.nq)
    state[joint.idx_q] = joint.nq - 1  # cosine and sine, or an angle of zero
    joint.calc(data, state, np.zeros(joint.idx_v + 1))
    motion = np.array(data.S).reshape(6)
    if motion[:3].any() and motion[3:].any():
        raise InputError(f"joint {model.names[number]} is a screw (expected hinges and slides up to the contacts)")
    slides = bool(motion[:3].any())
    return _Joint(number, slides, motion[:3] if slides else motion[3:], carries)


def _limits(model: pin.Model, joints: list[_Joint], given: Mapping[str, float], unlimited: bool) -> Float[np.ndarray, " j"]:
    """Per unit mass [N m/kg]; infinite where there is none."""
    for name in given:
        if not model.existJointName(name):
            raise InputError(f"limits: {name!r} is no joint of {model.name}")
    names = [model.names[joint.number] for joint in joints]
    known = [float(model.upperEffortLimit[model.joints[joint.number].idx_v]) for joint in joints]
    # A file that does not say has zero, or what stands for infinity.
    limit = np.array([x if np.isfinite(x) and 0 < x < NO_LIMIT else np.inf for x in known])
    for place, name in enumerate(names):
        if name in given:
            limit[place] = given[name]
    for place in np.flatnonzero(np.isnan(limit) | (limit < 0))[:1]:
        raise InputError(f"limits[{names[place]!r}] = {limit[place]} (expected a torque [N m], not negative)")
    without = [name for name, value in zip(names, limit, strict=True) if np.isinf(value)]
    if without:
        said = f"{model.name} has no effort limit for {', '.join(without)}"
        if not unlimited:
            raise InputError(f"{said}: give them as `limits`, or say `unlimited=True` to let them bear anything")
        warnings.warn(f"{said}: they may bear anything", stacklevel=3)
    return limit / pin.computeTotalMass(model)


def _block(
    model: pin.Model,
    q: np.ndarray,
    points: Float[np.ndarray, "n k 3"],
    joints: list[_Joint],
    gravity: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "n k 3 j"], Float[np.ndarray, "n j"]]:
    """Jacobians of the contacts, and torques that hold the joints, per unit mass."""
    found = links(model, q, np.zeros((len(q), model.nv)))
    masses, moments = _carried(model, found)
    total, n, k = pin.computeTotalMass(model), *points.shape[:2]
    jacobians, torque = np.zeros((n, k, 3, len(joints))), np.zeros((n, len(joints)))
    for place, joint in enumerate(joints):
        link = found[joint.number]
        axis = turned(link.rotation, np.repeat(joint.axis[:, None], n, axis=1))
        moves = lambda point, axis=axis, link=link, joint=joint: axis if joint.slides else cross(axis, point - link.position)
        for contact in np.flatnonzero(joint.carries):
            jacobians[:, contact, :, place] = moves(points[:, contact].T).T
        mass = masses[joint.number]
        centre = moments[joint.number] / (mass if mass else 1)
        # The torque that lifts what the joint carries.
        torque[:, place] = -mass / total * (gravity @ moves(centre))
    return jacobians, torque


def _carried(model: pin.Model, found: list[Link]) -> tuple[list[float], list[np.ndarray]]:
    """Mass that each joint carries [kg], and mass times place [kg m]."""
    masses = [float(inertia.mass) for inertia in model.inertias]
    moments = [inertia.mass * link.point(inertia.lever) for inertia, link in zip(model.inertias, found, strict=True)]
    for joint in range(model.njoints - 1, 0, -1):  # parents come first
        parent = model.parents[joint]
        masses[parent] += masses[joint]
        moments[parent] = moments[parent] + moments[joint]
    return masses, moments
