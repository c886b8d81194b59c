"""The next contact: in closed form over flat ground, and by its laws."""

import jax
import numpy as np
import pytest
from samplers import rotation
from scipy.spatial import ConvexHull

import jaxcap
from jaxcap import Progress, Status

pytestmark = pytest.mark.usefixtures("x64")
HEIGHT = 0.8
OMEGA = np.sqrt(9.81 / HEIGHT)
TOES = 0.1
FRICTION = 3.0  # ample


UP = np.eye(3)


def foot(x, y, z=0.0, frame=UP, friction=FRICTION):
    return jaxcap.rectangle([x, y, z], frame, 0.1, 0.05, friction)


FEET = foot(0, 0.1) + foot(0, -0.1)
WALL = rotation(0, -np.pi / 2, 0)  # its normal is -x
# Programs are shared: 8 contacts and 4 more, at most 64 pairs.
HANDS = [foot(0.6, y, z, WALL, 0.8) for y in (-0.3, 0, 0.3) for z in (0.6, 1.0)] + [foot(0.4, 0, friction=0.6)]
COMS = np.array([[0.05, 0, HEIGHT], [0.08, 0.03, 0.85], [-0.3, 0, 0.9]])
VELOCITIES = np.array([[0.7, 0.1, 0], [0.5, -0.1, 0.05], [0.6, 0, -0.1]])


def joined(contacts, candidates):
    return jax.tree.map(lambda *leaves: np.stack(leaves), *[contacts + one for one in candidates])


def scored(coms, velocities, candidates=HANDS, **options):
    """By `score`, of every state with every candidate."""
    n, m = len(coms), len(candidates)
    cones = jaxcap.cone_rays(joined(FEET, candidates))
    every = jax.tree.map(lambda leaf: np.tile(np.asarray(leaf), (n, *[1] * (leaf.ndim - 1))), cones)
    found = jaxcap.score(every, np.repeat(coms, m, axis=0), np.repeat(velocities, m, axis=0), **options)
    return jax.tree.map(lambda field: np.asarray(field).reshape(n, m), found)


