"""C3.3: the stop lies beyond the static region, and gravity pulls back into it, as for a robot that hangs.

The paper leaves this case open. From rest the CoM swings back under the force that least accelerates it. Every pass over a
static region of positive length costs energy, so each stop lies nearer than the one before on that side: whether the robot
is captured is settled by the first way back, which must end in a stop at all.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxcap.numerics.guarded import lesser, root
from jaxcap.one_state.boundary import Boundary, End, Ride
from jaxcap.one_state.polygon import Producer

MAX_SWINGS = 64
"""Most swings that are followed to their end for distance and time."""


class Farthest(NamedTuple):
    """The farthest place of rest from which the robot is captured."""

    alpha: Float[Array, "*n"]
    """[m], at least s_max."""
    known: Bool[Array, "*n"]
    """False where the polygon has more edges than are walked."""


def farthest_rest(outwards: Boundary, back: Boundary, s_max: Float[Array, "*n"], beyond: Bool[Array, "*n"]) -> Farthest:
    """The farthest alpha from which, at rest, the robot is captured; s_max in lanes that are not `beyond`.

    The way back to s_max gains at least the energy under the upper boundary; the way on from there can take away as much as
    maximum deceleration does until it diverges or leaves the polygon. A static region without length takes nothing.
    """
    skip = lambda outwards, back, s_max, beyond: Farthest(s_max, jnp.ones_like(beyond))
    return jax.lax.cond(jnp.any(beyond), _farthest_rest, skip, outwards, back, s_max, beyond)


def _farthest_rest(outwards, back, s_max, beyond):
    absorbed = jnp.maximum(-back.gain(back.end), 0)
    everything = (back.ending == End.NEVER) | (back.ending == End.FLOORLESS) | (back.ending == End.LIMIT)
    further = jnp.where(everything, outwards.end, lesser(outwards.negated().ride(absorbed).alpha, outwards.end))
    known = (back.ending != End.MAX_PIECES) & (outwards.ending != End.MAX_PIECES)
    return Farthest(jnp.where(beyond, s_max + further, s_max), known)


class Swing(NamedTuple):
    """Where the swings stand: at rest at `alpha`, about to go back."""

    done: Int[Array, ""]
    """Swings so far."""
    alpha: Float[Array, "*n"]
    """Where the CoM last came to rest [m]."""
    heading: Float[Array, ""]
    """Direction of the next swing, +1 or -1, the same in all lanes."""
    swinging: Bool[Array, "*n"]
    distance: Float[Array, "*n"]
    """Path since the start [m]."""
    time: Float[Array, "*n"]
    """Since the start [s]."""
    residual_speed: Float[Array, "*n"]
    """Speed that is left where a swing did not stop [m/s]."""


def swing(
    polygon: Producer, s_min: Float[Array, "*n"], s_max: Float[Array, "*n"], ride: Ride, swinging: Bool[Array, "*n"]
) -> Swing:
    """Swing to and fro until at rest in [s_min, s_max], out of control, or the bound on swings.

    ride: the way to the first stop, to which the swings' distance and time are added. Not differentiated.
    """
    polygon, s_min, s_max, ride = jax.lax.stop_gradient((polygon, s_min, s_max, ride))
    alpha = ride.alpha

    def once(state: Swing) -> Swing:
        limit, none = jnp.where(state.swinging, jnp.inf, 0), jnp.zeros_like(alpha)  # no further than to the stop
        lower = polygon.seen(state.alpha, state.heading, state.heading).boundary(limit, enough=none)
        at_end = lower.gain(lower.end)
        unknown = lower.ending == End.MAX_PIECES  # it then swings on to the bound, and has no time
        lost = state.swinging & (at_end > 0) & (lower.ending != End.NEVER)
        back = lower.ride(none)
        travelled = jnp.where(state.swinging & ~lost, back.alpha, 0)
        rest = state.alpha + state.heading * travelled
        return Swing(
            done=state.done + 1,
            alpha=rest,
            heading=-state.heading,
            swinging=state.swinging & (unknown | ~lost & ~((s_min <= rest) & (rest <= s_max))),
            distance=state.distance + travelled,
            time=state.time + jnp.where(travelled > 0, back.time, 0),
            residual_speed=jnp.where(lost, root(2 * at_end), state.residual_speed),
        )

    start = Swing(
        done=jnp.zeros((), jnp.int32),
        alpha=alpha,
        heading=-jnp.ones((), alpha.dtype),
        swinging=swinging,
        distance=alpha,
        time=ride.time,
        residual_speed=jnp.zeros_like(alpha),
    )
    return jax.lax.while_loop(lambda state: jnp.any(state.swinging) & (state.done < MAX_SWINGS), once, start)
