"""What may be added to a contact set, and what is taken from it: checked, and as batches."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool

from jaxcap.contacts.contact_set import ContactSet


def stacked(candidates: Any, name: str = "candidates") -> ContactSet:
    """Contact sets as one batch.

    Args:
        candidates: a batch of sets, or a list of sets with any number of rows.
        name: for messages.

    Raises:
        TypeError: for anything else.
        ValueError: for none.
    """
    if isinstance(candidates, ContactSet):
        if candidates.mask.ndim != 2:
            raise TypeError(f"{name}: {shape_of(candidates)} (expected a batch, points (m, k, 3), or a list of sets)")
    elif not isinstance(candidates, Sequence) or not all(isinstance(one, ContactSet) for one in candidates):
        raise TypeError(f"{name}: {shape_of(candidates)} (expected a batch of contact sets, or a list of them)")
    elif candidates:
        most = max(len(one) for one in candidates)
        candidates = jax.tree.map(lambda *leaves: np.stack(leaves), *[one.padded(most) for one in candidates])
    if len(candidates) == 0 or 0 in candidates.mask.shape or not np.any(candidates.mask):
        raise ValueError(f"{name}: none (expected at least one, with a contact that is not masked)")
    return candidates


def one_set(contacts: Any) -> ContactSet:
    """The same, in NumPy. Raises TypeError for anything but one contact set."""
    if not isinstance(contacts, ContactSet) or contacts.mask.ndim != 1:
        raise TypeError(f"contacts: {shape_of(contacts)} (expected one ContactSet)")
    return jax.tree.map(np.asarray, contacts)


def shape_of(given: Any) -> str:
    """In words, for messages."""
    if isinstance(given, ContactSet):
        return f"a ContactSet with points of shape {given.points.shape}"
    return f"{type(given).__name__}"


def lifted_rows(there: Bool[np.ndarray, " k"], lifted: Any, name: str = "lifted") -> Bool[np.ndarray, " k"]:
    """Which of k contacts are lifted.

    Args:
        there: the contacts that are not masked.
        lifted: row numbers, or None.
        name: for messages.

    Raises:
        ValueError: for what is no row, or one that is masked.
    """
    rows = np.zeros(len(there), bool)
    if lifted is None:
        return rows
    given = np.atleast_1d(np.asarray(lifted))
    if given.size and given.dtype.kind not in "iu":
        raise ValueError(f"{name}: {given.dtype} (expected row numbers of contacts)")
    for i, row in enumerate(given.tolist()):
        if not 0 <= row < len(there) or not there[row]:
            known = np.flatnonzero(there).tolist()
            raise ValueError(f"{name}[{i}] = {row} (expected a row of contacts that is not masked, of {known})")
        rows[row] = True
    return rows


def in_reach(reachable: Any, shape: tuple[int, ...], name: str = "reachable") -> Bool[np.ndarray, "..."]:
    """Which candidates are in reach.

    Args:
        reachable: bool, broadcast to the shape; None: all.
        shape: wanted.
        name: for messages.

    Raises:
        TypeError: for anything else.
    """
    given = np.asarray(True if reachable is None else reachable)
    try:
        fits = np.broadcast_shapes(given.shape, shape) == shape
    except ValueError:
        fits = False
    if given.dtype != bool or not fits:
        raise TypeError(f"{name}: {given.dtype} of shape {given.shape} (expected bool of shape {shape}, or its last axes)")
    return np.broadcast_to(given, shape)


def lift(contacts: ContactSet, lifted: Bool[np.ndarray, " k"]) -> ContactSet:
    """One contact set, or a batch of them, with these rows masked."""
    return ContactSet.unchecked(contacts.points, contacts.frames, contacts.friction, contacts.mask & ~lifted)


def joined(contacts: ContactSet, candidates: ContactSet) -> ContactSet:
    """Each of p contact sets with each of m candidates: a batch of p m sets, the candidates of the first set first."""
    p, m = len(contacts.mask), len(candidates.mask)

    def join(now: np.ndarray, new: np.ndarray) -> np.ndarray:
        return np.concatenate([np.repeat(now, m, axis=0), np.tile(new, (p, *[1] * (new.ndim - 1)))], axis=1)

    return jax.tree.map(join, contacts, candidates)
