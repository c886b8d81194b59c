"""Runs obey the laws of motion and of contact, are what they claim to be, and depend on their sample alone."""

import numpy as np
import pinocchio as pin
import pytest

from reference.tsid.controller import CONFIGURATIONS
from reference.tsid.push import contact_jacobian
from reference.tsid.robot import load
from reference.tsid.sampling import SCENARIOS, draw
from reference.tsid.simulator import Options, Outcome, Simulator
from reference.tsid.wrench_cone import wrench_cone

COUNT = 2
RESCUED = 33
"""A sample of `three` that only "brake" stops."""
DWELL = 200
"""Steps for which a stop lasts in `runs`: those of LASTING."""
LASTING = Options(dwell=0.2)


@pytest.fixture(scope="module")
def robot():
    return load("talos")


@pytest.fixture(scope="module")
def samples(robot):
    return [draw(robot, scenario, 7, index) for scenario in SCENARIOS for index in range(COUNT)]


@pytest.fixture(scope="module")
def runs(robot, samples):
    """Longer than those without a dwell, which are their beginnings."""
    simulator = Simulator(robot, CONFIGURATIONS["standard"], LASTING)
    return [simulator.run(sample, trace=True) for sample in samples]


def commanded(run):
    """Steps of a trace that were carried out."""
    return range(run.steps)


def test_both_outcomes_occur_and_are_what_they_say(runs):
    assert {Outcome.STOPPED, Outcome.FALLEN} <= {run.outcome for run in runs}
    for run in runs:
        trace = run.trace
        speed = np.linalg.norm(trace.v, axis=1)
        assert len(trace.t) == run.steps + 1 and run.time == trace.t[-1]
        slow = speed < 0.01
        assert not any(slow[i : i + DWELL + 1].all() for i in range(run.steps - DWELL))
        np.testing.assert_array_equal(run.com_end, trace.com[-1])
        if run.outcome == Outcome.STOPPED:
            assert run.reason == "stopped" and slow[-DWELL - 1 :].all() and len(slow) > DWELL
        elif run.reason == "infeasible":
            assert run.outcome == Outcome.FALLEN and run.counters["certified"] == 1 and trace.status[-1] == 1
        assert (trace.status[:-1] == 0).all()


def test_newton_euler(robot, samples, runs):
    """Inverse dynamics of the trace, contact wrenches applied, gives its torques and nothing at the base."""
    model, data = robot.model, robot.model.createData()
    for sample, run in zip(samples, runs, strict=True):
        for i in commanded(run)[::50]:
            q, v, a = run.trace.q[i], run.trace.v[i], run.trace.a[i]
            jacobian = contact_jacobian(robot, data, q, [contact.effector for contact in sample.contacts])
            residual = pin.rnea(model, data, q, v, a) - jacobian.T @ run.trace.wrenches[i].ravel()
            residual[6:] -= run.trace.tau[i]
            assert np.abs(residual).max() < 1e-6


def test_the_integrator_is_semi_implicit(robot, runs):
    for run in runs:
        for i in commanded(run)[::100]:
            trace = run.trace
            np.testing.assert_array_equal(trace.v[i + 1], trace.v[i] + 1e-3 * trace.a[i])
            np.testing.assert_array_equal(trace.q[i + 1], pin.integrate(robot.model, trace.q[i], 1e-3 * trace.v[i + 1]))


def test_contacts_stay_at_rest(robot, samples, runs):
    data = robot.model.createData()
    for sample, run in zip(samples, runs, strict=True):
        for i in range(0, run.steps + 1, 50):
            pin.framesForwardKinematics(robot.model, data, run.trace.q[i])
            for contact in sample.contacts:
                effector = robot.effectors[contact.effector]
                moved = contact.placement.actInv(data.oMf[effector.frame] * effector.placement)
                assert np.linalg.norm(moved.translation) < 2e-3 and np.linalg.norm(pin.log3(moved.rotation)) < 1e-2
            jacobian = contact_jacobian(robot, data, run.trace.q[i], [contact.effector for contact in sample.contacts])
            assert np.abs(jacobian @ run.trace.v[i]).max() < 0.05


