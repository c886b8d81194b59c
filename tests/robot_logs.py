"""One known motion, written in every layout that the library knows."""

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import joblib
import numpy as np
import pinocchio as pin
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation

from bench.robot_motion import Motion, write_lafan, write_mujoco
from jaxcap.robots.motion import robot_order

WRISTS = [f"{side}_wrist_{axis}_joint" for side in ("left", "right") for axis in ("roll", "pitch", "yaw")]
EPISODES = 2
"""In layouts that hold several, the motion is there so often."""

JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
"""
ODOMETRY = """std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
"""
PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
}


def names(model: pin.Model) -> list[str]:
    """Joints after the base."""
    return list(model.names)[2:]


def wxyz(q: np.ndarray) -> np.ndarray:
    return q[:, [6, 3, 4, 5]]


def world(one: Motion, part: slice) -> np.ndarray:
    """A velocity of the base in the world."""
    return Rotation.from_quat(one.q[:, 3:7]).apply(one.v[:, part])


def breadth(model: pin.Model) -> list[int]:
    """Columns of the joints, breadth first."""
    return [names(model).index(name) for name in robot_order(model, "breadth first")]


def asap(path: Path, one: Motion, model: pin.Model, dump: Callable = joblib.dump) -> None:
    kept = [i for i, name in enumerate(names(model)) if name not in WRISTS]
    fields = {"root_trans_offset": one.q[:, :3], "root_rot": one.q[:, 3:7], "dof": one.q[:, 7:][:, kept], "fps": 50}
    dump({f"motion{i}": {**fields, "pose_aa": np.zeros((len(one.q), 24, 3))} for i in range(EPISODES)}, path)


def gmr(path: Path, one: Motion, model: pin.Model) -> None:
    fields = {
        "fps": 50.0,
        "root_pos": one.q[:, :3],
        "root_rot": one.q[:, 3:7],
        "dof_pos": one.q[:, 7:],
        "link_body_list": ["a", "b"],
    }
    path.write_bytes(pickle.dumps(fields | {"local_body_pos": None}))


def bodies(one: Motion, quaternion: np.ndarray, prefix: dict[str, str]) -> dict[str, np.ndarray]:
    """Fields (n, bodies, ...) whose first body is the base."""
    first = {"pos": one.q[:, :3], "quat": quaternion, "lin": world(one, slice(0, 3)), "ang": world(one, slice(3, 6))}
    return {prefix[key]: np.stack([value, value + 1], axis=1) for key, value in first.items()}


def beyondmimic(path: Path, one: Motion, model: pin.Model, order: str = "breadth first", last: bool = False) -> None:
    columns = [names(model).index(name) for name in robot_order(model, order)]
    fields = bodies(
        one,
        one.q[:, 3:7] if last else wxyz(one.q),
        {"pos": "body_pos_w", "quat": "body_quat_w", "lin": "body_lin_vel_w", "ang": "body_ang_vel_w"},
    )
    np.savez(path, fps=[50], joint_pos=one.q[:, 7:][:, columns], joint_vel=one.v[:, 6:][:, columns], **fields)


def isaac_amp(path: Path, one: Motion, model: pin.Model) -> None:
    fields = bodies(
        one,
        wxyz(one.q),
        {
            "pos": "body_positions",
            "quat": "body_rotations",
            "lin": "body_linear_velocities",
            "ang": "body_angular_velocities",
        },
    )
    columns = breadth(model)
    listed = np.array(names(model))[columns]
    joints = {"dof_positions": one.q[:, 7:][:, columns], "dof_velocities": one.v[:, 6:][:, columns]}
    np.savez(path, fps=50, dof_names=listed, body_names=np.array(["pelvis", "other"]), **joints, **fields)


def isaac_lab(path: Path, one: Motion, model: pin.Model, version: int | None = 1) -> None:
    import h5py

    columns = breadth(model)
    with h5py.File(path, "w") as file:
        if version is not None:
            file.attrs["DATASET_FORMAT_VERSION"] = version
        for i in range(EPISODES):
            robot = file.create_group(f"data/demo_{i}/states/articulation/robot")
            robot["root_pose"] = np.concatenate([one.q[:, :3], one.q[:, 3:7] if version else wxyz(one.q)], axis=1)
            robot["root_velocity"] = np.concatenate([world(one, slice(0, 3)), world(one, slice(3, 6))], axis=1)
            robot["joint_position"], robot["joint_velocity"] = one.q[:, 7:][:, columns], one.v[:, 6:][:, columns]
            file[f"data/demo_{i}"].attrs["num_samples"] = len(one.q)


def tienkung(path: Path, one: Motion, model: pin.Model) -> None:
    euler = Rotation.from_quat(one.q[:, 3:7]).as_euler("xyz")
    rows = np.concatenate([one.q[:, :3], euler, one.q[:, 7:], world(one, slice(0, 3)), one.v[:, 3:]], axis=1)
    path.write_text(json.dumps({"LoopMode": "Wrap", "FrameDuration": 0.02, "Frames": rows.tolist()}))


def named_columns(path: Path, one: Motion, model: pin.Model) -> None:
    columns = table(one, model)
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.17g")


def named_parquet(path: Path, one: Motion, model: pin.Model) -> None:
    pq.write_table(pa.table(table(one, model)), path)


def table(one: Motion, model: pin.Model) -> dict[str, np.ndarray]:
    """A column for each number; joints in another order than the robot's."""
    columns = {"time": one.time}
    parts = {
        "base_{}": (one.q[:, :3], "xyz"),
        "base_q{}": (one.q[:, 3:7], "xyzw"),
        "base_v{}": (world(one, slice(0, 3)), "xyz"),
    }
    parts["base_w{}"] = (one.v[:, 3:6], "xyz")
    for template, (values, axes) in parts.items():
        columns |= {template.format(axis): values[:, i] for i, axis in enumerate(axes)}
    for i, name in reversed(list(enumerate(names(model)))):
        columns |= {name: one.q[:, 7 + i], f"{name}_velocity": one.v[:, 6 + i]}
    return columns


