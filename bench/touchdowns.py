"""Are those saved of whom `next_contacts` says so? Hands of falling robots come down on walls in the simulator.

    python -m bench.touchdowns [--samples 300] [--torques limited] [--folder DIR] [--why]

The first falls of `two.parquet` (best of four) whose posture can be held, each with and without torque limits. The robot
falls under "standard"; at 0.1, 0.2 and 0.4 s, if it has not fallen by then, a hand comes down: on one of eight walls that
stand where the hands are then (`reference.tsid.touchdown`), drawn at random, and on the one that a prediction prefers.
Then the best outcome of CONTROLLERS counts. All predictions are made of the state at t = 0, but for the last two; in all of
them a margin above zero says "saved", and one that there is not (contacts are lost on the way) is the least of all:

    point mass              margin of `next_contacts`
    momentum                and with the state's angular momentum
    without the hand        margin at touchdown without the new contact: how little the hand has to do
    arms, posture at 0      momentum, and `actuation` of the hand's place in the posture of t = 0
    arms, posture then      the posture at touchdown, as one who plans it knows it
    arms then, box          and a budget of 10 N m for the rate of angular momentum, after touchdown
    arms then, box always   and before it too
    arms, state before      of the simulated state before the impact
    arms, state after       and after it

Printed for each time and limits: touchdowns on random walls, the four cells, the area under the ROC with a band of 95 % by
bootstrap over falls, and that area if robots that stopped with a joint PAST its limit are no stops ("within limits"); then
how often the preferred wall saves the robot, and a random one. --why: those that were called saved and fell, run again
without one limit at a time. Runs are kept in --folder as they come, so that the same command resumes; numbers are drawn by
seeds of each sample, so that nothing depends on where it was interrupted.
Extras sim and evaluation.
"""

from __future__ import annotations

import argparse
import hashlib
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pinocchio as pin

import jaxcap
from jaxcap.robots import actuation
from reference.evaluation.replay import sample_of
from reference.evaluation.roc import CONFIDENCE, SEED, area
from reference.evaluation.samples import FOUR, Samples, read
from reference.tsid.controller import CONFIGURATIONS, Configuration
from reference.tsid.journal import Journal
from reference.tsid.labels import BEST_FIRST
from reference.tsid.robot import Contact, Robot, Sample, load
from reference.tsid.simulator import DEFAULT, Simulator, Trace
from reference.tsid.touchdown import HANDS, TouchdownSimulator, beyond, facing, touchdown, wall_normals

DATA = Path("reference/tsid/data/two.parquet")
TIMES = (0.1, 0.2, 0.4)
"""Of touchdown [s]."""
RIDE = "standard"
"""The controller until then."""
CONTROLLERS = ("brake", "fast", "standard")
"""After it, in the order in which they are tried; "straight" asks for the line that an impact has just bent."""
DECELERATION = CONFIGURATIONS[RIDE].deceleration
BOX = 10.0
"""[N m]"""
RANDOM = 19
"""Seed of the walls drawn."""
REPLICATES = 1000
"""Of a bootstrap."""
PREDICTIONS = (
    "point mass",
    "momentum",
    "without the hand",
    "arms, posture at 0",
    "arms, posture then",
    "arms then, box",
    "arms then, box always",
    "arms, state before",
    "arms, state after",
)
CHOOSES = {True: "arms, posture at 0", False: "momentum"}
"""The prediction that prefers a wall, with torque limits and without."""
TORQUES = {"limited": (True,), "unlimited": (False,), "both": (True, False)}
PAST = 0.05
"""How far past its limit a joint that a touchdown has left beyond its bounds may run [rad]."""
PLANNED = "arms, posture then"
"""The prediction whose errors --why looks at."""
WITHOUT = {
    "torque limits": {"torque_limits": False},
    "position limits": {"position_limits": False},
    "velocity limits": {"velocity_limits": False},
    "all three": {"torque_limits": False, "position_limits": False, "velocity_limits": False},
}
"""What --why leaves out."""

Record = dict[str, Any]


