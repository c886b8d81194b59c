"""Draw the README's picture: what one hand on a wall buys a robot that is pushed.

    python -m bench.picture [-o notebooks/kernel.png]

Left: TALOS in the stance talos_hand_on_wall, seen from behind its right side, its contacts, and a push. Right: the
horizontal CoM velocities from which it can come to rest without moving a contact, the CoM where it is on the left: on the
feet alone, and with the hand. The edge of a region is `max_speed` in each direction. Needs the extras robots, plots, data
and cli.
"""

import argparse
from functools import reduce
from operator import add
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from matplotlib.patheffects import withStroke

import jaxcap
from bench.robot_states import STANCES, Sampler
from jaxcap.plotting.style import BLUE, ORANGE, RED
from jaxcap.regions.velocity_area import VelocityArea, headings, velocity_area
from jaxcap.robots import TALOS_CONTACTS

STANCE = next(stance for stance in STANCES if stance.name == "talos_hand_on_wall")
BODY, FAR_BODY, WHITE = "#3c3c3c", "#777777", "#ffffff"
PUSH = np.array([1.2, 0.65, 0.0])
"""CoM velocity shown in both halves [m/s]."""
ARROW = 0.33
"""Length of the arrow for a velocity [m per m/s]."""
AZIMUTH, ELEVATION = np.radians([-110, 17])
"""Direction towards the camera [rad]: behind the robot's right side, above."""
DIRECTIONS = 1440
"""Directions in which the largest speed is computed."""
FAR = 10.0
"""Where an infinite speed is drawn [m/s]: outside of the picture."""
GROUND = np.array([[-0.45, -0.5, 0], [0.55, -0.5, 0], [0.55, 0.65, 0], [-0.45, 0.65, 0]])
WALL = np.array([[0.55, -0.5, 0], [0.55, 0.65, 0], [0.55, 0.65, 1.7], [0.55, -0.5, 1.7]])


def patches() -> dict[str, jaxcap.ContactSet]:
    """The stance's rectangles, by name."""
    return {
        contact.name: jaxcap.rectangle(
            contact.position,
            contact.rotation,
            TALOS_CONTACTS[contact.name].half_length,
            TALOS_CONTACTS[contact.name].half_width,
            contact.friction,
        )
        for contact in STANCE.contacts
    }


def kernel(contacts, com) -> VelocityArea:
    """The capturable horizontal velocities of this CoM. contacts: a list of sets."""
    return velocity_area(jaxcap.centroidal_cone(reduce(add, contacts)), com, headings(DIRECTIONS))


