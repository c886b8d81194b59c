"""Files that appear whole or not at all."""

import os
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from jaxcap.errors import InputError

EXTENSIONS = (".parquet", ".npz")

def check_output(
    path: str | Path,
    *,
    force: bool = False,
    inputs: Iterable[str | Path] = (),
    extensions: tuple[str, ...] = EXTENSIONS,
) -> None:
    """Raises InputError if `path` cannot be written: unknown extension, no such directory, an input, or there already.

    force: allow an existing file, unless it is one of `inputs`.
    """
    path = Path(path)
    extension_of(path, extensions)
    if not path.parent.is_dir():
        raise InputError(f"{path}: no such directory: {path.parent}")
    if not path.exists():
        return
    if not path.is_file():
        raise InputError(f"{path}: exists and is not a file")
    if any(Path(source).exists() and path.samefile(source) for source in inputs):
        raise InputError(f"{path}: is also an input")
    if not force:
        raise InputError(f"{path}: exists already (--force overwrites it)")


def extension_of(path: Path, extensions: tuple[str, ...] = EXTENSIONS) -> str:
    extension = path.suffix.lower()
    if extension not in extensions:
        expected = f"{', '.join(extensions[:-1])} or {extensions[-1]}"
        raise InputError(f"{path}: unknown extension {path.suffix!r} (expected {expected})")
    return extension


@contextmanager
def whole_file(path: Path, *, force: bool) -> Iterator[BinaryIO]:
    """A new file under a temporary name, which takes the name `path` when the block ends without an error.

    Raises InputError for an error of the file system, a full disk for one. The temporary file is removed.
    """
    target = Path(os.path.realpath(path))  # a link stays a link
    temporary = target.parent / f".jaxcap-{secrets.token_hex(8)}.tmp"
    try:
        with open(temporary, "xb") as handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        if target.exists() and not force:
            raise InputError(f"{path}: exists already; it was written in the meantime")
        os.replace(temporary, target)
        _sync(target.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def _sync(directory: Path) -> None:
    """Makes the new name last through a power cut, where the system lets a directory be opened."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
