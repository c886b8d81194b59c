"""The robot's limits: consistent with linear programs, with the ray form where there are none, and with what must be so."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import limited_samples, rotation

import jaxcap
from jaxcap import Actuation, Status
from jaxcap.contacts.actuation import actuated
from jaxcap.contacts.conventions import GRAVITY
from jaxcap.numerics.guarded import direction
from jaxcap.one_state.actuated_polygon import actuated_polygon
from jaxcap.one_state.line import motion_of_lanes
from reference import robot_limits as reference

pytestmark = pytest.mark.usefixtures("x64")
STATES, JOINTS, CHAIN = 64, 9, 3
FIGURES = ("margin", "min_speed", "max_speed", "paper_margin", "distance", "time", "residual_speed")


class Sample(NamedTuple):
    """States with contacts and a posture of their own."""

    contacts: jaxcap.ContactSet
    actuation: Actuation
    coms: np.ndarray
    velocities: np.ndarray
    box: np.ndarray

    def scored(self, **changes):
        """The answers, as NumPy's arrays; always by the same program."""
        new = self._replace(**changes)
        rays = jaxcap.cone_rays(new.contacts)
        found = jaxcap.score(rays, new.coms, new.velocities, actuation=new.actuation, momentum_box=new.box)
        return jax.tree.map(np.asarray, found)

    def limited(self, share):
        """The same robot with limits times a share."""
        return _with(self.actuation, limit=self.actuation.limit * share)


def _with(actuation, **changes):
    fields = {name: getattr(actuation, name) for name in ("jacobians", "gravity_torque", "limit", "mask")}
    return Actuation(**{**fields, **changes})


@pytest.fixture(scope="module")
def sample():
    """64 states, half of them with a momentum box."""
    rng = np.random.default_rng(12)
    contacts, postures, coms, velocities = zip(*limited_samples(rng, STATES), strict=True)
    stacked = lambda parts: [np.stack(fields) for fields in zip(*parts, strict=True)]
    box = np.where(np.arange(STATES) % 2, 0.1, 0.0)
    sets = jaxcap.ContactSet(*stacked(contacts))
    return Sample(sets, Actuation(*stacked(postures)), np.array(coms), np.array(velocities), box)


@pytest.fixture(scope="module")
def found(sample):
    with jax.enable_x64(True):
        return sample.scored()


@pytest.fixture(scope="module")
def programs(sample):
    """The rows of the reference, state by state."""
    rows = []
    for i in range(STATES):
        sets, posture = (jax.tree.map(lambda x, i=i: x[i], tree) for tree in (sample.contacts, sample.actuation))
        limits = reference.Limits(posture.jacobians, posture.gravity_torque, posture.limit, posture.mask)
        contacts = sets.points, sets.frames, sets.friction
        rows.append(reference.state_of(*contacts, sample.coms[i], sample.velocities[i], limits, box=sample.box[i]))
    return rows


def test_effort_is_that_of_the_linear_program(found, programs):
    assert (found.status == Status.OK).all()
    expected = np.array([reference.effort(program) for program in programs])
    np.testing.assert_allclose(found.effort, expected, rtol=1e-6)
    held = np.isfinite(expected)
    assert (held & (expected > 1)).sum() > 10 and (expected <= 1).sum() > 10


def test_speeds_are_those_of_the_linear_programs(found, programs):
    """Where the polygon does not go on beyond the static region, for there the robot swings."""
    compared = 0
    for i, program in enumerate(programs):
        s_min, s_max = reference.static_interval(program)
        first, end = reference.least_acceleration(program, 0.0), reference.farthest(program, 0.0)
        if first is None or s_min > s_max:
            assert found.max_speed[i] == 0
        elif end <= s_max + 1e-7:
            np.testing.assert_allclose(
                found.max_speed[i], reference.max_speed(program), rtol=1e-6, atol=1e-9, err_msg=str(i)
            )
            compared += found.max_speed[i] > 0
    assert compared > 20


@jax.jit
def _walked(cone, com, velocity, momentum):
    """Whether the start is feasible, the acceleration there, and the speed that the lower boundary stops."""
    along, speed = direction(velocity)
    polygon = actuated_polygon(cone, com, along, jnp.array([0, 0, -9.81]), momentum / speed)
    survey = polygon.survey()
    lower = polygon.knowing(survey).boundary(jnp.where(survey.feasible, jnp.inf, 0))
    stops = jnp.sqrt(jnp.maximum(-2 * lower.gain(lower.end), 0))
    return survey.feasible, lower.at(jnp.zeros_like(speed)), stops


