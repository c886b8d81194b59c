"""Make robot states for the predictor: TALOS and ANYmal in four stances, contacts kept and at rest.

    python -m bench.robot_states -o bench/data

For each stance: <stance>.parquet with centroidal states and <stance>.yaml with the contacts. A posture is the stance's
nominal one plus random changes of all joints and of the base, brought back to the contacts by Newton's method; it is
drawn again where a joint leaves its limits or the robot touches itself or a surface that it should not. A velocity is
random joint velocities plus the motion that gives the CoM a random velocity, all in the null space of the contact
Jacobian. Sample i of a stance depends on (seed, stance, i) only.
"""

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.optimize import linprog

from jaxcap import robots
from jaxcap.files.whole_file import whole_file

SEED = 2018
RESIDUAL = 1e-10
"""Largest contact error that is kept [m, rad]."""
REACH = 0.9
"""Largest change of a joint from the nominal posture [rad]: limits of ANYmal's joints in the URDF are dummies."""
JOINT_SPREAD, JOINT_SPREAD_MAX = 0.15, 0.4
"""Standard deviation of the joint changes: part of the joint's range, and at most [rad]."""
BASE_SPREAD = (0.12, 0.12, 0.06, 0.2, 0.2, 0.2)
"""Standard deviation of the base's changes [m, rad]."""
SPEED = 1.5
"""Largest CoM speed asked for [m/s]; joint velocity limits may lower it."""
STATIC_SAMPLES = 300
"""How many states of each stance the closing table tests for static equilibrium."""


class Contact(NamedTuple):
    """Where a patch or a point of the robot rests. World frame."""

    name: str
    """Key of `robots.TALOS_CONTACTS` (a rectangle) or `robots.ANYMAL_FEET` (a point)."""
    position: tuple[float, float, float]
    rotation: np.ndarray
    friction: float
    surface: tuple[float, float] = (0.02, 0.02)
    """Half sizes [m] of the slab that stands for the surface, which links that are not on a contact may not touch."""


class Stance(NamedTuple):
    """A robot on its contacts."""

    name: str
    about: str
    robot: str
    posture: str
    joints: dict[str, float]
    """Joint positions near the nominal posture where they differ from the robot's posture [rad]."""
    contacts: tuple[Contact, ...]


def _left_arm(*angles) -> dict[str, float]:
    return {f"arm_left_{i}_joint": angle for i, angle in enumerate(angles, start=1)}


def _tilted(roll: float, pitch: float) -> np.ndarray:
    return pin.rpy.rpyToMatrix(roll, pitch, 0.0)


FLAT = np.eye(3)
AHEAD = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # a wall: tangents y and -z, normal -x
TWO_FEET = (
    Contact("left_sole", (0.0, 0.085, 0.0), FLAT, 0.5, (1.0, 1.0)),
    Contact("right_sole", (0.0, -0.085, 0.0), FLAT, 0.5, (1.0, 1.0)),
)
FOUR_FEET = tuple(
    Contact(name, (0.37 if "front" in name else -0.37, 0.2 if "left" in name else -0.2, 0.0), FLAT, 0.7)
    for name in robots.ANYMAL_FEET
)
STANCES = (
    Stance("talos_two_feet", "TALOS, half sitting, two feet on flat ground", "talos", "half_sitting", {}, TWO_FEET),
    Stance(
        "talos_hand_on_wall",
        "TALOS, two feet on flat ground, left hand on a wall ahead",
        "talos",
        "half_sitting",
        _left_arm(-0.219, 0.835, -0.465, -1.701, 0.930, 0.616, -0.309),
        (*TWO_FEET, Contact("left_hand", (0.55, 0.35, 1.1), AHEAD, 0.5, (1.0, 1.0))),
    ),
    Stance(
        "talos_slopes_and_rail",
        "TALOS, two feet on slopes, left hand on a flat-topped rail that rises ahead",
        "talos",
        "half_sitting",
        _left_arm(-0.109, 1.282, -1.031, -1.331, -0.017, -0.511, 0.073),
        (
            Contact("left_sole", (0.0, 0.11, 0.0), _tilted(0.25, 0.0), 0.5, (0.15, 0.1)),
            Contact("right_sole", (0.08, -0.11, 0.04), _tilted(0.0, -0.25), 0.5, (0.15, 0.1)),
            Contact("left_hand", (0.2, 0.55, 0.8), _tilted(0.0, -0.2), 0.5, (0.5, 0.03)),
        ),
    ),
    Stance("anymal_four_points", "ANYmal B, four point feet on flat ground", "anymal", "standing", {}, FOUR_FEET),
)


