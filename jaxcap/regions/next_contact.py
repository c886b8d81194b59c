"""The next contact: which new foothold or grasp makes a robot capturable that is not, or most surely so.

Until the new contact bears, the robot brakes as hard as its present contacts allow (`advance`); then the question is that of
`score`, with the contact added. This is the one-step capture region, on floor, wall and rail alike.

What it says of a robot. Contacts bear whatever friction allows here, arms do not: in simulated touchdowns of TALOS's hand on
a wall, with its torque limits, three of four that this model calls saved still fell. So without the limits of the joints the
answer ranks candidates and rules them out, and only with `actuation` it says `saves`.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from jaxcap.batch.advance import checked_times
from jaxcap.contacts.actuation import Actuation
from jaxcap.contacts.cone import ConeRays
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY, ArrayLike
from jaxcap.one_state.result import Case
from jaxcap.regions.candidate_sets import in_reach, joined, lift, lifted_rows, one_set, stacked
from jaxcap.regions.kept_rays import rays_of
from jaxcap.regions.touchdown import Model, Scored, States, Touchdown, best_of, model_of, scored, states_of, touchdown

HALVINGS = 14
"""Of the horizon, in the search for the latest delay: a second is cut to 0.06 ms."""


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
    actuation: Actuation | None
    """Of each of m candidates."""
    model: Model

    @property
    def candidates(self) -> int:
        """How many."""
        return len(self.cones.rays) - 1


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
    several, model = stacked(candidates), model_of(gravity, momentum_box)
    sets = _sets(contacts, several, lifted, sides, model, actuation)
    states, many = states_of(com, com_velocity, specific_angular_momentum)
    shape = len(states.coms), sets.candidates
    delays = checked_times("delay", delay, shape if many else shape[1:])
    same = np.ndim(delay) == 0 and actuation is None
    delays = np.broadcast_to(np.asarray(delays), shape)[:, : 1 if same else None]
    there = np.broadcast_to(in_reach(reachable, shape if many else shape[1:]), shape) & np.any(several.mask, axis=1)
    found = _answers(sets, states, delays, there)
    if horizon is not None:
        found = found._replace(latest=_latest(sets, states, float(checked_times("horizon", horizon, ())), there))
    return found if many else jax.tree.map(lambda field: field[0], found)


def _answers(sets: _Sets, states: States, delays: np.ndarray, there: np.ndarray) -> NextContacts:
    shape = len(states.coms), sets.candidates
    then = _touchdown(sets, states, delays)
    wide = lambda field: np.broadcast_to(field.reshape(delays.shape), shape)
    margin, capturable, case, status = _scored(sets, then, delays.shape[1], without=True)
    usable = there & ~wide(then.lost)
    with_it, without = (np.where(usable, field, np.nan) for field in (margin[..., 0], margin[..., 1]))
    saved = usable & capturable[..., 0]
    return NextContacts(
        margin=with_it,
        margin_without=np.where(there, without, np.nan),
        capturable=saved,
        case=np.where(usable, case[..., 0], Case.UNDECIDED).astype(np.int8),
        status=status[..., 0],
        progress=wide(then.progress),
        best=best_of(with_it, saved),
        latest=None,
        saves=None if sets.actuation is None else saved,
    )


def _latest(sets: _Sets, states: States, horizon: float, there: np.ndarray) -> np.ndarray:
    """By bisection, all pairs at a time: what is saved after a delay is after all shorter ones."""
    shape = len(states.coms), sets.candidates

    def saved(delays: np.ndarray) -> np.ndarray:
        then = _touchdown(sets, states, delays)
        in_time = ~then.lost.reshape(shape)
        return there & in_time & _scored(sets, then, shape[1], without=False).capturable[..., 0]

    at_once, last = saved(np.zeros(shape)), saved(np.full(shape, horizon))
    low, high = np.zeros(shape), np.full(shape, horizon)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        still = saved(middle)
        low, high = np.where(still, middle, low), np.where(still, high, middle)
    return np.where(last, horizon, np.where(at_once, low, np.nan))


def _touchdown(sets: _Sets, states: States, delays: np.ndarray) -> Touchdown:
    """Of n states by d delays: d = 1 where all candidates take the same time, else m."""
    each = jax.tree.map(lambda field: np.repeat(field, delays.shape[1], axis=0), states)
    return touchdown(sets.during, None, each, delays.reshape(-1), sets.model)


def _scored(sets: _Sets, then: Touchdown, d: int, without: bool) -> Scored:
    """(n, m, 2) of every state with each candidate, and then without; (n, m, 1) if that is not wanted."""
    n, m = len(then.lost) // d, sets.candidates
    kinds = 2 if without else 1
    once = d == 1 and sets.actuation is None  # one state without any candidate, for all of them
    if once:
        which = np.arange(m + kinds - 1)[None]
    else:
        which = np.stack([np.arange(m), np.full(m, m)], axis=1)[:, :kinds].reshape(1, -1)
    each = which.shape[1] // d
    which = np.broadcast_to(which, (n, d * each)).reshape(-1)
    rows = np.arange(len(which)) // each
    postures = None if sets.actuation is None else rows % m
    found = scored(sets.cones, which, then.states, rows, sets.model, sets.actuation, postures)
    if not once:
        return jax.tree.map(lambda field: field.reshape(n, m, kinds), found)
    fields = jax.tree.map(lambda field: field.reshape(n, m + kinds - 1), found)
    pairs_of = lambda field: [field[:, :m], np.broadcast_to(field[:, m:], (n, m))][:kinds]
    return jax.tree.map(lambda field: np.stack(pairs_of(field), axis=-1), fields)


def _sets(
    contacts: ContactSet, candidates: ContactSet, lifted: Any, sides: int, model: Model, actuation: Actuation | None
) -> _Sets:
    """Raises TypeError, ValueError."""
    during, candidates = one_set(contacts), jax.tree.map(np.asarray, candidates)
    during = lift(during, lifted_rows(np.asarray(during.mask), lifted))
    m = len(candidates.mask)
    with_none = jax.tree.map(lambda leaf: np.concatenate([leaf, leaf[-1:]]), candidates)
    with_none.mask[-1] = False
    cones = rays_of(joined(jax.tree.map(lambda leaf: leaf[None], during), with_none), sides)
    if actuation is not None and (not actuation.batched or len(actuation.limit) != m):
        rows = len(actuation.limit) if actuation.batched else 1
        raise TypeError(f"actuation is of {rows} postures (expected a batch, one for each of {m} candidates)")
    return _Sets(cones, jax.tree.map(lambda leaf: leaf[-1], cones), actuation, model)