class Wall(NamedTuple):
    """What a hand comes down on."""

    hand: str
    robot: Robot
    """With that hand turned to the wall."""
    sample: Sample
    """After touchdown."""

    @property
    def contact(self) -> Contact:
        """The new one."""
        return self.sample.contacts[-1]


class Moment(NamedTuple):
    """A robot just before a touchdown."""

    time: float
    """[s]"""
    q: np.ndarray
    v: np.ndarray
    walls: list[Wall]


class Centre(NamedTuple):
    """Of mass, per unit mass."""

    com: np.ndarray
    velocity: np.ndarray
    momentum: np.ndarray
    """About it [m^2/s]."""


def centre(robot: Robot, q: np.ndarray, v: np.ndarray) -> Centre:
    """Of the robot at q, v."""
    data = robot.model.createData()
    momentum = pin.computeCentroidalMomentum(robot.model, data, q, v)
    return Centre(data.com[0].copy(), data.vcom[0].copy(), momentum.angular / pin.computeTotalMass(robot.model))


def ride(robot: Robot, sample: Sample, limits: bool) -> Trace:
    """The fall on two feet until the last touchdown, or its end if that comes before."""
    configuration = CONFIGURATIONS[RIDE]._replace(torque_limits=limits)
    run = Simulator(robot, configuration, DEFAULT._replace(time_limit=max(TIMES))).run(sample, trace=True)
    assert run.trace is not None
    # A robot that has fallen stands no longer at the last state; one that was stopped by the time does.
    last = len(run.trace.t) - (run.reason != "time")
    return Trace(*(column[:last] for column in run.trace))


def moments(robot: Robot, sample: Sample, trace: Trace) -> Iterator[Moment]:
    """Those touchdowns that come before the robot's fall."""
    normals = wall_normals(centre(robot, sample.q, sample.v).velocity)
    for at in TIMES:
        step = round(at / DEFAULT.dt)
        if step < len(trace.t):
            q, v = trace.q[step], trace.v[step]
            turned = [(hand, facing(robot, q, hand, normal)) for hand in HANDS for normal in normals]
            yield Moment(at, q, v, [Wall(hand, own, touchdown(own, sample, q, v, hand)) for hand, own in turned])


def contact_set(contact: Contact) -> jaxcap.ContactSet:
    """Its corners."""
    at = contact.placement
    return jaxcap.rectangle(at.translation, at.rotation, contact.half_length, contact.half_width, contact.friction)


