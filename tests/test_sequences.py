"""Several next contacts in turn: their laws, `next_contacts` from each touchdown, and in closed form over flat ground."""

import jax
import numpy as np
import pytest
from samplers import rotation

import jaxcap
from jaxcap import ContactStep, Progress, Status
from jaxcap.regions import sequences

pytestmark = pytest.mark.usefixtures("x64")
HEIGHT = 0.8
OMEGA = np.sqrt(9.81 / HEIGHT)
HALF = 0.1  # of a foot's length [m]


UP = np.eye(3)


def foot(x, y, z=0.0, frame=UP, friction=3.0):
    return jaxcap.rectangle([x, y, z], frame, HALF, 0.05, friction)


FEET = foot(0, 0.1) + foot(0, -0.1)
WALL = rotation(0, -np.pi / 2, 0)  # its normal is -x


def edge(x, y, z, frame, friction):
    return jaxcap.ContactSet([[x, y - 0.05, z], [x, y + 0.05, z]], frame, friction)


# Programs are shared, also with the tests of the next contact: 8 contacts, 2 of the first step and 2 of the second.
HANDS = [edge(0.6, y, z, WALL, 0.3) for y, z in ((-0.3, 0.6), (0, 0.6), (0.3, 1.0))] + [edge(0.3, 0, 0, UP, 0.6)]
SECOND = [edge(0.6, y, 0.9, WALL, 0.3) for y in (-0.2, 0.25)] + [edge(0.5, 0.1, 0, UP, 0.6)]
ALONE = [hand.padded(4) for hand in HANDS]
COMS = np.array([[0.05, 0, HEIGHT], [0.08, 0.03, 0.85], [-0.05, 0, 0.9], [0.65, 0, 0.3]])  # the last loses its feet
VELOCITIES = np.array([[0.9, 0.1, 0], [0.8, -0.1, 0.05], [0.2, 0, 0], [2.0, 0, 0]])
ANSWERS = ("margin", "capturable", "case", "status", "progress")


def two_steps(**second):
    return [ContactStep(HANDS, 0.05), ContactStep(SECOND, 0.08)._replace(**second)]


@pytest.fixture(scope="module")
def found():
    with jax.enable_x64(True):
        return jaxcap.contact_sequences(FEET, COMS, VELOCITIES, two_steps())


def row_of(found, i):
    return jax.tree.map(lambda field: field[i], found)


def same(one, other, margins_within=0.0):
    np.testing.assert_allclose(one.margin, other.margin, rtol=margins_within)
    for name in ANSWERS[1:]:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@pytest.mark.parametrize("options", [{}, {"specific_angular_momentum": 0.1 * COMS}, {"momentum_box": 0.2}])
def test_one_step_is_next_contacts_to_the_bit(options):
    """With a box to the last bit but one, for there it counts which states are side by side."""
    for lifted, delay in ((None, 0.05), (range(4), np.array([0.0, 0.03, 0.06, 0.09]))):
        one = jaxcap.next_contacts(FEET, COMS, VELOCITIES, ALONE, delay, lifted=lifted, **options)
        path = jaxcap.contact_sequences(FEET, COMS, VELOCITIES, [ContactStep(ALONE, delay, lifted)], **options)
        same(path, one, 1e-14 if "momentum_box" in options else 0)
        np.testing.assert_array_equal(path.best[:, 0], one.best)
        now = jaxcap.next_contacts(FEET, COMS, VELOCITIES, ALONE, 0.0, **options)
        np.testing.assert_allclose(path.margins[0], now.margin_without[:, 0], rtol=1e-9)


def test_one_state_is_a_row_of_many(found):
    for i in range(2):
        alone = jaxcap.contact_sequences(FEET, COMS[i], VELOCITIES[i], two_steps())
        assert alone.margin.shape == alone.needed.shape == (4, 3) and alone.best.shape == (2,)
        assert [margin.shape for margin in alone.margins] == [(), (4,), (4, 3)]
        same(alone, row_of(found, i), 1e-9)
        np.testing.assert_array_equal(alone.best, found.best[i])


