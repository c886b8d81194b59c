"""The engine: units are handed over, tried again, and survive the death of who runs them."""

import os
import signal
import time
from concurrent.futures import Future
from pathlib import Path
from typing import NamedTuple

import pytest

from jaxcap.engine import Here, Place, Shard, Terms, Unit, open_ledger, over_units, processes, shard_of
from jaxcap.errors import InputError

MINUTES = 60.0
"""[s]"""


class Touch(NamedTuple):
    """Work that leaves a mark each time that it runs, and fails, or dies, where it is told to."""

    folder: Path
    deadly: tuple[int, ...] = ()
    """Numbers that kill their process, always."""
    once: tuple[int, ...] = ()
    """Numbers that kill their process the first time."""
    long: tuple[int, ...] = ()
    """Numbers that take MINUTES the first time; before they have begun, none dies."""

    def __call__(self, number: int) -> int:
        mark = self.folder / str(number)
        again = mark.exists()
        with open(mark, "ab") as file:
            file.write(b"x")
        if number in self.deadly or (number in self.once and not again):
            time.sleep(0.2)  # others run beside it
            while not all((self.folder / str(other)).exists() for other in self.long):
                time.sleep(0.05)
            os.kill(os.getpid(), signal.SIGKILL)
        end = time.monotonic() + MINUTES * (number in self.long and not again)
        while time.monotonic() < end:
            time.sleep(0.1)
        return number * number


def failing(number: int) -> int:
    """Work of which the odd numbers fail."""
    if number % 2:
        raise InputError(f"number {number} is odd")
    return number


class Elsewhere(Place):
    """Workers a and b by turns, of which a fails at everything."""

    words, ahead, about = "two workers", 3, {}

    def __init__(self):
        self.given: list[tuple[tuple[str, ...], str]] = []

    def submit(self, avoid, call, *arguments):
        """To b if a is to be avoided."""
        from jaxcap.engine.workers import Attempt

        name = next(name for name in "ab" if name not in avoid)
        self.given.append((tuple(avoid), name))
        future = Future()
        future.set_result(Attempt(name, "disk full" if name == "a" else "", name))
        return future


def units(n):
    return [Unit(number, number) for number in range(n)]


def test_units_that_fail_are_told_and_the_others_finish():
    found = list(over_units(Here(), failing, units(6), tries=2))
    assert {one.unit.number: one.value for one in found if not one.error} == {0: 0, 2: 2, 4: 4}
    assert {one.unit.number: one.error for one in found if one.error} == {n: f"number {n} is odd" for n in (1, 3, 5)}


def test_a_unit_is_tried_again_elsewhere():
    place = Elsewhere()
    assert [(one.value, one.error) for one in over_units(place, failing, units(2), tries=2)] == [("b", "")] * 2
    assert place.given == [((), "a")] * 2 + [(("a",), "b")] * 2


def test_no_more_units_are_taken_than_the_place_may_have():
    taken = []

    class Slow(Elsewhere):
        def submit(self, avoid, call, *arguments):
            taken.append(arguments[1].number)
            return Future() if len(taken) == 2 else super().submit(("a",), call, *arguments)

    found = over_units(Slow(), failing, units(50))
    assert next(found).unit.number in (0, 2) and len(taken) == 3
    found.close()


def test_units_are_taken_when_there_is_room():
    asked = []
    found = over_units(Here(), abs, (Unit(number, asked.append(number) or number) for number in range(5)))
    assert [next(found).value, next(found).value] == [0, 1] and asked == [0, 1]
    found.close()


def test_an_interruption_ends_it():
    def interrupted(number):
        if number == 1:
            raise KeyboardInterrupt
        return number

    found = over_units(Here(), interrupted, units(3))
    assert next(found).value == 0
    with pytest.raises(KeyboardInterrupt):
        next(found)


