"""Would another engine say the same? Labels of the campaign, run again in MuJoCo.

    python -m bench.mujoco_check [--samples N] [--scenarios ...] [--jobs J]    # --samples 200 for a table worth quoting

The first N stops and the first N falls (best of four) of each file in --data. The MuJoCo model is made from Pinocchio's:
bodies, inertias and hinges are copied, nothing is read from a URDF twice. Contacts are unilateral: a sphere of 1 mm at each
corner of a contact's rectangle against the plane on which it lies, with MuJoCo's elliptic friction cone, which holds the
controller's pyramid. Torques are the controller's, and a spring and a damper at every joint that pull MuJoCo's state to the
controller's own, as torque-controlled robots do it, by at most FEEDBACK of the limits. A stop is run under the controller
that stopped it, a fall under each of those that ran, until one stops. Where the controller stops, or its QP has no solution,
its last torques and the springs to its last posture carry on: whether the robot then stands or falls is for MuJoCo to say.

    stopped     |v| stays below --slow for DWELL
    fallen      a contact is farther than 0.1 m from its place
    undecided   neither within the time limit

Two lines a file, for all postures and for those that can be held: of the stops, how many MuJoCo keeps up, lets fall, leaves
undecided; of the falls, likewise. Then a line for each disagreement: when it was decided, and what the QP had said.
Extras sim and evaluation; mujoco by itself: pip install "mujoco>=3.2".
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin

from reference.evaluation.replay import sample_of
from reference.evaluation.samples import FOUR, Samples, read
from reference.tsid.controller import CONFIGURATIONS
from reference.tsid.robot import Robot, Sample, load
from reference.tsid.simulator import DEFAULT, Simulator
from reference.tsid.workers import Died, answers
from reference.tsid.wrench_cone import corner_points

DATA = Path("reference/tsid/data")
SCENARIOS = ("two_coplanar", "two", "three", "four", "four_strong")
RADIUS = 1e-3
"""Of the spheres at the corners [m]."""
PRESSED = 1e-5
"""How deep the spheres are in their planes at the start, so that they touch [m]."""
SUBSTEPS = 4
"""Steps of MuJoCo in one of the controller."""
STIFFNESS, DAMPING = 40000.0, 400.0
"""Of the joints' errors [1/s^2, 1/s], times what the joints' inertia is where the base is free: contacts only add to it, so
that this is stable at the controller's step, which the inertia at a fixed base is not."""
FEEDBACK = 0.5
"""What springs and dampers may add, in torque limits [-]: torques at a limit would leave them no say."""
DWELL = 0.2
"""For how long MuJoCo's robot has to be slow [s]."""
AGAIN = 10
"""Steps after which the inertia is computed again."""


class Ending(NamedTuple):
    """How a run in MuJoCo ended."""

    outcome: str
    time: float
    """[s]"""
    commanded: float
    """How long the controller had a command [s]."""
    moved: float
    """Of the contact that is farthest from its place [m]."""
    speed: float
    """Norm of v."""


def document(robot: Robot, sample: Sample, dt: float) -> str:
    """MJCF of the robot on the contacts of a sample. dt: time step [s]."""
    root = ElementTree.Element("mujoco")
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="false", balanceinertia="false")
    gravity = _text(robot.model.gravity.linear)
    ElementTree.SubElement(
        root, "option", timestep=repr(dt), gravity=gravity, cone="elliptic", impratio="10", integrator="implicitfast"
    )
    world = ElementTree.SubElement(root, "worldbody")
    pairs = ElementTree.SubElement(root, "contact")
    bodies = {0: world}
    for joint in range(1, robot.model.njoints):
        bodies[joint] = _body(robot.model, joint, bodies[robot.model.parents[joint]])
    for contact in sample.contacts:
        effector, place = robot.effectors[contact.effector], contact.placement
        frame = robot.model.frames[effector.frame]
        at = {"pos": _text(place.translation), "quat": _quaternion(place.rotation)}
        ElementTree.SubElement(world, "geom", name=contact.effector, type="plane", size="1 1 1", **at, **SILENT)
        inside = frame.placement * effector.placement
        for corner, point in enumerate(corner_points(contact)):
            local = inside.act(place.actInv(point) + np.array([0.0, 0.0, RADIUS - PRESSED]))
            name = f"{contact.effector}_{corner}"
            body = bodies[frame.parentJoint]
            ElementTree.SubElement(body, "geom", name=name, size=repr(RADIUS), pos=_text(local), mass="0", **SILENT)
            friction = _text([contact.friction] * 2 + [1e-4] * 3)
            how = {"friction": friction, "condim": "3", "solref": "0.002 1", "solimp": "0.99 0.999 0.0001"}
            ElementTree.SubElement(pairs, "pair", geom1=name, geom2=contact.effector, **how)
    return ElementTree.tostring(root, encoding="unicode")


