"""The 3-D view, without a browser: what is drawn, and the scene as viser writes it."""

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")
pytest.importorskip("viser")

from bench.robot_motion import main as make_log  # noqa: E402
from jaxcap import robots  # noqa: E402
from jaxcap.commands.cli import main  # noqa: E402
from jaxcap.commands.view import PYRAMID, read_columns, scene  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


@pytest.fixture
def states(tmp_path):
    log, path = tmp_path / "walk.csv", tmp_path / "states.parquet"
    make_log(["g1", "-o", str(log), "--seconds", "2"])
    assert main(["states", str(log), "--robot", "g1", "-o", str(path)]) == 0
    return path


def test_what_is_drawn_is_the_row(states):
    model, columns = robots.load("g1").model, read_columns(states)
    row = int(np.argmin(columns["contact_mask"].sum(axis=1)))
    one, data = scene(model, columns, row), model.createData()
    pin.forwardKinematics(model, data, columns["configuration"][row])
    for i, (start, end) in enumerate(one.rods, 2):
        np.testing.assert_allclose(start, data.oMi[model.parents[i]].translation, atol=1e-9)
        np.testing.assert_allclose(end, data.oMi[i].translation, atol=1e-9)
    assert len(one.pyramids) == 4 * columns["contact_mask"][row].sum() == 16
    rise = one.pyramids[:, 1] - one.pyramids[:, 0]
    np.testing.assert_allclose(rise[:, 2], PYRAMID)
    np.testing.assert_allclose(np.linalg.norm(rise[:, :2], axis=1), 0.5 * PYRAMID)  # friction 0.5
    assert one.capturable is None and one.words == f"{columns['t'][row]:.2f} s"


def test_a_scene_is_saved(states, tmp_path, capsys):
    output = tmp_path / "scene.viser"
    assert main(["view", str(states), "--robot", "g1", "--save", str(output), "--port", "8991"]) == 0
    assert output.stat().st_size > 500
    assert main(["view", str(states), "--robot", "g1", "--save", str(output)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_what_is_refused(states, tmp_path, capsys):
    assert main(["view", str(states), "--robot", "go1"]) == 2
    assert "'configuration' has rows of shape (36,)" in capsys.readouterr().err
    assert main(["view", str(tmp_path / "none.parquet"), "--robot", "g1"]) == 2
    assert "cannot be read as Parquet" in capsys.readouterr().err