def lerobot(path: Path, one: Motion, model: pin.Model, version: str = "v3.0") -> None:
    """A folder. v3.0: all episodes in one file; v2.1: a file an episode."""
    (path / "meta").mkdir(parents=True)
    (path / "data/chunk-000").mkdir(parents=True)
    listed = [f"k{name.removesuffix('_joint').title().replace('_', '')}" for name in names(model)]
    features = {
        "observation.base_position": {"dtype": "float64", "shape": [3], "names": ["x", "y", "z"]},
        "observation.base_orientation": {"dtype": "float64", "shape": [4], "names": None},
        "observation.joint_position": {"dtype": "float64", "shape": [len(listed)], "names": {"motors": listed}},
        "timestamp": {"dtype": "float64", "shape": [1], "names": None},
    }
    (path / "meta/info.json").write_text(json.dumps({"codebase_version": version, "fps": 50, "features": features}))
    lists = lambda rows: pa.FixedSizeListArray.from_arrays(rows.ravel(), rows.shape[1])
    tables = [
        pa.table(
            {
                "observation.base_position": lists(one.q[:, :3]),
                "observation.base_orientation": pa.array(one.q[:, 3:7].tolist()),
                "observation.joint_position": lists(one.q[:, 7:]),
                "timestamp": one.time,
                "episode_index": np.full(len(one.time), i),
            }
        )
        for i in range(EPISODES)
    ]
    if version == "v2.1":
        for i, episode in enumerate(tables):
            pq.write_table(episode, path / f"data/chunk-000/episode_{i:06d}.parquet")
    else:
        pq.write_table(pa.concat_tables(tables), path / "data/chunk-000/file-000.parquet")


