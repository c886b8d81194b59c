"""The tables, in Markdown. Shares and areas in percent, with their intervals of 95 %."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path

import numpy as np

from reference.evaluation.margins import MARGINS, compared, everywhere, score_all
from reference.evaluation.paper import FALSE_ALARMS, STATED, Stated
from reference.evaluation.roc import Interval, area, areas, curve, detection_at, difference, judged, point
from reference.evaluation.roc_figures import SUBSAMPLES, TITLES, chosen_subsamples
from reference.evaluation.samples import BEST, Samples, among

HEIGHTS = (0.4, 0.7, 1.0)
"""Of the CoM above the ground that the capture point is told [m]."""


def beside_the_paper(samples: dict[str, Samples], folder: Path) -> str:
    """The exact margin, for every file and controller, beside the paper's text."""
    rows = []
    for file in among(samples, *samples):
        margin = compared(file, folder)["margin"]
        for name, outcomes in file.outcomes.items():
            used, fell = judged(outcomes)
            at = point(margin[used], fell)
            undecided = f"{(~used).sum()}" + (f" + {file.failed} failed" if file.failed else "")
            cells = (at.detected, at.missed, at.false, at.right, undecided, percent(at.detection), percent(at.false_alarms))
            rows.append((file.name, name, *cells, percent(area(margin[used], fell)), stated(STATED.get((file.name, name)))))
    header = ("file", "controller", "detected", "missed", "false", "right", "undecided")
    return table((*header, "detection %", "false alarms %", "area %", "paper %"), rows)


def order_by_controller(samples: dict[str, Samples], folder: Path) -> str:
    """Areas of the five margins against each controller: whether their order is the model's or the robot's limits'."""
    rows = []
    for file in among(samples, "two_ablations", "three_ablations"):
        margins = compared(file, folder)
        for controller, outcomes in file.outcomes.items():
            used, fell = judged(outcomes, among=everywhere(margins))
            values = np.stack([margins[margin.column][used] for margin in MARGINS])
            less = difference(values[0], values[2], fell)
            shown = (_number(100 * value) for value in areas(values, fell).values)
            rows.append((file.name, controller, *shown, f"{percent(less.interval, sign=True)}, p = {less.p:.2g}"))
    return table(("file", "controller", *(margin.label for margin in MARGINS), "exact less support polygon"), rows)


def among_predicted_stops(samples: dict[str, Samples], folder: Path) -> str:
    """Areas among the samples that the exact margin calls capturable: which margin knows the falls that it misses."""
    rows = []
    for file in among(samples, *TITLES):
        margins = compared(file, folder)
        used, fell = judged(file.outcomes[BEST], among=everywhere(margins) & (margins["margin"] >= 0))
        values = np.stack([margins[margin.column][used] for margin in MARGINS])
        shown = (_number(100 * value) for value in areas(values, fell).values)
        rows.append((file.name, int(fell.sum()), int((~fell).sum()), *shown))
    return table(("scenario", "missed falls", "right stops", *(margin.label for margin in MARGINS)), rows)


def five_margins(samples: dict[str, Samples], folder: Path) -> str:
    """The five margins of each scenario against the best of three controllers, compared on the same samples."""
    rows = []
    for file in among(samples, *TITLES):
        margins = compared(file, folder)
        known = everywhere(margins)
        used, fell = judged(file.outcomes[BEST], among=known)
        margins = {name: values[used] for name, values in margins.items()}
        for margin in MARGINS:
            values = margins[margin.column]
            at, roc = point(values, fell), curve(values, fell)
            star = f"{percent(at.detection)} / {percent(at.false_alarms)}" if margin.has_zero else "-"
            less = difference(margins["margin"], values, fell)
            compare = "-" if margin.column == "margin" else f"{percent(less.interval, sign=True)}, p = {less.p:.2g}"
            rates = (_number(100 * rate) for rate in detection_at(roc, np.array(FALSE_ALARMS)))
            cells = (len(fell), (~known).sum(), margin.label, percent(area(values, fell)), compare, star)
            rows.append((file.name, *cells, *rates))
    header = ("scenario", "samples", "without a capture point", "margin", "area %", "exact less this %")
    rates = (f"at {100 * rate:.3g} %" for rate in FALSE_ALARMS)
    return table((*header, "detection / false alarms % at zero", *rates), rows)


