"""Whether a log is what it seems: one line for each thing that looks wrong.

What is wrong beyond doubt is refused; what is doubtful is a note. Each check looks at what the others cannot see: velocities
held against differences do not see joints permuted in both alike, joint limits and soles do.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from jaxcap.robots.motion import Velocities

NORM, NORM_REFUSED = 1e-4, 0.05
"""Deviation of a quaternion's norm from 1 that is noted, and that is refused."""
BEYOND, FAR_BEYOND = 0.1, 1.0
"""How far outside its limits a joint is noted, and refused if it is there in `OFTEN` of the rows [rad, m]."""
OFTEN, SELDOM = 0.2, 0.01
"""Shares of the rows."""
TILTED, INVERTED = 0.5, -0.7
"""Cosine between the base's z axis and up: below is noted if half of the rows are, and refused if nearly all are."""
NEARLY_ALL = 0.9
FLOATING = 0.015
"""Ground that is estimated this far from zero is noted [m]."""
NEAR = 0.06
"""A robot has a sole this near to the ground in most rows [m]."""
FLAT = np.cos(np.radians(25.0))
"""Cosine of the tilt of a sole that stands."""
GLITCH = 8.0
"""A velocity is a glitch where it is this many times farther from the difference than velocities usually are, ..."""
SLACK = 0.5
"""... and by more than this [m/s, rad/s]."""
AGREE = 0.35
"""Velocities agree with differences if in most rows they are nearer to them than this share of the speed; ..."""
STILL = 0.03
"""... rows that are slower do not count [m/s, rad/s] ..."""
FEW = 5
"""... and there have to be as many others."""
SLIDING = 0.25
"""A sole that stands is slower in most rows [m/s]."""
SLIPPING = 0.25
"""A patch that touches slips less than this in half of the rows, as a share of how far base and joints each move it: in
public clips 0.08 to 0.13, with joints of another leg 0.3 to 0.9.
"""
LEANING = 0.4
"""The CoM is beside its support by less than this share of its height, in half of the rows."""
AIRBORNE = 0.5
"""Share of the rows in which nothing touches."""
FASTEST, FASTEST_JOINT = 10.0, 60.0
"""Base and joints do not move faster from row to row [m/s, rad/s]."""
SUDDEN = 8.0
"""A base that moves this many times faster than in nine rows of ten, and by `FASTEST` / 5, jumps."""
UNEVEN = 1.5
"""Time steps do not differ by more than this factor."""
LONGEST_STEP = 0.25
"""[s]"""


class Finding(NamedTuple):
    """Something that looks wrong."""

    kind: str
    """One word: a kind is told once an episode."""
    words: str
    refused: bool = False
    """Whether it is wrong beyond doubt."""


def check_time(time: Float[np.ndarray, " n"], start: int = 0) -> list[Finding]:
    """Times that increase, in steps that are alike."""
    steps = np.diff(time)
    back = np.flatnonzero(steps <= 0)
    if len(back):
        row = int(back[0])
        words = f"time[{start + row + 1}] = {time[row + 1]:.6g} s is not later than the row before ({time[row]:.6g} s)"
        return [Finding("time", words, refused=True)]
    if not len(steps):
        return []
    if np.median(steps) > LONGEST_STEP:
        return [Finding("steps", f"time steps are {np.median(steps):.3g} s (expected seconds, at most {LONGEST_STEP:g})")]
    if steps.max() > UNEVEN * np.median(steps):
        row = int(steps.argmax())
        words = f"the time step at row {start + row + 1} is {steps[row]:.3g} s, half are below {np.median(steps):.3g} s"
        return [Finding("steps", words)]
    return []


def check_norms(norms: Float[np.ndarray, " n"], start: int = 0) -> list[Finding]:
    """Unit quaternions."""
    off = np.abs(norms - 1)
    row = int(off.argmax())
    words = f"base_orientation[{start + row}] has norm {norms[row]:.6g} (expected 1)"
    return [Finding("quaternion", words, refused=off[row] > NORM_REFUSED)] if off[row] > NORM else []


