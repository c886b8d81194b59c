"""Robots: by name, or from a URDF or MJCF file."""

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Float
from pinocchio import Model  # the PyPI project called "pinocchio" is another one, and has no Model

from jaxcap.errors import InputError
from jaxcap.robots.patches import ANYMAL_FEET, TALOS_CONTACTS, ContactPatch, Patches, read_patches
from jaxcap.robots.soles import find_patches

PathLike = str | os.PathLike

FEET = Path(__file__).parent / "feet"
"""Patches of robots by name, a file each."""


class Robot(NamedTuple):
    """A robot ready for use."""

    model: Model
    """Pinocchio's model, locked joints removed."""
    postures: dict[str, Float[np.ndarray, "nq"]]
    """Named configurations of the SRDF file, such as `half_sitting`."""
    collisions: pin.GeometryModel | None
    """Collision shapes with the pairs that may not touch; None where no `package_dirs` were given."""
    patches: Patches = MappingProxyType({})
    """Where it can touch, by name; empty where nobody said and none was looked for."""


class Known(NamedTuple):
    """A robot of the package example-robot-data."""

    folder: str
    urdf: str
    srdf: str | None = None
    locked_joints: tuple[str, ...] = ()
    """Fixed at zero."""
    patches: Mapping[str, ContactPatch] | None = None
    """Where it can touch; None: as the file `feet/NAME.yaml` says, which was found from its collision shapes."""
    standing: str = ""
    """The posture in which its soles are flat; by default all joints at zero."""


_TALOS = Known(
    "talos_data",
    "robots/talos_reduced.urdf",
    "srdf/talos.srdf",
    ("gripper_left_joint", "gripper_right_joint"),
    TALOS_CONTACTS,
    "half_sitting",
)
_ANYMAL = Known("anymal_b_simple_description", "robots/anymal.urdf", "srdf/anymal.srdf", (), ANYMAL_FEET, "standing")

ROBOTS = {
    "talos": _TALOS,
    "g1": Known("g1_description", "urdf/g1_29dof_rev_1_0.urdf"),
    "romeo": Known("romeo_description", "urdf/romeo_small.urdf", "srdf/romeo_small.srdf", standing="half_sitting"),
    "anymal": _ANYMAL,
    "solo": Known("solo_description", "robots/solo12.urdf", "srdf/solo.srdf", standing="standing"),
    "go1": Known("go1_description", "urdf/go1.urdf", "srdf/go1.srdf", standing="standing"),
    "go2": Known("go2_description", "urdf/go2.urdf", "srdf/go2.srdf", standing="standing"),
}
"""Robots by name."""


def load(name_or_path: PathLike, feet: PathLike | None = None) -> Robot:
    """A robot by its name, or from its file, with the places where it can touch.

    Args:
        name_or_path: A name of `ROBOTS`, or a URDF (.urdf) or MJCF (.xml, .mjcf) file. Meshes are looked for beside the file
            and in the folders above it; shapes whose mesh is not there are left out.
        feet: A YAML file with its patches, as `patches_yaml` prints it. By default those that are known of the robot, or
            those found from its collision shapes; perhaps none.

    Raises:
        InputError: For an unknown name, and for a file that is missing or that Pinocchio cannot read.
    """
    text = os.fspath(name_or_path)
    robot = _named(text) if text in ROBOTS else _from_file(Path(text))
    return robot if feet is None else robot._replace(patches=read_patches(feet, robot.model))


def _named(name: str) -> Robot:
    """A robot of the table."""
    known = ROBOTS[name]
    robot = _example(known, collisions=False)
    patches = read_patches(FEET / f"{name}.yaml", robot.model) if known.patches is None else known.patches
    return robot._replace(patches=patches)


def look_for_patches(name: str) -> dict[str, ContactPatch]:
    """What is found of a robot of the table, from its collision shapes; the files in `feet/` are made by this."""
    robot = _example(ROBOTS[name], collisions=True)
    return find_patches(robot.model, robot.collisions, robot.postures.get(ROBOTS[name].standing, pin.neutral(robot.model)))


