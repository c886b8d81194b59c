"""Operations and bytes that one state needs, counted by hand from the code; see NOTES.md for the count, line by line.

An operation is an addition, multiplication, division, root, comparison, choice, minimum or maximum. What the algorithm needs
once is counted, for the mean number of pieces and pivots of the states measured; not what is done again in the second round
of a chunk, nor lanes that wait for others. Bytes are those that have to come from and go to memory: the state, its own
contacts if it has any, and the answer. Faces, and rays that are shared, stay in the cache.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import GRAVITY
from jaxcap.one_state.line import motion_of_lanes, survey_of_lanes

LINE = 61
"""Direction (20) and wrenches (41) of the line of travel."""
ROW, ROW_PIECE = 97, 12
"""Each face: half-plane 40, survey 32, first line and wall 25; and on each piece that is walked."""
RAY, RAY_PIVOT, RAY_PIECE = 15, 15, 34
"""Each ray: torque scaled and a little of it added to the target; and in each pivot, and on each piece that is walked."""
PIVOT, PIVOT_PIECE = 400, 500
"""What a pivot costs beside the rays: products of 6 x 6 matrices and the ratio test."""
ENDS = 4
"""Steps that end a simplex and pivot no more: three programs of the survey, and the first line of the boundary."""
MOTION, MOTION_PIECE = 200, 160
"""Speeds, case and figures; and on each piece: the record 40, five energy integrals 45, the ride 70."""
ANSWER = 7
"""Figures of the answer, beside one bool and two int8."""


class Work(NamedTuple):
    """What states do, on average."""

    pieces: float
    """Pieces of the lower boundary."""
    pivots: float
    """Of the survey; zero for faces."""


def work(cone: CentroidalCone | ConeRays, coms, com_velocities) -> Work:
    """Mean work of these states (n, 3), (n, 3)."""
    own = isinstance(cone, ConeRays) and cone.rays.ndim == 3
    lanes = jax.tree.map(lambda leaf: jnp.moveaxis(jnp.asarray(leaf), 0, -1), cone) if own else cone
    travelling = lanes, jnp.asarray(coms).T, jnp.asarray(com_velocities).T, GRAVITY
    pieces = jax.jit(lambda *state: motion_of_lanes(*state).line.lower.pieces)(*travelling)
    pivots = jnp.mean(survey_of_lanes(*travelling).near.pivots) if isinstance(cone, ConeRays) else 0
    return Work(float(jnp.mean(jnp.sum(pieces.right > pieces.left, axis=0))), float(pivots))


def rows(cone: CentroidalCone | ConeRays) -> int:
    """Faces, or rays."""
    return len(cone.faces) if isinstance(cone, CentroidalCone) else cone.rays.shape[-2]


def operations(cone: CentroidalCone | ConeRays, found: Work) -> float:
    """Operations of a state."""
    motion = LINE + MOTION + found.pieces * MOTION_PIECE
    if isinstance(cone, CentroidalCone):
        return motion + rows(cone) * (ROW + found.pieces * ROW_PIECE)
    steps = found.pivots + ENDS
    along = rows(cone) * (RAY + steps * RAY_PIVOT + found.pieces * RAY_PIECE)
    return motion + along + steps * PIVOT + found.pieces * PIVOT_PIECE


def traffic(cone: CentroidalCone | ConeRays, dtype: str) -> int:
    """Bytes of a state."""
    size = np.dtype(dtype).itemsize
    state = (6 + ANSWER) * size + 3
    if isinstance(cone, ConeRays) and cone.rays.ndim == 3:
        state += (6 * rows(cone) + 4) * size + rows(cone)
    return state
