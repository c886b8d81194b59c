"""What may be added to a contact set, and what is taken from it: checked, and as batches."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool

from jaxcap.contacts.contact_set import ContactSet


def stacked(candidates: Any) -> ContactSet:
    """Contact sets as one batch.

    Args:
        candidates: a batch of sets, or a list of sets with any number of rows.

    Raises:
        TypeError: for anything else.
        ValueError: for none.
    """
    if isinstance(candidates, ContactSet):
        if candidates.mask.ndim != 2:
            raise TypeError(f"candidates: {shape_of(candidates)} (expected a batch, points (m, k, 3), or a list of sets)")
    elif not isinstance(candidates, Sequence) or not all(isinstance(one, ContactSet) for one in candidates):
        raise TypeError(f"candidates: {shape_of(candidates)} (expected a batch of contact sets, or a list of them)")
    elif candidates:
        most = max(len(one) for one in candidates)
        candidates = jax.tree.map(lambda *leaves: np.stack(leaves), *[one.padded(most) for one in candidates])
    if len(candidates) == 0 or 0 in candidates.mask.shape or not np.any(candidates.mask):
        raise ValueError("candidates: none (expected at least one, with a contact that is not masked)")
    return candidates


def shape_of(given: Any) -> str:
    """In words, for messages."""
    if isinstance(given, ContactSet):
        return f"a ContactSet with points of shape {given.points.shape}"
    return f"{type(given).__name__}"


def lifted_rows(contacts: ContactSet, lifted: Any) -> Bool[np.ndarray, " k"]:
    """Which of k contacts are lifted.

    Args:
        contacts: one set.
        lifted: row numbers, or None.

    Raises:
        ValueError: for what is no row, or one that is masked.
    """
    rows = np.zeros(len(contacts), bool)
    if lifted is None:
        return rows
    given = np.atleast_1d(np.asarray(lifted))
    if given.size and given.dtype.kind not in "iu":
        raise ValueError(f"lifted: {given.dtype} (expected row numbers of contacts)")
    for i, row in enumerate(given.tolist()):
        if not 0 <= row < len(contacts) or not contacts.mask[row]:
            there = np.flatnonzero(contacts.mask).tolist()
            raise ValueError(f"lifted[{i}] = {row} (expected a row of contacts that is not masked, of {there})")
        rows[row] = True
    return rows
