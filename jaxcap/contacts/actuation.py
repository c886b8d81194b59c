"""What a robot's joints can bear in one posture, as data: no robot model is needed to score with it.

Forces at the contacts and gravity load the joints between the base and the contacts. Per unit mass, with the force f_i at
each contact point and the torque tau of each joint,

    tau + sum_i J_i' f_i = gravity_torque,   |tau| <= limit.

A joint that carries no contact is no business of this: a free arm that sags is no fall.
"""

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxcap.contacts.cone import ConeRays
from jaxcap.contacts.conventions import ArrayLike, FloatArray


@jax.tree_util.register_pytree_with_keys_class
@dataclass(frozen=True, init=False, eq=False)
class Actuation:
    """Torques of one posture, all per unit mass: Jacobians of the contact points, load of gravity, limits.

    A batch of postures has one leading axis more in every field. Rows of contacts are those of the `ContactSet` whose rays
    it is used with; what it says of masked contacts is ignored.

    Args:
        jacobians: (k, 3, n) velocity of each contact point over the speed of each joint, in the contacts' frame, base at
            rest [m/rad, or - for a slide].
        gravity_torque: (n,) that holds the joints against gravity where no contact bears anything, over the mass [N m/kg].
        limit: (n,) largest torque either way over the mass [N m/kg], >= 0; zero for a passive joint.
        mask: (n,) bool, False for a joint that carries no contact, or that has no limit; all True if not given.

    Raises:
        ValueError: naming the field, for a wrong shape, and for a limit that is negative or not finite. Other values are not
            looked at: a posture with NaN or infinity gets `Status.NONFINITE`, and leaves others alone. Values under a JAX
            transformation are not checked.
    """

    jacobians: Float[FloatArray, "*batch k 3 n"]
    gravity_torque: Float[FloatArray, "*batch n"]
    limit: Float[FloatArray, "*batch n"]
    mask: Bool[FloatArray, "*batch n"]

    def __init__(
        self, jacobians: ArrayLike, gravity_torque: ArrayLike, limit: ArrayLike, mask: ArrayLike | None = None
    ) -> None:
        given = (jacobians, gravity_torque, limit, mask)
        traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(given))
        self._set(*(_traced if traced else _checked)(*given))

    def _set(self, *values: Any) -> None:
        for field, value in zip(fields(self), values, strict=True):
            object.__setattr__(self, field.name, value)  # the class is frozen for everybody else

    @classmethod
    def unchecked(cls, jacobians: Any, gravity_torque: Any, limit: Any, mask: Any) -> "Actuation":
        """With fields as they are, which were checked before, or are none: JAX also passes placeholders.

        Args:
            jacobians: (k, 3, n).
            gravity_torque: (n,).
            limit: (n,).
            mask: (n,).

        Returns:
            The actuation with these fields; nothing is converted, broadcast or looked at.
        """
        actuation = object.__new__(cls)
        actuation._set(jacobians, gravity_torque, limit, mask)
        return actuation

    @property
    def batched(self) -> bool:
        """Whether these are many postures, not one."""
        return self.jacobians.ndim == 4

    @property
    def joints(self) -> int:
        """Number of joints, masked ones included."""
        return self.jacobians.shape[-1]

    def padded(self, contacts: int, joints: int) -> "Actuation":
        """The same with so many rows of contacts and joints; joints that are added are masked.

        Args:
            contacts: rows, as many as those of the padded `ContactSet`.
            joints: at least as many as there are.

        Raises:
            ValueError: if there are more already.
        """
        k, _, n = self.jacobians.shape[-3:]
        if contacts < k or joints < n:
            raise ValueError(f"size {contacts} contacts, {joints} joints is less than the {k}, {n} that there are")
        xp: Any = self.jacobians.__array_namespace__()
        lead, more = [(0, 0)] * (self.limit.ndim - 1), (0, joints - n)
        widened = (xp.pad(x, [*lead, more]) for x in (self.gravity_torque, self.limit, self.mask))
        return Actuation.unchecked(xp.pad(self.jacobians, [*lead, (0, contacts - k), (0, 0), more]), *widened)

    def tree_flatten_with_keys(self) -> tuple[tuple, None]:
        """Leaves and their names, for JAX."""
        return tuple((jax.tree_util.GetAttrKey(f.name), getattr(self, f.name)) for f in fields(self)), None

    @classmethod
    def tree_unflatten(cls, _: None, leaves: Any) -> "Actuation":
        """The actuation with these leaves, for JAX."""
        return cls.unchecked(*leaves)


