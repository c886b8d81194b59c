"""Mutated logs are refused, noted or corrected; and the good ones pass without a word."""

from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pin = pytest.importorskip("pinocchio")

from bench import log_mutations  # noqa: E402
from bench.robot_motion import main, motion  # noqa: E402
from jaxcap import robots  # noqa: E402
from jaxcap.errors import InputError  # noqa: E402
from jaxcap.robots import checks  # noqa: E402
from jaxcap.robots.slip import slips  # noqa: E402


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
    shares = np.full((20, 2), 0.01)
    shares[:9, 1] = 0.9
    assert checks.check_slips(shares, ["a", "b"]) == []  # in fewer than half of the rows
    shares[:11, 1] = 0.9
    (found,) = checks.check_slips(shares, ["a", "b"])
    assert found.kind == "slip" and found.words.startswith("'b' slips while it touches: 90%") and not found.refused
    assert checks.check_slips(np.full((20, 2), np.nan), ["a", "b"]) == []


def test_how_far_a_foot_slips():
    """A base that moves ahead and turns: over a foot at rest, with a foot that it carries along, and over one that lifts."""
    time = np.arange(30) / 50
    q = np.zeros((30, 8))
    q[:, 0], q[:, 5:7] = 0.5 * time, np.stack([np.sin(time / 2), np.cos(time / 2)], axis=1)
    base = Rotation.from_quat(q[:, 3:7])
    rests, carried = np.tile([0.1, 0.2, 0.0], (30, 1)), q[:, :3] + base.apply([0.1, 0.2, 0.0])
    touching = np.ones((30, 3), bool)
    touching[12, 2] = False
    shares = slips(q, np.stack([rests, carried, rests], axis=1), touching, 10)
    assert shares.shape == (20, 3)
    np.testing.assert_allclose(shares[:, 0], 0, atol=1e-12)
    np.testing.assert_allclose(shares[:, 1], 1, atol=1e-12)
    np.testing.assert_array_equal(np.isnan(shares[:, 2]), np.isin(np.arange(20), range(2, 13)))
    feet = np.tile(rests[:, None], (1, 3, 1))
    assert np.isnan(slips(np.tile(q[:1], (30, 1)), feet, touching, 10)).all()  # it stands still
    assert not len(slips(q[:5], feet[:5], touching[:5], 10))


@pytest.mark.parametrize("name", ["g1", "anymal"])
def test_a_robot_that_stands_among_noise_does_not_slip(name):
    """1 mm and 1 mrad in every row, at rest and stepping, velocities by differences."""
    robot, one = robots.load(name), motion(name, seconds=2.0)
    rng = np.random.default_rng(0)
    for still in (True, False):
        rows = np.tile(one.q[:1], (len(one.q), 1)) if still else one.q
        q = np.array([pin.integrate(robot.model, row, 1e-3 * rng.normal(size=robot.model.nv)) for row in rows])
        robots.states_of(robot, one.time, q, strict=True)


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
