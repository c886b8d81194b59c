"""Where the robot touches the world: contact points, frames, friction."""

from dataclasses import dataclass, fields
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxcap.contacts.conventions import FARTHEST, ROTATION_ERROR, ArrayLike, FloatArray


@jax.tree_util.register_pytree_with_keys_class
@dataclass(frozen=True, init=False, eq=False)
class ContactSet:
    """Point contacts, each with a frame and a friction coefficient. `a + b` joins two sets.

    All in one inertial frame, z up. A batch of sets of equally many rows has one leading axis more in every field: points
    (n, k, 3), frames (n, k, 3, 3) or (3, 3), friction (n, k) or one number, mask (n, k).

    Args:
        points: (k, 3) [m], coordinates at most 1e8.
        frames: (k, 3, 3) rotations, or one (3, 3) for all. The third column is the normal and points at the robot, the first
            is the tangent from which the edges of the friction pyramid are counted.
        friction: (k,) or one number for all, > 0; above 1e4 it counts as 1e4, which never slips.
        mask: (k,) bool, False for a row that is only padding; all True if not given.

    Raises:
        ValueError: naming field and row, for a wrong shape, a value that is not finite, a point beyond `FARTHEST`, a frame
            that is not a rotation, or a friction that is not positive. Values under a JAX transformation are not checked.
    """

    points: Float[FloatArray, "*batch k 3"]
    frames: Float[FloatArray, "*batch k 3 3"]
    friction: Float[FloatArray, "*batch k"]
    mask: Bool[FloatArray, "*batch k"]

    def __init__(self, points: ArrayLike, frames: ArrayLike, friction: ArrayLike, mask: ArrayLike | None = None) -> None:
        traced = any(isinstance(x, jax.core.Tracer) for x in (points, frames, friction, mask))
        self._set(*(_traced if traced else _checked)(points, frames, friction, mask))

    def _set(self, points: Any, frames: Any, friction: Any, mask: Any) -> None:
        for name, value in (("points", points), ("frames", frames), ("friction", friction), ("mask", mask)):
            object.__setattr__(self, name, value)  # the class is frozen for everybody else

    @classmethod
    def unchecked(cls, points: Any, frames: Any, friction: Any, mask: Any) -> "ContactSet":
        """A set of values that were checked before, or that are none: JAX also passes placeholders.

        Args:
            points: (k, 3) [m], as a NumPy or JAX array; (n, k, 3) for a batch.
            frames: (k, 3, 3), one for each row.
            friction: (k,).
            mask: (k,) bool.

        Returns:
            The set with these fields as they are: nothing is converted, broadcast or looked at.
        """
        contacts = object.__new__(cls)
        contacts._set(points, frames, friction, mask)
        return contacts

    def __len__(self) -> int:
        """Number of rows, padding included."""
        return self.points.shape[-2]

    def __add__(self, other: "ContactSet") -> "ContactSet":
        if not isinstance(other, ContactSet):
            return NotImplemented
        xp: Any = self.points.__array_namespace__()
        rows = self.mask.ndim - 1
        return ContactSet(*(xp.concat([getattr(self, f.name), getattr(other, f.name)], axis=rows) for f in fields(self)))

    def padded(self, size: int) -> "ContactSet":
        """The same contacts in `size` rows; the rows added are masked.

        Raises:
            ValueError: if there are more rows already.
        """
        if size < len(self):
            raise ValueError(f"size = {size} is less than the {len(self)} contacts there are")
        rows = (*self.mask.shape[:-1], size - len(self))
        return self + ContactSet(np.zeros((*rows, 3)), np.eye(3), np.ones(rows), mask=np.zeros(rows, dtype=bool))

    # Cones are named tuples, which JAX takes apart by itself. This class checks what it is made of, and must not check what
    # JAX puts into it, so it says how it is taken apart.
    def tree_flatten_with_keys(self) -> tuple[tuple, None]:
        """Leaves and their names, for JAX."""
        return tuple((jax.tree_util.GetAttrKey(f.name), getattr(self, f.name)) for f in fields(self)), None

    @classmethod
    def tree_unflatten(cls, _: None, leaves: Any) -> "ContactSet":
        """The set with these leaves, for JAX."""
        return cls.unchecked(*leaves)


