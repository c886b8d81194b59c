"""A posture's limits by faces: consistent with rays, with linear programs, and with what must be so."""

import re
from itertools import product
from pathlib import Path

import jax
import numpy as np
import pytest
from samplers import hinges, limited_stance, rotation
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

import jaxcap
from jaxcap import Actuation, Status
from jaxcap.contacts import sums
from jaxcap.contacts.actuated_cone import NOTHING, faces_of
from jaxcap.contacts.cone import stance_of
from jaxcap.contacts.limbs import Loads
from jaxcap.contacts.sums import TooManyFacesError, faces_of_sum
from reference import robot_limits as reference

pytestmark = pytest.mark.usefixtures("x64")
DATA = Path(reference.__file__).parent / "tsid" / "data"
WEIGHT, JOINTS, STATES = 9.81, 6, 64
FIGURES = ("margin", "min_speed", "max_speed", "effort", "paper_margin", "distance", "time", "residual_speed")
BOX = 0.1


def stance(seed=3):
    contacts, posture = limited_stance(seed)
    return jaxcap.ContactSet(*contacts), Actuation(*posture)


CONTACTS, POSTURE = stance()
HAND = np.arange(JOINTS) >= 3
ARM = Actuation(POSTURE.jacobians, POSTURE.gravity_torque, POSTURE.limit, HAND)


def states(seed=0, n=STATES):
    rng = np.random.default_rng(seed)
    return np.array([0.15, 0, 0.8]) + rng.uniform(-0.25, 0.25, (n, 3)), rng.uniform(-0.8, 0.8, (n, 3)) * [1, 1, 0.3]


COMS, VELOCITIES = states()


def changed(actuation=ARM, **fields):
    names = ("jacobians", "gravity_torque", "limit", "mask")
    return Actuation(**{**{name: getattr(actuation, name) for name in names}, **fields})


def loads(contacts=CONTACTS, actuation=ARM):
    return Loads.of(stance_of(contacts, 4), np.asarray(contacts.mask), actuation, WEIGHT)


def scored(cone, coms=COMS, velocities=VELOCITIES, **options):
    return jax.tree.map(np.asarray, jaxcap.score(cone, coms, velocities, **options))


def by_rays(actuation=ARM, box=0.0, contacts=CONTACTS, coms=COMS, velocities=VELOCITIES):
    return scored(jaxcap.cone_rays(contacts), coms, velocities, actuation=actuation, momentum_box=box)


def agree(faces, rays):
    """Verdicts outside 1e-6 m/s, figures to 1e-6."""
    assert (faces.status == rays.status).all() and np.isin(rays.status, (Status.OK, Status.NO_DIRECTION)).all()
    clear = np.abs(rays.margin) > 1e-6
    np.testing.assert_array_equal(faces.capturable[clear], rays.capturable[clear])
    for name in FIGURES:
        one, other = getattr(faces, name)[clear], getattr(rays, name)[clear]
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-8, err_msg=name)


def test_faces_of_a_sum_are_those_of_all_sums():
    """Of three polytopes, whose sums are more than are taken at once, with and without rays."""
    rng = np.random.default_rng(1)
    parts = [rng.normal(size=(20, 3)) for _ in range(3)]
    all_sums = np.array([sum(points) for points in product(*parts)])
    for rays in (np.zeros((0, 3)), np.array([[0.1, 0, 1.0], [-0.1, 0.2, 1], [0, -0.2, 1]])):
        found = faces_of_sum(parts, rays)
        assert len(all_sums) > sums.WHOLE
        np.testing.assert_allclose((found.normals @ all_sums.T).max(axis=1), found.offsets, atol=1e-12)
        assert (found.normals @ rays.T <= 1e-12).all()
        if not len(rays):
            equations = ConvexHull(all_sums).equations
            assert len(found.normals) == len(np.unique(np.round(equations, 9), axis=0))
            points = rng.normal(scale=4, size=(500, 3)).T
            inside = (equations[:, :3] @ points + equations[:, 3:] <= 1e-9).all(axis=0)
            np.testing.assert_array_equal((found.normals @ points <= found.offsets[:, None]).all(axis=0), inside)


