"""Robots when a new contact begins to bear, and what they are worth with it: what one next contact and several share."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from jaxcap.batch.advance import advance
from jaxcap.batch.score import score
from jaxcap.contacts.actuation import Actuation
from jaxcap.contacts.cone import ConeRays
from jaxcap.contacts.conventions import ArrayLike
from jaxcap.contacts.scoring_input import unless_zero
from jaxcap.one_state.advance import Progress

PAIRS = 1 << 15
"""Of state and contact set, at a time: their rays take 40 MB in single precision for two feet and a hand."""

NONE = -1
"""The best candidate where there is none."""


class Model(NamedTuple):
    """What holds for all states."""

    gravity: ArrayLike
    momentum_box: float
    """[m^2/s^2]"""


class States(NamedTuple):
    """In NumPy, n of them."""

    coms: Float[np.ndarray, "n 3"]
    com_velocities: Float[np.ndarray, "n 3"]
    momenta: Float[np.ndarray, "n 3"] | None
    """Angular, over the mass."""


class Touchdown(NamedTuple):
    """States when the new contact begins to bear, n of them."""

    states: States
    progress: Int8[np.ndarray, " n"]
    lost: Bool[np.ndarray, " n"]
    """The state is that of an earlier time: contacts are lost, or it would have turned back."""


class Scored(NamedTuple):
    """What `Capturability` says of each of some pairs."""

    margin: Float[np.ndarray, "..."]
    capturable: Bool[np.ndarray, "..."]
    case: Int8[np.ndarray, "..."]
    status: Int8[np.ndarray, "..."]


def model_of(gravity: ArrayLike, momentum_box: Any) -> Model:
    """Raises TypeError for boxes that differ from state to state."""
    if np.ndim(momentum_box):
        raise TypeError(f"momentum_box has shape {np.shape(momentum_box)} (expected one number)")
    return Model(gravity, momentum_box)


def states_of(com: Any, com_velocity: Any, momentum: Any) -> tuple[States, bool]:
    """As rows, and whether they were. Raises TypeError."""
    com, com_velocity = np.asarray(com), np.asarray(com_velocity)
    if com.ndim not in (1, 2) or com.shape[-1:] != (3,) or com_velocity.shape != com.shape:
        raise TypeError(
            f"com, com_velocity have shapes {com.shape}, {com_velocity.shape} (expected (3,), or (n, 3) for both)"
        )
    momentum = unless_zero(None if momentum is None else np.asarray(momentum))
    if momentum is not None and momentum.shape != com.shape:
        raise TypeError(f"specific_angular_momentum has shape {momentum.shape} (expected {com.shape}, as com)")
    momenta = None if momentum is None else np.atleast_2d(momentum)
    return States(np.atleast_2d(com), np.atleast_2d(com_velocity), momenta), com.ndim == 2


def touchdown(
    cones: ConeRays, which: Int[np.ndarray, " n"] | None, states: States, times: Float[np.ndarray, " n"], model: Model
) -> Touchdown:
    """Each state after its time of hardest braking.

    Args:
        cones: of one contact set that bears until then, or of several.
        which: the contact set of each state, of several.
        states: n of them.
        times: until the new contact bears [s].
        model: of all.
    """
    size = max(len(times), 1) if which is None else PAIRS
    parts = []
    for start in range(0, max(len(times), 1), size):
        rows = slice(start, start + size)
        bearing = cones if which is None else _rows_of(cones, which[rows])
        parts.append(_ride(bearing, _rows_of(states, rows), times[rows], model))
    return parts[0] if len(parts) == 1 else jax.tree.map(lambda *fields: np.concatenate(fields), *parts)


def scored(
    cones: ConeRays,
    which: Int[np.ndarray, " p"],
    states: States,
    rows: Int[np.ndarray, " p"],
    model: Model,
    actuation: Actuation | None = None,
    postures: Int[np.ndarray, " p"] | None = None,
) -> Scored:
    """`score` of pairs of contact set and state, so many at a time that their rays fit the memory.

    Args:
        cones: of several contact sets.
        which: the contact set of each pair.
        states: any number of them.
        rows: the state of each pair.
        model: of all.
        actuation: of several postures.
        postures: that of each pair.
    """
    parts = []
    for start in range(0, max(len(which), 1), PAIRS):
        pairs = slice(start, start + PAIRS)
        coms, velocities, momenta = _rows_of(states, rows[pairs])
        found = score(
            _rows_of(cones, which[pairs]),
            coms,
            velocities,
            model.gravity,
            specific_angular_momentum=momenta,
            actuation=None if postures is None else _rows_of(actuation, postures[pairs]),
            momentum_box=model.momentum_box,
        )
        parts.append(Scored(*map(np.asarray, (found.margin, found.capturable, found.case, found.status))))
    return parts[0] if len(parts) == 1 else jax.tree.map(lambda *fields: np.concatenate(fields), *parts)


def best_of(margin: Float[np.ndarray, "n m"], capturable: Bool[np.ndarray, "n m"]) -> Int[np.ndarray, " n"]:
    """The column with the largest margin [m/s], or `NONE`. A robot that already rests has no margin, and no need of any."""
    rank = np.where(np.isnan(margin), np.where(capturable, np.inf, -np.inf), margin)
    return np.where(np.max(rank, axis=1) > -np.inf, np.argmax(rank, axis=1), NONE)


def _ride(cones: ConeRays, states: States, times: Float[np.ndarray, " n"], model: Model) -> Touchdown:
    alone = len(times) == 1 and not cones.batched  # not side by side with copies of itself
    coms, velocities, momenta = _rows_of(states, 0) if alone else states
    found = advance(
        cones,
        coms,
        velocities,
        times[0] if alone else times,
        model.gravity,
        specific_angular_momentum=momenta,
        momentum_box=model.momentum_box,
    )
    field = lambda given: np.asarray(given)[None] if alone else np.asarray(given)
    progress, spinning = field(found.progress), found.specific_angular_momentum
    then = States(field(found.com), field(found.com_velocity), None if spinning is None else field(spinning))
    return Touchdown(then, progress, np.isin(progress, [Progress.TURNS, Progress.LEAVES]) & (times > 0))


def _rows_of(tree: Any, rows: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[rows], tree)
