"""How fast is `jaxcap.score`? A table over contact sets, with two baselines that are measured in the same run.

    python -m bench.throughput [--batch 100000] [--repeats 5] [--dtype float32] [--json FILE]

How to read it. One line is one contact set and `--batch` states on it. The two ratios come first: `score`'s states/s
over those of

    vmap     jax.jit(jax.vmap(jaxcap.capturability)), what a user would write first, on the same states
    paper    the paper's own algorithm in `reference/` (NumPy and ProxQP, float64, one state at a time), on the first
             `--paper-states` of them

Ratios survive a busy or a faster machine; states/s do not, so compare those only within a run. `best` and `median` are
over the repeats, each waited for to its end, states already on the device; the ratios are of the best. `compile` is the
first call less the best. `faces` are the rows of the cone, and cost is about proportional to them.

A second table says what the states were: the share that is capturable and the share of each case. A batch that is
nearly all EMPTY or C2 is decided before any walk and measures nothing. `differ` counts the states where `score` and the
paper disagree although the margin is larger than the band: it has to be 0. All of it takes about five minutes. The sets are

    coplanar feet, tilted feet         two soles; CoM over their bounding box and 0.05 m around, 0.7 to 1 m up
    the stances in bench/data          their real states, repeated up to the batch
    3 and 4 random rectangles          centres in [-0.5, 0.5] x [-0.5, 0.5] x [0, 0.5] m, roll and pitch within
                                       2 atan(mu); CoM up to 1.5 m above

with velocities uniform in [-1, 1]^3 m/s except for the real states. Everything is seeded. Needs the extras data, cli
and, unless --paper-states 0, sim.
"""

import argparse
import json
import os
import statistics
import time
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq

import jaxcap
from jaxcap.contact_files import read_contacts
from tests.samplers import random_contacts, rotation

DATA = Path(__file__).parent / "data"
STANCES = ("talos_two_feet", "talos_hand_on_wall", "talos_slopes_and_rail")
SEED = 0
"""Of the random contacts and states; with it the random rectangles have somewhere to stand."""
GOAL = 300_000
"""States/s that two CPU cores have to reach with two feet, float32, in a batch of `GOAL_BATCH`."""
GOAL_BATCH = 100_000
BAND = {"float32": 1e-3, "float64": 1e-6}
"""Margins smaller than this are too close for a verdict to be compared [m/s]."""
CASES = {
    "C1": ("C1",), "C2": ("C2",), "C3.1": ("C3_1",), "C3.2": ("C3_2_1", "C3_2_2"), "C3.3": ("C3_3",), "EMPTY": ("EMPTY",)
}
"""Columns of the second table."""


class Batch(NamedTuple):
    """A contact set and states on it."""

    name: str
    contacts: jaxcap.ContactSet
    coms: np.ndarray
    """(n, 3) [m]"""
    com_velocities: np.ndarray
    """(n, 3) [m/s]"""


class Timing(NamedTuple):
    """Seconds that one call takes."""

    first: float
    """With compiling."""
    best: float
    median: float


def feet(*placements) -> jaxcap.ContactSet:
    """Soles of 0.21 x 0.13 m, friction 0.5; a placement is the position [m] and roll, pitch, yaw [rad] of one."""
    first, *others = (jaxcap.rectangle(p, rotation(*angles), 0.105, 0.065, 0.5) for p, angles in placements)
    return sum(others, start=first)


def random_batch(name: str, contacts: jaxcap.ContactSet, n: int, lowest: float, highest: float) -> Batch:
    """States with the CoM over the contacts' bounding box and 0.05 m around, lowest to highest above it [m]."""
    rng = np.random.default_rng(SEED)
    low, high = contacts.points.min(axis=0), contacts.points.max(axis=0)
    coms = rng.uniform(low + np.array([-0.05, -0.05, lowest]), high + np.array([0.05, 0.05, highest]), (n, 3))
    return Batch(name, contacts, coms, rng.uniform(-1, 1, (n, 3)))


