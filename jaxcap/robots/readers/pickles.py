"""Pickles that are never executed: an unpickler that knows NumPy arrays and plain containers alone, also as joblib writes
them.

A pickle is a program. This one may call what makes arrays, and nothing else; any other name in it is refused by that name.
"""

import io
import math
import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from jaxcap.errors import InputError
from jaxcap.robots.readers.arrays import flat


class _JoblibArray:
    """What joblib writes before the bytes of an array: their shape, order and type."""


def _codes(text: str, encoding: str) -> bytes:
    """How old protocols write bytes."""
    if encoding not in ("latin1", "latin-1"):
        raise InputError(f"encoding {encoding!r} (expected latin1)")
    return text.encode("latin1")


_CORE = np._core.multiarray  # type: ignore[attr-defined]
_ALLOWED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("collections", "OrderedDict"): OrderedDict,
    ("_codecs", "encode"): _codes,
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): _JoblibArray,
}
for _core in ("numpy.core", "numpy._core"):
    _ALLOWED[f"{_core}.multiarray", "_reconstruct"] = _CORE._reconstruct
    _ALLOWED[f"{_core}.multiarray", "scalar"] = _CORE.scalar
    _ALLOWED[f"{_core}.numeric", "_frombuffer"] = np._core.numeric._frombuffer  # type: ignore[attr-defined]


_Base: Any = pickle._Unpickler
"""Python's own unpickler, not the one in C: the bytes of joblib's arrays stand between its opcodes."""


class _Unpickler(_Base):
    """Reads arrays and plain containers."""

    dispatch: ClassVar = dict(_Base.dispatch)

    def __init__(self, file: io.BytesIO):
        super().__init__(file, encoding="latin1")
        self._bytes = file

    def find_class(self, module: str, name: str) -> Any:
        """What a name stands for. Raises InputError if it is no array or container."""
        if (module, name) not in _ALLOWED:
            raise InputError(f"it holds {module}.{name}, which is not executed (expected NumPy arrays and plain containers)")
        return _ALLOWED[module, name]

    def load_build(self) -> None:
        """Sets the state of an object; where joblib announced an array, its bytes follow."""
        super().load_build()
        if isinstance(self.stack[-1], _JoblibArray):
            self.stack[-1] = self._array(vars(self.stack[-1]))

    dispatch[pickle.BUILD[0]] = load_build

    def _array(self, said: dict[str, Any]) -> np.ndarray:
        """The array whose bytes come next, after as many of padding as the first byte says."""
        dtype, shape = said["dtype"], tuple(map(int, said["shape"]))
        if not isinstance(dtype, np.dtype) or dtype.hasobject:
            raise InputError("it holds an array of objects, which is not executed (expected numbers)")
        if said.get("numpy_array_alignment_bytes") is not None:
            self._bytes.read(self._bytes.read(1)[0])
        size = math.prod(shape) * dtype.itemsize
        data = self._bytes.read(size)
        if len(data) < size:
            raise EOFError("it ends inside an array")
        return np.frombuffer(data, dtype).reshape(shape, order="F" if said.get("order") == "F" else "C")


def from_pickle(path: Path) -> dict[str, Any]:
    """The fields of a pickle, nested ones by their joined names. Raises InputError naming what else it holds."""
    try:
        said = _Unpickler(io.BytesIO(path.read_bytes())).load()
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if not isinstance(said, dict):
        raise InputError(f"{path}: holds a {type(said).__name__} (expected fields by name)")
    return flat(said)