def _from_file(path: Path) -> Robot:
    """A robot from a file, without locked joints."""
    kind = path.suffix.lower()
    if kind not in (".urdf", ".xml", ".mjcf"):
        raise InputError(f"robot {os.fspath(path)!r} is unknown (expected {', '.join(ROBOTS)}, or a .urdf or .xml file)")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        model, shapes = _urdf(path) if kind == ".urdf" else _mjcf(path)
    except (ValueError, RuntimeError) as error:
        raise InputError(f"{path}: Pinocchio cannot read it: {error}") from error
    if model.njoints < 2 or model.joints[1].nq != 7:
        raise InputError(f"{path}: its base does not move freely (expected a robot with a floating base)")
    return Robot(model, {}, None, find_patches(model, shapes, pin.neutral(model)))


def _urdf(path: Path) -> tuple[Model, pin.GeometryModel]:
    """Model, and the collision shapes of its outermost links; those whose mesh is not there are left out."""
    model = pin.buildModelFromUrdf(os.fspath(path), pin.JointModelFreeFlyer())
    folders = [folder for folder in path.resolve().parents if folder.parent != folder]
    try:
        tree = ElementTree.parse(path)
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error
    for link in tree.iter("link"):
        outer = _is_outermost(model, link.get("name", ""))
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if not outer or (mesh is not None and not any(_has(folder, mesh.get("filename", "")) for folder in folders)):
                link.remove(collision)
    text, known = ElementTree.tostring(tree.getroot(), encoding="unicode"), [os.fspath(folder) for folder in folders]
    return model, pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION, package_dirs=known)


def _is_outermost(model: Model, link: str) -> bool:
    """Whether no joint moves anything on from this link: meshes of the others take seconds to read, and are no feet."""
    return model.existFrame(link) and not len(model.children[model.frames[model.getFrameId(link)].parentJoint])


def _has(folder: Path, address: str) -> bool:
    """Whether a mesh is there, in this folder of packages."""
    name = address.removeprefix("package://").removeprefix("file://")
    return (folder / name).is_file()


def _mjcf(path: Path) -> tuple[Model, pin.GeometryModel]:
    """Model and collision shapes of a MuJoCo file; with a floating base even where the file has none."""
    model = pin.buildModelFromMJCF(os.fspath(path))
    if isinstance(model, tuple):  # with constraints, some versions return them beside the model
        model = model[0]
    if model.njoints < 2 or model.joints[1].nq != 7:
        model = pin.buildModelFromMJCF(os.fspath(path), pin.JointModelFreeFlyer())
        model = model[0] if isinstance(model, tuple) else model
    try:
        return model, pin.buildGeomFromMJCF(model, os.fspath(path), pin.GeometryType.COLLISION)
    except (ValueError, RuntimeError):
        return model, pin.GeometryModel()  # a mesh is missing: the feet have to be given


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
    return _example(_TALOS, collisions)


def anymal(collisions: bool = False) -> Robot:
    """ANYmal B of example-robot-data (30.5 kg): nq = 19, nv = 18. Posture: `standing`."""
    return _example(_ANYMAL, collisions)


def _example(known: Known, collisions: bool) -> Robot:
    """A robot of the package example-robot-data, which installs into the same prefix as Pinocchio."""
    share = Path(pin.__file__).parents[4] / "share"  # <prefix>/lib/python3.x/site-packages/pinocchio/__init__.py
    root = share / "example-robot-data" / "robots" / known.folder
    urdf, srdf = root / known.urdf, known.srdf and root / known.srdf
    if not urdf.is_file():
        raise FileNotFoundError(f'{urdf}: no such file; pip install "jaxcap[robots]" (example-robot-data >= 6)')
    return load_robot(urdf, srdf, [share] if collisions else (), locked_joints=known.locked_joints)
