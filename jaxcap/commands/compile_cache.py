"""Compiled programs are kept from one run of a command to the next; what prevents it is a note, never an error."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax

from jaxcap.batch.kept_programs import FOLDER, programs_kept, usable
from jaxcap.errors import InputError


@contextmanager
def compilation_cache(directory: Path | None, no_cache: bool = False) -> Iterator[None]:
    """While it lasts, JAX keeps compiled programs in this directory and takes them from there.

    Without a directory it is the user's own, unless JAX has been told of one already (JAX_COMPILATION_CACHE_DIR): that one
    stays. Raises InputError if a directory is named and none is wanted.
    """
    if directory is not None and no_cache:
        raise InputError(f"--cache {directory}: both --cache and --no-cache (expected one of them)")
    if no_cache or (directory is None and getattr(jax.config, FOLDER)):
        yield
        return
    try:
        chosen = usable(directory)
    except OSError as error:
        where = "" if directory is None else f"--cache {directory}: "
        print(f"note: {where}compiled programs are not kept: {error.strerror or error}", file=sys.stderr)
        yield
        return
    with _troubles_are_notes(chosen), programs_kept(chosen):
        yield


@contextmanager
def _troubles_are_notes(directory: Path) -> Iterator[None]:
    """JAX warns of each entry that it cannot read or write, and goes on without: one line for all of them."""
    told = False

    def show(message, category, filename, lineno, file=None, line=None):
        nonlocal told
        if "persistent compilation cache entry" not in str(message):
            shown(message, category, filename, lineno, file, line)
        elif not told:
            told = True
            print(f"note: {directory}: damaged or full; compiled anew what it could not give", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.filterwarnings("always", ".*persistent compilation cache entry", UserWarning)
        shown, warnings.showwarning = warnings.showwarning, show
        yield
