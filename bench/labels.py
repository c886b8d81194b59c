"""Do labels depend on the solver or the time step? The same samples labelled again, and every disagreement explained.

    python -m bench.labels [--samples N] [--folder DIR] [--jobs J]     # seconds by default; --samples 500 takes hours

The first N samples of seed 2018 of the scenarios `two` and `three`, best of three controllers. `base` (DAQP, 1 ms, contacts
stabilised) is read from the campaign's file in --base where that has them; the others are computed by the campaign itself
into DIR, so that the same command resumes (bench/data/labels has 500 of each):

    proxqp     ProxQP is asked first, DAQP where it fails
    half       time step of 0.5 ms
    double     time step of 2 ms
    drift      without stabilisation of the contacts

First a table: how many labels agree, flip (a fall here, a stop there), or are undecided on one side. Then a line for each
disagreement, every run of both sides as controller:reason@step, and its reason:

    time       one side ran out of time: it was about to stop, or went on moving
    unsolved   a QP that no solver solved and no proof calls infeasible
    edge       the label of `base` itself changes if the push is scaled by 1 +- s; s is the smallest that does it of
               1e-6, 1e-5, 1e-4, 1e-3, 1e-2. The run passes close to a state where it is decided
    step       not that, but it changes with a time step of 0.99, 0.9, 0.8, 1.1 or 1.25 ms: the first that does it
    other      none of these

The last table is the control: of --control samples whose labels all agree, how many have an edge within each s, and how many
change with one of those steps. Extra: sim.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from reference.tsid import campaign
from reference.tsid.controller import CONFIGURATIONS
from reference.tsid.labels import BEST_FIRST, BEST_OF_FOUR
from reference.tsid.robot import Robot, load
from reference.tsid.sampling import draw
from reference.tsid.simulator import DEFAULT, Simulator
from reference.tsid.table import read

SEED = 2018
SCENARIOS = ("two", "three")
VARIANTS = {
    "proxqp": ["--set", "solver=proxqp"],
    "half": ["--set", "dt=0.0005"],
    "double": ["--set", "dt=0.002"],
    "drift": ["--set", "stabilisation=[0.0, 0.0]"],
}
SCALES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
STEPS = (0.99e-3, 0.9e-3, 0.8e-3, 1.1e-3, 1.25e-3)
"""[s]"""
CONTROLLERS = BEST_OF_FOUR[:3]

Row = dict[str, Any]


class Disagreement(NamedTuple):
    """A sample with two labels."""

    scenario: str
    variant: str
    index: int
    here: Row
    there: Row


def rows(scenario: str, variant: str, options: argparse.Namespace) -> list[Row]:
    """The first N rows: from a file that has them, computed otherwise."""
    path = options.folder / f"{scenario}_{variant}.parquet"
    published = options.base / f"{scenario}.parquet"
    if variant == "base" and published.is_file():
        settings, _, found = read(published)
        if len(found) >= options.samples and settings["seed"] == SEED:
            return found[: options.samples]
    if not (path.is_file() and len(read(path)[2]) >= options.samples):
        arguments = [scenario, "--samples", str(options.samples), "--seed", str(SEED), "--jobs", str(options.jobs)]
        status = campaign.main([*arguments, "-o", str(path), "--controllers", *CONTROLLERS, *VARIANTS.get(variant, [])])
        if status != 0:
            sys.exit(status)
    return read(path)[2][: options.samples]


def runs(row: Row) -> str:
    """Every run of a row: controller:reason@step."""
    return " ".join(
        f"{name}:{row[f'{name}_reason']}@step {row[f'{name}_steps']}" for name in CONTROLLERS if f"{name}_reason" in row
    )


def label(robot: Robot, scenario: str, index: int, scale: float = 1.0, dt: float = DEFAULT.dt) -> str:
    """The best of three of a sample whose push is scaled, with a time step [s]."""
    sample = draw(robot, scenario, SEED, index)
    sample = sample._replace(v=scale * sample.v)
    outcomes = []
    for name in CONTROLLERS:
        outcomes.append(Simulator(robot, CONFIGURATIONS[name], DEFAULT._replace(dt=dt)).run(sample).outcome.name.lower())
        if outcomes[-1] == "stopped":
            break
    return min(outcomes, key=BEST_FIRST.index)


def edge(robot: Robot, scenario: str, index: int, outcome: str) -> float | None:
    """The least of SCALES by which the push has to change for another label than `outcome`; None: none does."""
    for scale in SCALES:
        if any(label(robot, scenario, index, 1.0 + sign * scale) != outcome for sign in (1.0, -1.0)):
            return scale
    return None


def step(robot: Robot, scenario: str, index: int, outcome: str) -> float | None:
    """The first of STEPS with another label than `outcome` [s]; None: none has."""
    return next((dt for dt in STEPS if label(robot, scenario, index, dt=dt) != outcome), None)


def reason(robot: Robot, found: Disagreement) -> str:
    """Why the labels differ, as the module's docstring lists it."""
    sides = found.here, found.there
    reasons = {side[f"{name}_reason"] for side in sides for name in CONTROLLERS if f"{name}_reason" in side}
    this = robot, found.scenario, found.index, found.here["outcome"]
    scale = edge(*this)
    dt = step(*this) if scale is None else None
    at = f"edge {scale:.0e}" if scale is not None else f"step {1e3 * dt:.2f} ms" if dt is not None else "other"
    if "unsolved" in reasons:
        return f"unsolved, {at}"
    return f"time, {at}" if any(side["outcome"] == "undecided" for side in sides) else at


