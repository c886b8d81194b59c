"""How fast is `jaxcap.score` where every state has its own contacts? Ray form, projection, linear programs, in one run.

    python -m bench.rays [--states 32768] [--baseline 40] [--repeats 3] [--json FILE]

Every state is random and has its own random contact set: 2, 3 or 4 rectangles (see tests/samplers.py). A line is a number
of rectangles and a precision. The ratios come first, states/s of the ray form over those of

    project  the face form with one projection for each state: `centroidal_cone`, then `capturability`, compiled
    LP       one linear program (25) for each state, at alpha = 0, by HiGHS; the paper's algorithm needs several

on the first `--baseline` states. `cold` are the states/s of `score` on independent states. Then the same contact sets with
trajectories of 64 states: `t.cold` without, `t.warm` with `neighbours=True`. Best of the repeats, states on the device,
waited for; `compile` is the first call less the best. `differ` counts verdicts that are not those of the projection, or of
double precision, although the margin is larger than the band: it has to be 0.

The second table counts pivots of a survey (the smallest acceleration at alpha = 0, and both ends of the static region) and
pieces of the lower boundary, cold, in double precision, for kinds of contact sets; 400 random states each.

Everything is seeded. Takes about six minutes. Needs the extras sim, data and cli, as the other benchmarks do.
"""

import argparse
import json
import os
import time
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap
from jaxcap.capturability import survey_of_lanes
from jaxcap.numerics import direction
from jaxcap.ray_polygon import ray_polygon
from reference.contacts import wrench_rays
from reference.linear_programs import line_program, solve_acceleration
from tests.samplers import random_contacts, random_state, rectangle, rotation

SEED, STEPS, DT = 3, 64, 0.002
BAND = {"float64": 1e-6, "float32": 1e-3}
"""Margins smaller than this are too close for a verdict to be compared [m/s]."""
ROWS = 640
"""Faces of a cone of the baseline, padded: compiled once."""
GRAVITY = np.array([0, 0, -9.81])


def stack(trees):
    """A tree of stacked leaves."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)


def samples(rectangles: int, count: int):
    """Contact sets (stacked), CoM positions and velocities (count, 3), and the sampler's own arrays."""
    rng = np.random.default_rng((SEED, rectangles))
    arrays = [random_contacts(rng, rectangles) for _ in range(count)]
    states = [random_state(rng, points) for points, *_ in arrays]
    coms, velocities = (np.array(x) for x in zip(*states, strict=True))
    return stack([jaxcap.ContactSet(*contacts) for contacts in arrays]), coms, velocities, arrays


def trajectories(contacts, coms, velocities):
    """The first states, each followed for STEPS steps at constant velocity."""
    first = len(coms) // STEPS
    along = (np.arange(STEPS) * DT)[:, None]
    repeated = jax.tree.map(lambda x: np.repeat(x[:first], STEPS, axis=0), contacts)
    moved = (coms[:first, None] + along * velocities[:first, None]).reshape(-1, 3)
    return repeated, moved, np.repeat(velocities[:first], STEPS, axis=0)


def best(call, repeats: int):
    """Seconds of compiling, best seconds of a call, and the answer."""
    seconds = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        answer = jax.block_until_ready(call())
        seconds.append(time.perf_counter() - start)
    return seconds[0] - min(seconds[1:]), min(seconds[1:]), answer


def ray_form(sample, dtype, repeats: int, **options):
    """Times and answers of the ray form."""
    contacts, coms, velocities = jax.tree.map(lambda x: jnp.asarray(x, dtype if x.dtype != bool else bool), sample)
    rays = jax.jit(jaxcap.cone_rays)(contacts)
    return best(lambda: jaxcap.score(rays, coms, velocities, **options), repeats)


def projection(arrays, coms, velocities, dtype):
    """Seconds a state of the face form with a projection for each, and the answers."""
    one = jax.jit(jaxcap.capturability)
    cone = lambda contacts: jaxcap.centroidal_cone(jaxcap.ContactSet(*contacts)).padded(ROWS)
    coms, velocities = coms.astype(dtype), velocities.astype(dtype)
    jax.block_until_ready(one(cone(arrays[0]), coms[0], velocities[0]))
    start = time.perf_counter()
    answers = [jax.block_until_ready(one(cone(c), x, v)) for c, x, v in zip(arrays, coms, velocities, strict=True)]
    return (time.perf_counter() - start) / len(coms), stack([jax.tree.map(np.asarray, a) for a in answers])


