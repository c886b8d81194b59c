"""A block of states: chunks for the cache, two rounds so that a chunk seldom waits for its slowest lane."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Int8, Num

from jaxcap.batch.blocks import LANES, over_chunks
from jaxcap.contacts.actuation import ActuatedRays
from jaxcap.contacts.cone import CentroidalCone, ConeRays
from jaxcap.contacts.conventions import FloatArray
from jaxcap.numerics.whole import ceil_div
from jaxcap.one_state.capturability import capturability_of_lanes
from jaxcap.one_state.decision import capturability_at
from jaxcap.one_state.line import Cone, Motion, motion_of_lanes, survey_of_lanes
from jaxcap.one_state.polygon import Survey
from jaxcap.one_state.result import Capturability

FEW_ROWS = 160
"""Up to so many faces, a chunk has twice as many lanes: what each operation costs besides its numbers is shared by more."""


LIMITED_BYTES = 256
"""Of one number of all states of a chunk, where the robot's limits come in: their programs are several times as large."""


class States(NamedTuple):
    """What differs from state to state: rows first in a block, lanes last in a chunk."""

    coms: Num[Array, "n 3"]
    """[m]"""
    com_velocities: Num[Array, "n 3"]
    """[m/s]"""
    cones: ConeRays | ActuatedRays | None = None
    """The contacts of each state, where they are its own."""
    specific_angular_momenta: Num[Array, "n 3"] | None = None
    """About the CoM, over the mass [m^2/s]; None for zero."""


class Shared(NamedTuple):
    """What the states of a block have in common."""

    gravity: Num[Array, "3"]
    """[m/s^2]"""
    cone: Cone | None = None
    """The contacts of all states, where these have none of their own."""
    filled: Int[FloatArray, ""] | None = None
    """So many of a block's rows are states, the others are padding, of which nothing is computed; None: all are."""

    def cone_of(self, states: States) -> Cone:
        """The contacts of these states."""
        cone = self.cone if states.cones is None else states.cones
        assert cone is not None, "states without contacts"
        return cone


@functools.partial(jax.custom_jvp, nondiff_argnums=(2,))
def scored_block(shared: Shared, states: States, neighbours: bool) -> Capturability:
    """`capturability` of the states of a block, differentiable."""
    return in_two_rounds(shared, states, neighbours)


@scored_block.defjvp
def _scored_block_jvp(neighbours: bool, primals: tuple, tangents: tuple) -> tuple[Capturability, Capturability]:
    """Derivatives are those of one round: the second has a loop of unknown length, and puts its answers over the first's."""

    def in_one_round(shared: Shared, states: States) -> Capturability:
        of_lanes = lambda lanes: capturability_of_lanes(
            shared.cone_of(lanes), lanes.coms, lanes.com_velocities, shared.gravity, lanes.specific_angular_momenta
        )
        return over_chunks(of_lanes, states)

    return jax.jvp(in_one_round, primals, tangents)


class _Glance(NamedTuple):
    """What the first round leaves of a state."""

    answer: Any
    skipped: Int8[Array, " n"]
    """`Line.skipped`."""
    slope: Float[Array, " n"]
    """Of the last line that was walked [1/s^2]."""
    survey: Survey


def in_two_rounds(
    shared: Shared, states: States, neighbours: bool = False, answer: Callable[[Motion], Any] = capturability_at
) -> Any:
    """The answers for one block. answer: of motions side by side, lanes last.

    A chunk takes as long as its slowest lane. So all states are looked at quickly, which settles most of them; the others go
    into the second round, side by side with those that have the same left to find out.
    """
    lanes = _lanes(shared, states)
    surveys = _surveys(shared, states) if neighbours else None

    def first(rows: tuple[States, Survey | None]) -> _Glance:
        motion = _motion(shared, *rows, quick=True)
        line = motion.line
        assert line.skipped is not None, "this was a quick look"
        return _Glance(answer(motion), line.skipped, line.lower.pieces.slope[-1], _lean(line.survey))

    glance = over_chunks(first, (states, surveys), lanes, shared.filled)
    order, count = unsettled(glance.skipped, glance.slope, lanes)
    return _second_round(shared, (states, glance.survey), order, count, glance.answer, answer, lanes)