def rectangle(
    position: ArrayLike, rotation: ArrayLike, half_length: ArrayLike, half_width: ArrayLike, friction: ArrayLike
) -> ContactSet:
    """A foot or a hand: four contacts at the corners of a rectangle.

    Args:
        position: (3,) centre [m].
        rotation: (3, 3), columns: direction of the length, of the width, normal pointing at the robot.
        half_length: [m], > 0.
        half_width: [m], > 0.
        friction: coefficient, > 0.

    Returns:
        The four corners as a contact set.

    Raises:
        ValueError: naming the field.
    """
    position, rotation = _array("position", position, (3,)), _array("rotation", rotation, (3, 3))
    sizes: dict[str, Any] = {"half_length": half_length, "half_width": half_width}
    for name, value in sizes.items():
        if not (np.ndim(value) == 0 and np.isfinite(value) and value > 0):
            raise ValueError(f"{name} = {value} (expected a positive number of metres)")
    corners = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) * [*sizes.values(), 0]
    return ContactSet(points=position + corners @ rotation.T, frames=rotation, friction=friction)


def _traced(points: Any, frames: Any, friction: Any, mask: Any) -> tuple[Any, Any, Any, Any]:
    """The four fields as JAX arrays of full shape; values are not known."""
    points, frames, friction = (jnp.asarray(x) for x in (points, frames, friction))
    frames = jnp.broadcast_to(frames, (*points.shape[:-1], 3, 3))
    friction = jnp.broadcast_to(friction, points.shape[:-1])
    mask = jnp.ones(points.shape[:-1], dtype=bool) if mask is None else jnp.asarray(mask)
    return points, frames, friction, mask


def _checked(points: Any, frames: Any, friction: Any, mask: Any) -> tuple[Any, Any, Any, Any]:
    """The four fields as NumPy arrays of full shape, or ValueError."""
    batch = (None,) * (np.ndim(points) - 2)
    points = _array("points", points, (*batch, None, 3))
    rows = points.shape[:-1]
    for index in np.argwhere(np.abs(points) > FARTHEST)[:1]:
        raise ValueError(f"points{_place(index)} = {points[tuple(index)]} (expected at most {FARTHEST:.0e} m)")
    frames = np.asarray(frames)
    if frames.shape == (3, 3):
        frames = np.broadcast_to(frames, (*rows, 3, 3))
    frames = _array("frames", frames, (*rows, 3, 3))
    friction = np.asarray(friction)
    if friction.ndim == 0:
        friction = np.broadcast_to(friction, rows)
    friction = _array("friction", friction, rows, finite=False)
    mask = np.ones(rows, dtype=bool) if mask is None else np.asarray(mask)
    if mask.dtype != bool or mask.shape != rows:
        raise ValueError(f"mask: {mask.dtype} of shape {mask.shape} (expected bool of shape {rows})")
    for index in np.argwhere(~(np.isfinite(friction) & (friction > 0)))[:1]:
        raise ValueError(f"friction{_place(index)} = {friction[tuple(index)]} (expected a positive finite number)")
    error = np.abs(np.swapaxes(frames, -1, -2) @ frames - np.eye(3)).max(axis=(-1, -2), initial=0)
    determinant = np.linalg.det(frames)
    for index in np.argwhere((error > ROTATION_ERROR) | (determinant < 0))[:1]:
        raise ValueError(
            f"frames{_place(index)} is not a rotation: det = {determinant[tuple(index)]:.3f} (expected +1), "
            f"columns orthonormal to {error[tuple(index)]:.1e} (expected {ROTATION_ERROR:.0e})"
        )
    return points, frames, friction, mask


def _place(index: Any) -> str:
    return f"[{', '.join(map(str, index))}]"


def _array(name: str, value: Any, shape: tuple[int | None, ...], finite: bool = True) -> np.ndarray:
    """`value` as a float array of this shape (None: any size), or ValueError."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf":
            raise TypeError
        array = array.astype(np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: {value!r:.80} (expected numbers)") from None
    if array.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        sizes = ", ".join("k" if n is None else str(n) for n in shape)
        raise ValueError(f"{name} has shape {array.shape} (expected ({sizes}))")
    if finite and not np.isfinite(array).all():
        index = np.argwhere(~np.isfinite(array))[0]
        raise ValueError(f"{name}{_place(index)} = {array[tuple(index)]} (expected a finite number)")
    return array
