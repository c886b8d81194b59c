"""Whether states and contacts look like metres in one frame with z up: what a robot can hardly be like is worth a word.

Nothing here is an error of itself: a note is for whoever forgot a unit, a sign or a frame.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

FAR = 10.0
"""A CoM is hardly farther from all contacts of its robot [m] ..."""
WIDE = 5.0
"""... and contacts of one robot are hardly farther apart [m]."""
MOST = 0.5
"""A note is given if more than this share of the rows is like that: a single bad row is no matter."""
ENOUGH = 1000
"""So many rows of a batch, evenly spread, tell what all are like."""

DOUBTS = (
    f"the CoM is more than {FAR:g} m from all contacts (expected metres, in one frame)",
    f"contacts are more than {WIDE:g} m apart (expected metres)",
    "the normals of all contacts point away from the CoM (expected normals that point at the robot)",
    "the CoM is below all contacts (expected z up, and the CoM in the frame of the contacts)",
)
"""What is looked for, in the order of `Stand.doubts`."""


class Stand(NamedTuple):
    """Contacts of a few rows."""

    points: Float[np.ndarray, "m k 3"]
    """Positions [m]."""
    normals: Float[np.ndarray, "m k 3"]
    """Pointing at the robot."""
    mask: Bool[np.ndarray, "m k"]
    """False for padding."""

    def doubts(self, coms: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, "4 m"]:
        """Which of `DOUBTS` each row raises."""
        arms = np.where(self.mask[..., None], coms[:, None].astype(float) - self.points, np.nan)
        with np.errstate(invalid="ignore", over="ignore"):
            far = (np.linalg.norm(arms, axis=-1) > FAR) | ~self.mask
            apart = np.linalg.norm(arms[:, :, None] - arms[:, None], axis=-1)  # NaN, which is not wide, for padding
            away = (np.einsum("mki,mki->mk", arms, self.normals) < 0) | ~self.mask
            below = (arms[..., 2] < 0) | ~self.mask
        return np.stack([far.all(axis=1), (apart > WIDE).any(axis=(1, 2)), away.all(axis=1), below.all(axis=1)])


class Plausibility:
    """Looks at rows as they come, and says what most of them are like."""

    def __init__(self) -> None:
        self._rows, self._doubtful = 0, np.zeros(len(DOUBTS), np.int64)

    def add(self, stand: Stand, coms: Float[np.ndarray, "m 3"]) -> None:
        """Takes rows: finite ones with contacts count."""
        seen = np.isfinite(coms).all(axis=1) & stand.mask.any(axis=1)
        self._rows += int(seen.sum())
        self._doubtful += stand.doubts(coms)[:, seen].sum(axis=1)

    def notes(self, of: str = "of the rows") -> tuple[str, ...]:
        """A line for each doubt that most rows raise. of: what the share is one of."""
        shares = self._doubtful / max(self._rows, 1)
        return tuple(f"in {share:.0%} {of} {doubt}" for share, doubt in zip(shares, DOUBTS, strict=True) if share > MOST)


def some(n: int) -> slice:
    """A few of n rows, evenly spread."""
    return slice(None, None, max(1, n // ENOUGH))
