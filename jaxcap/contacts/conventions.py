"""What every room agrees on: gravity, the type of an array, and how exactly a rotation is one."""

import numpy as np
from jaxtyping import Array

GRAVITY = (0.0, 0.0, -9.81)
"""[m/s^2], z up."""
FloatArray = np.ndarray | Array
ROTATION_ERROR = 1e-5
"""Largest entry of |R'R - 1| for a frame given in single precision or in a text file."""
