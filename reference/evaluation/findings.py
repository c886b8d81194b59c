"""What is to be said about the tables, in Markdown. Every number is computed here; reasons are those of the data's card."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from reference.evaluation.margins import MARGINS, compared, everywhere
from reference.evaluation.paper import LOST_WITHOUT_LIMITS, STATED
from reference.evaluation.roc import Interval, areas, difference, judged, point
from reference.evaluation.roc_figures import CONTROLLERS, TITLES
from reference.evaluation.samples import BEST, Samples, among
from reference.evaluation.tables import HEIGHTS, percent

SIGNIFICANT = 0.05
"""Differences less probable than this by chance are told as such."""


def data(samples: dict[str, Samples], folder: Path) -> str:
    """What was read."""
    files = (f"`{file.name}` ({len(file.index):,} samples, seed {file.seed})" for file in samples.values())
    return (
        f"The predictor (`jaxcap score`, double precision) against the outcomes of the campaign's files: {_listed(files)}. "
        "Detection is the share of falls with a margin below the threshold, false alarms the share of stops; undecided "
        "outcomes are in neither and are counted. Intervals of shares are Wilson's, of areas and their differences "
        "DeLong's, bands a stratified bootstrap's, all of 95 %. The paper's numbers are those of its text, for HRP-2."
    )


def differences(samples: dict[str, Samples], folder: Path) -> str:
    """Why ours differ: robot, sampling, solver."""
    told = []
    for file in among(samples, *TITLES):
        name = BEST if (file.name, BEST) in STATED else file.controllers[0]
        stated = STATED.get((file.name, name))
        used, fell = judged(file.outcomes[name])
        margin = compared(file, folder)["margin"][used]
        at = point(margin, fell)
        detection, alarms = (None, None) if stated is None else stated
        told.append(
            f"**{TITLES[file.scenario].capitalize()}**, {name}: detection {_against(at.detection, detection)}, "
            f"false alarms {_against(at.false_alarms, alarms)}. {_falls(file, used, fell, margin < 0)}"
        )
    told.append(
        "Robot: TALOS, whose arms bear 3 to 45 N m at the shoulders, elbows and wrists, where HRP-2 has more than 50 but "
        "for the wrists (card). Sampling: V-B names its rules, not their distributions, and detection and false alarms at "
        "margin zero depend on them. Solver: a fall needs a contact that slipped or a proof that the controller's QP has "
        "no solution, and runs that neither stop nor fall in time are undecided, where the paper has two outcomes."
    )
    return "\n\n".join(told)


def _falls(
    file: Samples, used: Bool[np.ndarray, " n"], fell: Bool[np.ndarray, " m"], predicted: Bool[np.ndarray, " m"]
) -> str:
    """How falls that were missed differ from those that were detected, and false alarms from other stops."""
    first = file.runs[file.controllers[0]].times[used]
    speed = np.linalg.norm(file.com_velocity, axis=1)[used]
    momentum = np.linalg.norm(file.angular_momentum, axis=1)[used]
    missed, detected, false, right = fell & ~predicted, fell & predicted, ~fell & predicted, ~fell & ~predicted
    sentences = []
    if missed.any() and detected.any():
        at_once = [f"{100 * np.mean(first[group] == 0):.0f} %" for group in (missed, detected)]
        sentences.append(
            f"Of the {missed.sum()} missed falls {at_once[0]} happen at the first step of the first controller (of the "
            f"{detected.sum()} detected ones {at_once[1]}); their median CoM speed is {np.median(speed[missed]):.2f} m/s "
            f"({np.median(speed[detected]):.2f} m/s of the detected ones)."
        )
    if false.any() and right.any():
        sentences.append(
            f"The {false.sum()} false alarms have a median angular momentum of {np.median(momentum[false]):.0f} kg m^2/s, "
            f"other stops {np.median(momentum[right]):.0f}."
        )
    return " ".join(sentences)


def order(samples: dict[str, Samples], folder: Path) -> str:
    """The order of the margins. V-C: on coplanar feet about equal, elsewhere exact, then support polygon, then hull."""
    told = []
    for file in among(samples, *TITLES):
        margins = compared(file, folder)
        used, fell = judged(file.outcomes[BEST], among=everywhere(margins))
        values = {margin.label: margins[margin.column][used] for margin in MARGINS}
        found = areas(np.stack(list(values.values())), fell).values
        ranking = sorted(zip(found, values, strict=True), reverse=True)
        ranked = ", ".join(f"{label} {100 * value:.1f} %" for value, label in ranking)
        names = [MARGINS[place].label for place in (0, 2, 3)]
        said = [_pair(one, other, values, fell) for one, other in pairwise(names)]
        said.append(_at_zero_and_above(values, names[:2], fell))
        told.append(f"- {TITLES[file.name]}: {ranked}. {' '.join(said)}".rstrip())
    return "\n".join(told)


def _at_zero_and_above(values: dict[str, np.ndarray], names: list[str], fell: Bool[np.ndarray, " m"]) -> str:
    """Where the first of two margins loses, if it does: at margin zero, or among what it calls capturable."""
    one, other = (values[name] for name in names)
    found = difference(one, other, fell)
    capturable = one >= 0
    if not (found.p < SIGNIFICANT and found.interval.value < 0 and fell[capturable].any()):
        return ""
    stars = [point(margin, fell) for margin in (one, other)]
    at_zero = (f"{100 * at.detection.value:.1f} % of the falls at {100 * at.false_alarms.value:.1f} %" for at in stars)
    above = areas(np.stack([one, other])[:, capturable], fell[capturable]).values
    return (
        f"At margin zero, {' and '.join(names)} detect {' and '.join(at_zero)} of false alarms; among the states that the "
        f"first calls capturable their areas are {100 * above[0]:.1f} and {100 * above[1]:.1f} %."
    )


def reason_of_the_order(samples: dict[str, Samples], folder: Path) -> str:
    """Whether the order of exact margin and support polygon is that of the robot's limits."""
    told = []
    for file in among(samples, "two_ablations", "three_ablations"):
        margins = compared(file, folder)
        found = {}
        for name in ("standard", "no_position_torque"):
            if name in file.outcomes:
                used, fell = judged(file.outcomes[name], among=everywhere(margins))
                values = {margin.label: margins[margin.column][used] for margin in MARGINS}
                one, other = (MARGINS[place].label for place in (0, 2))
                shares = (100 * value for value in areas(np.stack([values[one], values[other]]), fell).values)
                found[name] = "{:.1f} and {:.1f} %. {}".format(*shares, _pair(one, other, values, fell))
        told += [f"- `{file.name}`, {CONTROLLERS[name]}: {text}" for name, text in found.items()]
    return "\n".join(told)


