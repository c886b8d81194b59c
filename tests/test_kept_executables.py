"""Programs kept ready: taken by who asks the same, by nobody else; damage and foreign bytes are a note and a compilation."""

import hashlib
import pickle
import zlib
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.batch import kept_executables
from jaxcap.batch.kept_executables import Kept
from jaxcap.batch.kept_programs import kept_in, programs_kept

TRACED = []
"""One entry for each time that `scaled` was traced."""


class Given(NamedTuple):
    values: jax.Array
    factor: jax.Array | None = None


def fresh() -> Kept:
    """As in a process that has nothing in memory: JAX knows traced functions by their identity."""

    def scaled(given: Given, power: int) -> jax.Array:
        TRACED.append(power)
        return given.values**power * (1 if given.factor is None else given.factor)

    return Kept(scaled, "power")


VALUES = np.arange(4, dtype=np.float32)


@pytest.fixture
def folder(tmp_path):
    with programs_kept(tmp_path):
        TRACED.clear()
        yield tmp_path


def files(folder):
    return sorted(folder.glob("*.program"))


def another_process(given, power=2):
    """What it answers, and whether it had to trace."""
    before = len(TRACED)
    answer = fresh()(given, power=power)
    return np.asarray(answer).tolist(), len(TRACED) > before


def test_who_asks_the_same_traces_nothing(folder):
    kept = fresh()
    assert kept(Given(VALUES), power=2).tolist() == [0, 1, 4, 9] and kept(Given(VALUES + 1), power=2).tolist() == [
        1,
        4,
        9,
        16,
    ]
    assert len(TRACED) == len(files(folder)) == 1
    assert another_process(Given(VALUES + 1)) == ([1, 4, 9, 16], False)
    assert another_process(Given(jnp.asarray(VALUES))) == ([0, 1, 4, 9], False)


@pytest.mark.parametrize(
    ("given", "power"),
    [
        (Given(VALUES), 3),
        (Given(VALUES[:3]), 2),
        (Given(VALUES.astype(np.int32)), 2),
        (Given(VALUES, np.float32(2)[None]), 2),
    ],
    ids=["a value", "a shape", "a dtype", "a tree"],
)
def test_who_asks_something_else_gets_something_else(folder, given, power):
    another_process(Given(VALUES))
    expected = given.values**power * (1 if given.factor is None else given.factor)
    assert another_process(given, power) == (expected.tolist(), True)
    assert len(files(folder)) == 2


@pytest.mark.parametrize("what", ["_library", "_machine"])
def test_another_version_or_machine_takes_nothing(folder, monkeypatch, what):
    another_process(Given(VALUES))
    monkeypatch.setattr(kept_executables, what, lambda: "another")
    assert another_process(Given(VALUES)) == ([0, 1, 4, 9], True)


def test_another_precision_takes_nothing(folder):
    another_process(Given(VALUES))
    with jax.enable_x64(True):
        assert another_process(Given(VALUES)) == ([0, 1, 4, 9], True)


def whole(text):
    return hashlib.sha256(text).digest() + text


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b"", "it is damaged"),
        (b"x" * 100, "it is damaged"),
        (whole(b"not compressed"), "incorrect header"),
        (whole(zlib.compress(pickle.dumps((b"no program", None, None)))), "compiled anew"),
    ],
)
def test_what_cannot_be_used_is_a_note(folder, text, why):
    another_process(Given(VALUES))
    (file,) = files(folder)
    file.write_bytes(text)
    with pytest.warns(UserWarning, match=f"persistent compilation cache entry .*{why}"):
        assert another_process(Given(VALUES)) == ([0, 1, 4, 9], True)


def test_a_folder_that_went_away_is_a_note(folder, monkeypatch):
    monkeypatch.setattr(kept_executables, "kept_in", lambda: folder / "gone")
    with pytest.warns(UserWarning, match="No such file or directory"):
        assert another_process(Given(VALUES)) == ([0, 1, 4, 9], True)


def test_nothing_is_kept_unless_asked(tmp_path):
    assert kept_in() is None
    with programs_kept(tmp_path):
        assert kept_in() == tmp_path
        jax.config.update("jax_compilation_cache_dir", str(tmp_path / "theirs"))  # the user's word is the last
        assert kept_in() is None
    assert another_process(Given(VALUES)) == ([0, 1, 4, 9], True)
    assert not files(tmp_path)


def test_placed_or_traced_arrays_are_left_to_jax(folder):
    placed = jax.device_put(VALUES, jax.devices()[0])
    assert another_process(Given(placed)) == ([0, 1, 4, 9], True)
    assert jax.jit(lambda x: fresh()(Given(x), power=2))(VALUES).tolist() == [0, 1, 4, 9]
    with jax.debug_nans(True):
        another_process(Given(VALUES))
    assert not files(folder)
