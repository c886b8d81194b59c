"""Mutated logs are refused, noted or corrected; and the good ones pass without a word."""

from itertools import permutations

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from bench import log_mutations
from bench.robot_motion import main, motion
from jaxcap import robots
from jaxcap.errors import InputError
from jaxcap.robots import checks


def test_none_of_a_few_passes_in_silence():
    found = log_mutations.table(each=2)
    assert {name: len(fates) for name, fates in found.items()} == dict.fromkeys(log_mutations.MUTATIONS, 2)
    assert {one.word for fates in found.values() for one in fates} <= {"refused", "noted", "corrected"}
    assert {one.word for one in found["degrees"]} == {"refused"}


@pytest.mark.slow
def test_none_of_two_hundred_passes_in_silence(capsys):
    assert log_mutations.main([]) == 0
    assert "| 20 | 20 | 0 | 0 | 0 |" in capsys.readouterr().out


def test_a_quadruped_s_legs_in_any_other_order_are_noted():
    """In positions and velocities alike: within all limits, and velocities agree with differences."""
    robot, one = robots.load("anymal"), motion("anymal", seconds=2.0)
    robots.states_of(robot, one.time, one.q, one.v, strict=True)
    for legs in list(permutations(range(4)))[1:]:
        order = [3 * leg + joint for leg in legs for joint in range(3)]
        q, v = (np.c_[given[:, :-12], given[:, -12:][:, order]] for given in (one.q, one.v))
        with pytest.raises(InputError):
            robots.states_of(robot, one.time, q, v, strict=True)


def test_legs_that_do_not_undo_what_the_base_does_slip():
    touching, slips = np.ones((20, 2), bool), np.full((20, 2), 0.01)
    slips[:9, 1] = 0.9
    assert checks.check_slips(touching, slips, ["a", "b"]) == []  # in fewer than half of the rows
    slips[:11, 1] = 0.9
    (found,) = checks.check_slips(touching, slips, ["a", "b"])
    assert found.kind == "slip" and found.words.startswith("'b' slips while it touches: 90%") and not found.refused
    touching[:11, 1] = False  # not while it touches
    assert checks.check_slips(touching, slips, ["a", "b"]) == []
    assert checks.check_slips(touching, np.full((20, 2), np.nan), ["a", "b"]) == []  # it stands


def test_a_robot_that_stands_beside_its_feet_is_noted():
    points, mask = np.array([[[0.0, -0.1, 0], [0.0, 0.1, 0], [2.0, 0, 0]]] * 9), np.array([[True, True, False]] * 9)
    beside = lambda x: checks.check_support(np.array([[x, 0.05, 0.8]] * 9), points, mask)
    assert beside(0.3) == [] and beside(2.0)[0].words.startswith("the CoM is 2 m beside all that touches, 0.8 m above it")
    mask[:5, 2] = True
    assert beside(2.0) == [] and checks.check_support(np.zeros((9, 3)), points, np.zeros_like(mask)) == []


@pytest.mark.parametrize("name", ["g1", "anymal"])
def test_good_logs_pass_without_a_word(name, tmp_path):
    path = tmp_path / ("log.csv" if name == "g1" else "log.npz")
    main([name, "-o", str(path), "--seconds", "2"])
    log = robots.Log(path, robots.load(name))
    states = next(iter(log))
    assert log.notes == () and states.contact_mask.any(axis=1).all()


def test_feet_stay_where_they_stand():
    one, patches = motion("g1", seconds=2.0), robots.load("g1").patches
    model, (left, right) = robots.load("g1").model, patches.values()
    first = [robots.contact_placement(model, one.q[0], foot) for foot in (left, right)]
    lifted = [max(robots.contact_placement(model, q, foot).position[2] for q in one.q) for foot in (left, right)]
    last = [robots.contact_placement(model, one.q[-1], foot) for foot in (left, right)]
    for before, after, top in zip(first, last, lifted, strict=True):
        assert abs(before.position - after.position).max() < 1e-3 and abs(before.position[2]) < 1e-9 and top > 0.03
