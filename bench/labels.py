"""Do labels depend on the solver or the time step? The same samples labelled again, and every disagreement explained.

    python -m bench.labels [--samples N] [--folder DIR] [--jobs J]     # seconds by default; --samples 1000 takes hours

The first N samples of seed 2018 of the scenarios `two_coplanar`, `two`, `three` and `four`. `base` (DAQP, 1 ms, contacts
stabilised) is read from the campaign's file in --base where that has them; the others are computed by the campaign itself
into DIR, so that the same command resumes (bench/data/labels has those of the data's card):

    proxqp     ProxQP is asked first, DAQP where it fails
    half       time step of 0.5 ms
    double     time step of 2 ms
    drift      without stabilisation of the contacts

First a table, of the best of three controllers and of the best of four: how many labels agree, flip (a fall here, a stop
there), or are undecided on one side, and the share of those that do not agree, with Wilson's interval of 95 %. Then, if
--explain says of which of the two, a line for each disagreement, every run of both sides as controller:reason@step, and its
reason:

    time       one side ran out of time: it was about to stop, or went on moving
    unsolved   a QP that no solver solved and no proof calls infeasible
    edge       the label of `base` itself changes if the push is scaled by 1 +- s; s is the last of 1e-2, 1e-3, 1e-4, 1e-5,
               1e-6 that still does it. The run passes close to a state where it is decided
    step       not that, but it changes with a time step of 0.99, 0.9, 0.8, 1.1 or 1.25 ms: the first that does it
    other      none of these

and, after these, the control: of --control samples whose labels all agree, how many have an edge within each s, and how many
change with one of those steps. Extras: sim, evaluation.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from reference.evaluation.roc import share
from reference.tsid import campaign
from reference.tsid.controller import CONFIGURATIONS
from reference.tsid.labels import BEST_FIRST, BEST_OF_FOUR
from reference.tsid.robot import Robot, load
from reference.tsid.sampling import draw
from reference.tsid.simulator import DEFAULT, Simulator
from reference.tsid.table import read

SEED = 2018
SCENARIOS = ("two_coplanar", "two", "three", "four")
VARIANTS = {
    "proxqp": ["--set", "solver=proxqp"],
    "half": ["--set", "dt=0.0005"],
    "double": ["--set", "dt=0.002"],
    "drift": ["--set", "stabilisation=[0.0, 0.0]"],
}
SCALES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
STEPS = (0.99e-3, 0.9e-3, 0.8e-3, 1.1e-3, 1.25e-3)
"""[s]"""
TRUTHS = {3: "outcome", 4: "best_of_four"}
"""Columns of the labels, by the number of controllers of which they are the best."""
KINDS = ("agree", "flip", "one undecided", "errors")

Row = dict[str, Any]


class Disagreement(NamedTuple):
    """A sample with two labels."""

    truth: int
    """Number of controllers."""
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
        status = campaign.main([*arguments, "-o", str(path), "--states", "0", *VARIANTS.get(variant, [])])
        if status != 0:
            sys.exit(status)
    return read(path)[2][: options.samples]


def runs(row: Row, truth: int) -> str:
    """The runs of a row that a label is the best of: controller:reason@step."""
    names = [name for name in BEST_OF_FOUR[:truth] if f"{name}_reason" in row]
    return " ".join(f"{name}:{row[f'{name}_reason']}@step {row[f'{name}_steps']}" for name in names)


class Asked(NamedTuple):
    """A sample, and of how many controllers the best is wanted."""

    robot: Robot
    scenario: str
    index: int
    truth: int


def label(asked: Asked, scale: float = 1.0, dt: float = DEFAULT.dt) -> str:
    """The best of the controllers on a sample whose push is scaled, with a time step [s]."""
    sample = draw(asked.robot, asked.scenario, SEED, asked.index)
    sample = sample._replace(v=scale * sample.v)
    outcomes = []
    for name in BEST_OF_FOUR[: asked.truth]:
        run = Simulator(asked.robot, CONFIGURATIONS[name], DEFAULT._replace(dt=dt)).run(sample)
        outcomes.append(run.outcome.name.lower())
        if outcomes[-1] == "stopped":
            break
    return min(outcomes, key=BEST_FIRST.index)


def edge(asked: Asked, outcome: str) -> float | None:
    """The last of SCALES by which the push may change for another label than `outcome`; None: the first is not enough."""
    changes = lambda scale: any(label(asked, 1.0 + sign * scale) != outcome for sign in (1.0, -1.0))
    return min(itertools.takewhile(changes, SCALES), default=None)


def step(asked: Asked, outcome: str) -> float | None:
    """The first of STEPS with another label than `outcome` [s]; None: none has."""
    return next((dt for dt in STEPS if label(asked, dt=dt) != outcome), None)


def reason(robot: Robot, found: Disagreement) -> str:
    """Why the labels differ, as the module's docstring lists it."""
    sides, column = (found.here, found.there), TRUTHS[found.truth]
    names = [f"{name}_reason" for name in BEST_OF_FOUR[: found.truth]]
    reasons = {side[name] for side in sides for name in names if name in side}
    asked, outcome = Asked(robot, found.scenario, found.index, found.truth), found.here[column]
    scale = edge(asked, outcome)
    dt = step(asked, outcome) if scale is None else None
    at = f"edge {scale:.0e}" if scale is not None else f"step {1e3 * dt:.2f} ms" if dt is not None else "other"
    if "unsolved" in reasons:
        return f"unsolved, {at}"
    return f"time, {at}" if any(side[column] == "undecided" for side in sides) else at


