"""The contact sets that are measured, and states on them. Everything is seeded.

    coplanar feet, tilted feet         two soles; CoM over their bounding box and 0.05 m around, 0.7 to 1 m up
    the stances in bench/data          their real states, repeated up to the batch
    k random rectangles                centres in [-0.5, 0.5] x [-0.5, 0.5] x [0, 0.5] m, roll and pitch within
                                       2 atan(mu); CoM up to 1.5 m above
    own sets of k rectangles           every state has such a set of its own (see tests/samplers.py)

with velocities uniform in [-1, 1]^3 m/s except for the real states.
"""

from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import pyarrow.parquet as pq

import jaxcap
from jaxcap.files.contact_files import read_contacts
from tests.samplers import random_contacts, random_state, rotation

DATA = Path(__file__).parent / "data"
REAL = ("talos_two_feet", "talos_hand_on_wall", "talos_slopes_and_rail")
SEED = 0
"""Of the random contacts and states; with it the random rectangles have somewhere to stand."""
OWN_SETS = 4096
"""Different contact sets of a batch where every state has its own: drawn in Python, then repeated."""


class Batch(NamedTuple):
    """States, and the contact set that they share or the sets that are their own."""

    name: str
    contacts: jaxcap.ContactSet
    coms: np.ndarray
    """(n, 3) [m]"""
    com_velocities: np.ndarray
    """(n, 3) [m/s]"""

    def first(self, n: int) -> "Batch":
        """The first n states."""
        own = self.contacts.points.ndim == 3
        contacts = jax.tree.map(lambda leaf: leaf[:n], self.contacts) if own else self.contacts
        return Batch(self.name, contacts, self.coms[:n], self.com_velocities[:n])


def feet(*placements) -> jaxcap.ContactSet:
    """Soles of 0.21 x 0.13 m, friction 0.5; a placement is the position [m] and roll, pitch, yaw [rad] of one."""
    first, *others = (jaxcap.rectangle(p, rotation(*angles), 0.105, 0.065, 0.5) for p, angles in placements)
    return sum(others, start=first)


SETS = {
    "one foot": feet(((0, 0, 0), (0, 0, 0))),
    "coplanar feet": feet(((0, 0.1, 0), (0, 0, 0)), ((0, -0.1, 0), (0, 0, 0))),
    "tilted feet": feet(((0, 0.15, 0), (0.25, 0, 0)), ((0.3, -0.15, 0.2), (0, -0.25, 0))),
}


def batch(name: str, n: int) -> Batch:
    """n states on the set of this name: one of SETS, one of REAL, "k random rectangles" or "own sets of k rectangles"."""
    if name in SETS:
        return _random_states(name, SETS[name], n, 0.7, 1.0)
    if name in REAL:
        table = pq.read_table(DATA / f"{name}.parquet", columns=["com", "com_velocity"])
        coms, velocities = (np.resize(np.stack(table[column].to_numpy()), (n, 3)) for column in table.column_names)
        return Batch(name.replace("_", " "), read_contacts(DATA / f"{name}.yaml"), coms, velocities)
    if name.startswith("own"):
        return _own_sets(name, int(name.split()[3]), n)
    contacts = jaxcap.ContactSet(*random_contacts(np.random.default_rng(SEED), int(name.split()[0])))
    return _random_states(name, contacts, n, 0.0, 1.5)


def _random_states(name: str, contacts: jaxcap.ContactSet, n: int, lowest: float, highest: float) -> Batch:
    """CoM over the contacts' bounding box and 0.05 m around, lowest to highest above it [m]."""
    rng = np.random.default_rng(SEED)
    low, high = contacts.points.min(axis=0), contacts.points.max(axis=0)
    coms = rng.uniform(low + np.array([-0.05, -0.05, lowest]), high + np.array([0.05, 0.05, highest]), (n, 3))
    return Batch(name, contacts, coms, rng.uniform(-1, 1, (n, 3)))


def _own_sets(name: str, rectangles: int, n: int) -> Batch:
    rng = np.random.default_rng((SEED, rectangles))
    sets = [random_contacts(rng, rectangles) for _ in range(min(n, OWN_SETS))]
    states = [random_state(rng, points) for points, *_ in sets]
    repeated = lambda arrays: np.resize(np.stack(arrays), (n, *arrays[0].shape))
    contacts = jaxcap.ContactSet(*map(repeated, zip(*sets, strict=True)))
    return Batch(name, contacts, *map(repeated, zip(*states, strict=True)))
