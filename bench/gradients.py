"""Derivatives of the margin in both forms against differences, in double precision, on every kind of `bench.fuzz_kinds`.

    python -m bench.gradients [--seed S] [--pairs N] [--kinds ...] [--json OUT]

A pair is a state and a direction: a random change of the CoM, of its velocity, and by rays also of the contact points, of
friction, or of the frames (a rotation vector for each). Changes are relative: to the size of the state (distance from the
contacts' centroid to the farthest of them, plus to the CoM), to its speed, to friction, to one radian. The derivative is
that of `score` in forward mode, all pairs in one program. Half of the states, where there are so many, have a speed at which
they are capturable; the others are as they come.

Differences are one-sided, on both sides, with two steps. A side is resolved if its two differences agree. Columns:

    right          both sides resolved and equal, and the derivative is theirs
    wrong          the same, and it is not
    kinks right    they differ, as where contacts on a floor are moved out of it: the derivative is that of one side
    kinks between  it lies between the two, as the product of a subgradient and a direction does: what is linear in the
                   direction, as JAX wants it, cannot be one of the two along every direction
    kinks wrong    it is neither's, nor between them
    narrow         none of these, but with steps of 1e-11 the derivative is that of one side, or the sides differ, to a
                   twentieth: the margin has a feature narrower than the steps, as at a CoM exactly above an edge, where the
                   slack decides
    unclear        a side is not resolved, and no difference equals the derivative
    nan            the margin is a number, the derivative is not
    no margin      undecided, or the margin is infinite

Ends with status 1 unless wrong, kinks wrong and nan are all zero. Kinks are counted apart for they are no points to judge a
gradient at: of several faces that meet there one is differentiated.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap
from bench.fuzz_kinds import CONTACTS, KINDS, Sample, draw

STEPS = (1e-6, 1.25e-7)
"""Of the differences, relative [-]."""
NARROW = 1e-11
"""Of differences that see features narrower than that [-]."""
ROUGHLY = 0.05
"""Two derivatives are equal on that scale if they differ by less than this share."""
ALIKE = 1e-3
"""Two derivatives are equal if they differ by less than this share of themselves, or of the margin's scale."""
STATES = 16
"""Of each contact set; four times as many are drawn and looked at."""
GROUPS = ("com", "velocity", "points", "friction", "frames")
FACES = tuple(32 * 4**k for k in range(6))
"""Faces are padded to these numbers."""
COLUMNS = ("pairs", "right", "wrong", "kinks right", "kinks between", "kinks wrong", "narrow", "unclear", "nan", "no margin")


class Pairs(NamedTuple):
    """n states, each with contacts of its own, or their changes; arrays of NumPy or JAX."""

    com: Any
    """(n, 3) [m]"""
    velocity: Any
    """(n, 3) [m/s]"""
    points: Any
    """(n, k, 3) [m]"""
    friction: Any
    """(n, k)"""
    frames: Any
    """(n, k, 3, 3); of changes rotation vectors (n, k, 3) [rad]."""

    def rows(self, chosen) -> Pairs:
        """Some of them."""
        return Pairs(*(leaf[chosen] for leaf in self))


class Differences(NamedTuple):
    """One-sided differences of the margin, each (3, n) for the two steps and the narrow one."""

    ahead: np.ndarray
    behind: np.ndarray


def moved(pairs: Pairs, changes: Pairs, amount: float) -> Pairs:
    """The states after so much of the changes; NumPy, frames turned exactly."""
    sums = (np.asarray(one) + amount * np.asarray(other) for one, other in zip(pairs[:-1], changes[:-1], strict=True))
    return Pairs(*sums, turned(amount * changes.frames) @ pairs.frames)


def turned(vectors) -> np.ndarray:
    """Rotations (..., 3, 3) by rotation vectors (..., 3) [rad]."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    axis = skew(np, vectors) / np.where(angle > 0, angle, 1)
    return np.eye(3) + np.sin(angle) * axis + (1 - np.cos(angle)) * axis @ axis


def skew(xp, vectors):
    """Matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    x, y, z = (vectors[..., i] for i in range(3))
    none = xp.zeros_like(x)
    return xp.stack([xp.stack(row, axis=-1) for row in ((none, -z, y), (z, none, -x), (-y, x, none))], axis=-2)


