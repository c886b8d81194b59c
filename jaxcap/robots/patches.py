"""Where a robot can touch: patches of its links, as data, in YAML, and in the world.

A sole, a point foot and a ball foot are one kind of thing: a frame of the robot, a place in it, two half sides that may be
zero, and a radius by which a ball's contact lies below its centre.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from jaxcap.contacts.conventions import ROTATION_ERROR, ArrayLike
from jaxcap.errors import InputError, needs_extra
from jaxcap.robots.centroidal import check_units, rows_of

_SOLE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_CORNERS = ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0))


class ContactPatch(NamedTuple):
    """Where a robot's link can touch: a rectangle that can rest on a flat surface, or, without sides, a point or a ball."""

    frame: str
    """Name of the link's frame in the model."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre of the rectangle, the point, or the centre of the ball, in that frame [m]."""
    rotation: tuple[tuple[float, float, float], ...] = _SOLE
    """(3, 3) in that frame. Columns: direction of the length, of the width, normal pointing into the robot."""
    half_length: float = 0.0
    """[m], the long side."""
    half_width: float = 0.0
    """[m]."""
    radius: float = 0.0
    """Of a ball: it touches the ground this far below its centre, however the link is turned [m]."""

    @property
    def is_point(self) -> bool:
        """Whether it has no sides."""
        return self.half_length == 0 and self.half_width == 0

    @property
    def points(self) -> Float[np.ndarray, "k 3"]:
        """Its corners, or its one point, in the frame of the link [m]."""
        if self.is_point:
            return np.array([self.position])
        sides = np.array(_CORNERS) * (self.half_length, self.half_width)
        return np.array(self.position) + sides @ np.array(self.rotation)[:, :2].T


Patches = Mapping[str, ContactPatch]

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


def contact_placement(model: pin.Model, configuration: ArrayLike, patch: ContactPatch) -> Placement:
    """Where a patch of the robot is.

    Args:
        model: Pinocchio's.
        configuration: (nq,).
        patch: A rectangle, a point or a ball: of `TALOS_CONTACTS`, `ANYMAL_FEET`, `Robot.patches`, or your own.

    Returns:
        Position [m] and rotation in the world frame, as `jaxcap.rectangle` takes them. The rotation of a point is that of
        its link: what the point stands on says where its normal is. A ball's position is its lowest point.

    Raises:
        ValueError: Naming the field, or the frame that the model does not have.
    """
    if np.shape(configuration) != (model.nq,):
        raise ValueError(f"configuration has shape {np.shape(configuration)} (expected ({model.nq},): nq = {model.nq})")
    configuration = rows_of("configurations", np.asarray(configuration)[None], "nq", model.nq)
    check_units(model, configuration)
    if not model.existFrame(patch.frame):
        raise ValueError(f"patch.frame = {patch.frame!r} is no frame of {model.name}")
    data, frame = model.createData(), model.getFrameId(patch.frame)
    pin.forwardKinematics(model, data, pin.normalize(model, configuration[0]))
    link = pin.updateFramePlacement(model, data, frame)
    lowest = link.act(np.array(patch.position)) - (0, 0, patch.radius)
    return Placement(lowest, link.rotation @ np.array(patch.rotation))


def read_patches(path: str | os.PathLike, model: pin.Model) -> dict[str, ContactPatch]:
    """The patches of a robot from a YAML file, as `patches_yaml` writes it.

    Args:
        path: The file: under `patches`, by name, the fields of `ContactPatch`; all but `frame` may be left out.
        model: The robot's, whose frames are named.

    Raises:
        InputError: Naming file, patch and field.
    """
    with needs_extra("logs", "reading YAML"):
        import yaml
    try:
        said = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise InputError(f"{path}: cannot be read as YAML: {error}") from error
    listed = said.get("patches") if isinstance(said, dict) else None
    if not isinstance(listed, dict) or not listed:
        raise InputError(f"{path}: no patches (expected under 'patches', by name, fields such as 'frame')")
    return {str(name): _patch(f"{path}: patches.{name}", fields, model) for name, fields in listed.items()}


def _patch(where: str, fields: Any, model: pin.Model) -> ContactPatch:
    """A patch from YAML."""
    if not isinstance(fields, dict) or "frame" not in fields:
        raise InputError(f"{where} = {fields!r} (expected fields, 'frame' among them)")
    unknown = set(fields) - set(ContactPatch._fields)
    if unknown:
        raise InputError(f"{where}: unknown field {min(unknown)!r} (expected some of {', '.join(ContactPatch._fields)})")
    if not model.existFrame(str(fields["frame"])):
        raise InputError(f"{where}.frame = {fields['frame']!r} is no frame of {model.name}")
    numbers = {}
    for name, shape in (("position", (3,)), ("rotation", (3, 3)), ("half_length", ()), ("half_width", ()), ("radius", ())):
        try:
            value = np.array(fields.get(name, ContactPatch._field_defaults[name]), float)
        except (TypeError, ValueError):
            value = np.array(np.nan)
        if value.shape != shape or not np.isfinite(value).all() or (not shape and value < 0):
            kind = "x".join(map(str, shape)) + " finite numbers" if shape else "a number of metres, not negative"
            raise InputError(f"{where}.{name} = {fields.get(name)!r} (expected {kind})")
        numbers[name] = value
    turn = numbers["rotation"]
    if np.abs(turn.T @ turn - np.eye(3)).max() > ROTATION_ERROR or np.linalg.det(turn) < 0:
        raise InputError(f"{where}.rotation = {fields['rotation']!r} is not a rotation (columns: length, width, normal)")
    return ContactPatch(str(fields["frame"]), **{name: _plain(value) for name, value in numbers.items()})


def _plain(value: np.ndarray) -> Any:
    """An array as nested tuples of numbers."""
    return tuple(map(_plain, value)) if value.ndim else float(value)


def patches_yaml(patches: Patches) -> str:
    """The text of the YAML file that `read_patches` reads: to look at, to correct, and to give back with `--feet`."""
    lines = ["patches:   # where the robot can touch; metres, in the frame of the link"]
    for name, patch in patches.items():
        lines += [f"  {name}:", f"    frame: {patch.frame}", f"    position: {_listed(patch.position)}"]
        if patch.is_point:
            lines += [f"    radius: {patch.radius:.6g}   # 0: a point; else a ball, of which this is the centre"]
        else:
            lines += [
                f"    rotation: [{', '.join(map(_listed, patch.rotation))}]   # columns: length, width, normal",
                f"    half_length: {patch.half_length:.6g}",
                f"    half_width: {patch.half_width:.6g}",
            ]
    return "\n".join(lines) + "\n"


def _listed(numbers: tuple[float, ...]) -> str:
    return f"[{', '.join(f'{number:.9g}' for number in numbers)}]"