class Sampler:
    """Random states of one stance. Sample i depends on the seed, the stance and i only."""

    def __init__(self, stance: Stance, seed: int = SEED):
        self.stance, self.seed = stance, seed
        self.number = [s.name for s in STANCES].index(stance.name)
        robot = getattr(robots, stance.robot)(collisions=True)
        self.model, self.collisions = robot.model, robot.collisions
        self.frames = [_add_frame(self.model, contact.name) for contact in stance.contacts]
        self._add_surfaces()
        self.data, self.collision_data = self.model.createData(), self.collisions.createData()
        guess = robot.postures[stance.posture]
        for name, angle in stance.joints.items():
            guess[self.model.joints[self.model.getJointId(name)].idx_q] = angle
        self.nominal = self.project(guess)
        if self.nominal is None or self.collides(self.nominal):
            raise RuntimeError(f"{stance.name}: no nominal posture keeps the contacts without self-collision")
        self.lower = np.maximum(self.model.lowerPositionLimit, self.nominal - REACH)[7:]
        self.upper = np.minimum(self.model.upperPositionLimit, self.nominal + REACH)[7:]
        joints = self.model.upperPositionLimit[7:] - self.model.lowerPositionLimit[7:]
        self.spread = np.concatenate([BASE_SPREAD, np.minimum(JOINT_SPREAD * joints, JOINT_SPREAD_MAX)])
        # velocities in units that make all coordinates alike: 1 m/s and 1 rad/s for the base, the limit for a joint
        self.scale = np.concatenate([np.ones(6), self.model.upperVelocityLimit[6:]])

    def _add_surfaces(self, thickness: float = 0.04):
        """A slab under each contact, paired with all links that are on no contact."""
        touching = {self.model.frames[frame].parentJoint for frame in self.frames}
        others = [i for i, o in enumerate(self.collisions.geometryObjects) if o.parentJoint not in touching]
        for contact in self.stance.contacts:
            slab = coal.Box(*(2 * half for half in contact.surface), thickness)
            centre = np.array(contact.position) - thickness / 2 * contact.rotation[:, 2]
            shape = pin.GeometryObject("under_" + contact.name, 0, pin.SE3(contact.rotation, centre), slab)
            surface = self.collisions.addGeometryObject(shape)
            for other in others:
                self.collisions.addCollisionPair(pin.CollisionPair(other, surface))

    def contact_error(self, q):
        """Contact error [m, rad] and its Jacobian at q, stacked over the contacts: 6 rows a patch, 3 a point."""
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        errors, jacobians = [], []
        for contact, frame in zip(self.stance.contacts, self.frames, strict=True):
            actual = self.data.oMf[frame]
            if contact.name in robots.TALOS_CONTACTS:
                error = pin.SE3(contact.rotation, np.array(contact.position)).actInv(actual)
                errors.append(pin.log6(error).vector)
                jacobians.append(pin.Jlog6(error) @ pin.getFrameJacobian(self.model, self.data, frame, pin.LOCAL))
            else:
                errors.append(actual.translation - contact.position)
                jacobians.append(pin.getFrameJacobian(self.model, self.data, frame, pin.LOCAL_WORLD_ALIGNED)[:3])
        return np.concatenate(errors), np.vstack(jacobians)

    def project(self, q, iterations: int = 30):
        """The posture on the contacts that Newton's method (least change in each step) finds from q, or None."""
        for _ in range(iterations):
            error, jacobian = self.contact_error(q)
            if np.abs(error).max() < RESIDUAL:
                return q
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T, error)
            q = pin.integrate(self.model, q, -step * min(1.0, 0.5 / np.abs(step).max()))
        return None

    def collides(self, q) -> bool:
        """Whether the robot touches itself, or a surface with a link that is on no contact."""
        return pin.computeCollisions(self.model, self.data, self.collisions, self.collision_data, q, True)

    def sample(self, i: int):
        """Configuration (nq,) and velocity (nv,) of sample i, in Pinocchio's conventions."""
        rng = np.random.default_rng([self.seed, self.number, i])
        while True:
            change = rng.uniform() * self.spread * rng.standard_normal(self.model.nv)
            q = self.project(pin.integrate(self.model, self.nominal, change))
            if q is not None and (self.lower <= q[7:]).all() and (q[7:] <= self.upper).all() and not self.collides(q):
                return q, self.velocity(q, rng)

    def velocity(self, q, rng):
        """A random velocity (nv,) that keeps the contacts at rest, within the joints' velocity limits."""
        _, jacobian = self.contact_error(q)
        null = np.linalg.svd(jacobian * self.scale)[2][len(jacobian) :].T  # the Jacobians here have full rank
        com = pin.jacobianCenterOfMass(self.model, self.data, q) * self.scale @ null
        direction = rng.standard_normal(3) * (1.0, 1.0, 0.4)
        target = rng.uniform(0, SPEED) * direction / np.linalg.norm(direction)
        motion = null.T @ (0.1 * rng.uniform() * rng.standard_normal(self.model.nv))
        motion += np.linalg.pinv(com) @ (target - com @ motion)
        v = self.scale * (null @ motion)
        return v / max(1.0, np.abs(v / self.scale)[6:].max())


