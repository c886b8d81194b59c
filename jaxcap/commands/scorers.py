"""Scorers: what answers the batches of a dataset, whatever says which contacts a row has, with little compiled anew.

`OneSet` has the same contacts for all rows, `SharedSets` a few sets of which each row chooses one, `OwnContacts` has each
row's own. They differ in how they cut a batch into parts; `Scorer` is what they have in common.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

import jaxcap
from jaxcap.batch.blocks import BLOCK
from jaxcap.contacts.actuation import Actuation
from jaxcap.contacts.cone import CentroidalCone, ConeRays, centred, cone_rays
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY, ArrayLike
from jaxcap.contacts.projection import ProjectionError
from jaxcap.contacts.scoring_input import rounded
from jaxcap.errors import InputError
from jaxcap.files.bad_rows import BadRows
from jaxcap.files.contact_columns import CHOICE, MULTIPLE, RowChoices, RowContacts
from jaxcap.files.contact_files import ContactSets
from jaxcap.files.plausibility import Stand
from jaxcap.numerics.whole import round_up
from jaxcap.one_state.result import Capturability
from jaxcap.regions.capture_point import Baselines

MANY = 2048
"""Rows of one set in a batch from which on its faces are worth it: a projection takes 12 to 30 ms, once a set; the rays
take 10 to 20 microseconds a state, the faces 1 to 4."""

FACES = 64
"""Faces are padded to this number, or twice, four times, ... as many: compiling takes seconds."""


class Part(NamedTuple):
    """Rows of a batch that are scored in one call."""

    rows: Int[np.ndarray, " k"]
    cone: CentroidalCone | ConeRays
    """Of all of them, or rays of each."""
    contacts: ContactSet
    """The same."""


class Scored(NamedTuple):
    """What is known of a batch."""

    answers: Capturability
    """On the host, (n,)."""
    bad: BadRows
    """Rows whose contacts cannot be used; they have `Status.NONFINITE`."""


class Scorer(ABC):
    """Scores the batches of one dataset.

    It pads each batch to the sizes of those before, where they are larger, for compiling takes seconds. Rows without a
    contact are `Case.EMPTY`.

    Args:
        sides: Edges of the pyramid that replaces each friction cone.
        gravity: (3,) [m/s^2].
        neighbours: Rows that follow each other are similar states; it counts for rays alone.
        size: Rows of a full batch, if that is known.
        momentum_box: By how much the rate of angular momentum may differ, over the mass [m^2/s^2].
    """

    def __init__(self, sides: int, gravity: ArrayLike, neighbours: bool, size: int = 1, momentum_box: float = 0.0):
        self._sides, self._gravity, self._neighbours, self._size = sides, gravity, neighbours, size
        self._box = momentum_box

    @abstractmethod
    def _parts(self, contacts: Any, n: int) -> tuple[list[Part], BadRows]:
        """The n rows of a batch by what they are scored with, and those whose contacts cannot be used.

        contacts: from `StateBatch.contacts`.
        """

    @abstractmethod
    def stand(self, contacts: Any, n: int, rows: slice) -> Stand:
        """The contacts of these rows of a batch of n, wherever they can be used."""

    def score(
        self,
        contacts: Any,
        coms: Float[np.ndarray, "n 3"],
        com_velocities: Float[np.ndarray, "n 3"],
        momenta: Float[np.ndarray, "n 3"] | None = None,
        actuation: Actuation | None = None,
    ) -> Scored:
        """Scores a batch.

        Args:
            contacts: What `StateBatch.contacts` says of the rows.
            coms: (n, 3) [m]. Their dtype decides the precision.
            com_velocities: (n, 3) [m/s].
            momenta: (n, 3) about the CoM, over the mass [m^2/s]; None for zero.
            actuation: What joints can bear in each row, for `OwnContacts`; None: anything.

        Returns:
            The answers, and the rows whose contacts cannot be used.
        """
        parts, bad, coms = self._cut(contacts, coms)
        of_rows = lambda rows, tree: jax.tree.map(lambda field: field[rows], tree)
        given = coms, com_velocities, momenta, actuation
        outs = [self._score(part, *of_rows(part.rows, given)) for part in parts]
        return Scored(_in_order(parts, outs), bad)

    def baselines(
        self,
        contacts: Any,
        coms: Float[np.ndarray, "n 3"],
        com_velocities: Float[np.ndarray, "n 3"],
        height: float | None = None,
    ) -> Baselines:
        """`jaxcap.baselines` of a batch.

        Args:
            contacts: As for `score`, and so are coms and com_velocities.
            coms: (n, 3) [m].
            com_velocities: (n, 3) [m/s].
            height: Of the CoM in (14) [m]; by default that above each row's contacts.

        Returns:
            Distances (n,) [m] on the host; NaN for rows whose contacts cannot be used.
        """
        parts, _, coms = self._cut(contacts, coms)
        outs = [self._baselines(part, coms[part.rows], com_velocities[part.rows], height) for part in parts]
        return _in_order(parts, outs)

    def _cut(self, contacts: Any, coms: Float[np.ndarray, "n 3"]) -> tuple[list[Part], BadRows, Float[np.ndarray, "n 3"]]:
        """The parts of a batch, its bad rows, and the CoMs, NaN in bad rows."""
        self._size = max(self._size, min(BLOCK, len(coms)))
        parts, bad = self._parts(contacts, len(coms))
        return parts, bad, np.where(bad.rows[:, None], coms.dtype.type(np.nan), coms)

    def _score(
        self,
        part: Part,
        coms: Float[np.ndarray, "k 3"],
        com_velocities: Float[np.ndarray, "k 3"],
        momenta: Float[np.ndarray, "k 3"] | None,
        actuation: Actuation | None,
    ) -> Capturability:
        own = isinstance(part.cone, ConeRays)
        cone = self._filled(part.cone) if own else part.cone
        states, velocities, spinning = (self._filled(vectors) for vectors in (coms, com_velocities, momenta))
        options: dict[str, Any] = {"neighbours": own and self._neighbours, "specific_angular_momentum": spinning}
        if own and self._box:  # faces have it already
            options |= {"momentum_box": self._box}
        if actuation is not None:
            wide = actuation.padded(part.contacts.mask.shape[-1], actuation.joints)
            options |= {"actuation": self._filled(wide)}
        if {"momentum_box", "actuation"} & set(options):  # whose programs have no use for neighbours
            options["neighbours"] = False
        return _first(len(coms), jaxcap.score(cone, states, velocities, gravity=self._gravity, **options))

    def _baselines(
        self, part: Part, coms: Float[np.ndarray, "k 3"], com_velocities: Float[np.ndarray, "k 3"], height: float | None
    ) -> Baselines:
        cone, contacts = part.cone, part.contacts
        if isinstance(cone, ConeRays):
            cone, contacts = self._filled(cone), self._filled(contacts)
        out = jaxcap.baselines(cone, contacts, self._filled(coms), self._filled(com_velocities), height, self._gravity)
        return _first(len(coms), out)

    def _filled(self, tree: Any) -> Any:
        """With zeros up to a multiple of the batches' size, to repeat few shapes."""
        fill = lambda x: np.pad(x, ((0, -len(x) % self._size), *[(0, 0)] * (x.ndim - 1))) if len(x) % self._size else x
        return jax.tree.map(fill, tree)