class ActuatedRays(NamedTuple):
    """Rays of the cone, and what the robot can do with them: what a state with limits is scored by."""

    rays: ConeRays
    actuation: Actuation
    momentum_box: Float[FloatArray, "*batch"]
    """How much the rate of angular momentum may differ from what braking asks for, each component, per unit mass
    [m^2/s^2]."""

    @property
    def batched(self) -> bool:
        """Whether this is of each of many states."""
        return self.rays.batched

    @property
    def touching(self) -> Bool[Array, "k *n"]:
        """The contacts that are not masked; lanes last, as in all that follows."""
        contacts = self.actuation.jacobians.shape[0]
        return jnp.any(jnp.reshape(self.rays.mask, (contacts, -1, *jnp.shape(self.rays.mask)[1:])), axis=1)

    @property
    def finite(self) -> Bool[Array, "*n"]:
        """Whether all is a number that says something of a contact that touches, or of a joint that counts."""
        posture = self.actuation
        moves = jnp.isfinite(posture.jacobians) | ~self.touching[:, None, None] | ~jnp.asarray(posture.mask)
        holds = jnp.isfinite(posture.gravity_torque) & jnp.isfinite(posture.limit) | ~jnp.asarray(posture.mask)
        return jnp.all(moves, axis=(0, 1, 2)) & jnp.all(holds, axis=0) & jnp.isfinite(self.momentum_box)

    def without_what_is_not_finite(self) -> "ActuatedRays":
        """Zero for all of that, and for what is ignored."""
        number = lambda x: jnp.where(jnp.isfinite(x), x, 0)
        posture = self.actuation
        jacobians = jnp.where(self.touching[:, None, None], number(posture.jacobians), 0)
        known = Actuation.unchecked(jacobians, number(posture.gravity_torque), number(posture.limit), posture.mask)
        return ActuatedRays(self.rays._replace(rays=number(self.rays.rays)), known, number(self.momentum_box))

    @property
    def origin(self) -> Float[FloatArray, "..."]:
        """Centroid of the contact points [m]."""
        return self.rays.origin

    @property
    def length(self) -> Float[FloatArray, "..."]:
        """Size of the stance [m]."""
        return self.rays.length


