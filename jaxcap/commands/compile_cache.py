"""Compiled programs kept in a directory, for the command line: the library itself leaves JAX's settings alone."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax
from jax.experimental.compilation_cache.compilation_cache import reset_cache

from jaxcap.errors import InputError

WORTH_KEEPING = 0.5
"""Programs that take longer to compile are kept [s]."""


@contextmanager
def compilation_cache(directory: Path | None) -> Iterator[None]:
    """While it lasts, JAX keeps compiled programs in this directory and takes them from there. None: all stays as it is.

    The directory is made if it is missing. Raises InputError if it cannot be, or cannot be written.
    """
    if directory is None:
        yield
        return
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError as error:
        raise InputError(f"--cache {directory}: {error.strerror or error} (expected a directory to write to)") from error
    settings = {
        "jax_compilation_cache_dir": str(directory.absolute()),
        "jax_persistent_cache_min_compile_time_secs": WORTH_KEEPING,
        "jax_enable_compilation_cache": True,
    }
    before = {name: getattr(jax.config, name) for name in settings}
    try:
        _set(settings)
        yield
    finally:
        _set(before)


def _set(settings: dict) -> None:
    for name, value in settings.items():
        jax.config.update(name, value)
    reset_cache()  # JAX looks at its settings once, when it compiles for the first time
