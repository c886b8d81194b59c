"""Would another engine say the same? Labels of the campaign, run again in MuJoCo.

    python -m bench.mujoco_check [--samples N] [--scenarios ...] [--folder DIR]    # --samples 200 for a table worth quoting

The first N stops and the first N falls (best of four) of each file in --data. The MuJoCo model is made from Pinocchio's:
bodies, inertias and hinges are copied, nothing is read from a URDF twice. Contacts are unilateral: a sphere of 1 mm at each
corner of a contact's rectangle against the plane on which it lies, with MuJoCo's elliptic friction cone, which holds the
controller's pyramid. A stop is run under the controller that stopped it, a fall under each of those that ran; each of them
twice, until MuJoCo's robot stops:

    followed    the torques of our run, and a spring and a damper at every joint that pull to where our run has it, by at
                most SPRINGS of the limits, as torque-controlled robots do it. Where our run ends, the last torques and the
                springs to the last posture carry on
    closed      the controller's QP at the state in MuJoCo, every step, and dampers to the velocities that it asks for, by at
                most DAMPERS of the limits. It asks of the CoM at most -CLOSED times its velocity, where ours has -1/dt: a
                contact that yields does not bear that. Without a solution the last torques carry on

    stopped     |v| stays below --slow for DWELL
    fallen      a contact is farther than 0.1 m from its place
    undecided   neither within the time limit

Two lines a file, for all postures and for those that can be held: of the stops, how many MuJoCo keeps up, lets fall, leaves
undecided; of the falls, likewise. Then a line for each disagreement, of the last run: when it was decided, how long the QP
had commands, and which joint was the first to be LOST away from the posture that is followed, if one was. Runs are kept in
--folder as they come, so that the same command resumes.
Extras sim and evaluation; mujoco by itself: pip install "mujoco>=3.2".
"""

from __future__ import annotations

import argparse
import json
import tempfile
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
from reference.tsid.certificate import CertifiedSolver
from reference.tsid.controller import CONFIGURATIONS, Controller
from reference.tsid.robot import Robot, Sample, load
from reference.tsid.simulator import DEFAULT, Simulator
from reference.tsid.solvers import Status
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
SPRINGS = 0.5
"""What springs and dampers may add to torques that are followed, in torque limits [-]: at a limit they would have no say."""
CLOSED, DAMPERS, FRICTION = 20.0, 0.3, 100.0
"""In the closed loop: gain of the CoM [1/s], share of the torque limits and gain [1/s] of the dampers."""
DWELL = 0.2
"""For how long MuJoCo's robot has to be slow [s]."""
AGAIN = 10
"""Steps after which the inertia is computed again."""
LOST = 0.1
"""How far from where the controller has it a joint no longer does as told [rad]."""


class Ending(NamedTuple):
    """How a run in MuJoCo ended."""

    outcome: str
    how: str
    """`followed` or `closed`, and the controller."""
    time: float
    """[s]"""
    commanded: float
    """How long our run had a command [s]; of the closed loop, for how much of the time it had one."""
    moved: float
    """Of the contact that is farthest from its place [m]."""
    speed: float
    """Norm of v."""
    lost: str
    """The first joint that was LOST while there were commands, and when; empty: none."""


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


class Watch:
    """Ends a run in MuJoCo."""

    def __init__(self, engine: Engine, slow: float):
        self.engine, self.slow, self.moving, self.step = engine, slow, 0, -1

    def look(self) -> tuple[np.ndarray, np.ndarray, str]:
        """At the next step: q, v, and an outcome or nothing."""
        self.step += 1
        q, v = self.engine.state()
        if self.step % AGAIN == 0:
            self.moved, self.inertia = self.engine.moved(q), free_inertia(self.engine.robot, q)
        self.speed = float(np.linalg.norm(v))
        self.moving = self.step if not self.speed < self.slow else self.moving
        if (self.step - self.moving) * DEFAULT.dt >= DWELL:
            return q, v, "stopped"
        if self.moved > DEFAULT.slip or not np.isfinite(self.speed):
            return q, v, "fallen"
        return q, v, "undecided" if self.step * DEFAULT.dt >= DEFAULT.time_limit + DWELL else ""


def followed(robot: Robot, sample: Sample, controller: str, slow: float) -> Ending:
    """The torques of our run in MuJoCo. slow: |v| below which it has stopped."""
    trace = Simulator(robot, CONFIGURATIONS[controller]).run(sample, trace=True).trace
    watch, lost = Watch(Engine(robot, sample, DEFAULT.dt), slow), ""
    last = len(trace.t) - 1  # the state that ends the run has no command
    while True:
        q, v, outcome = watch.look()
        step = watch.step
        if outcome:
            how = f"followed {controller}"
            return Ending(outcome, how, step * DEFAULT.dt, last * DEFAULT.dt, watch.moved, watch.speed, lost)
        torque = trace.tau[min(step, last - 1)] if last else np.zeros(len(robot.torque))
        wanted = trace.v[step, 6:] if step < last else 0.0
        away = trace.q[min(step, last), 7:] - q[7:]
        if not lost and step < last and np.abs(away).max() > LOST:
            lost = f"{robot.model.names[2 + int(np.abs(away).argmax())]} at {step * DEFAULT.dt:.2f} s"
        errors = STIFFNESS * away + DAMPING * (wanted - v[6:])
        watch.engine.step(torque + np.clip(watch.inertia @ errors, -SPRINGS * robot.torque, SPRINGS * robot.torque))


