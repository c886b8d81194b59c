"""Random states of the samplers as jaxcap takes them: stacked cones and arrays of states."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from samplers import random_contacts, random_state

import jaxcap

ROWS = 640
"""At least as many faces as any of the random cones has."""
POINTS = 20
"""At least as many contacts as any of the random sets has, with one more rectangle."""


def contact_set(points, frames, friction) -> jaxcap.ContactSet:
    """The sampler's arrays as a ContactSet."""
    return jaxcap.ContactSet(points=points, frames=frames, friction=friction)


FORMS = {
    "faces": lambda contacts: jaxcap.centroidal_cone(contacts).padded(ROWS),
    "rays": lambda contacts: jax.tree.map(np.asarray, jaxcap.cone_rays(contacts.padded(POINTS))),
}
"""Both forms of the cone, of one size each, so that they can be stacked."""


@cache
def random_states(sets: int, states: int, seed: int, form: str = "faces"):
    """`states` states for each of `sets` contact sets of 2, 3 and 4 rectangles in turn.

    Returns the contacts (list of sampler arrays), cones stacked (one for each state), and coms and velocities (n, 3).
    """
    rng = np.random.default_rng(seed)
    contacts, cones, coms, velocities = [], [], [], []
    for i in range(sets):
        arrays = random_contacts(rng, 2 + i % 3)
        cone = FORMS[form](contact_set(*arrays))
        for _ in range(states):
            com, velocity = random_state(rng, arrays[0])
            contacts.append(arrays)
            cones.append(cone)
            coms.append(com)
            velocities.append(velocity)
    return contacts, stack(cones), np.array(coms), np.array(velocities)


def stack(trees):
    """A tree of stacked leaves from a list of trees."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)


TOGETHER = 60
"""States that one program answers: however many there are, they go through it by so many, and it is compiled once."""
DOWN = (0.0, 0.0, -9.81)


def each():
    """`capturability` with a cone for each state, of which it takes any number."""
    return _each


def _each(cones, coms, velocities, gravity=DOWN):
    count = len(coms)
    padded = jax.tree.map(lambda leaf: _padded(np.asarray(leaf), TOGETHER), (cones, coms, velocities))
    starts = range(0, count, TOGETHER)
    parts = [_program()(*jax.tree.map(lambda leaf, i=i: leaf[i : i + TOGETHER], padded), np.array(gravity)) for i in starts]
    return jax.tree.map(lambda *fields: jnp.asarray(np.concatenate(fields)[:count]), *parts)


def _padded(leaf, size):
    """The last row again and again, up to whole calls of a program of this size."""
    return np.concatenate([leaf, np.repeat(leaf[-1:], -len(leaf) % size, axis=0)])


@cache
def _program():
    """One for each form and precision; gravity is an argument, so that another one needs no other program."""
    return jax.jit(jax.vmap(lambda *state: jaxcap.capturability(*state[:3], gravity=state[3]), in_axes=(0, 0, 0, None)))


SHARED, OWN = 256, 1024
"""States that one program of `score` answers where they share their contacts, and where each has its own."""


def pieces(cone, coms, velocities, **options):
    """`score` of any number of states by programs of one size, so that few of them are compiled.

    The states go through it by so many, the last again and again up to a whole piece. Another test with cones of the same
    size needs no program of its own, in whatever file it is.
    """
    own = isinstance(cone, jaxcap.ConeRays) and np.ndim(cone.rays) == 3
    count, size = len(coms), OWN if own else SHARED
    rows = jax.tree.map(lambda leaf: _padded(np.asarray(leaf), size), (cone if own else None, coms, velocities))
    parts = []
    for start in range(0, count, size):
        cones, *states = jax.tree.map(lambda leaf, start=start: leaf[start : start + size], rows)
        parts.append(jax.tree.map(np.asarray, jaxcap.score(cones if own else cone, *states, **options)))
    return jax.tree.map(lambda *fields: np.concatenate(fields)[:count], *parts)
