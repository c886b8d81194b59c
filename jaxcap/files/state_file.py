"""An open file of states, whatever its format."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from jaxcap.files.columns import StateBatch


class StateFile(AbstractContextManager["StateFile"]):
    """An open file of states. Iterating yields a StateBatch for each `batch_size` rows; a `with` block closes it.

    A format says how to open the file (`_opened`), and what to check and to learn from its header (`_open`). Raises
    InputError, here or while iterating, if the file cannot be read or does not hold states.
    """

    rows: int
    """Number of states."""
    types: dict[str, Any]
    """The columns that are carried through: NumPy types, or Arrow fields."""
    skipped: Sequence[str] = ()
    """Arrays that are not, because they do not hold one value for each state."""
    about: Mapping[bytes, bytes] = MappingProxyType({})
    """What the file says of itself and the output should say again: how pandas makes the index of its frame, for one."""
    contacts: tuple[str, ...]
    """Names of the columns that give each row its contacts, or its set of a contacts file; see `contact_columns`."""

    def __init__(self, path: Path, batch_size: int, dtype: DTypeLike):
        self.path, self.batch_size, self.dtype = path, batch_size, np.dtype(dtype)
        self._file = self._opened()
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def _opened(self) -> Any:
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

    def __exit__(self, *_: Any) -> None:
        self.close()
