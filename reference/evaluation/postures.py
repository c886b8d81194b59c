"""Falls that a predictor can be blamed for: among postures that can be held, and by the best of four controllers.

A posture whose effort is above 1 cannot be held within the torque limits, push or no push. V-A starts "in an equilibrium
configuration", so what the paper's numbers are to be held against is the postures that can be held; all of them are shown
beside, since the sampling of V-B makes both.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Shaped

from reference.evaluation.margins import MARGINS, compared, everywhere
from reference.evaluation.paper import STATED, Stated
from reference.evaluation.roc import Difference, area, areas, difference, judged, point, share
from reference.evaluation.roc_figures import TITLES
from reference.evaluation.samples import BEST, FOUR, Samples, among
from reference.evaluation.tables import percent, stated, table

SIGNIFICANT = 0.05
"""Differences less probable than this by chance are told as such."""

POSTURES = {"all": np.inf, "can be held": 1.0}
"""Which samples are looked at, and the effort up to which they are [-]."""


class Part(NamedTuple):
    """Some samples of a file, and what became of them."""

    postures: str
    """A key of POSTURES."""
    truth: str
    """A key of the file's outcomes."""
    members: Bool[np.ndarray, " n"]
    outcomes: Shaped[np.ndarray, " n"]

    def paper(self, file: Samples) -> Stated | None:
        """What the paper's text has beside it, for HRP-2; it has three controllers."""
        return STATED.get((file.scenario, self.truth))


def parts(file: Samples) -> Iterator[Part]:
    """All and held postures, each by the best of three and of four, as far as the file has them.

    Of three contacts also by the controller that the paper's numbers there are of.
    """
    for postures, most in POSTURES.items():
        truths = [name for name in file.controllers if (file.scenario, name) in STATED]
        for truth in (*truths, BEST, FOUR):
            if truth in file.outcomes:
                yield Part(postures, truth, file.effort <= most, file.outcomes[truth])


def _files(samples: dict[str, Samples]) -> list[Samples]:
    """Those with a best outcome, of any robot, the paper's scenarios first. Raises MissingFile if there is none."""
    return [file for file in samples.values() if BEST in file.outcomes] or among(samples, *TITLES)


ROBOTS = {"talos": "", "talos_strong_arms": ", strong arms", "g1": ", robot G1"}
"""What is said of a robot behind its contacts, by its name."""


def title(file: Samples) -> str:
    """Contacts and robot, in words."""
    return TITLES[file.scenario] + ROBOTS.get(file.robot, f", {file.robot}")


def in_short(samples: dict[str, Samples], folder: Path) -> str:
    """Falls detected / false alarms at a margin of zero [%], for all postures and for those that can be held."""
    columns = [("all", BEST), ("can be held", BEST), ("can be held", FOUR)]
    rows = []
    for file in _files(samples):
        margin = compared(file, folder)["margin"]
        cells = dict.fromkeys(columns, "-")
        for part in parts(file):
            used, fell = judged(part.outcomes, among=part.members)
            at = point(margin[used], fell)
            cells[part.postures, part.truth] = f"{percent(at.detection)} / {percent(at.false_alarms)}"
        rows.append((title(file), f"{len(file.index):,}", *(cells[column] for column in columns), _paper(file)))
    header = ("contacts", "samples", *(f"{postures}, {truth}" for postures, truth in columns), "paper (HRP-2)")
    return table(header, rows)


def _paper(file: Samples) -> str:
    """The paper's text beside a scenario, whichever controllers it is of."""
    found = {name: STATED.get((file.scenario, name)) for name in (BEST, *file.controllers)}
    told = (f"{stated(one)}" + ("" if name == BEST else f" ({name} alone)") for name, one in found.items() if one)
    return next(told, "-")


def areas_in_short(samples: dict[str, Samples], folder: Path) -> str:
    """Areas under the ROC [%] of the five margins: postures that can be held, best of four controllers."""
    rows = []
    for file, values, fell in _held(samples, folder):
        shown = (percent(area(margin, fell)) for margin in values)
        rows.append((title(file), int(fell.sum()), int((~fell).sum()), *shown))
    return table(("contacts", "falls", "stops", *(margin.label for margin in MARGINS)), rows)


