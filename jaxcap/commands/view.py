"""`jaxcap view`: a log in 3-D, in the browser. Importing this module needs tyro (extra `cli`), running it also viser."""

import threading
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tyro
from jaxtyping import Float

from jaxcap.errors import InputError, MissingExtra, needs_extra
from jaxcap.files.whole_file import check_output, whole_file

VIEW = """Show states of a log in 3-D, in the browser.

EXAMPLES
  jaxcap states walk.csv --robot g1 -o states.parquet
  jaxcap score states.parquet -o scores.parquet
  jaxcap view scores.parquet --robot g1

STATES is Parquet, what jaxcap states wrote, or jaxcap score of that: then the
CoM is green where the state is capturable and red where it is not, and the
margin is told. A slider chooses the row.

SHOWN
  The robot as rods from joint to joint, its contacts with the pyramids of
  friction, the CoM with its velocity (an arrow as long as it moves in 0.3 s).

EXIT CODES
  0 done; 2 bad input, and one line says which; 130 interrupted.
"""
"""What `jaxcap view --help` says above the list of options; its first line also stands in `jaxcap --help`."""

PYRAMID = 0.12
"""Height of the pyramids of friction that are drawn [m]."""
AHEAD = 0.3
"""The arrow is the way of this time [s]."""
GREEN, RED, BLUE, GREY = (40, 150, 60), (190, 40, 20), (0, 96, 160), (110, 110, 110)


class Scene(NamedTuple):
    """What is drawn of one row."""

    rods: Float[np.ndarray, "b 2 3"]
    """From each joint to the one that carries it [m]."""
    pyramids: Float[np.ndarray, "e 2 3"]
    """Edges of the pyramids of the contacts that touch [m]."""
    arrow: Float[np.ndarray, "1 2 3"]
    """The CoM, and where it is soon [m]."""
    capturable: bool | None
    """None where it was not scored."""
    words: str


def view(
    states: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATES")],
    *,
    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT")],
    port: int = 8080,
    save: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    force: bool = False,
) -> None:
    """Shows a log; see VIEW.

    Raises InputError and MissingExtra.

    Args:
        states: Parquet file of states or scores.
        robot: Name of the robot, or its URDF or MJCF file.
        port: Where the browser finds it, on this machine alone.
        save: Write the first row as a scene of viser (.viser) and end.
        force: Overwrite FILE if it exists.
    """
    if save is not None:
        check_output(save, force=force, extensions=(".viser",), inputs=(states,))
    with needs_extra("view", "the 3-D view"):
        import viser
    columns = read_columns(states)
    try:
        from jaxcap.robots import load
    except ImportError as error:
        raise MissingExtra(str(error)) from error
    model = load(robot).model
    if columns["configuration"].shape[1:] != (model.nq,):
        shape = columns["configuration"].shape[1:]
        raise InputError(f"{states}: 'configuration' has rows of shape {shape} (expected ({model.nq},), {robot}'s)")
    server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    try:
        recorder = server.get_scene_serializer() if save is not None else None
        server.scene.set_up_direction("+z")
        server.scene.add_grid("/ground", width=4.0, height=4.0)
        draw(server, scene(model, columns, 0))
        if save is not None and recorder is not None:
            with whole_file(save, force=force) as handle:
                handle.write(recorder.serialize())
            return
        _slider(server, model, columns)
        print(f"http://localhost:{port}   (Ctrl-C ends)", flush=True)
        threading.Event().wait()
    finally:
        server.stop()


def _slider(server: Any, model: Any, columns: dict[str, np.ndarray]) -> None:
    """The row that is shown, and what there is to say about it."""
    slider = server.gui.add_slider("row", min=0, max=max(1, len(columns["com"]) - 1), step=1, initial_value=0)
    words = server.gui.add_markdown(scene(model, columns, 0).words)

    def show(_event: Any) -> None:
        one = scene(model, columns, min(int(slider.value), len(columns["com"]) - 1))
        draw(server, one)
        words.content = one.words

    slider.on_update(show)


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """The columns that are drawn. Raises InputError if the file or one of them is not there."""
    with needs_extra("view", "reading states"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    needed = ["com", "com_velocity", "contact_points", "contact_frames", "contact_friction", "contact_mask", "configuration"]
    try:
        names = pq.read_schema(path).names
        missing = next((name for name in needed if name not in names), None)
        if missing is not None:
            raise InputError(f"{path}: no column {missing!r} (expected what jaxcap states wrote, or jaxcap score of that)")
        table = pq.read_table(path, columns=[*needed, *(one for one in ("t", "margin", "capturable") if one in names)])
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read as Parquet: {error}") from error
    if not table.num_rows:
        raise InputError(f"{path}: no rows")
    return {name: np.array(table[name].to_pylist()) for name in table.column_names}


def scene(model: Any, columns: dict[str, np.ndarray], row: int) -> Scene:
    """What is drawn of a row.

    Args:
        model: Pinocchio's.
        columns: From `read_columns`.
        row: Its number.
    """
    from jaxcap.robots.tree import links

    q = columns["configuration"][row : row + 1]
    found = links(model, q, np.zeros((1, model.nv)))
    rods = [(found[model.parents[i]].position[:, 0], found[i].position[:, 0]) for i in range(2, model.njoints)]
    com, velocity = columns["com"][row], columns["com_velocity"][row]
    capturable = bool(columns["capturable"][row]) if "capturable" in columns else None
    words = f"{columns['t'][row]:.2f} s" if "t" in columns else f"row {row}"
    if "margin" in columns:
        words += f", margin {columns['margin'][row]:+.2f} m/s"
    return Scene(np.array(rods), _pyramids(columns, row), np.array([[com, com + AHEAD * velocity]]), capturable, words)


def _pyramids(columns: dict[str, np.ndarray], row: int) -> Float[np.ndarray, "e 2 3"]:
    """Four edges of each contact that touches, along the corners of its cone."""
    touching = columns["contact_mask"][row].astype(bool)
    points, frames = columns["contact_points"][row][touching], columns["contact_frames"][row][touching]
    slope = columns["contact_friction"][row][touching] / np.sqrt(2)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    local = np.concatenate([corners * slope[:, None, None], np.ones((len(points), 4, 1))], axis=2) * PYRAMID
    ends = points[:, None] + np.einsum("kij,kcj->kci", frames, local)
    return np.stack([np.broadcast_to(points[:, None], ends.shape), ends], axis=2).reshape(-1, 2, 3)


def draw(server: Any, one: Scene) -> None:
    """Draws a row, in place of the one before."""
    color = {None: BLUE, True: GREEN, False: RED}[one.capturable]
    with server.atomic():
        server.scene.add_line_segments("/robot", one.rods, GREY, thickness=0.03)
        server.scene.add_line_segments("/pyramids", one.pyramids, BLUE, thickness=0.004, visible=bool(len(one.pyramids)))
        server.scene.add_icosphere("/com", 0.04, color, position=one.arrow[0, 0])
        server.scene.add_arrows("/velocity", one.arrow, color)