def ros2(path: Path, one: Motion, model: pin.Model) -> None:
    from mcap_ros2.writer import Writer

    def definition(top: str, parts: list[str]) -> str:
        return top + "".join(f"{'=' * 80}\nMSG: {part}\n{PARTS[part]}" for part in parts)

    vector = lambda values: dict(zip("xyzw", map(float, values), strict=False))
    with open(path, "wb") as file:
        writer = Writer(file)
        joints = writer.register_msgdef(
            "sensor_msgs/msg/JointState", definition(JOINT_STATE, ["std_msgs/Header", "builtin_interfaces/Time"])
        )
        base = writer.register_msgdef("nav_msgs/msg/Odometry", definition(ODOMETRY, list(PARTS)))
        for i, now in enumerate(one.time):
            nanoseconds = round(now * 1e9)
            header = {
                "stamp": {"sec": 1_700_000_000 + nanoseconds // 10**9, "nanosec": nanoseconds % 10**9},
                "frame_id": "odom",
            }
            said = {
                "header": header,
                "name": names(model),
                "position": one.q[i, 7:].tolist(),
                "velocity": one.v[i, 6:].tolist(),
            }
            pose = {"position": vector(one.q[i, :3]), "orientation": vector(one.q[i, 3:7])}
            twist = {"linear": vector(one.v[i, :3]), "angular": vector(one.v[i, 3:6])}
            odometry = {"header": header, "child_frame_id": "base", "pose": {"pose": pose, "covariance": [0.0] * 36}}
            odometry["twist"] = {"twist": twist, "covariance": [0.0] * 36}
            writer.write_message("/odom", base, odometry, log_time=nanoseconds)
            writer.write_message("/joint_states", joints, said | {"effort": []}, log_time=nanoseconds)
        writer.finish()


def _simple(write: Callable) -> Callable:
    return lambda path, one, model: write(path, one)


LAYOUTS: dict[str, SimpleNamespace] = {
    name: SimpleNamespace(file=file, write=write, recognised=recognised, episodes=episodes, velocities=velocities)
    for name, file, write, recognised, episodes, velocities in [
        ("lafan1_g1", "log.csv", _simple(write_lafan), True, 1, False),
        ("asap", "log.pkl", asap, True, EPISODES, False),
        ("gmr", "log.pkl", gmr, True, 1, False),
        ("beyondmimic", "log.npz", beyondmimic, False, 1, True),
        ("beyondmimic_xyzw", "log.npz", lambda *log: beyondmimic(*log, last=True), False, 1, True),
        ("mjlab", "log.npz", lambda *log: beyondmimic(*log, order="depth first"), False, 1, True),
        ("isaac_amp", "log.npz", isaac_amp, True, 1, True),
        ("isaac_lab", "log.hdf5", isaac_lab, True, EPISODES, True),
        ("isaac_lab_2", "log.hdf5", lambda *log: isaac_lab(*log, version=None), True, EPISODES, True),
        ("mujoco", "log.npz", _simple(write_mujoco), True, 1, True),
        ("tienkung", "log.txt", tienkung, True, 1, True),
        ("ros2", "log.mcap", ros2, True, 1, True),
        ("lerobot", "log", lerobot, True, EPISODES, False),
        ("named_columns", "log.csv", named_columns, True, 1, True),
        ("named_parquet", "log.parquet", named_parquet, True, 1, True),
    ]
}
"""How each layout is written."""

LEG = ("hip_roll", "hip_pitch", "hip_yaw", "knee_pitch", "ankle_pitch", "ankle_roll")
ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow_pitch")


def tienkung_urdf() -> str:
    """A robot with the joints of TienKung: legs and arms of rods, feet of boxes."""
    inertia = '<inertia ixx=".02" iyy=".02" izz=".01" ixy="0" ixz="0" iyz="0"/>'
    mass = f'<inertial><origin xyz="0 0 -.1"/><mass value="2"/>{inertia}</inertial>'
    box = '<geometry><box size=".2 .1 .02"/></geometry>'
    limits = '<limit lower="-3" upper="3" effort="99" velocity="99"/>'
    parts = [f'<robot name="tienkung"><link name="pelvis">{mass}</link>']
    for limb, height in ((LEG, 0.0), (ARM, 0.4)):
        for side, y in (("l", 0.12), ("r", -0.12)):
            parent = "pelvis"
            for number, kind in enumerate(limb):
                name = f"{kind}_{side}"
                drop = -0.35 if kind in ("knee_pitch", "ankle_pitch", "elbow_pitch") else 0.0
                place = f"0 {y} {height}" if not number else f"0 0 {drop}"
                axis = {"roll": "1 0 0", "yaw": "0 0 1"}.get(kind.split("_")[1], "0 1 0")
                foot = f'<collision><origin xyz=".03 0 -.05"/>{box}</collision>'
                parts.append(f'<link name="{name}_link">{mass}{foot if kind == "ankle_roll" else ""}</link>')
                parts.append(
                    f'<joint name="{name}_joint" type="revolute"><origin xyz="{place}"/><parent link="{parent}"/>'
                    f'<child link="{name}_link"/><axis xyz="{axis}"/>{limits}</joint>'
                )
                parent = f"{name}_link"
    return "".join([*parts, "</robot>"])
