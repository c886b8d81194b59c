"""States/s with the robot's limits, each state its own posture, over the point mass and HiGHS; and how far HiGHS agrees.

    python -m bench.limits [--scenarios three four] [--joints arms all] [--faces three] [--states 8192]

The states are TALOS's of the evaluation (reference/tsid/data), repeated up to `--states`. `arms` has the rows of the joints
of the touching arms only, `all` those of every joint between the base and a contact (legs never bind on TALOS). Every line
is one run: the limits, the point mass, and, for the first `--check` states, the programs of `reference.robot_limits`, an
effort and a largest speed each. `effort` and `max_speed` are the largest relative differences among these; states where the
polygon goes on beyond the static region are left out of the latter, for there the robot swings.

Then, for `--faces`, one posture of each scenario (row `--row`) by faces, with the joints of the arms and no box: how many
they are, the seconds of projection, and the speed on states around that posture's, over rays with the same posture and over
the cone without limits; how many verdicts differ from those of rays, and at what margin at most. Needs the extra evaluation.

    python -m bench.limits --random 1000 [--seed 0]

compares instead so many states of each kind of `bench.limits_random`, of no robot, with the programs: `verdicts` differ
among the `clear` ones; `max_speed`, `min_speed` and `effort` are the largest relative differences of all that are decided.
"""

import argparse
import time
from collections.abc import Iterable
from pathlib import Path

import jax
import numpy as np

import jaxcap
from bench import limits_random
from bench.limited import Limited, limited
from bench.timing import in_turn, ratio
from reference import robot_limits as programs
from reference.evaluation.samples import read

DATA = Path(__file__).parents[1] / "reference" / "tsid" / "data"
FIRST = 1000
"""Rows of a file that are read."""
HOLDING = 1e-7
"""A polygon that goes on by more beyond the static region [m] lets the robot swing."""


def line(scenario: str, joints: str, dtype: str, options: argparse.Namespace) -> dict:
    """One line of the table."""
    some = limited(read(DATA / f"{scenario}.parquet", max(FIRST, options.check)), joints)
    many = some.repeated(options.states).cast(dtype)
    rays = jax.tree.map(np.asarray, jaxcap.cone_rays(many.contacts))
    timed = in_turn(
        {
            "limits": lambda: jaxcap.score(
                rays, many.coms, many.velocities, actuation=many.actuation, momentum_box=options.box
            ),
            "point": lambda: jaxcap.score(rays, many.coms, many.velocities),
        },
        options.rounds,
    )
    ours = timed["limits"]
    answer = jax.tree.map(np.asarray, ours.answer)
    return {
        "scenario": scenario,
        "joints": f"{joints} ({some.actuation.joints})",
        "dtype": dtype,
        "states/s": options.states / ours.best,
        "compile s": ours.compiling,
        "point mass x": ratio(ours, timed["point"]),
        **_checked(some, answer, options, ours.best / options.states),
        "undecided": int((answer.status == jaxcap.Status.MAX_STEPS).sum()),
    }


def line_of_faces(scenario: str, dtype: str, options: argparse.Namespace) -> dict:
    """One posture by faces."""
    some = jax.tree.map(lambda x: x[options.row], limited(read(DATA / f"{scenario}.parquet", options.row + 8), "arms"))
    start = time.perf_counter()
    cone = jaxcap.actuated_cone(some.contacts, some.actuation)
    projecting = time.perf_counter() - start
    plain, rays = jaxcap.centroidal_cone(some.contacts), jaxcap.cone_rays(some.contacts)
    rng = np.random.default_rng(0)
    coms = (some.coms + rng.uniform(-0.1, 0.1, (options.states, 3))).astype(dtype)
    velocities = (some.velocities + rng.uniform(-0.3, 0.3, (options.states, 3))).astype(dtype)
    timed = in_turn(
        {
            "faces": lambda: jaxcap.score(cone, coms, velocities),
            "rays": lambda: jaxcap.score(rays, coms, velocities, actuation=some.actuation),
            "point": lambda: jaxcap.score(plain, coms, velocities),
        },
        options.rounds,
    )
    ours, other = (jax.tree.map(np.asarray, timed[name].answer) for name in ("faces", "rays"))
    differ = ours.capturable != other.capturable
    return {
        "posture": f"{scenario} {options.row}",
        "dtype": dtype,
        "faces": len(cone.faces),
        "project s": projecting,
        "states/s": options.states / timed["faces"].best,
        "rays x": timed["rays"].best / timed["faces"].best,
        "point mass x": ratio(timed["faces"], timed["point"]),
        "verdicts": int(differ.sum()),
        "at margin": float(np.abs(other.margin[differ]).max(initial=0)),
    }