def compare(scenario: str, options: argparse.Namespace) -> Iterator[tuple[str, list[Disagreement], Counter]]:
    """For each variant: its name, the disagreements and the counts of agreement."""
    base = rows(scenario, "base", options)
    for variant in options.variants:
        counts: Counter[str] = Counter()
        found = []
        for here, there in zip(base, rows(scenario, variant, options), strict=True):
            if "error" in here or "error" in there:
                counts["errors"] += 1
                continue
            pair = {here["outcome"], there["outcome"]}
            kind = "agree" if len(pair) == 1 else "one undecided" if "undecided" in pair else "flip"
            counts[kind] += 1
            if kind != "agree":
                found.append(Disagreement(scenario, variant, here["index"], here, there))
        yield variant, found, counts


def main(arguments: list[str] | None = None) -> None:
    """Parse, label, compare, explain."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.labels", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=2, metavar="N", help="(default: 2)")
    parser.add_argument("--folder", type=Path, help="where labels are kept (default: a temporary folder)")
    parser.add_argument("--base", type=Path, default=Path("reference/tsid/data"), help="(default: reference/tsid/data)")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="processes (default: 1)")
    parser.add_argument("--scenarios", nargs="+", choices=SCENARIOS, default=list(SCENARIOS), metavar="SCENARIO")
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(VARIANTS), metavar="VARIANT")
    parser.add_argument("--control", type=int, default=0, metavar="K", help="agreeing samples that are nudged (default: 0)")
    options = parser.parse_args(arguments)
    if options.samples < 1:
        parser.error(f"--samples {options.samples} (expected at least 1)")
    with tempfile.TemporaryDirectory() as temporary:
        options.folder = options.folder or Path(temporary)
        options.folder.mkdir(parents=True, exist_ok=True)
        _report(options)


def _report(options: argparse.Namespace) -> None:
    robot = load("talos")
    kinds = ("agree", "flip", "one undecided", "errors")
    table, found = [], []
    for scenario in options.scenarios:
        for variant, differ, counts in compare(scenario, options):
            found += differ
            table.append(f"{scenario:10}{variant:10}" + "".join(f"{counts[kind]:15}" for kind in kinds))
    print(f"\n{'scenario':10}{'variant':10}" + "".join(f"{kind:>15}" for kind in kinds), *table, sep="\n")
    print("\nscenario variant index: base -> variant, reason | runs of base | runs of variant")
    for one in found:
        change = f"{one.here['outcome']} -> {one.there['outcome']}"
        why = reason(robot, one)
        print(
            f"{one.scenario} {one.variant} {one.index}: {change}, {why} | {runs(one.here)} | {runs(one.there)}", flush=True
        )
    for scenario in options.scenarios if options.control else ():
        differ = {one.index for one in found if one.scenario == scenario}
        agreeing = [row for row in rows(scenario, "base", options) if row["index"] not in differ and "error" not in row]
        edges = [edge(robot, scenario, row["index"], row["outcome"]) for row in agreeing[: options.control]]
        shares = ", ".join(f"{scale:.0e}: {sum(at is not None and at <= scale for at in edges)}" for scale in SCALES)
        steps = sum(step(robot, scenario, row["index"], row["outcome"]) is not None for row in agreeing[: options.control])
        print(f"control, {scenario}: of {len(edges)} samples that agree, edges by s {shares}; steps: {steps}", flush=True)


if __name__ == "__main__":
    main()