def stacked(trees: list[Any]) -> Any:
    """Many as a batch."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)


def bearing(moment: Moment, q: np.ndarray) -> jaxcap.Actuation:
    """What feet and arm can bear at each wall, in posture q."""
    found = []
    for wall in moment.walls:
        frames = [
            wall.robot.model.frames[wall.robot.effectors[contact.effector].frame].name
            for contact in wall.sample.contacts
            for _ in range(4)
        ]
        joined = sum((contact_set(contact) for contact in wall.sample.contacts[1:]), contact_set(wall.sample.contacts[0]))
        found.append(actuation(wall.robot.model, q, joined, frames))
    return stacked(found)


def rank(margin: np.ndarray, capturable: np.ndarray) -> list[float]:
    """A margin that there is not: the greatest of all where the robot rests, else the least."""
    return np.where(np.isnan(margin), np.where(capturable, np.inf, -np.inf), margin).tolist()


def predictions(robot: Robot, sample: Sample, moment: Moment) -> dict[str, list[float]]:
    """Margins of each wall [m/s]."""
    feet = contact_set(sample.contacts[0]) + contact_set(sample.contacts[1])
    hands = stacked([contact_set(wall.contact) for wall in moment.walls])
    start = centre(robot, sample.q, sample.v)
    ask = lambda **known: jaxcap.next_contacts(feet, start.com, start.velocity, hands, moment.time, **known)
    spinning = {"specific_angular_momentum": start.momentum}
    early, then = (bearing(moment, q) for q in (sample.q, moment.q))
    plain, momentum = ask(), ask(**spinning)
    found = {
        "point mass": rank(plain.margin, plain.capturable),
        "momentum": rank(momentum.margin, momentum.capturable),
        "without the hand": rank(momentum.margin_without, momentum.capturable & False),
    }
    box = BOX / pin.computeTotalMass(robot.model)
    for name, limits, always in (
        ("arms, posture at 0", early, 0.0),
        ("arms, posture then", then, 0.0),
        ("arms then, box always", then, box),
    ):
        limited = ask(**spinning, actuation=limits, momentum_box=always)
        found[name] = rank(limited.margin, limited.capturable)
    rays = jaxcap.cone_rays(stacked([feet + contact_set(wall.contact) for wall in moment.walls]))
    ridden = jaxcap.advance(
        jaxcap.cone_rays(feet), start.com, start.velocity, moment.time, specific_angular_momentum=start.momentum
    )
    states = {
        "arms then, box": [Centre(*map(np.asarray, (ridden.com, ridden.com_velocity, ridden.specific_angular_momentum)))],
        "arms, state before": [centre(robot, moment.q, moment.v)],
        "arms, state after": [centre(wall.robot, wall.sample.q, wall.sample.v) for wall in moment.walls],
    }
    for name, own in states.items():
        found[name] = scored(rays, stacked(own * (len(moment.walls) // len(own))), then, box * (name == "arms then, box"))
    lost = int(ridden.progress) in (jaxcap.Progress.TURNS, jaxcap.Progress.LEAVES)
    found["arms then, box"] = [-np.inf] * len(moment.walls) if lost else found["arms then, box"]
    return found


def scored(rays: jaxcap.ConeRays, at: Centre, limits: jaxcap.Actuation, box: float) -> list[float]:
    """Margins of states, each with contacts and limits of its own. box: [m^2/s^2]."""
    known = {"specific_angular_momentum": at.momentum, "actuation": limits, "momentum_box": box}
    answer = jaxcap.score(rays, at.com, at.velocity, **known)
    return rank(np.asarray(answer.margin), np.asarray(answer.capturable))


def outcome(wall: Wall, limits: bool, without: dict[str, bool] | None = None) -> Record:
    """The best one of CONTROLLERS after touchdown; `past`: how far a joint ran past its limit before a stop [rad]."""
    best = []
    for controller in CONTROLLERS:
        configuration: Configuration = CONFIGURATIONS[controller]._replace(torque_limits=limits)._replace(**(without or {}))
        run = TouchdownSimulator(wall.robot, configuration).run(wall.sample, trace=True)
        best.append((run.outcome.name.lower(), controller, str(run.reason), int(run.steps)))
        if best[-1][0] == "stopped":
            break
    past = 0.0
    if best[-1][0] == "stopped" and run.trace is not None:
        joints = run.trace.q[:, 7:]
        past = float(np.maximum(joints - wall.robot.upper, wall.robot.lower - joints).max())
    return {"outcome": min((one[0] for one in best), key=BEST_FIRST.index), "runs": best, "past": past}


def unit(robot: Robot, sample: Sample, limits: bool, why: bool) -> list[Record]:
    """All touchdowns of one fall."""
    found = []
    for moment in moments(robot, sample, ride(robot, sample, limits)):
        margins = predictions(robot, sample, moment)
        drawn = np.random.default_rng((RANDOM, sample.index, round(1e3 * moment.time)))
        number = int(drawn.integers(len(moment.walls)))
        preferred = margins[CHOOSES[limits]]
        best = number if max(preferred) == -np.inf else int(np.argmax(preferred))
        wall = moment.walls[number]
        outcomes = {str(i): outcome(moment.walls[i], limits) for i in sorted({number, best})}
        record = {"time": moment.time, "random": number, "best": best, "margins": margins, "outcomes": outcomes}
        record |= {"speed": float(np.linalg.norm(centre(robot, sample.q, sample.v).velocity)), "hand": wall.hand}
        record |= {"beyond": int(np.count_nonzero(beyond(robot, wall.sample.q, wall.sample.v, DECELERATION, DEFAULT.dt)))}
        if why and margins[PLANNED][number] > 0 and outcomes[str(number)]["outcome"] == "fallen":
            record["without"] = {name: outcome(wall, limits, less)["outcome"] for name, less in WITHOUT.items()}
        found.append(record)
    return found


def falls(samples: Samples, count: int) -> np.ndarray:
    """Rows of the first falls whose posture is in the file and can be held."""
    usable = (samples.outcomes[FOUR] == "fallen") & (samples.effort <= 1) & np.isfinite(samples.q).all(axis=1)
    return np.flatnonzero(usable)[:count]


def touchdowns(options: argparse.Namespace, journal: Journal) -> dict[bool, list[list[Record]]]:
    """Of each fall, with or without torque limits; what the journal does not hold is run. Raises ValueError."""
    settings = {"data": hashlib.sha256(DATA.read_bytes()).hexdigest(), "why": options.why, "version": 5}
    records = list(journal.records)
    if not records:
        journal.append(settings)
    elif records[0] != settings:
        raise ValueError(f"{journal.path}: of other data or options: {records[0]} (expected {settings})")
    kept = {(row, limits): found for row, limits, found in records[1:]}
    samples = read(DATA)
    robot, rows, start = load(samples.robot), falls(samples, options.samples), time.monotonic()
    for place, row in enumerate(rows.tolist()):
        for limits in TORQUES[options.torques]:
            if (row, limits) not in kept:
                found = unit(robot, sample_of(samples, row, robot), limits, options.why)
                journal.append([row, limits, found])
                kept[row, limits] = found
        if place % 10 == 9:
            print(f"# {place + 1} falls, {time.monotonic() - start:.0f} s", flush=True)
    return {limits: [kept[row, limits] for row in rows.tolist()] for limits in TORQUES[options.torques]}


class Judged(NamedTuple):
    """Touchdowns on random walls that were decided."""

    fall: np.ndarray
    """Which fall each of them is of."""
    saved: np.ndarray
    margins: dict[str, np.ndarray]
    undecided: int
    past: np.ndarray
    """Whether they were saved by running a joint past its limit."""


def judged(units: list[list[Record]], at: float | None) -> Judged:
    """At one time, or at all."""
    chosen = [(fall, one) for fall, own in enumerate(units) for one in own if at in (None, one["time"])]
    ends = np.array([one["outcomes"][str(one["random"])]["outcome"] for _, one in chosen])
    past = np.array([one["outcomes"][str(one["random"])]["past"] > PAST for _, one in chosen])
    known = ends != "undecided"
    margin = lambda name: np.array([one["margins"][name][one["random"]] for _, one in chosen])[known]
    fall = np.array([fall for fall, _ in chosen])[known]
    saved = ends[known] == "stopped"
    margins = {name: margin(name) for name in PREDICTIONS}
    return Judged(fall, saved, margins, int((~known).sum()), saved & past[known])


def with_band(margin: np.ndarray, fell: np.ndarray, fall: np.ndarray) -> str:
    """The area under the ROC; falls are drawn with all their touchdowns, which are not independent."""
    numbers, own = np.unique(fall, return_inverse=True)
    drawn = np.random.default_rng(SEED).multinomial(len(numbers), np.full(len(numbers), 1 / len(numbers)), REPLICATES)
    times = drawn[:, own].astype(float)  # how often each touchdown is in a replicate
    stops, down = margin[~fell][:, None], margin[fell][None]
    above = (stops > down) + 0.5 * (stops == down)
    pairs = times[:, ~fell].sum(axis=1) * times[:, fell].sum(axis=1)
    kept = pairs > 0
    areas = np.einsum("ri,ij,rj->r", times[:, ~fell], above, times[:, fell], optimize=True)[kept] / pairs[kept]
    low, high = np.quantile(areas, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]) if len(areas) else (np.nan, np.nan)
    return f"{area(margin, fell).value:.3f} ({low:.3f} to {high:.3f})"


def cells(of: Judged) -> Iterator[str]:
    """Lines of a table."""
    yield "| prediction | said saved: saved | fallen | said fallen: saved | fallen | area under the ROC | within limits |"
    yield "|---|---|---|---|---|---|---|"
    for name, margin in of.margins.items():
        said = margin > 0
        counts = [int((one & other).sum()) for one in (said, ~said) for other in (of.saved, ~of.saved)]
        bands = [with_band(margin, fell, of.fall) for fell in (~of.saved, ~of.saved | of.past)]
        yield f"| {name} | " + " | ".join([*map(str, counts), *bands]) + " |"


def choices(units: list[list[Record]], at: float | None, limits: bool) -> Iterator[str]:
    """What the preferred wall saves and what a random one, where a wall is called saved and where none is."""
    chosen = [one for own in units for one in own if at in (None, one["time"])]
    ended = lambda one, which: one["outcomes"][str(one[which])]["outcome"]
    for words, called in (("some wall is said to save it", True), ("none is", False), ("all", None)):
        among = [one for one in chosen if called is None or (max(one["margins"][CHOOSES[limits]]) > 0) == called]
        saved = [sum(ended(one, which) == "stopped" for one in among) for which in ("best", "random")]
        yield f"| {words} | {len(among)} | {saved[0]} | {saved[1]} |"


def reasons(units: list[list[Record]]) -> Iterator[str]:
    """What is predicted wrongly (arms, posture then), on random walls: what it lacks, and what would have known better."""
    ones = [one for own in units for one in own]
    margin = lambda one, name: one["margins"][name][one["random"]]
    ended = lambda one: one["outcomes"][str(one["random"])]
    wrong = [one for one in ones if "without" in one]
    at_once = sum(all(run[3] == 0 for run in ended(one)["runs"]) for one in wrong)
    yield f"- said saved, fallen: {len(wrong)}; {at_once} at the first step under all controllers"
    for name in WITHOUT:
        yield f"    - saved without {name}: {sum(one['without'][name] == 'stopped' for one in wrong)}"
    for name in ("arms, state before", "arms, state after"):
        yield f"    - {name}: said fallen {sum(margin(one, name) <= 0 for one in wrong)}"
    missed = [one for one in ones if margin(one, PLANNED) <= 0 and ended(one)["outcome"] == "stopped"]
    lost = sum(margin(one, PLANNED) == -np.inf for one in missed)
    yield f"- said fallen, saved: {len(missed)}; {lost} lose their contacts on the way, by the prediction"
    for name in ("arms then, box", "arms then, box always", "arms, state before", "arms, state after"):
        yield f"    - {name}: said saved {sum(margin(one, name) > 0 for one in missed)}"
    bent = [one["beyond"] for one in ones]
    yield f"- joints beyond their viability bounds after an impact: median {np.median(bent):.0f}, none {bent.count(0)} times"


def report(found: dict[bool, list[list[Record]]], why: bool) -> Iterator[str]:
    """All tables."""
    for limits, units in found.items():
        for at in (*TIMES, None):
            of = judged(units, at)
            when = "all times" if at is None else f"T = {at} s"
            yield f"\n### {'with' if limits else 'without'} torque limits, {when}\n"
            yield f"{len(of.saved)} touchdowns on random walls, {int(of.saved.sum())} saved; {of.undecided} more undecided;"
            yield f"{int(of.past.sum())} of the saved by running a joint past its limit\n"
            yield from cells(of)
            yield "\n| wall | touchdowns | preferred one saves | random one saves |\n|---|---|---|---|"
            yield from choices(units, at, limits)
        if why:
            yield ""
            yield from reasons(units)


def main(arguments: list[str] | None = None) -> None:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.touchdowns", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=300, metavar="N", help="falls (default: 300)")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="where runs are kept (default: a temporary folder)")
    parser.add_argument("--torques", choices=list(TORQUES), default="both", help="(default: both)")
    parser.add_argument("--why", action="store_true", help="run wrong predictions again without limits")
    options = parser.parse_args(arguments)
    if options.samples < 1:
        parser.error(f"--samples {options.samples} (expected at least 1)")
    jax.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        with Journal(folder / "touchdowns.journal") as journal:
            print(*report(touchdowns(options, journal), options.why), sep="\n", flush=True)


if __name__ == "__main__":
    main()
