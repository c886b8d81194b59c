"""Which tests are quick, types checked at run time, and compiled programs kept for the next run."""

import os
import shutil
from pathlib import Path

import pytest
from tiers import chosen, mark, part

KEPT = Path(__file__).resolve().parents[1] / ".jax_cache"
"""Compiled programs, for the next run and for the processes that tests start; may be deleted at any time."""
MOST_KEPT = 4e9
"""When the folder is larger, it is begun anew [bytes]."""
MOST_MAPS = 10_000
"""Of memory, in one process (about 2 GB): every program takes some, Linux allows 65,530, and all programs take 10 GB."""

WORTH_KEEPING = 0.1
"""Programs that take longer to compile are kept [s]."""

os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(KEPT))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", str(WORTH_KEEPING))

import jax  # noqa: E402
from hypothesis import settings  # noqa: E402
from jaxtyping import install_import_hook  # noqa: E402

jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])  # a plugin may have imported JAX
jax.config.update("jax_persistent_cache_min_compile_time_secs", WORTH_KEEPING)

settings.register_profile("repeatable", derandomize=True)  # the same examples every time
settings.load_profile("repeatable")

with install_import_hook("jaxcap", "beartype.beartype"):
    import jaxcap  # noqa: F401


def pytest_addoption(parser):
    parser.addoption("--everything", action="store_true", help="run all tests, not only the quick ones")
    parser.addoption("--others", action="store_true", help="run the tests that are not quick, and only those")


def pytest_configure(config):
    # A program that another process is just writing, or that was cut off in writing, is compiled again
    config.addinivalue_line("filterwarnings", "ignore:Error reading persistent compilation cache entry:UserWarning")
    size = sum(file.stat().st_size for file in KEPT.glob("*"))
    if size > MOST_KEPT and not hasattr(config, "workerinput"):
        shutil.rmtree(KEPT)


def pytest_report_header(config):
    wanted = part(config.option)
    return None if wanted == "all" else f"only part of the tests ({wanted}); --everything runs all of them"


FOUND = pytest.StashKey[list[pytest.Item]]()


def pytest_collection_modifyitems(config, items):
    """Marks what is not quick, and leaves out what --everything, --others or -m does not ask for."""
    mark(items)
    config.stash[FOUND] = list(items)
    items[:] = chosen(items, part(config.option))
    kept = set(items)
    config.hook.pytest_deselected(items=[item for item in config.stash[FOUND] if item not in kept])


@pytest.fixture
def found(request):
    """All tests that there are, also those that this run leaves out."""
    return request.config.stash[FOUND]


@pytest.fixture
def x64():
    """Double precision while a test runs; the library itself never switches."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(autouse=True, scope="module")
def programs(request):
    """A process that holds many programs lets them go between two files. What tests their keeping begins with none kept."""
    if request.path.name == "test_cli_cache.py":
        jax.config.update("jax_compilation_cache_dir", None)
    yield
    jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
    maps = Path("/proc/self/maps")
    if not maps.exists() or maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
