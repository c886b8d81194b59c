"""The centroidal cone of a contact set: by its faces, or by its rays."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import SAME_PLACE, SAME_PLACE_ERRORS, ArrayLike, FloatArray
from jaxcap.contacts.friction import STICKIEST, wrench_rays
from jaxcap.contacts.projection import ProjectionError, boxed_faces, cone_faces


class EffortFaces(NamedTuple):
    """Share of a robot's torque limits that standing still takes, by the wrench per unit mass that contacts then exert."""

    per_wrench: Float[FloatArray, "e 6"]
    """The effort is the largest of per_wrench @ wrench + constant: one row for each piece ..."""
    constant: Float[FloatArray, " e"]
    held: Float[FloatArray, "h 6"]
    """... where held @ wrench <= room; elsewhere no torques hold the robot. Faces of the cone without limits, but for joints
    whose limit is zero."""
    room: Float[FloatArray, " h"]
    """[m/s^2]"""


class CentroidalCone(NamedTuple):
    """All wrenches that the contacts can exert: faces @ (force, torque about `origin`) <= 0, (6).

    With a momentum box, or joints that bear only so much, all wrenches per unit mass: faces @ ... <= offsets. That is a
    polyhedron.

    A row is a face, an equality a pair of opposite rows; rows of zeros are padding. Rows are scaled such that
    (faces[:, :3], faces[:, 3:] * length) have unit length.
    """

    faces: Float[FloatArray, "*batch m 6"]
    """[-] for the three columns of force, [1/m] for those of torque."""
    origin: Float[FloatArray, "*batch 3"]
    """Centroid of the contact points [m]: a robot far from the world's origin is scored like one near it."""
    length: Float[FloatArray, "*batch"]
    """Distance of the farthest contact point from the origin [m], or 1 for a single place: the scale of rounding errors."""
    offsets: Float[FloatArray, "*batch m"] | None = None
    """How far out each row is [m/s^2], by the momentum box and the joints; None without: zero, to the bit and at no cost."""
    effort: EffortFaces | None = None
    """Of `actuated_cone`; None without the robot's limits."""

    def padded(self, rows: int) -> "CentroidalCone":
        """The same cone with at least this many rows: those added bound nothing."""
        extra = max(0, rows - len(self.faces))
        xp: Any = self.faces.__array_namespace__()
        if not extra:
            return self
        offsets = None if self.offsets is None else xp.pad(self.offsets, (0, extra))
        return self._replace(faces=xp.pad(self.faces, ((0, extra), (0, 0))), offsets=offsets)


def centroidal_cone(contacts: ContactSet, sides: int = 4, momentum_box: ArrayLike = 0.0) -> CentroidalCone:
    """Project the contacts' friction pyramids to the faces of the centroidal cone (6); host only, once a contact set.

    Args:
        contacts: one set, with at least one contact that is not masked.
        sides: edges of each friction pyramid, >= 3.
        momentum_box: by how much the rate of the robot's angular momentum over its mass may differ, in each component (along
            x, y and z), from what its motion says (zero, or that of `specific_angular_momentum`) [m^2/s^2]: by limbs that it
            moves. TALOS stopped best with 10 N m over its 90 kg. It counts at all times, where the robot stands still too.

    Returns:
        The faces, in double precision. They hold for any mass. With a box there are about twice as many.

    Raises:
        ValueError: for an empty set, sides < 3, a box that is negative or not finite, or contacts under a JAX transformation
            (`cone_rays` takes those).
        ProjectionError: a ValueError, where the faces found do not pass their check against the rays.

    Source: Caron, Pham, Nakamura, Leveraging Cone Double Description for Multi-contact Stability, RSS 2015.
    """
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((contacts, momentum_box))):
        raise ValueError("centroidal_cone works on the host, once for each contact set: call it outside jit, vmap and grad")
    box, stance = box_of_all(momentum_box), stance_of(contacts, sides)
    try:
        return projected(stance.rays, stance.origin, stance.length, box)
    except ProjectionError as error:
        raise ProjectionError(f"faces of {len(stance.touching)} contacts with {sides} sides: {error}") from error


