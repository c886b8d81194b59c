"""Precision for the tests, and types checked at run time."""

import jax
import pytest
from jaxtyping import install_import_hook

with install_import_hook("jaxcap", "beartype.beartype"):
    import jaxcap  # noqa: F401


@pytest.fixture
def x64():
    """Double precision while a test runs; the library itself never switches."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(autouse=True, scope="module")
def programs():
    """What one file has compiled is not kept for the next: all of it together is 10 GB."""
    yield
    jax.clear_caches()
