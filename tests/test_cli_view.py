"""The 3-D view, without a browser: what is drawn, the scene as viser writes it, and the slider."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

pin = pytest.importorskip("pinocchio")
viser = pytest.importorskip("viser")

import jaxcap  # noqa: E402
from bench.robot_motion import main as make_log  # noqa: E402
from jaxcap import robots  # noqa: E402
from jaxcap.commands.cli import main  # noqa: E402
from jaxcap.commands.view import read_columns  # noqa: E402
from jaxcap.commands.view_row import AHEAD, HEADINGS, PYRAMID, scene  # noqa: E402
from jaxcap.commands.view_window import MOST, Window, controls  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


@pytest.fixture
def states(tmp_path):
    log, path = tmp_path / "walk.csv", tmp_path / "states.parquet"
    make_log(["g1", "-o", str(log), "--seconds", "2"])
    assert main(["states", str(log), "--robot", "g1", "-o", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def meshes():
    """Of G1: 290,000 triangles."""
    return robots.looks("g1", robots.load("g1").model)


@pytest.fixture
def server():
    opened = viser.ViserServer(host="127.0.0.1", port=8995, verbose=False)
    yield opened
    opened.stop()


def test_what_is_drawn_is_the_row(states):
    model, columns = robots.load("g1").model, read_columns(states)
    row = int(np.argmin(columns["contact_mask"].sum(axis=1)))
    one, data = scene(model, columns, row), model.createData()
    pin.forwardKinematics(model, data, columns["configuration"][row])
    for i, (start, end) in enumerate(one.rods, 2):
        np.testing.assert_allclose(start, data.oMi[model.parents[i]].translation, atol=1e-9)
        np.testing.assert_allclose(end, data.oMi[i].translation, atol=1e-9)
        np.testing.assert_allclose(one.rotations[i], data.oMi[i].rotation, atol=1e-9)
        np.testing.assert_allclose(one.positions[i], data.oMi[i].translation, atol=1e-9)
    assert len(one.pyramids) == 4 * columns["contact_mask"][row].sum() == 16
    rise = one.pyramids[:, 1] - one.pyramids[:, 0]
    np.testing.assert_allclose(rise[:, 2], PYRAMID)
    np.testing.assert_allclose(np.linalg.norm(rise[:, :2], axis=1), 0.5 * PYRAMID)  # friction 0.5
    assert one.capturable is None and one.words == f"{columns['t'][row]:.2f} s" and not len(one.area)


@pytest.mark.slow
def test_the_area_holds_the_speeds_that_can_be_stopped(states):
    model, columns = robots.load("g1").model, read_columns(states)
    row = int(np.argmax(columns["contact_mask"].sum(axis=1)))
    one = scene(model, columns, row, area=True)
    mask, com = columns["contact_mask"][row], columns["com"][row]
    contacts = jaxcap.ContactSet(*(columns[f"contact_{name}"][row][mask] for name in ("points", "frames", "friction")))
    directions = jaxcap.headings(HEADINGS)
    found = jaxcap.score(jaxcap.centroidal_cone(contacts), np.tile(com, (HEADINGS, 1)), directions)
    wanted = com + AHEAD * np.asarray(found.max_speed)[:, None] * directions
    np.testing.assert_allclose(one.area[:, 0], wanted, atol=1e-4)
    columns["contact_mask"][row] = False
    assert not len(scene(model, columns, row, area=True).area)  # nothing touches: no velocity can be stopped


@pytest.mark.slow
def test_a_film_is_saved(states, meshes, tmp_path, capsys, monkeypatch):
    """Every row, as viser plays it: meshes once, what moves for each row, at the times of the log."""
    msgspec, zstandard = pytest.importorskip("msgspec"), pytest.importorskip("zstandard")
    monkeypatch.setattr("jaxcap.robots.looks", lambda *_: meshes)
    output = tmp_path / "film.viser"
    assert main(["view", str(states), "--robot", "g1", "--no-area", "--save", str(output), "--port", "8991"]) == 0
    inner = zstandard.ZstdDecompressor().decompressobj().decompress(output.read_bytes()[8:])
    said = msgspec.msgpack.decode(inner[8 : 8 + int.from_bytes(inner[:8], "little")])
    columns, names = read_columns(states), [message.get("name") for _, message in said["messages"]]
    rows = len(columns["t"])
    assert said["durationSeconds"] == pytest.approx(columns["t"][-1] - columns["t"][0])
    assert len(meshes) > 20
    assert sum(kind == "MeshMessage" for kind in (message["type"] for _, message in said["messages"])) == len(meshes)
    assert all(names.count(name) >= rows for name in ("/com", "/velocity", "/pyramids", f"/robot/{meshes[0].joint}"))
    assert main(["view", str(states), "--robot", "g1", "--save", str(output)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_rods_where_there_are_no_meshes(states, server):
    model, columns = robots.load("g1").model, read_columns(states)
    window, recorder = Window(server, ()), server.get_scene_serializer()
    window.draw(scene(model, columns, 3))
    drawn = {message["name"] for _, message in recorder._messages if "name" in message}
    assert {"/rods", "/com", "/velocity", "/pyramids", "/area"} <= drawn
    assert not any(name.startswith("/robot") for name in drawn)


def test_the_slider_chooses_the_row_and_the_margin_shows_where_it_is(server):
    margin, shown = np.r_[np.nan, np.linspace(-1, 1, 3 * MOST), np.inf], []
    turned = controls(server, len(margin), margin, lambda row: shown.append(row) or f"row {row}")
    rows, line, now = turned.plot.data
    assert len(rows) <= MOST and rows[1] == 4 and shown == [0]  # every fourth row
    np.testing.assert_array_equal(line[1:], margin[rows.astype(int)][1:])
    turned.slider.value = 4000
    assert shown[-1] == 4000 and turned.words.content == "row 4000"
    now = turned.plot.data[2]
    assert np.flatnonzero(~np.isnan(now)) == 1000 and now[1000] == margin[4000]
    assert controls(server, 5, None, str).plot is None


@pytest.mark.parametrize("name", ["solo", pytest.param("talos", marks=pytest.mark.slow)])
def test_meshes_are_where_pinocchio_has_them(name):
    """Also where joints are locked: held against Pinocchio's own reduction."""
    robot, path = robots.load(name), robots.models.file_of(name)
    q = pin.integrate(robot.model, pin.neutral(robot.model), np.random.default_rng(0).normal(size=robot.model.nv))
    whole = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    shapes = pin.buildGeomFromUrdf(whole, str(path), pin.GeometryType.VISUAL, package_dirs=[str(path.parents[4])])
    locked = [i for i, joint in enumerate(whole.names) if i and joint not in list(robot.model.names)]
    model, shapes = pin.buildReducedModel(whole, shapes, locked, pin.neutral(whole))
    data, placed = model.createData(), shapes.createData()
    pin.forwardKinematics(model, data, q)
    pin.updateGeometryPlacements(model, data, shapes, placed)
    found = robots.looks(name, robot.model)
    assert len(found) == len(shapes.geometryObjects)
    for look, shape, place in zip(found, shapes.geometryObjects, placed.oMg, strict=True):
        here = look.vertices @ data.oMi[look.joint].rotation.T + data.oMi[look.joint].translation
        box = shape.geometry
        box.computeLocalAABB()
        if hasattr(box, "num_tris"):
            there = box.vertices() * np.asarray(shape.meshScale).reshape(3) @ place.rotation.T + place.translation
            np.testing.assert_allclose(here, there, atol=1e-6)
        else:
            np.testing.assert_allclose((here.min(axis=0) + here.max(axis=0)) / 2, place.act(box.aabb_center), atol=1e-6)
        assert look.triangles.max() < len(look.vertices)