class Stance(NamedTuple):
    """The contacts that touch, on the host."""

    touching: ContactSet
    rays: Float[np.ndarray, "r 6"]
    """Of `wrench_rays`."""
    origin: Float[np.ndarray, "3"]
    """About which torques are taken [m]."""
    length: Float[np.ndarray, ""]
    """Its size [m], 1 for a single place."""


def stance_of(contacts: ContactSet, sides: int) -> Stance:
    """Where a robot stands, from one contact set. Raises ValueError for an empty one and for sides < 3."""
    active = jax.tree.map(lambda leaf: np.asarray(leaf)[np.asarray(contacts.mask)], contacts)
    if len(active) == 0:
        raise ValueError(f"contacts: none of {len(contacts)} is active (expected at least one)")
    origin = active.points.mean(axis=0)
    length = np.linalg.norm(active.points - origin, axis=1).max()
    length = length if length > _same_place(active) else 1.0
    return Stance(active, np.asarray(wrench_rays(active, sides, origin)), origin, np.asarray(length))


def box_of_all(momentum_box: ArrayLike) -> float:
    """The momentum box of one posture. Raises ValueError for what is none."""
    box = np.asarray(momentum_box)
    if not (box.ndim == 0 and box.dtype.kind in "iuf" and 0 <= box < np.inf):
        raise ValueError(f"momentum_box = {momentum_box} (expected a number of m^2/s^2, not negative)")
    return float(box)


def projected(
    rays: Float[np.ndarray, "r 6"], origin: Float[np.ndarray, "3"], length: Float[np.ndarray, ""], momentum_box: float = 0.0
) -> CentroidalCone:
    """The cone of one contact set by its faces, from its rays; host only.

    Args:
        rays: as those of `ConeRays`; zeros are ignored.
        origin: about which torques are taken [m].
        length: size of the stance [m].
        momentum_box: as for `centroidal_cone`.

    Raises:
        ProjectionError: as `centroidal_cone`.
    """
    scale = np.array([1, 1, 1, length, length, length])
    faces = boxed_faces(rays / scale) if momentum_box else cone_faces(rays / scale)
    faces = faces[order_of(faces)] / scale
    # The farthest that a box goes along a normal; exact, whatever rounding the projection has.
    offsets = momentum_box * np.abs(faces[:, 3:]).sum(axis=1) if momentum_box else None
    return CentroidalCone(faces=faces, origin=origin, length=length, offsets=offsets)


def order_of(faces: Float[np.ndarray, "m 6"]) -> Int[np.ndarray, " m"]:
    """An order of unit normals that rounding does not change: not that of the contacts, nor Qhull's."""
    return np.lexsort(np.round(faces, 9).T)


class ConeRays(NamedTuple):
    """All wrenches that the contacts can exert: sums of these rays (force, torque about `origin`) with weights >= 0.

    One contact set, or a batch of them with equally many rows.
    """

    rays: Float[FloatArray, "*batch r 6"]
    """[-] for force, of unit length, [m] for torque; rays of masked contacts are zero."""
    mask: Bool[FloatArray, "*batch r"]
    """False for the rays of masked contacts."""
    origin: Float[FloatArray, "*batch 3"]
    """Centroid of the contact points [m]: a robot far from the world's origin is scored like one near it."""
    length: Float[FloatArray, "*batch"]
    """Distance of the farthest contact point from the origin [m], or 1 where all are at one place."""
    sides: Int[FloatArray, "*batch"] | None = None
    """How many rays each contact has, contact by contact; padding may follow. Only derivatives ask for it, where rays tie:
    those of a contact move together."""

    @property
    def batched(self) -> bool:
        """Whether these are the rays of a batch of contact sets, not of one."""
        return self.rays.ndim == 3

    def padded(self, rows: int) -> "ConeRays":
        """The same cone with at least this many rows: those added bear nothing.

        Args:
            rows: wanted, of each contact set.
        """
        extra = max(0, rows - self.rays.shape[-2])
        if not extra:
            return self
        lead = [(0, 0)] * (self.rays.ndim - 2)
        xp_rays, xp_mask = (array.__array_namespace__() for array in (self.rays, self.mask))
        rays, mask = xp_rays.pad(self.rays, [*lead, (0, extra), (0, 0)]), xp_mask.pad(self.mask, [*lead, (0, extra)])
        return self._replace(rays=rays, mask=mask)


