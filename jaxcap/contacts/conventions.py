"""What every room agrees on: gravity, the types of arrays, and how exactly a rotation is one."""

from collections.abc import Sequence
from typing import Any

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
