"""Several next contacts, one after the other along one line: a small tree of all sequences of candidates.

Step by step as with one next contact: until a contact bears the robot brakes as hard as those before it allow (`advance`);
then it is asked whether it can stop on what bears now (`score`), and it goes on from there to the next.

What a straight path cannot do. The CoM stays on the line of its first velocity through all steps, and brakes as hard as it
can at all times. A robot steers: it bends its path towards a foothold beside the line, sways sideways from one foot to the
other, turns; and it brakes less, or speeds up, where a better place lies a little farther on, while the model may brake so
hard that it turns back before the next foot is down. So a sequence that stops the model is one way to stop it, and none that
does is no proof that there is none: sufficient in the model, not necessary. Walking, which sways, is on no line at all; this
is for two or three contacts in a hurry.
"""

from collections.abc import Sequence
from math import prod
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from jaxcap.batch.advance import checked_times
from jaxcap.contacts.cone import ConeRays
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY, ArrayLike
from jaxcap.one_state.advance import Progress
from jaxcap.one_state.result import Case
from jaxcap.regions.candidate_sets import in_reach, joined, lift, lifted_rows, one_set, stacked
from jaxcap.regions.kept_rays import rays_of
from jaxcap.regions.touchdown import NONE, Model, States, best_of, model_of, scored, states_of, touchdown

MOST_PATHS = 1 << 14
"""Of one tree: each has a contact set, whose rays take 60 MB in double precision for two feet and three hands."""


class ContactStep(NamedTuple):
    """One contact of a sequence: where it may be made, and when."""

    candidates: ContactSet | Sequence[ContactSet]
    """What may be added: m contact sets, as for `next_contacts`."""
    delay: ArrayLike
    """From the touchdown before it (the first: from now) until it bears [s]: one number, (m,), one for each candidate, or
    what broadcasts to all paths, (*n, m1, ..., m): one that depends on the candidates before it too."""
    lifted: ArrayLike | None = None
    """Rows that bear nothing from the touchdown before it on: a foot that swings. Counted through `contacts`, then the
    candidates of each step before, each with as many rows as its largest has."""
    reachable: ArrayLike | None = None
    """Bool, which candidates can be reached: (m,), or what broadcasts to all paths, as `delay`. All if not given."""


class ContactSequences(NamedTuple):
    """What each path would do; arrays (m1, ..., mk) for k steps with m1, ... candidates, or (n, m1, ..., mk) for n states.

    At the last touchdown, with all contacts of the path but those that are lifted; `margins` and `needed` look at the
    earlier ones too. A ranking of paths: contacts bear whatever friction allows, arms do not (see `NextContacts`).
    """

    margin: Float[np.ndarray, "..."]
    """As `NextContacts.margin` [m/s]: NaN where no speed is left, where the robot has lost its contacts or turned back on
    the way, and where a contact of the path is out of reach."""
    capturable: Bool[np.ndarray, "..."]
    """Whether the model can stop after the last step; False for paths that are lost before."""
    case: Int8[np.ndarray, "..."]
    """A `Case`."""
    status: Int8[np.ndarray, "..."]
    """A `Status`; of the last state there was, where a path is lost before."""
    progress: Int8[np.ndarray, "..."]
    """A `Progress`: how the robot comes to the last touchdown, or how the path was lost."""
    needed: Int[np.ndarray, "..."]
    """After how many steps of the path the model can stop, the fewest: 0 if it can on its present contacts; -1 if never.
    With steps that lift a foot it may be that more are worse."""
    best: Int[np.ndarray, "*n k"]
    """The candidate of each step on the path with the largest margin at its end; -1 where no path has one."""
    margins: tuple[Float[np.ndarray, "..."], ...]
    """Margin now, (*n,), after one step, (*n, m1), ..., after the last, which is `margin`."""


class _Step(NamedTuple):
    """One of them, checked: p paths lead to it, m candidates go on from each."""

    candidates: ContactSet
    lifted: Bool[np.ndarray, " k"]
    delays: Float[np.ndarray, "n p d"]
    """d = 1 where all candidates take the same time, else m."""
    there: Bool[np.ndarray, "n p m"]
    """There is a contact, and it is in reach."""


class _Level(NamedTuple):
    """All p paths of so many steps, at their last touchdown."""

    contacts: ContactSet
    """That bear from now on: p sets."""
    cones: ConeRays
    """Their rays."""
    states: States
    """n p of them."""
    there: Bool[np.ndarray, "n p"]
    """All contacts of the path are in reach."""
    lost: Bool[np.ndarray, "n p"]
    margin: Float[np.ndarray, "n p"]
    capturable: Bool[np.ndarray, "n p"]
    case: Int8[np.ndarray, "n p"]
    status: Int8[np.ndarray, "n p"]
    progress: Int8[np.ndarray, "n p"]


