"""`jaxcap score --robot`: the robot's torque limits and its angular momentum count where they are known."""

import itertools
import json

import jax
import numpy as np
import pyarrow.parquet as pq
import pytest

pin = pytest.importorskip("pinocchio")

import jaxcap  # noqa: E402
from bench.robot_motion import main as make_log  # noqa: E402
from jaxcap import robots  # noqa: E402
from jaxcap.commands.cli import main  # noqa: E402
from jaxcap.commands.robot_limits import TorqueLimits, counted  # noqa: E402
from jaxcap.commands.states import write_states  # noqa: E402
from jaxcap.files.records import read_states  # noqa: E402


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "walk.csv"
    make_log(["g1", "-o", str(path), "--seconds", "2"])
    return path


@pytest.fixture(scope="module")
def robot():
    return robots.load("g1")


def batches(log, robot, folder, rows):
    """The log's states in pieces, as the command reads them."""
    write_states(robots.Log(log, robot), folder / "states.parquet", force=True)
    with read_states(folder / "states.parquet", rows, np.float64) as source:
        return list(source)


@pytest.mark.slow
def test_the_command_scores_with_limits_and_angular_momentum(log, robot, tmp_path, capsys):
    """As the library does on the same rows, whatever the size of the pieces."""
    output = tmp_path / "scores.parquet"
    assert main(["score", str(log), "--robot", "g1", "-o", str(output), "--batch-size", "25"]) == 0
    told = "g1_29dof_rev_1_0: torque limits of 12 joints count, and angular momentum, over 33.34 kg (see --point-mass)"
    assert f"note: {log}: {told}" in capsys.readouterr().err
    said = json.loads(pq.read_schema(output).metadata[b"jaxcap"])
    assert said["counted"] == told and said["mass"] == pytest.approx(33.341, abs=1e-3)
    states = robots.states(log, robot)
    bearing = robots.actuation(robot.model, states.configuration, states.contacts, robot.patches)
    momenta = states.angular_momentum / pin.computeTotalMass(robot.model)
    rays = jaxcap.cone_rays(states.contacts)
    options = {"specific_angular_momentum": momenta, "actuation": bearing}
    expected = jaxcap.score(rays, states.com, states.com_velocity, **options)
    found = pq.read_table(output)
    for name in ("margin", "max_speed", "effort"):
        np.testing.assert_allclose(found[name].to_numpy(), getattr(expected, name), rtol=1e-4, atol=1e-4, err_msg=name)
    np.testing.assert_array_equal(found["status"].to_numpy(), expected.status)
    effort = found["effort"].to_numpy()
    assert np.isfinite(effort).sum() > 40 and (effort[np.isfinite(effort)] > 0).all()


@pytest.mark.slow
def test_limits_and_a_momentum_box_together(log, robot, tmp_path, capsys):
    """As the library does with both; a larger box never lowers the largest speed, and leaves the effort as it is."""
    found = {}
    for box in (0.0, 0.1, 0.3):
        output = tmp_path / f"{box}.parquet"
        options = ["--momentum-box", str(box), "--dtype", "float64", "--batch-size", "50"]
        assert main(["score", str(log), "--robot", "g1", "-o", str(output), *options]) == 0
        table = pq.read_table(output)
        found[box] = {name: table[name].to_numpy() for name in ("margin", "max_speed", "effort", "status", "capturable")}
    capsys.readouterr()
    states = robots.states(log, robot)
    bearing = robots.actuation(robot.model, states.configuration, states.contacts, robot.patches)
    momenta = states.angular_momentum / pin.computeTotalMass(robot.model)
    with jax.enable_x64(True):
        rays, options = jaxcap.cone_rays(states.contacts), {"specific_angular_momentum": momenta, "actuation": bearing}
        expected = jaxcap.score(rays, states.com, states.com_velocity, momentum_box=0.1, **options)
    for name, values in found[0.1].items():
        np.testing.assert_allclose(values, getattr(expected, name), rtol=1e-9, atol=1e-9, err_msg=name)
    speeds = [one["max_speed"] for one in found.values()]
    known = np.isfinite(speeds).all(axis=0)
    assert known.sum() > 40
    for less, more in itertools.pairwise(speeds):
        assert (more[known] >= less[known] * (1 - 1e-9)).all() and (more[known] > less[known] + 1e-3).any()
        np.testing.assert_array_equal(np.isinf(less) & ~np.isinf(more), False)
    np.testing.assert_allclose(found[0.3]["effort"], found[0.0]["effort"], rtol=1e-9)


def test_pieces_have_one_size_and_the_limits_of_the_whole(log, robot, tmp_path):
    """Also where a foot is in the air all the time, whose joints carry nothing."""
    states = robots.states(log, robot)
    whole = robots.actuation(robot.model, states.configuration, states.contacts, robot.patches)
    limits = TorqueLimits(robot)
    pieces = [limits.of(batch) for batch in batches(log, robot, tmp_path, 5)]
    assert len({tuple(field.shape for field in jax.tree.leaves(piece)) for piece in pieces}) == 1
    counts = np.concatenate([piece.mask.sum(axis=1) for piece in pieces])
    np.testing.assert_array_equal(counts, whole.mask.sum(axis=1))
    assert set(counts) == {6, 12}
    both = counts == 12
    for name in ("gravity_torque", "limit", "jacobians"):
        joined = np.concatenate([getattr(piece, name) for piece in pieces])
        np.testing.assert_allclose(joined[both], getattr(whole, name)[both], atol=1e-12, err_msg=name)


def test_a_row_without_a_posture_leaves_the_others_alone(log, robot, tmp_path):
    (batch,) = batches(log, robot, tmp_path, 100)
    q = batch.columns["configuration"].to_numpy(zero_copy_only=False)
    q = np.stack(q).copy()
    q[3, 9] = np.nan
    from jaxcap.files.arrow_columns import to_arrow

    broken = batch._replace(columns={"configuration": to_arrow(q, batch.columns["configuration"].type)})
    limits = TorqueLimits(robot)
    whole, found = limits.of(batch), limits.of(broken)
    others = np.arange(len(q)) != 3
    for name in ("jacobians", "gravity_torque", "limit", "mask"):
        np.testing.assert_array_equal(getattr(found, name)[others], getattr(whole, name)[others])
        assert np.isfinite(getattr(found, name)).all()


def test_a_robot_without_limits_is_said_and_keeps_its_momentum(robot):
    model = robot.model.copy()
    limit = np.array(model.upperEffortLimit)
    limit[model.joints[model.getJointId("left_knee_joint")].idx_v] = np.inf
    model.upperEffortLimit = limit
    known = counted(robot._replace(model=model), point_mass=False, mass=None)
    assert known.limits is None and known.mass == pytest.approx(33.341, abs=1e-3)
    assert known.words == (
        "g1_29dof_rev_1_0 has no effort limit for left_knee_joint: torque limits do not count, "
        "but angular momentum, over 33.34 kg"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--robot", "g1", "--mass", "30"], "--point-mass (expected without --mass)"),
        ([], "--point-mass (expected with --robot)"),
    ],
)
def test_options_that_contradict_each_other(log, tmp_path, capsys, arguments, message):
    assert main(["score", str(log), "-o", str(tmp_path / "a.parquet"), "--point-mass", *arguments]) == 2
    assert message in capsys.readouterr().err and not list(tmp_path.iterdir())
