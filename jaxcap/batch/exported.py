"""Programs for processes that have JAX but no jaxcap.

    Path("feet.jax").write_bytes(export(cone))                                       # here
    program = jax.jit(jax.export.deserialize(Path("feet.jax").read_bytes()).call)    # there
    out = program(coms, com_velocities)                                              # out["capturable"], out["margin"], ...

What is in the file is lowered ahead of time, for any machine, and compiled where it is called. JAX promises to read files
that are up to six months older than itself. There it needs jax and flatbuffers, here the extra `export`. A file is code:
load none that you do not trust.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxcap.batch.blocks import BLOCK, LANES, padded_cone
from jaxcap.batch.rounds import Shared, States, scored_block
from jaxcap.contacts.cone import CentroidalCone, ConeRays, cone_rays
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY
from jaxcap.errors import needs_extra

PLATFORMS = ("cpu", "cuda", "rocm", "tpu")
"""Where a program runs unless fewer are asked for: more cost a few bytes."""
ANY_BLOCK = 8 * LANES
"""States of a block where their number is not known: small, for one state costs as much as a block."""


def export(
    cone: CentroidalCone | ConeRays,
    n: int | str = "n",
    dtype="float32",
    gravity=GRAVITY,
    platforms: Sequence[str] = PLATFORMS,
) -> bytes:
    """`score` for one contact set, as a program to be loaded by `jax.export.deserialize`.

    cone: of one contact set, from `centroidal_cone` or `cone_rays`; it becomes part of the program. n: number of states;
    text, the name of a dimension, stands for any from 1 on, each of which is compiled when it is first met. A fixed number
    is quicker where it is small: one state takes the time of 64, and with any n that of 512. dtype: float32 or float64, of
    states and answers; float64 is called under `jax.enable_x64(True)`. gravity: (3,) [m/s^2]. platforms: those of
    `jax.export.export`.

    The program takes coms (n, 3) [m] and com_velocities (n, 3) [m/s], of that dtype, and returns a dict: each field of
    `Capturability` (n,), under its name; `case` and `status` are numbers. The answers are those of `score` but for
    rounding. It has no derivative, and uses one core of a CPU, one device.

    Raises ValueError for rays of several contact sets, a number of states or a dtype that cannot be, and MissingExtra.
    """
    if jax.tree.leaves(cone)[0].ndim != 2:
        raise ValueError(f"cone is that of {len(jax.tree.leaves(cone)[0])} contact sets (expected one)")
    cone = jax.tree.map(np.asarray, padded_cone(cone))
    return _serialized(lambda: cone, (), n, dtype, gravity, platforms)


def export_contacts(
    contacts: int,
    sides: int = 4,
    n: int | str = "n",
    dtype="float32",
    gravity=GRAVITY,
    platforms: Sequence[str] = PLATFORMS,
) -> bytes:
    """The same, with the contacts as an argument: one program for all contact sets of up to so many contacts.

    contacts: how many, at least 1. sides: edges of each friction pyramid, >= 3. The other arguments are those of `export`.

    The program takes, before coms and com_velocities, the fields of one `ContactSet` for all states: points (k, 3) [m],
    frames (k, 3, 3), friction (k,), of that dtype, and mask (k,), bool, false for rows that are padding; such a row needs
    finite numbers and a friction > 0. It computes by rays: no projection, and more time for each state. What `ContactSet`
    checks is not checked there: frames are rotations, friction is positive.

    Raises ValueError for numbers that cannot be, and MissingExtra.
    """
    if contacts < 1:
        raise ValueError(f"contacts = {contacts} (expected at least 1)")
    cone = lambda *fields: cone_rays(ContactSet.tree_unflatten(None, fields), sides)
    figures = [(contacts, 3), (contacts, 3, 3), (contacts,)]
    shapes = (*((shape, dtype) for shape in figures), ((contacts,), "bool"))
    return _serialized(cone, shapes, n, dtype, gravity, platforms)


def _serialized(cone: Callable, of_contacts: Sequence, n: int | str, dtype, gravity, platforms) -> bytes:
    """A program that takes what `cone` takes, of these shapes and dtypes, and the states."""
    dtype = np.dtype(dtype)
    if dtype not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise ValueError(f"dtype = {dtype} (expected float32 or float64)")
    if not isinstance(n, str) and n < 1:
        raise ValueError(f"n = {n} (expected at least 1, or the name of a dimension)")
    with needs_extra("export", "jaxcap.exported"):
        import flatbuffers  # noqa: F401
    gravity = np.asarray(gravity, dtype)
    block = ANY_BLOCK if isinstance(n, str) else min(n, BLOCK)

    def capturability(*arguments):
        *contacts, coms, com_velocities = arguments
        common = cone(*contacts)
        answer = lambda states: scored_block(Shared(gravity, common), states, False)._asdict()
        return _over_blocks(answer, States(coms, com_velocities), block)

    with jax.enable_x64(dtype.itemsize == 8):
        (count,) = jax.export.symbolic_shape(n) if isinstance(n, str) else (n,)
        shapes = [jax.ShapeDtypeStruct(*each) for each in (*of_contacts, ((count, 3), dtype), ((count, 3), dtype))]
        return bytes(jax.export.export(jax.jit(capturability), platforms=tuple(platforms))(*shapes).serialize())


def _over_blocks(one: Callable, rows, block: int):
    """`one` of all rows, a block at a time. Not `over_chunks`: the number of rows may be a symbol, and rows stay first."""
    n = jax.tree.leaves(rows)[0].shape[0]
    blocks = (n + block - 1) // block
    fill = lambda x: jnp.pad(x, ((0, blocks * block - n), (0, 0))).reshape(blocks, block, *x.shape[1:])
    return jax.tree.map(lambda x: x.reshape(blocks * block)[:n], jax.lax.map(one, jax.tree.map(fill, rows)))