class _Form(NamedTuple):
    """What holds for the whole tree."""

    rows: int
    """Of all contact sets, which are padded to it: levels share their programs."""
    sides: int
    model: Model


def contact_sequences(
    contacts: ContactSet,
    com: ArrayLike,
    com_velocity: ArrayLike,
    steps: Sequence[ContactStep],
    *,
    specific_angular_momentum: ArrayLike | None = None,
    momentum_box: float = 0.0,
    sides: int = 4,
    gravity: ArrayLike = GRAVITY,
) -> ContactSequences:
    """Which hands and feet, one after the other, so that the robot can stop: `next_contacts` for every path of a small tree.

    A path takes one candidate of each step. It is lost where contacts are lost, or the robot turns back, before the next one
    bears. With one step this is `next_contacts`. The CoM stays on one straight line and brakes as hard as it can: what stops
    the model is enough, but a robot that steers, turns or chooses when to brake may stop where no path does. On the host.

    Args:
        contacts: one set, where the robot stands now.
        com: (3,), or (n, 3) for many states [m], in the contacts' frame, z up.
        com_velocity: (3,), or (n, 3) [m/s].
        steps: a `ContactStep` for each contact that is made, in this order; 16,384 paths at most.
        specific_angular_momentum: (3,), or (n, 3) about the CoM, over the mass [m^2/s]; None for zero. It keeps its
            proportion to the CoM's speed all the way (see `advance`).
        momentum_box: as for `next_contacts`, at all times [m^2/s^2]: one number.
        sides: edges of each friction pyramid, >= 3.
        gravity: (3,) [m/s^2].

    Returns:
        The margin after each step, how many steps are needed, and the best path. Limits of joints are left out, for they
        would need a posture for every path: ask `next_contacts` with `actuation` for the last step of the best one.

    Raises:
        TypeError: for wrong shapes, or steps that are none.
        ValueError: for no steps, too many paths, no candidates, a delay or box that is negative or not finite, a lifted
            contact that is not there; naming the step.
            A candidate or state with numbers that are not finite gets a status, and leaves the others alone.

    Source: on flat ground the N-step regions of Koolen et al., Capturability-based Analysis, IJRR 2012, of motions along one
        line: d_N = (d_{N-1} + l) exp(-omega T).
    """
    start, model = one_set(contacts), model_of(gravity, momentum_box)
    candidates = _candidates_of(steps)
    sizes = [len(one.mask) for one in candidates]
    form = _Form(len(start) + sum(len(one) for one in candidates), sides, model)
    states, many = states_of(com, com_velocity, specific_angular_momentum)
    lead = (len(states.coms),) if many else ()
    checked, there = [], np.asarray(start.mask)
    for k, step in enumerate(steps):
        one = _checked(f"steps[{k}]", step, candidates[k], there, lead, sizes[: k + 1])
        checked.append(one)
        there = np.concatenate([there & ~one.lifted, np.any(candidates[k].mask, axis=0)])
    levels = [_now(form, start, states)]
    for one in checked:
        levels.append(_after(form, levels[-1], one))
    return _answers(levels, lead, sizes)


def _candidates_of(steps: Any) -> list[ContactSet]:
    """Of each step, in NumPy. Raises TypeError, ValueError."""
    if isinstance(steps, ContactStep) or not isinstance(steps, Sequence):
        raise TypeError(f"steps: {type(steps).__name__} (expected a list of ContactStep)")
    if not steps:
        raise ValueError("steps: none (expected at least one ContactStep)")
    for k, step in enumerate(steps):
        if not isinstance(step, ContactStep):
            raise TypeError(f"steps[{k}]: {type(step).__name__} (expected a ContactStep)")
    found = [jax.tree.map(np.asarray, stacked(step.candidates, f"steps[{k}].candidates")) for k, step in enumerate(steps)]
    sizes = [len(one.mask) for one in found]
    if prod(sizes) > MOST_PATHS:
        product = " * ".join(map(str, sizes))
        raise ValueError(
            f"steps: {product} = {prod(sizes):,} paths (expected at most {MOST_PATHS:,}: fewer candidates, or fewer steps)"
        )
    return found


def _checked(
    name: str, step: ContactStep, candidates: ContactSet, there: np.ndarray, lead: tuple[int, ...], sizes: list[int]
) -> _Step:
    """there: rows that bear before it. lead: (n,), or () for one state. sizes: candidates of each step, this one's last.

    Raises TypeError, ValueError.
    """
    shape, m = (*lead, *sizes), sizes[-1]
    flat = (*(lead or (1,)), prod(sizes[:-1]), m)
    delays = np.asarray(checked_times(f"{name}.delay", step.delay, shape)).reshape(flat)
    same = np.ndim(step.delay) == 0 or np.shape(step.delay)[-1] == 1
    reach = in_reach(step.reachable, shape, f"{name}.reachable").reshape(flat)
    return _Step(
        candidates,
        lifted_rows(there, step.lifted, f"{name}.lifted"),
        delays[..., :1] if same else delays,
        reach & np.any(candidates.mask, axis=1),
    )