def actuated(
    cone: Any, actuation: Actuation | None, momentum_box: ArrayLike = 0.0, states: int | None = None
) -> ActuatedRays:
    """Rays with a robot's limits; where one of several parts is a batch, the others are repeated.

    Args:
        cone: from `cone_rays`.
        actuation: of one posture, or of each of many; None: joints bear anything.
        momentum_box: >= 0, one number or (n,) [m^2/s^2].
        states: how many are scored; None for one.

    Raises:
        TypeError: for what is no actuation, for faces, Jacobians of other contacts, or another number of postures.
        ValueError: for a box that is negative or not finite.
    """
    if not isinstance(cone, ConeRays):
        raise TypeError(f"cone: a {type(cone).__name__} (expected cone_rays(contacts): the robot's limits need the rays)")
    rays = cone.rays.shape[-2]
    if actuation is None:
        actuation = Actuation.unchecked(np.zeros((1, 3, 0)), np.zeros(0), np.zeros(0), np.zeros(0, bool))
    if not isinstance(actuation, Actuation):
        raise TypeError(f"actuation: {type(actuation).__name__} (expected a jaxcap.Actuation)")
    contacts = actuation.jacobians.shape[-3]
    if actuation.joints and (contacts == 0 or rays % contacts or rays // contacts < 3):
        raise TypeError(f"actuation.jacobians: {contacts} contacts, for {rays} rays (expected those of the same contacts)")
    box = _box(momentum_box)
    for name, batched, count in (
        ("actuation", actuation.batched, len(actuation.limit) if actuation.batched else 0),
        ("momentum_box", box.ndim == 1, box.size),
    ):
        if batched and count != states:
            what = "one" if states is None else f"one, or one for each of {states} states"
            raise TypeError(f"{name} has {count} rows (expected {what})")
    many = cone.batched or actuation.batched or box.ndim == 1
    if not many:
        return ActuatedRays(cone, actuation, box)
    return ActuatedRays(
        cone if cone.batched else _repeated(cone, states),
        actuation if actuation.batched else _repeated(actuation, states),
        box if box.ndim == 1 else _repeated(box, states),
    )


def with_limits(cone: Any, actuation: Actuation | None, momentum_box: ArrayLike, states: int | None = None) -> Any:
    """The cone as it is where nothing limits it, else `actuated`: a box of zero is today's program, in either form."""
    none = actuation is None and not isinstance(momentum_box, jax.core.Tracer) and not np.any(np.asarray(momentum_box) != 0)
    return cone if none else actuated(cone, actuation, momentum_box, states)


def torque_columns(rays: Float[FloatArray, "r 6 *#n"], jacobians: Float[FloatArray, "k 3 j *#n"]) -> Any:
    """Torque of each joint under a unit of each ray: J' f, lanes last.

    Args:
        rays: of k contacts, those of one contact together.
        jacobians: of these contacts.

    Returns:
        (j, r, *n).
    """
    contacts, _three, joints, *_lanes = jacobians.shape
    forces = rays[:, :3].reshape(contacts, -1, 3, *rays.shape[2:])
    found: Any = sum(jacobians[:, None, x] * forces[:, :, x, None] for x in range(3))
    return jnp.moveaxis(found.reshape(rays.shape[0], joints, *jnp.shape(found)[3:]), 0, 1)


def _box(momentum_box: Any) -> Any:
    """The box as an array, or ValueError."""
    if isinstance(momentum_box, jax.core.Tracer):
        return momentum_box
    box = momentum_box if isinstance(momentum_box, jax.Array) else np.asarray(momentum_box, float)
    if box.ndim > 1:
        raise ValueError(f"momentum_box has shape {box.shape} (expected one number, or (n,))")
    for value in np.asarray(box)[~(np.isfinite(box) & (np.asarray(box) >= 0))].flat[:1]:
        raise ValueError(f"momentum_box = {value} (expected a number of m^2/s^2, not negative)")
    return box


def _repeated(tree: Any, count: int | None) -> Any:
    """The same for each of many states; NumPy's arrays take no memory by it."""
    repeat = lambda x: (np if isinstance(x, np.ndarray) else jnp).broadcast_to(x, (count, *np.shape(x)))
    return jax.tree.map(repeat, tree)


def _traced(jacobians: Any, gravity_torque: Any, limit: Any, mask: Any) -> tuple[Any, Any, Any, Any]:
    """The four fields as JAX arrays of full shape; values are not known."""
    jacobians, gravity_torque, limit = (jnp.asarray(x) for x in (jacobians, gravity_torque, limit))
    lead = (*jacobians.shape[:-3], jacobians.shape[-1])
    mask = jnp.ones(lead, bool) if mask is None else jnp.broadcast_to(jnp.asarray(mask), lead)
    for name, value in (("gravity_torque", gravity_torque), ("limit", limit)):
        _check_shape(name, jnp.shape(jnp.broadcast_to(value, lead) if value.ndim <= 1 else value), lead)
    return jacobians, jnp.broadcast_to(gravity_torque, lead), jnp.broadcast_to(limit, lead), mask


def _checked(jacobians: Any, gravity_torque: Any, limit: Any, mask: Any) -> tuple[Any, Any, Any, Any]:
    """The four fields as arrays of full shape, or ValueError."""
    jacobians = _numbers("jacobians", jacobians)
    if jacobians.ndim not in (3, 4) or jacobians.shape[-2] != 3:
        raise ValueError(f"jacobians has shape {jacobians.shape} (expected (k, 3, n), or (rows, k, 3, n))")
    lead = (*jacobians.shape[:-3], jacobians.shape[-1])
    gravity_torque, limit = _numbers("gravity_torque", gravity_torque), _numbers("limit", limit)
    mask = np.ones(lead, bool) if mask is None else mask
    mask = mask if isinstance(mask, jax.Array) else np.asarray(mask)
    if mask.dtype != bool:
        raise ValueError(f"mask: {mask.dtype} (expected bool)")
    _check_shape("gravity_torque", gravity_torque.shape, lead)
    for name, value in (("limit", limit), ("mask", mask)):
        _check_shape(name, value.shape, lead if value.ndim == len(lead) else lead[-1:])
    limit, mask = (
        np.broadcast_to(x, lead) if isinstance(x, np.ndarray) else jnp.broadcast_to(x, lead) for x in (limit, mask)
    )
    wrong = np.asarray(mask) & ~(np.isfinite(np.asarray(limit)) & (np.asarray(limit) >= 0))
    for index in np.argwhere(wrong)[:1]:
        place = ", ".join(map(str, index))
        raise ValueError(f"limit[{place}] = {limit[tuple(index)]} (expected a finite number of N m/kg, not negative)")
    return jacobians, gravity_torque, limit, mask


def _check_shape(name: str, shape: tuple[int, ...], expected: tuple[int, ...]) -> None:
    if shape != expected:
        raise ValueError(f"{name} has shape {shape} (expected {expected}, by jacobians)")


def _numbers(name: str, value: Any) -> Any:
    """`value` as an array of floats, or ValueError."""
    if isinstance(value, jax.Array):
        return value
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf":
            raise TypeError
    except (TypeError, ValueError):
        raise ValueError(f"{name}: {value!r:.80} (expected numbers)") from None
    return array if array.dtype.kind == "f" else array.astype(np.float64)