def test_the_second_level_is_next_contacts_from_the_first_touchdown(found):
    """From every path that is not lost, with the joined contacts; and one that is stays lost."""
    first = jaxcap.next_contacts(FEET, COMS, VELOCITIES, ALONE, 0.05)
    np.testing.assert_allclose(found.margins[1], first.margin, rtol=1e-9)
    then = jaxcap.advance(jaxcap.cone_rays(FEET), COMS, VELOCITIES, 0.05)
    lost = np.isin(then.progress, [Progress.LEAVES, Progress.TURNS])
    assert 0 < lost.sum() < len(COMS)
    for i, hand in enumerate(HANDS):
        going_on = jaxcap.next_contacts(FEET + hand, then.com, np.asarray(then.com_velocity), SECOND, 0.08)
        path = found._replace(**{name: getattr(found, name)[~lost, i] for name in ANSWERS})
        same(path, going_on._replace(**{name: getattr(going_on, name)[~lost] for name in ANSWERS}), 1e-9)
    assert np.isnan(found.margin[lost]).all() and not found.capturable[lost].any()
    assert (found.progress[lost] == np.asarray(then.progress)[lost, None, None]).all()


def test_a_second_contact_at_once_is_a_contact_of_both():
    joined = [one + other for one in HANDS for other in SECOND]
    both = jaxcap.next_contacts(FEET, COMS, VELOCITIES, joined, 0.05)
    path = jaxcap.contact_sequences(FEET, COMS, VELOCITIES, two_steps(delay=0.0))
    np.testing.assert_allclose(path.margin.reshape(len(COMS), -1), both.margin, rtol=1e-9)
    np.testing.assert_array_equal(path.capturable.reshape(len(COMS), -1), both.capturable)
    some = both.best >= 0
    np.testing.assert_array_equal(path.best[some], np.stack(np.unravel_index(both.best[some], (4, 3)), axis=-1))
    assert (path.best[~some] == -1).all() and 0 < some.sum() < len(COMS)


def test_what_stops_after_one_step_stops_after_two(found):
    """Where nothing is lifted; and what stops at once needs none."""
    first = jaxcap.next_contacts(FEET, COMS, VELOCITIES, ALONE, 0.05).capturable
    assert found.capturable[first].all() and 0 < first.sum() < first.size
    assert (found.needed[first] <= 1).all() and (found.needed[~first & ~np.isnan(found.margins[1])] != 1).all()
    now = jaxcap.score(jaxcap.cone_rays(FEET), COMS, VELOCITIES).capturable
    np.testing.assert_array_equal(np.all(found.needed == 0, axis=(1, 2)), now)
    np.testing.assert_array_equal(found.needed >= 0, found.capturable)
    assert set(np.unique(found.needed)) == {-1, 0, 1, 2}


def test_the_order_of_candidates_is_their_order(found):
    order = np.array([2, 0, 3, 1])
    mixed = jaxcap.contact_sequences(
        FEET, COMS, VELOCITIES, [ContactStep([HANDS[i] for i in order], 0.05), ContactStep(SECOND[::-1], 0.08)]
    )
    for name in (*ANSWERS, "needed"):
        np.testing.assert_array_equal(getattr(mixed, name), getattr(found, name)[:, order][:, :, ::-1])
    np.testing.assert_array_equal(mixed.margins[1], found.margins[1][:, order])