def _second_round(
    shared: Shared,
    rows: tuple[States, Survey],
    order: Int[Array, " m"],
    count: Int[Array, ""],
    answers: Any,
    answer: Callable[[Motion], Any],
    lanes: int,
) -> Any:
    """The answers, with those of the first `count` rows of `order` found anew, by a whole walk."""
    n = len(rows[0].coms)
    rows = jax.tree.map(lambda x: x[order], rows)

    def one_chunk(chunk, answers):
        start = chunk * lanes
        cut = lambda x: jax.lax.dynamic_slice_in_dim(x, start, lanes)
        states, survey = jax.tree.map(lambda x: jnp.moveaxis(cut(x), 0, -1), rows)
        found = answer(_motion(shared, states, survey, quick=False))
        place = jnp.where(start + jnp.arange(lanes) < count, cut(order), n)  # beyond the last: dropped
        return jax.tree.map(lambda x, y: x.at[place].set(jnp.moveaxis(y, -1, 0), mode="drop"), answers, found)

    return jax.lax.fori_loop(0, ceil_div(count, lanes), one_chunk, answers)


def _lanes(shared: Shared, states: States) -> int:
    """How many states of a block share a chunk."""
    n = len(states.coms)
    if isinstance(shared.cone_of(states), ActuatedRays):
        return LIMITED_BYTES // states.coms.dtype.itemsize
    few = isinstance(shared.cone, CentroidalCone) and len(shared.cone.faces) <= FEW_ROWS
    return 2 * LANES if few and n >= 2 * LANES else LANES


def _motion(shared: Shared, lanes: States, survey: Survey | None, quick: bool) -> Motion:
    momenta = lanes.specific_angular_momenta
    return motion_of_lanes(shared.cone_of(lanes), lanes.coms, lanes.com_velocities, shared.gravity, survey, quick, momenta)


def unsettled(skipped: Int8[Array, " n"], slope: Float[Array, " n"], lanes: int) -> tuple[Int[Array, " m"], Int[Array, ""]]:
    """Indices of the rows where something was skipped, those alike together, padded to whole chunks; and how many they are.

    slope: where the quick look stopped [1/s^2]; the steeper a boundary still falls, the more pieces follow. All is sorted as
    one integer, five times as fast as by two keys: four bits for what was skipped, the rest for the slope and the index.
    """
    n = len(skipped)
    levels = 1 << max(27 - n.bit_length(), 0)
    level = (levels - 1) * (0.5 + 0.5 * slope / (1 + jnp.abs(slope)))
    level = jnp.where(level >= 0, level, 0).astype(jnp.int32)  # NaN is not
    kind = jnp.where(skipped == 0, 8, skipped).astype(jnp.int32)  # what is settled comes last
    order = jnp.sort((kind * levels + level) * n + jnp.arange(n, dtype=jnp.int32)) % n
    return jnp.pad(order, (0, -n % lanes)), jnp.sum(skipped != 0, dtype=jnp.int32)


def _lean(survey: Survey) -> Survey:
    """Without what no other round needs."""
    return survey._replace(near=())


def _surveys(shared: Shared, states: States) -> Survey:
    """All surveys of a block of neighbours, which share a lane: each begins where the one before has ended."""

    def one(lanes: States, near: Any = None) -> Survey:
        momenta = lanes.specific_angular_momenta
        return survey_of_lanes(shared.cone_of(lanes), lanes.coms, lanes.com_velocities, shared.gravity, near, momenta)

    n = len(states.coms)
    # A lane has rows that follow each other, as many as there are steps; those beyond the last are done for nothing.
    steps = ceil_div(jnp.asarray(n if shared.filled is None else shared.filled, jnp.int32), LANES)
    in_lane = jnp.arange(LANES, dtype=jnp.int32) * steps
    at = lambda k: jax.tree.map(lambda x: jnp.moveaxis(x[jnp.minimum(in_lane + k, n - 1)], 0, -1), states)

    def step(k, known):
        near, found = known
        survey = one(at(k), near)
        put = lambda every, new: jax.lax.dynamic_update_index_in_dim(every, new, k, 0)
        return survey.near, jax.tree.map(put, found, _lean(survey))

    first = one(at(0))
    nothing = jax.tree.map(lambda x: jnp.zeros((ceil_div(n, LANES), *x.shape), x.dtype), _lean(first))
    surveys = jax.lax.fori_loop(0, steps, step, (first.near, nothing))[1]
    row = jnp.arange(n, dtype=jnp.int32)
    back = lambda x: jnp.moveaxis(x, -1, 1)[
        row % jnp.maximum(steps, 1), jnp.minimum(row // jnp.maximum(steps, 1), LANES - 1)
    ]
    return jax.tree.map(back, surveys)
