"""A log's episode in the conventions of this library: time, q and v as Pinocchio has them, flags of contact.

Everything that a layout declares is undone here and nowhere else: order of quaternions, Euler angles, degrees,
millimetres, y up, frames of velocities, order of joints.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from jaxcap.errors import InputError
from jaxcap.robots.episodes import Column, Episode
from jaxcap.robots.layouts import LENGTHS, Layout

Y_TO_Z = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Turns a world with y up into one with z up."""

SLIDERS = ("JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned")
"""Joints whose numbers are lengths."""


class Velocities(NamedTuple):
    """What of a velocity was logged; None: not."""

    linear: Float[np.ndarray, "n 3"] | None
    """Of the base, along its own axes [m/s]."""
    angular: Float[np.ndarray, "n 3"] | None
    """Likewise [rad/s]."""
    joints: Float[np.ndarray, "n j"] | None
    """[rad/s, m/s], NaN for joints that are not in the log."""


class Rows(NamedTuple):
    """Rows of an episode, in Pinocchio's conventions."""

    time: Float[np.ndarray, " n"]
    """[s]"""
    configurations: Float[np.ndarray, "n nq"]
    norms: Float[np.ndarray, " n"]
    """Of the quaternions as logged; those in `configurations` are normalised."""
    logged: Velocities
    touching: Mapping[str, Bool[np.ndarray, " n"]]
    """By the names of patches; empty where it was not logged."""


class JointMap(NamedTuple):
    """Where the joints of a log go."""

    columns: tuple[int, ...]
    """Of the log, for each joint that both have."""
    joints: tuple[int, ...]
    """The model's, in the same order."""
    missing: tuple[str, ...]
    """Joints of the model that the log does not have."""


