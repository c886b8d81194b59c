"""What friction, a hand and a slope are worth: how hard a level push TALOS takes, from the weakest to the strongest heading.

    python -m bench.sections [--headings 360]

The stances are those of bench/data, the CoM is the median of the stance's states. A table is a section of the kernel through
contact sets: the sets of its lines differ in one number, and all of them, in all headings, are one call of `score`. Columns:
the smallest and the largest `max_speed` over the headings [m/s], their headings [deg, 0 is ahead, 90 to the left], and the
area of the velocities that can be stopped [m^2/s^2]. On a slope, feet and ground are turned about the y axis through the
feet's centroid (positive: downhill is ahead), and the CoM stays; pyramids of four sides hold up to atan(mu / sqrt 2). Needs
the extras data and cli. For pictures: `jaxcap map --axis friction=0.1:1:46`.
"""

import argparse
from pathlib import Path

import jax
import numpy as np
import pyarrow.parquet as pq

import jaxcap
from jaxcap.files.contact_files import read_contacts
from jaxcap.maps.contact_axes import contacts_at
from jaxcap.regions.velocity_area import headings, velocity_area

DATA = Path(__file__).parent / "data"
FRICTIONS = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5])
SLOPES = np.array([-20, -15, -10, -5, 0, 5, 10, 15, 20])
"""[deg]"""


def stance(name: str):
    """Contacts and CoM (3,) [m]."""
    coms = pq.read_table(DATA / f"{name}.parquet", columns=["com"])["com"].combine_chunks().flatten()
    return read_contacts(DATA / f"{name}.yaml"), np.median(np.asarray(coms, float).reshape(-1, 3), axis=0)


def without_hand(contacts):
    """Its last four contacts masked."""
    count = len(contacts)
    return jaxcap.ContactSet(contacts.points, contacts.frames, contacts.friction, mask=np.arange(count) < count - 4)


def section(title: str, labels, sets, com, count: int):
    """Print one table: a line for each contact set."""
    stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *sets)
    area = velocity_area(jaxcap.cone_rays(stacked), com, headings(count))
    print(f"\n{title}, CoM at {np.round(com, 3)}\n{'':>12}  weakest  heading  strongest  heading     area")
    step = 360 / count
    for label, stands, speeds, size in zip(labels, area.standing, np.asarray(area.max_speed), area.size(), strict=True):
        low, high = speeds.argmin(), speeds.argmax()
        figures = f"{speeds[low]:9.3f}{low * step:9.0f}{speeds[high]:11.3f}{high * step:9.0f}{size:9.3f}"
        print(f"{label:>12}{figures}" if stands else f"{label:>12}  cannot stand")


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--headings", type=int, default=360)
    count = parser.parse_args().headings
    jax.config.update("jax_enable_x64", True)
    feet, feet_com = stance("talos_two_feet")
    wall, wall_com = stance("talos_hand_on_wall")
    frictions, slopes = [f"mu = {mu}" for mu in FRICTIONS], [f"{slope} deg" for slope in SLOPES]
    rougher = lambda contacts: [contacts_at([contacts], friction=friction) for friction in FRICTIONS]
    tilted = [contacts_at([feet], slope=slope) for slope in np.radians(SLOPES)]
    section("Two feet", frictions, rougher(feet), feet_com, count)
    section("Two feet, hand on a wall", frictions, rougher(wall), wall_com, count)
    section("A hand on a wall", ["without", "with"], [without_hand(wall), wall], wall_com, count)
    section("Two feet on a slope", slopes, tilted, feet_com, count)


if __name__ == "__main__":
    main()
