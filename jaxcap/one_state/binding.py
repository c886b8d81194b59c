"""Which joints of a robot give in first: what a little more of each torque limit would buy, which the duals know."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxcap.contacts.actuation import Actuation
from jaxcap.contacts.cone import ConeRays
from jaxcap.contacts.conventions import GRAVITY, ArrayLike
from jaxcap.one_state.capturability import capturability


class BindingJoints(NamedTuple):
    """The joints whose torque limits decide, and by how much."""

    figure: str
    """What they decide: "max_speed", or "effort" where the posture cannot be held."""
    gains: dict[str | int, float]
    """By how much a little more of a joint's limit raises the largest speed [m/s per N m], or lowers the effort [1 per N m];
    the largest first, joints that do not bind left out. Per N m/kg where no mass is given."""


def binding_joints(
    cone: ConeRays,
    com: ArrayLike,
    com_velocity: ArrayLike,
    actuation: Actuation,
    names: Sequence[str] | None = None,
    *,
    mass: float = 1.0,
    gravity: ArrayLike = GRAVITY,
    specific_angular_momentum: ArrayLike | None = None,
    momentum_box: ArrayLike = 0.0,
) -> BindingJoints:
    """The joints that a robot's largest capturable speed, or whether it can hold its posture, hangs on.

    On the host, one state. It is the derivative of `capturability` in `actuation.limit`, which is there for many states too:
    exact away from kinks, at a kink that of one side.

    Args:
        cone: from `cone_rays`.
        com: (3,) [m], in the contacts' frame; its dtype decides the precision.
        com_velocity: (3,) [m/s]; of a robot at rest only a posture that cannot be held has joints that bind.
        actuation: of this posture.
        names: (n,) of its joints, as `jaxcap.robots.joint_names` has them; None: they are numbered.
        mass: of the robot [kg]; 1 for gains per N m/kg.
        gravity: (3,) [m/s^2].
        specific_angular_momentum: as for `capturability` [m^2/s].
        momentum_box: as for `capturability` [m^2/s^2].

    Returns:
        The joints and their gains; none where no torque limit ends the largest speed, and where that is zero or infinite.

    Raises:
        TypeError: as `capturability`.
        ValueError: for an actuation of many postures, names of another number of joints, or a mass that is not positive.
    """
    if actuation.batched:
        raise ValueError(f"actuation has {len(actuation.limit)} postures (expected one)")
    joints: Sequence[str | int] = range(actuation.joints) if names is None else names
    if len(joints) != actuation.joints:
        raise ValueError(f"names: {len(joints)} (expected {actuation.joints}, one for each joint of actuation)")
    if not 0 < mass < np.inf:
        raise ValueError(f"mass = {mass} (expected a positive number of kg)")

    def figures(limit):
        limited = Actuation(actuation.jacobians, actuation.gravity_torque, limit, actuation.mask)
        more: Any = {"specific_angular_momentum": specific_angular_momentum, "momentum_box": momentum_box}
        found = capturability(cone, com, com_velocity, gravity, actuation=limited, **more)
        return jnp.stack([found.max_speed, -found.effort]), found.effort

    slopes, effort = jax.jacfwd(figures, has_aux=True)(jnp.asarray(actuation.limit))
    unheld = bool(1 < effort < np.inf)
    gains = np.asarray(slopes, float)[int(unheld)] / mass
    # What is left of a joint that does not bind is rounding; a joint that is masked has none.
    least = np.sqrt(jnp.finfo(slopes.dtype).eps) * np.nanmax(gains, initial=0)
    order = [int(j) for j in np.argsort(-gains, kind="stable") if gains[j] > least]
    return BindingJoints("effort" if unheld else "max_speed", {joints[j]: float(gains[j]) for j in order})