def linear_program(arrays, coms, velocities):
    """Seconds a state of one linear program each, its set-up included."""
    start = time.perf_counter()
    for contacts, com, velocity in zip(arrays, coms, velocities, strict=True):
        solve_acceleration(line_program(com, velocity / np.linalg.norm(velocity), wrench_rays(*contacts)), 0.0, 1)
    return (time.perf_counter() - start) / len(coms)


def line(rectangles: int, dtype: str, options) -> dict:
    """One line of the first table."""
    contacts, coms, velocities, arrays = samples(rectangles, options.states)
    compiled, seconds, answer = ray_form((contacts, coms, velocities), dtype, options.repeats)
    few = slice(options.baseline)
    projecting, faces = projection(arrays[few], coms[few], velocities[few], dtype)
    programming = linear_program(arrays[few], coms[few], velocities[few])
    moving = trajectories(contacts, coms, velocities)
    _, cold, _ = ray_form(moving, dtype, options.repeats)
    _, warm, _ = ray_form(moving, dtype, options.repeats, neighbours=True)
    double = answer if dtype == "float64" else ray_form((contacts, coms, velocities), "float64", 1)[2]
    rate, moved = options.states / seconds, len(moving[1])
    unlike = lambda a, b: int(((a.capturable != b.capturable) & ~(np.abs(b.margin) < BAND[dtype])).sum())
    return {
        "contacts": rectangles, "dtype": dtype, "x project": rate * projecting, "x LP": rate * programming,
        "cold": rate, "project": 1 / projecting, "LP": 1 / programming, "t.cold": moved / cold, "t.warm": moved / warm,
        "compile": compiled, "undecided": int((answer.status == jaxcap.Status.MAX_STEPS).sum()),
        "differ": unlike(jax.tree.map(lambda x: x[few], answer), faces) + unlike(answer, double),
    }


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
    rays = jaxcap.cone_rays(stack([jaxcap.ContactSet(*contacts) for contacts in arrays]), sides)
    rays = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), rays)
    survey = survey_of_lanes(rays, coms, velocities, GRAVITY)
    walked = jnp.where(survey.feasible, jnp.inf, 0.0)
    lower = ray_polygon(rays, coms, direction(velocities)[0], GRAVITY).knowing(survey).boundary(walked)
    pieces = jnp.sum(lower.pieces.right > lower.pieces.left, axis=0)[survey.feasible]
    spread = lambda what, x: {f"{what} {q}": float(np.percentile(x, q)) if len(x) else np.nan for q in (50, 99, 100)}
    return {"kind": name, "sides": sides} | spread("pivots", survey.near.pivots) | spread("pieces", pieces)


def table(rows: list[dict]) -> str:
    """Aligned columns."""
    show = lambda x: x if isinstance(x, str) else "-" if x != x else f"{x:,.0f}" if x >= 10 or x == int(x) else f"{x:.2f}"
    cells = [list(rows[0])] + [[show(x) for x in row.values()] for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "\n".join("  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)) for row in cells)


def main():
    """Measure, print, and save where asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", type=int, default=32768, help="states of a line; a multiple of 64")
    parser.add_argument("--baseline", type=int, default=40, help="states of the baselines")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path, help="also save all rows here")
    options = parser.parse_args()
    if options.states < STEPS or options.states % STEPS:
        parser.error(f"--states {options.states} (expected a positive multiple of {STEPS})")
    jax.config.update("jax_enable_x64", True)
    print(f"{os.cpu_count()} cores, {jax.default_backend()}, JAX {jax.__version__}; states/s and ratios, cold and warm\n")
    lines = [line(k, dtype, options) for dtype in BAND for k in (2, 3, 4)]
    print(table(lines))
    kinds = [f"{k} random rectangles" for k in (2, 3, 4)]
    counted = [*map(partial(pivots, sides=4), [*kinds, *KINDS]), *map(partial(pivots, sides=8), kinds)]
    print(f"\n{table(counted)}")
    if options.json:
        options.json.write_text(json.dumps({"lines": lines, "pivots": counted}, indent=1))


if __name__ == "__main__":
    main()