SILENT = {"contype": "0", "conaffinity": "0"}
"""Of geometries that touch in the pairs that are listed only."""


def _body(model: pin.Model, joint: int, parent: ElementTree.Element) -> ElementTree.Element:
    """A joint of Pinocchio and the link that it moves."""
    place, inertia = model.jointPlacements[joint], model.inertias[joint]
    body = ElementTree.SubElement(parent, "body", pos=_text(place.translation), quat=_quaternion(place.rotation))
    if joint == 1:
        ElementTree.SubElement(body, "freejoint", name=model.names[joint])
    else:
        velocity = model.joints[joint].createData()
        model.joints[joint].calc(velocity, pin.neutral(model))
        axis = _text(np.ravel(velocity.S)[3:])
        ElementTree.SubElement(body, "joint", name=model.names[joint], type="hinge", axis=axis, limited="false")
    moments = inertia.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    about = {"pos": _text(inertia.lever), "mass": repr(float(inertia.mass)), "fullinertia": _text(moments)}
    ElementTree.SubElement(body, "inertial", **about)
    return body


def _text(values) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def _quaternion(rotation: np.ndarray) -> str:
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return _text([w, x, y, z])


class Engine:
    """A sample in MuJoCo, seen through Pinocchio's coordinates."""

    def __init__(self, robot: Robot, sample: Sample, dt: float):
        self.robot, self.sample, self._steps = robot, sample, SUBSTEPS
        self.model = mujoco.MjModel.from_xml_string(document(robot, sample, dt / SUBSTEPS))
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(name) for name in list(robot.model.names)[2:]]
        self._q = np.array([joint.qposadr[0] for joint in joints])
        self._v = np.array([joint.dofadr[0] for joint in joints])
        q, v = sample.q, sample.v
        rotation = pin.Quaternion(q[3:7]).toRotationMatrix()
        self.data.qpos[:7] = np.concatenate([q[:3], q[[6, 3, 4, 5]]])
        self.data.qvel[:6] = np.concatenate([rotation @ v[:3], v[3:6]])
        self.data.qpos[self._q], self.data.qvel[self._v] = q[7:], v[6:]

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """q (nq,) and v (nv,) as Pinocchio has them."""
        place, motion = self.data.qpos, self.data.qvel
        base = place[[4, 5, 6, 3]] / np.linalg.norm(place[3:7])
        rotation = pin.Quaternion(base).toRotationMatrix()
        q = np.concatenate([place[:3], base, place[self._q]])
        return q, np.concatenate([rotation.T @ motion[:3], motion[3:6], motion[self._v]])

    def step(self, torque: np.ndarray) -> None:
        """One step of the controller under joint torques (n,) [N m]."""
        self.data.qfrc_applied[self._v] = torque
        for _ in range(self._steps):
            mujoco.mj_step(self.model, self.data)

    def moved(self, q: np.ndarray) -> float:
        """How far the contact that moved most is from its place [m]."""
        data = self.robot.model.createData()
        pin.framesForwardKinematics(self.robot.model, data, q)
        places = [self.robot.effectors[contact.effector] for contact in self.sample.contacts]
        found = [(data.oMf[effector.frame] * effector.placement).translation for effector in places]
        wanted = [contact.placement.translation for contact in self.sample.contacts]
        return float(np.linalg.norm(np.subtract(found, wanted), axis=1).max())


