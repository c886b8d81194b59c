"""Rays of contact sets that are asked for again and again, kept by the contents of the sets."""

from functools import lru_cache
from typing import NamedTuple

import jax
import numpy as np

from jaxcap.contacts.cone import ConeRays, cone_rays
from jaxcap.contacts.contact_set import ContactSet

MOST_KEPT = 1 << 20
"""Bytes of contacts whose rays are kept for the next call: eight hundred candidates of a hand beside two feet."""


class _Field(NamedTuple):
    """An array by its contents."""

    data: bytes
    shape: tuple[int, ...]
    dtype: str


def rays_of(contacts: ContactSet, sides: int) -> ConeRays:
    """Their rays, in NumPy, where to gather is several times as fast. In a loop of control the candidates are the same again
    and again, and to make their rays takes as long as to score them: those of few sets are kept, by their contents.

    Args:
        contacts: a batch of sets, of NumPy's arrays.
        sides: edges of each friction pyramid, >= 3.
    """
    leaves = jax.tree.leaves(contacts)
    if sum(leaf.nbytes for leaf in leaves) > MOST_KEPT:
        return jax.tree.map(np.asarray, cone_rays(contacts, sides))
    fields = tuple(_Field(leaf.tobytes(), leaf.shape, leaf.dtype.str) for leaf in leaves)
    return _kept_rays(fields, sides, bool(jax.config.jax_enable_x64))  # type: ignore[attr-defined]


@lru_cache(maxsize=8)
def _kept_rays(fields: tuple[_Field, ...], sides: int, x64: bool) -> ConeRays:
    """x64: the precision in which JAX makes them now."""
    leaves = (np.frombuffer(field.data, field.dtype).reshape(field.shape) for field in fields)
    return jax.tree.map(np.asarray, cone_rays(ContactSet.unchecked(*leaves), sides))
