"""Draw a stop and a fall of the whole-body simulation in each scenario.

    python -m bench.tsid_picture [-o notebooks/stop_and_fall.png]

Left half: a push after which TALOS came to rest; right half: one after which its controller had no way left. Each has the
robot at the start (pale) and at the end (dark) with its contacts and their last forces, and the CoM's path from above: the
region in which the CoM can rest on these contacts, the path, and the straight line on which the predictor has it stop, where
it says so. Where prediction and outcome differ the panel is framed and says what was missed. As wide as a printed column.
Needs the extras sim and plots. The samples are those of the campaign with seed 2018.
"""

from __future__ import annotations

import argparse
from functools import reduce
from operator import add
from pathlib import Path
from typing import NamedTuple

import jax
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

import jaxcap
from reference.contacts import wrench_rays
from reference.tsid.controller import CONFIGURATIONS
from reference.tsid.robot import Contact, Robot, Sample, load
from reference.tsid.sampling import draw
from reference.tsid.simulator import Simulator, Trace
from reference.tsid.wrench_cone import corner_points

SEED = 2018
SAMPLES = {"two_coplanar": (61, 122), "two": (1, 56), "three": (5, 19), "four": (124, 185)}
"""A stop and a fall, similar in CoM speed."""
TITLES = {
    "two_coplanar": "two feet on the ground",
    "two": "two feet, anywhere",
    "three": "two feet, one hand",
    "four": "two feet, two hands",
}
BLUE, ORANGE, RED = "#0060a0", "#e69f00", "#8b1a00"  # told apart by colour-blind readers, and in grey
END, START, REGION = "#202020", "#b0b0b0", "#d9e6f2"
AZIMUTH, ELEVATION = np.radians([-55, 14])
"""Direction towards the camera [rad]: in front of the robot's right side, above."""
WIDTH, CELL, SIDE, TITLE, LEGEND = 3.5, 1.3, 0.78, 0.34, 0.62
"""Of the sheet, for a printed column [in]: its width; heights of a robot's picture, of a path's, of what stands above the
robot, and of the legend."""
ACROSS, LOWEST, HIGHEST = 1.46, -0.42, 1.64
"""What is shown of a robot: width, and from below to above the left sole [m]."""
HEAD = np.array([0.0, 0.0, 0.13])
"""Of the head's centre in the last joint of the neck [m]."""
FORCE = 1 / 1800.0
"""Length of a force [m/N]."""
DIRECTIONS = 48
"""In which the region's extent is computed."""
FARTHEST = 0.6
"""Extent at which the region is cut off [m]."""


def seen(points) -> np.ndarray:
    """Parallel projection of points (..., 3) to the picture (..., 2) [m]."""
    (ca, ce), (sa, se) = np.cos([AZIMUTH, ELEVATION]), np.sin([AZIMUTH, ELEVATION])
    return np.asarray(points) @ np.array([[-sa, ca, 0], [-ca * se, -sa * se, ce]]).T


def bones(robot: Robot, q: np.ndarray) -> list[np.ndarray]:
    """Segments (2, 3) [m] from joint to joint and to the effectors; the last one goes from the neck to the head."""
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, q)
    at = [placement.translation.copy() for placement in data.oMi]
    segments = [np.array([at[model.parents[j]], at[j]]) for j in range(2, model.njoints)]
    for effector in robot.effectors.values():
        frame = model.frames[effector.frame]
        tip = (data.oMf[effector.frame] * effector.placement).translation
        segments.append(np.array([at[frame.parentJoint], tip]))
    neck = model.getJointId("head_2_joint")
    return [*segments, np.array([at[neck], data.oMi[neck].act(HEAD)])]


def region(contacts: tuple[Contact, ...], around: np.ndarray) -> np.ndarray:
    """Vertices (m, 2) of where a CoM can stay on the contacts, by a linear program for each direction; cut off far away."""
    points = np.concatenate([corner_points(contact) for contact in contacts])
    frames = np.repeat([contact.placement.rotation for contact in contacts], 4, axis=0)
    rays, origin = wrench_rays(points, frames, np.repeat([contact.friction for contact in contacts], 4))[:2]
    weight = 9.81  # upwards, on a mass of 1
    moment = np.array([[0.0, weight], [-weight, 0.0], [0.0, 0.0]])  # of the weight at (x, y)
    matrix = np.column_stack([rays, np.vstack([np.zeros((3, 2)), -moment])])
    right = np.concatenate([[0.0, 0.0, weight], -moment @ origin[:2]])
    bounds = [(0.0, None)] * rays.shape[1] + [(c - FARTHEST, c + FARTHEST) for c in around[:2]]
    vertices = []
    for angle in np.linspace(0, 2 * np.pi, DIRECTIONS, endpoint=False):
        cost = np.concatenate([np.zeros(rays.shape[1]), [-np.cos(angle), -np.sin(angle)]])
        result = linprog(cost, A_eq=matrix, b_eq=right, bounds=bounds, method="highs")
        if result.status == 0:
            vertices.append(result.x[-2:])
    return np.array(vertices)[ConvexHull(vertices).vertices]


