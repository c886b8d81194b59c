"""Contact sets: rectangles, joining, padding, pyramid edges, and clear errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import rotation

import jaxcap
from jaxcap import ContactSet, rectangle
from jaxcap.contacts.conventions import checked_gravity
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
    "a point beyond sense": ({"points": [[0, 0, 0], [1e20, 0, 0]]}, r"points\[1, 0\] = 1e\+20 \(expected at most"),
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


def test_a_set_that_is_not_checked_holds_what_it_is_given():
    fields = "points", "frames", "friction", "mask"
    contacts = ContactSet.unchecked(*fields)
    assert [getattr(contacts, name) for name in fields] == list(fields)
    assert jax.tree.map(str.upper, contacts).points == "POINTS"


@pytest.mark.parametrize("spread", [0, 1e-17, 1e-12])
def test_contacts_at_one_place_are_one_point(spread):
    """What is between them is rounding: no torque about their place, in both forms."""
    contacts = ContactSet(np.array([[0.3, 0.1, 0], [0.3, 0.1 + spread, 0], [0.3, 0.1, spread]]), np.eye(3), 0.5)
    alone = jaxcap.centroidal_cone(ContactSet(np.array([[0.3, 0.1, 0]]), np.eye(3), 0.5))
    cone = jaxcap.centroidal_cone(contacts)
    assert cone.length == jaxcap.cone_rays(contacts).length == 1
    # The equalities' rows are any basis: the same cone, not the same rows.
    assert cone.faces.shape == alone.faces.shape
    assert (cone.faces @ wrench_rays(contacts, 4, alone.origin).T).max() < 1e-11
    assert (alone.faces @ wrench_rays(contacts, 4, cone.origin).T).max() < 1e-11


GRAVITIES = {
    "a number": (9.81, TypeError, r"gravity has shape \(\) \(expected \(3,\)"),
    "two numbers": ((0, -9.81), TypeError, r"gravity has shape \(2,\)"),
    "text": ("down", TypeError, r"gravity = 'down' \(expected three numbers"),
    "ragged": ([[0], [0, 1], 2], TypeError, r"expected three numbers"),
    "NaN": ((0, 0, np.nan), ValueError, r"gravity = .*nan.* \(expected finite numbers"),
    "infinite, in single": (np.array([0, -np.inf, 0], np.float32), ValueError, r"expected finite numbers"),
}


@pytest.mark.parametrize("name", GRAVITIES)
def test_bad_gravity_gets_a_clear_error(name):
    value, error, message = GRAVITIES[name]
    cone, com = jaxcap.centroidal_cone(rectangle([0, 0, 0], np.eye(3), 0.1, 0.1, 0.5)), np.array([0, 0, 0.8])
    for call in (
        lambda: checked_gravity(value),
        lambda: jaxcap.support_polygon(cone, value),
        lambda: jaxcap.velocity_area(cone, com, gravity=value),
        lambda: jaxcap.robustness(cone, com, gravity=value),
        lambda: jaxcap.com_area(cone, np.array([0.3, 0, 0]), 0.8, gravity=value),
        lambda: jaxcap.capture_point(com, com, 0.8, gravity=value),
        lambda: jaxcap.baselines(cone, rectangle([0, 0, 0], np.eye(3), 0.1, 0.1, 0.5), com[None], com[None], gravity=value),
    ):
        with pytest.raises(error, match=message):
            call()


def test_gravity_that_is_not_finite_may_be_left_to_a_status():
    assert np.isnan(checked_gravity((0, 0, np.nan), finite=False)[2])
    assert checked_gravity((0, 0, -10)).dtype == np.float64


def test_traced_gravity_has_its_shape_checked():
    assert jax.jit(lambda gravity: checked_gravity(gravity) * 2)(jnp.array([0, 0, jnp.nan])).shape == (3,)
    assert jax.jit(lambda g: checked_gravity((0.0, 0.0, -g)))(9.81)[2] == np.float32(-9.81)
    with pytest.raises(TypeError, match=r"gravity has shape \(2,\)"):
        jax.jit(checked_gravity)(jnp.zeros(2))


def test_no_gravity_has_no_support_polygon():
    cone = jaxcap.centroidal_cone(rectangle([0, 0, 0], np.eye(3), 0.1, 0.1, 0.5))
    with pytest.raises(ValueError, match=r"gravity = 0 \(expected a direction"):
        jaxcap.support_polygon(cone, (0, 0, 0))


def test_padding_to_less_is_an_error():
    with pytest.raises(ValueError, match=r"size = 1 is less than the 2 contacts"):
        ContactSet(**GOOD).padded(1)


def test_projection_inside_jit_is_an_error():
    contacts = ContactSet(**GOOD)
    with pytest.raises(ValueError, match="works on the host"):
        jax.jit(lambda contacts: jaxcap.centroidal_cone(contacts).faces)(contacts)
