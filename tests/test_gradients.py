"""Gradients of the answer with respect to the state: equal to finite differences away from kinks, never NaN."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from states import each, random_states

import jaxcap
from jaxcap import Case

pytestmark = pytest.mark.usefixtures("x64")
FIGURES = ("margin", "min_speed", "max_speed", "paper_margin", "residual_speed", "distance", "time")
STEP = 1e-6
KINKS = json.loads((Path(__file__).parent / "kinks.json").read_text())
"""States on contacts that are symmetric about their line of travel: faces of the cone are parallel to it, and turn with it.
Found by `python -m bench.gradients --seed 7 --pairs 3000`."""


def figures(cone, com, velocity):
    return values(jaxcap.capturability(cone, com, velocity))


def values(answer):
    """The figures of an answer, last."""
    return jnp.stack([getattr(answer, name) for name in FIGURES], axis=-1)


@pytest.fixture(scope="module")
def derivatives():
    """Reverse mode, forward mode and central differences at two steps, with respect to com and velocity; and the cases."""
    with jax.enable_x64(True):
        _, cones, coms, velocities = random_states(60, 5, 11)
        state = np.concatenate([coms, velocities], axis=1)
        joint = lambda cone, state: figures(cone, state[:3], state[3:])
        reverse = np.asarray(jax.jit(jax.vmap(jax.jacrev(joint, argnums=1)))(cones, state))
        forward = np.asarray(jax.jit(jax.vmap(jax.jacfwd(joint, argnums=1)))(cones, state))
        value = lambda state: values(each()(cones, state[:, :3], state[:, 3:]))
        difference = lambda step: np.stack(
            [(value(state + d) - value(state - d)) / (2 * step) for d in step * np.eye(6)], axis=-1
        )
        with np.errstate(invalid="ignore"):
            differences = [np.asarray(difference(step)) for step in (STEP, 2 * STEP)]
        answer = jax.tree.map(np.asarray, each()(cones, coms, velocities))
    return reverse, forward, differences, answer


def test_reverse_mode_equals_forward_mode(derivatives):
    reverse, forward, _, _ = derivatives
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9)


def test_gradients_of_figures_that_are_numbers_are_finite(derivatives):
    reverse, _, _, answer = derivatives
    for k, name in enumerate(FIGURES):
        known = ~np.isnan(getattr(answer, name))
        assert np.isfinite(reverse[known, k]).all(), name
    assert np.isinf(answer.max_speed).any()  # among them are limits that are infinite


@pytest.mark.parametrize("name", FIGURES)
def test_gradient_equals_finite_differences(derivatives, name):
    """Wherever the differences at two steps agree with each other: elsewhere lies a kink."""
    reverse, _, (difference, check), answer = derivatives
    k = FIGURES.index(name)
    smooth = np.abs(difference[:, k] - check[:, k]) < 1e-5 * (1 + np.abs(difference[:, k]))
    if name in ("distance", "time", "residual_speed", "paper_margin"):
        smooth &= (answer.case != Case.C3_3)[:, None]  # documented: swings are not differentiated
    assert smooth.sum() > (150 if name in ("distance", "time") else 1500)
    np.testing.assert_allclose(reverse[:, k][smooth], difference[:, k][smooth], rtol=1e-4, atol=1e-4)


def test_gradient_of_the_margin_is_smooth_almost_everywhere(derivatives):
    """So the test above leaves out next to nothing."""
    _, _, (difference, check), _ = derivatives
    finite = np.isfinite(difference[:, 0])
    smooth = np.abs(difference[:, 0] - check[:, 0]) < 1e-5 * (1 + np.abs(difference[:, 0]))
    assert smooth[finite].mean() > 0.98


STATES = {
    "zero velocity": ([0, 0, 0.8], [0, 0, 0]),
    "zero velocity off the feet": ([1, 0, 0.8], [0, 0, 0]),
    "on the edge of the feet, along it": ([0.1, 0, 0.8], [0, 0.5, 0]),
    "on the edge of the feet, outwards": ([0.1, 0, 0.8], [0.5, 0, 0]),
    "straight up": ([0, 0, 0.8], [0, 0, 1]),
    "straight down": ([0, 0, 0.8], [0, 0, -1]),
    "away from the feet": ([1, 0, 0.8], [1, 0, 0]),
    "past the feet": ([1, 0, 0.8], [0, 1, 0]),
    "on the ground": ([0, 0, 0], [0.1, 0, 0]),
    "very slow": ([0, 0, 0.8], [1e-30, 0, 0]),
    "very fast": ([0, 0, 0.8], [1e30, 0, 0]),
    "not a number": ([np.nan, 0, 0.8], [1, 0, 0]),
}


@pytest.mark.parametrize("name", STATES)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_gradient_of_the_margin_is_never_nan(name, dtype):
    foot = lambda y: jaxcap.rectangle([0, y, 0], np.eye(3), 0.1, 0.05, 0.5)
    cone = jaxcap.centroidal_cone(foot(0.1) + foot(-0.1))
    com, velocity = (jnp.asarray(x, dtype) for x in STATES[name])
    gradient = jax.grad(lambda com, velocity: jaxcap.capturability(cone, com, velocity).margin, argnums=(0, 1))
    for part in gradient(com, velocity):
        assert part.dtype == dtype
        assert np.isfinite(part).all()


@jax.jit
def _margin_and_slope(cone, com, velocity, moves, t):
    """At t along the change of state; one program for all of the same size."""
    at = lambda t: jaxcap.capturability(cone, com + t * moves[0], velocity + t * moves[1]).margin
    return jax.jvp(at, (t,), (1.0,))


@pytest.mark.parametrize("state", KINKS, ids=lambda state: state["name"])
def test_a_face_parallel_to_the_line_turns_with_it(state):
    """A coefficient that is zero has a derivative all the same. The margin has a kink there: the derivative is not beyond
    those of its two sides."""
    contacts = jaxcap.ContactSet(*(np.array(state[name]) for name in ("points", "frames", "friction")))
    cone = jaxcap.centroidal_cone(contacts, state["sides"]).padded(128)
    com, velocity, change = (np.array(state[name]) for name in ("com", "com_velocity", "change"))
    moves = [change, 0 * change] if state["moves"] == "com" else [0 * change, change]
    margin = lambda t: _margin_and_slope(cone, com, velocity, moves, t)[0]

    step = 1e-7
    behind, ahead = (float((margin(s) - margin(0.0)) / s) for s in (-step, step))
    derivative = float(_margin_and_slope(cone, com, velocity, moves, 0.0)[1])
    error = 1e-3 * abs(derivative)  # of the differences
    assert min(behind, ahead) - error <= derivative <= max(behind, ahead) + error
