"""What a user gets to read when a file, an option or the installation is at fault."""

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """A file, column, field or option that cannot be used. The message is for the user and names what is at fault."""


class MissingExtra(ImportError):
    """A package is missing that belongs to an optional extra. The message says which command installs it."""


@contextmanager
def needs_extra(extra: str, purpose: str) -> Iterator[None]:
    """Imports inside the block belong to the extra `extra`. Raises MissingExtra where one of them is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("jaxcap"):
            raise
        raise MissingExtra(f'{purpose} needs {error.name}; install it with: pip install "jaxcap[{extra}]"') from error
