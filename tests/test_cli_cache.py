"""`--cache DIR`: the second run compiles nothing, answers the same, and JAX's settings are put back."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from state_files import command, read_columns, write_contacts, write_states

from jaxcap.commands.cli import main
from jaxcap.commands.compile_cache import compilation_cache
from jaxcap.errors import InputError

pytest.importorskip("tyro")

SETTINGS = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs", "jax_enable_compilation_cache")
EVENTS = "/jax/compilation_cache/"

COUNTED = """
import collections, json, sys
import jax
from jaxcap.commands.cli import main
events = collections.Counter()
jax.monitoring.register_event_listener(lambda name, **_: events.update([name]))
code = main(sys.argv[1:])
print(json.dumps(events), file=sys.stderr)
sys.exit(code)
"""
"""`jaxcap` that says in the end how often JAX kept a program, and took one."""


def counted(*arguments) -> dict[str, int]:
    """A run in a process of its own: programs kept and taken."""
    root = str(Path(__file__).parents[1])
    quickly = {**os.environ, "PYTHONPATH": root, "XLA_FLAGS": "--xla_backend_optimization_level=0"}
    program = [sys.executable, "-W", "error", "-c", COUNTED, *map(str, arguments)]
    run = subprocess.run(program, check=True, capture_output=True, text=True, env=quickly)
    events = json.loads(run.stderr.splitlines()[-1])
    return {"kept": events.get(EVENTS + "cache_misses", 0), "taken": events.get(EVENTS + "cache_hits", 0)}


@pytest.fixture
def settings():
    """Those of JAX before the test, which have to be there after it."""
    before = {name: getattr(jax.config, name) for name in SETTINGS}
    yield before
    assert {name: getattr(jax.config, name) for name in SETTINGS} == before


@pytest.fixture
def given(tmp_path):
    write_states(tmp_path / "states.npz", 50)
    write_contacts(tmp_path / "feet.yaml")
    return tmp_path


def test_a_second_run_takes_what_the_first_kept(given):
    score = lambda out: command(given / "states.npz", given / "feet.yaml", given / out, "--cache", given / "a" / "b")
    first = counted(*score("first.npz"))
    assert first["kept"] >= 1
    assert len(list((given / "a" / "b").glob("*-cache"))) == first["kept"]
    assert counted(*score("second.npz")) == {"kept": 0, "taken": first["kept"]}
    one, other = read_columns(given / "first.npz"), read_columns(given / "second.npz")
    assert set(one) == set(other)
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)


def test_a_map_is_computed_with_the_cache(given, settings, monkeypatch):
    maps, seen = pytest.importorskip("jaxcap.maps.kernel"), []

    def write_map(*_, **__):
        seen.append(jax.config.jax_compilation_cache_dir)
        return 1

    monkeypatch.setattr(maps, "write_map", write_map)
    monkeypatch.chdir(given)
    assert main(["map", "feet.yaml", "-o", "map.nc", "--cache", "programs"]) == 0
    assert main(["map", "feet.yaml", "-o", "map.nc"]) == 0
    assert seen == [str(given / "programs"), None]


def test_without_the_option_nothing_is_kept(tmp_path, settings):
    with compilation_cache(None):
        assert {name: getattr(jax.config, name) for name in SETTINGS} == settings


def test_settings_are_put_back_after_an_error(tmp_path, settings):
    with pytest.raises(ZeroDivisionError), compilation_cache(tmp_path):
        assert jax.config.jax_compilation_cache_dir == str(tmp_path)
        raise ZeroDivisionError


@pytest.mark.parametrize("where", ["file", "file/below", "/proc/self"])
def test_a_directory_that_cannot_be_written(given, settings, capsys, monkeypatch, where):
    """Nobody may write into /proc, not even root."""
    monkeypatch.chdir(given)
    Path("file").write_text("not a directory")
    assert main(command("states.npz", "feet.yaml", "out.npz", "--cache", where)) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"error: --cache {where}: ") and "expected a directory to write to" in message
    assert not Path("out.npz").exists()
    with pytest.raises(InputError), compilation_cache(Path(where)):
        pass


@pytest.mark.parametrize("name", ["score", "map"])
def test_help_names_the_option(capsys, name):
    assert main([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert "--cache DIR" in text and "COMPILING" in text
    assert max(map(len, text.splitlines())) <= 80