class OneSet(Scorer):
    """Scores batches of rows with the same contacts, by faces.

    Args:
        contacts: Of all rows.
        size: Rows of a full batch: the last batch needs no compiling.
        sides: As for `Scorer`, and so is gravity.
        gravity: (3,) [m/s^2].
        momentum_box: As for `Scorer`.

    Raises:
        ValueError: If the faces cannot be computed.
    """

    def __init__(
        self, contacts: ContactSet, size: int, sides: int = 4, gravity: ArrayLike = GRAVITY, momentum_box: float = 0.0
    ):
        super().__init__(sides, gravity, neighbours=False, size=max(size, 1), momentum_box=momentum_box)
        self._cone, self._contacts = jaxcap.centroidal_cone(contacts, sides, momentum_box), contacts

    def _parts(self, contacts: None, n: int) -> tuple[list[Part], BadRows]:
        return [Part(np.arange(n), self._cone, self._contacts)], BadRows(n)

    def stand(self, contacts: None, n: int, rows: slice) -> Stand:
        """The same for all."""
        return _stand(jax.tree.map(lambda x: np.repeat(x[None], len(range(n)[rows]), axis=0), self._contacts))


class OwnContacts(Scorer):
    """Scores batches of rows with contacts of their own, by rays; see `Scorer` for the arguments."""

    def __init__(self, sides: int = 4, gravity: ArrayLike = GRAVITY, neighbours: bool = False, momentum_box: float = 0.0):
        super().__init__(sides, gravity, neighbours, momentum_box=momentum_box)
        self._width = 1
        """Contacts of a row, the most so far."""

    def _parts(self, contacts: RowContacts, n: int) -> tuple[list[Part], BadRows]:
        self._width = max(self._width, contacts.mask.shape[1])
        *fields, bad = contacts.padded(self._width)
        sets = ContactSet.unchecked(*fields)
        return [Part(np.arange(n), _rays(sets, self._sides), sets)], bad

    def stand(self, contacts: RowContacts, n: int, rows: slice) -> Stand:
        """What the columns say."""
        return Stand(contacts.points[rows], contacts.frames[rows, ..., 2], contacts.mask[rows])


