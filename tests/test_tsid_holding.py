"""The effort of a posture: by another program, and as it must change with limits, contacts and free limbs."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import linprog

from reference.tsid.controller import CONFIGURATIONS
from reference.tsid.holding import carrying, effort
from reference.tsid.push import contact_jacobian
from reference.tsid.robot import load
from reference.tsid.sampling import draw
from reference.tsid.simulator import DEFAULT, Outcome, Simulator
from reference.tsid.wrench_cone import wrench_cone

TALOS = load("talos")
HELD, LOST = (0, 1, 2), (0, 3, 5)
"""Samples of `three` that can be held, and of `four` that cannot (seed 2018)."""


@pytest.mark.parametrize("scenario", ["two_coplanar", "three", "four"])
def test_the_torque_for_standing_is_that_of_an_independent_program(scenario):
    """In wrenches and the rows of their cones, where `effort` has weights on the edges."""
    sample = draw(TALOS, scenario, 2018, 1)
    data = TALOS.model.createData()
    pin.framesForwardKinematics(TALOS.model, data, sample.q)
    jacobian = contact_jacobian(TALOS, data, sample.q, [contact.effector for contact in sample.contacts])
    gravity = pin.rnea(TALOS.model, data, sample.q, np.zeros(TALOS.model.nv), np.zeros(TALOS.model.nv))
    k, carry = len(sample.contacts), carrying(TALOS, sample.contacts)
    cones = np.zeros((16 * k, 6 * k + 1))
    for i, contact in enumerate(sample.contacts):
        rows = wrench_cone(contact.half_length, contact.half_width, contact.friction)
        cones[16 * i : 16 * i + 16, 6 * i : 6 * i + 6] = rows
    pushes, own, limit = jacobian.T, jacobian.T[6:][carry], TALOS.torque[carry, None]
    torques = np.block([[-own, -limit], [own, -limit]])
    bounds = np.concatenate([-gravity[6:][carry], gravity[6:][carry], np.zeros(16 * k)])
    base = np.column_stack([pushes[:6], np.zeros(6)])
    cost = np.append(np.zeros(6 * k), 1.0)
    rows = np.concatenate([torques, cones])
    result = linprog(cost, A_ub=rows, b_ub=bounds, A_eq=base, b_eq=gravity[:6], bounds=(None, None), method="highs")
    assert effort(TALOS, sample.q, sample.contacts) == pytest.approx(result.fun, rel=1e-6)


def test_twice_the_limits_take_half_the_share():
    sample = draw(TALOS, "two", 2018, 1)
    strong = TALOS._replace(torque=2 * TALOS.torque)
    assert effort(TALOS, sample.q, sample.contacts) == pytest.approx(2 * effort(strong, sample.q, sample.contacts))


def test_only_joints_between_base_and_contacts_count():
    three = draw(TALOS, "three", 2018, 0)
    names = np.array(list(TALOS.model.names)[2:])
    side = three.contacts[2].effector.split("_")[0]
    counted = set(names[carrying(TALOS, three.contacts)])
    assert {name for name in counted if name.startswith("arm")} == {name for name in names if name.startswith(f"arm_{side}")}
    assert {"torso_1_joint", "torso_2_joint", "leg_left_1_joint", "leg_right_6_joint"} <= counted
    assert "head_1_joint" not in counted
    weak = TALOS._replace(torque=np.where(carrying(TALOS, three.contacts), TALOS.torque, 1e-6))
    assert effort(weak, three.q, three.contacts) == effort(TALOS, three.q, three.contacts)


def with_friction(sample, friction):
    return [contact._replace(friction=friction) for contact in sample.contacts]


def test_more_friction_never_takes_more():
    for index in range(4):
        sample = draw(TALOS, "four", 2018, index)
        efforts = [effort(TALOS, sample.q, with_friction(sample, friction)) for friction in (0.5, 0.7, 1.0)]
        assert np.all(np.diff(efforts) <= 1e-9) and efforts[2] < efforts[0]


@pytest.mark.parametrize("index", range(3))
def test_what_can_be_held_stands_without_a_push_and_what_cannot_falls(index):
    simulator = Simulator(TALOS, CONFIGURATIONS["standard"], DEFAULT._replace(dwell=0.2))  # at rest it has stopped at once
    for scenario, at, held in (("three", HELD, True), ("four", LOST, False)):
        sample = draw(TALOS, scenario, 2018, at[index])
        assert (effort(TALOS, sample.q, sample.contacts) <= 1) is held
        run = simulator.run(sample._replace(v=0 * sample.v))
        assert (run.outcome == Outcome.STOPPED) is held


def test_without_equilibrium_there_is_no_effort():
    sample = draw(TALOS, "two", 2018, 1)
    with pytest.raises(ArithmeticError, match="effort: HiGHS ended with status 2"):
        effort(TALOS, sample.q, with_friction(sample, 0.01))
