"""From contacts that differ from row to row to scores: batch after batch of a dataset, with little compiled anew."""

from collections.abc import Iterable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

import jaxcap
from jaxcap.batch.blocks import BLOCK
from jaxcap.batch.score import score
from jaxcap.contacts.cone import CentroidalCone, ConeRays, centroidal_cone, cone_rays
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY
from jaxcap.contacts.projection import ProjectionError
from jaxcap.errors import InputError
from jaxcap.files.contact_columns import CHOICE, MULTIPLE, BadRows, RowChoices, RowContacts
from jaxcap.files.contact_files import ContactSets
from jaxcap.one_state.result import Capturability
from jaxcap.regions.capture_point import Baselines, baselines
from jaxcap.regions.capture_point import baselines as baselines_of

MANY = 2048
"""Rows of one set in a batch from which on its faces are worth it: a projection takes 12 to 30 ms, once a set; the rays
take 10 to 20 microseconds a state, the faces 1 to 4."""

FACES = 64
"""Faces are padded to this number, or twice, four times, ... as many: compiling takes seconds."""


class OwnContacts:
    """Scores batches of rows with contacts of their own, by rays.

    sides, gravity, neighbours: as for `cone_rays` and `score`. Batches of one dataset are best given to one object: it
    pads each to the sizes of those before, where they are larger, for compiling takes seconds.
    """

    def __init__(self, sides: int = 4, gravity=GRAVITY, neighbours: bool = False):
        self._sides, self._gravity, self._neighbours = sides, gravity, neighbours
        self._rows = self._contacts = 1

    def score(
        self, contacts: RowContacts, coms: Float[np.ndarray, "n 3"], com_velocities: Float[np.ndarray, "n 3"]
    ) -> tuple[Capturability, BadRows]:
        """Scores on the host (n,), and the rows whose contacts cannot be used: these have `Status.NONFINITE`.

        contacts: from `StateBatch.contacts`, or `contact_columns.from_arrays`. coms: (n, 3) [m]. com_velocities: (n, 3)
        [m/s]. The dtype of the last two decides the precision. Rows without a contact are `Case.EMPTY`.
        """
        sets, bad = self._sets(contacts, coms)
        coms = np.where(bad.rows[:, None], np.nan, coms)
        rays = _rays(sets, self._sides)
        return _score(rays, coms, com_velocities, self._rows, self._gravity, self._neighbours), bad

    def baselines(
        self, contacts: RowContacts, coms: Float[np.ndarray, "n 3"], com_velocities: Float[np.ndarray, "n 3"],
        height: float | None = None,
    ) -> Baselines:
        """`capture_point.baselines` on the host (n,); NaN for rows whose contacts cannot be used. Arguments as for `score`.

        height: of the CoM in (14) [m]; by default above each row's contacts.
        """
        sets, bad = self._sets(contacts, coms)
        coms = np.where(bad.rows[:, None], np.nan, coms)
        return _baselines(_rays(sets, self._sides), sets, coms, com_velocities, self._rows, height, self._gravity)

    def _sets(self, contacts: RowContacts, coms) -> tuple[ContactSet, BadRows]:
        """Contact sets of the dtype of the CoMs and of the largest size so far."""
        self._contacts = max(self._contacts, contacts.mask.shape[1])
        self._rows = max(self._rows, min(BLOCK, len(coms)))
        *fields, bad = contacts.padded(self._contacts)
        fields = [x if x.dtype == bool else x.astype(coms.dtype, copy=False) for x in fields]
        return ContactSet.tree_unflatten(None, fields), bad  # unflatten: the values were checked already