@pytest.mark.parametrize("actuation", [ARM, POSTURE], ids=["arm", "arm and leg"])
def test_a_wrench_is_within_the_faces_if_and_only_if_forces_and_torques_make_it(actuation):
    asked = loads(actuation=actuation)
    found = faces_of(asked)
    rays, torques = asked.rays.reshape(-1, 6), asked.torques.reshape(len(asked.limit), -1)
    rng, verdicts = np.random.default_rng(2), []
    for _ in range(60):
        wrench = rng.exponential(size=len(rays)) ** 3 @ rays / 12 + rng.normal(scale=0.02, size=6)
        program = linprog(
            np.zeros(len(rays)),
            A_eq=rays.T,
            b_eq=wrench,
            A_ub=np.concatenate([torques, -torques]),
            b_ub=np.concatenate([asked.gravity + asked.limit, asked.limit - asked.gravity]),
        )
        room = (found.offsets - found.normals @ wrench).min()
        if abs(room) > 1e-6:
            assert (room > 0) == (program.status == 0)
            verdicts.append(room > 0)
    assert 5 < sum(verdicts) < len(verdicts) - 5


def test_effort_by_faces_is_that_of_the_linear_program():
    effort = jaxcap.actuated_cone(CONTACTS, ARM).effort
    limits = reference.Limits(*(np.asarray(field) for field in (ARM.jacobians, ARM.gravity_torque, ARM.limit, ARM.mask)))
    origin, expected, found = CONTACTS.points.mean(axis=0), [], []
    for com in COMS[:40]:
        state = reference.state_of(CONTACTS.points, CONTACTS.frames, CONTACTS.friction, com, np.ones(3), limits)
        expected.append(reference.effort(state))
        up = np.array([0, 0, WEIGHT])
        wrench = np.concatenate([up, np.cross(com - origin, up)])
        held = (effort.held @ wrench <= effort.room).all()
        found.append((effort.per_wrench @ wrench + effort.constant).max() if held else np.inf)
    np.testing.assert_allclose(found, expected, rtol=1e-7)
    assert np.isfinite(expected).sum() > 5 and len(set(np.round(expected, 6))) > 10