class Compared(NamedTuple):
    """A variant of a scenario beside its base."""

    scenario: str
    variant: str
    truth: int
    """Number of controllers."""
    counts: Counter[str]
    """Of KINDS."""
    differ: list[Disagreement]

    def line(self) -> str:
        """Of the table."""
        number = sum(self.counts[kind] for kind in KINDS[:3])
        apart = share(number - self.counts["agree"], number)
        shares = "".join(f"{100 * value:9.1f}" for value in apart)
        counts = "".join(f"{self.counts[kind]:15}" for kind in KINDS)
        return f"{self.scenario:14}{self.variant:10}best of {self.truth}{counts}{shares}"


def compare(scenario: str, options: argparse.Namespace) -> Iterator[Compared]:
    """Every variant, for each of the labels that both sides have."""
    base = rows(scenario, "base", options)
    for variant in options.variants:
        other = rows(scenario, variant, options)
        for truth, column in TRUTHS.items():
            if any(column in row for row in other):  # files of three controllers have no fourth
                yield _compare(scenario, variant, truth, list(zip(base, other, strict=True)))


def _compare(scenario: str, variant: str, truth: int, pairs: list[tuple[Row, Row]]) -> Compared:
    counts: Counter[str] = Counter()
    found = []
    for here, there in pairs:
        if "error" in here or "error" in there:
            counts["errors"] += 1
            continue
        pair = {here[TRUTHS[truth]], there[TRUTHS[truth]]}
        kind = "agree" if len(pair) == 1 else "one undecided" if "undecided" in pair else "flip"
        counts[kind] += 1
        if kind != "agree":
            found.append(Disagreement(truth, scenario, variant, here["index"], here, there))
    return Compared(scenario, variant, truth, counts, found)


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
    parser.add_argument("--explain", type=int, choices=list(TRUTHS), metavar="K", help="disagreements of the best of K")
    parser.add_argument("--control", type=int, default=0, metavar="K", help="agreeing samples that are nudged (default: 0)")
    options = parser.parse_args(arguments)
    if options.samples < 1:
        parser.error(f"--samples {options.samples} (expected at least 1)")
    with tempfile.TemporaryDirectory() as temporary:
        options.folder = options.folder or Path(temporary)
        options.folder.mkdir(parents=True, exist_ok=True)
        _report(options)


def _report(options: argparse.Namespace) -> None:
    found = [one for scenario in options.scenarios for one in compare(scenario, options)]
    shares = "".join(f"{word:>9}" for word in ("apart %", "from", "to"))
    counts = "".join(f"{kind:>15}" for kind in KINDS)
    print(
        f"\n{'scenario':14}{'variant':10}{'label':9}{counts}{shares}", *(one.line() for one in found), sep="\n", flush=True
    )
    if options.explain is None:
        return
    robot = load("talos")
    column = TRUTHS[options.explain]
    print("\nscenario variant index: base -> variant, reason | runs of base | runs of variant")
    differ = [one for compared in found if compared.truth == options.explain for one in compared.differ]
    for one in differ:
        change = f"{one.here[column]} -> {one.there[column]}, {reason(robot, one)}"
        both = " | ".join(runs(side, one.truth) for side in (one.here, one.there))
        print(f"{one.scenario} {one.variant} {one.index}: {change} | {both}", flush=True)
    for scenario in options.scenarios if options.control else ():
        apart = {one.index for one in differ if one.scenario == scenario}
        agreeing = [row for row in rows(scenario, "base", options) if row["index"] not in apart and "error" not in row]
        asked = [(Asked(robot, scenario, row["index"], options.explain), row[column]) for row in agreeing[: options.control]]
        edges = [edge(*one) for one in asked]
        within = ", ".join(f"{scale:.0e}: {sum(at is not None and at <= scale for at in edges)}" for scale in SCALES)
        steps = sum(step(*one) is not None for one in asked)
        print(f"control, {scenario}: of {len(edges)} samples that agree, edges by s {within}; steps: {steps}", flush=True)


if __name__ == "__main__":
    main()
