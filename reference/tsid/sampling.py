"""Random robot states in multi-contact (V-B): a posture in static equilibrium on its contacts, then a push.

Sample `index` of a scenario is a function of robot, scenario, seed and index alone: each has its own random stream, so that
it is the same whoever draws it, alone or in any order.

Postures: joints = home + 0.15 range N(0, 1), clipped to 1 % of the range inside their limits. The left foot's rectangle is
put at the world's origin, its length along x: flat for `two_coplanar`, else tilted about a random horizontal axis by
U(0, 0.5) rad. `two_coplanar`: the right leg is moved by inverse kinematics until that foot lies in the plane z = 0. Else:
the contact surfaces are where the effectors are, the right foot's normal within 60 degrees of vertical. A posture is drawn
again until the CoM is in static equilibrium with the pyramids that the controller uses and nothing collides.

States are rounded to single precision before anything is computed from them, so that a file of float32 holds exactly what
was simulated: q is the normalised value (`restore`) of its float32 rounding, v is float32.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from reference.tsid.push import DECELERATION, STEPS, push
from reference.tsid.robot import Contact, Robot, Sample
from reference.tsid.wrench_cone import equilibrium

SCENARIOS = ("two_coplanar", "two", "three", "four", "four_strong")
"""Feet on one plane; feet anywhere; feet and one hand, left or right; feet and hands; the same postures as those of `four`,
pushed harder. The order of the first four is part of the seed."""

STRONG = "_strong"
"""How the name of a scenario ends whose pushes are `strong` ones."""

FRICTION = 0.5
"""mu of every contact [-]."""

SPREAD = 0.15
"""Standard deviation of a joint, share of its range [-]."""

MARGIN = 0.01
"""Least distance from a joint limit, share of the range [-]."""

TILT = 0.5
"""Greatest inclination of the left foot [rad]."""

STEEPEST = 0.5
"""Least vertical component of the right foot's normal: cos(60 deg) [-]."""

ATTEMPTS = 20000
"""Postures drawn for one sample before giving up."""

FLAT = 1e-9
"""Height [m] and normal's tangential components [-] of a foot that inverse kinematics has put on the plane."""

NEWTON_STEPS = 30

DISTRIBUTION = {
    "friction": FRICTION,
    "spread": SPREAD,
    "margin": MARGIN,
    "tilt": TILT,
    "steepest": STEEPEST,
    "deceleration": DECELERATION,
    "hit_and_run_steps": STEPS,
}
"""What a file of samples should say of them."""


def draw(robot: Robot, scenario: str, seed: int, index: int, zero_momentum: bool = False) -> Sample:
    """Sample `index` of a scenario. World frame: z up, left foot's rectangle at the origin.

    zero_momentum: the same posture, pushed without angular momentum about the centre of mass.
    Raises ValueError naming an unknown scenario, ArithmeticError where `ATTEMPTS` postures are all refused.
    """
    if scenario not in SCENARIOS:
        raise ValueError(f"scenario = {scenario!r} (expected one of: {', '.join(SCENARIOS)})")
    strong, scenario_of_postures = scenario.endswith(STRONG), scenario.removesuffix(STRONG)
    rng = np.random.default_rng(np.random.SeedSequence((seed, SCENARIOS.index(scenario_of_postures), index)))
    data, shapes = robot.model.createData(), robot.collisions.createData()
    for _ in range(ATTEMPTS):
        effectors = _effectors(scenario_of_postures, rng)
        q = posture(robot, data, scenario, rng)
        if q is None:
            continue
        contacts = place(robot, data, q, effectors)
        if scenario != "two_coplanar" and contacts[1].placement.rotation[2, 2] < STEEPEST:
            continue
        if not equilibrium(contacts, pin.centerOfMass(robot.model, data, q), robot.model.gravity.linear):
            continue
        if not pin.computeCollisions(robot.model, data, robot.collisions, shapes, q, True):
            return Sample(scenario, seed, index, q, push(robot, q, effectors, rng, zero_momentum, strong), contacts)
    raise ArithmeticError(f"{robot.name}, {scenario}, sample {index}: none of {ATTEMPTS} postures is in equilibrium")


