"""What a missing extra is told as: one line, no traceback, from a command; a named cause, from an import."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def extra(name: str, module: str) -> Iterator[None]:
    """Imports in this block come with an extra of jaxcap. module: the importing one's `__name__`.

    Raises ModuleNotFoundError naming package and extra; where the module is run as a command it says so and exits with 1.
    """
    try:
        yield
    except ModuleNotFoundError as missing:
        package = (missing.name or "").split(".")[0]
        if package == "reference":
            raise
        told = f'{package} is not installed; it comes with the extra {name}: pip install -e ".[{name}]"'
        if module == "__main__":
            sys.exit(told)
        raise ModuleNotFoundError(told, name=missing.name) from missing
