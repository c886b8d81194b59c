"""An open file of states, whatever its format."""

from abc import abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np

from jaxcap.files.columns import StateBatch


class StateFile(AbstractContextManager):
    """An open file of states. Iterating yields a StateBatch for each `batch_size` rows; a `with` block closes it.

    A format says how to open the file (`_opened`), and what to check and to learn from its header (`_open`). Raises
    InputError, here or while iterating, if the file cannot be read or does not hold states.
    """

    rows: int
    """Number of states."""
    contacts: tuple[str, ...]
    """Names of the columns that give each row its contacts, or its set of a contacts file; see `contact_columns`."""

    def __init__(self, path: Path, batch_size: int, dtype: np.dtype):
        self.path, self.batch_size, self.dtype = path, batch_size, np.dtype(dtype)
        self._file = self._opened()
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def _opened(self):
        """The library's handle of the file."""

    @abstractmethod
    def _open(self) -> None:
        """Read the header and refuse what is not a file of states."""

    @abstractmethod
    def __iter__(self) -> Iterator[StateBatch]:
        """The states, `batch_size` rows at a time."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __exit__(self, *_) -> None:
        self.close()
