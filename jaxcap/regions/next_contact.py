"""The next contact: which new foothold or grasp makes a robot capturable that is not, or most surely so.

Until the new contact bears, the robot brakes as hard as its present contacts allow (`advance`); then the question is that of
`score`, with the contact added. This is the one-step capture region, on floor, wall and rail alike.

What it says of a robot. Contacts bear whatever friction allows here, arms do not: in simulated touchdowns of TALOS's hand on
a wall, with its torque limits, three of four that this model calls saved still fell. So without the limits of the joints the
answer ranks candidates and rules them out, and only with `actuation` it says `saves`.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from jaxcap.batch.advance import advance, checked_times
from jaxcap.batch.score import score
from jaxcap.contacts.actuation import Actuation
from jaxcap.contacts.cone import ConeRays, cone_rays
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY, ArrayLike
from jaxcap.contacts.scoring_input import unless_zero
from jaxcap.one_state.advance import Progress
from jaxcap.one_state.result import Case
from jaxcap.regions.candidate_sets import lifted_rows, shape_of, stacked

PAIRS = 1 << 15
"""Of state and candidate, scored at a time: their rays take 40 MB in single precision for two feet and a hand."""
HALVINGS = 14
"""Of the horizon, in the search for the latest delay: a second is cut to 0.06 ms."""
MOST_KEPT = 1 << 20
"""Bytes of contacts whose rays are kept for the next call: eight hundred candidates of a hand beside two feet."""
NONE = -1
"""The best candidate where there is none."""


class NextContacts(NamedTuple):
    """What each of m candidates would do; arrays (m,), or (n, m) for n states.

    A ranking, unless `saves` is there: see above.
    """

    margin: Float[np.ndarray, "*n m"]
    """Of the state at touchdown with the new contact, as `Capturability.margin` [m/s]: infinite where contacts can press
    against each other as hard as one likes, such as a hand on a wall and feet on the floor. NaN where no speed is left,
    where the robot has lost its contacts or turned back by then, and for what is out of reach."""
    margin_without: Float[np.ndarray, "*n m"]
    """The same without it: what the new limb has to make up for, if negative [m/s]."""
    capturable: Bool[np.ndarray, "*n m"]
    """Whether the model can stop with it, whatever force friction allows."""
    case: Int8[np.ndarray, "*n m"]
    """A `Case`, with the new contact."""
    status: Int8[np.ndarray, "*n m"]
    """A `Status`."""
    progress: Int8[np.ndarray, "*n m"]
    """A `Progress`: how the robot comes to the time of touchdown."""
    best: Int[np.ndarray, "*n"]
    """The candidate with the largest margin, of those in reach; -1 where none has one."""
    latest: Float[np.ndarray, "*n m"] | None
    """Longest delay after which the model can still stop [s], up to the horizon; NaN where it cannot even at once. All
    shorter ones do, so that the earliest is zero: present contacts are among the later ones. None without a horizon."""
    saves: Bool[np.ndarray, "*n m"] | None
    """`capturable` within the limits of the robot's joints at touchdown; None without actuation."""


class _Sets(NamedTuple):
    """The contact sets that states are scored with: those of each candidate, and last, that without one."""

    cones: ConeRays
    """m + 1 of them."""
    during: ConeRays
    """Until touchdown."""
    gravity: ArrayLike
    actuation: Actuation | None
    """Of each of m candidates."""
    momentum_box: float = 0.0
    """[m^2/s^2]"""

    @property
    def candidates(self) -> int:
        """How many."""
        return len(self.cones.rays) - 1


class _Field(NamedTuple):
    """An array by its contents."""

    data: bytes
    shape: tuple[int, ...]
    dtype: str


class _States(NamedTuple):
    """As they are given, n of them."""

    coms: Float[np.ndarray, "n 3"]
    com_velocities: Float[np.ndarray, "n 3"]
    momenta: Float[np.ndarray, "n 3"] | None
    """Angular, over the mass."""