def closed(robot: Robot, sample: Sample, controller: str, slow: float) -> Ending:
    """The controller on MuJoCo's state, as `followed`."""
    configuration = CONFIGURATIONS[controller]
    gain = min(CLOSED, configuration.com_gain or CLOSED)
    own = Controller(robot, configuration._replace(com_gain=gain), sample, DEFAULT.dt, DEFAULT.stabilisation)
    solver, watch = CertifiedSolver(DEFAULT.solver), Watch(Engine(robot, sample, DEFAULT.dt), slow)
    torque, solved = np.zeros(len(robot.torque)), 0
    while True:
        q, v, outcome = watch.look()
        if outcome:
            times = watch.step * DEFAULT.dt, solved * DEFAULT.dt
            return Ending(outcome, f"closed {controller}", *times, watch.moved, watch.speed, "")
        answer, wanted = solver.solve(own.problem_at(q, v)), np.zeros(len(v))
        if answer.status == Status.OPTIMAL:
            command = own.command(answer.y)
            torque, wanted, solved = command.torque, v + DEFAULT.dt * command.acceleration, solved + 1
        errors = FRICTION * (wanted - v)[6:]
        watch.engine.step(torque + np.clip(watch.inertia @ errors, -DAMPERS * robot.torque, DAMPERS * robot.torque))


def run(robot: Robot, sample: Sample, controllers: tuple[str, ...], slow: float) -> Ending:
    """The first way in which the robot stops, else the last."""
    for controller in controllers:
        for way in (followed, closed):
            ending = way(robot, sample, controller, slow)
            if ending.outcome == "stopped":
                return ending
    return ending


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
        return run(robot, sample_of(samples, case.row, robot), case.controllers, slow)

    return one


class Kept:
    """Endings of one file's samples, by row, in a file that is written whole with each of them."""

    def __init__(self, path: Path):
        self.path = path
        found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        self.endings = {int(row): Ending(*values) for row, values in found.items()}

    def add(self, row: int, ending: Ending) -> None:
        self.endings[row] = ending
        half = self.path.with_suffix(".part")
        half.write_text(json.dumps(self.endings), encoding="utf-8")
        half.replace(self.path)


def check(path: Path, options: argparse.Namespace) -> list[str]:
    """Lines about one file: its counts, then its disagreements."""
    samples = read(path)
    chosen = cases(samples, options.samples)
    kept = Kept(options.folder / f"{samples.name}.json")
    missing = [index for index, case in enumerate(chosen) if case.row not in kept.endings]
    for index, ending in answers(_runner, (path, chosen, options.slow), missing, options.jobs):
        if isinstance(ending, Died):
            raise ArithmeticError(f"{samples.name}, sample {chosen[index].row}: {ending}")
        kept.add(chosen[index].row, ending)
    endings = [kept.endings[case.row] for case in chosen]
    lines = []
    for postures, most in (("all", np.inf), ("can be held", 1.0)):
        cells = []
        for label in ("stopped", "fallen"):
            held = [i for i, case in enumerate(chosen) if case.label == label and samples.effort[case.row] <= most]
            counts = Counter(endings[i].outcome for i in held)
            cells.append(f"{len(held):8}" + "".join(f"{counts[word]:10}" for word in ("stopped", "fallen", "undecided")))
        lines.append(f"{samples.name:14}{postures:13}" + " | ".join(cells))
    ways = Counter(ending.how.split()[0] for ending in endings if ending.outcome == "stopped")
    lines.append(f"{'':14}stopped in MuJoCo: {ways['followed']} followed, {ways['closed']} closed")
    differ = [(case, ending) for case, ending in zip(chosen, endings, strict=True) if ending.outcome != case.label]
    return lines + [f"  {samples.name} {_told(samples, case, ending)}" for case, ending in differ]


def _told(samples: Samples, case: Case, ending: Ending) -> str:
    """A disagreement in words."""
    return (
        f"{samples.index[case.row]}: {case.label} -> {ending.outcome} at {ending.time:.2f} s, {ending.how}, commands for "
        f"{ending.commanded:.2f} s, contact moved {1e3 * ending.moved:.0f} mm, |v| {ending.speed:.3f}, effort "
        f"{samples.effort[case.row]:.2f}{', lost: ' * bool(ending.lost)}{ending.lost}"
    )


def main(arguments: list[str] | None = None) -> None:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.mujoco_check", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=int, default=2, metavar="N", help="stops and falls of each file (default: 2)")
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS), metavar="FILE", help="names of files")
    parser.add_argument("--data", type=Path, default=DATA, metavar="FOLDER")
    parser.add_argument("--slow", type=float, default=0.05, help="|v| of a stop: contacts are soft here (default: 0.05)")
    parser.add_argument("--folder", type=Path, metavar="DIR", help="where runs are kept (default: a temporary folder)")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="processes (default: 1)")
    options = parser.parse_args(arguments)
    if options.samples < 1:
        parser.error(f"--samples {options.samples} (expected at least 1)")
    words = "".join(f"{word:>10}" for word in ("stopped", "fallen", "undecided"))
    print(f"mujoco {mujoco.__version__}\n{'file':14}{'postures':13}{'stops':>8}{words} | {'falls':>8}{words}", flush=True)
    with tempfile.TemporaryDirectory() as temporary:
        options.folder = options.folder or Path(temporary)
        options.folder.mkdir(parents=True, exist_ok=True)
        for name in options.scenarios:
            start = time.perf_counter()
            print(*check(options.data / f"{name}.parquet", options), sep="\n")
            print(f"  ({time.perf_counter() - start:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