def free_inertia(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(n, n): joint torques per joint accelerations where nothing touches and the base gives way."""
    mass = pin.crba(robot.model, robot.model.createData(), q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    return mass[6:, 6:] - mass[6:, :6] @ np.linalg.solve(mass[:6, :6], mass[:6, 6:])


def run(robot: Robot, sample: Sample, controller: str, slow: float) -> Ending:
    """A sample in MuJoCo under a controller of ours. slow: |v| below which it has stopped."""
    trace = Simulator(robot, CONFIGURATIONS[controller]).run(sample, trace=True).trace
    dt, engine, moving = DEFAULT.dt, Engine(robot, sample, DEFAULT.dt), 0
    last = len(trace.t) - 1  # the state that ends the run has no command
    for step in range(round((DEFAULT.time_limit + DWELL) / dt) + 1):
        q, v = engine.state()
        if step % AGAIN == 0:
            moved, inertia = engine.moved(q), free_inertia(robot, q)
        speed = float(np.linalg.norm(v))
        moving = step if not speed < slow else moving
        outcome = "fallen" if moved > DEFAULT.slip or not np.isfinite(speed) else None
        if (step - moving) * dt >= DWELL:
            outcome = "stopped"
        if outcome:
            return Ending(outcome, step * dt, last * dt, moved, speed)
        torque = trace.tau[min(step, last - 1)] if last else np.zeros(len(robot.torque))
        wanted = trace.v[step, 6:] if step < last else 0.0
        errors = STIFFNESS * (trace.q[min(step, last), 7:] - q[7:]) + DAMPING * (wanted - v[6:])
        feedback = np.clip(inertia @ errors, -FEEDBACK * robot.torque, FEEDBACK * robot.torque)
        engine.step(torque + feedback)
    return Ending("undecided", step * dt, last * dt, engine.moved(q), speed)


class Case(NamedTuple):
    """A sample to be run again."""

    row: int
    label: str
    controllers: tuple[str, ...]


def cases(samples: Samples, number: int) -> list[Case]:
    """The first stops and the first falls of a file, as many of each."""
    found = []
    for label in ("stopped", "fallen"):
        for row in np.flatnonzero(samples.outcomes[FOUR] == label)[:number]:
            ran = [name for name in samples.controllers if samples.runs[name].outcomes[row]]
            found.append(Case(int(row), label, tuple(ran[-1:] if label == "stopped" else ran)))
    return found


def _runner(path: Path, chosen: list[Case], slow: float) -> Callable[[int], Ending]:
    """In a process of its own: the run of a number."""
    samples = read(path)
    robot = load(samples.robot)

    def one(number: int) -> Ending:
        case = chosen[number]
        sample = sample_of(samples, case.row, robot)
        for controller in case.controllers:
            ending = run(robot, sample, controller, slow)
            if ending.outcome == "stopped":
                break
        return ending

    return one


def check(path: Path, number: int, slow: float, jobs: int) -> list[str]:
    """Lines about one file: its counts, then its disagreements."""
    samples = read(path)
    chosen = cases(samples, number)
    endings: dict[int, Ending] = {}
    for index, ending in answers(_runner, (path, chosen, slow), range(len(chosen)), jobs):
        if isinstance(ending, Died):
            raise ArithmeticError(f"{samples.name}, sample {chosen[index].row}: {ending}")
        endings[index] = ending
    lines = []
    for postures, most in (("all", np.inf), ("can be held", 1.0)):
        cells = []
        for label in ("stopped", "fallen"):
            held = [i for i, case in enumerate(chosen) if case.label == label and samples.effort[case.row] <= most]
            counts = Counter(endings[i].outcome for i in held)
            cells.append(f"{len(held):8}" + "".join(f"{counts[word]:10}" for word in ("stopped", "fallen", "undecided")))
        lines.append(f"{samples.name:14}{postures:13}" + " | ".join(cells))
    for i, case in enumerate(chosen):
        ending = endings[i]
        if ending.outcome != case.label:
            lines.append(
                f"  {samples.name} {samples.index[case.row]}: {case.label} -> {ending.outcome} at {ending.time:.2f} s, "
                f"{case.controllers[-1]}, commands for {ending.commanded:.2f} s, contact moved {1e3 * ending.moved:.0f} mm, "
                f"|v| {ending.speed:.3f}, "
                f"effort {samples.effort[case.row]:.2f}"
            )
    return lines


def main(arguments: list[str] | None = None) -> None:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.mujoco_check", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=2, metavar="N", help="stops and falls of each file (default: 2)")
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS), metavar="FILE", help="names of files")
    parser.add_argument("--data", type=Path, default=DATA, metavar="FOLDER")
    parser.add_argument("--slow", type=float, default=0.05, help="|v| of a stop: contacts are soft here (default: 0.05)")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="processes (default: 1)")
    options = parser.parse_args(arguments)
    if options.samples < 1:
        parser.error(f"--samples {options.samples} (expected at least 1)")
    words = "".join(f"{word:>10}" for word in ("stopped", "fallen", "undecided"))
    print(f"mujoco {mujoco.__version__}\n{'file':14}{'postures':13}{'stops':>8}{words} | {'falls':>8}{words}", flush=True)
    for name in options.scenarios:
        start = time.perf_counter()
        print(*check(options.data / f"{name}.parquet", options.samples, options.slow, options.jobs), sep="\n")
        print(f"  ({time.perf_counter() - start:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