def undecided_either_way(samples: dict[str, Samples], folder: Path) -> str:
    """What the exact margin's figures become if outcomes that are neither stop nor fall count as one of them."""
    rows = []
    for file in among(samples, *TITLES):
        margin = compared(file, folder)["margin"]
        for counted in ("excluded", "fallen", "stopped"):
            used, fell = judged(file.outcomes[BEST], counted)
            at = point(margin[used], fell)
            shares = percent(at.detection), percent(at.false_alarms), percent(area(margin[used], fell))
            rows.append((file.name, counted, int(fell.sum()), int((~fell).sum()), *shares))
    return table(("scenario", "undecided are", "falls", "stops", "detection %", "false alarms %", "area %"), rows)


def other_controllers(samples: dict[str, Samples], folder: Path) -> str:
    """Where all controllers ran on the same samples: what each changes of what becomes of them under the first."""
    files = [file for file in samples.values() if BEST not in file.outcomes]
    rows = []
    for file in files or among({}, "two_ablations", "three_ablations", "two_zero_momentum", "three_zero_momentum"):
        capturable = compared(file, folder)["margin"] >= 0
        first = file.outcomes[file.controllers[0]]
        missed, false = (first == "fallen") & capturable, (first == "stopped") & ~capturable
        groups = missed, (first == "fallen") & ~capturable, (first == "stopped") & capturable, false
        for controller in file.controllers[1:]:
            other = file.outcomes[controller]
            changed = [
                f"{(group & (other == new)).sum()} of {group.sum()}"
                for group, new in zip(groups, ("stopped", "stopped", "fallen", "fallen"), strict=True)
            ]
            rows.append((file.name, controller, *changed))
    header = ("file", "controller", "missed falls that stop here", "detected falls that stop here")
    return table((*header, "right stops that fall here", "false alarms that fall here"), rows)


def heights(samples: dict[str, Samples], folder: Path) -> str:
    """Areas of the capture point's two margins for several heights, which contacts at several heights leave open."""
    rows, options = [], [(), *(("--height", str(height)) for height in HEIGHTS)]
    columns = [margin for margin in MARGINS if margin.column.startswith("capture_point")]
    files = among(samples, *TITLES)
    score_all(product(files, options), folder)
    for file in files:
        scored = [compared(file, folder, *option) for option in options]
        used, fell = judged(file.outcomes[BEST], among=everywhere(scored[0]))
        for margin in columns:
            found = [margins[margin.column][used] for margins in scored]
            rows.append((file.name, margin.label, *(_number(100 * value) for value in areas(np.stack(found), fell).values)))
    return table(("scenario", "margin", "default", *(f"{height} m" for height in HEIGHTS)), rows)


def subsamples(samples: dict[str, Samples], folder: Path) -> str:
    """How much the areas of Fig. 9 differ, beside what DeLong's variance of all samples expects of them."""
    (file,) = among(samples, "three")
    used, fell = judged(file.outcomes[BEST])
    margin = compared(file, folder)["margin"][used]
    choices = chosen_subsamples(len(fell))
    found = np.array([areas(margin[None, choice], fell[choice]).values[0] for choice in choices])
    size, whole = len(choices[0]), areas(margin[None], fell)
    expected = np.sqrt(whole.covariance[0, 0] * (len(fell) / size - 1))  # drawn from so few, without replacement
    cells = (size, len(fell), *(_number(100 * value) for value in (found.min(), found.max())))
    spread = (_number(100 * value, 2) for value in (found.std(ddof=1), expected))
    header = ("curves", "samples each", "of", "least area %", "largest area %", "standard deviation %", "expected %")
    return table(header, [(SUBSAMPLES, *cells, *spread)])


def percent(interval: Interval, sign: bool = False) -> str:
    """A share with its interval, in percent; a dash for a share of nothing."""
    if np.isnan(interval.value):
        return "-"
    value, low, high = (f"{100 * number:{'+' if sign else ''}.1f}" for number in interval)
    return value if np.isnan(interval.low) else f"{value} ({low} to {high})"


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    cells = [[str(cell) for cell in row] for row in rows]
    lines = [header, ["---"] * len(header), *cells]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def stated(paper: Stated | None) -> str:
    """Detection and false alarms by the paper's text, in percent; a dash for what it does not state."""
    if paper is None:
        return "-"
    detection = "-" if paper.detection is None else f"{100 * paper.detection:.3g}"
    return f"{detection} / {100 * paper.false_alarms:.3g}"


def _number(value: float, digits: int = 1) -> str:
    return "-" if np.isnan(value) else f"{value:.{digits}f}"
