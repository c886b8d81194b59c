"""What every scorer asks of its arguments, and positions relative to the contacts.

Positions are subtracted in the precision in which they come, before anything is cast: a robot at UTM coordinates, 5e5 m from
the origin, is scored in single precision as one at the origin.
"""

from typing import Any

import jax
import numpy as np
from jax.typing import DTypeLike

from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.contact_set import ContactSet


def check_cone(cone: Any) -> None:
    """Raises TypeError for what is neither faces nor rays."""
    if not isinstance(cone, CentroidalCone | ConeRays):
        hint = "centroidal_cone(contacts) or cone_rays(contacts)"
        what = f"a {type(cone).__name__}" if isinstance(cone, ContactSet) else f"{type(cone).__name__}"
        raise TypeError(f"cone: {what} (expected {hint})")


def as_given(values: Any) -> Any:
    """An argument as an array, JAX's or NumPy's; None stays None. NumPy's go to the compiled program as they are: to make
    JAX's of them first takes longer than the answer for one state, and compiles for every number of rows.
    """
    return values if values is None or isinstance(values, jax.Array) else np.asarray(values)


def relative(cone: CentroidalCone | ConeRays, coms: Any) -> tuple[CentroidalCone | ConeRays, Any]:
    """Cone and CoM positions with the contacts' centroid as their origin, where both are NumPy's; else as they are.

    JAX's arrays have their precision already. In NumPy the difference is taken in double precision, then rounded to the
    dtype of `coms`.
    """
    if isinstance(coms, jax.Array) or not isinstance(cone.origin, np.ndarray):
        return cone, coms
    coms = np.asarray(coms)
    if coms.dtype.kind not in "iuf":
        return cone, coms
    arms = np.subtract(coms, cone.origin, dtype=np.float64)
    return cone._replace(origin=np.zeros_like(cone.origin)), rounded(arms, coms.dtype)


def unless_zero(momentum: Any) -> Any:
    """An angular momentum, None where it is known to be zero: the paper's model then, to the bit."""
    if momentum is None or isinstance(momentum, jax.core.Tracer) or np.any(np.asarray(momentum) != 0):
        return momentum
    return None


def rounded(values: Any, dtype: DTypeLike | None = None) -> Any:
    """NumPy's numbers in the precision in which JAX will take them; others as they are.

    dtype: that they came in, by default their own. What is beyond the largest number becomes infinite, and the state is
    marked: JAX's own conversion would warn of it, and crash where warnings are errors.
    """
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f":
        return values
    given = np.dtype(values.dtype if dtype is None else dtype)
    taken = jax.dtypes.canonicalize_dtype(given if given.kind == "f" else np.float64)
    with np.errstate(over="ignore"):
        return values.astype(taken, copy=False)
