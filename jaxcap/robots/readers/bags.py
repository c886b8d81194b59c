"""ROS 2 bags in MCAP: one topic of joint states, one of odometry. Importing this module needs mcap and mcap-ros2-support.

Rows are the stamps of the joint states. Odometry comes at times of its own, and is interpolated: positions and velocities
along straight lines, orientations along the shortest arc. Joint states before its first or after its last stamp are left
out.
"""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from scipy.spatial.transform import Rotation, Slerp

from jaxcap.errors import InputError
from jaxcap.robots.readers.spool import Spools

JOINTS, ODOMETRY = "JointState", "Odometry"
AT_A_TIME = 4096
"""Messages that are kept before they go to the file."""


def bag(path: Path, stack: ExitStack) -> dict[str, Any]:
    """The joint states of a bag and the base's pose and velocity at their times."""
    spools, names = _messages(path, stack)
    arrays = spools.arrays()
    for kind in (JOINTS, ODOMETRY):
        if kind not in arrays:
            raise InputError(f"{path}: no message of type {kind} (expected one topic of it)")
    joints, odometry = arrays[JOINTS], arrays[ODOMETRY]
    for kind, rows in ((JOINTS, joints), (ODOMETRY, odometry)):
        late = np.flatnonzero(np.diff(rows[:, 0]) <= 0)
        if len(late):
            raise InputError(
                f"{path}: {kind} {late[0] + 1} is not later than the one before (stamp {rows[late[0] + 1, 0]:.6f} s)"
            )
    inside = (joints[:, 0] >= odometry[0, 0]) & (joints[:, 0] <= odometry[-1, 0])
    time = np.asarray(joints[inside, 0])
    found = {"time": time - time[:1], "joints/name": names, "joints/position": joints[inside, 1 : 1 + len(names)]}
    if joints.shape[1] > 1 + len(names):
        found["joints/velocity"] = joints[inside, 1 + len(names) :]
    return found | _interpolated(time, odometry)


def _interpolated(time: np.ndarray, odometry: np.ndarray) -> dict[str, np.ndarray]:
    """Pose and velocity of the base at these times."""
    stamps = np.asarray(odometry[:, 0])
    linear = lambda first: np.stack([np.interp(time, stamps, odometry[:, first + i]) for i in range(3)], axis=1)
    turned = Rotation.from_quat(odometry[:, 4:8])
    between = Slerp(stamps, turned)(time) if len(stamps) > 1 else turned[np.zeros(len(time), int)]
    return {
        "odometry/position": linear(1),
        "odometry/orientation": between.as_quat(),
        "odometry/linear": linear(8),
        "odometry/angular": linear(11),
    }


def _messages(path: Path, stack: ExitStack) -> tuple[Spools, tuple[str, ...]]:
    """Rows of stamp and numbers, of each of the two kinds; the joints by name, in the order of the first message."""
    spools, names, start = Spools(str(path), stack), (), None
    topics: dict[str, str] = {}
    waiting: dict[str, list[list[float]]] = {JOINTS: [], ODOMETRY: []}
    reader = make_reader(stack.enter_context(path.open("rb")), decoder_factories=[DecoderFactory()])
    for message in reader.iter_decoded_messages():
        kind = (message.schema.name if message.schema else "").rpartition("/")[2]
        if kind not in waiting:
            continue
        topic = topics.setdefault(kind, message.channel.topic)
        if message.channel.topic != topic:
            raise InputError(f"{path}: two topics of type {kind}, {topic!r} and {message.channel.topic!r} (expected one)")
        said = message.decoded_message
        if kind == JOINTS:
            names = names or tuple(said.name)
        start = said.header.stamp.sec if start is None else start  # of today's clock a float keeps no better than 0.2 us
        stamp = said.header.stamp.sec - start + 1e-9 * said.header.stamp.nanosec
        waiting[kind].append([stamp, *(_joints(path, said, names) if kind == JOINTS else _base(said))])
        if len(waiting[kind]) == AT_A_TIME:
            spools.append(kind, np.array(waiting[kind]))
            waiting[kind] = []
    for kind, rows in waiting.items():
        if rows:
            spools.append(kind, np.array(rows))
    return spools, names


def _joints(path: Path, said: Any, names: tuple[str, ...]) -> list[float]:
    """Positions and velocities in the order of the first message."""
    at = {name: i for i, name in enumerate(said.name)}
    if set(at) != set(names) or len(said.position) != len(names):
        raise InputError(f"{path}: a JointState names {len(at)} joints, the first one {len(names)} (expected the same)")
    order = [at[name] for name in names]
    velocities = [said.velocity[i] for i in order] if len(said.velocity) == len(names) else []
    return [*(said.position[i] for i in order), *velocities]


def _base(said: Any) -> list[float]:
    """Position, quaternion x, y, z, w, linear and angular velocity in the child frame."""
    pose, twist = said.pose.pose, said.twist.twist
    of = lambda vector, axes: [float(getattr(vector, axis)) for axis in axes]
    return [*of(pose.position, "xyz"), *of(pose.orientation, "xyzw"), *of(twist.linear, "xyz"), *of(twist.angular, "xyz")]
