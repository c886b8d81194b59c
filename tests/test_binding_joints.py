"""The joints that bind are those whose limits, changed a little, change the largest speed, or the effort."""

import jax
import numpy as np
import pytest
from samplers import limited_samples

import jaxcap
from jaxcap import Actuation

pytestmark = pytest.mark.usefixtures("x64")
STATES, JOINTS = 24, 9
STEP = 1e-6
"""Of a limit [N m/kg]."""
SECOND_ORDER, ROUNDING = 1e-4, 1e-7
"""What central differences leave: relative, and of what does not change at all."""


@pytest.fixture(scope="module")
def sample():
    """Contacts, actuation, CoM and velocity of each state."""
    contacts, postures, coms, velocities = zip(*limited_samples(np.random.default_rng(12), STATES), strict=True)
    stacked = lambda parts: [np.stack(fields) for fields in zip(*parts, strict=True)]
    return jaxcap.ContactSet(*stacked(contacts)), Actuation(*stacked(postures)), np.array(coms), np.array(velocities)


def row(tree, i):
    return jax.tree.map(lambda x: x[i], tree)


@pytest.fixture(scope="module")
def binding(sample):
    """Of each state."""
    contacts, actuation, coms, velocities = sample
    with jax.enable_x64(True):
        return [
            jaxcap.binding_joints(jaxcap.cone_rays(row(contacts, i)), coms[i], velocities[i], row(actuation, i))
            for i in range(STATES)
        ]


def changed(sample, changes):
    """Answers with changes (STATES, JOINTS, JOINTS) of the limits; shape (STATES, JOINTS)."""
    contacts, actuation, coms, velocities = jax.tree.map(lambda x: np.repeat(x, JOINTS, axis=0), sample)
    limit = actuation.limit + changes.reshape(-1, JOINTS)
    limited = Actuation(actuation.jacobians, actuation.gravity_torque, limit)
    found = jaxcap.score(jaxcap.cone_rays(contacts), coms, velocities, actuation=limited)
    return jax.tree.map(lambda x: np.asarray(x).reshape(STATES, JOINTS), found)


def figure(binding, answers):
    """The figure that the joints decide, by state and joint."""
    values = {"max_speed": answers.max_speed, "effort": -answers.effort}
    return np.stack([values[one.figure][i] for i, one in enumerate(binding)])


def of_joints(binding):
    """Gains by state and joint, zero for what is not named."""
    return np.array([[one.gains.get(joint, 0.0) for joint in range(JOINTS)] for one in binding])


def test_gains_are_central_differences(sample, binding):
    """Of each joint's limit, in max_speed; of postures that cannot be held in the effort."""
    step = np.broadcast_to(STEP * np.eye(JOINTS), (STATES, JOINTS, JOINTS))
    more, less = changed(sample, step), changed(sample, -step)
    differences = (figure(binding, more) - figure(binding, less)) / (2 * STEP)
    found = of_joints(binding)
    np.testing.assert_allclose(found, differences, rtol=SECOND_ORDER, atol=ROUNDING)
    unheld = np.array([one.figure == "effort" for one in binding])
    np.testing.assert_array_equal(unheld, (more.effort[:, 0] > 1) & np.isfinite(more.effort[:, 0]))
    assert unheld.sum() > 3 and (found[~unheld] > 0).any(axis=1).sum() > 3 and (found == 0).any()


def test_more_of_a_joint_that_is_not_named_changes_nothing(sample, binding):
    """And more of one that is named never hurts."""
    actuation, found = sample[1], of_joints(binding)
    before = figure(binding, changed(sample, np.zeros((STATES, JOINTS, JOINTS))))
    after = figure(binding, changed(sample, 0.3 * actuation.limit[:, None] * np.eye(JOINTS)))
    np.testing.assert_allclose(after[found == 0], before[found == 0], rtol=1e-9, atol=1e-9)
    assert (after >= before - 1e-9).all() and (after[found > 0] > before[found > 0]).all()


def test_gains_of_the_effort_add_up_to_it(sample, binding):
    """The effort is of degree -1 in all limits together, so limits times gains are the effort: Euler's theorem."""
    effort = changed(sample, np.zeros((STATES, JOINTS, JOINTS))).effort[:, 0]
    unheld = np.array([one.figure == "effort" for one in binding])
    shares = (sample[1].limit * of_joints(binding)).sum(axis=1)
    np.testing.assert_allclose(shares[unheld], effort[unheld], rtol=1e-9)


def test_names_mass_and_order(sample, binding):
    contacts, actuation, coms, velocities = sample
    i = max(range(STATES), key=lambda i: len(binding[i].gains))
    assert list(binding[i].gains.values()) == sorted(binding[i].gains.values(), reverse=True)
    names = [f"joint {j}" for j in range(JOINTS)]
    arguments = jaxcap.cone_rays(row(contacts, i)), coms[i], velocities[i], row(actuation, i)
    named = jaxcap.binding_joints(*arguments, names, mass=40.0)
    assert list(named.gains) == [names[j] for j in binding[i].gains]
    np.testing.assert_allclose([40 * gain for gain in named.gains.values()], list(binding[i].gains.values()))


def test_where_no_limit_is_met_no_joint_binds(sample):
    contacts, actuation, coms, velocities = sample
    free = row(Actuation(actuation.jacobians, actuation.gravity_torque, 1e5 * actuation.limit), 0)
    arguments = jaxcap.cone_rays(row(contacts, 0)), coms[0]
    assert jaxcap.binding_joints(*arguments, velocities[0], free) == jaxcap.BindingJoints("max_speed", {})
    assert jaxcap.binding_joints(*arguments, np.zeros(3), free).gains == {}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"names": ["knee"]}, r"names: 1 \(expected 9"),
        ({"mass": 0.0}, r"mass = 0.0 \(expected a positive"),
        ({"mass": np.nan}, "mass = nan"),
    ],
)
def test_what_cannot_be_used_is_named(sample, options, message):
    contacts, actuation, coms, velocities = (row(part, 0) for part in sample)
    with pytest.raises(ValueError, match=message):
        jaxcap.binding_joints(jaxcap.cone_rays(contacts), coms, velocities, actuation, **options)
    with pytest.raises(ValueError, match="24 postures"):
        jaxcap.binding_joints(jaxcap.cone_rays(contacts), coms, velocities, sample[1])
