"""Robot states through Pinocchio: (q, v) -> centre of mass, its velocity, angular momentum; where a robot can touch.

Conventions are Pinocchio's. A configuration q of a free-flying robot starts with the base position in the world frame
[m] and the base orientation as a unit quaternion in the order x, y, z, w; joint angles [rad] follow. A velocity v
starts with the linear [m/s] and angular [rad/s] velocity of the base in the LOCAL frame of the base; joint velocities
[rad/s] follow. What comes out is in the world frame, z up. Data recorded elsewhere (MuJoCo: w, x, y, z) has to be
converted first; `convention_error` says whether it was.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxcap.contacts.conventions import ArrayLike

try:
    import pinocchio as pin
    from pinocchio import Model  # the PyPI project called "pinocchio" is another one, and has no Model
except ImportError as error:
    raise ImportError('jaxcap.robots needs Pinocchio: pip install "jaxcap[robots]"') from error

PathLike = str | os.PathLike

UNIT_NORM = 1e-4
"""Largest deviation from 1 of the norm of a quaternion, for single precision and text files; normalised on use."""

UNIT_TAIL = {"JointModelFreeFlyer": 4, "JointModelSpherical": 4, "JointModelPlanar": 2}
"""How many of a joint's last coordinates form a unit vector."""


class Robot(NamedTuple):
    """A robot ready for use."""

    model: Model
    """Pinocchio's model, locked joints removed."""
    postures: dict[str, Float[np.ndarray, "nq"]]
    """Named configurations of the SRDF file, such as `half_sitting`."""
    collisions: pin.GeometryModel | None
    """Collision shapes with the pairs that may not touch; None where no `package_dirs` were given."""


class CentroidalStates(NamedTuple):
    """What the predictor needs of n robot states, and the angular momentum that it neglects. World frame, float64."""

    com: Float[np.ndarray, "n 3"]
    """Centre of mass [m]."""
    com_velocity: Float[np.ndarray, "n 3"]
    """[m/s]."""
    angular_momentum: Float[np.ndarray, "n 3"]
    """About the centre of mass [kg m^2/s]."""


_SOLE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class ContactPatch(NamedTuple):
    """Where a robot's link can touch: a rectangle that can rest on a flat surface, or, without sides, a point."""

    frame: str
    """Name of the link's frame in the model."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre of the rectangle, or the point, in that frame [m]."""
    rotation: tuple[tuple[float, float, float], ...] = _SOLE
    """(3, 3) in that frame. Columns: direction of the length, of the width, normal pointing into the robot."""
    half_length: float = 0.0
    """[m], the long side."""
    half_width: float = 0.0
    """[m]."""

    @property
    def is_point(self) -> bool:
        """Whether it has no sides."""
        return self.half_length == 0 and self.half_width == 0


_HAND = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))

TALOS_CONTACTS = {
    "left_sole": ContactPatch("left_sole_link", (0.0, 0.0, 0.0), _SOLE, 0.105, 0.065),
    "right_sole": ContactPatch("right_sole_link", (0.0, 0.0, 0.0), _SOLE, 0.105, 0.065),
    "left_hand": ContactPatch("gripper_left_base_link", (0.0, 0.012, -0.1516), _HAND, 0.034, 0.023),
    "right_hand": ContactPatch("gripper_right_base_link", (0.0, 0.012, -0.1516), _HAND, 0.034, 0.023),
}
"""Where TALOS can touch, measured in example-robot-data 6.0.

Soles: the plane is that of the sole frame, 0.107 m below the ankle (collision mesh: 0.1074 m); the size is that of the
foot's collision box in `talos_reduced_box.urdf`, 0.21 x 0.13 m, centred under the ankle as there. (The foot's collision
mesh spans 0.221 x 0.134 m; its flat bottom, 0.195 x 0.117 m.)

Hands: TALOS has no palm. A gripper pushed straight at a surface touches with the ends of its three fingers, which this
URDF fixes, all 0.1516 m below `gripper_*_base_link` along -z. The outer corners of the tips are the trapezoid
(+-0.0475, 0.0466), (+-0.0155, -0.0466) m in x, y. The rectangle, 0.068 x 0.046 m, is the largest inside it with sides
along y and x (0.0692 x 0.0475 m), rounded down; no vertex of the hand's collision meshes lies beyond its plane.
"""

ANYMAL_FEET = {
    "left_front_foot": ContactPatch("LF_FOOT"),
    "right_front_foot": ContactPatch("RF_FOOT"),
    "left_hind_foot": ContactPatch("LH_FOOT"),
    "right_hind_foot": ContactPatch("RH_FOOT"),
}
"""Points: the origins of frames of ANYmal's feet, as its SRDF stands (the foot's sphere ends 8 mm further down)."""


