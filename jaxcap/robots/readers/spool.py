"""Columns that arrive piece by piece, kept in an unnamed file and mapped into memory."""

import tempfile
from contextlib import ExitStack
from typing import Any

import numpy as np

from jaxcap.errors import InputError


class Spools:
    """Columns by name, each in a file of its own that vanishes with the stack."""

    def __init__(self, where: str, stack: ExitStack):
        self._where, self._stack = where, stack
        self._files: dict[str, Any] = {}
        self._kinds: dict[str, tuple[np.dtype, tuple[int, ...]]] = {}
        self._rows: dict[str, int] = {}

    def append(self, name: str, rows: np.ndarray) -> None:
        """Adds rows at the end of a column. Raises InputError if they are not as wide as those before."""
        kind = (rows.dtype, rows.shape[1:])
        if name not in self._files:
            self._files[name] = self._stack.enter_context(tempfile.TemporaryFile())  # noqa: SIM115
            self._kinds[name], self._rows[name] = kind, 0
        if self._kinds[name] != kind:
            raise InputError(
                f"{self._where}: {name!r} has rows of shape {kind[1]} (expected {self._kinds[name][1]}, as before)"
            )
        self._files[name].write(np.ascontiguousarray(rows).reshape(-1).view(np.uint8).data)
        self._rows[name] += len(rows)

    def arrays(self) -> dict[str, np.ndarray]:
        """The columns, to be sliced."""
        found = {}
        for name, file in self._files.items():
            (dtype, row), n = self._kinds[name], self._rows[name]
            file.flush()
            found[name] = np.memmap(file, dtype, "r", shape=(n, *row)) if n and all(row) else np.empty((n, *row), dtype)
        return found
