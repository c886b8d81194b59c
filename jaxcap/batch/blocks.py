"""Rows in blocks for cores and devices, and in chunks for the cache.

Two loops over blocks are here, and every other part of the library uses one of them: `over_blocks` on the host, from one
thread a core, and `over_chunks` inside a program.
"""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxcap.contacts.actuation import ActuatedRays
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.numerics.whole import ceil_div, round_up
from jaxcap.one_state.line import Cone

BLOCK = 1 << 13
"""States of a block, one call of the compiled program; several run at a time."""
RAYS_BLOCK = 1 << 12
"""The same where every state has its own contacts: it takes longer, and both cores should have work."""
ROWS = 16
"""Faces are padded to a multiple of this, so that not every contact set is compiled anew."""
LANES = 64
"""States of a chunk, computed side by side: rows x lanes numbers should fit the cache."""


def padded_cone(cone: CentroidalCone | ConeRays) -> CentroidalCone | ConeRays:
    """The same, faces padded to a multiple of ROWS."""
    return cone.padded(round_up(max(len(cone.faces), 1), ROWS)) if isinstance(cone, CentroidalCone) else cone


def own_or_common(cone: Cone) -> tuple[ConeRays | ActuatedRays | None, Cone | None]:
    """The cones of each state, or the one of all; the other is None."""
    own = cone if isinstance(cone, ConeRays | ActuatedRays) and cone.batched else None
    if own is not None:
        return own, None
    return None, cone if isinstance(cone, ActuatedRays) else padded_cone(cone)


def over_blocks(run: Callable[[int], Any], n: int, block: int) -> Any:
    """run(start) for the block that begins with each row, joined, and cut to n rows; of no rows, those of one empty block.

    The first block runs alone: it compiles the program, which the others share.
    """
    first, *starts = range(0, max(n, 1), block)
    parts = [run(first), *side_by_side(run, starts)]
    return jax.tree.map(lambda *fields: _joined(fields, n), *parts)


def _joined(fields: tuple[Any, ...], n: int) -> Any:
    """One block's rows are taken as they are: each operation by itself takes as long as the answer for a state."""
    rows = jnp.asarray(fields[0]) if len(fields) == 1 else jnp.concatenate(fields)
    return rows if len(rows) == n else rows[:n]


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


def block_of(rows: Any, n: int, start: int, block: int, shares: int = 1) -> Any:
    """One block of n rows, padded to the next of a few sizes, each of which is compiled once, in equal shares."""
    count = ceil_div(min(block, n - start), shares)
    most = block // shares
    size = most if start else min(most, max(LANES, 1 << max(count - 1, 0).bit_length()))
    cut = lambda leaf: leaf if len(leaf) <= block else leaf[start : start + block]
    return padded(jax.tree.map(cut, rows), shares * size)


def over_chunks(one: Callable, rows: Any, lanes: int = LANES) -> Any:
    """`one` of all rows, a chunk at a time, a row a lane; lanes come last in what `one` takes and returns."""
    n = len(jax.tree.leaves(rows)[0])
    chunks = ceil_div(n, lanes)
    to_chunks = lambda x: jnp.moveaxis(x.reshape(chunks, lanes, *x.shape[1:]), 1, -1)
    found = jax.lax.map(one, jax.tree.map(to_chunks, padded(rows, chunks * lanes)))
    return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 1).reshape(chunks * lanes, *x.shape[1:-1])[:n], found)


def padded(rows: Any, size: int) -> Any:
    """With rows of zeros, up to this number."""
    pad = lambda x: (np if isinstance(x, np.ndarray) else jnp).pad(x, ((0, size - len(x)), *[(0, 0)] * (x.ndim - 1)))
    return jax.tree.map(lambda x: x if len(x) == size else pad(x), rows)
