"""Programs for processes that have JAX but no jaxcap.

    Path("feet.jax").write_bytes(export(cone))                                       # here
    program = jax.jit(jax.export.deserialize(Path("feet.jax").read_bytes()).call)    # there
    out = program(coms, com_velocities)                                              # out["capturable"], out["margin"], ...

What is in the file is lowered ahead of time, for any machine, and compiled where it is called. JAX promises to read files
that are up to six months older than itself. There it needs jax and flatbuffers, here the extra `export`. A file is code:
load none that you do not trust.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import DTypeLike

from jaxcap.batch.blocks import BLOCK, LANES, padded_cone
from jaxcap.batch.rounds import Shared, States, scored_block
from jaxcap.contacts.cone import CentroidalCone, ConeRays, cone_rays
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY, ArrayLike, checked_gravity
from jaxcap.errors import needs_extra

PLATFORMS = ("cpu", "cuda", "rocm", "tpu")
"""Where a program runs unless fewer are asked for: more cost a few bytes."""
ANY_BLOCK = 8 * LANES
"""States of a block where their number is not known: small, for one state costs as much as a block."""


def export(
    cone: CentroidalCone | ConeRays,
    n: int | str = "n",
    dtype: DTypeLike = "float32",
    gravity: ArrayLike = GRAVITY,
    platforms: Sequence[str] = PLATFORMS,
    positions: DTypeLike | None = None,
    momentum: bool = False,
) -> bytes:
    """`score` for one contact set, as a program to be loaded by `jax.export.deserialize`.

    The program takes coms (n, 3) [m] and com_velocities (n, 3) [m/s], and returns a dict: each field of `Capturability`
    (n,), under its name; `case` and `status` are numbers. The answers are those of `score` but for rounding. It has no
    derivative, and uses one core of a CPU, one device.

    Args:
        cone: of one contact set, from `centroidal_cone` or `cone_rays`; it becomes part of the program.
        n: number of states; text, the name of a dimension, stands for any from 1 on, each of which is compiled when it is
            first met. A fixed number is quicker where it is small: one state takes the time of 64, and with any n that of
            512.
        dtype: float32 or float64, of states and answers; a float64 program is called under `jax.enable_x64(True)`.
        gravity: (3,) [m/s^2].
        platforms: those of `jax.export.export`.
        positions: dtype of coms, by default `dtype`. With float64 beside a dtype of float32, the contacts' centroid is
            subtracted before anything is rounded: for robots far from the origin. Such a program, too, is called under
            `jax.enable_x64(True)`.
        momentum: the program takes a third argument, specific_angular_momentum (n, 3) [m^2/s]; see `score`.

    Returns:
        The program, to be loaded by `jax.export.deserialize`.

    Raises:
        ValueError: for rays of several contact sets, a number of states or a dtype that cannot be.
        MissingExtra: without the extra `export`.
    """
    if jax.tree.leaves(cone)[0].ndim != 2:
        raise ValueError(f"cone is that of {len(jax.tree.leaves(cone)[0])} contact sets (expected one)")
    cone = jax.tree.map(np.asarray, padded_cone(cone))
    return _serialized(lambda: cone, (), n, _Dtypes.of(dtype, positions), gravity, platforms, momentum)


def export_contacts(
    contacts: int,
    sides: int = 4,
    n: int | str = "n",
    dtype: DTypeLike = "float32",
    gravity: ArrayLike = GRAVITY,
    platforms: Sequence[str] = PLATFORMS,
    positions: DTypeLike | None = None,
    momentum: bool = False,
) -> bytes:
    """The same, with the contacts as an argument: one program for all contact sets of up to so many contacts.

    The program takes, before coms and com_velocities, the fields of one `ContactSet` for all states: points (k, 3) [m], of
    the dtype of positions, frames (k, 3, 3), friction (k,), of that of the answers, and mask (k,), bool, false for rows that
    are padding; such a row needs finite numbers and a friction > 0. It computes by rays: no projection, and more time for
    each state. What `ContactSet` checks is not checked there: frames are rotations, friction is positive.

    Args:
        contacts: how many, at least 1.
        sides: edges of each friction pyramid, >= 3.
        n, dtype, gravity, platforms, positions, momentum: those of `export`.

    Returns:
        The program, to be loaded by `jax.export.deserialize`.

    Raises:
        ValueError: for numbers that cannot be.
        MissingExtra: without the extra `export`.
    """
    if contacts < 1:
        raise ValueError(f"contacts = {contacts} (expected at least 1)")
    cone = lambda *fields: cone_rays(ContactSet.unchecked(*fields), sides)
    dtypes = _Dtypes.of(dtype, positions)
    points, frames = ((contacts, 3), dtypes.positions), ((contacts, 3, 3), dtypes.answers)
    shapes = (points, frames, ((contacts,), dtypes.answers), ((contacts,), bool))
    return _serialized(cone, shapes, n, dtypes, gravity, platforms, momentum)


class _Dtypes(NamedTuple):
    """In which precision a program computes, and takes positions."""

    answers: np.dtype
    positions: np.dtype

    @classmethod
    def of(cls, dtype: DTypeLike, positions: DTypeLike | None) -> "_Dtypes":
        """Raises ValueError for anything but float32 and float64."""
        dtypes = cls(np.dtype(dtype), np.dtype(dtype if positions is None else positions))
        for name, value in zip(("dtype", "positions"), dtypes, strict=True):
            if value not in (np.dtype(np.float32), np.dtype(np.float64)):
                raise ValueError(f"{name} = {value} (expected float32 or float64)")
        return dtypes


def _serialized(
    cone: Callable,
    of_contacts: Sequence,
    n: int | str,
    dtypes: _Dtypes,
    gravity: ArrayLike,
    platforms: Sequence[str],
    momentum: bool,
) -> bytes:
    """A program that takes what `cone` takes, of these shapes and dtypes, and the states."""
    if not isinstance(n, str) and n < 1:
        raise ValueError(f"n = {n} (expected at least 1, or the name of a dimension)")
    checked_gravity(gravity, finite=False)
    with needs_extra("export", "jaxcap.exported"):
        import flatbuffers  # noqa: F401
    pull: Any = np.asarray(gravity, dtypes.answers)  # NumPy's: a constant of the program, whatever the x64 switch says here
    block = ANY_BLOCK if isinstance(n, str) else min(n, BLOCK)

    def capturability(*arguments):
        momenta = arguments[-1] if momentum else None
        *contacts, coms, com_velocities = arguments[:-1] if momentum else arguments
        there = cone(*contacts)
        arms = (coms - jnp.asarray(there.origin, dtypes.positions)).astype(dtypes.answers)
        here = jax.tree.map(lambda x: x if x.dtype == bool else jnp.asarray(x, dtypes.answers), there)
        shared = Shared(pull, here._replace(origin=jnp.zeros(3, dtypes.answers)))
        answer = lambda states: scored_block(shared, states, False)._asdict()
        return _over_blocks(answer, States(arms, com_velocities, None, momenta), block)

    with jax.enable_x64(max(dtypes.answers.itemsize, dtypes.positions.itemsize) == 8):
        (count,) = jax.export.symbolic_shape(n) if isinstance(n, str) else (n,)
        vectors = (count, 3), dtypes.answers
        of_states = ((count, 3), dtypes.positions), vectors, *([vectors] if momentum else [])
        shapes = [jax.ShapeDtypeStruct(*each) for each in (*of_contacts, *of_states)]
        return bytes(jax.export.export(jax.jit(capturability), platforms=tuple(platforms))(*shapes).serialize())


def _over_blocks(one: Callable, rows: Any, block: int) -> Any:
    """`one` of all rows, a block at a time. Not `over_chunks`: the number of rows may be a symbol, and rows stay first."""
    n = jax.tree.leaves(rows)[0].shape[0]
    blocks = (n + block - 1) // block
    fill = lambda x: jnp.pad(x, ((0, blocks * block - n), (0, 0))).reshape(blocks, block, *x.shape[1:])
    return jax.tree.map(lambda x: x.reshape(blocks * block)[:n], jax.lax.map(one, jax.tree.map(fill, rows)))
