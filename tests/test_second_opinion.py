"""What rays leave undecided, faces answer."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from states import FORMS, random_states

import jaxcap
from jaxcap.batch.rounds import States
from jaxcap.batch.second_opinion import decided
from jaxcap.contacts.conventions import GRAVITY
from jaxcap.one_state.result import Status

ROWS = (2, 3, 11)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_what_is_missing_is_answered_by_faces(dtype):
    with jax.enable_x64(dtype == np.float64):
        _, cones, coms, velocities = random_states(6, 2, 11, "rays")
        coms, velocities = jnp.asarray(coms, dtype), jnp.asarray(velocities, dtype)
        found = jaxcap.score(cones, coms, velocities)
        assert (found.status == Status.OK).all()
        lost = jax.tree.map(np.array, found)
        for field, nothing in zip(lost, (False, -1, Status.MAX_STEPS), strict=False):
            field[list(ROWS)] = nothing
        lost.status[list(ROWS)], lost.margin[list(ROWS)] = Status.MAX_STEPS, np.nan
        again = decided(cones, States(coms, velocities), GRAVITY, lost)
    for name, one, other in zip(found._fields, found, again, strict=True):
        assert one.dtype == other.dtype, name
        others = np.setdiff1d(np.arange(len(coms)), ROWS)
        np.testing.assert_array_equal(np.asarray(one)[others], np.asarray(other)[others], name)
        rtol = 1e-6 if dtype == np.float64 else 1e-2
        np.testing.assert_allclose(np.asarray(one, float), np.asarray(other, float), rtol, rtol, err_msg=name)


def test_nothing_missing_nothing_done():
    _, cones, coms, velocities = random_states(3, 2, 11, "rays")
    coms, velocities = jnp.asarray(coms), jnp.asarray(velocities)
    found = jaxcap.score(cones, coms, velocities)
    assert decided(cones, States(coms, velocities), GRAVITY, found) is found


def test_one_contact_set_for_all():
    feet = FORMS["rays"](jaxcap.rectangle((0, 0, 0), np.eye(3), 0.1, 0.07, 0.5))
    coms, velocities = jnp.array([[0, 0, 0.8], [0.01, 0, 0.8]]), jnp.array([[0.1, 0, 0], [2.0, 0, 0]])
    found = jaxcap.score(feet, coms, velocities)
    lost = found._replace(status=np.array([Status.MAX_STEPS] * 2, np.int8), capturable=np.array([False, True]))
    again = decided(feet, States(coms, velocities), GRAVITY, lost)
    np.testing.assert_array_equal(again.capturable, found.capturable)
    np.testing.assert_array_equal(again.status, Status.OK)