def ray_margin(pairs: Pairs, mask, sides: int):
    """Margins (n,) by rays."""
    contacts = jaxcap.ContactSet(pairs.points, pairs.frames, pairs.friction, mask)
    return jaxcap.score(jaxcap.cone_rays(contacts, sides), pairs.com, pairs.velocity).margin


def ray_derivative(pairs: Pairs, changes: Pairs, mask, sides: int) -> np.ndarray:
    """Derivatives (n,) by rays along the changes."""

    def along(pairs, changes, mask, amount):
        frames = pairs.frames + amount * skew(jnp, changes.frames) @ pairs.frames
        sums = (one + amount * other for one, other in zip(pairs[:-1], changes[:-1], strict=True))
        return ray_margin(Pairs(*sums, frames), mask, sides)

    program = jax.jit(lambda pairs, changes, mask: jax.jvp(lambda t: along(pairs, changes, mask, t), (0.0,), (1.0,))[1])
    return np.asarray(program(jax.tree.map(jnp.asarray, pairs), changes, mask))


@jax.jit
def face_derivative(cone, coms, velocities, change_of_com, change_of_velocity):
    """Derivatives (n,) by the faces of one contact set."""
    along = lambda t: jaxcap.score(cone, coms + t * change_of_com, velocities + t * change_of_velocity).margin
    return jax.jvp(along, (0.0,), (1.0,))[1]


def differences(margin, pairs: Pairs, changes: Pairs, middle) -> Differences:
    """Of margin(pairs), ahead and behind."""
    with np.errstate(invalid="ignore"):
        ahead = [(margin(moved(pairs, changes, step)) - middle) / step for step in (*STEPS, NARROW)]
        behind = [(middle - margin(moved(pairs, changes, -step))) / step for step in (*STEPS, NARROW)]
    return Differences(np.array(ahead), np.array(behind))


def verdicts(derivative, found: Differences, middle, scale) -> np.ndarray:
    """The column of each pair, by name. scale: of the margin [m/s], (n,)."""
    with np.errstate(invalid="ignore"):
        alike = lambda a, b: np.abs(a - b) <= ALIKE * (scale + np.minimum(np.abs(a), np.abs(b)))
        (a1, a2, a3), (b1, b2, b3) = found
        resolved, same = alike(a1, a2) & alike(b1, b2), alike(a2, b2)
        right = alike(derivative, (a2 + b2) / 2)
        one_side = alike(derivative, a2) | alike(derivative, b2)
        roughly = lambda a, b: np.abs(a - b) <= ROUGHLY * np.maximum(np.maximum(np.abs(a), np.abs(b)), ROUGHLY * scale)
        more = ~roughly(a3, a2) | ~roughly(b3, b2)  # is seen with the narrow step
        narrow = more & (roughly(derivative, a3) | roughly(derivative, b3) | ~roughly(a3, b3))
        between = (np.minimum(a2, b2) <= derivative) & (derivative <= np.maximum(a2, b2))
        near = one_side | ~resolved & (alike(derivative, a1) | alike(derivative, b1))
    return np.select(
        [
            ~np.isfinite(middle),
            ~np.isfinite(derivative),
            resolved & same & right,
            near & ~(resolved & same),
            narrow,
            resolved & same,
            resolved & between,
            resolved,
        ],
        ["no margin", "nan", "right", "kinks right", "narrow", "wrong", "kinks between", "kinks wrong"],
        "unclear",
    )