class _Touchdown(NamedTuple):
    """States when the new contact begins to bear, n by d: d = 1 where all candidates take the same time, else m."""

    coms: Float[np.ndarray, "n d 3"]
    com_velocities: Float[np.ndarray, "n d 3"]
    momenta: Float[np.ndarray, "n d 3"] | None
    """Angular, over the mass."""
    progress: Int8[np.ndarray, "n d"]
    lost: Bool[np.ndarray, "n d"]
    """The state is that of an earlier time: contacts are lost, or it would have turned back."""


def next_contacts(
    contacts: ContactSet,
    com: ArrayLike,
    com_velocity: ArrayLike,
    candidates: ContactSet | Sequence[ContactSet],
    delay: ArrayLike,
    lifted: ArrayLike | None = None,
    *,
    reachable: ArrayLike | None = None,
    horizon: float | None = None,
    specific_angular_momentum: ArrayLike | None = None,
    actuation: Actuation | None = None,
    momentum_box: float = 0.0,
    sides: int = 4,
    gravity: ArrayLike = GRAVITY,
) -> NextContacts:
    """Where a hand or a foot has to go so that the robot can stop: the margin with each candidate once it bears.

    On the host: the states in between are `advance`'s, the margins `score`'s.

    Args:
        contacts: one set, where the robot stands now.
        com: (3,), or (n, 3) for many states [m], in the contacts' frame, z up.
        com_velocity: (3,), or (n, 3) [m/s].
        candidates: what may be added, a contact set for each: a batch (see `ContactSet`), or a list of sets.
        delay: until it bears [s]: one number, (m,), one for each candidate, or (n, m); such as a reaction time plus distance
            over the speed of the limb.
        lifted: rows of `contacts` that bear nothing from now on: the foot that swings, which the candidates replace.
        reachable: (m,) or (n, m) bool, candidates that can be reached; all if not given.
        horizon: also look for `latest`, up to this delay [s]; takes sixteen times as long.
        specific_angular_momentum: (3,), or (n, 3) about the CoM, over the mass [m^2/s]; None for zero. Until touchdown, and
            after it, it keeps its proportion to the CoM's speed (see `advance`).
        actuation: of each of m candidates, what the joints can bear in the posture at touchdown: with rows for the
            `contacts`, then for those of the candidate. It counts from touchdown on, not before.
        momentum_box: how much the rate of angular momentum per unit mass may differ from what braking brings about, in each
            component, until touchdown and after it [m^2/s^2]: one number.
        sides: edges of each friction pyramid, >= 3.
        gravity: (3,) [m/s^2].

    Returns:
        Margins with and without each candidate, and the best; a ranking of candidates unless `actuation` is given.

    Raises:
        TypeError: for wrong shapes.
        ValueError: for no candidates, a delay, horizon or box that is negative or not finite, a lifted contact that is not
            there.
            A candidate or state with numbers that are not finite gets a status, and leaves the others alone.

    Source: on flat ground the regions of Koolen et al., Capturability-based Analysis, IJRR 2012, of motions along one line.
    """
    several = stacked(candidates)
    if np.ndim(momentum_box):
        raise TypeError(f"momentum_box has shape {np.shape(momentum_box)} (expected one number)")
    sets = _sets(contacts, several, lifted, sides, gravity, actuation)._replace(momentum_box=momentum_box)
    states, many = _states(com, com_velocity, specific_angular_momentum)
    shape = len(states.coms), sets.candidates
    delays = checked_times("delay", delay, shape if many else shape[1:])
    same = np.ndim(delay) == 0 and actuation is None
    delays = np.broadcast_to(np.asarray(delays), shape)[:, : 1 if same else None]
    there = _reachable(reachable, shape, many) & np.any(several.mask, axis=1)
    found = _answers(sets, states, delays, there)
    if horizon is not None:
        found = found._replace(latest=_latest(sets, states, float(checked_times("horizon", horizon, ())), there))
    return found if many else jax.tree.map(lambda field: field[0], found)


