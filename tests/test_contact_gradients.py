"""Gradients of the margin with respect to the contacts: which foot placement would have saved it."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from states import random_states, stack
from test_ray_form import DEGENERATE, degenerate_states

import jaxcap

pytestmark = pytest.mark.usefixtures("x64")
POINTS, STEP = 12, 1e-6
STATES = 200
"""Of random sets with two and three rectangles: those that one call differentiates."""
GROUPS = ("points", "turns", "friction", "com", "com_velocity")


def margin(change, points, frames, friction, mask, com, velocity):
    """The margin of a state after a small change of everything. Turns: rotation vectors of the frames [rad]."""
    x, y, z = jnp.moveaxis(change["turns"], -1, 0)
    none = jnp.zeros_like(x)
    skew = jnp.stack([jnp.stack(row, axis=-1) for row in ((none, -z, y), (z, none, -x), (-y, x, none))], axis=-2)
    frames = frames + skew @ frames + skew @ skew @ frames / 2
    contacts = jaxcap.ContactSet(points + change["points"], frames, friction + change["friction"], mask)
    return jaxcap.capturability(jaxcap.cone_rays(contacts), com + change["com"], velocity + change["com_velocity"]).margin


def nothing():
    shapes = {"points": (POINTS, 3), "turns": (POINTS, 3), "friction": (POINTS,), "com": (3,), "com_velocity": (3,)}
    return {name: jnp.zeros(shapes[name]) for name in GROUPS}


def arrays(contacts):
    padded = contacts.padded(POINTS)
    return padded.points, padded.frames, padded.friction, padded.mask


@functools.cache
def derivative():
    return jax.jit(jax.vmap(jax.grad(margin), in_axes=(None, *[0] * 6)))


@pytest.fixture(scope="module")
def compared():
    """Gradients, and differences ahead and behind, of random states with two and three rectangles."""
    with jax.enable_x64(True):
        contacts, _, coms, velocities = random_states(60, 5, 11, "rays")
        few = [i for i, (points, *_) in enumerate(contacts) if len(points) <= POINTS]
        assert len(few) == STATES
        sets = [arrays(jaxcap.ContactSet(*contacts[i])) for i in few]
        states = (*(np.stack(x) for x in zip(*sets, strict=True)), coms[few], velocities[few])
        gradient = derivative()(nothing(), *states)
        flat, unravel = ravel_pytree(nothing())
        value = jax.jit(jax.vmap(lambda flat, *state: margin(unravel(flat), *state), in_axes=(None, *[0] * 6)))
        steps = STEP * np.eye(len(flat))
        with np.errstate(invalid="ignore"):
            middle = value(0 * flat, *states)
            ahead = np.stack([(value(d, *states) - middle) / STEP for d in steps], axis=-1)
            behind = np.stack([(middle - value(-d, *states)) / STEP for d in steps], axis=-1)
    sizes = np.cumsum([leaf[0].size for leaf in jax.tree.leaves(gradient)])[:-1]
    rows = lambda tree: np.concatenate([np.asarray(leaf).reshape(len(few), -1) for leaf in jax.tree.leaves(tree)], axis=1)
    split = lambda table: dict(zip(sorted(GROUPS), np.split(table, sizes, axis=1), strict=True))
    return tuple(map(split, (rows(gradient), ahead, behind)))


@pytest.mark.parametrize("name", GROUPS)
def test_gradient_equals_finite_differences(compared, name):
    """Wherever the differences ahead and behind agree with each other: elsewhere lies a kink.

    A kink is nothing rare here: if a face of the cone goes through all four corners of a foot, to move one of them up or
    down is not the same.
    """
    gradient, ahead, behind = (part[name] for part in compared)
    smooth = np.abs(ahead - behind) < 1e-3 * (1 + np.abs(ahead))
    assert smooth[np.isfinite(ahead)].mean() > 0.9
    assert (np.abs(gradient[smooth]) > 1e-2).sum() > 50
    difference = (ahead + behind)[smooth] / 2
    np.testing.assert_allclose(gradient[smooth], difference, rtol=1e-3, atol=1e-3)
    assert np.median(np.abs(gradient[smooth] - difference)) < 1e-6


def test_gradient_is_always_finite(compared):
    assert all(np.isfinite(part).all() for part in jax.tree.leaves(compared[0]))


def test_gradient_of_degenerate_sets_is_never_nan():
    """Not even where the cone is flat, empty, or everything, or the CoM at rest. By as many as above: compiled once."""
    batch = [
        (*arrays(contacts), com, velocity)
        for i, contacts in enumerate(DEGENERATE.values())
        if len(contacts) <= POINTS
        for com, velocity in zip(*degenerate_states(contacts, i, 46), strict=True)
    ]
    batch.append((*batch[0][:3], np.zeros(POINTS, bool), np.array([0, 0, 0.8]), np.array([0.1, 0, 0])))
    for i in range(0, len(batch), STATES):
        some = batch[i : i + STATES]
        gradient = derivative()(nothing(), *stack(some + some[-1:] * (STATES - len(some))))
        assert all(np.isfinite(part).all() for part in jax.tree.leaves(gradient))
