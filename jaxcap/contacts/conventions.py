"""What every room agrees on: gravity, the types of arrays, and how exactly a rotation is one."""

import numpy as np
import numpy.typing
from jaxtyping import Array

GRAVITY = (0.0, 0.0, -9.81)
"""[m/s^2], z up."""
FloatArray = np.ndarray | Array
ArrayLike = numpy.typing.ArrayLike | Array
"""What becomes an array: one of NumPy or JAX, a number, or nested lists and tuples of numbers."""
ROTATION_ERROR = 1e-5
"""Largest entry of |R'R - 1| for a frame given in single precision or in a text file."""