def _states(com: Any, com_velocity: Any, momentum: Any) -> tuple[_States, bool]:
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
    return _States(np.atleast_2d(com), np.atleast_2d(com_velocity), momenta), com.ndim == 2


def _answers(sets: _Sets, states: _States, delays: np.ndarray, there: np.ndarray) -> NextContacts:
    shape = len(states.coms), sets.candidates
    touchdown = _touchdown(sets, states, delays)
    wide = lambda field: np.broadcast_to(field, shape)
    margin, capturable, case, status = _scored(sets, touchdown, without=True)
    usable = there & ~wide(touchdown.lost)
    with_it, without = (np.where(usable, field, np.nan) for field in (margin[..., 0], margin[..., 1]))
    saved = usable & capturable[..., 0]
    # A robot that already rests has no margin, and no need of any.
    rank = np.where(np.isnan(with_it), np.where(saved, np.inf, -np.inf), with_it)
    return NextContacts(
        margin=with_it,
        margin_without=np.where(there, without, np.nan),
        capturable=saved,
        case=np.where(usable, case[..., 0], Case.UNDECIDED).astype(np.int8),
        status=status[..., 0],
        progress=wide(touchdown.progress),
        best=np.where(np.max(rank, axis=1) > -np.inf, np.argmax(rank, axis=1), NONE),
        latest=None,
        saves=None if sets.actuation is None else saved,
    )


def _latest(sets: _Sets, states: _States, horizon: float, there: np.ndarray) -> np.ndarray:
    """By bisection, all pairs at a time: what is saved after a delay is after all shorter ones."""
    shape = len(states.coms), sets.candidates

    def saved(delays: np.ndarray) -> np.ndarray:
        touchdown = _touchdown(sets, states, delays)
        return there & ~touchdown.lost & _scored(sets, touchdown, without=False)[1][..., 0]

    at_once, last = saved(np.zeros(shape)), saved(np.full(shape, horizon))
    low, high = np.zeros(shape), np.full(shape, horizon)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        still = saved(middle)
        low, high = np.where(still, middle, low), np.where(still, high, middle)
    return np.where(last, horizon, np.where(at_once, low, np.nan))


def _touchdown(sets: _Sets, states: _States, delays: np.ndarray) -> _Touchdown:
    n, d = delays.shape
    alone = n * d == 1  # not side by side with copies of itself
    rows, times = (0, delays[0, 0]) if alone else (np.repeat(np.arange(n), d), delays.reshape(-1))
    coms, velocities, momenta = jax.tree.map(lambda field: field[rows], states)
    found = advance(
        sets.during,
        coms,
        velocities,
        times,
        sets.gravity,
        specific_angular_momentum=momenta,
        momentum_box=sets.momentum_box,
    )
    of_rows = lambda field: np.asarray(field)[None] if alone else np.asarray(field)
    place = lambda field: of_rows(field).reshape(n, d, *of_rows(field).shape[1:])
    progress = place(found.progress)
    lost = np.isin(progress, [Progress.TURNS, Progress.LEAVES]) & (delays > 0)
    spinning = found.specific_angular_momentum
    momenta = None if spinning is None else place(spinning)
    return _Touchdown(place(found.com), place(found.com_velocity), momenta, progress, lost)