def skeleton() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Limbs as chains of points (n, 3), from far to near, and the CoM of the nominal posture [m]."""
    sampler = Sampler(STANCE)
    model, data = sampler.model, sampler.data
    com = pin.centerOfMass(model, data, sampler.nominal).copy()
    pin.framesForwardKinematics(model, data, sampler.nominal)
    joint = lambda name: data.oMi[model.getJointId(f"{name}_joint")].translation
    middle = lambda left, right: (joint(left) + joint(right)) / 2
    tip = lambda patch: data.oMf[model.getFrameId(patch.frame)].act(np.array(patch.position))
    shoulders, hips = ("arm_left_2", "arm_right_2"), ("leg_left_1", "leg_right_1")
    limbs = {
        f"{side} {limb}": [*(joint(f"{limb}_{side}_{i}") for i in joints), tip(TALOS_CONTACTS[f"{side}_{end}"])]
        for side in ("left", "right")
        for limb, joints, end in (("leg", (1, 4, 5), "sole"), ("arm", (2, 4, 5), "hand"))
    }
    trunk = {
        "hips": [joint(name) for name in hips],
        "spine": [middle(*hips), middle(*shoulders), joint("head_1")],
        "shoulders": [joint(name) for name in shoulders],
    }
    order = ("left arm", "left leg", "hips", "spine", "shoulders", "right leg", "right arm")
    return {name: np.array((limbs | trunk)[name]) for name in order}, com


def seen(points) -> np.ndarray:
    """Parallel projection of points (n, 3) to the picture (n, 2) [m]."""
    (ca, ce), (sa, se) = np.cos([AZIMUTH, ELEVATION]), np.sin([AZIMUTH, ELEVATION])
    right, up = np.array([-sa, ca, 0]), np.array([-ca * se, -sa * se, ce])
    return np.asarray(points) @ np.stack([right, up], axis=1)


def draw_stance(axes, contacts, limbs, com) -> None:
    """The robot on its contacts, far things first."""
    axes.fill(*seen(GROUND).T, facecolor="#eeeeee", edgecolor="#bbbbbb")
    axes.fill(*seen(WALL).T, facecolor="#dddddd", edgecolor="#bbbbbb")
    for name, contact in contacts.items():
        hand = "hand" in name
        axes.fill(*seen(contact.points).T, facecolor=ORANGE if hand else BLUE, edgecolor="black", zorder=3 if hand else 1)
    for name, chain in limbs.items():
        outline = [withStroke(linewidth=13, foreground=WHITE)]
        style = {"linewidth": 9, "solid_capstyle": "round", "solid_joinstyle": "round", "path_effects": outline}
        axes.plot(*seen(chain).T, color=FAR_BODY if "left" in name else BODY, **style)
    head = seen(limbs["spine"][-1:] + np.array([0, 0, 0.13]))
    axes.scatter(*head.T, s=1100, color=BODY, edgecolor=WHITE, linewidth=2, zorder=3)
    start, end = seen([com, com + ARROW * PUSH])
    axes.annotate("", end, start, arrowprops={"color": RED, "width": 5, "headwidth": 18, "headlength": 18}, zorder=4)
    axes.scatter(*start, s=160, color=WHITE, edgecolor=RED, linewidth=3, zorder=5)
    axes.set(aspect="equal")
    axes.set_axis_off()


def draw_kernels(axes, feet: VelocityArea, both: VelocityArea) -> None:
    """The two regions of velocities."""
    for outline in both.outline(FAR):
        axes.fill(*outline.T, facecolor=ORANGE, alpha=0.55, edgecolor=ORANGE, linewidth=2.5)
    for outline in feet.outline(FAR):
        axes.fill(*outline.T, facecolor=BLUE, edgecolor=BLUE, linewidth=2.5)
    axes.axhline(0, color="black", linewidth=0.6)
    axes.axvline(0, color="black", linewidth=0.6)
    axes.set(xlim=(-0.9, 2.45), ylim=(-1.0, 1.45), aspect="equal")
    axes.set(xlabel="CoM velocity, forwards [m/s]", ylabel="CoM velocity, to the left [m/s]")
    axes.text(-0.055, 0.06, "stops on\nits feet\nalone", color="white", ha="center", weight="bold")
    more = float(both.size() / feet.size())
    text = f"stops if the hand\nis on the wall:\n{more:.1f} x as many"
    axes.text(0.74, 0.38, text, ha="center", va="center", weight="bold")
    axes.text(1.65, -0.55, "has to move a contact,\nor falls", ha="center", color="#555555")
    axes.annotate(
        "the push on the left",
        PUSH[:2],
        (1.5, 0.16),
        color=RED,
        weight="bold",
        arrowprops={"arrowstyle": "-", "color": RED, "shrinkB": 8},
    )
    axes.scatter(*PUSH[:2], s=150, color=WHITE, edgecolor=RED, linewidth=3, zorder=5)


def main(arguments=None) -> None:
    """Parse, compute, draw."""
    parser = argparse.ArgumentParser(prog="python -m bench.picture", description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("notebooks/kernel.png"))
    options = parser.parse_args(arguments)
    matplotlib.use("Agg")
    matplotlib.rcParams["font.size"] = 14
    figure, (left, right) = plt.subplots(1, 2, figsize=(16, 7), dpi=100, layout="constrained", width_ratios=(2, 3))
    contacts = patches()
    limbs, com = skeleton()
    draw_stance(left, contacts, limbs, com)
    soles = [contact for name, contact in contacts.items() if "sole" in name]
    draw_kernels(right, kernel(soles, com), kernel([*contacts.values()], com))
    left.set_title(f"TALOS, pushed at {np.linalg.norm(PUSH):.1f} m/s")
    right.set_title("From which velocities can it stop without a step?")
    figure.savefig(options.output)


if __name__ == "__main__":
    main()
