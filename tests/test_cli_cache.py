"""Programs are kept: the second run compiles nothing, answers the same, JAX's settings are put back, trouble is a note."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import pytest
from state_files import command, read_columns, write_contacts, write_states

from jaxcap.batch.kept_programs import keep_programs
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


class Run(NamedTuple):
    kept: int
    taken: int
    said: tuple[str, ...]
    """What stands on stderr."""


def counted(home: Path, *arguments) -> Run:
    """A run in a process of its own, whose user has this folder for caches and has told JAX of none."""
    root = str(Path(__file__).parents[1])
    own = {"PYTHONPATH": root, "XDG_CACHE_HOME": str(home), "XLA_FLAGS": "--xla_backend_optimization_level=0"}
    others = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    program = [sys.executable, "-W", "error", "-c", COUNTED, *map(str, arguments)]
    run = subprocess.run(program, check=True, capture_output=True, text=True, env=others | own)
    *said, last = run.stderr.splitlines()
    events = json.loads(last)
    return Run(events.get(EVENTS + "cache_misses", 0), events.get(EVENTS + "cache_hits", 0), tuple(said))


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


def assert_same_file(one: Path, other: Path):
    one, other = read_columns(one), read_columns(other)
    assert set(one) == set(other)
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)


@pytest.mark.parametrize("where", [(), ("--cache", "a/b")], ids=["the user's", "a folder"])
def test_a_second_run_takes_what_the_first_kept(given, where, monkeypatch):
    monkeypatch.chdir(given)
    home = given / "home"
    folder = given / "a" / "b" if where else home / "jaxcap"
    score = lambda out: counted(home, *command("states.npz", "feet.yaml", out, *where))
    first = score("first.npz")
    assert first.kept >= 1
    assert len(list(folder.glob("*-cache"))) == first.kept and folder.stat().st_mode & 0o777 == 0o700
    assert where == () or not home.exists()
    ready = list(folder.glob("*.program"))
    assert ready and score("second.npz") == Run(0, first.kept - len(ready), first.said)  # JAX is not asked for these
    assert_same_file(given / "first.npz", given / "second.npz")
    for entry in [*folder.glob("*-cache"), *ready]:
        entry.write_bytes(entry.read_bytes()[:100])
    damaged = score("third.npz")
    assert damaged.kept == first.kept and [line for line in damaged.said if line not in first.said] == [
        f"note: {folder}: damaged or full; compiled anew what it could not give"
    ]
    assert_same_file(given / "first.npz", given / "third.npz")


def test_a_folder_of_the_user_that_others_may_write_to_is_not_used(given, settings, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(given))
    (given / "jaxcap").mkdir()
    (given / "jaxcap").chmod(0o777)
    with compilation_cache(None):
        assert jax.config.jax_compilation_cache_dir is None
    assert capsys.readouterr().err == (
        f"note: compiled programs are not kept: {given / 'jaxcap'} belongs to others or may be written to by them\n"
    )
    with pytest.raises(PermissionError, match="belongs to others"):
        keep_programs()


def test_python_keeps_them_by_one_call(tmp_path, settings, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    try:
        assert keep_programs() == tmp_path / "jaxcap"
        assert jax.config.jax_compilation_cache_dir == str(tmp_path / "jaxcap")
        assert keep_programs(tmp_path / "here") == tmp_path / "here"
        assert jax.config.jax_compilation_cache_dir == str(tmp_path / "here")
    finally:
        for name, value in settings.items():
            jax.config.update(name, value)


def test_a_map_is_computed_with_the_cache(given, settings, monkeypatch):
    maps, seen = pytest.importorskip("jaxcap.maps.kernel"), []

    def write_map(*_, **__):
        seen.append(jax.config.jax_compilation_cache_dir)
        return 1

    monkeypatch.setattr(maps, "write_map", write_map)
    monkeypatch.setenv("XDG_CACHE_HOME", str(given / "home"))
    monkeypatch.chdir(given)
    assert main(["map", "feet.yaml", "-o", "map.nc", "--cache", "programs"]) == 0
    assert main(["map", "feet.yaml", "-o", "map.nc", "--no-cache"]) == 0
    assert main(["map", "feet.yaml", "-o", "map.nc"]) == 0
    assert seen == [str(given / "programs"), None, str(given / "home" / "jaxcap")]


def test_nothing_is_kept_where_it_is_not_wanted(tmp_path, settings, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with compilation_cache(None, no_cache=True):
        assert {name: getattr(jax.config, name) for name in SETTINGS} == settings
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match="both --cache and --no-cache"), compilation_cache(tmp_path, no_cache=True):
        pass


def test_a_folder_that_jax_has_been_told_of_stays(tmp_path, settings, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "theirs"))
    try:
        with compilation_cache(None):
            assert jax.config.jax_compilation_cache_dir == str(tmp_path / "theirs")
    finally:
        jax.config.update("jax_compilation_cache_dir", settings["jax_compilation_cache_dir"])
    assert not list(tmp_path.iterdir())


def test_settings_are_put_back_after_an_error(tmp_path, settings):
    with pytest.raises(ZeroDivisionError), compilation_cache(tmp_path):
        assert jax.config.jax_compilation_cache_dir == str(tmp_path)
        raise ZeroDivisionError


@pytest.mark.parametrize("where", ["file", "file/below", "/proc/self"])
def test_a_directory_that_cannot_be_written_is_a_note(given, settings, capsys, monkeypatch, where):
    """Nobody may write into /proc, not even root."""
    monkeypatch.chdir(given)
    Path("file").write_text("not a directory")
    with compilation_cache(Path(where)):
        assert {name: getattr(jax.config, name) for name in SETTINGS} == settings
    assert capsys.readouterr().err.startswith(f"note: --cache {where}: compiled programs are not kept: ")


@pytest.mark.parametrize("name", ["score", "map"])
def test_help_names_the_option(capsys, name):
    assert main([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert "--cache DIR" in text and "--no-cache" in text and "COMPILING" in text
    assert max(map(len, text.splitlines())) <= 80
