"""Which of two answers is right, by linear programs in double precision that share no code with jaxcap (`reference/`).

A form of the cone claims of a state, or of another speed along its line, that it is capturable or that it is not. Close to
a boundary of the capturable set both claims are honest: rounding the CoM decides. So the claim is *wrong* only if it is true
of no state in the ball around the state: CoM moved by `radius * size` (size: from the contacts' centroid to the farthest
contact, plus the CoM's distance from the centroid) plus a few units in the last place of the coordinates, direction of
travel turned by `radius`, speed changed by `band * speed`. radius is 1e-9 in double and 1e-5 in single precision, band 1e-6
and 1e-3.

The ball is searched: the state itself; every axis of CoM and velocity; random places in it; and, as the cone of rails, poles
and points is flat and the states that it carries are a surface of no thickness, the nearest state of that surface. What a
flat cone forbids next to that surface is less than a solver's tolerance: there the equations themselves are asked. Contacts
are taken as the exact numbers that they are after rounding to the dtype. Lengths are measured in `size` and times in
sqrt(size): the tolerances of the solvers are then relative, whatever the width of the stance.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from bench.fuzz_kinds import Sample
from reference.algorithm import brake, is_static_region_reachable
from reference.contacts import Wrenches, wrench_rays
from reference.linear_programs import line_terms, solve

RADIUS = {"float64": 1e-9, "float32": 1e-5}
"""Of the ball, relative to the size of the state [-]."""
BAND = {"float64": 1e-6, "float32": 1e-3}
"""Of the speed, relative to it [-]."""
ULPS = 4
"""So many units in the last place of the coordinates belong to the ball too."""
RANDOM = 8
"""Random neighbours of each sort."""
UNKNOWN = 10
"""With more places of a ball without a verdict, that a claim holds nowhere else is not known."""
ENDLESS = 1
"""Walks of too many pieces after which no other place is asked: each takes seconds."""
NEWTON = 6
"""Steps towards the surface of a flat cone."""
SWINGS = 4
"""Passes back and forth that are followed in C3.3."""
NO_BRAKE = 1e-7
"""A mean deceleration below this is none but the solver's tolerance [m/s^2]: no robot stops 10^8 sizes away."""
FLAT = 1e-13
"""A cone that has no more extent than this has none, and a term of its equations that is no larger is zero [-]."""
SAME_PLACE = 1e-9
"""Two places closer than this are one [size]."""


class State(NamedTuple):
    """One state in units of its size: gravity is as it was."""

    wrenches: Wrenches
    com: np.ndarray
    """(3,) [size]"""
    direction: np.ndarray
    """(3,)"""
    speed: float
    """[sqrt(size m)/s]"""
    reach: float
    """Radius of the ball of CoM positions [size]."""
    turn: float
    """Radius of the ball of directions [-]."""
    band: float
    """Half-width of the interval of speeds, relative to the speed [-]."""


def sizes(sample: Sample) -> np.ndarray:
    """Size of each state [m], (n,): from the contacts' centroid to the farthest contact, and to the CoM."""
    centre = sample.points.mean(axis=0)
    arms = np.linalg.norm(sample.points - centre, axis=1).max() + np.linalg.norm(sample.coms - centre, axis=1)
    return np.where(arms > 0, arms, 1.0)


def state_of(sample: Sample, row: int, dtype: str, speed: float | None = None) -> State:
    """The state of this row, at its own speed or another [m/s]."""
    centre = sample.points.mean(axis=0)
    com, velocity = sample.coms[row], sample.velocities[row]
    size = float(sizes(sample)[row])
    own_speed = np.linalg.norm(velocity)
    largest = max(np.abs(sample.points).max(), np.abs(com).max())
    return State(
        wrenches=wrench_rays((sample.points - centre) / size, sample.frames, sample.friction, sample.sides),
        com=(com - centre) / size,
        direction=velocity / own_speed,
        speed=float(own_speed if speed is None else speed) / np.sqrt(size),
        reach=RADIUS[dtype] + ULPS * float(np.finfo(dtype).eps) * largest / size,
        turn=RADIUS[dtype],
        band=BAND[dtype],
    )


def capturable(state: State) -> bool | None:
    """The verdict by Algorithms 1 and 2 of the reference, None where it has none.

    Not by its Algorithm 1 as a whole: its QP (16) may not end on flat cones. The static region is two linear programs here.
    """
    return _verdict(state)[0]


def _verdict(state: State) -> tuple[bool | None, bool]:
    """The same, and whether none was found because the walk has too many pieces, which takes long."""
    try:
        return _capturable(state), False
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        return None, str(error).startswith("no end")


def _capturable(state: State) -> bool | None:
    com, speed, direction, wrenches = state.com, state.speed, state.direction, state.wrenches
    if _never_brakes(state):
        return False
    walk = brake(com, speed, direction, wrenches)
    if walk.stop != "C3" or speed**2 < 2 * NO_BRAKE * walk.alpha:
        return False
    region = static_region(com, direction, wrenches)
    if region is None:
        return False
    low, high = region
    if walk.alpha < low - SAME_PLACE:
        return is_static_region_reachable(com, speed, direction, wrenches)
    alpha, heading = walk.alpha, 1
    for _ in range(SWINGS):
        if low - SAME_PLACE <= alpha <= high + SAME_PLACE:
            return True
        if high - low < SAME_PLACE:  # nothing brakes a swing
            return False
        heading = -heading
        back = brake(com + alpha * direction, 0.0, heading * direction, wrenches, from_rest=True)
        if back.stop != "C3":
            return False
        alpha += heading * back.alpha
    return True  # every swing is smaller than the one before