def check_limits(model: pin.Model, q: Float[np.ndarray, "n nq"]) -> list[Finding]:
    """Joints inside their limits."""
    low, high, free = model.lowerPositionLimit[7:], model.upperPositionLimit[7:], q[:, 7:]
    known = (high > low) & (high - low < 100)
    beyond = np.where(known, np.maximum(np.maximum(low - free, free - high), 0), 0)
    if not beyond.size:
        return []
    names = {joint.idx_q - 7: name for name, joint in zip(list(model.names)[2:], list(model.joints)[2:], strict=True)}
    worst = int((beyond > BEYOND).sum(axis=0).argmax())
    share = float((beyond[:, worst] > BEYOND).mean())
    if share <= SELDOM:
        return []
    row = int(beyond[:, worst].argmax())
    limits = f"limits {low[worst]:.3g} to {high[worst]:.3g}"
    words = (
        f"joint {names.get(worst, worst)!r} is outside its {limits} in {share:.0%} of the rows, up to {free[row, worst]:.4g}"
    )
    refused = bool(((beyond > FAR_BEYOND).any(axis=1)).mean() > OFTEN)
    hint = " (degrees? joints in another order? another robot?)"
    return [Finding("limits", words + hint, refused)]


def check_upright(q: Float[np.ndarray, "n nq"]) -> list[Finding]:
    """The base upright in most rows."""
    x, y = q[:, 3], q[:, 4]
    cosine = 1 - 2 * (x * x + y * y)  # of the base's z axis with up
    if (cosine < INVERTED).mean() > NEARLY_ALL:
        words = f"the base is upside down in {(cosine < INVERTED).mean():.0%} of the rows (the quaternion in another order?)"
        return [Finding("upright", words, refused=True)]
    if np.median(cosine) < TILTED:
        tilt = np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1)))
        return [
            Finding("upright", f"the base is tilted by {tilt:.0f} degrees in half of the rows (the quaternion, or y up?)")
        ]
    return []


def check_soles(
    heights: Float[np.ndarray, "n p"],
    speeds: Float[np.ndarray, "n p"],
    tilts: Float[np.ndarray, "n p"],
    flat: Bool[np.ndarray, " p"],
) -> list[Finding]:
    """A sole on the ground, flat on it and at rest, in most rows.

    Args:
        heights: Of the lowest point of each patch above the ground [m].
        speeds: Of that point [m/s].
        tilts: Cosine between each patch's normal and the ground's.
        flat: Which patches are rectangles.
    """
    found = []
    lowest = np.nanmin(heights, axis=1)
    if np.median(np.abs(lowest)) > NEAR:
        words = (
            f"the lowest sole is {np.median(lowest):.2g} m above the ground in half of the rows (expected within {NEAR:g} m)"
        )
        found.append(Finding("soles", words))
    on_lowest = np.take_along_axis(speeds, np.nan_to_num(heights, nan=np.inf).argmin(axis=1)[:, None], axis=1)
    if np.median(on_lowest) > SLIDING:
        words = f"the lowest sole moves at {np.median(on_lowest):.2g} m/s in half of the rows (expected below {SLIDING:g})"
        found.append(Finding("slide", words))
    if flat.any():
        down = np.where(np.abs(heights - lowest[:, None]) < NEAR, tilts, -1)[:, flat]
        best = down.max(axis=1)
        best = best[best > -1]
        if len(best) and np.median(best) < FLAT:
            tilt = np.degrees(np.arccos(np.clip(np.median(best), -1, 1)))
            words = f"the soles are tilted by {tilt:.0f} degrees where they are lowest, in half of the rows"
            found.append(Finding("tilt", f"{words} (joints in another order? another base frame?)"))
    return found


def check_contacts(touching: Bool[np.ndarray, "n p"]) -> list[Finding]:
    """Something touches in most rows."""
    airborne = float((~touching.any(axis=1)).mean())
    if airborne <= AIRBORNE:
        return []
    return [Finding("contacts", f"nothing touches the ground in {airborne:.0%} of the rows")]


def check_slips(slips: Float[np.ndarray, "m p"], names: list[str]) -> list[Finding]:
    """Each patch at rest while it touches.

    Args:
        slips: From `slips`, NaN where nothing is said.
        names: Of the patches.
    """
    known = [patch for patch in range(len(names)) if (~np.isnan(slips[:, patch])).sum() >= FEW]
    medians = {patch: float(np.nanmedian(slips[:, patch])) for patch in known}
    worst = max(medians, key=lambda patch: medians[patch], default=None)
    if worst is None or medians[worst] <= SLIPPING:
        return []
    words = f"{names[worst]!r} slips while it touches: {medians[worst]:.0%} of what base and joints move it does not cancel"
    return [
        Finding(
            "slip",
            f"{words}, in half of these rows (joints in another order? a base that drifts?)",
        )
    ]


