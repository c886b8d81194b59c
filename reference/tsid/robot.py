"""A robot and where it can touch: what sampling, controller and simulator share.

Conventions are Pinocchio's: q starts with the base position in the world frame [m] and its orientation as a quaternion
x, y, z, w; v starts with the base's linear and angular velocity in the base's LOCAL frame. A contact's frame has its
origin at the centre of a rectangle, columns along the length and the width, and the normal pointing into the robot.
"""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

CONFIGURATIONS = Path(__file__).parent / "robots"
"""The folder of the robots known by name."""

SHARE = Path(pin.__file__).parents[4] / "share"  # <prefix>/lib/python3.x/site-packages/pinocchio/__init__.py
"""Where example-robot-data installs its models: in the same prefix as Pinocchio."""

EFFECTORS = ("left_foot", "right_foot", "left_hand", "right_hand")
"""What every robot has, in this order."""


class Effector(NamedTuple):
    """A rectangle on a link that can rest on a flat surface."""

    frame: int
    """Index of the link's frame in the model."""
    placement: pin.SE3
    """Of the rectangle in that frame [m]."""
    half_length: float
    """[m], along the first axis."""
    half_width: float
    """[m], along the second axis."""


class Robot(NamedTuple):
    """A robot ready for use: one free-flying base, then n joints of one degree of freedom each (nv = n + 6)."""

    name: str
    model: pin.Model
    collisions: pin.GeometryModel
    """Collision shapes, with the pairs that may not touch."""
    home: np.ndarray
    """(nq,): the posture around which configurations are drawn."""
    effectors: dict[str, Effector]
    """In the order left foot, right foot, left hand, right hand."""
    lower: np.ndarray
    """(n,) least joint positions [rad]."""
    upper: np.ndarray
    """(n,) greatest joint positions [rad]."""
    speed: np.ndarray
    """(n,) greatest joint speeds [rad/s]."""
    torque: np.ndarray
    """(n,) greatest joint torques [N m]."""


class Contact(NamedTuple):
    """A rectangle of the robot held against a surface of the world."""

    effector: str
    placement: pin.SE3
    """Of the rectangle in the world [m]."""
    half_length: float
    half_width: float
    friction: float


class Sample(NamedTuple):
    """A robot just after a push: sample `index` of a scenario, the same whoever draws it."""

    scenario: str
    seed: int
    index: int
    q: np.ndarray
    """(nq,)"""
    v: np.ndarray
    """(nv,)"""
    contacts: tuple[Contact, ...]


def configuration(robot: str | os.PathLike) -> Path:
    """The TOML file of a robot, by its name in `robots/` or by its path. Raises FileNotFoundError."""
    named = CONFIGURATIONS / f"{robot}.toml"
    path = named if named.is_file() else Path(robot)
    if not path.is_file():
        known = ", ".join(sorted(entry.stem for entry in CONFIGURATIONS.glob("*.toml")))
        raise FileNotFoundError(f"robot {os.fspath(robot)!r}: no such file (by name: {known})")
    return path


def entries_of(robot: str | os.PathLike) -> dict[str, Any]:
    """What a configuration says: its own keys and, where it says `like = NAME`, those of that one which it has not."""
    entries = tomllib.loads(configuration(robot).read_text(encoding="utf-8"))
    return entries_of(entries.pop("like")) | entries if "like" in entries else entries


def load(robot: str | os.PathLike) -> Robot:
    """A robot by the name of a file in `robots/`, or from a TOML file of its own (`robots/talos.toml` explains the keys).

    Collision pairs are those of all shapes, less those that the SRDF disables, those of links joined by a joint or fixed
    to each other, and those that touch in the home posture: shapes that overlap there are drawn too large.
    Raises FileNotFoundError naming the missing file; ValueError naming the key that is missing, unknown or wrong.
    """
    path, entries = configuration(robot), entries_of(robot)
    unknown = set(entries) - {"urdf", "srdf", "packages", "home", "locked", "effectors", "torque"}
    missing = {"urdf", "packages", "home", "effectors"} - set(entries)
    if unknown or missing:
        raise ValueError(f"{path.name}: unknown keys {sorted(unknown)}, missing keys {sorted(missing)} (expected none)")
    urdf, packages = _find(path, "urdf", entries["urdf"]), _find(path, "packages", entries["packages"])
    srdf = _find(path, "srdf", entries["srdf"]) if "srdf" in entries else None
    model = pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer())
    shapes = pin.buildGeomFromUrdf(model, str(urdf), pin.GeometryType.COLLISION, package_dirs=[str(packages)])
    if srdf is not None:
        pin.loadReferenceConfigurations(model, str(srdf))
    locked = [_joint(path, "locked", model, name) for name in entries.get("locked", ())]
    model, (shapes,) = pin.buildReducedModel(model, [shapes], locked, pin.neutral(model))
    home = _home(path, model, entries["home"])
    _keep_pairs(model, shapes, srdf, home)
    found = {key: _effector(path, model, key, entries["effectors"].get(key)) for key in EFFECTORS}
    lower, upper, speed, torque = _limits(path, model)
    for name, value in entries.get("torque", {}).items():
        if not value > 0:
            raise ValueError(f"{path.name}: torque.{name} = {value} (expected a positive torque)")
        torque[model.joints[_joint(path, "torque", model, name)].idx_v - 6] = value
    return Robot(path.stem, model, shapes, home, found, lower, upper, speed, torque)


