"""`jaxcap map --robot --posture`: a robot in one posture, by faces or by rays."""

import jax
import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")
xarray = pytest.importorskip("xarray")

import jaxcap  # noqa: E402
from jaxcap.commands import posture as module  # noqa: E402
from jaxcap.commands.cli import main  # noqa: E402
from jaxcap.commands.posture import limited_cone, posture_of  # noqa: E402
from jaxcap.contacts.actuation import ActuatedRays  # noqa: E402
from jaxcap.contacts.sums import TooManyFacesError  # noqa: E402
from jaxcap.robots import load  # noqa: E402

AXES = [part for axis in ("com_x=-0.1:0.1:3", "com_y=0", "heading=0:360deg:4") for part in ("--axis", axis)]


def test_a_named_posture_stands_on_its_lowest_patches():
    found = posture_of("anymal", "standing", 0, ("LF", "RF"))
    robot = load("anymal")
    assert found.contacts.mask.all() and len(found.contacts) == 4 and found.actuation.mask.sum() == 6
    assert np.ptp(found.contacts.points[:, 2]) < 0.02 and (found.contacts.frames[:, 2, 2] > 0.99).all()
    q = robot.postures["standing"]
    assert found.height == pytest.approx(pin.centerOfMass(robot.model, robot.model.createData(), q)[2])
    assert found.words == f"{robot.model.name}, standing: limits of 6 joints"


def test_too_many_faces_give_rays_and_a_note(monkeypatch):
    def refuse(*_):
        raise TooManyFacesError("more than 50000 faces (expected fewer joints)")

    monkeypatch.setattr(module, "actuated_cone", refuse)
    found = limited_cone(posture_of("anymal", "standing", 0, ()), 4)
    assert isinstance(found.cone, ActuatedRays)
    assert found.note == "more than 50000 faces: computed by rays, which takes several times as long"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "CONTACTS is missing (expected a file of contacts, or --robot and --posture)"),
        (["--posture", "standing"], "--posture (expected with --robot)"),
        (["--joints", "leg"], "--joints (expected with --robot)"),
        (["--robot", "anymal"], "--robot (expected with --posture)"),
        (["feet.yaml", "--robot", "anymal", "--posture", "standing"], "feet.yaml (expected without --robot)"),
        (
            ["--robot", "anymal", "--posture", "dancing"],
            "--posture 'dancing' (expected a .parquet file of states, or a posture",
        ),
        (["--robot", "anymal", "--posture", "standing", "--row", "3"], "--row 3 (expected with a file as --posture"),
        (["--robot", "anymal", "--posture", "standing", "--joints", "tail"], "--joints 'tail' is in no name of a joint"),
    ],
)
def test_options_that_cannot_be_used(tmp_path, capsys, options, message):
    assert main(["map", *options, "-o", str(tmp_path / "a.zarr")]) == 2
    assert message in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_map_is_that_of_the_posture(tmp_path, capsys):
    """By faces as by rays, its effort too, and its file says whose it is."""
    output = tmp_path / "a.zarr"
    command = ["map", "--robot", "romeo", "--posture", "half_sitting", "--joints", "Ankle", "--dtype", "float64", *AXES]
    assert main([*command, "-o", str(output), "--quantity", "max_speed", "--quantity", "effort"]) == 0
    assert "half_sitting: limits of 4 joints" in capsys.readouterr().err
    with xarray.open_zarr(output) as found:
        assert "limits of 4 joints" in found.attrs["robot"] and "position" in found.attrs["contacts"]
        assert found["effort"].dims == ("com_x",)
        effort = np.repeat(found["effort"].values, 4)
        speeds, height = found["max_speed"].transpose("com_x", "heading").values.reshape(-1), float(found["com_z"])
    standing = posture_of("romeo", "half_sitting", 0, ("Ankle",))
    assert height == pytest.approx(standing.height, abs=1e-3)
    places = np.meshgrid(np.linspace(-0.1, 0.1, 3), np.arange(4) * np.pi / 2, indexing="ij")
    x, heading = (values.reshape(-1) for values in places)
    coms = np.column_stack([x, 0 * x, np.full_like(x, height)])
    velocities = np.column_stack([np.cos(heading), np.sin(heading), 0 * x])
    rays = jaxcap.cone_rays(standing.contacts)
    with jax.enable_x64(True):
        limited = jaxcap.score(rays, coms, velocities, actuation=standing.actuation)
        expected = np.asarray(limited.max_speed)
        plain = np.asarray(jaxcap.score(rays, coms, velocities).max_speed)
    np.testing.assert_allclose(speeds, expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(effort, limited.effort, rtol=1e-6)
    assert np.isfinite(effort).any()
    assert (expected < plain - 1e-3).any()