def _add_frame(model, name: str) -> int:
    """The frame of a contact, added to the model (a patch) or already there (a foot)."""
    if name not in robots.TALOS_CONTACTS:
        return model.getFrameId(robots.ANYMAL_FEET[name].frame)
    patch = robots.TALOS_CONTACTS[name]
    link = model.getFrameId(patch.frame)
    placement = model.frames[link].placement * pin.SE3(np.array(patch.rotation), np.array(patch.position))
    return model.addFrame(pin.Frame(name, model.frames[link].parentJoint, link, placement, pin.FrameType.OP_FRAME))


def in_equilibrium(com, contacts) -> bool:
    """Whether forces in the 4-edge friction pyramids can hold a robot at rest with this CoM: a linear program."""
    rays = []
    for contact in contacts:
        patch = robots.TALOS_CONTACTS.get(contact.name)
        half = (patch.half_length, patch.half_width) if patch else (0.0, 0.0)
        for corner in ((1, 1), (-1, 1), (-1, -1), (1, -1)) if patch else ((0, 0),):
            point = contact.position + contact.rotation[:, :2] @ (np.array(half) * corner) - com
            for angle in np.pi / 4 + np.pi / 2 * np.arange(4):
                force = contact.rotation @ [contact.friction * np.cos(angle), contact.friction * np.sin(angle), 1.0]
                rays.append(np.concatenate([force, np.cross(point, force)]))
    return linprog(np.zeros(len(rays)), A_eq=np.transpose(rays), b_eq=[0, 0, 1, 0, 0, 0]).status == 0


def contact_file(stance: Stance) -> bytes:
    """The contacts as YAML text."""
    lines = [f"# {stance.about}; states in {stance.name}.parquet. Made by bench/robot_states.py."]
    lines += ["# World frame, z up, metres. Columns of a rotation: tangent, tangent, normal pointing at the robot."]
    lines += ["contacts:"]
    for contact in stance.contacts:
        patch = robots.TALOS_CONTACTS.get(contact.name)
        lines += [f"  - type: {'rectangle' if patch else 'point'}", f"    name: {contact.name}"]
        lines += [f"    position: {list(contact.position)}", f"    rotation: {(contact.rotation + 0.0).tolist()}"]
        if patch:
            lines += [f"    half_length: {patch.half_length}", f"    half_width: {patch.half_width}"]
        lines += [f"    friction: {contact.friction}"]
    return ("\n".join(lines) + "\n").encode()


