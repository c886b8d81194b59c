"""Programs kept ready to run, so that a later process neither traces nor lowers them.

JAX's own cache, which `keep_programs` turns on, knows a program by what it was lowered to: every process has to trace and
lower it again to find it. Here it is known by all that tracing depends on: the arguments' shapes, the settings and versions
of JAX, the machine, and the text of the library itself.
"""

import functools
import hashlib
import os
import pickle
import platform
import tempfile
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jaxlib
import numpy as np
from jax.experimental import serialize_executable

from jaxcap.batch.kept_programs import kept_in
from jaxcap.version import __version__

ROOMS = ("numerics", "contacts", "one_state", "batch", "maps")
"""Programs are made of these."""
PRECISION = ("jax_enable_x64", "jax_default_matmul_precision")
"""Settings of JAX that users change from call to call; the others are looked at when a program is first asked for."""
ELSEWISE = ("jax_default_device", "jax_disable_jit", "jax_debug_nans", "jax_debug_infs")
"""Settings with which everything is left to `jax.jit`."""
DIGEST = hashlib.sha256().digest_size
"""Bytes at the head of a file, which tell whether the rest is whole."""


class Kept:
    """`jax.jit` of a function, whose programs are kept ready where `keep_programs` says; where it was not asked, `jax.jit`.

    Args:
        function: Of trees of arrays and, by name, of values that the program depends on.
        static: The names of these.
    """

    def __init__(self, function: Callable, *static: str):
        self.jitted = jax.jit(function, static_argnames=static)
        self._name = f"{function.__module__}.{function.__name__}"
        self._ready: dict[Any, Callable] = {}

    def __call__(self, *arrays: Any, **static: Any) -> Any:
        """As the function."""
        leaves, tree = jax.tree.flatten(arrays)
        folder = kept_in()
        if folder is None or not _plain(leaves):
            return self.jitted(*arrays, **static)
        shapes = tuple((leaf.shape, str(jax.dtypes.canonicalize_dtype(leaf.dtype))) for leaf in leaves)
        asked = tree, shapes, tuple(sorted(static.items())), *map(_setting, PRECISION)
        if (folder, asked) not in self._ready:
            self._ready[folder, asked] = self._made(folder / f"{self._digest(asked)}.program", arrays, static)
        return self._ready[folder, asked](*arrays)

    def _digest(self, asked: tuple) -> str:
        settings = {name: _setting(name) for name in jax.config.values if "cache" not in name}
        told = self._name, *map(str, asked), settings, _library(), _machine()
        return hashlib.sha256(repr(told).encode()).hexdigest()

    def _made(self, path: Path, arrays: tuple, static: dict[str, Any]) -> Callable:
        """Taken from the folder, or compiled and put there."""
        program = _taken(path)
        if program is None:
            program = self.jitted.lower(*arrays, **static).compile()
            _put(path, program)
        return program


def _plain(leaves: list[Any]) -> bool:
    """Whether it is a call on the only device, of arrays that were placed nowhere, and nobody looks for errors."""
    if jax.device_count() > 1 or any(map(_setting, ELSEWISE)):
        return False
    placed = lambda x: isinstance(x, jax.core.Tracer) or (isinstance(x, jax.Array) and (x.committed or x.weak_type))
    return all(isinstance(leaf, np.ndarray | np.generic | jax.Array) and not placed(leaf) for leaf in leaves)


def _taken(path: Path) -> Callable | None:
    """None if there is none that can be used."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        _note(path, error)
        return None
    if hashlib.sha256(data[DIGEST:]).digest() != data[:DIGEST]:
        _note(path, "it is damaged")
        return None
    try:
        return serialize_executable.deserialize_and_load(*pickle.loads(zlib.decompress(data[DIGEST:])))
    except Exception as error:  # whatever another build of JAX makes of it: it is compiled again
        _note(path, error)
        return None


def _put(path: Path, program: Any) -> None:
    """Whole or not at all."""
    try:
        data = zlib.compress(pickle.dumps(serialize_executable.serialize(program)), level=1)
    except (jax.errors.JaxRuntimeError, ValueError):
        return  # what JAX took from its own cache cannot be written once more
    try:
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            part = Path(folder) / path.name
            part.write_bytes(hashlib.sha256(data).digest() + data)
            os.replace(part, path)
    except OSError as error:
        _note(path, error)


def _note(path: Path, why: Any) -> None:
    warnings.warn(f"persistent compilation cache entry {path}: {why}; compiled anew", UserWarning, stacklevel=2)


def _setting(name: str) -> Any:
    """Of JAX, as it is for this thread."""
    return getattr(jax.config, name, jax.config.values.get(name))


@functools.cache
def _library() -> str:
    """Its text, and the versions of all that makes programs of it."""
    found = hashlib.sha256(f"{__version__} {jax.__version__} {jaxlib.__version__}".encode())
    for room in ROOMS:
        for file in sorted((Path(__file__).parents[1] / room).glob("*.py")):
            found.update(f"{file.name}\n".encode() + file.read_bytes())
    return found.hexdigest()


@functools.cache
def _machine() -> str:
    """What a program may have been compiled for: a folder may be that of several machines."""
    device = jax.devices()[0]
    try:
        told = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        told = [platform.processor()]
    processor = sorted({line for line in told if line.startswith(("flags", "Features", "model name"))} or set(told[:1]))
    flags = os.environ.get("XLA_FLAGS", "")
    return repr((device.platform, device.device_kind, device.client.platform_version, platform.machine(), processor, flags))
