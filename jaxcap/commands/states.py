"""`jaxcap states`: a robot's log to rows that `jaxcap score` takes. Importing this module needs tyro and tqdm (extra
`cli`).
"""

import dataclasses
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
import tyro
from tqdm import tqdm

from jaxcap.errors import InputError, MissingExtra
from jaxcap.files.records import write_scores
from jaxcap.files.whole_file import check_output
from jaxcap.version import __version__

if TYPE_CHECKING:
    from jaxcap.robots import Log, Robot

STATES = """Turn a robot's log into states that jaxcap score takes.

EXAMPLES
  jaxcap states walk.csv --robot g1 -o states.parquet
  jaxcap states demos.hdf5 --robot my.urdf --feet feet.yaml -o states.parquet
  jaxcap states log.npz --robot anymal --layout mine.yaml -o states.parquet
  jaxcap states --robot g1 --print-feet            # where it can touch, as YAML

LOG
  A file or a folder: NPZ, CSV, Parquet, HDF5, JSON, pickles (never executed:
  arrays and plain containers alone), ROS 2 bags in MCAP, LeRobot datasets. It
  needs the pose of the base and the positions of the joints.

ROBOT
  A name (talos, g1, romeo, anymal, solo, go1, go2), or a URDF or MJCF file.

LAYOUT
  Which field is what, in which convention. Those of public recorders have
  names, and are recognised by their fields where these leave no doubt:
  lafan1_g1, asap, gmr, beyondmimic, beyondmimic_xyzw, mjlab, isaac_amp,
  isaac_lab, isaac_lab_2, mujoco, tienkung, ros2, lerobot, named_columns,
  named_parquet. An own one is a YAML file:
    format: npz                 # npz csv parquet hdf5 json pickle mcap lerobot
    time: t                     # [s]; or rate: 50, or step: 0.02
    base_position: root_pos     # or root[0:3], or [x, y, z]
    base_orientation: root_rot
    quaternion: xyzw            # or wxyz, or euler: xyz
    joint_positions: dof_pos
    joint_names: [hip, knee]    # or a field, or joint_order: depth first
    base_linear_velocity: root_vel     # optional, with its frame, as is
    linear_velocity_frame: world       # base_angular_velocity; or base
    joint_velocities: dof_vel          # optional
    contacts: {left_foot: touch[0]}    # optional: flags by patch
    angles: rad                 # or deg
    lengths: m                  # or cm, mm
    up: z                       # or y
  What is not said is asked for, not guessed.

FEET
  YAML, as --print-feet prints it: patches (or points, or balls) of the robot's
  links. By default they are known, or found from the collision shapes.

CONTACTS
  By flags, if they are logged. Else a patch touches when its lowest point is
  low and slow, with hysteresis and a dwell. The ground is level, where the
  soles of each episode stand, or where --ground says: a height [m], or YAML
  with planes or heights.

VELOCITIES
  As logged; what is not is made by central differences on the Lie group,
  one-sided at the ends of an episode. --smooth N filters these over N rows
  (Savitzky-Golay).

NOTES AND ERRORS
  Looked at are unit quaternions, joint limits, the base upright, soles on the
  ground, flat, at rest and below the CoM, velocities against differences,
  jumps and time steps. What is wrong beyond doubt costs the episode, the
  others are not affected; what is doubtful is a line on stderr and in the
  metadata. With --strict both are errors, and nothing is written.

OUT
  Parquet or NPZ. For each row t (its time), episode, row, com, com_velocity,
  angular_momentum, contact_points, contact_frames, contact_friction,
  contact_mask, and the configuration in Pinocchio's convention. Its metadata
  hold what was read as what. It is written whole or not at all.

EXIT CODES
  0 done; 2 bad input, and one line says which; 130 interrupted.
"""
"""What `jaxcap states --help` says above the list of options; its first line also stands in `jaxcap --help`."""

UNITS = {"t": "s", "com": "m", "com_velocity": "m/s", "angular_momentum": "kg m^2/s", "contact_points": "m"}


@dataclasses.dataclass(frozen=True)
class LogOptions:
    """How a log is read."""

    layout: Annotated[str | None, tyro.conf.arg(metavar="LAYOUT")] = None
    """Name or YAML file of the layout; by default recognised."""
    feet: Annotated[Path | None, tyro.conf.arg(metavar="FEET")] = None
    """YAML file of where the robot can touch."""
    friction: float = 0.5
    """Coefficient of all contacts."""
    ground: Annotated[str | None, tyro.conf.arg(metavar="Z")] = None
    """Height of the ground [m], or its YAML file; by default where the soles stand."""
    velocities: Literal["logged", "differences"] = "logged"
    """Velocities as logged where they are, or differences of everything."""
    smooth: int = 0
    """Rows of the filter on differences; 0 is none."""