@pytest.mark.slow
def test_a_process_that_dies_costs_no_other_unit(tmp_path):
    """One dies once, as by the system's hand; one kills whoever runs it, and is given up."""
    work = Touch(tmp_path, deadly=(3,), once=(1,))
    with processes(2) as place:
        found = {one.unit.number: one for one in over_units(place, work, units(8))}
    assert {n: one.value for n, one in found.items() if not one.error} == {n: n * n for n in range(8) if n != 3}
    assert (found[3].error, found[3].died) == ("its process died with exit code -9", True)
    assert len((tmp_path / "1").read_bytes()) >= 2


@pytest.mark.slow
def test_who_works_long_is_not_waited_for_when_another_dies(tmp_path):
    """What ran beside it begins anew: it is told to end in the middle, and does."""
    start = time.monotonic()
    with processes(2, Terms(ahead=1)) as place:
        found = list(over_units(place, Touch(tmp_path, once=(1,), long=(0,)), units(2)))
    assert sorted(one.value for one in found) == [0, 1] and len((tmp_path / "0").read_bytes()) == 2
    assert time.monotonic() - start < MINUTES


class Answer(NamedTuple):
    """What a process is like."""

    name: str

    def __call__(self, _: int) -> tuple[str | None, int, str | None]:
        return os.environ.get(self.name), os.nice(0), os.environ.get("PATH")


@pytest.mark.slow
def test_processes_are_as_the_job_asks(monkeypatch):
    monkeypatch.delenv("JAXCAP_TEST", raising=False)
    niceness = os.nice(0)
    with processes(1, Terms(environment={"JAXCAP_TEST": "7"}, niceness=3)) as place:
        (found,) = over_units(place, Answer("JAXCAP_TEST"), units(1))
    assert found.value == ("7", min(19, niceness + 3), os.environ["PATH"])
    assert "JAXCAP_TEST" not in os.environ and os.nice(0) == niceness


def strange():
    """What a process that is unlike this one finds."""
    return {"jax": f"of process {os.getpid()}"}


@pytest.mark.slow
def test_a_worker_that_is_different_fails_its_units_by_name():
    with processes(1, Terms(about=strange)) as place:
        assert place.about == {"jax": f"of process {place.about['jax'].split()[-1]}"} != strange()
        place.about["jax"] = "0.0.7"
        (found,) = over_units(place, abs, units(1), tries=1)
    assert "has jax of process " in found.error and "(expected jax 0.0.7)" in found.error and not found.died


@pytest.mark.parametrize(
    "text, why", [("3/3", "0/3 to 2/3"), ("0/0", "at least one"), ("-1/3", "i/n"), ("x", "i/n"), ("1/", "i/n")]
)
def test_shards_that_there_are_not(text, why):
    with pytest.raises(InputError, match=f"--shard {text} .*{why}"):
        shard_of(text)


def test_every_unit_belongs_to_one_shard():
    shards = [unit for i in range(3) for unit in Shard(i, 3).part(units(8))]
    assert sorted(shards) == units(8) == shard_of(None).part(units(8))


def test_a_folder_belongs_to_its_settings(tmp_path):
    ledger = open_ledger(tmp_path / "out", {"sides": 4, "mass": None}, force=False)
    assert ledger.done("a") is None
    ledger.write("a", {"states": 3})
    assert ledger.done("a") is None  # there is a record, but no file
    (tmp_path / "out" / "a").write_text("scores")
    assert open_ledger(tmp_path / "out", {"sides": 4, "mass": None}, force=False).done("a") == {"states": 3}
    with pytest.raises(InputError, match="other settings: sides 4 there and 8 now"):
        open_ledger(tmp_path / "out", {"sides": 8, "mass": None}, force=False)
    assert open_ledger(tmp_path / "out", {"sides": 8, "mass": None}, force=True).done("a") is None


def test_folders_that_cannot_be_used(tmp_path):
    (tmp_path / "thesis.tex").write_text("all of it")
    with pytest.raises(InputError, match="no earlier run"):
        open_ledger(tmp_path, {}, force=True)
    with pytest.raises(InputError, match="not a folder"):
        open_ledger(tmp_path / "thesis.tex", {}, force=True)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
