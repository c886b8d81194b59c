"""HDF5: datasets stay in the file and are read where they are sliced. Importing this module needs h5py."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxcap.robots.readers.arrays import plain


def hdf5(path: Path, stack: ExitStack) -> dict[str, Any]:
    """The datasets of a file by their paths; attributes by the path of their group and `@`, as in `data/@version`."""
    file = stack.enter_context(h5py.File(path, "r"))
    found: dict[str, Any] = _attributes("", file)

    def visit(name: str, item: Any) -> None:
        found.update(_attributes(f"{name}/", item))
        if isinstance(item, h5py.Dataset):
            texts = h5py.check_string_dtype(item.dtype) is not None
            small = item.ndim == 0
            found[name] = plain(np.array(item.asstr()[()], dtype=str)) if texts else plain(item[()]) if small else item

    file.visititems(visit)
    return found


def _attributes(before: str, item: Any) -> dict[str, Any]:
    return {f"{before}@{name}": plain(value) for name, value in item.attrs.items()}