def _now(form: _Form, contacts: ContactSet, states: States) -> _Level:
    """Before the first step: one path, of no contact."""
    n = len(states.coms)
    sets = jax.tree.map(lambda leaf: leaf[None], contacts)
    cones = rays_of(_padded(sets, form.rows), form.sides)
    found = scored(cones, np.zeros(n, int), states, np.arange(n), form.model)
    yes = np.ones((n, 1), bool)
    fields = {name: field[:, None] for name, field in found._asdict().items()}
    progress = np.full((n, 1), Progress.ON_THE_WAY, np.int8)
    return _Level(sets, cones, states, there=yes, lost=~yes, progress=progress, **fields)


def _after(form: _Form, level: _Level, step: _Step) -> _Level:
    """All paths that go on from those of a level."""
    n, p, d = step.delays.shape
    m = step.there.shape[2]
    bearing = lift(level.contacts, step.lifted)
    during = rays_of(_padded(bearing, form.rows), form.sides) if step.lifted.any() else level.cones
    each = jax.tree.map(lambda field: np.repeat(field, d, axis=0), level.states)
    if p == 1:  # one contact set for all states
        then = touchdown(jax.tree.map(lambda leaf: leaf[0], during), None, each, step.delays.reshape(-1), form.model)
    else:
        path = np.tile(np.repeat(np.arange(p), d), n)
        then = touchdown(during, path, each, step.delays.reshape(-1), form.model)
    # The state of each path: one for all candidates, where they take the same time.
    row = np.broadcast_to(np.arange(n * p * d).reshape(n, p, d), (n, p, m)).reshape(-1)
    sets = joined(bearing, step.candidates)
    cones = rays_of(_padded(sets, form.rows), form.sides)
    found = scored(cones, np.tile(np.arange(p * m), n), then.states, row, form.model)
    found = jax.tree.map(lambda field: field.reshape(n, p * m), found)
    of_path = lambda field: field[row].reshape(n, p * m)
    before = lambda field: np.repeat(field, m, axis=1)
    there = before(level.there) & step.there.reshape(n, p * m)
    gone = before(level.lost)
    lost = gone | of_path(then.lost)
    usable = there & ~lost
    return _Level(
        contacts=sets,
        cones=cones,
        states=jax.tree.map(lambda field: field[row], then.states),
        there=there,
        lost=lost,
        margin=np.where(usable, found.margin, np.nan),
        capturable=usable & found.capturable,
        case=np.where(usable, found.case, Case.UNDECIDED).astype(np.int8),
        status=np.where(gone, before(level.status), found.status),
        progress=np.where(gone, before(level.progress), of_path(then.progress)),
    )


def _padded(contacts: ContactSet, rows: int) -> ContactSet:
    """Sets with masked rows up to this number; nothing is checked, for candidates may be bad."""
    count, have = contacts.mask.shape
    extra = lambda leaf, value: np.broadcast_to(np.asarray(value, leaf.dtype), (count, rows - have, *leaf.shape[2:]))
    values = ContactSet.unchecked(0.0, np.eye(3), 1.0, False)
    return jax.tree.map(lambda leaf, value: np.concatenate([leaf, extra(leaf, value)], axis=1), contacts, values)


def _answers(levels: list[_Level], lead: tuple[int, ...], sizes: list[int]) -> ContactSequences:
    """lead: (n,), or () for one state. sizes: candidates of each step."""
    last = levels[-1]
    needed: np.ndarray = np.full(levels[0].capturable.shape, NONE)
    for k, level in enumerate(levels):
        needed = np.repeat(needed, level.capturable.shape[1] // needed.shape[1], axis=1)
        needed = np.where((needed == NONE) & level.capturable, k, needed)
    path = best_of(last.margin, last.capturable)
    best = np.stack(np.unravel_index(np.maximum(path, 0), sizes), axis=-1)
    best = np.where(path[:, None] == NONE, NONE, best)
    shaped = lambda field, steps: field.reshape((*lead, *sizes[:steps]))
    names = ("margin", "capturable", "case", "status", "progress")
    return ContactSequences(
        **{name: shaped(getattr(last, name), len(sizes)) for name in names},
        needed=shaped(needed, len(sizes)),
        best=best if lead else best[0],
        margins=tuple(shaped(level.margin, k) for k, level in enumerate(levels)),
    )