def test_times_and_reach_of_every_path(found):
    """As limbs would have it: the second contact comes sooner from some of the first, and some are out of reach."""
    delays, reach = np.full((4, 3), 0.08), np.ones((4, 3), bool)
    delays[1], reach[2, 1] = 0.02, False
    each = jaxcap.contact_sequences(FEET, COMS, VELOCITIES, two_steps(delay=delays, reachable=reach))
    soon = jaxcap.contact_sequences(FEET, COMS, VELOCITIES, two_steps(delay=0.02))
    expected = np.where(np.arange(4)[:, None] == 1, soon.margin, found.margin)
    expected[:, 2, 1] = np.nan
    np.testing.assert_allclose(each.margin, expected, rtol=1e-9)
    assert not each.capturable[:, 2, 1].any()
    np.testing.assert_array_equal(each.needed[:, 2, 1], np.where(found.needed[:, 2, 1] < 2, found.needed[:, 2, 1], -1))
    first = two_steps()[0]._replace(reachable=np.arange(4) != 1)
    without = jaxcap.contact_sequences(FEET, COMS, VELOCITIES, [first, two_steps()[1]])
    assert np.isnan(without.margin[:, 1]).all() and not without.capturable[:, 1].any()
    np.testing.assert_array_equal(without.margin[:, [0, 2, 3]], found.margin[:, [0, 2, 3]])


def test_a_bad_one_spoils_no_other(found):
    """Candidates that are NaN or without contacts, in either step; a state that is NaN."""
    hands, second = (jax.tree.map(lambda *leaves: np.stack(leaves), *sets) for sets in (HANDS, SECOND))
    hands.points[1], hands.mask[3], second.points[0, 1] = np.nan, False, np.nan
    coms = np.where(np.arange(4)[:, None] == 2, np.nan, COMS)
    bad = jaxcap.contact_sequences(FEET, coms, VELOCITIES, [ContactStep(hands, 0.05), ContactStep(second, 0.08)])
    good = np.ix_([0, 1, 3], [0, 2], [1, 2])
    for name in (*ANSWERS, "needed"):
        np.testing.assert_array_equal(getattr(bad, name)[good], getattr(found, name)[good])
    others = np.ones(bad.margin.shape, bool)
    others[good] = False
    assert np.isnan(bad.margin[others]).all() and not bad.capturable[others].any()
    assert (bad.status[2] == Status.NONFINITE).all() and (bad.best[2] == -1).all() and (bad.needed[2] == -1).all()
    assert (bad.status[0, 1] == Status.NONFINITE).all() and (bad.status[0, :3, 0] == Status.NONFINITE).all()


def tipped(edge, x, speed, delay):
    """Place and speed of a pendulum that tips about an edge, after a time."""
    cosh, sinh = np.cosh(OMEGA * delay), np.sinh(OMEGA * delay)
    return edge + (x - edge) * cosh + speed / OMEGA * sinh, speed * cosh + (x - edge) * OMEGA * sinh


