"""The README's picture of the next contact: where the hand or the foot of a pushed robot has to go.

    python -m bench.next_picture [-o notebooks/next_contact.png]

A humanoid of TALOS's size on two feet is pushed towards a wall, beside a rail. Every place of a palm on floor, wall and rail
is scored as it bears 0.2 s later; the line encloses those with which the model can stop.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import jaxcap
from jaxcap.plotting import capture_region
from jaxcap.plotting.patches import patches

COM, VELOCITY = np.array([0.0, 0.0, 0.85]), np.array([0.75, 0.15, 0.0])
DELAY = 0.2
"""[s]"""
WALL = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0.0]])
"""Its normal points back at the robot."""
SPACING = 0.05
"""[m]"""


def feet() -> jaxcap.ContactSet:
    """Both soles on the floor."""
    sole = lambda y: jaxcap.rectangle([0, y, 0], np.eye(3), 0.1, 0.065, 0.5)
    return sole(0.1) + sole(-0.1)


def surfaces() -> list[jaxcap.Surface]:
    """Wall, floor and rail."""
    return [
        jaxcap.surface([0.8, 0, 0.8], WALL, 0.8, 0.7, 0.6),  # behind the floor, as the picture is seen
        jaxcap.surface([0.35, 0, 0], np.eye(3), 0.45, 0.7, 0.5),
        jaxcap.rail([0.0, 0.65, 0.9], [0.75, 0.65, 0.9], [0, 0, 1], 0.03, 0.6),
    ]


def main() -> None:
    """Draws it."""
    parser = argparse.ArgumentParser(prog="python -m bench.next_picture", description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("notebooks/next_contact.png"))
    options = parser.parse_args()
    candidates = jaxcap.candidates_on(surfaces(), 0.06, 0.05, SPACING)
    found = jaxcap.next_contacts(feet(), COM, VELOCITY, candidates.contacts, DELAY)
    figure = Figure(figsize=(8.4, 6.2), layout="compressed")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d", computed_zorder=False)
    capture_region(candidates, found.margin, ax=axes)
    for corners in patches(feet()):
        axes.plot(*np.vstack([corners, corners[:1]]).T, color="black", zorder=20)
    axes.quiver(*COM, *(0.4 * VELOCITY), color="black", linewidth=2, zorder=20)
    axes.scatter(*COM, color="black", s=50, zorder=20)
    axes.plot(*np.stack([COM, COM * [1, 1, 0]]).T, color="black", linewidth=0.8, linestyle=":")
    best = candidates.centres[found.best]
    axes.scatter(*best, marker="*", s=180, facecolor="white", edgecolor="black", zorder=30, label="best place")
    without = float(found.margin_without[0])
    axes.set_title(f"a contact {DELAY} s from now; without one the robot lacks {-without:.2f} m/s")
    axes.legend(loc="upper left")
    axes.view_init(elev=22, azim=-125)
    figure.savefig(options.output, dpi=110)
    stops = int(found.capturable.sum())
    print(f"{len(candidates.surface)} places, {stops} with which the model can stop: {options.output}")


if __name__ == "__main__":
    main()
