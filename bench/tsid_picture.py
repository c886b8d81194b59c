"""Draw a stop and a fall of the whole-body simulation in each scenario.

    python -m bench.tsid_picture [-o notebooks/stop_and_fall.png]

Left half: a push after which TALOS came to rest; right half: one after which its controller had no way left. Each has a
filmstrip (start, middle, end; contacts, friction pyramids at the corners, forces of the contacts) and the CoM's path from
above: the region in which the CoM can rest on these contacts, the path, and the straight line on which the predictor has it
stop, where it says so. Needs the extras sim and plots. The samples are those of the campaign with seed 2018.
"""

from __future__ import annotations

import argparse
from functools import reduce
from operator import add
from pathlib import Path

import jax
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
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
NEAR, FAR, REGION = "#303030", "#909090", "#d9e6f2"
AZIMUTH, ELEVATION = np.radians([-55, 14])
"""Direction towards the camera [rad]: in front of the robot's right side, above."""
SPACING = 1.15
"""Between the frames of a strip [m]."""
LEFT, RIGHT, LOWEST, HIGHEST = 0.7, 1.05, -0.45, 1.8
"""What a strip shows to the left of its first feet, to the right of its last, below and above the left ones [m]."""
PYRAMID = 0.09
"""Height of the friction pyramids [m]."""
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


def bones(robot: Robot, q: np.ndarray) -> list[tuple[np.ndarray, bool]]:
    """Segments (2, 3) [m] from joint to joint and to the effectors, and whether they are of the far side."""
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, q)
    at = [placement.translation.copy() for placement in data.oMi]
    far = lambda joint: "left" in model.names[joint]
    segments = [(np.array([at[model.parents[j]], at[j]]), far(j)) for j in range(2, model.njoints)]
    for effector in robot.effectors.values():
        frame = model.frames[effector.frame]
        tip = (data.oMf[effector.frame] * effector.placement).translation
        segments.append((np.array([at[frame.parentJoint], tip]), far(frame.parentJoint)))
    return sorted(segments, key=lambda segment: not segment[1])


def pyramids(contact: Contact) -> list[np.ndarray]:
    """Triangles (3, 3) [m] of the friction pyramids at a contact's corners."""
    slope = contact.friction / np.sqrt(2.0)
    edges = np.array([[x * slope, y * slope, 1.0] for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))]) * PYRAMID
    edges = edges @ contact.placement.rotation.T
    return [
        np.array([corner, corner + edges[i], corner + edges[(i + 1) % 4]])
        for corner in corner_points(contact)
        for i in range(4)
    ]


def region(contacts: tuple[Contact, ...], around: np.ndarray) -> np.ndarray:
    """Vertices (m, 2) of where a CoM can stay on the contacts, by a linear program for each direction; cut off far away."""
    points = np.concatenate([corner_points(contact) for contact in contacts])
    frames = np.repeat([contact.placement.rotation for contact in contacts], 4, axis=0)
    rays, origin = wrench_rays(points, frames, np.repeat([contact.friction for contact in contacts], 4))
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


