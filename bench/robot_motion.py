"""Motions of robots made here, for tests, notebooks and benchmarks: no one else's data.

    python -m bench.robot_motion g1 -o g1.csv        # G1 steps in place, as LAFAN1 logs it
    python -m bench.robot_motion anymal -o trot.npz  # ANYmal trots in place, as MuJoCo logs it

The base sways, the feet follow the ground and step by inverse kinematics, arms swing. Nothing is simulated: whether the
robot could move like that, jaxcap is asked.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from jaxcap import robots
from jaxcap.robots.differences import differences

STEPS = 30
"""Of Newton's method, at most."""
EXACT = 1e-12
"""Where it stops [m, rad]."""


class Motion(NamedTuple):
    """A motion in Pinocchio's conventions."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray


class Gait(NamedTuple):
    """How a robot steps."""

    start: dict[str, float]
    """Joint angles from which inverse kinematics begins [rad]; a part of a name is for all joints that have it."""
    height: float
    """Of the base [m]."""
    feet: tuple[tuple[str, float], ...]
    """Frames of the feet, and when each is lifted: share of the period."""
    lift: float = 0.06
    """[m]"""
    period: float = 1.2
    """[s]"""
    swing: float = 0.35
    """Share of the period that a foot is in the air."""
    sway: float = 0.03
    """[m]"""
    points: bool = False
    """Whether feet are points: their orientation is free."""
    arms: tuple[str, ...] = ()
    """Joints that swing."""


GAITS = {
    "g1": Gait(
        {"hip_pitch": -0.35, "knee": 0.7, "ankle_pitch": -0.35},
        0.72,
        (("left_ankle_roll_link", 0.1), ("right_ankle_roll_link", 0.6)),
        arms=("left_shoulder_pitch_joint", "right_elbow_joint", "waist_yaw_joint"),
    ),
    "anymal": Gait(
        {"F_HFE": 0.6, "F_KFE": -1.2, "H_HFE": -0.6, "H_KFE": 1.2},
        0.46,
        (("LF_FOOT", 0.1), ("RH_FOOT", 0.1), ("RF_FOOT", 0.6), ("LH_FOOT", 0.6)),
        period=0.8,
        sway=0.01,
        points=True,
    ),
}


def motion(name: str, seconds: float = 4.0, rate: float = 50.0, sole: float = 0.0) -> Motion:
    """A robot that stands, then steps in place, then stands.

    Args:
        name: A name of `GAITS`.
        seconds: How long.
        rate: Rows a second.
        sole: Height at which the soles stand [m].
    """
    gait, robot = GAITS[name], robots.load(name)
    model = robot.model
    time = np.arange(round(seconds * rate)) / rate
    q = np.tile(pin.neutral(model), (len(time), 1))
    nominal = _nominal(model, gait)
    data = model.createData()
    pin.framesForwardKinematics(model, data, nominal)
    frames = [model.getFrameId(frame) for frame, _ in gait.feet]
    stance = [data.oMf[frame].copy() for frame in frames]
    depth = {frame: place.translation[2] for frame, place in zip(frames, stance, strict=True)}
    ground = min(depth.values()) - _below(robot)
    for place in stance:
        place.translation[2] = min(depth.values())
        place.rotation = np.eye(3) if not gait.points else place.rotation
    last = nominal
    for row, now in enumerate(time):
        last = _posed(model, gait, last, now, seconds)
        for (_, lifted), frame, place in zip(gait.feet, frames, stance, strict=True):
            up = place.translation + np.array([0, 0, gait.lift * _bump(gait, now, seconds, lifted)])
            last = _reach(model, data, last, frame, pin.SE3(place.rotation, up), gait.points)
        q[row] = last
    q[:, 2] += sole - ground
    return Motion(time, q, differences(model, time, q))


def _nominal(model: pin.Model, gait: Gait) -> np.ndarray:
    q = pin.neutral(model)
    q[2] = gait.height
    for name, joint in zip(list(model.names)[2:], list(model.joints)[2:], strict=True):
        q[joint.idx_q] = sum(angle for part, angle in gait.start.items() if part in name)
    return q


def _below(robot: robots.Robot) -> float:
    """How far below the frame of a foot its lowest point is [m]."""
    patch = next(iter(robot.patches.values()))
    return patch.radius - min(point[2] for point in patch.points)


def _posed(model: pin.Model, gait: Gait, q: np.ndarray, now: float, seconds: float) -> np.ndarray:
    """With base and arms where they are at this time."""
    q, phase = q.copy(), 2 * np.pi * now / gait.period
    ease = _ease(now, seconds)
    q[:3] = 0.3 * gait.sway * np.sin(2 * phase) * ease, -gait.sway * np.sin(phase) * ease, gait.height
    q[3:7] = pin.Quaternion(
        pin.rpy.rpyToMatrix(0.02 * np.sin(phase) * ease, 0.03, 0.1 * np.sin(0.5 * phase) * ease)
    ).coeffs()
    for joint in gait.arms:
        q[model.joints[model.getJointId(joint)].idx_q] = 0.3 * np.sin(phase) * ease
    return q


def _ease(now: float, seconds: float) -> float:
    """0 at both ends, 1 in the middle, smooth."""
    share = np.clip(min(now, seconds - now) / (0.2 * seconds), 0, 1)
    return float(share * share * (3 - 2 * share))


def _bump(gait: Gait, now: float, seconds: float, lifted: float) -> float:
    """How high a foot is: 0 on the ground, 1 at the top."""
    share = (now / gait.period - lifted) % 1.0 / gait.swing
    return _ease(now, seconds) * np.sin(np.pi * share) ** 2 if share < 1 else 0.0


def _reach(model: pin.Model, data: pin.Data, q: np.ndarray, frame: int, goal: pin.SE3, point: bool) -> np.ndarray:
    """With the joints of one leg such that its foot is at `goal`: Newton's method, nothing else moves."""
    leg = [
        joint for joint in model.supports[model.frames[frame].parentJoint] if joint > 1 and "waist" not in model.names[joint]
    ]
    columns = [model.joints[joint].idx_v for joint in leg]
    for _ in range(STEPS):
        pin.computeJointJacobians(model, data, q)
        here = pin.updateFramePlacement(model, data, frame)
        error = np.r_[goal.translation - here.translation, here.rotation @ pin.log3(here.rotation.T @ goal.rotation)]
        jacobian = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:, columns]
        rows = slice(0, 3) if point else slice(0, 6)
        if np.abs(error[rows]).max() < EXACT:
            break
        step = np.zeros(model.nv)
        step[columns] = np.linalg.lstsq(jacobian[rows], error[rows], rcond=None)[0]
        q = pin.integrate(model, q, step)
    return q