def _pair(one: str, other: str, values: dict[str, np.ndarray], fell: Bool[np.ndarray, " m"]) -> str:
    """Which of two margins is the better one."""
    found = difference(values[one], values[other], fell)
    if np.isnan(found.p) or found.p >= SIGNIFICANT:
        return f"{one.capitalize()} and {other} do not differ by more than chance (p = {found.p:.2g})."
    word = "better than" if found.interval.value > 0 else "worse than"
    return f"{one.capitalize()} is {word} {other} (p = {found.p:.2g})."


def ablations(samples: dict[str, Samples], folder: Path) -> str:
    """What each controller changes in detection and false alarms of the exact margin, beside the paper's text."""
    told = []
    for file in among(samples, "two_ablations", "three_ablations", "two_zero_momentum", "three_zero_momentum"):
        stars = _stars(file, folder)
        first, *others = stars
        for name in others:
            shares = zip(stars[name], stars[first], strict=True)
            change = [100 * (one - other) for one, other in shares]
            told.append(
                f"- `{file.name}`, {CONTROLLERS[name]}: detection {change[0]:+.1f} points, false alarms {change[1]:+.1f} "
                f"{_beside(change, file.name, first, name)}."
            )
        if {"no_torque", "no_position"} <= set(stars):
            torque, position = (100 * (stars[name][0] - stars[first][0]) for name in ("no_torque", "no_position"))
            told.append(
                f"- `{file.name}`: of the two limits it is that of {'torque' if torque > position else 'position'} that "
                f"conceals more falls from the margin ({torque:+.1f} points of detection without torque limits, "
                f"{position:+.1f} without position limits), in the paper, on three contacts, that of position."
            )
        if "no_position_velocity" in stars:
            stops = file.outcomes[first] == "stopped"
            lost = np.mean(file.outcomes["no_position_velocity"][stops] == "fallen") if stops.any() else np.nan
            told.append(
                f"- `{file.name}`: of the {stops.sum()} stops of the {first} controller {100 * lost:.1f} % fall without "
                f"position and velocity limits; in the paper about {100 * LOST_WITHOUT_LIMITS:.0f} %."
            )
    return "\n".join(told)


def _stars(file: Samples, folder: Path) -> dict[str, tuple[float, float]]:
    """Detection and false alarms of the exact margin at zero, by controller."""
    margin = compared(file, folder)["margin"]
    stars = {}
    for name, outcomes in file.outcomes.items():
        used, fell = judged(outcomes)
        at = point(margin[used], fell)
        stars[name] = at.detection.value, at.false_alarms.value
    return stars


def _beside(change: list[float], file: str, first: str, name: str) -> str:
    """The paper's change, and whether ours has its direction."""
    one, other = STATED.get((file, name)), STATED.get((file, first))
    if one is None or other is None or one.detection is None or other.detection is None:
        return "(the paper's text has no number)"
    stated = 100 * (one.detection - other.detection), 100 * (one.false_alarms - other.false_alarms)
    agree = all(np.sign(ours) == np.sign(theirs) for ours, theirs in zip(change, stated, strict=True))
    word = "the same directions" if agree else "not the same directions"
    return f"(paper: {stated[0]:+.1f} and {stated[1]:+.1f}, {word})"


def heights(samples: dict[str, Samples], folder: Path) -> str:
    """How much the height matters."""
    told = []
    for file in among(samples, *TITLES):
        scored = [compared(file, folder, "--height", str(height)) for height in HEIGHTS]
        default = compared(file, folder)
        used, fell = judged(file.outcomes[BEST], among=everywhere(default))
        stacked = np.stack([default["margin"][used], *(margins["capture_point_support"][used] for margins in scored)])
        exact, *found = (100 * value for value in areas(stacked, fell).values)
        best = int(np.argmax(found))
        told.append(
            f"- {TITLES[file.name]}: {min(found):.1f} to {max(found):.1f} % to the support polygon, the most at "
            f"{HEIGHTS[best]} m; exact margin {exact:.1f} %."
        )
    return "\n".join(told)


def _against(ours: Interval, stated: float | None) -> str:
    return f"{percent(ours)} %" + ("" if stated is None else f" ({100 * stated:.3g} % in the paper)")


def _listed(parts: Iterable[str]) -> str:
    *most, last = parts
    return f"{', '.join(most)} and {last}" if most else last