def samples_of(options: argparse.Namespace) -> list[Sample]:
    """Contact sets with STATES states each, those that are capturable at some speed first, as far as half of them."""
    sets = -(-options.pairs // STATES)
    drawn = [draw(options.seed, i, options.kinds[i % len(options.kinds)], 4 * STATES) for i in range(sets)]
    drawn = [sample._replace(sides=options.sides) for sample in drawn]
    pairs, mask = pairs_of(drawn)
    cone = jaxcap.cone_rays(jaxcap.ContactSet(pairs.points, pairs.frames, pairs.friction, mask), options.sides)
    limits = np.asarray(jaxcap.score(cone, pairs.com, pairs.velocity).max_speed).reshape(sets, -1)
    chosen = []
    for sample, limit in zip(drawn, limits, strict=True):
        good, rest = np.flatnonzero(limit > 0)[: STATES // 2], np.arange(4 * STATES)
        rows = np.concatenate([good, np.setdiff1d(rest, good)])[:STATES]
        chosen.append(sample._replace(coms=sample.coms[rows], velocities=sample.velocities[rows]))
    return chosen


def pairs_of(samples: list[Sample]) -> tuple[Pairs, np.ndarray]:
    """All states of the samples with their contacts, padded, and the mask of contacts (n, k)."""
    n = len(samples[0].coms)
    sets = [jaxcap.ContactSet(s.points, s.frames, s.friction).padded(CONTACTS) for s in samples]
    each = lambda name: np.repeat(np.stack([getattr(contacts, name) for contacts in sets]), n, axis=0)
    coms, velocities = (np.concatenate([getattr(s, name) for s in samples]) for name in ("coms", "velocities"))
    return Pairs(coms, velocities, each("points"), each("friction"), each("frames")), each("mask")


def changes_of(rng, pairs: Pairs, mask, groups) -> tuple[Pairs, np.ndarray]:
    """A random change of one group in each pair, and the group's name (n,)."""
    n, k = mask.shape
    group = rng.choice(groups, size=n)
    centre = (pairs.points * mask[..., None]).sum(axis=1) / mask.sum(axis=1)[:, None]
    arms = np.linalg.norm(pairs.points - centre[:, None], axis=2) * mask
    size = (arms.max(axis=1) + np.linalg.norm(pairs.com - centre, axis=1))[:, None]
    speed = np.linalg.norm(pairs.velocity, axis=1, keepdims=True)
    unit = lambda *shape: (vectors := rng.normal(size=(n, *shape))) / np.sqrt((vectors**2).sum(axis=-1, keepdims=True))
    only = lambda name, change: change * (group == name).reshape(-1, *[1] * (change.ndim - 1))
    return Pairs(
        com=only("com", size * unit(3)),
        velocity=only("velocity", speed * unit(3)),
        points=only("points", size[..., None] * unit(k, 3) * mask[..., None]),
        friction=only("friction", pairs.friction * rng.uniform(-1, 1, (n, k)) * mask),
        frames=only("frames", unit(k, 3) * mask[..., None]),
    ), group


class Answer(NamedTuple):
    """What was found of the pairs of one form; arrays (n,)."""

    form: str
    kinds: np.ndarray
    group: np.ndarray
    column: np.ndarray
    derivative: np.ndarray
    found: Differences
    contacts: np.ndarray
    """How many a state has: the rows that are not padding."""


def by_rays(samples: list[Sample], rng, sides: int) -> tuple[Answer, Pairs, Pairs]:
    """The ray form on all pairs."""
    pairs, mask = pairs_of(samples)
    changes, group = changes_of(rng, pairs, mask, GROUPS)
    margin = lambda pairs: np.asarray(ray_margin(pairs, mask, sides))
    middle = margin(pairs)
    found = differences(margin, pairs, changes, middle)
    derivative = ray_derivative(pairs, changes, mask, sides)
    column = verdicts(derivative, found, middle, scale_of(pairs, changes))
    kinds = np.repeat([s.kind for s in samples], len(samples[0].coms))
    return Answer("rays", kinds, group, column, derivative, found, mask.sum(axis=1)), pairs, changes


def by_faces(samples: list[Sample], rng) -> tuple[Answer, Pairs, Pairs]:
    """The face form, set by set."""
    cones = [cone_of(sample) for sample in samples]
    samples = [sample for sample, cone in zip(samples, cones, strict=True) if cone is not None]
    pairs, mask = pairs_of(samples)
    changes, group = changes_of(rng, pairs, mask, GROUPS[:2])
    rows = [slice(i * STATES, (i + 1) * STATES) for i in range(len(samples))]
    parts = list(zip([cone for cone in cones if cone is not None], rows, strict=True))
    margin = lambda pairs: np.concatenate(
        [np.asarray(jaxcap.score(cone, pairs.com[own], pairs.velocity[own]).margin) for cone, own in parts]
    )
    middle = margin(pairs)
    found = differences(margin, pairs, changes, middle)
    derivative = np.concatenate([
        face_derivative(cone, *(array[own] for array in (pairs.com, pairs.velocity, changes.com, changes.velocity)))
        for cone, own in parts
    ])  # fmt: skip
    column = verdicts(derivative, found, middle, scale_of(pairs, changes))
    kinds = np.repeat([s.kind for s in samples], STATES)
    return Answer("faces", kinds, group, column, derivative, found, mask.sum(axis=1)), pairs, changes


def cone_of(sample: Sample):
    """Faces padded to one of a few numbers, or None if the projection is refused."""
    try:
        cone = jaxcap.centroidal_cone(jaxcap.ContactSet(sample.points, sample.frames, sample.friction), sample.sides)
    except ValueError:
        return None
    return cone.padded(next(size for size in FACES if size >= len(cone.faces)))


def scale_of(pairs: Pairs, changes: Pairs) -> np.ndarray:
    """Scale of the margin [m/s]: the speed, or that of a fall over the distance to the contacts."""
    arm = np.linalg.norm(pairs.points[:, 0] - pairs.com, axis=1)
    return np.maximum(np.linalg.norm(pairs.velocity, axis=1), np.sqrt(9.81 * arm))


def table(answer: Answer, by: np.ndarray) -> str:
    """Counts by kind or by group."""
    counts: dict[str, Counter] = defaultdict(Counter)
    for name, column in zip(by, answer.column, strict=True):
        counts[str(name)].update([str(column), "pairs"])
    total = Counter(map(str, answer.column)) + Counter(pairs=len(answer.column))
    line = lambda first, values: f"{first:15}" + "".join(f"{value:>14}" for value in values)
    rows = [line(name, [count[c] for c in COLUMNS]) for name, count in (*sorted(counts.items()), ("total", total))]
    return "\n".join([line(answer.form, COLUMNS), *rows])


def failures(answer: Answer, pairs: Pairs, changes: Pairs, sides: int, keep: int) -> list[dict[str, Any]]:
    """Pairs that failed, with contacts and change, at most `keep` of each kind, group and column."""
    seen: Counter = Counter()
    out = []
    for i in np.flatnonzero(np.isin(answer.column, ("wrong", "kinks wrong", "nan", "unclear"))):
        key = (str(answer.kinds[i]), str(answer.group[i]), str(answer.column[i]))
        seen[key] += 1
        if seen[key] > keep:
            continue
        k = answer.contacts[i]
        head = {"name": f"grad_{answer.form}_{i}_{key[0]}".replace(" ", "_"), "kind": key[0], "form": answer.form}
        head |= {"what": f"{key[2]}, {key[1]}", "dtype": "float64", "sides": sides}
        state = {name: getattr(pairs, name)[i][:k].tolist() for name in ("points", "frames", "friction")}
        state |= {"com": pairs.com[i].tolist(), "com_velocity": pairs.velocity[i].tolist()}
        change = {"change": getattr(changes, key[1])[i][:k].tolist(), "derivative": float(answer.derivative[i])}
        change |= {name: getattr(answer.found, name)[:, i].tolist() for name in ("ahead", "behind")}
        out.append(head | state | change)
    return out


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print; the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.gradients", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="(default: 0)")
    parser.add_argument("--pairs", type=int, default=10000, metavar="N", help="of each form (default: 10000)")
    parser.add_argument("--sides", type=int, default=4, metavar="N", help="of the friction pyramids (default: 4)")
    parser.add_argument("--keep", type=int, default=2, metavar="N", help="failures of a kind that are saved (default: 2)")
    parser.add_argument("--forms", nargs="+", choices=("faces", "rays"), default=["faces", "rays"], help="(default: both)")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS), metavar="KIND", help="(default: all)")
    parser.add_argument("--json", type=Path, metavar="OUT", help="where failing pairs are saved")
    options = parser.parse_args(arguments)
    print(f"jaxcap: {Path(jaxcap.__file__).parent}, seed {options.seed}; compiling", file=sys.stderr, flush=True)
    bad, saved = 0, []
    with jax.enable_x64(True):
        samples = samples_of(options)
        for form in options.forms:
            rng = np.random.default_rng((options.seed, form == "rays"))
            answer, pairs, changes = by_rays(samples, rng, options.sides) if form == "rays" else by_faces(samples, rng)
            print(f"{table(answer, answer.kinds)}\n\n{table(answer, answer.group)}\n", flush=True)
            bad += int(np.isin(answer.column, ("wrong", "kinks wrong", "nan")).sum())
            saved += failures(answer, pairs, changes, options.sides, options.keep)
    if options.json is not None:
        options.json.write_text("[\n" + ",\n".join(map(json.dumps, saved)) + "\n]\n")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
