"""Mutated logs are refused, noted or corrected; and the good ones pass without a word."""

import pytest

pytest.importorskip("pinocchio")

from bench import log_mutations
from bench.robot_motion import main, motion
from jaxcap import robots


def test_none_of_a_few_passes_in_silence():
    found = log_mutations.table(each=2)
    assert {name: len(fates) for name, fates in found.items()} == dict.fromkeys(log_mutations.MUTATIONS, 2)
    assert {one.word for fates in found.values() for one in fates} <= {"refused", "noted", "corrected"}
    assert {one.word for one in found["degrees"]} == {"refused"}


@pytest.mark.slow
def test_none_of_two_hundred_passes_in_silence(capsys):
    assert log_mutations.main([]) == 0
    assert "| 20 | 20 | 0 | 0 | 0 |" in capsys.readouterr().out


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