class SharedSets(Scorer):
    """Scores batches of rows that choose among a few contact sets: by faces where many rows choose one, else by rays.

    The faces are kept from batch to batch.

    Args:
        sets: Contacts by number; a set may be empty.
        names: Of each set, None for a set without; by default none has one.
        sides: As for `Scorer`, and so are gravity and neighbours.
        gravity: (3,) [m/s^2].
        neighbours: Rows that follow each other are similar states.
        momentum_box: As for `Scorer`.
    """

    def __init__(
        self,
        sets: Sequence[ContactSet],
        names: Sequence[str | None] | None = None,
        sides: int = 4,
        gravity: ArrayLike = GRAVITY,
        neighbours: bool = False,
        momentum_box: float = 0.0,
    ):
        super().__init__(sides, gravity, neighbours, momentum_box=momentum_box)
        self._sets = sets
        self._numbers = {name: i for i, name in enumerate(names or ()) if name is not None}
        size = round_up(max(1, *map(len, sets)), MULTIPLE)
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *(contacts.padded(size) for contacts in sets))
        self._stacked, self._rays = stacked, jax.tree.map(np.asarray, _rays(stacked, sides))
        self._cones: dict[int, CentroidalCone | None] = {}

    def choose(self, choices: RowChoices) -> tuple[Int[np.ndarray, " n"], BadRows]:
        """The number of each row's set, and the rows that choose none that there is (these have any number)."""
        bad = BadRows(len(choices.numbers))
        bad.add(choices.missing, lambda row: f"{CHOICE} is null (expected a number or a name)")
        if choices.names is None:
            found = choices.numbers
            known, expected = (found >= 0) & (found < len(self._sets)), f"0 to {len(self._sets) - 1}"
        else:
            places = np.array([self._numbers.get(name, -1) for name in choices.names] or [-1])
            found = places[choices.numbers]
            known, expected = found >= 0, _listed(self._numbers)
        bad.add(~known, lambda row: f"{CHOICE} = {choices.shown(row)} (expected {expected})")
        return np.where(bad.rows, 0, found).astype(np.int64), bad

    def stand(self, choices: RowChoices, n: int, rows: slice) -> Stand:
        """The sets that the rows choose."""
        numbers, bad = self.choose(choices)
        chosen = jax.tree.map(lambda x: x[numbers[rows]], self._stacked)
        return _stand(chosen)._replace(mask=chosen.mask & ~bad.rows[rows, None])

    def _parts(self, choices: RowChoices, n: int) -> tuple[list[Part], BadRows]:
        """The rows of each set that many choose, and the rest."""
        numbers, bad = self.choose(choices)
        chosen = np.bincount(numbers[~bad.rows], minlength=len(self._sets))
        numbers[bad.rows] = np.argmax(chosen)  # they go along with others, and call for no program of their own
        cones = {i: cone for i in np.flatnonzero(chosen >= MANY).tolist() if (cone := self._cone(i)) is not None}
        parts = [Part(np.flatnonzero(numbers == i), cone, self._sets[i]) for i, cone in cones.items()]
        rest = np.flatnonzero(~np.isin(numbers, list(cones)))
        if len(rest) or not parts:
            parts.append(Part(rest, *jax.tree.map(lambda x: x[numbers[rest]], (self._rays, self._stacked))))
        return parts, bad

    def _cone(self, number: int) -> CentroidalCone | None:
        """The faces of a set, or None where the projection fails: its rays serve as well."""
        if number not in self._cones:
            contacts = self._sets[number]
            try:
                touches = np.any(contacts.mask)
                cone = jaxcap.centroidal_cone(contacts, self._sides, self._box) if touches else _no_wrench()
                rows = FACES << max(0, (len(cone.faces) - 1) // FACES).bit_length()
                self._cones[number] = cone.padded(rows)
            except ProjectionError:
                self._cones[number] = None
        return self._cones[number]


def scorer_of(
    contacts: ContactSet | ContactSets | tuple[str, ...],
    path: Path | None,
    size: int,
    sides: int,
    neighbours: bool,
    momentum_box: float = 0.0,
) -> Scorer:
    """What scores batches, whatever the contacts are.

    Args:
        contacts: The set of all states, the sets that a column chooses from, or the names of the columns that hold them.
        path: Of the contacts file, for messages.
        size: Rows of a full batch.
        sides: As for `Scorer`, and so are neighbours and momentum_box.
        neighbours: Rows that follow each other are similar states.
        momentum_box: [m^2/s^2].

    Raises:
        InputError: If the faces of the one set cannot be computed.
    """
    if isinstance(contacts, ContactSet):
        try:
            return OneSet(contacts, size, sides, momentum_box=momentum_box)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from error
    if isinstance(contacts, ContactSets):
        return SharedSets(contacts.sets, contacts.names, sides, neighbours=neighbours, momentum_box=momentum_box)
    return OwnContacts(sides, neighbours=neighbours, momentum_box=momentum_box)


def _stand(contacts: ContactSet) -> Stand:
    """A batch of contact sets, as plausibility looks at them."""
    points, frames, mask = (np.asarray(field) for field in (contacts.points, contacts.frames, contacts.mask))
    return Stand(points, frames[..., 2], mask)


def _in_order(parts: list[Part], outs: list) -> Any:
    """The answers for all parts, row by row."""
    if len(parts) == 1:
        return outs[0]
    order = np.argsort(np.concatenate([part.rows for part in parts]))
    return jax.tree.map(lambda *fields: np.concatenate(fields)[order], *outs)


def _first(n: int, out: Any) -> Any:
    """The first n rows, on the host."""
    return jax.tree.map(lambda field: np.asarray(field)[:n], out)


def _rays(contacts: ContactSet, sides: int) -> ConeRays:
    """`cone_rays`, compiled; the contacts are centred on the host, in double precision."""
    local, origin = centred(contacts)
    return _compiled_rays(jax.tree.map(rounded, local), sides)._replace(origin=origin)


@partial(jax.jit, static_argnames="sides")
def _compiled_rays(contacts: ContactSet, sides: int) -> ConeRays:
    return cone_rays(contacts, sides)


def _no_wrench() -> CentroidalCone:
    """The cone of no contact: every wrench <= 0 and >= 0."""
    return CentroidalCone(np.concatenate([np.eye(6), -np.eye(6)]), np.zeros(3), np.asarray(1.0))


def _listed(names: Iterable[str]) -> str:
    """Names for a message, not too many."""
    names = list(names)
    return ", ".join(map(repr, names[:10])) + (", ..." if len(names) > 10 else "") if names else "a name, but no set has one"
