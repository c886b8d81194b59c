"""What the robot's limits add to the margin, against the simulated outcomes: `python -m bench.limits_truth`.

For each scenario the margins of the point mass, with the state's own angular momentum, with a budget for its rate (the box),
and with the torque limits of the robot's joints and the effort of holding the posture; falls detected and false alarms at
zero, and the area under the ROC, in percent with intervals of 95 %; and the falls detected where the threshold is moved to
as many false alarms as GOALS says (bootstrap). The one number that was chosen is the box, by a prototype that saw the first
1,000 rows of each file: these are left out unless `--skip 0`. All postures count, also those that cannot be held: that they
cannot is what the limits are to say.

--trees: and what can be known at all, roughly: gradient-boosted trees on the posture, all velocities, angular momentum,
contacts, effort and all margins above, by FOLDS-fold cross-validation on the same rows. Their score is shown as a margin;
zero is even odds. Needs the extra evaluation.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any, NamedTuple

import jax
import numpy as np
import pinocchio as pin
from jaxtyping import Float

import jaxcap
from bench.limited import Limited, limited
from bench.limits import DATA
from reference.evaluation.roc import Interval, area, band, curve, detection_at, judged, point, share
from reference.evaluation.samples import BEST, FOUR, Samples, read
from reference.tsid.robot import load

SCENARIOS = ("two_coplanar", "two", "three", "four")
BOX = 10.0
"""What the rate of angular momentum may differ by [N m]."""
GOALS = {"two_coplanar": 0.05, "two": 0.05, "three": 0.03, "four": 0.01}
"""Shares of false alarms at which detection is asked for."""
FOLDS, SEED = 5, 2018
"""Of the trees' cross-validation."""
ROUNDS = 300
"""Trees, one after the other."""


class Variant(NamedTuple):
    """A margin, by what it knows of the robot."""

    label: str
    momentum: bool
    torques: bool
    box: float
    """[N m]"""


VARIANTS = (
    Variant("point mass", False, False, 0.0),
    Variant("+ angular momentum", True, False, 0.0),
    Variant("+ angular momentum, box", True, False, BOX),
    Variant("+ torques", False, True, 0.0),
    Variant("+ torques, angular momentum", True, True, 0.0),
    Variant("+ torques, angular momentum, box", True, True, BOX),
)


def margins(states: Limited, momenta: Float[np.ndarray, "n 3"], mass: float, variant: Variant) -> Float[np.ndarray, " n"]:
    """The margins of states with these angular momenta [kg m^2/s], in m/s; NaN where undecided, infinite at rest."""
    found = jaxcap.score(
        jaxcap.cone_rays(states.contacts),
        states.coms,
        states.velocities,
        specific_angular_momentum=momenta / mass if variant.momentum else None,
        actuation=states.actuation if variant.torques else None,
        momentum_box=variant.box / mass,
    )
    found = jax.tree.map(np.asarray, found)
    at_rest = found.status == jaxcap.Status.NO_DIRECTION
    return np.where(at_rest, np.where(found.capturable, np.inf, -np.inf), found.margin)


def _from(samples: Samples, index: int) -> Samples:
    """The samples from this number on that hold their postures, without what single controllers did."""
    keep = (samples.index >= index) & np.isfinite(samples.q).all(axis=1)
    arrays: dict[str, Any] = {name: x[keep] for name, x in samples._asdict().items() if isinstance(x, np.ndarray)}
    contacts: Any = type(samples.contacts)(*(field[keep] for field in samples.contacts))
    outcomes = {name: words[keep] for name, words in samples.outcomes.items()}
    return samples._replace(**arrays, contacts=contacts, outcomes=outcomes, runs={})


def trees(samples: Samples, known: Float[np.ndarray, "n k"], truth: str) -> Float[np.ndarray, " n"]:
    """What boosted trees say of each sample that they have not seen, as a margin; NaN where its outcome is undecided.

    known: the margins [m/s].
    """
    from sklearn.ensemble import HistGradientBoostingClassifier
    from sklearn.model_selection import StratifiedKFold, cross_val_predict

    n, contacts = len(samples.com), samples.contacts
    numbers = (contacts.positions, contacts.rotations, contacts.friction)
    state = (samples.q, samples.v, samples.com, samples.com_velocity, samples.angular_momentum, samples.effort[:, None])
    features = np.concatenate([*state, *(x.reshape(n, -1) for x in numbers), np.clip(known, -1e3, 1e3)], axis=1)
    used, fell = judged(samples.outcomes[truth])
    learner = HistGradientBoostingClassifier(max_iter=ROUNDS, learning_rate=0.05, random_state=SEED)
    folds = StratifiedKFold(FOLDS, shuffle=True, random_state=SEED)
    found = np.full(n, np.nan)
    found[used] = -cross_val_predict(learner, features[used], fell, cv=folds, method="decision_function")
    return found


def line(samples: Samples, values: Float[np.ndarray, " n"], truth: str) -> list[str]:
    """Cells of the table: detection, false alarms, area, detection at GOALS."""
    known = ~np.isnan(values)
    used, fell = judged(samples.outcomes[truth], among=known)
    cells = point(values[used], fell)
    shares = share(cells.detected, cells.detected + cells.missed), share(cells.false, int((~fell).sum()))
    goal = np.array([GOALS.get(samples.name, 0.05)])
    there = detection_at(curve(values[used], fell), goal)[0]
    low, high = band(values[used], fell, goal)[:, 0]
    at_goal = f"{_percent(Interval(there, low, high))} at {100 * goal[0]:.0f} %"
    return [*map(_percent, shares), _percent(area(values[used], fell)), at_goal, str(int((~known).sum()))]


def _percent(figure: Interval) -> str:
    return f"{100 * figure.value:.1f} ({100 * figure.low:.1f} to {100 * figure.high:.1f})"


def _say(scenario: str, label: str, cells: list[str], start: float) -> None:
    """A line of the table, and how long it took."""
    print(f"| {scenario} | {label} | " + " | ".join(cells) + " |", flush=True)
    print(f"{scenario}, {label}: {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)


def main() -> None:
    """Scores and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS, metavar="NAME")
    parser.add_argument("--skip", type=int, default=1000, metavar="N", help="rows left out (default: 1000)")
    parser.add_argument("--first", type=int, metavar="N", help="rows of each file that are read (default: all)")
    parser.add_argument("--trees", action="store_true", help="and boosted trees, cross-validated")
    parser.add_argument("--truth", choices=[BEST, FOUR], default=FOUR, help="(default: %(default)s)")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    print("| scenario | margin | falls detected | false alarms | area under the ROC | detected at a share | undecided |")
    print("| --- | --- | --- | --- | --- | --- | --- |", flush=True)
    for scenario in options.scenarios:
        samples = _from(read(DATA / f"{scenario}.parquet", options.first), options.skip)
        mass = pin.computeTotalMass(load(samples.robot).model)
        # On TALOS legs never bind: with a hand, rows of the arms alone give the same verdicts in a third of the time.
        hands = any("hand" in str(name) for name in samples.contacts.effectors[0])
        states = limited(samples, "arms" if hands else "all")
        known = []
        for variant in VARIANTS:
            start = time.monotonic()
            known.append(margins(states, samples.angular_momentum, mass, variant))
            _say(scenario, variant.label, line(samples, known[-1], options.truth), start)
        if options.trees:
            start = time.monotonic()
            found = trees(samples, np.stack(known, axis=1), options.truth)
            _say(scenario, "boosted trees", line(samples, found, options.truth), start)


if __name__ == "__main__":
    main()