def test_wrenches_are_in_their_cones(samples, runs):
    for sample, run in zip(samples, runs, strict=True):
        for i, contact in enumerate(sample.contacts):
            cone = wrench_cone(contact.half_length, contact.half_width, contact.friction)
            assert (run.trace.wrenches[: run.steps, i] @ cone.T).max(initial=-1.0) < 0.05


def test_torques_and_joints_keep_their_limits(robot, runs, largest=10.0):
    for run in runs:
        trace = run.trace
        assert (np.abs(trace.tau[: run.steps]) <= robot.torque + 1e-2).all()
        assert (np.abs(trace.a[: run.steps, 6:]) <= largest + 1e-3).all()
        assert (np.abs(trace.v[:, 6:]) <= robot.speed + 1e-4).all()
        assert (trace.q[:, 7:] <= robot.upper + 1e-5).all() and (trace.q[:, 7:] >= robot.lower - 1e-5).all()


def energy_gap(robot, sample, dt, duration):
    """Change of mechanical energy less the torques' work over a time, and the initial kinetic energy [J]."""
    options = Options(dt=dt, time_limit=duration)
    trace = Simulator(robot, CONFIGURATIONS["standard"], options).run(sample, trace=True).trace
    data = robot.model.createData()
    energy = [pin.computeMechanicalEnergy(robot.model, data, trace.q[i], trace.v[i]) for i in (0, -1)]
    mean_speed = 0.5 * (trace.v[:-1, 6:] + trace.v[1:, 6:])
    work = dt * (trace.tau[:-1] * mean_speed).sum()
    return energy[1] - energy[0] - work, pin.computeKineticEnergy(robot.model, data, trace.q[0], trace.v[0])


def test_energy_changes_by_the_work_of_the_torques(robot, samples, runs):
    """To the first order of the integrator, so half the step has about half the gap."""
    sample = next(s for s, run in zip(samples, runs, strict=True) if run.outcome == Outcome.STOPPED and run.steps > 300)
    (coarse, kinetic), (fine, _) = (energy_gap(robot, sample, dt, 0.2) for dt in (1e-3, 5e-4))
    assert abs(coarse) < 0.02 * kinetic
    assert abs(fine) < 0.7 * abs(coarse)


def test_com_velocity_is_the_com_s(runs):
    for run in runs:
        if run.steps > 2:
            steps = np.diff(run.trace.com, axis=0) / 1e-3
            np.testing.assert_allclose(steps, run.trace.com_velocity[1:], atol=5e-3)


def test_a_run_depends_on_its_sample_alone(robot, samples, runs):
    """The same bits, alone, in another order, with and without a trace."""
    simulator = Simulator(robot, CONFIGURATIONS["standard"], LASTING)
    for i in (5, 2, 0):
        again = simulator.run(samples[i])
        assert again.trace is None
        assert again.com_end.tobytes() == runs[i].com_end.tobytes()
        assert again[:4] == runs[i][:4] and again.counters == runs[i].counters


def test_without_a_push_the_robot_has_stopped(robot, samples):
    still = samples[0]._replace(v=np.zeros(robot.model.nv))
    run = Simulator(robot, CONFIGURATIONS["standard"]).run(still)
    assert (run.outcome, run.reason, run.steps, run.time) == (Outcome.STOPPED, "stopped", 0, 0.0)
    run = Simulator(robot, CONFIGURATIONS["standard"], LASTING).run(still)
    assert (run.outcome, run.reason, run.steps, run.time) == (Outcome.STOPPED, "stopped", DWELL, 0.2)


def test_a_dwell_changes_nothing_before_the_first_dip(robot, samples, runs):
    """The run without a dwell, the default, is the beginning of the run with one, and ends where that is slow first."""
    simulator = Simulator(robot, CONFIGURATIONS["standard"])
    for sample, run in zip(samples, runs, strict=True):
        slow = np.linalg.norm(run.trace.v, axis=1) < 0.01
        first = int(slow.argmax()) if slow.any() else run.steps
        short = simulator.run(sample, trace=True)
        assert "dips" not in short.counters
        assert short.steps == first and (short.outcome == Outcome.STOPPED) == slow.any()
        assert (run.outcome == Outcome.STOPPED or run.counters.get("dips", 0) > 0) == slow.any()
        np.testing.assert_array_equal(short.trace.v, run.trace.v[: first + 1])


