"""What every room agrees on: gravity, the types of arrays, and how exactly a rotation is one."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import jax.typing
import numpy as np
from jaxtyping import Array

GRAVITY = (0.0, 0.0, -9.81)
"""[m/s^2], z up."""
FloatArray = np.ndarray | Array
ArrayLike = jax.typing.ArrayLike | Sequence[Any]
"""What becomes an array: one of NumPy or JAX, a number, or nested lists and tuples of numbers."""
ROTATION_ERROR = 1e-5
"""Largest entry of |R'R - 1| for a frame given in single precision or in a text file."""
FARTHEST = 1e8
"""Largest coordinate of a contact point [m]. Map coordinates (UTM, ECEF) are below 1e7; here double precision still tells
1e-8 m. Far beyond, differences between contacts are lost, and their squares overflow in single precision."""

SAME_PLACE = 1e-9
"""Contacts all within this of their centroid [m] are at one place ..."""
SAME_PLACE_ERRORS = 8
"""... and those within so many rounding errors of their coordinates, as 0.3 is of 0.1 + 0.2."""


def checked_gravity(gravity: ArrayLike, finite: bool = True) -> FloatArray:
    """Gravity as an array, if it is one that gravity can be.

    Args:
        gravity: (3,) [m/s^2]; of traced values only the shape is checked.
        finite: whether NaN and infinity are errors; else the caller has a status for them.

    Returns:
        (3,), a NumPy array of float64, or the JAX array that was given.

    Raises:
        TypeError: for anything but three numbers, such as 9.81.
        ValueError: for a value that is not finite.
    """
    traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(gravity))
    try:
        array = jnp.asarray(gravity) if traced or isinstance(gravity, jax.Array) else np.asarray(gravity)
        numbers = jnp.issubdtype(array.dtype, np.integer) or jnp.issubdtype(array.dtype, np.floating)
    except (TypeError, ValueError):
        numbers = False
    if not numbers:
        raise TypeError(f"gravity = {gravity!r:.80} (expected three numbers [m/s^2], as (0, 0, -9.81))")
    if array.shape != (3,):
        raise TypeError(f"gravity has shape {array.shape} (expected (3,) [m/s^2], as (0, 0, -9.81))")
    if not traced and finite and not np.isfinite(np.asarray(array)).all():
        raise ValueError(f"gravity = {np.asarray(array)} (expected finite numbers [m/s^2])")
    return array if isinstance(array, jax.Array) else array.astype(np.float64)