def cone_rays(contacts: ContactSet, sides: int = 4) -> ConeRays:
    """The rays of the contacts' friction pyramids: the centroidal cone without its faces, at no cost.

    Pure: works under jit and vmap, and is differentiable in points, frames and friction.

    Args:
        contacts: one set, or a batch of sets of equally many rows (see `ContactSet.padded`), each of which may be masked in
            part or altogether.
        sides: edges of each friction pyramid, >= 3.

    Returns:
        The rays, with a leading axis for a batch.

    Raises:
        ValueError: if sides < 3.
    """
    local, origin = centred(contacts)
    # One set in NumPy stays so to the end: JAX would compile every number of contacts anew. With many sets JAX is faster.
    alone = contacts.points.ndim == 2 and all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(local))
    spanned = _spanned if alone else _spanned_by_jax
    rays, mask, length = map(jnp.asarray, spanned(local, _same_place(contacts), sides))
    alike = jnp.asarray(np.full(length.shape, sides, np.int32))
    return ConeRays(rays=rays, mask=mask, origin=origin, length=length, sides=alike)


def _spanned(local: ContactSet, same_place: Any, sides: int) -> tuple[Any, Any, Any]:
    """Rays, mask and length of contacts about their centroid; of NumPy's, the length of one set is a NumPy scalar."""
    xp: Any = local.points.__array_namespace__()
    # Where torques are taken about changes nothing, nor does their scale: no gradient.
    points = local.points if isinstance(local.points, np.ndarray) else jax.lax.stop_gradient(local.points)
    square = xp.max(xp.sum(xp.where(local.mask[..., None], points, 0) ** 2, axis=-1), axis=-1, initial=0)
    apart = square > same_place**2
    length = xp.where(apart, xp.sqrt(xp.where(apart, square, 1)), 1)
    rays = wrench_rays(local, sides, xp.zeros_like(points[..., 0, :]))
    return rays, xp.repeat(local.mask, sides, axis=-1), length


_spanned_by_jax = jax.jit(_spanned, static_argnames="sides")


def centred(contacts: ContactSet) -> tuple[ContactSet, FloatArray]:
    """The same contacts about their centroid, that of those which are not masked, and the centroid.

    NumPy's arrays stay such, in double precision: far from the world's origin JAX's single precision would round contacts to
    centimetres and more before anything is subtracted.

    Args:
        contacts: one set, or a batch of them.

    Returns:
        Contacts with the centroid at the origin, their friction as it counts, and where the centroid was, (..., 3) [m].
    """
    points = contacts.points if isinstance(contacts.points, np.ndarray) else jax.lax.stop_gradient(contacts.points)
    xp: Any = np if isinstance(points, np.ndarray) else jnp
    mask = contacts.mask[..., None]
    origin = xp.sum(xp.where(mask, points, 0), axis=-2) / xp.maximum(xp.sum(mask, axis=-2), 1)
    local = contacts.points - origin[..., None, :]
    return ContactSet.unchecked(local, contacts.frames, xp.minimum(contacts.friction, STICKIEST), contacts.mask), origin


def _same_place(contacts: ContactSet) -> Any:
    """Contacts within this of their centroid [m] are at one place."""
    xp: Any = contacts.points.__array_namespace__()
    largest = xp.max(xp.abs(xp.where(contacts.mask[..., None], contacts.points, 0)), axis=(-1, -2), initial=0)
    return xp.maximum(SAME_PLACE, SAME_PLACE_ERRORS * float(jnp.finfo(contacts.points.dtype).eps) * largest)
