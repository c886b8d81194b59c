"""A block of states: chunks for the cache, two rounds so that a chunk seldom waits for its slowest lane."""

import functools

import jax
import jax.numpy as jnp

from jaxcap.batch.blocks import LANES, over_chunks, padded
from jaxcap.contacts.cone import CentroidalCone
from jaxcap.one_state.capturability import capturability_of_lanes
from jaxcap.one_state.decision import capturability_at
from jaxcap.one_state.line import survey_of_lanes, travel_of_lanes

FEW_ROWS = 160
"""Up to so many faces, a chunk has twice as many lanes: what each operation costs besides its numbers is shared by more."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(3,))
def answers(common, per_state, gravity, neighbours: bool):
    """`capturability` of the states of a block."""
    return answer_block(common, per_state, gravity, neighbours)


@answers.defjvp
def _answers_jvp(neighbours, primals, tangents):
    """Derivatives are those of one round: the second has a loop of unknown length, and puts its answers over the first's."""

    def in_one_round(common, per_state, gravity):
        return over_chunks(lambda states: capturability_of_lanes(*_arguments(common, states), gravity), per_state)

    return jax.jvp(in_one_round, primals, tangents)


def answer_block(common, per_state, gravity, neighbours: bool = False, answer=capturability_at):
    """The answers for one block, in two rounds. answer: of lines of travel, speeds along them, and whether they are finite.

    A chunk takes as long as its slowest lane. So all states are looked at quickly, which settles most of them; the others go
    into the second round, side by side with those that have the same left to find out.
    """
    n = len(jax.tree.leaves(per_state)[0])
    lanes = 2 * LANES if isinstance(common, CentroidalCone) and len(common.faces) <= FEW_ROWS and n >= 2 * LANES else LANES
    travel = lambda states, survey, quick: travel_of_lanes(*_arguments(common, states), gravity, survey, quick)

    def first(rows):
        line, *motion = travel(*rows, quick=True)
        return answer(line, *motion), line.left, line.lower.pieces.slope[-1], _lean(line.survey)

    surveys = _surveys(common, per_state, gravity) if neighbours else None
    answers, left, slope, surveys = over_chunks(first, (per_state, surveys), lanes)
    order, count = unsettled(left, slope, lanes)
    rows = jax.tree.map(lambda x: x[order], (per_state, surveys))

    def second(chunk, answers):
        start = chunk * lanes
        cut = lambda x: jax.lax.dynamic_slice_in_dim(x, start, lanes)
        found = answer(*travel(*jax.tree.map(lambda x: jnp.moveaxis(cut(x), 0, -1), rows), quick=False))
        place = jnp.where(start + jnp.arange(lanes) < count, cut(order), n)   # beyond the last: dropped
        return jax.tree.map(lambda x, y: x.at[place].set(jnp.moveaxis(y, -1, 0), mode="drop"), answers, found)

    return jax.lax.fori_loop(0, -(-count // lanes), second, answers)


def unsettled(left, slope, lanes: int):
    """Indices of the rows where something is left, those alike together, padded to whole chunks; and how many they are.

    slope: where the quick look stopped [1/s^2]; the steeper a boundary still falls, the more pieces follow. All is sorted as
    one integer, five times as fast as by two keys: four bits for what is left, the rest for the slope and the index.
    """
    n = len(left)
    levels = 1 << max(27 - n.bit_length(), 0)
    level = (levels - 1) * (0.5 + 0.5 * slope / (1 + jnp.abs(slope)))
    level = jnp.where(level >= 0, level, 0).astype(jnp.int32)   # NaN is not
    kind = jnp.where(left == 0, 8, left).astype(jnp.int32)   # what is settled comes last
    order = jnp.sort((kind * levels + level) * n + jnp.arange(n, dtype=jnp.int32)) % n
    return jnp.pad(order, (0, -n % lanes)), jnp.sum(left != 0, dtype=jnp.int32)


def _lean(survey):
    """Without what no other round needs."""
    return survey._replace(near=())


def _surveys(common, per_state, gravity):
    """All surveys of a block of neighbours, which share a lane: each begins where the one before has ended."""
    one = lambda states, near=None: survey_of_lanes(*_arguments(common, states), gravity, near)
    n, steps = len(per_state[0]), -(-len(per_state[0]) // LANES)
    to_steps = lambda x: jnp.moveaxis(x.reshape(LANES, steps, *x.shape[1:]), 0, -1)
    states = jax.tree.map(to_steps, padded(per_state, steps * LANES))

    def step(near, states):
        survey = one(states, near)
        return survey.near, _lean(survey)

    first = one(jax.tree.map(lambda x: x[0], states))
    surveys = jax.lax.scan(step, first.near, states)[1]
    return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0).reshape(-1, *x.shape[1:-1])[:n], surveys)


def _arguments(common, states):
    """Cone, CoM and velocity of a chunk; the cone is common, or every state's own."""
    com, com_velocity, *own = states
    return (*own, com, com_velocity) if own else (common, com, com_velocity)


