"""`jaxcap view`: a log in 3-D, in the browser. Importing this module needs tyro (extra `cli`), running it also viser."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from jaxcap.commands.states import load_robot
from jaxcap.commands.view_row import scene
from jaxcap.errors import InputError, needs_extra
from jaxcap.files.whole_file import check_output, whole_file

VIEW = """Show states of a log in 3-D, in the browser.

EXAMPLES
  jaxcap states walk.csv --robot g1 -o states.parquet
  jaxcap score states.parquet -o scores.parquet
  jaxcap view scores.parquet --robot g1

STATES
  Parquet, what jaxcap states wrote, or jaxcap score of that: then the CoM is
  green where the state is capturable and red where it is not, and the margin
  is told. A slider chooses the row.

SHOWN
  The robot by its visual meshes, where they are there (else, or with --rods,
  as rods from joint to joint), its contacts with the pyramids of friction, the
  CoM with its velocity (an arrow as long as it moves in 0.3 s), and around it
  the outline of all level velocities that can be stopped: inside it a level
  arrow is capturable. The margin over the rows, and where the slider is.

EXIT CODES
  0 done; 2 bad input, and one line says which; 130 interrupted.
"""
"""What `jaxcap view --help` says above the list of options; its first line also stands in `jaxcap --help`."""


def view(
    states: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATES")],
    *,
    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT")],
    rods: bool = False,
    no_area: bool = False,
    port: int = 8080,
    save: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    force: bool = False,
) -> None:
    """Shows a log; see VIEW.

    Raises InputError and MissingExtra.

    Args:
        states: Parquet file of states or scores.
        robot: Name of the robot, or its URDF or MJCF file.
        rods: The robot as rods from joint to joint, not by its meshes.
        no_area: Without the velocity area, which takes a moment a row.
        port: Where the browser finds it, on this machine alone.
        save: Write the rows as a film of viser (.viser) and end.
        force: Overwrite FILE if it exists.
    """
    if save is not None:
        check_output(save, force=force, extensions=(".viser",), inputs=(states,))
    with needs_extra("view", "the 3-D view"):
        import viser

        from jaxcap.commands.view_window import Window, controls
    columns = read_columns(states)
    model = load_robot(robot, "view").model
    if columns["configuration"].shape[1:] != (model.nq,):
        shape = columns["configuration"].shape[1:]
        raise InputError(f"{states}: 'configuration' has rows of shape {shape} (expected ({model.nq},), {robot}'s)")
    from jaxcap.robots import looks

    server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    try:
        recorder = server.get_scene_serializer() if save is not None else None
        window = Window(server, () if rods else looks(robot, model))

        def show(row: int) -> str:
            one = scene(model, columns, row, not no_area)
            window.draw(one)
            return one.words

        if save is not None and recorder is not None:
            _play(recorder, columns.get("t"), len(columns["com"]), show)
            with whole_file(save, force=force) as handle:
                handle.write(recorder.serialize())
            return
        controls(server, len(columns["com"]), columns.get("margin"), show)
        print(f"http://localhost:{port}   (Ctrl-C ends)", flush=True)
        threading.Event().wait()
    finally:
        server.stop()


def _play(recorder: Any, times: np.ndarray | None, rows: int, show: Callable[[int], str]) -> None:
    """Draws all rows, one after the other, at their times; where the next episode begins, time goes on."""
    for row in range(rows):
        show(row)
        if times is not None and row + 1 < rows:
            recorder.insert_sleep(max(0.0, float(times[row + 1] - times[row])))


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
