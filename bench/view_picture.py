"""The README's picture of `jaxcap view`: the same scene, drawn by Matplotlib, for a picture in a file needs no browser.

    python -m bench.view_picture [-o notebooks/view.png]

G1 steps in place: its meshes, contacts with their pyramids of friction, the CoM with its velocity,
and the outline of the level velocities that can be stopped, as `jaxcap view` shows them; below, the margin over time.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

import jaxcap
from bench.robot_motion import motion
from jaxcap import robots
from jaxcap.commands.view_row import AHEAD, Scene, scene

LIGHT = np.array([0.4, -0.5, 0.77])
"""Where it comes from."""
AT = 1.62
"""The row that is drawn [s]."""


def triangles(one: Scene, meshes: tuple[robots.Look, ...]) -> tuple[np.ndarray, np.ndarray]:
    """All triangles (t, 3, 3) [m] in the world, and their colours, darker where they turn from the light."""
    corners, colors = [], []
    for look in meshes:
        placed = look.vertices @ one.rotations[look.joint].T + one.positions[look.joint]
        three = placed[look.triangles]
        normal = np.cross(three[:, 1] - three[:, 0], three[:, 2] - three[:, 0])
        length = np.linalg.norm(normal, axis=1)
        three, normal = three[length > 0], normal[length > 0] / length[length > 0, None]
        shade = 0.55 + 0.45 * np.abs(normal @ LIGHT)
        corners.append(three)
        colors.append(np.clip((0.25 + 0.75 * np.array(look.color) / 255) * shade[:, None], 0, 1))
    return np.concatenate(corners), np.concatenate(colors)


def draw(axes, one: Scene, meshes: tuple[robots.Look, ...]) -> None:
    """The scene, from the side."""
    corners, colors = triangles(one, meshes)
    axes.add_collection3d(Poly3DCollection(corners, facecolors=colors, linewidths=0))
    color = "#28963c" if one.capturable else "#be2814"
    axes.add_collection3d(Line3DCollection(one.pyramids, colors="#0060a0", linewidths=1.2))
    axes.add_collection3d(Line3DCollection(one.area, colors="#e68c00", linewidths=2.2, zorder=1e6))
    start, end = one.arrow[0]
    axes.plot(*np.stack([start, end], axis=1), color=color, linewidth=3, zorder=1e7)
    axes.plot(*start[:, None], "o", color=color, markersize=9, zorder=1e7)
    middle = one.positions[1]
    axes.set(xlim=middle[0] + np.array([-0.4, 0.4]), ylim=middle[1] + np.array([-0.4, 0.4]), zlim=(0, 1.35))
    axes.set_box_aspect((0.8, 0.8, 1.35), zoom=1.2)
    axes.view_init(elev=18, azim=-38)
    axes.set_axis_off()


def main(arguments: list[str] | None = None) -> None:
    """Draws the picture."""
    parser = argparse.ArgumentParser(description="Draw the picture of jaxcap view.")
    parser.add_argument("-o", "--output", type=Path, default=Path("notebooks/view.png"))
    output = parser.parse_args(arguments).output
    robot, one = robots.load("g1"), motion("g1", seconds=6.0)
    states = robots.states_of(robot, one.time, one.q, one.v)
    scores = jaxcap.score(jaxcap.cone_rays(states.contacts), states.com, states.com_velocity)
    columns = states._asdict() | {name: np.asarray(getattr(scores, name)) for name in ("capturable", "margin")}
    row = int(np.abs(one.time - AT).argmin())
    drawn = scene(robot.model, columns, row, area=True)
    figure = Figure(figsize=(7.0, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 1, height_ratios=(4.2, 1))
    draw(figure.add_subplot(grid[0], projection="3d", computed_zorder=False), drawn, robots.looks("g1", robot.model))
    below = figure.add_subplot(grid[1])
    below.plot(one.time, columns["margin"], color="#0060a0")
    below.plot(one.time[row], columns["margin"][row], "o", color="#be2814")
    below.axhline(0, color="0.6", linewidth=0.8)
    below.set(xlabel="time [s]", ylabel="margin [m/s]", xlim=(one.time[0], one.time[-1]))
    figure.suptitle(f"G1 at {drawn.words}; velocities as the way of {AHEAD:g} s", fontsize=10)
    figure.savefig(output, dpi=110)
    print(output)


if __name__ == "__main__":
    main()
