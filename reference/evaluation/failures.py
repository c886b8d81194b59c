"""Where prediction fails: what missed falls have that right stops have not, and false alarms that detected falls have not.

What is looked at, of the state just after the push: CoM speed; angular momentum about the CoM; how hard
the joint that is nearest to its limit has to brake in order not to pass it, which the sampling keeps below 10 rad/s^2 (known
where the file holds q and v); the effort, the share of the torque limits that standing takes.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reference.evaluation import output
from reference.evaluation.figure_style import BLUE, GREEN, ORANGE, RED, WIDE, save, styled
from reference.evaluation.margins import score
from reference.evaluation.roc import Interval, area, judged, share
from reference.evaluation.roc_figures import TITLES
from reference.evaluation.samples import BEST, Samples, among
from reference.evaluation.tables import percent, table
from reference.tsid.robot import load


class Cell(NamedTuple):
    """One of the four combinations of prediction and outcome."""

    fell: bool
    predicted: bool
    """To fall."""
    label: str
    color: str


CELLS = {
    "right": Cell(False, False, "right stops", BLUE),
    "missed": Cell(True, False, "missed falls", RED),
    "false": Cell(False, True, "false alarms", ORANGE),
    "detected": Cell(True, True, "detected falls", GREEN),
}

CONTRASTS = {"missed": "right", "false": "detected"}
"""Where the prediction fails, and where the same prediction is right."""

FEATURES = {
    "speed": "CoM speed [m/s]",
    "momentum": "angular momentum [kg m²/s]",
    "braking": "braking before a joint limit [rad/s²]",
    "torque": "torque for standing [share of limit]",
}

LEAST = {"speed": 0.01, "momentum": 0.1}
"""Where logarithmic axes begin."""


def cells(outcomes, capturable: Bool[np.ndarray, " n"]) -> dict[str, Bool[np.ndarray, " n"]]:
    """Which samples are in each of CELLS; undecided ones are in none."""
    used, _ = judged(outcomes)
    fell = outcomes == "fallen"
    return {name: used & (fell == cell.fell) & (capturable != cell.predicted) for name, cell in CELLS.items()}


def features(samples: Samples) -> dict[str, Float[np.ndarray, " n"]]:
    """FEATURES of all samples, NaN where one is not known."""
    robot = load(samples.robot)
    return {
        "speed": np.linalg.norm(samples.com_velocity, axis=1),
        "momentum": np.linalg.norm(samples.angular_momentum, axis=1),
        "braking": braking(samples.q[:, 7:], samples.v[:, 6:], robot.lower, robot.upper),
        "torque": samples.effort,
    }


def braking(
    position: Float[np.ndarray, "n j"],
    velocity: Float[np.ndarray, "n j"],
    lower: Float[np.ndarray, " j"],
    upper: Float[np.ndarray, " j"],
) -> Float[np.ndarray, " n"]:
    """Least deceleration with which every joint stops before the limit it moves to [rad/s^2], (15) solved for it.

    Infinite where a joint moves and has no room left. position: [rad]. velocity: [rad/s]. lower, upper: limits [rad].
    """
    room = np.maximum(np.where(velocity > 0, upper - position, position - lower), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = np.where(velocity == 0, 0.0, velocity**2 / (2 * room))
    return needed.max(axis=1)


class Found(NamedTuple):
    """What is known of one scenario."""

    where: dict[str, Bool[np.ndarray, " n"]]
    """Members of CELLS."""
    values: dict[str, Float[np.ndarray, " n"]]
    """FEATURES."""
    at_once: Bool[np.ndarray, " n"]
    """Whether the first QP of the first controller has no solution."""


def where_prediction_fails(samples: dict[str, Samples], folder: Path) -> list[Path]:
    """What missed falls and false alarms have in common: a picture, tables, and what a user should believe."""
    found = {TITLES[file.name]: find(file, score(file, folder)["capturable"]) for file in among(samples, *TITLES)}
    text = Path(folder) / "failures.md"
    output.write(text, "\n".join((medians(found), contrasts(found), believe(found))).encode())
    with styled():
        return [*save(drawn(found), folder, "failures"), text]


def find(samples: Samples, capturable: Bool[np.ndarray, " n"]) -> Found:
    """Cells and features of one file in which the best of three controllers counts."""
    where = cells(samples.outcomes[BEST], np.asarray(capturable, bool))
    first = samples.runs[samples.controllers[0]]
    return Found(where, features(samples), (first.outcomes == "fallen") & (first.times == 0))


def medians(found: dict[str, Found]) -> str:
    """Median and quartiles of each feature in each cell, in Markdown."""
    rows = []
    for title, (where, values, at_once) in found.items():
        for name, members in where.items():
            spreads = [_spread(feature[members]) for feature in values.values()]
            fell = f"{at_once[members].mean():.0%}" if members.any() else "-"
            rows.append((title, CELLS[name].label, members.sum(), *spreads, fell))
    return table(("", "", "samples", *FEATURES.values(), "falls at the first step"), rows)


def _spread(values: Float[np.ndarray, " m"]) -> str:
    values = values[~np.isnan(values)]
    return "{1:.2g} ({0:.2g} to {2:.2g})".format(*np.quantile(values, [0.25, 0.5, 0.75])) if len(values) else "-"


def contrast(found: Found, wrong: str, feature: str) -> Interval:
    """Probability that a sample of a wrong cell has more of a feature than one where the same prediction is right."""
    members = {name: found.values[feature][found.where[name]] for name in (wrong, CONTRASTS[wrong])}
    members = {name: values[~np.isnan(values)] for name, values in members.items()}
    both = np.concatenate(list(members.values()))
    return area(-both, np.arange(len(both)) < len(members[wrong]))


def contrasts(found: dict[str, Found]) -> str:
    """How well each feature alone tells a failure of the prediction from a success with the same verdict, in Markdown."""
    rows = []
    for title, one in found.items():
        for wrong, right in CONTRASTS.items():
            areas = [percent(contrast(one, wrong, feature)) for feature in FEATURES]
            rows.append((title, f"{CELLS[wrong].label} above {CELLS[right].label}", *areas))
    note = "Probability in % that the one has more of it than the other; 50 is chance.\n"
    return table(("", "", *(name.split(" [")[0] for name in FEATURES.values())), rows) + "\n" + note


def believe(found: dict[str, Found]) -> str:
    """What a user should believe, in Markdown."""
    return "\n".join(f"- **{title.capitalize()}**: {_belief(one)}" for title, one in found.items()) + "\n"


def _belief(found: Found) -> str:
    size = {name: int(members.sum()) for name, members in found.where.items()}
    falls, stops = size["detected"] + size["false"], size["right"] + size["missed"]
    told = [
        f"of {falls:,} predicted falls {percent(share(size['detected'], falls))} % fell, "
        f"of {stops:,} predicted stops {percent(share(size['right'], stops))} % stopped."
    ]
    for wrong, right in CONTRASTS.items():
        areas = {feature: contrast(found, wrong, feature) for feature in FEATURES}
        clear = {name: one for name, one in areas.items() if one.low > 0.5 or one.high < 0.5}
        if clear:
            name = max(clear, key=lambda feature: abs(clear[feature].value - 0.5))
            word = "more" if clear[name].value > 0.5 else "less"
            told.append(
                f"{CELLS[wrong].label.capitalize()} differ from {CELLS[right].label} most by {word} "
                f"{FEATURES[name].split(' [')[0]} ({percent(clear[name])} %)."
            )
    weak = {name: found.values["torque"][found.where[name]] for name in ("missed", "right")}
    weak = {name: values[~np.isnan(values)] for name, values in weak.items()}
    heavy = [f"{(values > 1).sum()} of {len(values)} {CELLS[name].label}" for name, values in weak.items()]
    told.append(f"In a posture that the torque limits do not let the robot hold even at rest began {' and '.join(heavy)}.")
    light = {name: int(np.sum(values <= 1)) for name, values in weak.items()}
    if sum(light.values()) > 0:
        kept = share(light["right"], sum(light.values()))
        told.append(f"Of the predicted stops in other postures {percent(kept)} % stopped.")
    if size["missed"]:
        at_once = found.at_once[found.where["missed"]].sum()
        told.append(f"{at_once} of {size['missed']} missed falls have no way out at the first step of the first controller.")
    return " ".join(told)


def drawn(found: dict[str, Found]) -> Figure:
    """A line of panels for each feature, a column for each scenario; boxes of quartiles, whiskers from 5 to 95 %."""
    figure = Figure(figsize=(WIDE, 0.35 + 1.05 * len(FEATURES)), layout="constrained")
    grid = figure.subplots(len(FEATURES), len(found), squeeze=False, sharex="row", sharey=True)
    for row, (feature, label) in zip(grid, FEATURES.items(), strict=True):
        for axes, one in zip(row, found.values(), strict=True):
            _draw_boxes(axes, one, feature)
            if feature == "torque":
                axes.axvline(1.0, color="black", linewidth=0.6, linestyle=":")
        if feature in LEAST:
            row[0].set_xscale("log")
            row[0].set_xlim(left=LEAST[feature])
        name = row[0].annotate(label, (0, 1), (0, 3), xycoords="axes fraction", textcoords="offset points", va="bottom")
        name.set_in_layout(False)  # longer than its panel is wide
        row[0].set_title(" ", loc="left")  # keeps the height of it
    for axes, title in zip(grid[0], found, strict=True):
        axes.set_title(f"{title}\n", fontweight="bold")
    return figure


def _draw_boxes(axes: Axes, found: Found, feature: str) -> None:
    for line, (name, cell) in enumerate(CELLS.items()):
        values = found.values[feature][found.where[name]]
        values = values[np.isfinite(values)]
        if len(values):
            names = ("whislo", "q1", "med", "q3", "whishi")
            box = dict(zip(names, np.quantile(values, [0.05, 0.25, 0.5, 0.75, 0.95]), strict=True))
            style = {
                "boxprops": {"facecolor": cell.color, "alpha": 0.5, "linewidth": 0.6},
                "whiskerprops": {"linewidth": 0.6},
            }
            style |= {"capprops": {"linewidth": 0.6}, "medianprops": {"color": "black", "linewidth": 1.6}}
            drawing = {"orientation": "horizontal", "showfliers": False, "patch_artist": True, "manage_ticks": False}
            axes.bxp([box], positions=[line], widths=0.65, **drawing, **style)
    axes.set_yticks(range(len(CELLS)), [cell.label for cell in CELLS.values()])
    axes.set_ylim(len(CELLS) - 0.4, -0.6)
    axes.grid(axis="x", color="#e8e8e8", linewidth=0.4)
    axes.set_axisbelow(True)