def test_brake_stops_within_the_limits(robot):
    """A robot that the three let fall; the laws are those of every run."""
    sample = draw(robot, "three", 2018, RESCUED)
    four = (Simulator(robot, CONFIGURATIONS[name]) for name in ("standard", "straight", "fast", "brake"))
    runs = [simulator.run(sample, trace=True) for simulator in four]
    assert [run.outcome for run in runs] == [Outcome.FALLEN] * 3 + [Outcome.STOPPED]
    test_torques_and_joints_keep_their_limits(robot, runs[3:], 30.0)
    test_wrenches_are_in_their_cones([sample], runs[3:])
    test_newton_euler(robot, [sample], runs[3:])


def test_feasible_at_rest_is_never_fallen(robot, samples):
    """A robot in static equilibrium, barely moving, is not labelled fallen by any controller."""
    for sample in samples[::COUNT]:
        slow = sample._replace(v=sample.v * 0.02 / np.linalg.norm(sample.v))
        for name in ("standard", "fast", "straight"):
            assert Simulator(robot, CONFIGURATIONS[name]).run(slow).outcome == Outcome.STOPPED


def test_time_is_a_third_outcome(robot, samples, runs):
    index = next(i for i, run in enumerate(runs) if run.steps > 50)
    run = Simulator(robot, CONFIGURATIONS["standard"], Options(time_limit=0.02)).run(samples[index])
    assert (run.outcome, run.reason, run.steps, run.time) == (Outcome.UNDECIDED, "time", 20, 0.02)


def test_a_slipping_contact_is_a_fall(robot, samples, runs):
    """With a tolerance below what stabilisation leaves, a run ends where a contact has moved as far."""
    index = next(i for i, run in enumerate(runs) if run.steps > 50)
    run = Simulator(robot, CONFIGURATIONS["standard"], Options(slip=1e-7)).run(samples[index])
    assert (run.outcome, run.reason) == (Outcome.FALLEN, "slip") and run.steps < runs[index].steps


def test_a_straight_com_stays_on_its_line(robot, samples):
    simulator, moved = Simulator(robot, CONFIGURATIONS["straight"]), 0
    for sample in samples:
        trace = simulator.run(sample, trace=True).trace
        along = trace.com_velocity[0] / np.linalg.norm(trace.com_velocity[0])
        path = trace.com - trace.com[0]
        across = path - np.outer(path @ along, along)
        assert np.abs(across).max() < 2e-4
        moved += np.abs(path).max() > 0.01
    assert moved > 0


def test_constant_momentum_stays_zero(robot):
    simulator, moved = Simulator(robot, CONFIGURATIONS["constant_momentum"]), 0
    data = robot.model.createData()
    for index in range(3):
        run = simulator.run(draw(robot, "three", 7, index, zero_momentum=True), trace=True)
        for q, v in zip(run.trace.q[::20], run.trace.v[::20], strict=True):
            assert np.abs(pin.computeCentroidalMomentum(robot.model, data, q, v).angular).max() < 0.02
        moved += run.steps > 20
    assert moved > 0


def test_options_are_checked(robot):
    with pytest.raises(ValueError, match=r"solver = 'simplex' \(expected one of: daqp, proxqp\)"):
        Simulator(robot, CONFIGURATIONS["standard"], Options(solver="simplex"))
    with pytest.raises(ValueError, match=r"dwell = -0.1 \(expected at least 0\)"):
        Simulator(robot, CONFIGURATIONS["standard"], Options(dwell=-0.1))
    with pytest.raises(ValueError, match=r"dt = 0.0 \(expected a positive number\)"):
        Simulator(robot, CONFIGURATIONS["standard"], Options(dt=0.0))
