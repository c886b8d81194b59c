"""How soon a limb is at a place, and where it cannot go: by hand, and what is refused."""

import jax
import numpy as np
import pytest

import jaxcap

PLACES = np.array([[0.3, 0.4, 0], [0, 0, 0], [-0.6, 0, 0.8], [0, 0, 2.0]])
PALMS = [jaxcap.rectangle(place, np.eye(3), 0.05, 0.04, 0.5) for place in PLACES]


def test_distance_over_speed_after_the_reaction():
    """To the middle of the palm, whatever its rows; a limb for each state is a row each."""
    found = jaxcap.limb_reach(PALMS, [0, 0, 0], 2.0, 0.1)
    np.testing.assert_allclose(found.delay, [0.35, 0.1, 0.6, 1.1], rtol=1e-12)
    assert found.reachable.all()
    rows = jaxcap.limb_reach(PALMS, [[0, 0, 0], [0, 0, 2.0]], 2.0, 0.1)
    np.testing.assert_array_equal(rows.delay[0], found.delay)
    assert rows.delay.shape == rows.reachable.shape == (2, 4) and abs(rows.delay[1, 3] - 0.1) < 1e-12
    moved = jaxcap.limb_reach([one.padded(9) for one in PALMS], [0, 0, 0], 2.0, 0.1)
    np.testing.assert_array_equal(moved.delay, found.delay)


def test_an_outstretched_limb_ends_somewhere():
    """The root decides that, wherever hand or foot are now; a longer limb reaches no less."""
    found = jaxcap.limb_reach(PALMS, [9, 9, 9], 1.0, root=[0, 0, 1], length=1.001)
    assert found.reachable.tolist() == [False, True, True, True]
    each = jaxcap.limb_reach(PALMS, np.zeros((2, 3)), 1.0, root=[[0, 0, 1], [0, 0, 2]], length=1.001)
    assert each.reachable.tolist() == [[False, True, True, True], [False, False, False, True]]
    reached = [jaxcap.limb_reach(PALMS, [0, 0, 0], 1.0, root=[0, 0, 1], length=length).reachable for length in (0.5, 1.2, 3)]
    assert [mask.sum() for mask in reached] == [0, 4, 4]


def test_what_is_not_finite_is_out_of_reach_and_spoils_no_other():
    palms = jax.tree.map(lambda *leaves: np.stack(leaves), *PALMS)
    palms.points[0, 2] = np.nan
    palms.mask[1] = False
    found, whole = (jaxcap.limb_reach(sets, [[0, 0, 0], [np.nan, 0, 0]], 2.0, 0.1) for sets in (palms, PALMS))
    assert found.reachable.tolist() == [[False, False, True, True], [False] * 4]
    np.testing.assert_array_equal(found.delay[0, 2:], whole.delay[0, 2:])
    np.testing.assert_array_equal(found.delay[~found.reachable], 0.1)
    rootless = jaxcap.limb_reach(PALMS, [0, 0, 0], 2.0, root=[np.nan, 0, 0], length=1.0)
    assert not rootless.reachable.any() and np.isfinite(rootless.delay).all()


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"candidates": []}, ValueError, "candidates: none"),
        ({"candidates": PALMS[0]}, TypeError, "candidates: a ContactSet with points of shape"),
        ({"limb": [0, 0]}, TypeError, r"limb: int64 of shape \(2,\) \(expected numbers, \(3,\), or \(n, 3\)\)"),
        ({"speed": 0.0}, ValueError, r"speed = 0.0 \(expected a positive number of metres per second\)"),
        ({"speed": np.nan}, ValueError, "speed = nan"),
        ({"reaction": -0.1}, ValueError, "reaction = -0.1"),
        ({"root": [0, 0, 0]}, ValueError, r"root is given alone \(expected root and length, or neither\)"),
        ({"length": 1.0}, ValueError, "length is given alone"),
        ({"root": [0, 0, 0], "length": np.inf}, ValueError, "length = inf"),
        (
            {"root": np.zeros((2, 3)), "length": 1.0},
            TypeError,
            r"root has shape \(2, 3\) \(expected \(3,\), or \(3,\), as limb",
        ),
    ],
)
def test_what_cannot_be_is_named(change, error, words):
    given = {"candidates": PALMS, "limb": [0, 0, 0], "speed": 1.0}
    with pytest.raises(error, match=words):
        jaxcap.limb_reach(**given | change)