def stance_batch(name: str, n: int) -> Batch:
    """The states of a shipped stance, repeated until there are n."""
    table = pq.read_table(DATA / f"{name}.parquet", columns=["com", "com_velocity"])
    coms, velocities = (np.resize(np.stack(table[column].to_numpy()), (n, 3)) for column in table.column_names)
    return Batch(name.replace("_", " "), read_contacts(DATA / f"{name}.yaml"), coms, velocities)


def batches(n: int) -> list[Batch]:
    """All that is measured, n states each."""
    flat = feet(((0, 0.1, 0), (0, 0, 0)), ((0, -0.1, 0), (0, 0, 0)))
    tilted = feet(((0, 0.15, 0), (0.25, 0, 0)), ((0.3, -0.15, 0.2), (0, -0.25, 0)))
    rectangles = {k: jaxcap.ContactSet(*random_contacts(np.random.default_rng(SEED), k)) for k in (3, 4)}
    return [
        random_batch("coplanar feet", flat, n, 0.7, 1.0),
        random_batch("tilted feet", tilted, n, 0.7, 1.0),
        *(stance_batch(name, n) for name in STANCES),
        *(random_batch(f"{k} random rectangles", contacts, n, 0.0, 1.5) for k, contacts in rectangles.items()),
    ]


def timed(call, repeats: int) -> tuple[Timing, jaxcap.Capturability]:
    """Times of `call()`, which is waited for, and what it returns. Compiles anew."""
    jax.clear_caches()
    seconds = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        out = jax.block_until_ready(call())
        seconds.append(time.perf_counter() - start)
    return Timing(seconds[0], min(seconds[1:]), statistics.median(seconds[1:])), out


def paper(batch: Batch, n: int, sides: int) -> tuple[float, list[bool | None]]:
    """States/s of the paper's algorithm on the first n states, and its verdicts: None where it has none."""
    from reference.algorithm import is_state_capturable
    from reference.contacts import wrench_rays

    contacts = batch.contacts
    wrenches = wrench_rays(contacts.points, contacts.frames, contacts.friction, sides)
    verdicts = []
    start = time.perf_counter()
    for com, velocity in zip(batch.coms[:n], batch.com_velocities[:n], strict=True):
        try:
            result = is_state_capturable(None, None, None, com, velocity, sides=sides, wrenches=wrenches)
            verdicts.append(result.capturable)
        except ArithmeticError:
            verdicts.append(None)
    return len(verdicts) / (time.perf_counter() - start), verdicts


def measure(batch: Batch, options) -> dict:
    """One line of the tables."""
    cone = jaxcap.centroidal_cone(batch.contacts, sides=options.sides)
    states = [jnp.asarray(x, options.dtype) for x in (batch.coms, batch.com_velocities)]
    n = len(batch.coms)
    ours, out = timed(lambda: jaxcap.score(cone, *states), options.repeats)
    plain = jax.jit(jax.vmap(jaxcap.capturability, in_axes=(None, 0, 0)))
    vmap, _ = timed(lambda: plain(cone, *states), options.repeats)
    case = np.asarray(out.case)
    line = {
        "contacts": batch.name,
        "states_per_second_best": n / ours.best,
        "states_per_second_median": n / ours.median,
        "vmap_states_per_second_best": n / vmap.best,
        "ratio_to_vmap": vmap.best / ours.best,
        "compile_seconds": ours.first - ours.best,
        "vmap_compile_seconds": vmap.first - vmap.best,
        "faces": len(cone.faces),
        "sides": options.sides,
        "capturable": float(np.mean(out.capturable)),
        "cases": {name: float(np.isin(case, [jaxcap.Case[c] for c in cases]).mean()) for name, cases in CASES.items()},
        "not_ok": int(np.sum(np.asarray(out.status) != jaxcap.Status.OK)),
    }
    if options.paper_states:
        rate, verdicts = paper(batch, options.paper_states, options.sides)
        pairs = zip(verdicts, np.asarray(out.capturable), np.asarray(out.margin), strict=False)
        differ = sum(a is not None and a != b and abs(m) > BAND[options.dtype] for a, b, m in pairs)
        line |= {"paper_states_per_second": rate, "ratio_to_paper": n / ours.best / rate, "differ": int(differ)}
    return line