class Source:
    """An episode of a log, whose rows can be had in any piece.

    Args:
        episode: Its fields.
        layout: What they are.
        model: Pinocchio's, with a floating base.

    Raises:
        InputError: Naming file, episode, field, expectation and value: no base pose, joints of another robot, wrong shapes.
    """

    def __init__(self, episode: Episode, layout: Layout, model: pin.Model):
        self._layout, self._model, self.where = layout, model, episode.where
        for what, field in (("base_position", layout.base_position), ("base_orientation", layout.base_orientation)):
            if not episode.has(field):
                names = ", ".join(name for name in list(episode.fields)[:20])
                raise InputError(
                    f"{self.where}: no base pose: {what} {field!r} is not there, and without it nothing can be scored "
                    f"(fields: {names})"
                )
        widths = {"base_position": 3, "base_orientation": 4 if layout.quaternion else 3}
        self._columns = {what: self._column(episode, what, width) for what, width in widths.items()}
        self.rows = len(self._columns["base_position"])
        self._time = _clock(episode, layout)
        self._map, self._columns["joint_positions"] = self._joints(episode)
        width = self._columns["joint_positions"][:0].shape[1]
        for what, size in (("base_linear_velocity", 3), ("base_angular_velocity", 3), ("joint_velocities", width)):
            if self._logged(episode, what):
                self._columns[what] = self._column(episode, what, size)
        flags = {name: field for name, field in (layout.contacts or {}).items() if episode.has(field)}
        self._flags = {name: episode.column(f"contacts.{name}", field) for name, field in flags.items()}
        self._check_lengths()

    @property
    def missing(self) -> tuple[str, ...]:
        """Joints of the robot that the log does not have: they are held at zero."""
        return self._map.missing

    @property
    def has_velocities(self) -> bool:
        """Whether all velocities are logged."""
        return {"base_linear_velocity", "base_angular_velocity", "joint_velocities"} <= set(self._columns)

    def _logged(self, episode: Episode, what: str) -> bool:
        """Whether the log has this velocity."""
        field = getattr(self._layout, what)
        if what == "joint_velocities" and isinstance(field, str) and "{joint}" in field:
            return episode.has(self._template(episode, field))
        return episode.has(field)

    def _column(self, episode: Episode, what: str, width: int) -> Column:
        field = getattr(self._layout, what)
        if isinstance(field, str) and "{joint}" in field:
            field = self._template(episode, field)
        column = episode.column(what, field)
        shape = column[:0].shape
        if shape[1:] != (width,):
            raise InputError(f"{self.where}: {what} {field!r} has rows of shape {shape[1:]} (expected ({width},))")
        return column

    def _template(self, episode: Episode, template: str) -> tuple[str, ...]:
        """The fields of the robot's joints that the log has positions of."""
        positions = str(self._layout.joint_positions)
        names = [name for name in list(self._model.names)[2:] if positions.replace("{joint}", name) in episode.fields]
        return tuple(template.replace("{joint}", name) for name in names)

    def _joints(self, episode: Episode) -> tuple[JointMap, Column]:
        """The joints' columns, and where they go."""
        layout, model = self._layout, self._model
        if isinstance(layout.joint_positions, str) and "{joint}" in layout.joint_positions:
            fields = self._template(episode, layout.joint_positions)
            if not fields:
                raise InputError(
                    f"{self.where}: no column has the name of a joint of {model.name} ({_some(list(model.names)[2:])})"
                )
            names = [name for name in list(model.names)[2:] if layout.joint_positions.replace("{joint}", name) in fields]
            column = episode.column("joint_positions", fields if len(fields) > 1 else f"{fields[0]}")
            return joint_map(self.where, names, model, ()), column
        column = episode.column("joint_positions", layout.joint_positions)
        shape = column[:0].shape
        if len(shape) != 2:
            raise InputError(
                f"{self.where}: joint_positions has rows of shape {shape[1:]} (expected one number for each joint)"
            )
        if layout.joint_names is not None:
            names = list(episode.texts("joint_names", layout.joint_names))
        else:
            names = robot_order(model, str(layout.joint_order))
        if len(names) != shape[1]:
            source = f"{model.name} has" if layout.joint_names is None else "joint_names has"
            raise InputError(
                f"{self.where}: joint_positions has {shape[1]} columns, but {source} {len(names)} joints ({_some(names)})"
            )
        return joint_map(self.where, names, model, layout.ignored_joints), column

    def _check_lengths(self) -> None:
        if not self.rows:
            raise InputError(f"{self.where}: no rows")
        named = self._columns | {f"contacts.{name}": flag for name, flag in self._flags.items()}
        for what, column in named.items():
            if len(column) != self.rows:
                raise InputError(f"{self.where}: {what} has {len(column)} rows (expected {self.rows}, as base_position has)")
        if isinstance(self._time, Column) and len(self._time) != self.rows:
            raise InputError(f"{self.where}: time has {len(self._time)} rows (expected {self.rows}, as base_position has)")

    def read(self, start: int, stop: int) -> Rows:
        """Rows start to stop. Raises InputError naming row and field for a number that is not finite, or a zero
        quaternion.
        """
        rows, layout, model = slice(start, stop), self._layout, self._model
        raw = {what: self._finite(what, column[rows], start) for what, column in self._columns.items()}
        time = self._time[rows].reshape(-1) if isinstance(self._time, Column) else np.arange(start, stop) * self._time
        time = self._finite("time", time, start)
        length, angle = LENGTHS[layout.lengths], np.pi / 180 if layout.angles == "deg" else 1.0
        world = Y_TO_Z if layout.up == "y" else np.eye(3)
        turned, norms = self._orientation(raw["base_orientation"] * (1.0 if layout.quaternion else angle), start)
        turned = Rotation.from_matrix(world) * turned if layout.up == "y" else turned
        q = np.tile(pin.neutral(model), (len(time), 1))
        q[:, :3] = raw["base_position"] * length @ world.T
        q[:, 3:7] = turned.as_quat()
        joints = raw["joint_positions"] * self._units(angle)
        for column, joint in zip(self._map.columns, self._map.joints, strict=True):
            _set(q, model.joints[joint], joints[:, column])
        own = lambda what, unit, frame: _own(raw.get(what), unit, frame, world, turned)
        linear = own("base_linear_velocity", length, layout.linear_velocity_frame)
        angular = own("base_angular_velocity", angle, layout.angular_velocity_frame)
        flags = {name: self._finite(name, column[rows], start).reshape(-1) > 0.5 for name, column in self._flags.items()}
        return Rows(time, q, norms, Velocities(linear, angular, self._joint_velocities(raw, angle)), flags)

    def _units(self, angle: float) -> Float[np.ndarray, " k"]:
        """What the numbers of each column are multiplied by: sliders are in metres."""
        width = self._columns["joint_positions"][:0].shape[1]
        units = np.full(width, angle)
        for column, joint in zip(self._map.columns, self._map.joints, strict=True):
            if self._model.joints[joint].shortname() in SLIDERS:
                units[column] = LENGTHS[self._layout.lengths]
        return units

    def _joint_velocities(self, raw: Mapping[str, np.ndarray], angle: float) -> Float[np.ndarray, "n j"] | None:
        if "joint_velocities" not in raw:
            return None
        logged = raw["joint_velocities"] * self._units(angle)
        found = np.full((len(logged), self._model.nv - 6), np.nan)
        for column, joint in zip(self._map.columns, self._map.joints, strict=True):
            found[:, self._model.joints[joint].idx_v - 6] = logged[:, column]
        return found

    def _orientation(self, numbers: np.ndarray, start: int) -> tuple[Rotation, Float[np.ndarray, " n"]]:
        if self._layout.euler:
            return Rotation.from_euler(self._layout.euler, numbers), np.ones(len(numbers))
        if self._layout.quaternion == "wxyz":
            numbers = numbers[:, [1, 2, 3, 0]]
        norms = np.linalg.norm(numbers, axis=1)
        zero = np.flatnonzero(norms < 1e-6)
        if len(zero):
            raise InputError(f"{self.where}: base_orientation[{start + zero[0]}] is zero (expected a unit quaternion)")
        return Rotation.from_quat(numbers), norms

    def _finite(self, what: str, values: np.ndarray, start: int) -> np.ndarray:
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            place = ", ".join(map(str, (bad[0][0] + start, *bad[0][1:])))
            raise InputError(f"{self.where}: {what}[{place}] = {values[tuple(bad[0])]} (expected a finite number)")
        return values