def state_file(stance: Stance, states: robots.CentroidalStates, seed: int) -> bytes:
    """The states as a Parquet file, units and conventions in its metadata."""
    about = {
        "robot": f"{stance.robot} of example-robot-data 6",
        "stance": stance.about,
        "frame": "world, z up",
        "conventions": "angular_momentum is about the CoM; base velocities entered Pinocchio in the base frame",
        "units": "com: m, com_velocity: m/s, angular_momentum: kg m^2/s",
        "seed": str(seed),
        "made_by": f"bench/robot_states.py --samples {len(states.com)} --seed {seed}, pinocchio {pin.__version__}",
    }
    columns = {k: pa.FixedSizeListArray.from_arrays(x.ravel(), 3) for k, x in states._asdict().items()}
    table = pa.table({**columns, "sample": np.arange(len(states.com), dtype=np.int32)}).replace_schema_metadata(about)
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd", use_dictionary=False)
    return sink.getvalue().to_pybytes()


def generate(stance: Stance, samples: int, seed: int) -> robots.CentroidalStates:
    """The centroidal states of samples 0, 1, ..."""
    sampler = Sampler(stance, seed)
    q, v = np.empty((samples, sampler.model.nq)), np.empty((samples, sampler.model.nv))
    for i in range(samples):
        q[i], v[i] = sampler.sample(i)
        if sys.stderr.isatty() and (i + 1) % 100 == 0:
            print(f"\r{stance.name}: {i + 1} of {samples}", end="\n" if i + 1 == samples else "", file=sys.stderr)
    return robots.centroidal_states(sampler.model, q, v)


def main(arguments=None) -> None:
    """Parse, generate, write, tell."""
    parser = argparse.ArgumentParser(prog="python -m bench.robot_states", description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the files")
    parser.add_argument("--samples", type=int, default=5000, help="states for each stance (default: 5000)")
    parser.add_argument("--seed", type=int, default=SEED, help=f"at least 0 (default: {SEED})")
    parser.add_argument("--force", action="store_true", help="replace files that exist")
    options = parser.parse_args(arguments)
    if options.samples < 1 or options.seed < 0:
        parser.error(f"--samples {options.samples} --seed {options.seed} (expected at least 1 and at least 0)")
    paths = [options.output / f"{stance.name}.{kind}" for stance in STANCES for kind in ("parquet", "yaml")]
    if (existing := [path for path in paths if path.exists()]) and not options.force:
        parser.error(f"{existing[0]} exists (--force replaces it)")
    options.output.mkdir(parents=True, exist_ok=True)
    print(f"{'stance':24}{'states':>8}{'kB':>7}   CoM speed, 10 / 50 / 90 % [m/s]   CoM in static equilibrium")
    for stance in STANCES:
        states = generate(stance, options.samples, options.seed)
        content = state_file(stance, states, options.seed)
        for extension, found in (("parquet", content), ("yaml", contact_file(stance))):
            with whole_file(options.output / f"{stance.name}.{extension}", force=True) as file:
                file.write(found)
        speed = np.quantile(np.linalg.norm(states.com_velocity, axis=1), [0.1, 0.5, 0.9])
        static = np.mean([in_equilibrium(com, stance.contacts) for com in states.com[:STATIC_SAMPLES]])
        numbers = f"{options.samples:8}{len(content) / 1e3:7.0f}   " + "   ".join(f"{x:4.2f}" for x in speed)
        print(f"{stance.name:24}{numbers:54}{static:4.0%} of the first {STATIC_SAMPLES}")


if __name__ == "__main__":
    main()