def test_the_regions_of_the_inverted_pendulum():
    """Koolen et al. 2012, finite feet on one line, from the toes: d_N = (d_{N-1} + l) exp(-omega T), d_0 = 0. Each step
    lifts the foot behind, when the one before has touched down; every path that is open has its margin in closed form too.
    """
    delay, longest = 0.25, 0.35
    first = np.array([0.15, 0.25, longest, 0.5])  # where the feet are put [m]
    second = np.unique(np.round(np.add.outer(first, first), 9))
    reach = lambda stride: (stride > 0.1) & (stride < longest + 1e-9)
    near, paths = reach(first), reach(second - first[:, None])
    steps = [
        ContactStep([foot(x, 0) for x in first], delay, None, near),
        ContactStep([foot(x, 0) for x in second], delay, range(4), paths),
    ]
    regions = np.zeros(3)
    for k in (1, 2):
        regions[k] = (regions[k - 1] + longest) * np.exp(-OMEGA * delay)
    ahead = np.linspace(0.02, regions[2] + 0.08, 12)  # of the toes, the capture point [m]
    assert np.abs(np.subtract.outer(ahead, regions)).min() > 1e-4
    coms, velocities = np.tile([0, 0, HEIGHT], (12, 1)), np.outer(OMEGA * (HALF + ahead), [1, 0, 0])
    found = jaxcap.contact_sequences(foot(0, 0), coms, velocities, steps)
    paths = paths & near[:, None]
    needed = np.where(found.needed < 0, 9, found.needed)[:, paths].min(axis=1)
    np.testing.assert_array_equal(needed, np.where(ahead <= regions[1], 1, np.where(ahead <= regions[2], 2, 9)))
    toes, one = first + HALF, tipped(HALF, 0.0, velocities[:, :1], delay)
    two = tipped(toes, *one, delay)
    far = one[0] + one[1] / OMEGA > toes
    enough = np.broadcast_to((near & ~far)[..., None], found.needed.shape)
    np.testing.assert_array_equal(found.needed == 1, enough)
    beyond = paths & ~enough  # the pendulum tips over the toes of the first step too
    assert beyond.sum() > 40 and (found.progress[beyond] == Progress.ON_THE_WAY).all()
    expected = OMEGA * np.maximum(second + HALF - two[0][..., None], 0) - two[1][..., None]
    np.testing.assert_allclose(found.margin[beyond], expected[beyond], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"steps": []}, ValueError, r"steps: none \(expected at least one ContactStep\)"),
        ({"steps": two_steps(candidates=[])}, ValueError, r"steps\[1\].candidates: none"),
        ({"steps": two_steps(delay=-0.1)}, ValueError, r"steps\[1\].delay = -0.1 \(expected a finite number of seconds"),
        ({"steps": two_steps(delay=[0, np.nan, 0])}, ValueError, r"steps\[1\].delay\[.*1\] = nan"),
        ({"steps": two_steps(delay=[0.1] * 4)}, TypeError, r"steps\[1\].delay has shape \(4,\) \(expected .* \(4, 3\)\)"),
        ({"steps": two_steps(lifted=[3, 10])}, ValueError, r"steps\[1\].lifted\[1\] = 10 \(expected a row of contacts that"),
        ({"steps": two_steps(reachable=[1, 0, 1])}, TypeError, r"steps\[1\].reachable: int64 of shape \(3,\)"),
        ({"com": np.zeros(2)}, TypeError, r"have shapes \(2,\), \(3,\)"),
    ],
)
def test_what_cannot_be_is_named(change, error, words):
    given = {"contacts": FEET, "com": np.zeros(3), "com_velocity": np.ones(3), "steps": two_steps()}
    with pytest.raises(error, match=words):
        jaxcap.contact_sequences(**given | change)


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (ContactStep(HANDS, 0.1), r"steps: ContactStep \(expected a list of ContactStep\)"),
        ([(HANDS, 0.1)], r"steps\[0\]: tuple \(expected a ContactStep\)"),
    ],
)
def test_what_cannot_be_is_named_of_other_types(steps, words):
    """Not from outside: there the types are checked in tests."""
    with pytest.raises(TypeError, match=words):
        sequences._candidates_of(steps)


def test_a_lifted_contact_is_not_lifted_again():
    steps = [ContactStep(HANDS, 0.1, [2, 3]), ContactStep(SECOND, 0.1, [8, 3])]
    with pytest.raises(ValueError, match=r"steps\[1\].lifted\[1\] = 3 .* of \[0, 1, 4, 5, 6, 7, 8, 9\]"):
        jaxcap.contact_sequences(FEET, COMS, VELOCITIES, steps)


def test_a_tree_that_is_too_large_says_how_large():
    step = ContactStep([HANDS[0]] * 26, 0.1)
    with pytest.raises(ValueError, match=rf"26 \* 26 \* 26 = 17,576 paths \(expected at most {sequences.MOST_PATHS:,}"):
        jaxcap.contact_sequences(FEET, COMS, VELOCITIES, [step] * 3)


def test_no_states_have_no_answers():
    none = jaxcap.contact_sequences(FEET, COMS[:0], VELOCITIES[:0], two_steps())
    assert none.margin.shape == none.needed.shape == (0, 4, 3) and none.best.shape == (0, 2)
    one = jaxcap.next_contacts(FEET, COMS[:0], VELOCITIES[:0], ALONE, 0.05)
    assert one.margin.shape == one.margin_without.shape == (0, 4) and one.best.shape == (0,)
