"""How cost grows: with the batch, with the faces of a cone, with the rays of a contact set.

`ns` is the time of `jaxcap.score` for a state, all fields, best of the rounds. `power` is the slope of log cost over log
size between a line and the one before: 0 where cost does not grow, 1 where it is proportional.
"""

import itertools
import math

import jax
import jax.numpy as jnp

import jaxcap
from bench.stances import batch
from bench.timing import spent

FACES = (
    ("one foot", 4),
    ("coplanar feet", 4),
    ("coplanar feet", 8),
    ("2 random rectangles", 4),
    ("3 random rectangles", 4),
    ("4 random rectangles", 4),
    ("3 random rectangles", 6),
    ("4 random rectangles", 6),
    ("4 random rectangles", 8),
)
"""Contact sets and sides of the pyramids, about in the order of their faces."""
RECTANGLES = (1, 2, 3, 4, 6)
"""Of the contact sets of rays."""


def with_batch(producer: str, most: int, rounds: int, dtype: str) -> list[dict]:
    """From one state to `most`, in powers of ten, on two feet."""
    sizes = [10**k for k in range(12) if 10**k <= most]
    states = batch("coplanar feet", sizes[-1])
    cone = _cone(producer, states.contacts, 4, dtype)
    lines = [
        {"producer": producer, "batch": n, "states/s": n / seconds, "ns": 1e9 * seconds / n}
        for n, seconds in ((n, _seconds(cone, states.first(n), rounds, dtype)) for n in sizes)
    ]
    return with_power(lines, "batch", lambda line: line["ns"] * line["batch"])


def with_faces(size: int, rounds: int, dtype: str, sets=FACES) -> list[dict]:
    """Sets with more and more faces, a batch of this size each."""
    lines = []
    for name, sides in sets:
        states = batch(name, size)
        cone = _cone("face", states.contacts, sides, dtype)
        nano = 1e9 * _seconds(cone, states, rounds, dtype) / size
        rows = len(cone.faces)
        lines.append({"contacts": name, "sides": sides, "points": len(states.contacts), "faces": rows, "ns": nano})
    lines.sort(key=lambda line: line["faces"])
    return with_power([line | {"ns/face": line["ns"] / line["faces"]} for line in lines], "faces", lambda line: line["ns"])


def with_rays(size: int, rounds: int, dtype: str, rectangles=RECTANGLES) -> list[dict]:
    """Every state on a set of its own, of more and more contacts."""
    lines = []
    for k in rectangles:
        states = batch(f"own sets of {k} rectangles", size)
        cone = _cone("own", states.contacts, 4, dtype)
        nano = 1e9 * _seconds(cone, states, rounds, dtype) / size
        lines.append({"rectangles": k, "points": 4 * k, "rays": 16 * k, "ns": nano, "ns/ray": nano / (16 * k)})
    return with_power(lines, "rays", lambda line: line["ns"])


def with_power(lines: list[dict], size: str, cost) -> list[dict]:
    """With the growth of the cost from each line to the next."""
    power = [math.nan]
    for before, line in itertools.pairwise(lines):
        times = line[size] / before[size]
        power.append(math.log(cost(line) / cost(before)) / math.log(times) if times > 1 else math.nan)
    return [line | {"power": value} for line, value in zip(lines, power, strict=True)]


def _cone(producer: str, contacts, sides: int, dtype: str):
    kind = jaxcap.centroidal_cone if producer == "face" else jaxcap.cone_rays
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype if leaf.dtype != bool else bool), kind(contacts, sides=sides))


def _seconds(cone, states, rounds: int, dtype: str) -> float:
    """Of `score`, the best of the rounds after the first call."""
    coms, velocities = jnp.asarray(states.coms, dtype), jnp.asarray(states.com_velocities, dtype)
    call = lambda: jaxcap.score(cone, coms, velocities)
    call()
    return min(spent(call)[0] for _ in range(rounds))
