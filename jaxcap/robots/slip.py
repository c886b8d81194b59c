"""Whether a foot that stands stays where it is: what the base does to it, the joints of its leg have to undo.

This ties joints to the base, which nothing else does: joints of another leg, or in another order, may look like a gait, lie
within their limits and agree with their own velocities. Places are compared, some rows apart, not velocities: noise of
every row hardly counts then.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

SPAN = 0.2
"""Places are compared that are so far apart [s]."""
STIRRED = 0.02
"""Where base and joints together move a foot less than this meanwhile, nothing is said [m]."""


def slips(
    configurations: Float[np.ndarray, "n nq"],
    centres: Float[np.ndarray, "n p 3"],
    touching: Bool[np.ndarray, "n p"],
    apart: int,
) -> Float[np.ndarray, "m p"]:
    """How far each patch moves along the ground, as a share of how far base and joints each move it.

    Args:
        configurations: In Pinocchio's conventions.
        centres: Of the patches [m].
        touching: Which touch.
        apart: Rows between the two places.

    Returns:
        A row for each pair of rows. 0 where it is at rest; near 1 where base and joints know nothing of each other; NaN
        where both hardly move, or where it does not touch all the time.
    """
    if len(centres) <= apart:
        return np.zeros((0, centres.shape[1]))
    before, after = centres[:-apart], centres[apart:]
    base = Rotation.from_quat(configurations[:, 3:7]).as_matrix()
    turned = base[apart:] @ base[:-apart].transpose(0, 2, 1)
    places = configurations[:, None, :3]
    carried = (before - places[:-apart]) @ turned.transpose(0, 2, 1) + places[apart:] - before  # as if no joint moved
    moved = after - before
    stirred = np.linalg.norm(carried, axis=2) + np.linalg.norm(moved - carried, axis=2)
    ceased = np.concatenate([np.zeros((1, touching.shape[1]), int), np.cumsum(~touching, axis=0)])
    stands = ceased[apart + 1 :] == ceased[: -apart - 1]
    share = np.linalg.norm(moved[..., :2], axis=2) / np.maximum(stirred, STIRRED)
    return np.where(stands & (stirred > STIRRED), share, np.nan)