def states(
    log: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")] = None,
    *,
    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT")],
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="OUT")] = None,
    options: tyro.conf.OmitArgPrefixes[LogOptions] = LogOptions(),
    print_feet: bool = False,
    strict: bool = False,
    force: bool = False,
) -> None:
    """Reads a log and writes its states; see STATES.

    Raises InputError and MissingExtra.

    Args:
        log: The log, a file or a folder.
        robot: Name of the robot, or its URDF or MJCF file.
        output: File to write, .parquet or .npz.
        options: How the log is read.
        print_feet: Print where the robot can touch, as YAML, and do nothing else.
        strict: What is doubtful is an error, not a note.
        force: Overwrite OUT if it exists.
    """
    if print_feet:
        patches = load_robot(robot, "logs", options.feet).patches
        from jaxcap.robots import patches_yaml

        print(patches_yaml(patches), end="")
        return
    if log is None or output is None:
        raise InputError(f"{'LOG' if log is None else '--output'} is missing (expected a log and --output)")
    check_output(output, force=force, inputs=(log,) if log.is_file() else ())
    opened = open_log(log, robot, options, strict)
    rows = write_states(opened, output, force=force)
    for note in opened.notes:
        print(f"note: {note}", file=sys.stderr)
    episodes = "1 episode" if opened.episodes == 1 else f"{opened.episodes} episodes"
    print(f"{rows} rows of {episodes}, layout {opened.layout.name}: {output}")


def open_log(log: Path, robot: str, options: LogOptions, strict: bool) -> "Log":
    """A log with its robot. Raises InputError for an option, a file or a layout that cannot be used."""
    known = load_robot(robot, "logs", options.feet)
    from jaxcap.robots import Log, Options, layout_of, read_ground

    if not 0 < options.friction < np.inf:
        raise InputError(f"--friction {options.friction} (expected a positive number)")
    if options.smooth < 0 or (options.smooth and not options.smooth % 2):
        raise InputError(f"--smooth {options.smooth} (expected an odd number of rows, or 0)")
    layout = None if options.layout is None else layout_of(options.layout)
    ground = None if options.ground is None else read_ground(options.ground)
    said = Options(options.friction, ground, options.velocities, options.smooth, strict=strict)
    return Log(log, known, layout, said)


def load_robot(name: str, extra: str, feet: Path | None = None) -> "Robot":
    """A robot. extra: that which has all that the command needs, Pinocchio too. Raises InputError and MissingExtra."""
    try:
        from jaxcap.robots import load
    except ImportError as error:
        raise MissingExtra(f'robots need Pinocchio; install it with: pip install "jaxcap[{extra}]"') from error
    return load(name, feet)


class StatesOfLog(NamedTuple):
    """What is scored."""

    file: Path
    """Of states."""
    robot: "Robot | None" = None
    """Whose log they are from."""


@contextmanager
def states_of_log(log: Path, robot: str | None, options: LogOptions, output: Path, strict: bool) -> Iterator[StatesOfLog]:
    """The states of a log in a file that is gone when the block ends; without a robot the log is such a file itself.

    Args:
        log: The log, or a file of states.
        robot: Whose log it is.
        options: How it is read.
        output: What is written in the block: the file lies beside it.
        strict: What is doubtful is an error.
    """
    if robot is None:
        check_plain(options)
        yield StatesOfLog(log)
        return
    opened = open_log(log, robot, options, strict)
    with tempfile.TemporaryDirectory(dir=output.resolve().parent, prefix=".jaxcap-") as folder:
        file = Path(folder) / "states.parquet"
        write_states(opened, file, force=False)
        for note in opened.notes:
            print(f"note: {note}", file=sys.stderr)
        yield StatesOfLog(file, opened.robot)


def check_plain(options: LogOptions) -> None:
    """Raises InputError if an option says how a log is read, where states are none."""
    given = [field.name for field in dataclasses.fields(options) if getattr(options, field.name) != field.default]
    if given:
        raise InputError(f"--{given[0]} says how a log is read (expected with --robot)")


def said_of_log(about: Mapping[bytes, bytes]) -> dict[str, Any]:
    """What `jaxcap states` wrote into a file's metadata of how the log was read, and what it noted: for what is made of it.

    Args:
        about: The metadata of a Parquet file; of any other kind, or of other states, nothing is said.
    """
    try:
        said = json.loads(about.get(b"jaxcap", b"{}"))
        return {"read": {"notes": said.get("notes", [])} | said["read"]} if said.get("read") else {}
    except (ValueError, AttributeError, TypeError):
        return {}  # not ours


def write_states(log: "Log", output: Path, *, force: bool) -> int:
    """Writes the states of a log, whole or not at all. Returns the number of rows."""
    model = log.robot.model
    k = sum(len(patch.points) for patch in log.robot.patches.values())
    number = np.dtype(np.float64)
    types: dict[str, Any] = {"t": number, "episode": np.dtype("U1"), "row": np.dtype(np.int64)}
    types |= dict.fromkeys(("com", "com_velocity", "angular_momentum"), np.dtype((number, (3,))))
    types |= {"contact_points": np.dtype((number, (k, 3))), "contact_frames": np.dtype((number, (k, 3, 3)))}
    types |= {"contact_friction": np.dtype((number, (k,))), "contact_mask": np.dtype((bool, (k,)))}
    types |= {"configuration": np.dtype((number, (model.nq,)))}
    metadata = {
        "written_by": f"jaxcap {__version__}",
        "conventions": "one inertial frame for all positions and velocities, z up, SI units; "
        "frames: columns are tangent, tangent, normal pointing at the robot",
        "units": UNITS,
        "meanings": {},
        "read": log.about(),
    }
    rows = 0
    with (
        write_scores(output, types, metadata, fields=(), force=force) as sink,
        tqdm(unit=" rows", unit_scale=True, disable=None) as bar,
    ):
        for piece in log:
            sink.write(piece._asdict())
            rows += len(piece.t)
            bar.update(len(piece.t))
        sink.remark(log.notes)
    return rows