class Placement(NamedTuple):
    """Where a patch is, in the world frame."""

    position: Float[np.ndarray, "3"]
    """Centre of the rectangle, or the point [m]."""
    rotation: Float[np.ndarray, "3 3"]
    """Columns: direction of the length, of the width, normal pointing at the robot."""


def load_robot(
    urdf_path: PathLike,
    srdf_path: PathLike | None = None,
    package_dirs: Sequence[PathLike] = (),
    free_flyer: bool = True,
    locked_joints: Sequence[str] = (),
) -> Robot:
    """A robot from its URDF file, with the postures and the ignored collision pairs of its SRDF file.

    Args:
        urdf_path: The robot.
        srdf_path: Its postures and ignored collision pairs.
        package_dirs: Folders in which `package://` addresses of meshes start; without any, no collision shapes are loaded.
        free_flyer: Whether the base moves freely.
        locked_joints: Names of joints fixed at zero and removed from the model.

    Raises:
        FileNotFoundError: Naming the missing file.
        ValueError: Naming a locked joint that the model does not have.
    """
    for path in (urdf_path, srdf_path, *package_dirs):
        if path is not None and not Path(path).exists():
            raise FileNotFoundError(f"{os.fspath(path)}: no such file or folder")
    urdf_path = os.fspath(urdf_path)
    model = pin.buildModelFromUrdf(urdf_path, *([pin.JointModelFreeFlyer()] if free_flyer else []))
    missing = [name for name in locked_joints if not model.existJointName(name)]
    if missing:
        names = ", ".join(model.names)
        raise ValueError(f"locked_joints: {missing[0]!r} is no joint of {model.name} (expected some of: {names})")
    shapes = pin.GeometryModel()
    if package_dirs:
        folders = [os.fspath(folder) for folder in package_dirs]
        shapes = pin.buildGeomFromUrdf(model, urdf_path, pin.GeometryType.COLLISION, package_dirs=folders)
    if srdf_path is not None:
        pin.loadReferenceConfigurations(model, os.fspath(srdf_path))
    locked = [model.getJointId(name) for name in locked_joints]
    model, (shapes,) = pin.buildReducedModel(model, [shapes], locked, pin.neutral(model))
    if package_dirs:
        shapes.addAllCollisionPairs()
        if srdf_path is not None:
            pin.removeCollisionPairs(model, shapes, os.fspath(srdf_path))
    postures = {entry.key(): np.array(entry.data()) for entry in model.referenceConfigurations}
    return Robot(model, postures, shapes if package_dirs else None)


def talos(collisions: bool = False) -> Robot:
    """TALOS of example-robot-data (90.3 kg), grippers locked at zero: nq = 37, nv = 36. Posture: `half_sitting`."""
    grippers = ("gripper_left_joint", "gripper_right_joint")
    return _example("talos_data", "robots/talos_reduced.urdf", "srdf/talos.srdf", collisions, grippers)


def anymal(collisions: bool = False) -> Robot:
    """ANYmal B of example-robot-data (30.5 kg): nq = 19, nv = 18. Posture: `standing`."""
    return _example("anymal_b_simple_description", "robots/anymal.urdf", "srdf/anymal.srdf", collisions)


def _example(folder: str, urdf: str, srdf: str, collisions: bool, locked_joints: Sequence[str] = ()) -> Robot:
    """A robot of the package example-robot-data, which installs into the same prefix as Pinocchio."""
    share = Path(pin.__file__).parents[4] / "share"  # <prefix>/lib/python3.x/site-packages/pinocchio/__init__.py
    root = share / "example-robot-data" / "robots" / folder
    if not (root / urdf).is_file():
        raise FileNotFoundError(f'{root / urdf}: no such file; pip install "jaxcap[robots]" (example-robot-data >= 6)')
    return load_robot(root / urdf, root / srdf, [share] if collisions else (), locked_joints=locked_joints)


def centroidal_states(model: Model, configurations: ArrayLike, velocities: ArrayLike) -> CentroidalStates:
    """Centre of mass, its velocity and the angular momentum about it, of n robot states.

    Quaternions in the wrong order and base velocities in the world frame cannot be seen here: see `convention_error`.

    Args:
        model: Pinocchio's.
        configurations: (n, nq), in the conventions at the head of this module.
        velocities: (n, nv), likewise.

    Raises:
        ValueError: Naming field and row for a wrong shape, a value that is not finite, a quaternion not of unit norm.
    """
    configurations = _rows("configurations", configurations, "nq", model.nq)
    velocities = _rows("velocities", velocities, "nv", model.nv)
    if len(configurations) != len(velocities):
        raise ValueError(f"velocities has {len(velocities)} rows (expected {len(configurations)}, as configurations)")
    _check_units(model, configurations)
    data = model.createData()
    out = CentroidalStates(*(np.empty((len(configurations), 3)) for _ in CentroidalStates._fields))
    for i, (q, v) in enumerate(zip(configurations, velocities, strict=True)):
        momentum = pin.computeCentroidalMomentum(model, data, pin.normalize(model, q), v)
        out.com[i], out.com_velocity[i], out.angular_momentum[i] = data.com[0], data.vcom[0], momentum.angular
    return out


