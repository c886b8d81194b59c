"""Which places a hand or a foot can get to, and how long it takes: the simplest model, a straight way at one speed."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import ArrayLike
from jaxcap.contacts.surfaces import Number
from jaxcap.regions.candidate_sets import stacked


class LimbReach(NamedTuple):
    """Arguments of `next_contacts`, by these names; arrays (m,) for m candidates, or (n, m) for n places of the limb."""

    delay: Float[np.ndarray, "*n m"]
    """Until the candidate bears [s]; the reaction alone where places are not finite: those are out of reach."""
    reachable: Bool[np.ndarray, "*n m"]


def limb_reach(
    candidates: ContactSet | Sequence[ContactSet],
    limb: ArrayLike,
    speed: Number,
    reaction: Number = 0.0,
    *,
    root: ArrayLike | None = None,
    length: Number | None = None,
) -> LimbReach:
    """How soon a hand or a foot can be at each candidate, and which it reaches: `next_contacts(..., **found._asdict())`.

    The limb moves straight at one speed, through whatever is in its way, and is not slowed down by its own inertia; all
    distances are to the candidate's centroid.

    Args:
        candidates: m contact sets, as for `next_contacts`.
        limb: (3,) where the hand or foot is now, or (n, 3), for each state [m], in the contacts' frame.
        speed: of the limb [m/s].
        reaction: time before it starts to move [s].
        root: (3,) or (n, 3), hip or shoulder at touchdown [m]; only with `length`.
        length: of the outstretched limb [m]: what is farther from its root is out of reach.

    Returns:
        Delays and a mask. A candidate without contacts, or with numbers that are not finite, is out of reach, and so is all
        from a limb or root that is not finite.

    Raises:
        TypeError: for wrong shapes.
        ValueError: for a speed or length that is not positive and finite, a reaction that is negative or not finite, or a
            root without a length.
    """
    several = stacked(candidates)
    _check_numbers(speed, reaction, length)
    if (root is None) != (length is None):
        raise ValueError(f"{'length' if root is None else 'root'} is given alone (expected root and length, or neither)")
    start = _places("limb", limb)
    centres = _centres(several)
    distance = _distances(start, centres)
    reachable = np.isfinite(distance)
    if root is not None:
        base = _places("root", root)
        if base.ndim == 2 and base.shape != start.shape:
            raise TypeError(f"root has shape {base.shape} (expected (3,), or {start.shape}, as limb)")
        reachable &= _distances(base, centres) <= length  # NaN is not
    return LimbReach(reaction + np.where(np.isfinite(distance), distance, 0) / speed, reachable)


def _centres(candidates: ContactSet) -> Float[np.ndarray, "m 3"]:
    """NaN without contacts."""
    points, mask = np.asarray(candidates.points, np.float64), np.asarray(candidates.mask)[..., None]
    count = mask.sum(axis=1)
    return np.where(mask, points, 0).sum(axis=1) / np.where(count > 0, count, np.nan)


def _distances(places: Float[np.ndarray, "*n 3"], centres: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "*n m"]:
    return np.linalg.norm(places[..., None, :] - centres, axis=-1)


def _places(name: str, given: Any) -> Float[np.ndarray, "*n 3"]:
    """Raises TypeError."""
    places = np.asarray(given)
    if places.dtype.kind not in "iuf" or places.ndim not in (1, 2) or places.shape[-1] != 3:
        raise TypeError(f"{name}: {places.dtype} of shape {places.shape} (expected numbers, (3,), or (n, 3))")
    return places.astype(np.float64)


def _check_numbers(speed: Any, reaction: Any, length: Any) -> None:
    """Raises ValueError."""
    if not 0 < speed < np.inf:
        raise ValueError(f"speed = {speed} (expected a positive number of metres per second)")
    if not 0 <= reaction < np.inf:
        raise ValueError(f"reaction = {reaction} (expected a finite number of seconds, not negative)")
    if length is not None and not 0 < length < np.inf:
        raise ValueError(f"length = {length} (expected a positive number of metres)")