def test_no_delay_is_the_score_of_the_joined_set_to_the_bit():
    found, expected = jaxcap.next_contacts(FEET, COMS, VELOCITIES, HANDS, 0.0), scored(COMS, VELOCITIES)
    for name in ("margin", "capturable", "case", "status"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    without = jaxcap.score(jaxcap.cone_rays(FEET), COMS, VELOCITIES).margin
    np.testing.assert_allclose(found.margin_without, np.repeat(np.asarray(without)[:, None], 7, axis=1), rtol=1e-9)


def test_a_delay_is_the_score_of_the_state_at_touchdown():
    """One delay for all, and one for each candidate."""
    delays = np.array([0.05, 0.1, 0.1, 0.02, 0.1, 0.15, 0.08])
    found = jaxcap.next_contacts(FEET, COMS, VELOCITIES, HANDS, delays)
    for i, delay in enumerate(delays):
        then = jaxcap.advance(jaxcap.cone_rays(FEET), COMS, VELOCITIES, delay)
        usable = then.progress != Progress.LEAVES
        expected = scored(then.com, np.asarray(then.com_velocity)).margin[:, i]
        np.testing.assert_allclose(found.margin[usable, i], expected[usable], rtol=1e-9)
        assert np.isnan(found.margin[~usable, i]).all()
        alike = jaxcap.next_contacts(FEET, COMS, VELOCITIES, HANDS, delay)
        np.testing.assert_allclose(found.margin[:, i], alike.margin[:, i], rtol=1e-9)
        np.testing.assert_allclose(found.margin_without[:, i], alike.margin_without[:, i], rtol=1e-9)


def test_angular_momentum_is_that_at_touchdown():
    """As `advance` and `score` have it; none is the answer without, to the bit."""
    momenta, without = (
        np.array([[0, 0.2, 0], [0.05, -0.1, 0.1], [0, 0.1, 0]]),
        jaxcap.next_contacts(FEET, COMS, VELOCITIES, HANDS, 0.05),
    )
    found = jaxcap.next_contacts(FEET, COMS, VELOCITIES, HANDS, 0.05, specific_angular_momentum=momenta)
    then = jaxcap.advance(jaxcap.cone_rays(FEET), COMS, VELOCITIES, 0.05, specific_angular_momentum=momenta)
    usable = np.asarray(then.progress != Progress.LEAVES)
    assert usable.sum() >= 2
    each = np.repeat(np.asarray(then.specific_angular_momentum), len(HANDS), axis=0)
    expected = scored(then.com, np.asarray(then.com_velocity), specific_angular_momentum=each).margin
    np.testing.assert_allclose(found.margin[usable], expected[usable], rtol=1e-9)
    assert (np.abs(found.margin_without - without.margin_without)[usable] > 1e-3).all()
    zero = jaxcap.next_contacts(FEET, COMS, VELOCITIES, HANDS, 0.05, specific_angular_momentum=0 * momenta)
    np.testing.assert_array_equal(zero.margin, without.margin)
    with pytest.raises(TypeError, match=r"specific_angular_momentum has shape \(3,\) \(expected \(3, 3\), as com\)"):
        jaxcap.next_contacts(FEET, COMS, VELOCITIES, HANDS, 0.05, specific_angular_momentum=[0, 0.1, 0])


def test_a_momentum_box_counts_before_touchdown_and_after_it():
    """As `advance` and `score` have it; at once it never hurts, and zero is the answer without, to the bit."""
    options = {"momentum_box": 0.2}
    found = jaxcap.next_contacts(FEET, COMS, VELOCITIES, HANDS, 0.05, **options)
    then = jaxcap.advance(jaxcap.cone_rays(FEET), COMS, VELOCITIES, 0.05, **options)
    usable = ~np.isin(then.progress, [Progress.LEAVES, Progress.TURNS])
    expected = scored(then.com, np.asarray(then.com_velocity), **options)
    np.testing.assert_allclose(found.margin[usable], expected.margin[usable], rtol=1e-9)
    assert usable.sum() > 1 and np.isnan(found.margin[~usable]).all()
    at_once, without = (jaxcap.next_contacts(FEET, COMS, VELOCITIES, HANDS, 0.0, momentum_box=box) for box in (0.2, 0.0))
    sure = np.isfinite(without.margin)
    assert (at_once.margin >= without.margin - 1e-9)[sure].all() and (at_once.margin_without > without.margin_without).any()
    plain = jaxcap.next_contacts(FEET, COMS, VELOCITIES, HANDS, 0.0)
    np.testing.assert_array_equal(without.margin, plain.margin)


def test_the_capture_point():
    """All feet lifted, a point to step on at once: the margin is the distance from the capture point, in speed."""
    places, speed = np.linspace(-0.1, 0.6, 29), 0.9
    points = [jaxcap.ContactSet([[x, 0, 0]], np.eye(3), FRICTION).padded(4) for x in places]
    found = jaxcap.next_contacts(FEET, [0.05, 0, HEIGHT], [speed, 0, 0], points, 0.0, lifted=range(8))
    beyond = OMEGA * (places - 0.05)
    expected = np.where(beyond >= 0, -np.abs(speed - beyond), -speed)
    np.testing.assert_allclose(found.margin, expected, atol=1e-9)
    point = jaxcap.capture_point(np.array([0.05, 0, HEIGHT]), np.array([speed, 0, 0]), HEIGHT)
    assert found.best == np.argmin(np.abs(places - float(point[0])))
    at_it = jaxcap.ContactSet([[float(point[0]), 0, 0]], np.eye(3), FRICTION).padded(4)
    found = jaxcap.next_contacts(FEET, [0.05, 0, HEIGHT], [speed, 0, 0], [at_it], 0.0, lifted=range(8))
    assert abs(found.margin[0]) < 1e-9


@pytest.mark.parametrize(("speed", "delay"), [(0.6, 0.1), (0.8, 0.2), (0.9, 0.3)])
def test_the_one_step_region_of_the_inverted_pendulum(speed, delay):
    """Koolen et al. 2012, finite feet: the pendulum tips about the toes until the step, then about the hull of all feet."""
    places = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 9), np.linspace(-0.3, 0.3, 6)), axis=-1).reshape(-1, 2)
    steps = [foot(*place) for place in places]
    found = jaxcap.next_contacts(FEET, [0, 0, HEIGHT], [speed, 0, 0], steps, delay)
    cosh, sinh = np.cosh(OMEGA * delay), np.sinh(OMEGA * delay)
    x, v = TOES - TOES * cosh + speed / OMEGA * sinh, speed * cosh - TOES * OMEGA * sinh

    def exit_of(step):
        hull = ConvexHull(np.concatenate([FEET.points, step.points])[:, :2]).equations
        ahead = hull[hull[:, 0] > 1e-12]
        return np.min(-(ahead[:, 2]) / ahead[:, 0])  # where the line y = 0 leaves it

    expected = np.array([OMEGA * max(exit_of(step) - x, 0) - v for step in steps])
    np.testing.assert_allclose(found.margin, expected, atol=1e-6)
    np.testing.assert_array_equal(found.capturable, expected >= 0)
    assert 0 < found.capturable.sum() < len(steps)
    np.testing.assert_allclose(found.margin_without, OMEGA * max(TOES - x, 0) - v, atol=1e-6)


def test_a_candidate_that_is_a_contact_already_changes_nothing():
    found = jaxcap.next_contacts(FEET, COMS, VELOCITIES, [foot(0, 0.1), foot(0, -0.1)], 0.05)
    np.testing.assert_allclose(found.margin, found.margin_without, rtol=1e-9)


def test_friction_and_more_candidates_never_hurt():
    slippery = [jaxcap.ContactSet(one.points, one.frames, one.friction / 2) for one in HANDS]
    found, less = (jaxcap.next_contacts(FEET, COMS, VELOCITIES, hands, 0.05) for hands in (HANDS, slippery))
    known = ~np.isnan(found.margin)
    assert known.sum() > 6
    assert (found.margin[known] >= less.margin[known] - 1e-9).all()
    assert (found.margin[known] >= found.margin_without[known] - 1e-9).all()
    few = jaxcap.next_contacts(FEET, COMS, VELOCITIES, HANDS[:3], 0.05)
    largest = lambda margins: np.max(np.where(np.isnan(margins), -np.inf, margins), axis=1)
    assert (largest(found.margin) >= largest(few.margin)).all()