def _never_brakes(state: State) -> bool:
    """Whether the equations of a flat cone alone say that the CoM can not go on along its line, or not slow down on it.

    In the directions in which the cone has no extent, per_acc * acceleration + per_alpha * alpha + constant = 0.
    """
    left, values, _ = np.linalg.svd(state.wrenches.rays)
    extents = np.append(values, np.zeros(6 - len(values)))
    null = left[:, extents <= FLAT * extents[0]].T
    per_acc, constant, per_alpha = (null @ term for term in line_terms(state.com, state.direction, state.wrenches))
    size = np.linalg.norm(per_acc)
    if size <= 100 * FLAT:
        return bool(max(np.linalg.norm(per_alpha), np.linalg.norm(constant)) > 100 * FLAT)
    unit = per_acc / size
    across = [np.linalg.norm(term - unit * (unit @ term)) for term in (constant, per_alpha)]
    # acceleration = -(unit @ constant + alpha * unit @ per_alpha) / size
    return bool(max(across) > FLAT or max(unit @ constant, unit @ per_alpha) <= FLAT)


def static_region(com, direction, wrenches: Wrenches) -> tuple[float, float] | None:
    """Where on the line zero acceleration is feasible, from and to [size]; None if nowhere."""
    _, constant, slope = line_terms(com, direction, wrenches)
    scale = np.linalg.norm(constant)
    matrix = np.column_stack([-slope / scale, wrenches.rays])
    ends = []
    for sign in (1.0, -1.0):
        cost = np.zeros(matrix.shape[1])
        cost[0] = sign
        found = solve(cost, matrix, constant / scale)
        if found.status == 2:
            return None
        ends.append(-sign * np.inf if found.status == 3 else float(found.x[0]))
    return ends[0], ends[1]


def true_of_some(state: State, claim: bool) -> bool | None:
    """Whether a state in the ball is (claim) or is not (not claim) capturable; None where the reference cannot say.

    A few places without a verdict say nothing: in the next the same linear programs end elsewhere.
    """
    unknown, endless = 0, 0
    for one in (state, *_ball(state)):
        verdict, too_long = _verdict(one)
        if verdict == claim:
            return True
        unknown += verdict is None
        endless += too_long
        if endless > ENDLESS:
            return None
    return None if unknown > UNKNOWN else False


def _ball(state: State) -> Iterator[State]:
    """States of the ball, the more telling ones first."""
    speeds = [state.speed * (1 + sign * state.band) for sign in (1, -1)]
    yield from (state._replace(speed=speed) for speed in speeds)
    for flat in _on_the_surface(state):
        yield from (flat._replace(speed=speed) for speed in (state.speed, *speeds))
    rng = np.random.default_rng(0)
    moves = [np.concatenate(pair) for pair in zip(*[rng.normal(size=(RANDOM, 3)) for _ in range(2)], strict=True)]
    for move in (*np.eye(6), *-np.eye(6), *moves):
        yield _moved(state, state.reach * _unit(move[:3]), state.turn * _unit(move[3:]))
    for move in moves:
        amounts = rng.uniform(size=2)
        moved = _moved(state, amounts[0] * state.reach * _unit(move[3:]), amounts[1] * state.turn * _unit(move[:3]))
        yield moved._replace(speed=speeds[int(rng.integers(2))])


def _unit(vector):
    length = np.linalg.norm(vector)
    return vector / length if length > 0 else vector


def _moved(state: State, place, turn) -> State:
    return state._replace(com=state.com + place, direction=_unit(state.direction + turn))


def _on_the_surface(state: State) -> Iterator[State]:
    """Where the cone is flat, or flat within the ball: the nearest state that it carries, all along its line.

    In the directions in which the cone has no extent the wrench has to vanish at rest, and change neither with the
    acceleration nor with alpha. With and without the condition on alpha: a point carries what moves towards it, too.
    """
    left, values, _ = np.linalg.svd(state.wrenches.rays)
    extents = np.append(values, np.zeros(6 - len(values)))
    null = left[:, extents <= 10 * state.reach * extents[0]].T
    if not len(null):
        return
    scales = np.repeat([state.reach, state.turn], 3)

    def residual(x, terms):
        com, direction = state.com + scales[:3] * x[:3], state.direction + scales[3:] * x[3:]
        per_acc, constant, per_alpha = line_terms(com, direction, state.wrenches)
        return np.concatenate([null @ term for term in (constant, per_acc, per_alpha)[:terms]])

    for terms in (3, 2, 1):
        x = np.zeros(6)
        for _ in range(NEWTON):
            here = residual(x, terms)
            slope = np.column_stack([residual(x + e, terms) - here for e in np.eye(6)])
            x = x - np.linalg.lstsq(slope, here, rcond=1e-10)[0]
        if np.linalg.norm(x[:3]) <= 1 and np.linalg.norm(x[3:]) <= 1:
            yield _moved(state, scales[:3] * x[:3], scales[3:] * x[3:])