def _find(configuration: Path, key: str, relative: str) -> Path:
    """The file or folder meant by a path relative to `SHARE` or to the configuration."""
    for root in (SHARE, configuration.parent):
        if (root / relative).exists():
            return root / relative
    raise FileNotFoundError(
        f"{configuration.name}: {key} = {relative!r} is neither in {SHARE} nor beside the configuration; "
        'models named example-robot-data/... come with: pip install "example-robot-data>=6"'
    )


def _joint(path: Path, key: str, model: pin.Model, name: str) -> int:
    if not model.existJointName(name):
        raise ValueError(f"{path.name}: {key}: {name!r} is no joint of {model.name} (expected one of: {list(model.names)})")
    return model.getJointId(name)


def _home(path: Path, model: pin.Model, entry: str | dict[str, float]) -> np.ndarray:
    """(nq,): a posture of the SRDF by name, or one from a table of joint positions."""
    if isinstance(entry, str):
        postures = {posture.key(): np.array(posture.data()) for posture in model.referenceConfigurations}
        if entry not in postures:
            raise ValueError(f"{path.name}: home = {entry!r} (expected one of: {sorted(postures)})")
        return postures[entry]
    home = pin.neutral(model)
    for name, value in entry.items():
        home[model.joints[_joint(path, "home", model, name)].idx_q] = value
    return home


def _keep_pairs(model: pin.Model, shapes: pin.GeometryModel, srdf: Path | None, home: np.ndarray) -> None:
    """Leave in `shapes` the pairs that can collide; the rule is that of `load`."""
    shapes.addAllCollisionPairs()
    if srdf is not None:
        pin.removeCollisionPairs(model, shapes, str(srdf))
    data = shapes.createData()
    pin.computeCollisions(model, model.createData(), shapes, data, home, False)
    dropped = []
    for pair, result in zip(shapes.collisionPairs, data.collisionResults, strict=True):
        first, second = (shapes.geometryObjects[i].parentJoint for i in (pair.first, pair.second))
        joined = first == second or model.parents[first] == second or model.parents[second] == first
        if joined or result.isCollision():
            dropped.append((pair.first, pair.second))
    for pair in dropped:
        shapes.removeCollisionPair(pin.CollisionPair(*pair))


def _effector(path: Path, model: pin.Model, key: str, entry: dict[str, Any] | None) -> Effector:
    expected = {"frame", "position", "normal", "along", "half_length", "half_width"}
    if entry is None or set(entry) != expected:
        have = "nothing" if entry is None else sorted(entry)
        raise ValueError(f"{path.name}: effectors.{key} has {have} (expected {sorted(expected)})")
    if not model.existFrame(entry["frame"]):
        raise ValueError(f"{path.name}: effectors.{key}.frame = {entry['frame']!r} is no frame of {model.name}")
    normal, along = np.array(entry["normal"], float), np.array(entry["along"], float)
    normal = normal / np.linalg.norm(normal)
    along = along - (normal @ along) * normal
    if not np.linalg.norm(along) > 1e-6:
        raise ValueError(f"{path.name}: effectors.{key}.along = {entry['along']} (expected not parallel to the normal)")
    along = along / np.linalg.norm(along)
    for name in ("half_length", "half_width"):
        if not entry[name] > 0:
            raise ValueError(f"{path.name}: effectors.{key}.{name} = {entry[name]} (expected a positive length)")
    rotation = np.column_stack([along, np.cross(normal, along), normal])
    placement = pin.SE3(rotation, np.array(entry["position"], float))
    return Effector(model.getFrameId(entry["frame"]), placement, entry["half_length"], entry["half_width"])


def _limits(path: Path, model: pin.Model) -> tuple[np.ndarray, ...]:
    """Least and greatest position, greatest speed and torque of the joints, (n,) each, from the URDF."""
    if model.nv < 7 or model.joints[1].nv != 6 or model.nq != model.nv + 1:
        raise ValueError(
            f"{path.name}: {model.name} has nq = {model.nq}, nv = {model.nv} (expected 1-DoF joints: nq = nv + 1)"
        )
    lower, upper = model.lowerPositionLimit[7:], model.upperPositionLimit[7:]
    limits = {"range": upper - lower, "velocity": model.upperVelocityLimit[6:], "effort": model.upperEffortLimit[6:]}
    for key, values in limits.items():
        bad = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
        if len(bad):
            raise ValueError(f"{path.name}: {key} limit of {model.names[bad[0] + 2]} is {values[bad[0]]} (expected > 0)")
    return lower.copy(), upper.copy(), limits["velocity"].copy(), limits["effort"].copy()
