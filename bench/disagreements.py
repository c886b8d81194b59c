"""Why hpp-bezier-com-traj and jaxcap disagree on a state: each disagreement gets one of these reasons, found by computing.

Capturable for jaxcap alone:
    duration  a straight cubic curve stops too, but of another duration than was tried, or one whose wrench stays in the cone
              although the control points of the wrench do not, which is what they ask for
    swings    the stop lies beyond where the robot can stand and it swings back (C3.3): no curve that they look for
    braking   no straight cubic stops: its deceleration changes linearly in time, and the CoM has to brake harder

Capturable for them alone:
    falls     their curve ends at rest where the robot cannot stand: they do not ask for that
    bends     their curve leaves the line of travel, or turns back on it: they may do that, jaxcap's model does not
    leaves    their curve leaves the cone, by jaxcap's faces

`unexplained` has to be 0: their curve stays on the line, and in the cone, and ends where the robot can stand.
"""

import numpy as np

import jaxcap
from bench.peers import curve_end
from bench.stances import Batch

GRAVITY = np.array([0.0, 0.0, -9.81])
INSIDE = 1e-6
"""A wrench outside a face by less than this, relative to its unit normal and the weight, is inside [-]."""
OFF = 1e-4
"""A curve that leaves the line by less than this is straight [m]."""
SAMPLES = np.linspace(0.0, 1.0, 41)
"""Of a curve, of its duration [-]."""
TIMES = np.geomspace(0.05, 10.0, 60)
"""Durations of straight curves that are tried [s]."""
STOPS = 200
"""Ends of straight curves that are tried, up to speed times duration away."""


def reasons(modules, batch: Batch, cone, answer: jaxcap.Capturability, durations: np.ndarray) -> dict[str, int]:
    """Counts of states: both, neither, and for those on which they disagree each reason.

    durations: of their curve (n,) [s], NaN for none.
    """
    ours, theirs = np.asarray(answer.capturable), np.isfinite(durations)
    names = ("both", "neither", "duration", "swings", "braking", "falls", "bends", "leaves", "unexplained")
    counts = dict.fromkeys(names, 0)
    for i in range(len(ours)):
        if ours[i] == theirs[i]:
            counts["both" if ours[i] else "neither"] += 1
        elif ours[i]:
            swings = answer.case[i] == jaxcap.Case.C3_3
            straight = not swings and straight_curve(cone, batch.coms[i], batch.com_velocities[i])
            counts["swings" if swings else "duration" if straight else "braking"] += 1
        else:
            counts[_excess(modules, batch, cone, i, durations[i])] += 1
    return counts


def _excess(modules, batch: Batch, cone, index: int, duration: float) -> str:
    """The reason why a state is capturable for them alone."""
    com, velocity = batch.coms[index], batch.com_velocities[index]
    end = curve_end(modules, batch, index, duration)
    if not _in_cone(cone, *curve(com, velocity, end, duration)).all():
        return "leaves"
    if not _in_cone(cone, end, np.zeros(3)):
        return "falls"
    along = velocity / np.linalg.norm(velocity)
    places = curve(com, velocity, end, duration)[0] - com
    off = np.linalg.norm(places - np.outer(places @ along, along), axis=1).max()
    return "bends" if off > OFF or np.diff(places @ along).min() < -OFF / len(SAMPLES) else "unexplained"


def curve(com, velocity, end, duration):
    """Places [m] and accelerations [m/s^2] at SAMPLES of cubic curves from the state to rest at these ends (..., 3) [m]."""
    t = SAMPLES[:, None]
    second = com + velocity * duration / 3
    end = np.asarray(end)[..., None, :]
    place = com * (1 - t) ** 3 + second * 3 * t * (1 - t) ** 2 + end * (3 * t**2 - 2 * t**3)
    acceleration = 6 * ((1 - t) * (com - 2 * second + end) + t * (second - end)) / duration**2
    return place, acceleration


def straight_curve(cone, com, velocity) -> bool:
    """Whether some cubic curve along the velocity comes to rest, in the cone, where the robot can stand."""
    for duration in TIMES:
        ends = com + np.linspace(0.0, 1.0, STOPS + 1)[:, None] * velocity * duration
        ends = ends[_in_cone(cone, ends, np.zeros(3))]
        if len(ends) and _in_cone(cone, *curve(com, velocity, ends, duration)).all(axis=-1).any():
            return True
    return False


def _in_cone(cone, place, acceleration):
    """Whether the contacts can give this acceleration there; arrays (..., 3)."""
    force = acceleration - GRAVITY + np.zeros_like(place)
    arm = (place - cone.origin) / cone.length
    wrench = np.concatenate([force, np.cross(arm, force)], axis=-1)
    faces = cone.faces * np.array([1, 1, 1, cone.length, cone.length, cone.length])
    return np.max(wrench @ faces.T, axis=-1, initial=-np.inf) <= INSIDE * np.linalg.norm(GRAVITY)
