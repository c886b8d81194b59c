"""The ray form, where every state has its own contacts: against projections and linear programs, warm starts, pivots.

`lines`, a number of rectangles and a precision each: states/s of `score` over those of

    project  the face form with one projection for each state: `centroidal_cone`, then `capturability`, compiled
    LP       one linear program (25) for each state, at alpha = 0, by HiGHS; the paper's algorithm needs several

on the first few states, and states/s. Then trajectories of 64 states each, without and with `neighbours=True`, in turn.
`differ` counts verdicts that are not those of the projection although the margin is larger than the band: it has to be 0.

`pivots` counts pivots of a survey (the smallest acceleration at alpha = 0, and both ends of the static region) and pieces of
the lower boundary, cold, in double precision, for kinds of contact sets; 400 random states each.
"""

import operator
import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap
from bench.stances import Batch, batch
from bench.throughput import BAND
from bench.timing import in_turn, ratio
from jaxcap.contacts.conventions import GRAVITY
from jaxcap.numerics.guarded import direction
from jaxcap.one_state.line import survey_of_lanes
from jaxcap.one_state.ray_polygon import ray_polygon
from tests.samplers import random_contacts, random_state, rectangle, rotation

SEED, STEPS, DT = 3, 64, 0.002
ROWS = 640
"""Faces of a cone of the baseline, padded: compiled once."""


def line(rectangles: int, dtype: str, states: int, few: int, rounds: int) -> dict:
    """One line of the first table. states: of a batch, a multiple of 64. few: states of the baselines."""
    sample = batch(f"own sets of {rectangles} rectangles", states)
    contacts, coms, velocities = _in(dtype, sample[1:])
    moving = _in(dtype, _trajectories(sample)[1:])
    rays, moving_rays = (jax.jit(jaxcap.cone_rays)(sets) for sets in (contacts, moving[0]))
    timed = in_turn(
        {
            "cold": lambda: jaxcap.score(rays, coms, velocities),
            "t.cold": lambda: jaxcap.score(moving_rays, *moving[1:]),
            "t.warm": lambda: jaxcap.score(moving_rays, *moving[1:], neighbours=True),
        },
        rounds,
    )
    projecting, faces = _projection(sample.first(few), dtype)
    rate, answer = states / timed["cold"].best, timed["cold"].answer
    unlike = (answer.capturable[:few] != faces.capturable) & ~(np.abs(faces.margin) < BAND[dtype])
    rates = {name: states / timed[name].best for name in timed}
    return {
        "x project": rate * projecting,
        "x LP": rate * _linear_program(sample.first(few)),
        "x warm": ratio(timed["t.cold"], timed["t.warm"]),
        "rectangles": rectangles,
        "dtype": dtype,
        **rates,
        "undecided": int((answer.status == jaxcap.Status.MAX_STEPS).sum()),
        "differ": int(unlike.sum()),
    }


def _in(dtype: str, arrays):
    return jax.tree.map(lambda x: jnp.asarray(x, dtype if x.dtype != bool else bool), arrays)


def _trajectories(sample: Batch) -> Batch:
    """The first states, each followed for STEPS steps at constant velocity."""
    first = sample.first(len(sample.coms) // STEPS)
    repeated = lambda x: np.repeat(x, STEPS, axis=0)
    along = (np.arange(STEPS) * DT)[:, None]
    moved = (first.coms[:, None] + along * first.com_velocities[:, None]).reshape(-1, 3)
    return Batch(first.name, jax.tree.map(repeated, first.contacts), moved, repeated(first.com_velocities))


def _one_by_one(sample: Batch):
    """The states, each with its own contact set."""
    for i, state in enumerate(zip(sample.coms, sample.com_velocities, strict=True)):
        yield jax.tree.map(operator.itemgetter(i), sample.contacts), *state


def _projection(sample: Batch, dtype: str):
    """Seconds a state of the face form with a projection for each, and the answers."""
    one = jax.jit(jaxcap.capturability)
    cone = lambda contacts: jaxcap.centroidal_cone(contacts).padded(ROWS)
    answer = lambda contacts, com, velocity: one(cone(contacts), com.astype(dtype), velocity.astype(dtype))
    jax.block_until_ready(answer(*next(_one_by_one(sample))))
    start = time.perf_counter()
    answers = [jax.tree.map(np.asarray, answer(*state)) for state in _one_by_one(sample)]
    return (time.perf_counter() - start) / len(answers), jax.tree.map(lambda *leaves: np.stack(leaves), *answers)


def _linear_program(sample: Batch) -> float:
    """Seconds a state of one linear program each, its set-up included."""
    from reference.contacts import wrench_rays
    from reference.linear_programs import line_program, solve_acceleration

    start = time.perf_counter()
    for contacts, com, velocity in _one_by_one(sample):
        wrenches = wrench_rays(contacts.points, contacts.frames, contacts.friction)
        solve_acceleration(line_program(com, velocity / np.linalg.norm(velocity), wrenches), 0.0, 1)
    return (time.perf_counter() - start) / len(sample.coms)


UP = np.eye(3)
foot = lambda x, y, z=0.0, frame=UP, friction=0.5: rectangle([x, y, z], frame, friction=friction)
joined = lambda *parts: tuple(np.concatenate(fields) for fields in zip(*parts, strict=True))
KINDS = {
    "coplanar feet, equal frames": joined(foot(0, 0.1), foot(0, -0.1)),
    "four coplanar feet": joined(foot(0.3, 0.1), foot(0.3, -0.1), foot(-0.3, 0.1), foot(-0.3, -0.1)),
    "feet on a slope": joined(foot(0, 0.2, 0, rotation(0.3, 0, 0)), foot(0, -0.2, 0, rotation(0.3, 0, 0))),
    "opposing palms": joined(foot(0, 0.2, 1, rotation(np.pi / 2, 0, 0)), foot(0, -0.2, 1, rotation(-np.pi / 2, 0, 0))),
    "one point": (np.zeros((1, 3)), UP[None], np.array([0.5])),
    "two points": (np.array([[-0.2, 0, 0], [0.2, 0, 0]]), np.stack([UP] * 2), np.full(2, 0.5)),
}


def pivots(name: str, sides: int, count: int = 400) -> dict:
    """One line of the second table. name: of a kind, or "k random rectangles"."""
    rng = np.random.default_rng(SEED)
    arrays = [KINDS[name] if name in KINDS else random_contacts(rng, int(name[0])) for _ in range(count)]
    states = [random_state(rng, points) for points, *_ in arrays]
    coms, velocities = (jnp.asarray(np.array(x).T) for x in zip(*states, strict=True))
    sets = jaxcap.ContactSet(*(np.stack(fields) for fields in zip(*arrays, strict=True)))
    rays = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), jaxcap.cone_rays(sets, sides))
    survey = survey_of_lanes(rays, coms, velocities, GRAVITY)
    walked = jnp.where(survey.feasible, jnp.inf, 0.0)
    lower = ray_polygon(rays, coms, direction(velocities)[0], jnp.asarray(GRAVITY)).knowing(survey).boundary(walked)
    pieces = jnp.sum(lower.pieces.right > lower.pieces.left, axis=0)[survey.feasible]
    spread = lambda what, x: {f"{what} {q} %": float(np.percentile(x, q)) if len(x) else np.nan for q in (50, 99, 100)}
    return {"kind": name, "sides": sides} | spread("pivots", survey.near.pivots) | spread("pieces", pieces)
