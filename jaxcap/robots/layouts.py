"""Layouts: which field of a log is what, as data.

A layout is a YAML file. Those of public recorders are in `known_layouts/`, one file each, and an own one is written in
the same ten lines. What a layout does not say is asked for, never guessed: the order of a quaternion, the frame of a
velocity, the order of joints without names.
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

from jaxcap.errors import InputError, needs_extra

KNOWN = Path(__file__).parent / "known_layouts"
"""A file for each layout."""

FORMATS = ("npz", "csv", "parquet", "hdf5", "json", "pickle", "mcap", "lerobot")
QUATERNIONS = ("xyzw", "wxyz")
FRAMES = ("world", "base")
ORDERS = ("depth first", "breadth first")
LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Units of lengths [m]."""

Where = str | tuple[str, ...]
"""A field of the log: `name`, `name[0:3]` (columns), `name[2]` (one entry of the second axis), `name[x, y]` (columns by
name); or several, side by side."""


@dataclass(frozen=True)
class Layout:
    """What the fields of a log are."""

    name: str
    format: str
    """One of `FORMATS`."""
    base_position: Where
    """Of the robot's root link, in the world."""
    base_orientation: Where
    joint_positions: Where
    """All of them; `{joint}` stands for the name of each joint of the robot."""
    about: str = ""
    has: tuple[str, ...] = ()
    """Fields by which such a log is recognised; none: it has to be asked for."""
    attributes: Mapping[str, tuple[Any, ...]] | None = None
    """Values of attributes by which it is recognised; None among them: it is not there."""
    columns: int | None = None
    """How many a table without a header has."""
    header: bool = True
    """Whether a CSV file begins with names of columns; else its numbers are the field `table`."""
    episodes: str | None = None
    """The groups that are episodes, `data/demo_*`; or a column that numbers them. By default the file is one."""
    time: Where | None = None
    """[s]; or rate, or step."""
    rate: float | str | None = None
    """Rows a second: a number, or a field."""
    step: float | str | None = None
    """[s]: a number, or a field."""
    quaternion: str | None = None
    """One of `QUATERNIONS`."""
    euler: str | None = None
    """In place of a quaternion, as SciPy spells them: `xyz` about fixed axes, `XYZ` about turned ones."""
    base_linear_velocity: Where | None = None
    linear_velocity_frame: str | None = None
    """One of `FRAMES`: which axes the numbers are along."""
    base_angular_velocity: Where | None = None
    angular_velocity_frame: str | None = None
    joint_velocities: Where | None = None
    joint_names: Where | tuple[str, ...] | None = None
    """A list of names, or the field that holds them."""
    joint_order: str | None = None
    """One of `ORDERS`, where there are no names: the robot's own, parents before children."""
    ignored_joints: tuple[str, ...] = ()
    """Joints of the log that the robot model does not have and does not need, such as fingers."""
    contacts: Mapping[str, Where] | None = None
    """By the name of a patch, the field that says whether it is in contact."""
    angles: str = "rad"
    """rad or deg: of joints and Euler angles, and their velocities."""
    lengths: str = "m"
    """One of `LENGTHS`: of the base, and its velocity."""
    up: str = "z"
    """z or y."""

    def conventions(self) -> dict[str, Any]:
        """What was read as what, for the metadata of the output."""
        said = {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if field.name not in ("about", "has", "attributes")
        }
        return {name: value for name, value in said.items() if value is not None and value != ()}


def known_layouts() -> dict[str, Layout]:
    """The layouts of public recorders, by name."""
    return {path.stem: read_layout(path) for path in sorted(KNOWN.glob("*.yaml"))}


def layout_of(name_or_path: str | os.PathLike) -> Layout:
    """A layout by its name, or from a YAML file. Raises InputError naming what is wrong with it."""
    text = os.fspath(name_or_path)
    if text.endswith((".yaml", ".yml")):
        return read_layout(Path(text))
    if not (KNOWN / f"{text}.yaml").is_file():
        names = ", ".join(path.stem for path in sorted(KNOWN.glob("*.yaml")))
        raise InputError(f"layout {text!r} is unknown (expected {names}, or a .yaml file)")
    return read_layout(KNOWN / f"{text}.yaml")


def read_layout(path: Path) -> Layout:
    """A layout from its file. Raises InputError naming file, field, expectation and value."""
    with needs_extra("logs", "reading a layout"):
        import yaml
    try:
        said = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise InputError(f"{path}: cannot be read as YAML: {' '.join(str(error).split())}") from error
    if not isinstance(said, dict):
        raise InputError(f"{path}: no layout (expected fields such as 'format' and 'base_position')")
    given = {name: _tuples(value) for name, value in said.items()} | {"name": path.stem}
    names = {field.name: field for field in fields(Layout)}
    unknown = [name for name in given if name not in names]
    if unknown:
        raise InputError(f"{path}: unknown field {unknown[0]!r} (expected some of {', '.join(names)})")
    missing = [name for name, field in names.items() if field.default is MISSING and name not in given]
    if missing:
        raise InputError(f"{path}: no field {missing[0]!r}")
    layout = Layout(**given)
    _check(path, layout)
    return layout


def _tuples(value: Any) -> Any:
    """Lists of YAML as tuples: a layout does not change."""
    if isinstance(value, dict):
        return {name: _tuples(inner) for name, inner in value.items()}
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _check(path: Path, layout: Layout) -> None:
    """Raises InputError for a word that is none of those that may stand there, and for what has to be said and is not."""
    choices: dict[str, Iterable[Any]] = {
        "format": FORMATS,
        "quaternion": (*QUATERNIONS, None),
        "linear_velocity_frame": (*FRAMES, None),
        "angular_velocity_frame": (*FRAMES, None),
        "joint_order": (*ORDERS, None),
        "angles": ("rad", "deg"),
        "lengths": tuple(LENGTHS),
        "up": ("z", "y"),
    }
    for name, allowed in choices.items():
        value = getattr(layout, name)
        if value not in allowed:
            raise InputError(f"{path}: {name} = {value!r} (expected {' or '.join(str(word) for word in allowed if word)})")
    if (layout.quaternion is None) == (layout.euler is None):
        raise InputError(f"{path}: base_orientation needs one of 'quaternion' ({' or '.join(QUATERNIONS)}) and 'euler'")
    if sum(way is not None for way in (layout.time, layout.rate, layout.step)) != 1:
        raise InputError(f"{path}: expected one of 'time', 'rate' and 'step'")
    for velocity, frame in (
        ("base_linear_velocity", "linear_velocity_frame"),
        ("base_angular_velocity", "angular_velocity_frame"),
    ):
        if getattr(layout, velocity) is not None and getattr(layout, frame) is None:
            raise InputError(f"{path}: {velocity} needs {frame!r} ({' or '.join(FRAMES)})")
    template = isinstance(layout.joint_positions, str) and "{joint}" in layout.joint_positions
    if sum((template, layout.joint_names is not None, layout.joint_order is not None)) != 1:
        raise InputError(
            f"{path}: the joints have no names (expected one of 'joint_names', a list or a field, 'joint_order', "
            f"{' or '.join(ORDERS)}, and joint_positions with '{{joint}}')"
        )