def order_in_words(samples: dict[str, Samples], folder: Path) -> str:
    """Whether the paper's order holds there: exact margin above support polygon above hull (V-C), by DeLong's test."""
    told = []
    for file, values, fell in _held(samples, folder):
        pairs = {
            "the exact margin less the support polygon": difference(values[0], values[2], fell),
            "the support polygon less the hull": difference(values[2], values[3], fell),
        }
        said = (f"{name} {percent(pair.interval, sign=True)}, {verdict(pair)}" for name, pair in pairs.items())
        name = title(file)
        told.append(f"- {name[0].upper()}{name[1:]}: {'; '.join(said)}.")
    return "\n".join(told)


def verdict(pair: Difference) -> str:
    """A difference of areas in words."""
    if np.isnan(pair.p):
        return "too few to say"
    sign = "as in the paper" if pair.interval.value > 0 else "the other way round"
    return f"{sign} (p = {pair.p:.2g})" if pair.p < SIGNIFICANT else f"no difference to be seen (p = {pair.p:.2g})"


def _held(samples: dict[str, Samples], folder: Path) -> Iterator[tuple[Samples, Float[np.ndarray, "5 m"], np.ndarray]]:
    """Files with a best of four: the five margins of postures that can be held and decided, and which of these fell."""
    for file in (file for file in _files(samples) if FOUR in file.outcomes):
        margins = compared(file, folder)
        used, fell = judged(file.outcomes[FOUR], among=(file.effort <= 1) & everywhere(margins))
        yield file, np.stack([margins[margin.column][used] for margin in MARGINS]), fell


def beside_the_paper(samples: dict[str, Samples], folder: Path) -> str:
    """The exact margin at zero for all postures and for those that can be held, by the best of three and of four."""
    rows = []
    for file in _files(samples):
        margin = compared(file, folder)["margin"]
        for part in parts(file):
            used, fell = judged(part.outcomes, among=part.members)
            at = point(margin[used], fell)
            cells = (int(fell.sum()), int((~fell).sum()), int(part.members.sum() - used.sum()))
            shares = (percent(at.detection), percent(at.false_alarms), percent(area(margin[used], fell)))
            rows.append((file.name, part.postures, part.truth, *cells, *shares, stated(part.paper(file))))
    header = ("scenario", "postures", "outcome", "falls", "stops", "undecided", "detection %", "false alarms %", "area %")
    return table((*header, "paper %"), rows)


def order(samples: dict[str, Samples], folder: Path) -> str:
    """Areas of the five margins on the same samples. V-C has the exact margin first, then support polygon, then hull."""
    rows = []
    for file in _files(samples):
        margins = compared(file, folder)
        for part in parts(file):
            used, fell = judged(part.outcomes, among=part.members & everywhere(margins))
            values = np.stack([margins[margin.column][used] for margin in MARGINS])
            shown = (f"{100 * value:.1f}" if np.isfinite(value) else "-" for value in areas(values, fell).values)
            pairs = (difference(values[one], values[other], fell) for one, other in ((0, 2), (2, 3)))
            compare = (
                percent(pair.interval, sign=True) + ("" if np.isnan(pair.p) else f", p = {pair.p:.2g}") for pair in pairs
            )
            rows.append((file.name, part.postures, part.truth, *shown, *compare))
    header = ("scenario", "postures", "outcome", *(margin.label for margin in MARGINS))
    return table((*header, "exact less support polygon", "support polygon less hull"), rows)


def rescued(samples: dict[str, Samples], folder: Path) -> str:
    """What "brake" stops of what the best of three lets fall or leaves undecided, by posture and prediction."""
    rows = []
    for file in (file for file in _files(samples) if FOUR in file.outcomes):
        capturable = compared(file, folder)["margin"] >= 0
        saved = file.outcomes[FOUR] == "stopped"
        for postures, held in (("can be held", file.effort <= 1), ("cannot be held", file.effort > 1)):
            cells = []
            for outcome in ("fallen", "undecided"):
                for predicted in (capturable, ~capturable):
                    members = held & predicted & (file.outcomes[BEST] == outcome)
                    number = int((members & saved).sum())
                    cells.append(f"{number} of {members.sum()}: {percent(share(number, int(members.sum())))}")
            rows.append((file.name, postures, *cells))
    header = ("scenario", "postures", "falls predicted to stop", "falls predicted to fall")
    return table((*header, "undecided predicted to stop", "undecided predicted to fall"), rows)