def test_a_joint_that_gravity_turns_leaves_no_wrench():
    """One that carries nothing, and an arm that no force at its hand relieves."""
    idle = changed(POSTURE, jacobians=POSTURE.jacobians * HAND, gravity_torque=np.where(HAND, 0.1, 5.0))
    assert faces_of(loads(actuation=idle)) is NOTHING
    assert faces_of(loads(actuation=changed(idle, gravity_torque=np.where(HAND, 0.1, 3.0)))) is not NOTHING
    against = changed(mask=np.arange(JOINTS) == 3, gravity_torque=np.full(JOINTS, 50.0))
    verdicts = [
        faces_of(loads(actuation=changed(against, gravity_torque=sign * against.gravity_torque))) for sign in (-1, 1)
    ]
    torques = loads(actuation=against).torques
    for sign, found in zip((-1, 1), verdicts, strict=True):
        assert (found is NOTHING) == (not (sign * torques > 0).any())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"actuation": jax.tree.map(lambda x: x[None].repeat(3, axis=0), ARM)}, "actuation has 3 postures (expected one"),
        ({"actuation": changed(jacobians=ARM.jacobians[:8])}, "actuation.jacobians: 8 contacts (expected 12"),
        ({"actuation": changed(gravity_torque=np.full(JOINTS, np.nan))}, "actuation.gravity_torque is not finite"),
        ({"momentum_box": -1.0}, "momentum_box = -1.0 (expected a number of m^2/s^2, not negative)"),
        ({"gravity": (0, 0, 0)}, "gravity = 0 (expected a direction"),
        ({"sides": 2}, "sides = 2 (expected at least 3)"),
    ],
)
def test_what_cannot_be_is_named(change, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        jaxcap.actuated_cone(**{"contacts": CONTACTS, "actuation": ARM, **change})


def test_a_limb_on_two_links_is_for_rays():
    jacobians = POSTURE.jacobians.copy()
    jacobians[:4, :, 3:] = hinges(np.random.default_rng(5), CONTACTS.points, 0)[:4]
    with pytest.raises(
        ValueError, match=r"contacts 0, 1, 2, 3, 8, 9, 10, 11 share joints and are on several links .*cone_rays"
    ):
        jaxcap.actuated_cone(CONTACTS, changed(jacobians=jacobians))


def test_too_many_faces_are_for_rays(monkeypatch):
    monkeypatch.setattr(sums, "FACES", 100)
    with pytest.raises(TooManyFacesError, match=r"more than 100 faces .*cone_rays"):
        jaxcap.actuated_cone(CONTACTS, ARM)


def test_on_the_host_only():
    with pytest.raises(ValueError, match="outside jit"):
        jax.jit(lambda limit: jaxcap.actuated_cone(CONTACTS, changed(limit=limit)).offsets)(ARM.limit)


@pytest.mark.parametrize("box", [0.0, BOX])
@pytest.mark.parametrize("actuation", [ARM, POSTURE], ids=["arm", "arm and leg"])
def test_faces_and_rays_agree(actuation, box):
    faces = scored(jaxcap.actuated_cone(CONTACTS, actuation, momentum_box=box))
    rays = by_rays(actuation, box)
    agree(faces, rays)
    unheld = (rays.effort > 1) & np.isfinite(rays.effort)
    assert unheld.any() and rays.capturable.sum() > 3


def test_speeds_are_those_of_the_linear_programs():
    """Where the polygon does not go on beyond the static region, for there the robot swings."""
    found = scored(jaxcap.actuated_cone(CONTACTS, ARM))
    limits = reference.Limits(*(np.asarray(field) for field in (ARM.jacobians, ARM.gravity_torque, ARM.limit, ARM.mask)))
    compared = 0
    for i in range(0, STATES, 2):
        where = CONTACTS.points, CONTACTS.frames, CONTACTS.friction, COMS[i], VELOCITIES[i]
        program = reference.state_of(*where, limits)
        s_min, s_max = reference.static_interval(program)
        if s_min <= s_max and reference.farthest(program, 0.0) <= s_max + 1e-7:
            np.testing.assert_allclose(found.max_speed[i], reference.max_speed(program), rtol=1e-6, atol=1e-9)
            compared += found.max_speed[i] > 0
    assert compared > 8


def test_more_never_lowers_the_speed():
    found = scored(jaxcap.actuated_cone(CONTACTS, ARM)).max_speed
    rough = jaxcap.ContactSet(CONTACTS.points, CONTACTS.frames, CONTACTS.friction * 1.2)
    for more in (
        jaxcap.actuated_cone(CONTACTS, changed(limit=ARM.limit * 1.3)),
        jaxcap.actuated_cone(CONTACTS, ARM, momentum_box=BOX),
        jaxcap.actuated_cone(rough, ARM),
    ):
        speeds = scored(more).max_speed
        assert (speeds >= found * (1 - 1e-9) - 1e-9).all() and (speeds > found + 1e-6).any()


def test_without_limits_it_is_the_cone():
    """No joint that counts gives the cone itself; limits that nothing comes near, its answers."""
    plain = jaxcap.centroidal_cone(CONTACTS)
    free = jaxcap.actuated_cone(CONTACTS, changed(mask=np.zeros(JOINTS, bool)))
    np.testing.assert_allclose(free.faces, plain.faces, atol=1e-9)
    np.testing.assert_allclose(free.offsets, 0, atol=1e-9)
    expected = scored(plain)
    for cone in (free, jaxcap.actuated_cone(CONTACTS, changed(limit=ARM.limit * 1e4))):
        found = scored(cone)
        np.testing.assert_array_equal(found.capturable, expected.capturable)
        for name in ("margin", "min_speed", "max_speed"):
            one, other = getattr(found, name), getattr(expected, name)
            endless = np.isinf(other)
            assert (one[endless] > 10).all() and not endless.all()
            np.testing.assert_allclose(one[~endless], other[~endless], rtol=1e-6, atol=1e-8, err_msg=name)


def test_a_passive_joint_is_legal():
    limit = ARM.limit.copy()
    limit[-1] = 0
    passive = changed(limit=limit)
    agree(scored(jaxcap.actuated_cone(CONTACTS, passive)), by_rays(passive))


def test_a_turn_a_translation_and_an_order_change_nothing():
    found = scored(jaxcap.actuated_cone(CONTACTS, ARM))
    turn, shift, rows = rotation(0, 0, 0.7), np.array([3.0, -2.0, 0.5]), np.random.default_rng(4).permutation(12)
    moved = jaxcap.ContactSet(
        (CONTACTS.points @ turn.T + shift)[rows], (turn @ CONTACTS.frames)[rows], CONTACTS.friction[rows]
    )
    turned = changed(jacobians=np.einsum("xy,kyj->kxj", turn, ARM.jacobians)[rows])
    answers = scored(jaxcap.actuated_cone(moved, turned), COMS @ turn.T + shift, VELOCITIES @ turn.T)
    np.testing.assert_array_equal(answers.capturable, found.capturable)
    for name in ("margin", "max_speed", "effort"):
        np.testing.assert_allclose(getattr(answers, name), getattr(found, name), rtol=1e-8, atol=1e-9, err_msg=name)


def test_single_precision_gives_the_verdict_of_double():
    cone = jaxcap.actuated_cone(CONTACTS, ARM)
    found, single = scored(cone), scored(cone, COMS.astype(np.float32), VELOCITIES.astype(np.float32))
    assert single.margin.dtype == np.float32 and (single.status == Status.OK).all()
    differ = single.capturable != found.capturable
    assert np.abs(found.margin[differ]).max(initial=0) < 1e-3
    np.testing.assert_allclose(single.effort, found.effort, rtol=1e-3)


def test_regions_take_it():
    """The velocity area, robustness and the support polygon of one place, against the states that they are made of."""
    cone = jaxcap.actuated_cone(CONTACTS, ARM)
    com, directions = COMS[0] * [0, 0, 1] + [0.05, 0, 0], jaxcap.headings(16)
    area = jaxcap.velocity_area(cone, com, directions)
    expected = scored(cone, np.tile(com, (16, 1)), directions).max_speed
    np.testing.assert_allclose(area.max_speed, expected, rtol=1e-9)
    polygon = jaxcap.support_polygon(cone)
    held = scored(cone, COMS, 0 * VELOCITIES).capturable
    inside = np.asarray(jaxcap.support_distance(polygon, COMS[:, :2])) > 0
    np.testing.assert_array_equal(inside, held)
    assert 5 < held.sum() < STATES - 5


@pytest.mark.parametrize("scenario", ["three", "four"])
def test_faces_and_rays_agree_on_talos(scenario):
    """A posture with one hand, and one with two; what counts are the joints of the arms."""
    pytest.importorskip("pinocchio")
    from bench.limited import limited
    from reference.evaluation.samples import read

    some, row = limited(read(DATA / f"{scenario}.parquet", 4), "arms"), 2
    contacts, posture = (jax.tree.map(lambda x: x[row], tree) for tree in (some.contacts, some.actuation))
    rng = np.random.default_rng(6)
    coms = some.coms[row] + rng.uniform(-0.1, 0.1, (STATES, 3))
    velocities = some.velocities[row] + rng.uniform(-0.2, 0.2, (STATES, 3))
    cone = jaxcap.actuated_cone(contacts, posture)
    agree(scored(cone, coms, velocities), by_rays(posture, 0.0, contacts, coms, velocities))
