"""Tables that tell postures apart: they count every sample once, and less effort never adds one."""

import numpy as np
import pytest

from reference.evaluation import postures
from reference.evaluation.margins import MARGINS
from reference.evaluation.roc import difference
from reference.evaluation.samples import BEST, FOUR, MissingFile, Runs, Samples

N = 400
WORDS = np.array(["fallen", "stopped", "undecided"])


@pytest.fixture
def file(monkeypatch):
    """Random outcomes, brake stopping some of what fell; margins that order them but for some noise."""
    random = np.random.default_rng(12)
    best = WORDS[random.choice(3, N, p=[0.5, 0.4, 0.1])]
    four = np.where((best == "fallen") & (random.uniform(size=N) < 0.2), "stopped", best)
    margin = np.where(four == "fallen", -0.2, 0.2) + random.normal(size=N)
    monkeypatch.setattr(postures, "compared", lambda *_: {one.column: margin for one in MARGINS})
    runs = {name: Runs(best, best, np.ones(N)) for name in ("standard", "straight", "fast", "brake")}
    outcomes = {BEST: best, FOUR: four}
    blank = Samples(*[None] * len(Samples._fields))
    return blank._replace(
        name="three", scenario="three", controllers=tuple(runs), index=np.arange(N), outcomes=outcomes,
        robot="talos", runs=runs, effort=random.uniform(0, 2, N), failed=0,
    )  # fmt: skip


def lines(text):
    return [line.strip("| ").split(" | ") for line in text.splitlines()[2:]]


def test_every_sample_is_counted(file, tmp_path):
    found = {
        tuple(line[1:3]): [int(cell) for cell in line[3:6]]
        for line in lines(postures.beside_the_paper({"three": file}, tmp_path))
    }
    for truth in (BEST, FOUR):
        assert sum(found["all", truth]) == N
        assert sum(found["can be held", truth]) == (file.effort <= 1).sum()
        assert found["all", truth] == [(file.outcomes[truth] == word).sum() for word in WORDS]
    assert found["all", FOUR][0] < found["all", BEST][0] and found["all", FOUR][2] == found["all", BEST][2]


def test_the_same_margin_has_the_same_area(file, tmp_path):
    for line in lines(postures.order({"three": file}, tmp_path)):
        assert len(set(line[3 : 3 + len(MARGINS)])) == 1 and line[-1].startswith("+0.0")


def test_what_brake_saves_is_what_the_two_outcomes_differ_by(file, tmp_path):
    saved = [cell.split(" of ")[0] for line in lines(postures.rescued({"three": file}, tmp_path)) for cell in line[2:]]
    assert sum(map(int, saved)) == (file.outcomes[BEST] != file.outcomes[FOUR]).sum()


def test_without_a_best_outcome_there_is_no_table(file, tmp_path):
    with pytest.raises(MissingFile):
        postures.order({"three_ablations": file._replace(outcomes={"standard": file.outcomes[BEST]})}, tmp_path)


def test_in_short_has_the_cells_of_the_long_table(file, tmp_path):
    robots = {"three": file, "arms": file._replace(name="three_strong_arms", robot="talos_strong_arms")}
    found = {tuple(line[:3]): line[6:8] for line in lines(postures.beside_the_paper(robots, tmp_path))}
    first, other = lines(postures.in_short(robots, tmp_path))
    columns = [("all", BEST), ("can be held", BEST), ("can be held", FOUR)]
    assert first[2:5] == [" / ".join(found["three", *column]) for column in columns]
    assert first[0] == "two feet, one hand" and other[0] == "two feet, one hand, strong arms" and first[1:] == other[1:]
    assert first[1] == "400" and first[5] == "74 / 2.3 (standard alone)"


@pytest.mark.parametrize(
    "scenario, robot, told",
    [("two", "talos", "two feet"), ("two", "g1", "two feet, robot G1"), ("two_coplanar", "mine", "two coplanar feet, mine")],
)
def test_robots_are_told_apart(file, tmp_path, scenario, robot, told):
    other = file._replace(scenario=scenario, robot=robot)
    assert postures.title(other) == told
    assert postures.order_in_words({"other": other}, tmp_path).startswith(f"- T{told[1:]}: ")


def test_areas_in_short_count_held_postures(file, tmp_path):
    (line,) = lines(postures.areas_in_short({"three": file}, tmp_path))
    held = file.outcomes[FOUR][file.effort <= 1]
    assert [int(cell) for cell in line[1:3]] == [(held == "fallen").sum(), (held == "stopped").sum()]
    assert len(set(line[3:])) == 1


def test_a_margin_that_knows_is_above_one_that_does_not(file, tmp_path, monkeypatch):
    fell, random = file.outcomes[FOUR] == "fallen", np.random.default_rng(3)
    values = {one.column: random.normal(size=N) for one in MARGINS} | {"margin": np.where(fell, -1.0, 1.0)}
    monkeypatch.setattr(postures, "compared", lambda *_: values)
    assert "the exact margin less the support polygon" in postures.order_in_words({"three": file}, tmp_path)
    assert "as in the paper" in postures.verdict(difference(values["margin"], values["com_speed"], fell))
    assert "the other way round" in postures.verdict(difference(values["com_speed"], values["margin"], fell))
    assert "too few to say" in postures.verdict(difference(values["margin"][:1], values["margin"][:1], fell[:1]))