def restore(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """The configuration (nq,), float64, that a row of float32 values stands for: its quaternion normalised."""
    return pin.normalize(model, np.asarray(q, dtype=float))


def place(robot: Robot, data: pin.Data, q: np.ndarray, effectors: Sequence[str]) -> tuple[Contact, ...]:
    """Contacts where the effectors are at q (nq,)."""
    pin.framesForwardKinematics(robot.model, data, q)
    contacts = []
    for name in effectors:
        effector = robot.effectors[name]
        at = data.oMf[effector.frame] * effector.placement
        contacts.append(Contact(name, at, effector.half_length, effector.half_width, FRICTION))
    return tuple(contacts)


def posture(robot: Robot, data: pin.Data, scenario: str, rng: np.random.Generator) -> np.ndarray | None:
    """A random configuration (nq,) on the left foot, rounded; None where the right foot does not reach the plane."""
    reach = robot.upper - robot.lower
    lowest, highest = robot.lower + MARGIN * reach, robot.upper - MARGIN * reach
    q = pin.neutral(robot.model)
    q[7:] = np.clip(robot.home[7:] + SPREAD * reach * rng.standard_normal(len(reach)), lowest, highest)
    rotation = np.eye(3)
    if scenario != "two_coplanar":
        direction, angle = 2 * np.pi * rng.random(), TILT * rng.random()
        rotation = pin.exp3(angle * np.array([np.cos(direction), np.sin(direction), 0.0]))
    left = place(robot, data, q, ["left_foot"])[0].placement
    q[:7] = pin.SE3ToXYZQUAT(pin.SE3(rotation, np.zeros(3)) * left.inverse())
    if scenario == "two_coplanar" and not _step_down(robot, data, q, lowest, highest):
        return None
    return _rounded(robot.model, q)


def _effectors(scenario: str, rng: np.random.Generator) -> tuple[str, ...]:
    hands = {"three": [("left_hand",), ("right_hand",)], "four": [("left_hand", "right_hand")]}.get(scenario, [()])
    return ("left_foot", "right_foot", *hands[rng.integers(len(hands))])


def _step_down(robot: Robot, data: pin.Data, q: np.ndarray, lowest: np.ndarray, highest: np.ndarray) -> bool:
    """Move the right leg's joints in q, in place, until that foot is flat on z = 0; False where it cannot.

    Newton steps of least norm on the height and the normal's two tangential components, clipped to the limits.
    """
    foot = robot.effectors["right_foot"]
    legs = [
        robot.model.supports[robot.model.frames[robot.effectors[side].frame].parentJoint]
        for side in ("left_foot", "right_foot")
    ]
    leg = np.array([robot.model.joints[joint].idx_v for joint in legs[1] if joint not in set(legs[0])])
    for _ in range(NEWTON_STEPS):
        at = place(robot, data, q, ["right_foot"])[0].placement
        normal = at.rotation[:, 2]
        error = np.array([at.translation[2], normal[0], normal[1]])
        if np.abs(error).max() < FLAT:
            return bool(normal[2] > 0)
        local = foot.placement.inverse().action @ pin.computeFrameJacobian(robot.model, data, q, foot.frame, pin.LOCAL)
        linear, angular = at.rotation @ local[:3, leg], at.rotation @ local[3:, leg]
        turning = np.cross(angular.T, normal).T  # velocity of the normal
        step = np.linalg.lstsq(np.vstack([linear[2], turning[:2]]), -error, rcond=None)[0]
        q[leg + 1] = np.clip(q[leg + 1] + step, lowest[leg - 6], highest[leg - 6])
    return False


def _rounded(model: pin.Model, q: np.ndarray) -> np.ndarray | None:
    """The nearest configuration that `restore` gives back from its own float32 rounding; None in the rare case of none."""
    for _ in range(5):
        single = q.astype(np.float32)
        q = restore(model, single)
        if np.array_equal(q.astype(np.float32), single):
            return q
    return None
