"""States that rays leave undecided are asked again by faces, in double precision on the host: somebody wants to know.

They are few, and a projection takes milliseconds. Faces settle them by other numbers: they choose no bases, so none can tie.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxcap.batch.blocks import ROWS
from jaxcap.batch.rounds import States
from jaxcap.contacts.cone import CentroidalCone, ConeRays, projected
from jaxcap.contacts.conventions import ArrayLike
from jaxcap.contacts.projection import ProjectionError
from jaxcap.one_state.capturability import capturability
from jaxcap.one_state.result import Capturability, Status

MOST = 1000
"""No more states of a call are asked again: so many are no accident, and would take minutes."""


class _State(NamedTuple):
    """One state with its own contacts."""

    cone: CentroidalCone
    com: Float[np.ndarray, "3"]
    com_velocity: Float[np.ndarray, "3"]
    specific_angular_momentum: Float[np.ndarray, "3"] | None


def decided(cone: ConeRays, states: States, gravity: ArrayLike, found: Capturability) -> Capturability:
    """The answers, those that are missing from faces; what faces do not decide either stays undecided.

    Args:
        cone: of all states, or of each.
        states: n of them, in the cone's frame.
        gravity: (3,) [m/s^2].
        found: by rays, (n,).
    """
    rows = np.flatnonzero(np.asarray(found.status) == Status.MAX_STEPS)
    if len(rows) == 0:
        return found
    fields = [np.array(field) for field in found]
    on_the_host = jax.default_device(jax.local_devices(backend="cpu")[0])
    with jax.enable_x64(True), on_the_host, np.errstate(over="ignore"):
        gravity = np.asarray(gravity, float)
        for row in rows[:MOST]:
            state = _state(cone, states, int(row))
            if state is None:
                continue
            for field, value in zip(
                fields,
                _compiled(*state[:3], gravity, specific_angular_momentum=state.specific_angular_momentum),
                strict=True,
            ):
                field[row] = value
    return Capturability(*map(jax.numpy.asarray, fields))


def _state(cone: ConeRays, states: States, row: int) -> _State | None:
    """None where the rays have no faces."""
    own = lambda field: np.asarray(field[row] if cone.batched else field, float)
    try:
        faces = projected(own(cone.rays), own(cone.origin), own(cone.length))
    except ProjectionError:
        return None
    size = ROWS
    while size < len(faces.faces):
        size *= 4  # few sizes: each is compiled
    of_row = lambda vectors: np.asarray(vectors[row], float)
    momentum = None if states.specific_angular_momenta is None else of_row(states.specific_angular_momenta)
    return _State(faces.padded(size), of_row(states.coms), of_row(states.com_velocities), momentum)


_compiled = jax.jit(capturability)