def check_support(
    com: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "n k 3"], mask: Bool[np.ndarray, "n k"]
) -> list[Finding]:
    """The CoM not far beside what carries it: for as long as half a log nothing stands, or trots, like that.

    The distance is that to the box around the touching points, which is never more than to their hull.

    Args:
        com: [m].
        points: Of all patches [m].
        mask: Which touch.
    """
    there = mask.any(axis=1)
    if there.sum() < FEW:
        return []
    com, touches = com[there], mask[there, :, None]
    low = np.where(touches, points[there], np.inf).min(axis=1)
    high = np.where(touches, points[there], -np.inf).max(axis=1)
    beside = np.linalg.norm(np.maximum(np.maximum(low - com, com - high), 0)[:, :2], axis=1)
    height = com[:, 2] - low[:, 2]
    if np.median(beside - LEANING * height) <= 0:
        return []
    words = f"the CoM is {np.median(beside):.2g} m beside all that touches, {np.median(height):.2g} m above it"
    return [Finding("support", f"{words}, in half of these rows (feet that never touch? joints in another order?)")]


def check_ground(height: float) -> list[Finding]:
    """Soles that stand at zero."""
    if abs(height) <= FLOATING:
        return []
    return [
        Finding("ground", f"the soles stand at {height:+.3f} m: the ground is taken to be there (--ground says where it is)")
    ]


def check_velocities(logged: Velocities, v: Float[np.ndarray, "n nv"], start: int = 0) -> list[Finding]:
    """Logged velocities like the differences of the configurations, at the ends too.

    Args:
        logged: As logged.
        v: By differences.
        start: Number of the first row, for messages.
    """
    parts = {
        "base_linear_velocity": (logged.linear, v[:, :3], "m/s"),
        "base_angular_velocity": (logged.angular, v[:, 3:6], "rad/s"),
        "joint_velocities": (logged.joints, v[:, 6:], "rad/s"),
    }
    return [one for what, part in parts.items() if part[0] is not None for one in _against(what, *part, start)]


def _against(what: str, logged: np.ndarray | None, differences: np.ndarray, unit: str, start: int) -> list[Finding]:
    known = ~np.isnan(logged).any(axis=0)  # type: ignore[arg-type]
    logged, differences = logged[:, known], differences[:, known]  # type: ignore[index]
    if not logged.size:
        return []
    error, speed = np.linalg.norm(logged - differences, axis=1), np.linalg.norm(differences, axis=1)
    moving = (speed > STILL) | (error > STILL)
    if moving.sum() >= FEW and np.median(error[moving] / np.maximum(speed[moving], STILL)) > AGREE:
        words = f"{what} is {np.median(error[moving]):.2g} {unit} from the differences of the positions in half of the rows"
        return [Finding(what, f"{words} (speed {np.median(speed[moving]):.2g}; another frame, order or unit?)")]
    glitches = np.flatnonzero(error > np.maximum(GLITCH * np.median(error), SLACK + speed))
    if len(glitches):
        row = int(glitches[0])
        words = f"{what}[{start + row}] is {error[row]:.2g} {unit} from the difference of the positions"
        often = f"{len(glitches)} such row{'s' if len(glitches) > 1 else ''}"
        return [Finding(what, f"{words} ({often}; --velocities differences does without)")]
    return []


def check_jumps(v: Float[np.ndarray, "n nv"], start: int = 0) -> list[Finding]:
    """No jumps from row to row. v: by differences."""
    base, joints = np.linalg.norm(v[:, :3], axis=1), np.abs(v[:, 6:]).max(axis=1, initial=0)
    sudden = min(FASTEST, max(FASTEST / 5, SUDDEN * float(np.percentile(base, 90))))
    found = []
    for what, speed, most, unit in (("the base", base, sudden, "m/s"), ("a joint", joints, FASTEST_JOINT, "rad/s")):
        if speed.max(initial=0) > most:
            row, often = int(speed.argmax()), float((speed > most).mean())
            words = f"{what} moves at {speed[row]:.3g} {unit} at row {start + row}, faster than {most:.3g} in {often:.1%}"
            found.append(Finding("jumps", f"{words} of the rows (a jump? millimetres, degrees?)", refused=often > OFTEN))
    return found
