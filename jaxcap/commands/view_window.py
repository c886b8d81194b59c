"""The 3-D view in the browser, by viser: what is drawn once, what moves with the row, the slider and the margin over it."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from viser import uplot

from jaxcap.commands.view_row import Scene

GREEN, RED, BLUE, GREY, ORANGE = (40, 150, 60), (190, 40, 20), (0, 96, 160), (110, 110, 110), (230, 140, 0)
MOST = 2000
"""Points of the margin's line: of a longer log every so many rows."""


class Window:
    """A scene in a server.

    Args:
        server: viser's.
        looks: Shapes of the robot (`jaxcap.robots.looks`); where there are none, rods from joint to joint.
    """

    def __init__(self, server: viser.ViserServer, looks: Sequence[Any]):
        self._server, self._rods = server, not looks
        server.scene.set_up_direction("+z")
        server.scene.add_grid("/ground", width=4.0, height=4.0)
        self._links = {
            joint: server.scene.add_frame(f"/robot/{joint}", show_axes=False)
            for joint in sorted({look.joint for look in looks})
        }
        for number, look in enumerate(looks):
            name, vertices = f"/robot/{look.joint}/{number}", look.vertices.astype(np.float32)
            server.scene.add_mesh_simple(
                name, vertices, look.triangles.astype(np.uint32), color=look.color, flat_shading=True
            )

    def draw(self, one: Scene) -> None:
        """Draws a row, in place of the one before."""
        color = {None: BLUE, True: GREEN, False: RED}[one.capturable]
        scene = self._server.scene
        with self._server.atomic():
            for joint, link in self._links.items():
                x, y, z, w = Rotation.from_matrix(one.rotations[joint]).as_quat()
                link.position, link.wxyz = tuple(one.positions[joint]), (w, x, y, z)
            if self._rods:
                scene.add_line_segments("/rods", one.rods, GREY, thickness=0.03)
            for name, lines, shade in (("/pyramids", one.pyramids, BLUE), ("/area", one.area, ORANGE)):
                shown = bool(len(lines))
                lines = lines if shown else np.zeros((1, 2, 3))
                scene.add_line_segments(name, lines, shade, thickness=0.004, visible=shown)
            scene.add_icosphere("/com", 0.04, color, position=tuple(one.arrow[0, 0]))
            scene.add_arrows("/velocity", one.arrow, color)


@dataclasses.dataclass
class Controls:
    """What the reader turns, and reads."""

    slider: Any
    words: Any
    plot: Any | None
    """None where nothing was scored."""


def controls(
    server: viser.ViserServer, rows: int, margin: Float[np.ndarray, " n"] | None, show: Callable[[int], str]
) -> Controls:
    """A slider of rows below the margin over them.

    Args:
        server: viser's.
        rows: How many there are.
        margin: Of each [m/s], or None.
        show: Draws a row, and says what there is to say of it.
    """
    plot = None if margin is None else _plot(server, margin)
    slider = server.gui.add_slider("row", min=0, max=max(1, rows - 1), step=1, initial_value=0)
    words = server.gui.add_markdown(show(0))

    def moved(_event: Any) -> None:
        row = min(int(slider.value), rows - 1)
        words.content = show(row)
        if plot is not None:
            plot.data = (*plot.data[:2], _marked(plot.data[0], plot.data[1], row))

    slider.on_update(moved)
    return Controls(slider, words, plot)


def _plot(server: viser.ViserServer, margin: Float[np.ndarray, " n"]) -> Any:
    """The margin over the rows, and where the slider is."""
    kept = np.arange(0, len(margin), -(-len(margin) // MOST)).astype(float)
    line = np.where(np.isfinite(margin), margin, np.nan)[kept.astype(int)]
    series = (
        uplot.Series(label="row"),
        uplot.Series(label="margin [m/s]", stroke="#0060a0", width=2),
        uplot.Series(label="now", stroke="#be2814", points={"show": True, "size": 9}),
    )
    data = (kept, line, _marked(kept, line, 0))
    return server.gui.add_uplot(data, series, title="margin [m/s]", scales={"x": {"time": False}}, aspect=1.8)


def _marked(rows: np.ndarray, line: np.ndarray, row: int) -> np.ndarray:
    """The margin where the slider is, and nowhere else; zero where there is none to be drawn."""
    at = int(np.abs(rows - row).argmin())
    return np.where(np.arange(len(rows)) == at, np.nan_to_num(line), np.nan)