def _checked(states: Limited, answer: jaxcap.Capturability, options: argparse.Namespace, each: float) -> dict:
    """How much longer HiGHS takes, and the largest differences from it."""
    efforts, speeds, swinging = np.full((3, options.check), np.nan)
    start = time.perf_counter()
    rows = [program_of(states, i, options.box) for i in range(options.check)]
    for i, state in enumerate(rows):
        efforts[i], speeds[i] = programs.effort(state), programs.max_speed(state)
    spent = (time.perf_counter() - start) / max(options.check, 1)
    for i, state in enumerate(rows):
        s_min, s_max = programs.static_interval(state)
        speeds[i] = 0.0 if s_min > s_max else speeds[i]
        swinging[i] = s_min <= s_max < programs.farthest(state, 0.0) - HOLDING
    off = lambda name, expected, rows: np.abs(getattr(answer, name)[: options.check][rows] / expected[rows] - 1)
    usable = (swinging == 0) & (speeds > 0) & np.isfinite(speeds)
    return {
        "HiGHS x": spent / each if options.check else np.nan,
        "effort": np.max(off("effort", efforts, np.isfinite(efforts)), initial=0),
        "max_speed": np.max(off("max_speed", speeds, usable), initial=0),
        "compared": int(usable.sum()),
    }


def program_of(states: Limited, i: int, box: float) -> programs.State:
    """One state for the reference."""
    posture, contacts = (jax.tree.map(lambda x: x[i], tree) for tree in (states.actuation, states.contacts))
    limits = programs.Limits(posture.jacobians, posture.gravity_torque, posture.limit, posture.mask)
    where = contacts.points, contacts.frames, contacts.friction
    return programs.state_of(*where, states.coms[i], states.velocities[i], limits, box=box)


def main() -> None:
    """Measures and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="*", default=["three", "four"])
    parser.add_argument("--faces", nargs="*", default=["three"], help="scenarios with a posture by faces")
    parser.add_argument("--row", type=int, default=3, help="that posture, among rows whose robot holds one")
    parser.add_argument("--joints", nargs="+", default=["arms", "all"], choices=["arms", "all"])
    parser.add_argument("--dtypes", nargs="+", default=["float64", "float32"])
    parser.add_argument("--states", type=int, default=8192)
    parser.add_argument("--check", type=int, default=100, help="states that HiGHS solves too")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--box", type=float, default=0.11, help="momentum box per unit mass [m^2/s^2] (10 N m for TALOS)")
    parser.add_argument("--random", type=int, metavar="N", help="compare so many random states of each kind instead")
    parser.add_argument("--seed", type=int, default=0, help="of these")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if options.random:
        _print(limits_random.lines(options.random, options.seed, options.dtypes))
        return
    tables = (
        line(scenario, joints, dtype, options)
        for scenario in options.scenarios
        for joints in options.joints
        for dtype in options.dtypes
    )
    _print(tables)
    _print(line_of_faces(scenario, dtype, options) for scenario in options.faces for dtype in options.dtypes)


def _print(lines: Iterable[dict]) -> None:
    """A table, line by line."""
    for number, found in enumerate(lines):
        if number == 0:
            print("  ".join(f"{name:>12}" for name in found))
        shown = (f"{value:>12.4g}" if isinstance(value, float) else f"{value!s:>12}" for value in found.values())
        print("  ".join(shown), flush=True)


if __name__ == "__main__":
    main()