def convention_error(model: Model, configurations: ArrayLike, velocities: ArrayLike, dt: float) -> Float[np.ndarray, "n-2"]:
    """How far a recorded trajectory's velocities are from its configurations: check a convention, do not guess it.

    It shrinks with dt^2 where the conventions are Pinocchio's. Where they are not (base velocity in the world frame,
    quaternion w first, joints in another order) it is of the order of the speed, if the base is turned.

    Args:
        model: Pinocchio's.
        configurations: (n, nq) at equal steps, n >= 3.
        velocities: (n, nv) at the same times.
        dt: Those steps [s].

    Returns:
        The distance [m/s] between the CoM velocity and the central difference of the CoM, (n - 2,): at all steps but the
        first and last.

    Raises:
        ValueError: As `centroidal_states`; also for fewer than three rows, and a step that is not positive.
    """
    if not (np.ndim(dt) == 0 and np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt = {dt} (expected a positive number of seconds)")
    states = centroidal_states(model, configurations, velocities)
    if len(states.com) < 3:
        raise ValueError(f"configurations has {len(states.com)} rows (expected at least 3 for a central difference)")
    difference = (states.com[2:] - states.com[:-2]) / (2 * dt)
    return np.linalg.norm(difference - states.com_velocity[1:-1], axis=1)


def contact_placement(model: Model, configuration: ArrayLike, patch: ContactPatch) -> Placement:
    """Where a patch of the robot is.

    Args:
        model: Pinocchio's.
        configuration: (nq,).
        patch: A rectangle or a point: of `TALOS_CONTACTS`, `ANYMAL_FEET`, or your own.

    Returns:
        Position [m] and rotation in the world frame, as `jaxcap.rectangle` takes them. The rotation of a point is that of
        its link: what the point stands on says where its normal is.

    Raises:
        ValueError: Naming the field, or the frame that the model does not have.
    """
    if np.shape(configuration) != (model.nq,):
        raise ValueError(f"configuration has shape {np.shape(configuration)} (expected ({model.nq},): nq = {model.nq})")
    configuration = _rows("configurations", np.asarray(configuration)[None], "nq", model.nq)
    _check_units(model, configuration)
    if not model.existFrame(patch.frame):
        raise ValueError(f"patch.frame = {patch.frame!r} is no frame of {model.name}")
    data, frame = model.createData(), model.getFrameId(patch.frame)
    pin.forwardKinematics(model, data, pin.normalize(model, configuration[0]))
    link = pin.updateFramePlacement(model, data, frame)
    return Placement(link.act(np.array(patch.position)), link.rotation @ np.array(patch.rotation))


def _rows(name: str, value: ArrayLike, symbol: str, size: int) -> Float[np.ndarray, "n size"]:
    """`value` as float64 rows of this size, or ValueError."""
    array = np.asarray(value)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} has dtype {array.dtype} (expected numbers)")
    if array.ndim != 2 or array.shape[1] != size:
        raise ValueError(f"{name} has shape {array.shape} (expected (n, {size}): {symbol} = {size})")
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        row, column = map(int, bad[0])
        raise ValueError(f"{name}[{row}, {column}] = {array[row, column]} (expected a finite number)")
    return np.ascontiguousarray(array, dtype=np.float64)


def _check_units(model: Model, configurations: Float[np.ndarray, "n nq"]) -> None:
    """ValueError for the first quaternion, or sine and cosine of an unbounded joint, that is not of unit norm."""
    for name, joint in zip(model.names, model.joints, strict=True):
        tail = UNIT_TAIL.get(joint.shortname(), 2 if (joint.nq, joint.nv) == (2, 1) else 0)
        end = joint.idx_q + joint.nq
        norm = np.linalg.norm(configurations[:, end - tail : end], axis=1)
        bad = np.flatnonzero((np.abs(norm - 1) > UNIT_NORM) & (tail > 0))
        if len(bad):
            row = int(bad[0])
            what = "quaternion (x, y, z, w)" if tail == 4 else "cosine and sine"
            raise ValueError(
                f"configurations[{row}, {end - tail}:{end}]: {what} of {name} has norm {norm[row]:.6g} "
                f"(expected 1 within {UNIT_NORM:g})"
            )
