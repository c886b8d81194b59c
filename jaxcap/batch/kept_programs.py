"""Compiled programs kept in a folder, so that they are compiled once and not once a process."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax
import platformdirs
from jax.experimental.compilation_cache.compilation_cache import reset_cache

FOLDER = "jax_compilation_cache_dir"
"""JAX's setting that names the folder; None: nothing is kept."""

WORTH_KEEPING = 0.0
"""Programs that take longer to compile are kept [s]: also single operations, 10 ms each, of which making rays has fifty."""


_ours: Path | None = None
"""The folder, where it was this library that told JAX of it."""


def kept_in() -> Path | None:
    """The folder, if `keep_programs` was asked and JAX has been told of no other since."""
    told = getattr(jax.config, FOLDER)
    return _ours if _ours is not None and told == str(_ours) else None


def keep_programs(directory: str | Path | None = None) -> Path:
    """From now on JAX keeps compiled programs in a folder and takes them from there; the command line does so by itself.

    The one function of jaxcap that changes settings of JAX, of the whole process: JAX's persistent compilation cache is
    turned on, for the programs of everybody. Beside them, those of `score` and of maps are kept ready to run, and
    found without tracing. The folder may be deleted at any time. What it holds is code: use none that
    is written to by anyone whom you do not trust.

    Args:
        directory: It is made, for the user alone, if it is missing; without one, the user's own cache folder.

    Returns:
        The folder.

    Raises:
        OSError: It cannot be made or written to, or the user's own folder belongs to, or may be written to by, others.
    """
    global _ours
    _ours = usable(directory)
    _set(_settings(_ours))
    return _ours


@contextmanager
def programs_kept(directory: Path) -> Iterator[None]:
    """The same for a while, for a folder that `usable` has returned."""
    global _ours
    settings, ours = _settings(directory), _ours
    before = {name: getattr(jax.config, name) for name in settings}
    try:
        _ours = directory
        _set(settings)
        yield
    finally:
        _ours = ours
        _set(before)


def usable(directory: str | Path | None) -> Path:
    """The folder to keep programs in, made and tried; raises OSError as `keep_programs` says."""
    chosen = platformdirs.user_cache_path("jaxcap", appauthor=False) if directory is None else Path(directory).absolute()
    chosen.mkdir(mode=0o700, parents=True, exist_ok=True)
    if directory is None and hasattr(os, "getuid"):
        status = chosen.stat()
        if status.st_uid != os.getuid() or status.st_mode & 0o022:
            raise PermissionError(f"{chosen} belongs to others or may be written to by them")
    with tempfile.TemporaryFile(dir=chosen):
        pass
    return chosen


def _settings(directory: Path) -> dict[str, object]:
    return {
        FOLDER: str(directory),
        "jax_persistent_cache_min_compile_time_secs": WORTH_KEEPING,
        "jax_enable_compilation_cache": True,
    }


def _set(settings: dict[str, object]) -> None:
    for name, value in settings.items():
        jax.config.update(name, value)
    reset_cache()  # JAX looks at its settings once, when it compiles for the first time