def _own(
    velocity: np.ndarray | None, unit: float, frame: str | None, world: np.ndarray, turned: Rotation
) -> Float[np.ndarray, "n 3"] | None:
    """A velocity of the base along its own axes."""
    if velocity is None:
        return None
    velocity = velocity * unit
    return velocity if frame == "base" else turned.inv().apply(velocity @ world.T)


def _set(q: np.ndarray, joint: object, values: np.ndarray) -> None:
    """Writes the positions of one joint: an angle, a length, or cosine and sine."""
    if joint.nq == 2:  # type: ignore[attr-defined]
        q[:, joint.idx_q], q[:, joint.idx_q + 1] = np.cos(values), np.sin(values)  # type: ignore[attr-defined]
    else:
        q[:, joint.idx_q] = values  # type: ignore[attr-defined]


def _clock(episode: Episode, layout: Layout) -> Column | float:
    """Times of the rows, or the step between them [s]."""
    if layout.time is not None:
        return episode.column("time", layout.time)
    if layout.rate is not None:
        return 1.0 / episode.number("rate", layout.rate)
    return episode.number("step", layout.step or 0.0)


def robot_order(model: pin.Model, order: str) -> list[str]:
    """The joints after the base, depth first as the model has them, or breadth first: all of one depth before the next."""
    depth = [0] * model.njoints
    for joint in range(1, model.njoints):
        depth[joint] = depth[model.parents[joint]] + 1
    joints = range(2, model.njoints)
    return [
        model.names[joint] for joint in (joints if order == "depth first" else sorted(joints, key=lambda one: depth[one]))
    ]


def joint_map(where: str, names: list[str], model: pin.Model, ignored: tuple[str, ...]) -> JointMap:
    """Where the joints of a log go, by name; `_joint`, `.pos` and capitals do not matter where that leaves no doubt.

    Raises:
        InputError: For a joint that the robot does not have, and for one that is named twice.
    """
    own = {_plain(name): joint for joint, name in enumerate(model.names) if joint > 1}
    exact = {name: joint for joint, name in enumerate(model.names) if joint > 1}
    if len(own) < len(exact):
        own = exact  # two joints differ in spelling alone
    columns, joints = [], []
    for column, name in enumerate(names):
        joint = exact.get(name, own.get(_plain(name)))
        if joint is None and name not in ignored:
            known = _some(list(exact))
            raise InputError(
                f"{where}: joint {name!r} is no joint of {model.name} (joints: {known}; ignored_joints leaves it out)"
            )
        if joint is not None:
            if joint in joints:
                raise InputError(f"{where}: joint {model.names[joint]!r} is there twice")
            columns.append(column)
            joints.append(joint)
    if not joints:
        raise InputError(f"{where}: no joint of {model.name} is there (expected some of {_some(list(exact))})")
    missing = tuple(name for name, joint in exact.items() if joint not in joints)
    return JointMap(tuple(columns), tuple(joints), missing)


def _plain(name: str) -> str:
    """A joint's name without what loggers add: kLeftKnee, left_knee_joint and left_knee.pos are one."""
    name = re.sub(r"^k(?=[A-Z])", "", name)
    name = re.sub(r"(\.(pos|q|position))$", "", name.lower())
    return re.sub(r"[^a-z0-9]", "", re.sub(r"_?joint$", "", name))


def _some(names: list[str]) -> str:
    return ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
