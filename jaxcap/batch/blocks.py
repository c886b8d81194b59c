"""Rows in blocks for cores and devices, and in chunks for the cache.

Two loops over blocks are here, and every other part of the library uses one of them: `over_blocks` on the host, from one
thread a core, and `over_chunks` inside a program.
"""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxcap.contacts.actuation import ActuatedRays
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import FloatArray
from jaxcap.numerics.whole import ceil_div, round_up
from jaxcap.one_state.line import Cone

BLOCK = 1 << 13
"""States of a block, one call of the compiled program; several run at a time."""
RAYS_BLOCK = 1 << 12
"""The same where every state has its own contacts: it takes longer, and both cores should have work."""
SMALL_BLOCK = 1 << 9
"""The other size of a block, so that any number of rows meets two programs at most. Up to so many rows are one: what a block
costs besides its states, sorting its rows first of all, grows with its size."""
ROWS = 16
"""Faces and rays are padded to a multiple of this, so that not every contact set is compiled anew. It is what a sole's four
corners have in rays, of four sides each: soles and palms are not padded."""
LANES = 64
"""States of a chunk, computed side by side: rows x lanes numbers should fit the cache."""


def padded_cone(cone: Cone) -> Cone:
    """The same, faces or rays padded to a multiple of ROWS; with a robot's limits as it is."""
    if isinstance(cone, ActuatedRays):
        return cone
    if isinstance(cone, CentroidalCone):
        return cone.padded(round_up(max(len(cone.faces), 1), ROWS))
    return to_host(cone).padded(round_up(max(cone.rays.shape[-2], 1), ROWS))  # JAX would compile the padding of every shape


def own_or_common(cone: Cone) -> tuple[ConeRays | ActuatedRays | None, Cone | None]:
    """The cones of each state, or the one of all, padded; the other is None."""
    padded = padded_cone(cone)
    if isinstance(padded, ConeRays | ActuatedRays) and padded.batched:
        return padded, None
    return None, padded


def over_blocks(run: Callable[["Block"], Any], rows: Any, n: int, block: int, shares: int = 1) -> Any:
    """`run` of n rows, a block at a time, joined; of no rows, what it makes of one empty block.

    The first block runs alone: it compiles the program, which the others share. shares: of a block, see `block_of`.
    """
    rows = to_host(rows) if shares == 1 else rows
    one = lambda start: run(block_of(rows, n, start, block, shares))
    first, *starts = range(0, max(n, 1), block)
    parts = [one(first), *side_by_side(one, starts)]
    return jax.tree.map(lambda *fields: _joined(fields, n), *parts)


def _joined(fields: tuple[Any, ...], n: int) -> Any:
    """One block's rows are taken as they are: each operation by itself takes as long as the answer for a state."""
    if len(fields) == 1 and len(fields[0]) == n and isinstance(fields[0], jax.Array):
        return fields[0]
    parts = to_host(fields)
    if all(isinstance(part, np.ndarray) for part in parts):
        rows = parts[0] if len(parts) == 1 else np.concatenate(parts)
        return jax.device_put(rows[:n])  # jnp.asarray compiles a copy for every shape
    return jnp.concatenate(fields)[:n]


def to_host(tree: Any) -> Any:
    """What lies in the host's memory, and was placed there by nobody, as NumPy's: to cut and pad that compiles nothing."""
    known = lambda x: isinstance(x, jax.Array) and not isinstance(x, jax.core.Tracer)
    here = lambda x: known(x) and not x.committed and all(d.platform == "cpu" for d in x.devices())
    return jax.tree.map(lambda x: np.asarray(x) if here(x) else x, tree)


def side_by_side(run: Callable[[Any], Any], items: Iterable, ahead: int = sys.maxsize) -> Iterator:
    """The results of run(item), in order, from one thread a core: on a CPU, JAX runs what one thread asks for in sequence.

    ahead: how many items at most are begun beyond the one whose result is waited for. Called when the program is compiled.
    """
    # JAX makes the settings' names at run time.
    x64, device = jax.config.jax_enable_x64, jax.config.jax_default_device  # type: ignore[attr-defined]

    def in_thread(item: Any) -> Any:
        with jax.enable_x64(x64), jax.default_device(device):  # both settings belong to a thread
            return jax.block_until_ready(run(item))

    waiting: deque = deque()
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as threads:
        try:
            for item in items:
                waiting.append(threads.submit(in_thread, item))
                if len(waiting) > ahead:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


class Block(NamedTuple):
    """Some of the rows, padded."""

    rows: Any
    filled: Int[FloatArray, ""] | None
    """So many are no padding; None: all are, or devices share them, of which each would have a number of its own."""


def block_of(rows: Any, n: int, start: int, block: int, shares: int = 1) -> Block:
    """One block of n rows, padded to one of two sizes, each of which is compiled once, in equal shares.

    Padding costs nothing where the program is told of `Block.filled`.
    """
    here = min(block, n - start)
    most = block // shares
    size = most if start or ceil_div(here, shares) > SMALL_BLOCK else min(most, SMALL_BLOCK)
    cut = lambda leaf: leaf if len(leaf) <= block else leaf[start : start + block]
    return Block(padded(jax.tree.map(cut, rows), shares * size), np.asarray(here, np.int32) if shares == 1 else None)


def over_chunks(one: Callable, rows: Any, lanes: int = LANES, filled: Int[FloatArray, ""] | None = None) -> Any:
    """`one` of all rows, a chunk at a time, a row a lane; lanes come last in what `one` takes and returns.

    filled: rows from here on are padding; they get zeros, or what `one` makes of them. Reverse mode needs None.
    """
    n = len(jax.tree.leaves(rows)[0])
    chunks = ceil_div(n, lanes)
    to_chunks = lambda x: jnp.moveaxis(x.reshape(chunks, lanes, *x.shape[1:]), 1, -1)
    chunked = jax.tree.map(to_chunks, padded(rows, chunks * lanes))
    found = (
        jax.lax.map(one, chunked) if filled is None else _first_chunks(one, chunked, ceil_div(jnp.asarray(filled), lanes))
    )
    return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 1).reshape(chunks * lanes, *x.shape[1:-1])[:n], found)


def _first_chunks(one: Callable, chunked: Any, count: Int[Array, ""]) -> Any:
    """`jax.lax.map`, but only of the first `count`."""
    one = jax.jit(one)  # traced once, for the shapes and in the loop
    of_chunk = jax.eval_shape(one, jax.tree.map(lambda x: x[0], chunked))
    chunks = len(jax.tree.leaves(chunked)[0])
    nothing = jax.tree.map(lambda x: jnp.zeros((chunks, *x.shape), x.dtype), of_chunk)
    put = lambda k: lambda all_of_it, new: jax.lax.dynamic_update_index_in_dim(all_of_it, new, k, 0)
    at = lambda k: lambda x: jax.lax.dynamic_index_in_dim(x, k, keepdims=False)
    return jax.lax.fori_loop(
        0, count, lambda k, found: jax.tree.map(put(k), found, one(jax.tree.map(at(k), chunked))), nothing
    )


def padded(rows: Any, size: int) -> Any:
    """With rows of zeros, up to this number."""
    pad = lambda x: (np if isinstance(x, np.ndarray) else jnp).pad(x, ((0, size - len(x)), *[(0, 0)] * (x.ndim - 1)))
    return jax.tree.map(lambda x: x if len(x) == size else pad(x), rows)