class SharedSets:
    """Scores batches of rows that choose among a few contact sets: by faces where many rows choose one, else by rays.

    sets: contacts by number; a set may be empty. names: of each set, None for a set without; by default none has one.
    sides, gravity, neighbours: as for `cone_rays` and `score`. The faces are kept from batch to batch.
    """

    def __init__(
        self, sets: Sequence[ContactSet], names: Sequence[str | None] | None = None, sides: int = 4, gravity=GRAVITY,
        neighbours: bool = False,
    ):
        self._sides, self._gravity, self._neighbours = sides, gravity, neighbours
        self._sets = sets
        self._numbers = {name: i for i, name in enumerate(names or ()) if name is not None}
        size = -(-max(1, *map(len, sets)) // MULTIPLE) * MULTIPLE
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *(contacts.padded(size) for contacts in sets))
        self._stacked, self._rays = stacked, jax.tree.map(np.asarray, _rays(stacked, sides))
        self._cones: dict[int, CentroidalCone | None] = {}
        self._rows = 1

    def choose(self, choices: RowChoices) -> tuple[Int[np.ndarray, " n"], BadRows]:
        """The number of each row's set, and the rows that choose none that there is (these have any number)."""
        bad = BadRows(len(choices.numbers))
        bad.add(choices.missing, lambda row: f"{CHOICE} is null (expected a number or a name)")
        if choices.names is None:
            found = choices.numbers
            known, expected = (found >= 0) & (found < len(self._sets)), f"0 to {len(self._sets) - 1}"
            shown = str
        else:
            places = np.array([self._numbers.get(name, -1) for name in choices.names] or [-1])
            found = places[choices.numbers]
            known, expected = found >= 0, _listed(self._numbers)
            shown = lambda number: repr(choices.names[number])
        bad.add(~known, lambda row: f"{CHOICE} = {shown(choices.numbers[row])} (expected {expected})")
        return np.where(bad.rows, 0, found).astype(np.int64), bad

    def score(
        self, choices: RowChoices, coms: Float[np.ndarray, "n 3"], com_velocities: Float[np.ndarray, "n 3"]
    ) -> tuple[Capturability, BadRows]:
        """Scores on the host (n,), and the rows whose choice cannot be used: these have `Status.NONFINITE`.

        choices: from `StateBatch.contacts`, or `contact_columns.chosen`. coms: (n, 3) [m]. com_velocities: (n, 3) [m/s].
        The dtype of the last two decides the precision. Rows that choose an empty set are `Case.EMPTY`.
        """
        parts, bad = self._parts(choices, coms)
        coms = np.where(bad.rows[:, None], np.nan, coms)
        outs = [
            _score(cone, coms[rows], com_velocities[rows], self._rows, self._gravity, self._neighbours)
            for rows, cone, _ in parts
        ]
        return _in_order(parts, outs), bad

    def baselines(
        self, choices: RowChoices, coms: Float[np.ndarray, "n 3"], com_velocities: Float[np.ndarray, "n 3"],
        height: float | None = None,
    ) -> Baselines:
        """`capture_point.baselines` on the host (n,); NaN for rows whose choice cannot be used. Arguments as for `score`.

        height: of the CoM in (14) [m]; by default above each set's contacts.
        """
        parts, bad = self._parts(choices, coms)
        coms = np.where(bad.rows[:, None], np.nan, coms)
        outs = [
            _baselines(cone, sets, coms[rows], com_velocities[rows], self._rows, height, self._gravity)
            for rows, cone, sets in parts
        ]
        return _in_order(parts, outs)

    def _parts(self, choices: RowChoices, coms) -> tuple[list["_Part"], BadRows]:
        """The rows of each set that many choose, and the rest."""
        numbers, bad = self.choose(choices)
        counts = np.bincount(numbers[~bad.rows], minlength=len(self._sets))
        numbers[bad.rows] = np.argmax(counts)  # they go along with others, and call for no program of their own
        self._rows = max(self._rows, min(BLOCK, len(coms)))
        cones = {i: cone for i in np.flatnonzero(counts >= MANY).tolist() if (cone := self._cone(i)) is not None}
        parts = [_Part(np.flatnonzero(numbers == i), cone, self._sets[i]) for i, cone in cones.items()]
        rest = np.flatnonzero(~np.isin(numbers, list(cones)))
        if len(rest) or not parts:
            own = lambda x: x[numbers[rest]].astype(coms.dtype if x.dtype != bool else bool)
            parts.append(_Part(rest, *jax.tree.map(own, (self._rays, self._stacked))))
        return parts, bad

    def _cone(self, number: int) -> CentroidalCone | None:
        """The faces of a set, or None where the projection fails: its rays serve as well."""
        if number not in self._cones:
            contacts = self._sets[number]
            try:
                cone = centroidal_cone(contacts, sides=self._sides) if np.any(contacts.mask) else _no_wrench()
                rows = FACES << max(0, (len(cone.faces) - 1) // FACES).bit_length()
                self._cones[number] = cone.padded(rows)
            except ProjectionError:
                self._cones[number] = None
        return self._cones[number]


class _Part(NamedTuple):
    """Rows of a batch that are scored in one call."""

    rows: Int[np.ndarray, " k"]
    cone: CentroidalCone | ConeRays
    """Of all of them, or rays of each."""
    contacts: ContactSet
    """The same."""


def _in_order(parts: list[_Part], outs: list):
    """The answers for all parts, row by row."""
    order = np.argsort(np.concatenate([part.rows for part in parts]))
    return jax.tree.map(lambda *fields: np.concatenate(fields)[order], *outs)


@partial(jax.jit, static_argnames="sides")
def _rays(contacts: ContactSet, sides: int) -> ConeRays:
    return cone_rays(contacts, sides)


def _no_wrench() -> CentroidalCone:
    """The cone of no contact: every wrench <= 0 and >= 0."""
    return CentroidalCone(np.concatenate([np.eye(6), -np.eye(6)]), np.zeros(3), np.asarray(1.0))


def _score(cone, coms, com_velocities, rows: int, gravity, neighbours: bool) -> Capturability:
    """Scores on the host; neighbours count for rays alone."""
    own = isinstance(cone, ConeRays)
    states = _filled((coms, com_velocities), rows)
    out = score(_filled(cone, rows) if own else cone, *states, gravity=gravity, neighbours=neighbours and own)
    return jax.tree.map(lambda field: np.asarray(field)[: len(coms)], out)


def _baselines(cone, contacts, coms, com_velocities, rows: int, height, gravity) -> Baselines:
    """The same for `baselines`. The cone is one for all rows, as are the contacts, or rays of each."""
    sets = _filled((cone, contacts), rows) if isinstance(cone, ConeRays) else (cone, contacts)
    out = baselines(*sets, *_filled((coms, com_velocities), rows), height, gravity)
    return jax.tree.map(lambda field: np.asarray(field)[: len(coms)], out)


def _filled(tree, rows: int):
    """With zeros up to a multiple of `rows`, to repeat few shapes."""
    fill = lambda x: np.pad(x, ((0, -len(x) % rows), *[(0, 0)] * (x.ndim - 1))) if len(x) % rows else x
    return jax.tree.map(fill, tree)


def _listed(names: Iterable[str]) -> str:
    """Names for a message, not too many."""
    names = list(names)
    return ", ".join(map(repr, names[:10])) + (", ..." if len(names) > 10 else "") if names else "a name, but no set has one"


class _OneSet:
    """Scores batches of rows with the same contacts, as `SharedSets` and `OwnContacts` do others. size: of a full batch.

    Raises ValueError if the faces cannot be computed.
    """

    def __init__(self, contacts: ContactSet, sides: int, size: int):
        self._cone, self._contacts, self._size = jaxcap.centroidal_cone(contacts, sides=sides), contacts, size

    def score(self, _, coms, com_velocities):
        return self._padded(partial(jaxcap.score, self._cone, gravity=GRAVITY), coms, com_velocities), None

    def baselines(self, _, coms, com_velocities, height):
        one = partial(baselines_of, self._cone, self._contacts, height=height, gravity=GRAVITY)
        return self._padded(one, coms, com_velocities)

    def _padded(self, one, coms, com_velocities):
        """Waits for the answers. Zeros fill up to `size` rows, so that the last batch needs no compiling."""
        n = len(coms)
        padding = ((0, self._size - n), (0, 0))
        out = one(np.pad(coms, padding), np.pad(com_velocities, padding))
        return jax.tree.map(lambda field: np.asarray(field)[:n], out)


def scorer_of(contacts, path, size: int, sides: int, neighbours: bool) -> _OneSet | SharedSets | OwnContacts:
    """What scores batches, whatever the contacts are. size: rows of a full batch."""
    if isinstance(contacts, ContactSet):
        try:
            return _OneSet(contacts, sides, size)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from error
    options = {"sides": sides, "gravity": GRAVITY, "neighbours": neighbours}
    return SharedSets(*contacts, **options) if isinstance(contacts, ContactSets) else OwnContacts(**options)