def test_shapes_without_meshes(tmp_path):
    """Primitives are drawn, a mesh that is not there is left out; MJCF too."""
    geometries = (
        '<box size=".1 .2 .3"/>',
        '<sphere radius=".1"/>',
        '<cylinder radius=".1" length=".4"/>',
        '<mesh filename="a.stl"/>',
    )
    visuals = "".join(
        f'<visual><origin xyz="0 0 {i}"/><geometry>{one}</geometry></visual>' for i, one in enumerate(geometries)
    )
    mass = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r"><link name="base">{mass}{visuals}</link></robot>')
    found = robots.looks(path, robots.load(path).model)
    sizes = [np.ptp(look.vertices, axis=0).round(6).tolist() for look in found]
    assert sizes[0] == [0.1, 0.2, 0.3] and len(sizes) == 3
    assert sizes[1] == pytest.approx([0.2] * 3, abs=0.01) and sizes[2] == pytest.approx([0.2, 0.2, 0.4], abs=0.01)
    assert [look.vertices[:, 2].mean().round(6) for look in found] == [0, 1, 2]
    path = tmp_path / "robot.xml"
    path.write_text(
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="b"><freejoint/><geom type="capsule" size=".1 .3" '
        'mass="1"/></body></worldbody></mujoco>'
    )
    (look,) = robots.looks(path, robots.load(path).model)
    np.testing.assert_allclose(np.ptp(look.vertices, axis=0), [0.2, 0.2, 0.8], atol=0.01)


@pytest.mark.slow
def test_the_picture_of_the_readme(tmp_path):
    from bench.view_picture import main as draw

    draw(["-o", str(tmp_path / "view.png")])
    assert (tmp_path / "view.png").read_bytes()[1:4] == b"PNG"


def test_what_is_refused(states, tmp_path, capsys):
    assert main(["view", str(states), "--robot", "go1"]) == 2
    assert "'configuration' has rows of shape (36,)" in capsys.readouterr().err
    assert main(["view", str(tmp_path / "none.parquet"), "--robot", "g1"]) == 2
    assert "cannot be read as Parquet" in capsys.readouterr().err
    pq.write_table(pa.table({"com": [[0.0, 0, 0]]}), tmp_path / "other.parquet")
    assert main(["view", str(tmp_path / "other.parquet"), "--robot", "g1"]) == 2
    assert "no column 'com_velocity' (expected what jaxcap states wrote" in capsys.readouterr().err