def test_the_latest_delay_is_where_the_verdict_changes():
    """And a shorter one never hurts."""
    state, steps = (COMS[:1], VELOCITIES[:1]), [foot(x, 0.05) for x in (-0.2, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)]
    found = jaxcap.next_contacts(FEET, *state, steps, 0.0, horizon=0.5)
    known = found.latest[0] < 0.5
    assert known.sum() >= 3
    at = lambda delay: jaxcap.next_contacts(FEET, *state, steps, np.where(known, delay, 0)[None]).capturable[0]
    latest = np.nan_to_num(found.latest[0])
    assert at(latest)[known].all() and at(latest / 2)[known].all() and not at(latest + 1e-4)[known].any()
    np.testing.assert_array_equal(np.isnan(found.latest), ~found.capturable)
    assert np.isnan(found.latest).any()


def test_a_bad_one_spoils_no_other():
    """A candidate that is NaN, one out of reach, one without contacts; a state that is NaN, one that falls at once."""
    hands = jax.tree.map(lambda *leaves: np.stack(leaves), *HANDS)
    hands.points[1], hands.mask[3] = np.nan, False
    coms = np.concatenate([COMS[:1], [[np.nan, 0, 1]]])
    reach = np.arange(7) != 2
    found = jaxcap.next_contacts(FEET, coms, VELOCITIES[:2], hands, 0.0, reachable=reach)
    whole = jaxcap.next_contacts(FEET, coms, VELOCITIES[:2], HANDS, 0.0)
    good = [0, 4, 5, 6]
    np.testing.assert_array_equal(found.margin[0, good], whole.margin[0, good])
    assert np.isnan(found.margin[0, [1, 2, 3]]).all() and not found.capturable[:, [1, 2, 3]].any()
    assert found.status[0, 1] == Status.NONFINITE and (found.status[1] == Status.NONFINITE).all()
    assert found.best.tolist() == [good[int(np.argmax(found.margin[0, good]))], -1]


def test_a_robot_that_rests_is_safe_with_any():
    found = jaxcap.next_contacts(FEET, [0, 0, HEIGHT], [0.05, 0, 0], HANDS, 0.5)
    assert found.capturable.all() and (found.progress == Progress.RESTS).all() and np.isnan(found.margin).all()
    assert found.best == 0 and found.saves is None


def test_the_limits_of_the_joints():
    """An arm that bears anything changes nothing, and then it is said to be saved; one that bears nothing is no contact."""
    jacobians = np.zeros((2, 12, 3, 4))
    jacobians[:, 8:, 0, 0] = 1  # one joint carries what the hand presses on the wall
    answers = []
    for limit in (1e6, 1e-6):
        limits = jaxcap.Actuation(jacobians, np.zeros((2, 4)), np.full((2, 4), limit))
        answers.append(jaxcap.next_contacts(FEET, COMS[0], VELOCITIES[0], HANDS[:2], 0.02, actuation=limits))
    strong, weak = answers
    plain = jaxcap.next_contacts(FEET, COMS[0], VELOCITIES[0], HANDS[:2], 0.02)
    np.testing.assert_allclose(strong.margin_without, plain.margin_without, rtol=1e-6)
    np.testing.assert_array_equal(strong.saves, plain.capturable)
    assert plain.capturable.all() and not weak.saves.any()
    np.testing.assert_allclose(weak.margin, plain.margin_without, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"candidates": []}, ValueError, "candidates: none"),
        ({"candidates": HANDS[0]}, TypeError, r"candidates: a ContactSet with points of shape \(4, 3\)"),
        ({"delay": -0.1}, ValueError, r"delay = -0.1 \(expected a finite number of seconds, not negative\)"),
        ({"delay": [0.1] * 6 + [np.nan]}, ValueError, r"delay\[6\] = nan"),
        ({"delay": [0.1] * 3}, TypeError, r"delay has shape \(3,\) \(expected one number, or \(7,\)\)"),
        ({"horizon": np.inf}, ValueError, "horizon = inf"),
        ({"lifted": [8]}, ValueError, r"lifted\[0\] = 8 \(expected a row of contacts"),
        ({"lifted": 0.5}, ValueError, "lifted: float64"),
        ({"reachable": np.ones(3, bool)}, TypeError, r"reachable: bool of shape \(3,\)"),
        ({"com": np.zeros(2)}, TypeError, r"have shapes \(2,\), \(3,\)"),
    ],
)
def test_what_cannot_be_is_named(change, error, words):
    given = {"contacts": FEET, "com": np.zeros(3), "com_velocity": np.ones(3), "candidates": HANDS, "delay": 0.1}
    with pytest.raises(error, match=words):
        jaxcap.next_contacts(**given | change)
