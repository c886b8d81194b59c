"""Which tests are quick, types checked at run time, and compiled programs kept for the next run."""

import os
import shutil
from pathlib import Path

import pytest
from tiers import is_quick, mark

KEPT = Path(__file__).resolve().parents[1] / ".jax_cache"
"""Compiled programs, for the next run and for the processes that tests start; may be deleted at any time."""
MOST_KEPT = 4e9
"""When the folder is larger, it is begun anew [bytes]."""
MOST_MAPS = 20_000
"""Of memory, in one process: every program takes some, Linux allows 65,530, and all programs together take 10 GB."""

os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(KEPT))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")

import jax  # noqa: E402
from jaxtyping import install_import_hook  # noqa: E402

jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])   # it may have been imported before
jax.config.update("jax_persistent_cache_min_compile_time_secs", float(os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"]))

with install_import_hook("jaxcap", "beartype.beartype"):
    import jaxcap  # noqa: F401


def pytest_addoption(parser):
    parser.addoption("--everything", action="store_true", help="run all tests, not only the quick ones")


def pytest_configure(config):
    # A program that another process is just writing, or that was cut off in writing, is compiled again
    config.addinivalue_line("filterwarnings", "ignore:Error reading persistent compilation cache entry:UserWarning")
    size = sum(file.stat().st_size for file in KEPT.glob("*"))
    if size > MOST_KEPT and not hasattr(config, "workerinput"):
        shutil.rmtree(KEPT)


def pytest_collection_modifyitems(config, items):
    """Marks what is not quick, and leaves it out unless --everything or -m asks for it."""
    mark(items)
    if config.option.everything or config.option.markexpr:
        return
    config.hook.pytest_deselected(items=[item for item in items if not is_quick(item)])
    items[:] = filter(is_quick, items)


@pytest.fixture
def x64():
    """Double precision while a test runs; the library itself never switches."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(autouse=True, scope="module")
def programs():
    """A process that holds many programs lets them go between two files."""
    yield
    maps = Path("/proc/self/maps")
    if not maps.exists() or maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