def test_angular_momentum_is_braked_as_in_the_linear_programs(sample):
    momentum = np.random.default_rng(8).uniform(-0.2, 0.2, (STATES, 3))
    lanes = lambda tree: jax.tree.map(lambda x: jnp.moveaxis(jnp.asarray(x), 0, -1), tree)
    cone = actuated(jaxcap.cone_rays(sample.contacts), sample.actuation, sample.box, STATES)
    feasible, lowest, stops = _walked(*lanes((cone, sample.coms, sample.velocities, momentum)))
    for i in range(STATES):
        sets, posture = (jax.tree.map(lambda x, i=i: x[i], tree) for tree in (sample.contacts, sample.actuation))
        limits = reference.Limits(posture.jacobians, posture.gravity_torque, posture.limit, posture.mask)
        where = sets.points, sets.frames, sets.friction, sample.coms[i], sample.velocities[i]
        program = reference.state_of(*where, limits, spin=momentum[i], box=sample.box[i])
        first = reference.least_acceleration(program, 0.0)
        assert (first is not None) == feasible[i]
        if first is not None:
            np.testing.assert_allclose(lowest[i], first.value, rtol=1e-8, atol=1e-9)
            np.testing.assert_allclose(stops[i], reference.max_speed(program), rtol=1e-6, atol=1e-9)


