"""An open file of states, whatever its format."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import DTypeLike

from jaxcap.files.bad_rows import BadRows
from jaxcap.files.columns import SPECIFIC, VECTORS, StateBatch, momentum_columns, spelling
from jaxcap.files.contact_columns import RowChoices, RowContacts


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

    momentum: tuple[str, ...]
    """Names of the columns that hold the angular momentum, if it is read; see `momentum_columns`."""

    def __init__(self, path: Path, batch_size: int, dtype: DTypeLike, mass: float | None = None):
        self.path, self.batch_size, self.dtype, self.mass = path, batch_size, np.dtype(dtype), mass
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

    def _spelt(self, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
        """The columns that hold each vector of a state."""
        found = {vector: spelling(self.path, vector, names) for vector in VECTORS}
        self.momentum = momentum_columns(self.path, names, self.mass)
        return found | ({SPECIFIC: self.momentum} if self.momentum else {})

    def _batch(
        self,
        vectors: Mapping[str, Float[np.ndarray, "n 3"]],
        columns: Mapping[str, Any],
        bad: BadRows,
        contacts: RowContacts | RowChoices | None,
    ) -> StateBatch:
        """A batch from its vectors, which `_spelt` has named."""
        com, com_velocity = (vectors[vector] for vector in VECTORS)
        momenta = vectors.get(SPECIFIC)
        if momenta is not None and self.mass is not None:
            momenta = (momenta / self.mass).astype(self.dtype)
        return StateBatch(com, com_velocity, columns, bad, contacts, momenta)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __exit__(self, *_: Any) -> None:
        self.close()
