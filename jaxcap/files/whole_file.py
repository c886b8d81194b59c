"""Files that appear whole or not at all."""

import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from jaxcap.errors import InputError

EXTENSIONS = (".parquet", ".npz")
"""Of files of states and scores."""


def check_output(
    path: str | Path,
    *,
    force: bool = False,
    inputs: Iterable[str | Path] = (),
    extensions: tuple[str, ...] = EXTENSIONS,
    is_ours: Callable[[Path], bool] = Path.is_file,
    kind: str = "file",
) -> None:
    """Looks whether `path` can be written, before anything is computed.

    Args:
        path: Where the output goes.
        force: Allow an existing output, unless it is one of `inputs`.
        inputs: Files that must not be overwritten, those that are read.
        extensions: Those that the output may have.
        is_ours: Whether what is there is of the kind that is written, and may be replaced.
        kind: That kind, in one word.

    Raises:
        InputError: For an unknown extension, a missing directory, an input, or what is there already.
    """
    path = Path(path)
    extension_of(path, extensions)
    if not path.parent.is_dir():
        raise InputError(f"{path}: no such directory: {path.parent}")
    if not path.exists():
        return
    if not is_ours(path):
        raise InputError(f"{path}: exists and is not a {kind}")
    if any(Path(source).exists() and path.samefile(source) for source in inputs):
        raise InputError(f"{path}: is also an input")
    if not force:
        raise InputError(f"{path}: exists already (--force overwrites it)")


def extension_of(path: Path, extensions: tuple[str, ...] = EXTENSIONS) -> str:
    """The extension, in small letters. Raises InputError if it is none of these."""
    extension = path.suffix.lower()
    if extension not in extensions:
        expected = f"{', '.join(extensions[:-1])} or {extensions[-1]}"
        raise InputError(f"{path}: unknown extension {path.suffix!r} (expected {expected})")
    return extension


@contextmanager
def whole_file(path: Path, *, force: bool, lasting: bool = True) -> Iterator[BinaryIO]:
    """A new file under a temporary name, which takes the name `path` when the block ends without an error.

    Args:
        path: Where the file goes; a link stays a link.
        force: Replace a file that is there.
        lasting: Through a power cut, after which the file may else be lost, or empty. It costs a few milliseconds.

    Raises:
        InputError: For an error of the file system, a full disk for one. The temporary file is removed.
    """
    target = Path(os.path.realpath(path))
    temporary = temporary_beside(target)
    with write_errors_of(path):
        try:
            with open(temporary, "xb") as handle:
                yield handle
                handle.flush()
                if lasting:
                    os.fsync(handle.fileno())
            refuse_late_comer(path, force)
            os.replace(temporary, target)
            if lasting:
                _sync(target.parent)
        finally:
            with suppress(OSError):
                temporary.unlink()


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A new folder under a temporary name, which takes the name `path`, full, when the block ends without an error.

    Of processes that make it at a time one does, and the others find it there.
    """
    temporary = temporary_beside(path)
    try:
        temporary.mkdir()
        yield temporary
        try:
            os.rename(temporary, path)
        except OSError:
            if not path.exists():
                raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def temporary_beside(path: Path) -> Path:
    """A name in the same directory that nobody has: from there a rename to `path` is one step."""
    return path.with_name(f".jaxcap-{secrets.token_hex(8)}.tmp")


def refuse_late_comer(path: Path, force: bool) -> None:
    """Raises InputError if `path` is there, though it was not when the work began."""
    if path.exists() and not force:
        raise InputError(f"{path}: exists already; it was written in the meantime")


@contextmanager
def write_errors_of(path: Path) -> Iterator[None]:
    """Turns errors of the file system while `path` is written into InputError."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def _sync(directory: Path) -> None:
    """Makes the new name last through a power cut, where the system lets a directory be opened."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
