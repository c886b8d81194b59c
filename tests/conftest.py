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
