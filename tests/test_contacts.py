"""Contact sets: rectangles, joining, padding, pyramid edges, and clear errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import rotation

import jaxcap
from jaxcap import ContactSet, rectangle
from jaxcap.contacts.friction import pyramid_edges, wrench_rays

FRAME = rotation(0.3, -0.2, 0.7)


def test_rectangle_has_its_corners_in_its_frame():
    foot = rectangle([1, 2, 3], FRAME, 0.1, 0.05, 0.7)
    local = (foot.points - [1, 2, 3]) @ FRAME
    np.testing.assert_allclose(np.abs(local), np.tile([0.1, 0.05, 0], (4, 1)), atol=1e-15)
    assert len(np.unique(np.round(local, 6), axis=0)) == 4
    np.testing.assert_array_equal(foot.frames, np.tile(FRAME, (4, 1, 1)))
    np.testing.assert_array_equal(foot.friction, [0.7] * 4)


def test_joined_sets_keep_their_order():
    one, other = rectangle([0, 0, 0], FRAME, 0.1, 0.05, 0.7), ContactSet(np.ones((1, 3)), np.eye(3), 0.2)
    both = one + other
    assert len(both) == 5
    np.testing.assert_array_equal(both.points[4], [1, 1, 1])
    np.testing.assert_array_equal(both.friction, [0.7] * 4 + [0.2])


def test_padding_is_masked_and_has_no_rays():
    padded = ContactSet(np.ones((2, 3)), np.eye(3), 0.2).padded(5)
    np.testing.assert_array_equal(padded.mask, [True, True, False, False, False])
    rays = wrench_rays(padded, 4, np.zeros(3))
    assert rays.shape == (20, 6)
    assert not rays[8:].any()
    assert rays[:8].any(axis=1).all()


@pytest.mark.parametrize("sides", [3, 4, 5, 8])
def test_pyramid_edges_lie_on_the_friction_cone_at_their_angles(sides):
    edges = pyramid_edges(FRAME[None], np.array([0.6]), sides)[0] @ FRAME
    np.testing.assert_allclose(edges[:, 2], 1)
    np.testing.assert_allclose(np.hypot(edges[:, 0], edges[:, 1]), 0.6)
    angles = np.arctan2(edges[:, 1], edges[:, 0]) % (2 * np.pi)
    np.testing.assert_allclose(angles, np.pi / sides + 2 * np.pi * np.arange(sides) / sides)


def test_rays_are_traced_like_computed():
    contacts = rectangle([0.1, 0.2, 0.3], FRAME, 0.1, 0.05, 0.7)
    traced = jax.jit(lambda contacts: wrench_rays(contacts, 4, jnp.zeros(3)))(contacts)
    np.testing.assert_allclose(traced, wrench_rays(contacts, 4, np.zeros(3)), atol=1e-6)
    slope = jax.jacfwd(lambda points: wrench_rays(ContactSet(points, contacts.frames, contacts.friction), 4, jnp.zeros(3)))
    assert np.isfinite(slope(jnp.asarray(contacts.points))).all()


GOOD = {"points": np.zeros((2, 3)), "frames": np.tile(np.eye(3), (2, 1, 1)), "friction": np.ones(2)}
BAD = {
    "points of a wrong shape": ({"points": np.zeros((2, 2))}, r"points has shape \(2, 2\) \(expected \(k, 3\)\)"),
    "points that are text": ({"points": "here"}, r"points: 'here' \(expected numbers\)"),
    "a point that is not finite": ({"points": [[0, 0, 0], [0, np.nan, 0]]}, r"points\[1, 1\] = nan \(expected a finite"),
    "too few frames": ({"frames": np.eye(3)[None]}, r"frames has shape \(1, 3, 3\)"),
    "a reflection": ({"frames": np.array([np.eye(3), np.diag([1, 1, -1.0])])}, r"frames\[1\] is not a rotation: det = -1.0"),
    "a scaled frame": ({"frames": np.array([np.eye(3), 1.1 * np.eye(3)])}, r"frames\[1\] is not a rotation: det = 1.331"),
    "no friction": ({"friction": [1, 0]}, r"friction\[1\] = 0.0 \(expected a positive finite number\)"),
    "negative friction": ({"friction": -1}, r"friction\[0\] = -1.0"),
    "infinite friction": ({"friction": [1, np.inf]}, r"friction\[1\] = inf"),
    "too much friction": ({"friction": [1, 1, 1]}, r"friction has shape \(3,\)"),
    "a mask of numbers": ({"mask": [1, 0]}, r"mask: int64 of shape \(2,\) \(expected bool of shape \(2,\)\)"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_contacts_get_a_clear_error(name):
    changes, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        ContactSet(**{**GOOD, **changes})


@pytest.mark.parametrize(("argument", "value"), [("half_length", 0), ("half_width", -1), ("half_length", np.nan)])
def test_bad_rectangle_gets_a_clear_error(argument, value):
    sizes = {"half_length": 0.1, "half_width": 0.1, argument: value}
    with pytest.raises(ValueError, match=f"{argument} = .* \\(expected a positive number of metres\\)"):
        rectangle([0, 0, 0], np.eye(3), friction=1.0, **sizes)


def test_padding_to_less_is_an_error():
    with pytest.raises(ValueError, match=r"size = 1 is less than the 2 contacts"):
        ContactSet(**GOOD).padded(1)


def test_projection_inside_jit_is_an_error():
    contacts = ContactSet(**GOOD)
    with pytest.raises(ValueError, match="works on the host"):
        jax.jit(lambda contacts: jaxcap.centroidal_cone(contacts).faces)(contacts)