def strip(axes, robot: Robot, sample: Sample, trace: Trace) -> None:
    """The robot at three times, side by side, to scale."""
    right = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
    middle = seen([contact.placement.translation for contact in sample.contacts[:2]])[:, 0].mean()
    last = len(trace.t) - 1
    for place, step in enumerate((0, last // 2, last)):
        shift = (place * SPACING - middle) * right
        for contact in sample.contacts:
            axes.fill(*seen(corner_points(contact) + shift).T, facecolor=BLUE, edgecolor="black", linewidth=0.8, zorder=1)
            for triangle in pyramids(contact):
                axes.fill(*seen(triangle + shift).T, facecolor=ORANGE, edgecolor=ORANGE, alpha=0.3, linewidth=0.4, zorder=2)
        outline = [withStroke(linewidth=6.5, foreground="white")]
        for segment, far in bones(robot, trace.q[step]):
            style = {"color": FAR if far else NEAR, "linewidth": 4.5, "solid_capstyle": "round", "path_effects": outline}
            axes.plot(*seen(segment + shift).T, zorder=3 if far else 4, **style)
        wrenches = trace.wrenches[min(step, last - 1)]  # at the end there is no command
        for contact, wrench in zip(sample.contacts, wrenches, strict=True):
            foot = contact.placement.translation
            tip = foot + FORCE * contact.placement.rotation @ wrench[:3]
            arrow = {"arrowstyle": "-|>", "color": RED, "linewidth": 2, "mutation_scale": 13, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", seen(tip + shift), seen(foot + shift), arrowprops=arrow, zorder=6)
        axes.plot(*seen(trace.com[: step + 1] + shift).T, color=BLUE, linewidth=2.5, zorder=5)
        axes.scatter(*seen(trace.com[step] + shift), s=45, color="white", edgecolor=BLUE, linewidth=2, zorder=6)
        data = robot.model.createData()
        pin.forwardKinematics(robot.model, data, trace.q[step])
        head = data.oMi[robot.model.getJointId("head_2_joint")].act(HEAD) + shift
        axes.scatter(*seen(head), s=330, color=NEAR, edgecolor="white", linewidth=1.5, zorder=4)
        axes.text(place * SPACING, LOWEST + 0.02, f"{trace.t[step]:.2f} s", ha="center", va="bottom")
    axes.plot([-LEFT, -LEFT + 0.5], [LOWEST + 0.3] * 2, color="black", linewidth=2)
    axes.text(-LEFT + 0.25, LOWEST + 0.28, "0.5 m", ha="center", va="top", fontsize=13)
    axes.set(aspect="equal", xlim=(-LEFT, 2 * SPACING + RIGHT), ylim=(LOWEST, HIGHEST))
    axes.set_axis_off()


def from_above(axes, sample: Sample, trace: Trace, out: jaxcap.Capturability) -> None:
    """Contacts, region of static equilibrium and the CoM's path; metres."""
    axes.fill(*region(sample.contacts, trace.com[0]).T, facecolor=REGION, edgecolor=BLUE, linewidth=0.8, zorder=0)
    for contact in sample.contacts:
        axes.fill(*corner_points(contact)[:, :2].T, facecolor="none", edgecolor=NEAR, linewidth=1.2, zorder=1)
    start, velocity = trace.com[0], trace.com_velocity[0]
    if bool(out.capturable):
        end = start + float(out.distance) * velocity / np.linalg.norm(velocity)
        axes.plot(*np.array([start, end])[:, :2].T, color=ORANGE, linewidth=2, linestyle=(0, (2, 1)), zorder=2)
        axes.scatter(*end[:2], marker="*", s=130, color=ORANGE, edgecolor="black", linewidth=0.6, zorder=3)
    axes.plot(*trace.com[:, :2].T, color=RED, linewidth=2.2, zorder=4)
    axes.scatter(*start[:2], s=40, color="white", edgecolor=RED, linewidth=2, zorder=5)
    axes.scatter(*trace.com[-1, :2], s=45, marker="s", color=RED, zorder=5)
    arrow = {"arrowstyle": "-|>", "color": "black", "linewidth": 1.2, "mutation_scale": 11, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", start[:2] + 0.25 * velocity[:2], start[:2], arrowprops=arrow, zorder=6)
    shown = np.concatenate([trace.com[:, :2], *(corner_points(contact)[:, :2] for contact in sample.contacts)])
    middle, half = (shown.max(axis=0) + shown.min(axis=0)) / 2, np.ptp(shown, axis=0).max() / 2 + 0.05
    limits = {"xlim": (middle[0] - half, middle[0] + half), "ylim": (middle[1] - half, middle[1] + half)}
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", **limits)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.yaxis.set_major_locator(MaxNLocator(4))


def panel(strip_axes, path_axes, robot: Robot, scenario: str, index: int) -> None:
    """Simulate one sample and draw it."""
    sample = draw(robot, scenario, SEED, index)
    run = Simulator(robot, CONFIGURATIONS["standard"]).run(sample, trace=True)
    trace = run.trace
    out = prediction(sample, trace.com[0], trace.com_velocity[0])
    strip(strip_axes, robot, sample, trace)
    from_above(path_axes, sample, trace, out)
    said = "stop" if bool(out.capturable) else "fall"
    ended = {"stopped": "stopped after", "infeasible": "fell after"}[run.reason]
    speed = np.linalg.norm(trace.com_velocity[0])
    strip_axes.set_title(f"{TITLES[scenario]}: {speed:.2f} m/s, {ended} {run.time:.2f} s", fontsize=19, loc="left")
    path_axes.set_title(f"predicted: {said}\n(margin {float(out.margin):+.2f} m/s)", fontsize=15)


def legend(figure) -> None:
    """What the signs mean."""
    line = lambda color, label, **style: Line2D([], [], color=color, label=label, linewidth=3, **style)
    dot = {"marker": "o", "markerfacecolor": "white", "markersize": 9}
    handles = [
        Patch(facecolor=BLUE, edgecolor="black", label="contact"),
        Patch(facecolor=ORANGE, alpha=0.5, label="friction pyramids (0.09 m high)"),
        line(RED, f"force of a contact ({0.25 / FORCE:.0f} N are 0.25 m)"),
        line(BLUE, "CoM so far", **dot),
        Patch(facecolor=REGION, edgecolor=BLUE, label="CoM can rest here"),
        line(RED, "CoM from start to end (square)", **dot),
        line("black", "first 0.25 s at the initial velocity"),
        line(ORANGE, "predicted path and stop", linestyle=(0, (2, 1)), marker="*", markersize=14, markeredgecolor="black"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)


def main(arguments=None) -> None:
    """Parse, simulate, draw."""
    parser = argparse.ArgumentParser(prog="python -m bench.tsid_picture", description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("notebooks/stop_and_fall.png"))
    options = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", True)
    matplotlib.use("Agg")
    robot = load("talos")
    matplotlib.rcParams["font.size"] = 17
    size = {"figsize": (22, 18.5), "dpi": 80, "layout": "constrained"}
    figure, grid = plt.subplots(4, 4, width_ratios=(1.9, 0.9, 1.9, 0.9), **size)
    for row, (scenario, indices) in zip(grid, SAMPLES.items(), strict=True):
        for column, index in zip((0, 2), indices, strict=True):
            panel(row[column], row[column + 1], robot, scenario, index)
    legend(figure)
    figure.savefig(options.output)


if __name__ == "__main__":
    main()
