"""The rows of a state's programs with a robot's limits: force, torque and the joints' torques, each in its own scale."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxcap.contacts.actuation import ActuatedRays, torque_columns
from jaxcap.one_state.wrench_line import WrenchLine

LEAST_LIMIT = 1e-3
"""Torque rows are scaled by the joint's limit, or by that of gravity on an arm of this share of the stance if it is less."""


class Rows(NamedTuple):
    """The rows of a state's programs, scaled."""

    rays: Float[Array, "m r *n"]
    gravity: Float[Array, "j *n"]
    """Torque that holds each joint."""
    bound: Float[Array, "m *n"]
    length: Float[Array, "*#n"]

    def scaled(self, wrench: Float[Array, "6 *n"]) -> Float[Array, "6 *n"]:
        """A wrench in the units of the rows."""
        return jnp.concatenate([wrench[:3], wrench[3:] / self.length])

    @staticmethod
    def of(cone: ActuatedRays, line: WrenchLine, lanes: tuple[int, ...], dtype: Any) -> "Rows":
        """Of lanes of this shape. Rows of masked joints are zero."""
        full = lambda x, axes: jnp.broadcast_to(
            jnp.asarray(x, dtype).reshape(*jnp.shape(x)[:axes], *jnp.shape(x)[axes:] or [1] * len(lanes)),
            (*jnp.shape(x)[:axes], *lanes),
        )
        actuation, rays = cone.actuation, full(cone.rays.rays, 2)
        mask = full(actuation.mask, 1) > 0
        limit = jnp.where(mask, full(actuation.limit, 1), 0)
        least = LEAST_LIMIT * line.length * line.weight
        unit = jax.lax.stop_gradient(jnp.maximum(limit, least) / jnp.where(line.weight > 0, line.weight, 1))
        unit = jnp.where(unit > 0, unit, 1)
        joint = lambda x, over: jnp.where(mask if x.ndim == mask.ndim else mask[:, None], x, 0) / over
        torques = joint(torque_columns(rays, full(actuation.jacobians, 3)), unit[:, None])
        wrenches = jnp.moveaxis(jnp.concatenate([rays[:, :3], rays[:, 3:] / line.length], axis=1), 0, 1)
        box = full(cone.momentum_box, 0) / line.length
        both = jnp.concatenate([wrenches, torques])
        return Rows(
            rays=jnp.concatenate([both, jnp.zeros_like(both[:, :1])], axis=1),
            gravity=joint(full(actuation.gravity_torque, 1), unit),
            bound=jnp.concatenate([jnp.zeros((3, *lanes), dtype), jnp.broadcast_to(box, (3, *lanes)), limit / unit]),
            length=line.length,
        )