TIMES = (
    f"{'contacts':22}{'x vmap':>8}{'x paper':>9}"
    f"{'best':>11}{'median':>11}{'vmap':>11}{'paper':>7}{'compile':>9}{'faces':>7}"
)
STATES = f"{'contacts':22}{'capturable':>11}" + "".join(f"{name:>7}" for name in CASES) + f"{'not ok':>8}{'differ':>8}"


def times(line: dict) -> str:
    """A line of the first table."""
    ratio, rate = line.get("ratio_to_paper"), line.get("paper_states_per_second")
    return (
        f"{line['contacts']:22}{line['ratio_to_vmap']:8.1f}{f'{ratio:,.0f}' if ratio else '-':>9}"
        f"{line['states_per_second_best']:11,.0f}{line['states_per_second_median']:11,.0f}"
        f"{line['vmap_states_per_second_best']:11,.0f}{f'{rate:.0f}' if rate else '-':>7}"
        f"{line['compile_seconds']:8.1f}s{line['faces']:7}"
    )


def states(line: dict) -> str:
    """A line of the second table."""
    shares = "".join(f"{share:7.1%}" for share in line["cases"].values())
    return f"{line['contacts']:22}{line['capturable']:11.1%}{shares}{line['not_ok']:8}{line.get('differ', '-'):>8}"


def goal(line: dict, about: dict) -> str:
    """Whether the issue's figure holds, for a set of two feet."""
    best, median = line["states_per_second_best"], line["states_per_second_median"]
    kept = "holds" if median >= GOAL else "holds for the best repeat only" if best >= GOAL else "does NOT hold"
    where = f"{about['cores']} cores of {about['device']}"
    return f"goal, >= {GOAL:,} states/s, {line['contacts']}: {kept} (median {median:,.0f}, best {best:,.0f}; {where})"


def parse(arguments=None):
    """The options."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.throughput", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--batch", type=int, default=GOAL_BATCH, help=f"states in a call (default: {GOAL_BATCH})")
    parser.add_argument("--repeats", type=int, default=5, help="timed calls after the first (default: 5)")
    parser.add_argument("--dtype", choices=list(BAND), default="float32", help="(default: float32)")
    parser.add_argument("--sides", type=int, default=4, help="edges of a friction pyramid (default: 4)")
    parser.add_argument("--paper-states", type=int, default=200, help="states for the paper's algorithm (default: 200)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures to this file as well")
    options = parser.parse_args(arguments)
    if options.batch < 1 or options.repeats < 1 or options.sides < 3 or options.paper_states < 0:
        parser.error("expected --batch and --repeats of at least 1, --sides of at least 3, --paper-states of at least 0")
    return options


def main(arguments=None) -> None:
    """Parse, measure, print."""
    options = parse(arguments)
    jax.config.update("jax_enable_x64", options.dtype == "float64")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    about = {"jaxcap": jaxcap.__version__, "jax": jax.__version__, "device": jax.devices()[0].device_kind, "cores": cores}
    about |= {"batch": options.batch, "dtype": options.dtype, "repeats": options.repeats, "sides": options.sides}
    print(", ".join(f"{key} {value}" for key, value in about.items()), end="\n\n")
    print(TIMES)
    lines = []
    for batch in batches(options.batch):
        lines.append(measure(batch, options))
        print(times(lines[-1]), flush=True)
    print(f"best, median, vmap, paper: states/s\n\n{STATES}", *map(states, lines), sep="\n", end="\n\n")
    if (options.batch, options.dtype, options.sides) == (GOAL_BATCH, "float32", 4):
        print(*(goal(line, about) for line in lines if "feet" in line["contacts"]), sep="\n")
    else:
        print(f"goal, >= {GOAL:,} states/s with two feet: judged at --batch {GOAL_BATCH} --dtype float32 --sides 4 only")
    if options.json:
        options.json.write_text(json.dumps({**about, "results": lines}, indent=1) + "\n")


if __name__ == "__main__":
    main()