def prediction(sample: Sample, com, com_velocity) -> jaxcap.Capturability:
    """What the predictor says of the start."""
    rectangle = lambda c: jaxcap.rectangle(
        c.placement.translation, c.placement.rotation, c.half_length, c.half_width, c.friction
    )
    return jaxcap.capturability(jaxcap.centroidal_cone(reduce(add, map(rectangle, sample.contacts))), com, com_velocity)


def poses(axes, robot: Robot, sample: Sample, trace: Trace) -> None:
    """The robot at the start and at the end, on the same feet, to scale."""
    start, end = (bones(robot, q) for q in (trace.q[0], trace.q[-1]))
    for contact in sample.contacts:
        axes.fill(*seen(corner_points(contact)).T, facecolor=BLUE, edgecolor=BLUE, linewidth=0.8, zorder=5)
    for number, (segments, color) in enumerate(((start, START), (end, END))):
        outline = [withStroke(linewidth=2.6, foreground="white")]
        style = {"color": color, "linewidth": 1.6, "solid_capstyle": "round", "path_effects": outline, "clip_on": False}
        for segment in segments:
            axes.plot(*seen(segment).T, zorder=2 + number, **style)
        axes.scatter(*seen(segments[-1][1]), s=42, color=color, edgecolor="white", linewidth=0.6, zorder=2 + number)
    last = len(trace.t) - 1  # the state at the end has no command
    wrenches = trace.wrenches[last - 1] if last else ()
    for contact, wrench in zip(sample.contacts, wrenches, strict=False):
        foot = contact.placement.translation
        tip = foot + FORCE * contact.placement.rotation @ wrench[:3]
        arrow = {"arrowstyle": "-|>", "color": RED, "linewidth": 0.9, "mutation_scale": 5, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", seen(tip), seen(foot), arrowprops=arrow, zorder=6)
    axes.plot(*seen(trace.com).T, color=ORANGE, linewidth=1.6, zorder=5, path_effects=[withStroke(linewidth=2.4)])
    axes.scatter(*seen(trace.com[-1]), s=14, marker="s", color=ORANGE, edgecolor="black", linewidth=0.6, zorder=6)
    across = seen(np.concatenate([*start, *end]))[:, 0]
    left = (across.min() + across.max() - ACROSS) / 2
    axes.set(aspect="equal", xlim=(left, left + ACROSS), ylim=(LOWEST, HIGHEST))
    axes.set_axis_off()


def from_above(axes, sample: Sample, trace: Trace, out: jaxcap.Capturability) -> None:
    """Contacts, region of static equilibrium and the CoM's path; a bar of 0.2 m."""
    axes.fill(*region(sample.contacts, trace.com[0]).T, facecolor=REGION, edgecolor=BLUE, linewidth=0.6, zorder=0)
    for contact in sample.contacts:
        axes.fill(*corner_points(contact)[:, :2].T, facecolor="none", edgecolor=END, linewidth=0.8, zorder=1)
    start, velocity = trace.com[0], trace.com_velocity[0]
    axes.plot(*trace.com[:, :2].T, color=ORANGE, linewidth=1.6, zorder=4, path_effects=[withStroke(linewidth=2.4)])
    axes.scatter(*start[:2], s=12, color="white", edgecolor="black", linewidth=0.8, zorder=5)
    axes.scatter(*trace.com[-1, :2], s=14, marker="s", color=ORANGE, edgecolor="black", linewidth=0.6, zorder=6)
    if bool(out.capturable):
        end = start + float(out.distance) * velocity / np.linalg.norm(velocity)
        axes.plot(*end[:2], marker="x", markersize=4.5, color=BLUE, markeredgewidth=1.5, zorder=7)
    shown = np.concatenate([trace.com[:, :2], *(corner_points(contact)[:, :2] for contact in sample.contacts)])
    middle, half = (shown.max(axis=0) + shown.min(axis=0)) / 2, np.ptp(shown, axis=0).max() / 2 + 0.06
    (left, low), (right, high) = middle - half, middle + half
    axes.set(aspect="equal", xlim=(left, right), ylim=(low, high), xticks=[], yticks=[])
    axes.plot([left + 0.03, left + 0.23], [low + 0.04] * 2, color="black", linewidth=1.5, solid_capstyle="butt", zorder=8)


class Cell(NamedTuple):
    """Where one sample is drawn."""

    robot: Axes
    above: Axes


def cells(figure: Figure, row: int) -> list[Cell]:
    """The two cells of a row, the first row being the uppermost."""
    width, height = figure.get_size_inches()
    across = CELL * ACROSS / (HIGHEST - LOWEST)
    bottom = LEGEND + (len(SAMPLES) - 1 - row) * (CELL + TITLE)
    place = lambda left, wide, high: figure.add_axes((left / width, bottom / height, wide / width, high / height))
    lefts = (0.02, 0.02 + WIDTH / 2)
    return [Cell(place(left, across, CELL), place(left + across + 0.02, SIDE, SIDE)) for left in lefts]


def panel(cell: Cell, robot: Robot, scenario: str, index: int) -> None:
    """Simulate one sample and draw it."""
    sample = draw(robot, scenario, SEED, index)
    run = Simulator(robot, CONFIGURATIONS["standard"]).run(sample, trace=True)
    trace = run.trace
    out = prediction(sample, trace.com[0], trace.com_velocity[0])
    poses(cell.robot, robot, sample, trace)
    from_above(cell.above, sample, trace, out)
    stop, stopped = bool(out.capturable), run.reason == "stopped"
    ended = {"stopped": "stopped", "infeasible": "fell"}[run.reason]
    speed = np.linalg.norm(trace.com_velocity[0])
    cell.robot.text(0, 1.01, f"{speed:.2f} m/s, {ended} at {run.time:.1f} s", transform=cell.robot.transAxes, va="bottom")
    said = f"predicted: {'stop' if stop else 'fall'}\n{float(out.margin):+.2f} m/s"
    if stop != stopped:
        said += f"\n{'missed fall' if stop else 'false alarm'}"
        for spine in cell.above.spines.values():
            spine.set(color=RED, linewidth=2.4)
    style = {"color": RED, "fontweight": "bold"} if stop != stopped else {}
    cell.above.text(0.5, 1.06, said, transform=cell.above.transAxes, ha="center", va="bottom", linespacing=1.1, **style)


def legend(figure) -> None:
    """What the signs mean."""
    line = lambda color, label, **style: Line2D([], [], color=color, label=label, linewidth=1.6, **style)
    square = {"marker": "s", "markersize": 3.5, "markeredgecolor": "black", "markeredgewidth": 0.6}
    cross = {"linestyle": "", "marker": "x", "markersize": 4.5, "markeredgewidth": 1.5}
    handles = [
        line(START, "start"),
        line(END, "end"),
        Patch(facecolor=BLUE, edgecolor=BLUE, linewidth=0.8, label="contact"),
        line(RED, f"last force ({0.25 / FORCE:.0f} N: 0.25 m)"),
        line(ORANGE, "path of the CoM to its end", **square, path_effects=[withStroke(linewidth=2.4)]),
        line("black", "0.2 m, seen from above"),
        Patch(facecolor=REGION, edgecolor=BLUE, linewidth=0.6, label="where the CoM can rest"),
        line(BLUE, "predicted stop", **cross),
    ]
    figure.legend(
        handles=handles, loc="lower center", ncols=2, frameon=False, handlelength=1.6, columnspacing=1.0, borderaxespad=0.1
    )


def main(arguments=None) -> None:
    """Parse, simulate, draw."""
    parser = argparse.ArgumentParser(prog="python -m bench.tsid_picture", description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("notebooks/stop_and_fall.png"))
    options = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", True)
    matplotlib.use("Agg")
    robot = load("talos")
    with matplotlib.rc_context({"font.size": 6.5, "axes.linewidth": 0.6}):
        figure = plt.figure(figsize=(WIDTH, LEGEND + len(SAMPLES) * (CELL + TITLE)), dpi=300)
        for row, (scenario, indices) in enumerate(SAMPLES.items()):
            pair = cells(figure, row)
            pair[0].robot.text(
                0, 1.1, TITLES[scenario], transform=pair[0].robot.transAxes, va="bottom", fontsize=7.5, fontweight="bold"
            )
            for cell, index in zip(pair, indices, strict=True):
                panel(cell, robot, scenario, index)
        legend(figure)
        figure.savefig(options.output)


if __name__ == "__main__":
    main()