def write_lafan(path: Path, one: Motion) -> None:
    """As LAFAN1 retargeted to the G1: CSV without a header, quaternion x, y, z, w, no velocities."""
    np.savetxt(path, one.q, delimiter=",", fmt="%.17g")


def write_mujoco(path: Path, one: Motion) -> None:
    """As MuJoCo's qpos and qvel: quaternion w, x, y, z, linear velocity in the world."""
    qpos, qvel = one.q.copy(), one.v.copy()
    qpos[:, 3:7] = one.q[:, [6, 3, 4, 5]]
    for row, base in zip(qvel, one.q, strict=True):
        row[:3] = pin.XYZQUATToSE3(base[:7]).rotation @ row[:3]
    np.savez(path, time=one.time, qpos=qpos, qvel=qvel)


WRITERS: dict[str, Callable[[Path, Motion], None]] = {"g1": write_lafan, "anymal": write_mujoco}


def main(arguments: list[str] | None = None) -> None:
    """Writes a small log."""
    parser = argparse.ArgumentParser(description="Write a small robot log.")
    parser.add_argument("robot", choices=GAITS)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=6.0)
    given = parser.parse_args(arguments)
    rate = 30.0 if given.robot == "g1" else 50.0
    WRITERS[given.robot](given.output, motion(given.robot, given.seconds, rate))
    print(given.output)


if __name__ == "__main__":
    main()