def test_margin_and_verdict_follow_from_speeds_and_effort(sample, found):
    speed = np.linalg.norm(sample.velocities, axis=1)
    walks = found.max_speed - speed
    walks = np.where(found.min_speed > 0, np.minimum(walks, speed - found.min_speed), walks)
    unheld = np.isfinite(found.effort) & (found.effort > 1)
    lacking = 0.5 * (1 - np.where(unheld, found.effort, 1))
    np.testing.assert_allclose(found.margin, np.where(unheld, np.minimum(walks, lacking), walks), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(found.capturable, (found.margin >= 0) & ~unheld)


def test_without_limits_it_is_the_ray_form(sample):
    """All joints masked, and limits that nothing comes near."""
    rays = jaxcap.cone_rays(sample.contacts)
    expected = jax.tree.map(np.asarray, jaxcap.score(rays, sample.coms, sample.velocities))
    no_box = np.zeros(STATES)
    free = _with(sample.actuation, mask=np.zeros(JOINTS, bool))
    for actuation in (free, sample.limited(1e7)):
        answers = sample.scored(actuation=actuation, box=no_box)
        np.testing.assert_array_equal(answers.capturable, expected.capturable)
        np.testing.assert_array_equal(answers.case, expected.case)
        for name in FIGURES:
            kwargs = {"rtol": 1e-6, "atol": 1e-7, "err_msg": name}
            np.testing.assert_allclose(getattr(answers, name), getattr(expected, name), **kwargs)
    assert np.isnan(expected.effort).all()
    answers = sample.scored(actuation=free, box=no_box)
    assert set(answers.effort) <= {0.0, np.inf}


def test_more_never_lowers_the_speed(sample, found):
    stronger, freer = sample.scored(actuation=sample.limited(1.3)), sample.scored(box=sample.box + 0.05)
    rougher = sample.contacts.friction * 1.2
    contacts = jaxcap.ContactSet(sample.contacts.points, sample.contacts.frames, rougher, sample.contacts.mask)
    rough = sample.scored(contacts=contacts)
    for more in (stronger, freer, rough):
        assert (more.max_speed >= found.max_speed * (1 - 1e-9) - 1e-9).all()
        assert (more.max_speed > found.max_speed + 1e-6).any()
    mask = sample.contacts.mask & (np.arange(12) < 8)
    sets = sample.contacts
    less = sample.scored(contacts=jaxcap.ContactSet(sets.points, sets.frames, sets.friction, mask))
    assert (less.max_speed <= found.max_speed * (1 + 1e-9) + 1e-9).all()


def test_effort_scales_as_one_over_the_limit(sample, found):
    half = sample.scored(actuation=sample.limited(0.5))
    np.testing.assert_allclose(half.effort, 2 * found.effort, rtol=1e-9)


def test_a_quarter_turn_and_a_translation_change_nothing(sample, found):
    """The momentum box has the axes of the world, so by other angles it would be another one."""
    turn, shift = rotation(0, 0, np.pi / 2), np.array([3.0, -2.0, 0.5])
    sets, posture = sample.contacts, sample.actuation
    moved = jaxcap.ContactSet(sets.points @ turn.T + shift, turn @ sets.frames, sets.friction)
    turned = _with(posture, jacobians=np.einsum("xy,nkyj->nkxj", turn, posture.jacobians))
    answers = sample.scored(
        contacts=moved, actuation=turned, coms=sample.coms @ turn.T + shift, velocities=sample.velocities @ turn.T
    )
    for name in ("margin", "max_speed", "effort"):
        np.testing.assert_allclose(getattr(answers, name), getattr(found, name), rtol=1e-8, atol=1e-9, err_msg=name)


def test_order_of_contacts_and_joints_changes_nothing(sample, found):
    rng = np.random.default_rng(3)
    rows, joints = rng.permutation(12), rng.permutation(JOINTS)
    sets, posture = sample.contacts, sample.actuation
    contacts = jaxcap.ContactSet(sets.points[:, rows], sets.frames[:, rows], sets.friction[:, rows])
    jacobians = posture.jacobians[:, rows][..., joints]
    actuation = Actuation(jacobians, posture.gravity_torque[:, joints], posture.limit[:, joints])
    answers = sample.scored(contacts=contacts, actuation=actuation)
    for name in ("margin", "max_speed", "effort"):
        np.testing.assert_allclose(getattr(answers, name), getattr(found, name), rtol=1e-8, atol=1e-9, err_msg=name)


def test_what_is_said_of_masked_contacts_and_joints_is_ignored(sample):
    hand = np.arange(12) >= 8
    sets, posture = sample.contacts, sample.actuation
    without = jaxcap.ContactSet(sets.points, sets.frames, sets.friction, np.broadcast_to(~hand, (STATES, 12)))
    arm = np.arange(JOINTS) >= 2 * CHAIN
    clean = sample.scored(contacts=without, actuation=_with(posture, mask=~arm))
    nonsense = np.where(hand[:, None, None] | arm, np.nan, posture.jacobians)
    limit = np.where(arm, np.nan, posture.limit)
    spoilt = sample.scored(contacts=without, actuation=_with(posture, jacobians=nonsense, limit=limit, mask=~arm))
    for one, other in zip(clean, spoilt, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_bad_row_leaves_the_others_alone(sample, found):
    jacobians, torque = sample.actuation.jacobians.copy(), sample.actuation.gravity_torque.copy()
    jacobians[3, 1, 0, 0], torque[40, 2] = np.nan, np.inf
    answers = sample.scored(actuation=_with(sample.actuation, jacobians=jacobians, gravity_torque=torque))
    bad = np.isin(np.arange(STATES), [3, 40])
    assert (answers.status[bad] == Status.NONFINITE).all() and not answers.capturable[bad].any()
    assert np.isnan(answers.effort[bad]).all()
    for one, other in zip(answers, found, strict=True):
        np.testing.assert_array_equal(one[~bad], other[~bad])


def test_a_passive_joint_is_legal(sample):
    limit = sample.actuation.limit.copy()
    limit[:, -1] = 0
    answers = sample.scored(actuation=_with(sample.actuation, limit=limit))
    assert (answers.status == Status.OK).all()
    assert (answers.max_speed <= sample.scored().max_speed + 1e-9).all()


def test_single_precision_gives_the_verdict_of_double(sample, found):
    single = jax.tree.map(lambda x: x if x.dtype == bool else x.astype(np.float32), sample)
    answers = single.scored()
    assert answers.margin.dtype == np.float32 and (answers.status == Status.OK).all()
    differ = answers.capturable != found.capturable
    assert np.abs(found.margin[differ]).max(initial=0) < 1e-3
    finite = np.isfinite(found.effort)
    np.testing.assert_allclose(answers.effort[finite], found.effort[finite], rtol=1e-3)


@jax.jit
def _slope(rays, place, along):
    """Margin and effort of one state, and their derivatives."""

    def figures(jacobians, torque, limit, com, velocity):
        out = jaxcap.capturability(rays, com, velocity, actuation=Actuation(jacobians, torque, limit))
        return jnp.stack([out.margin, out.effort])

    return jax.jvp(figures, place, along)


def test_one_state_is_a_row_of_many_and_gradients_are_central_differences(sample, found):
    """In Jacobians, torques, limits, position and velocity, where joints bind.

    Jacobians change as those of a rigid limb do, or forces that share a load in many ways would each count for itself.
    """
    free = sample.scored(actuation=sample.limited(1e7))
    binds = (found.effort < 0.9) & (found.max_speed > 0.1) & (found.max_speed < 0.95 * free.max_speed)
    row = int(np.flatnonzero(binds & (sample.box == 0) & (found.case == jaxcap.Case.C3_1))[0])
    sets, posture = (jax.tree.map(lambda x: x[row], tree) for tree in (sample.contacts, sample.actuation))
    rays = jax.tree.map(jnp.asarray, jaxcap.cone_rays(sets))
    place = tuple(map(jnp.asarray, (*jax.tree.leaves(posture)[:3], sample.coms[row], sample.velocities[row])))
    rng = np.random.default_rng(0)
    shift, turn = rng.normal(size=(2, 3, JOINTS))
    rigid = shift[None] + np.cross(turn.T[None], sets.points[:, None]).transpose(0, 2, 1)
    rigid *= np.abs(posture.jacobians).max(axis=1, keepdims=True) > 0
    for k in range(len(place)):
        change = rigid if k == 0 else rng.normal(size=place[k].shape)
        along = tuple(jnp.asarray(change) if i == k else jnp.zeros_like(x) for i, x in enumerate(place))
        value, slope = _slope(rays, place, along)
        np.testing.assert_allclose(value, [found.margin[row], found.effort[row]], rtol=1e-9)
        step = 1e-6
        moved = (tuple(x + sign * step * d for x, d in zip(place, along, strict=True)) for sign in (1, -1))
        ahead, behind = (_slope(rays, values, along)[0] for values in moved)
        assert np.abs(slope[1 if k < 4 else 0]) > 1e-3
        np.testing.assert_allclose(slope, (ahead - behind) / (2 * step), rtol=2e-4, atol=1e-6, err_msg=str(k))


def test_reverse_mode_is_forward_mode(sample):
    """In limits and position: a product with a change one way is that with what comes back the other way."""
    sets, posture = (jax.tree.map(lambda x: x[0], tree) for tree in (sample.contacts, sample.actuation))
    rays = jaxcap.cone_rays(sets)

    def figures(limit, com):
        out = jaxcap.capturability(rays, com, sample.velocities[0], actuation=_with(posture, limit=limit))
        return jnp.stack([out.max_speed, out.margin, out.effort])

    places, rng = (jnp.asarray(posture.limit), jnp.asarray(sample.coms[0])), np.random.default_rng(2)
    forwards = jax.jit(lambda change: jax.jvp(figures, places, change)[1])
    backwards = jax.jit(lambda weights: jax.vjp(figures, *places)[1](weights))
    for name, weights in zip(("max_speed", "margin", "effort"), np.eye(3), strict=True):
        slopes = backwards(weights)
        assert all(np.abs(slope).max() > 0.1 for slope in slopes), name
        for _ in range(3):
            change = tuple(jnp.asarray(rng.normal(size=place.shape)) for place in places)
            back = sum(np.sum(slope * part) for slope, part in zip(slopes, change, strict=True))
            np.testing.assert_allclose(weights @ forwards(change), back, rtol=1e-9, atol=1e-12)


def test_wrong_shapes_and_values_are_named():
    jacobians, torque, limit = np.zeros((4, 3, 2)), np.zeros(2), np.ones(2)
    for field, arguments in {
        "jacobians": (np.zeros((4, 2)), torque, limit),
        "gravity_torque": (jacobians, np.zeros(3), limit),
        "limit": (jacobians, torque, np.ones(3)),
        "limit[1] = -1.0": (jacobians, torque, [1.0, -1.0]),
        "limit[0] = inf": (jacobians, torque, [np.inf, 1.0]),
        "limit[0] = nan": (jacobians, torque, [np.nan, 1.0]),
        "mask": (jacobians, torque, limit, np.ones(2)),
    }.items():
        with pytest.raises(ValueError, match=field.replace("[", r"\[").replace("]", r"\]")):
            Actuation(*arguments)
    assert Actuation(jacobians, torque, [np.nan, 1.0], mask=[False, True]).mask.sum() == 1


def test_actuation_of_other_contacts_or_postures_is_named(sample):
    rays = jaxcap.cone_rays(sample.contacts)
    call = lambda rays=rays, **kwargs: jaxcap.score(rays, sample.coms, sample.velocities, **kwargs)
    posture = sample.actuation
    with pytest.raises(TypeError, match=r"actuation.jacobians: 11 contacts, for 48 rays"):
        call(actuation=_with(posture, jacobians=posture.jacobians[:, :11]))
    with pytest.raises(TypeError, match="actuation has 63 rows"):
        call(actuation=jax.tree.map(lambda x: x[:63], posture))
    with pytest.raises(ValueError, match="momentum_box = -1"):
        call(momentum_box=-1.0)
    cone = jaxcap.centroidal_cone(jax.tree.map(lambda x: x[0], sample.contacts))
    with pytest.raises(TypeError, match="rays"):
        call(cone, actuation=posture)


def test_no_program_waits_for_the_threads_that_run_it(sample):
    """LAPACK's kernels do, and two programs side by side then wait for ever: `bounded_simplex.inverse_of`."""
    limited = actuated(jaxcap.cone_rays(sample.contacts), sample.actuation, sample.box, STATES)
    lanes = jax.tree.map(lambda x: jnp.moveaxis(jnp.asarray(x), 0, -1), (limited, sample.coms, sample.velocities))
    program = jax.jit(lambda *state: motion_of_lanes(*state, GRAVITY)).lower(*lanes).as_text()
    assert "stablehlo.while" in program
    assert "custom_call" not in program.replace("custom_call @Sharding", "")