def _scored(sets: _Sets, touchdown: _Touchdown, without: bool) -> tuple[np.ndarray, ...]:
    """Margin, verdict, case and status (n, m, 2) of every state with each candidate, and then without; (n, m, 1) if that is
    not wanted.
    """
    (n, d), m = touchdown.progress.shape, sets.candidates
    kinds = 2 if without else 1
    if d == 1 and sets.actuation is None:  # one state without any candidate, for all of them
        which = np.arange(m + kinds - 1)[None]
    else:
        which = np.stack([np.arange(m), np.full(m, m)], axis=1)[:, :kinds].reshape(1, -1)
    each = which.shape[1] // d
    which = np.broadcast_to(which, (n, d * each)).reshape(-1)
    parts = []
    for start in range(0, len(which), PAIRS):
        pairs = np.arange(start, min(start + PAIRS, len(which)))
        parts.append(_scored_pairs(sets, touchdown, which[pairs], pairs // each))
    fields = [np.concatenate(field).reshape(n, -1) for field in zip(*parts, strict=True)]
    if d == 1 and sets.actuation is None:
        pairs_of = lambda field: [field[:, :m], np.broadcast_to(field[:, m:], (n, m))][:kinds]
        return tuple(np.stack(pairs_of(field), axis=-1) for field in fields)
    return tuple(field.reshape(n, m, kinds) for field in fields)


def _scored_pairs(sets: _Sets, touchdown: _Touchdown, which: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, ...]:
    """which: the set of each pair. state: its row in the states at touchdown."""
    vectors = touchdown.coms, touchdown.com_velocities, touchdown.momenta
    coms, velocities, momenta = jax.tree.map(lambda field: field.reshape(-1, 3)[state], vectors)
    cones = jax.tree.map(lambda leaf: leaf[which], sets.cones)
    limits = None if sets.actuation is None else jax.tree.map(lambda leaf: leaf[state % sets.candidates], sets.actuation)
    found = score(
        cones,
        coms,
        velocities,
        sets.gravity,
        specific_angular_momentum=momenta,
        actuation=limits,
        momentum_box=sets.momentum_box,
    )
    return tuple(np.asarray(field) for field in (found.margin, found.capturable, found.case, found.status))


def _sets(
    contacts: ContactSet, candidates: ContactSet, lifted: Any, sides: int, gravity: Any, actuation: Actuation | None
) -> _Sets:
    """Raises TypeError, ValueError."""
    if not isinstance(contacts, ContactSet) or contacts.mask.ndim != 1:
        raise TypeError(f"contacts: {shape_of(contacts)} (expected one ContactSet)")
    contacts, candidates = jax.tree.map(np.asarray, (contacts, candidates))
    during = ContactSet.unchecked(
        contacts.points, contacts.frames, contacts.friction, contacts.mask & ~lifted_rows(contacts, lifted)
    )
    m = len(candidates.mask)
    repeated = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (m + 1, *leaf.shape)), during)
    with_none = jax.tree.map(lambda leaf: np.concatenate([leaf, leaf[-1:]]), candidates)
    with_none.mask[-1] = False
    join = lambda now, new: np.concatenate([now, new], axis=1)
    cones = _rays_of(jax.tree.map(join, repeated, with_none), sides)
    if actuation is not None and (not actuation.batched or len(actuation.limit) != m):
        rows = len(actuation.limit) if actuation.batched else 1
        raise TypeError(f"actuation is of {rows} postures (expected a batch, one for each of {m} candidates)")
    return _Sets(cones, jax.tree.map(lambda leaf: leaf[-1], cones), gravity, actuation)


def _rays_of(contacts: ContactSet, sides: int) -> ConeRays:
    """Their rays, in NumPy, where to gather is several times as fast. In a loop of control the candidates are the same again
    and again, and to make their rays takes as long as to score them: those of few sets are kept, by their contents.
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


def _reachable(reachable: Any, shape: tuple[int, int], many: bool) -> np.ndarray:
    """(n, m) bool. Raises TypeError."""
    if reachable is None:
        return np.ones(shape, bool)
    given = np.asarray(reachable)
    fits = given.shape in ((shape, shape[1:]) if many else (shape[1:],))
    if given.dtype != bool or not fits:
        raise TypeError(f"reachable: {given.dtype} of shape {given.shape} (expected bool of shape {shape[1:]}, or {shape})")
    return np.broadcast_to(given, shape)
