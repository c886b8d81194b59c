"""Logs in every layout against the direct path, and what is refused."""

import json
import pickle
import re

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")

import robot_logs  # noqa: E402
from robot_logs import LAYOUTS  # noqa: E402

from bench.robot_motion import Motion, motion  # noqa: E402
from jaxcap import robots  # noqa: E402
from jaxcap.errors import InputError  # noqa: E402
from jaxcap.robots.differences import differences  # noqa: E402
from jaxcap.robots.logs import Log, Options, States  # noqa: E402
from jaxcap.robots.touch import Touching, decided, lasting  # noqa: E402

CLOSE = 1e-9
"""Largest difference between a log and the direct path, double precision [m, m/s, kg m^2/s]."""


@pytest.fixture(scope="module")
def g1():
    return robots.load("g1")


@pytest.fixture(scope="module")
def stepping():
    """G1 steps in place for three seconds."""
    return motion("g1", seconds=3.0)


@pytest.fixture(scope="module")
def tienkung(tmp_path_factory):
    """A robot of rods that squats and lifts its left foot: 100 rows."""
    path = tmp_path_factory.mktemp("robot") / "tienkung.urdf"
    path.write_text(robot_logs.tienkung_urdf())
    robot = robots.load(path)
    time, q = np.arange(100) / 50, np.tile(pin.neutral(robot.model), (100, 1))
    bend = 0.3 * np.sin(2 * time)
    bends = {"l": bend + 0.5 * np.sin(np.pi * time / 2) ** 4, "r": bend}
    for name, share in (("hip_pitch", -1), ("knee_pitch", 2), ("ankle_pitch", -1)):
        for side in "lr":
            q[:, robot.model.joints[robot.model.getJointId(f"{name}_{side}_joint")].idx_q] = share * bends[side]
    q[:, 2] = 0.06 + 0.7 * np.cos(bend)
    q[:, 7 + 13] = bend
    return robot, Motion(time, q, differences(robot.model, time, q))


def case(name, g1, stepping, tienkung):
    """Robot and motion of a layout; LAFAN1 has 30 rows a second."""
    if name == "lafan1_g1":
        time = np.arange(len(stepping.q)) / 30
        stepping = Motion(time, stepping.q, differences(g1.model, time, stepping.q))
    return tienkung if name == "tienkung" else (g1, stepping)


def assert_same(found: States, wanted: States):
    for field in ("t", "com", "com_velocity", "angular_momentum", "contact_points", "contact_frames", "contact_friction"):
        np.testing.assert_allclose(getattr(found, field), getattr(wanted, field), rtol=0, atol=CLOSE, err_msg=field)
    np.testing.assert_array_equal(found.contact_mask, wanted.contact_mask)


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_log_gives_the_states_of_the_direct_path(name, g1, stepping, tienkung, tmp_path):
    layout, (robot, one) = LAYOUTS[name], case(name, g1, stepping, tienkung)
    path = tmp_path / layout.file
    layout.write(path, one, robot.model)
    log = Log(path, robot, None if layout.recognised else robots.layout_of(name))
    assert log.layout.name == name
    found = list(log)
    missing = [note for note in log.notes if "held at zero" in note]
    assert log.notes == tuple(missing) and bool(missing) == (name == "asap")  # nothing looks wrong
    assert log.episodes == layout.episodes
    wanted = robots.states_of(robot, one.time, one.q, one.v if layout.velocities else None)
    assert wanted.contact_mask.any() and not wanted.contact_mask.all()
    for number in range(layout.episodes):
        episode = [piece for piece in found if piece.episode[0] == found[number].episode[0]]
        assert_same(States(*(np.concatenate(parts) for parts in zip(*episode, strict=True))), wanted)


@pytest.mark.parametrize("write", ["joblib", "pickle", "old pickle"])
def test_pickles_of_any_age(write, g1, stepping, tmp_path):
    dump = {
        "pickle": lambda said, path: path.write_bytes(pickle.dumps(said)),
        "old pickle": lambda said, path: path.write_bytes(pickle.dumps(said, protocol=2)),
    }
    path = tmp_path / "log.pkl"
    robot_logs.asap(path, stepping, g1.model, **({"dump": dump[write]} if write in dump else {}))
    found = next(iter(Log(path, g1)))
    assert_same(found, robots.states_of(g1, stepping.time, stepping.q))


def test_lerobot_with_a_file_an_episode_and_one_of_them_damaged(g1, stepping, tmp_path):
    path = tmp_path / "set"
    robot_logs.lerobot(path, stepping, g1.model, version="v2.1")
    file = path / "data/chunk-000/episode_000001.parquet"
    file.write_bytes(file.read_bytes()[:1000])
    log = Log(path, g1)
    assert_same(next(iter(log)), robots.states_of(g1, stepping.time, stepping.q))
    assert len(list(log)) == log.episodes == 1
    assert "episode_000001.parquet: cannot be read as parquet" in log.notes[0]


def test_where_pieces_are_cut_does_not_show(g1, stepping, tmp_path, monkeypatch):
    path = tmp_path / "log.npz"
    LAYOUTS["mujoco"].write(path, stepping, g1.model)
    options = Options(ground=robots.read_ground(0.0), velocities="differences", smooth=9)
    (whole,) = Log(path, g1, None, options)
    for size in (7, 50):
        monkeypatch.setattr("jaxcap.robots.logs.PIECE", size)
        pieces = list(Log(path, g1, None, options))
        assert len(pieces) == -(-len(stepping.time) // size)
        assert_same(States(*(np.concatenate(parts) for parts in zip(*pieces, strict=True))), whole)
        assert np.array_equal(np.concatenate([piece.row for piece in pieces]), whole.row)


def test_differences_are_of_second_order_inside(g1):
    """A smooth motion: half the step, a quarter of the error; at the ends half."""
    model = g1.model
    rng = np.random.default_rng(0)
    rates, start = rng.normal(size=model.nv), pin.neutral(model)

    def errors(step):
        time = np.arange(9) * step
        q = np.array([pin.integrate(model, start, np.sin(t + rates)) for t in time])
        exact = differences(
            model,
            np.array([-1e-5, 1e-5]),
            np.array([pin.integrate(model, start, np.sin(time[4] + d + rates)) for d in (-1e-5, 1e-5)]),
        )
        return np.abs(differences(model, time - time[4], q)[4, 6:] - exact[0, 6:]).max()

    assert 3.5 < errors(0.04) / errors(0.02) < 6


def test_an_own_layout_of_ten_lines(g1, stepping, tmp_path):
    """Degrees, millimetres, y up, velocity of the base along its own axes, flags of contact."""
    turn = pin.rpy.rpyToMatrix(-np.pi / 2, 0, 0)  # the world with y up
    pose = np.array([pin.SE3ToXYZQUAT(pin.SE3(turn, np.zeros(3)) * pin.XYZQUATToSE3(q[:7])) for q in stepping.q])
    touching = np.arange(len(stepping.q)) % 50 < 25
    np.savez(
        tmp_path / "log.npz",
        t=stepping.time,
        base=np.concatenate([pose[:, :3] * 1000, pose[:, 3:]], axis=1),
        velocity=stepping.v[:, :3] * 1000,
        joints=np.degrees(stepping.q[:, 7:]),
        touch=np.stack([touching, ~touching], axis=1),
        names=np.array(list(g1.model.names)[2:]),
    )
    (tmp_path / "mine.yaml").write_text("""
format: npz
time: t
base_position: base[0:3]
base_orientation: base[3:7]
quaternion: xyzw
base_linear_velocity: velocity
linear_velocity_frame: base
joint_positions: joints
joint_names: names
contacts: {left_ankle_roll_link: "touch[0]", right_ankle_roll_link: "touch[1]"}
angles: deg
lengths: mm
up: y
""")
    found = robots.states(tmp_path / "log.npz", g1, tmp_path / "mine.yaml", ground=0.0)
    wanted = robots.states_of(g1, stepping.time, stepping.q, ground=0.0)
    assert_same(found._replace(contact_mask=wanted.contact_mask), wanted)
    feet = found.contact_mask.reshape(len(touching), 2, 4)
    assert not feet[~touching, 0].any() and not feet[touching, 1].any() and feet[touching, 0].any(axis=1).all()


def test_a_base_velocity_that_is_not_logged_is_a_difference(g1, stepping, tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, time=stepping.time, qpos=np.c_[stepping.q[:, :3], stepping.q[:, [6, 3, 4, 5]], stepping.q[:, 7:]])
    assert_same(robots.states(path, g1), robots.states_of(g1, stepping.time, stepping.q))


def test_hysteresis():
    rules = Touching(low=0.02, high=0.04, slow=1, fast=2)
    heights = np.array([0.03, 0.01, 0.03, 0.05, 0.03, 0.01, 0.01])[:, None]
    speeds = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.5, 0.5])[:, None]
    for before in (False, True):
        found = decided(heights, speeds, rules, np.array([before]))[:, 0]
        assert found.tolist() == [before, True, True, False, False, False, True]
    assert not decided(np.array([[np.nan]]), np.array([[0.0]]), rules, np.array([True])).any()


def test_dwell():
    touching = np.array([1, 1, 0, 1, 1, 1, 0, 0, 0, 1, 0, 0, 0], dtype=bool)[:, None]
    assert lasting(touching, 2)[:, 0].astype(int).tolist() == [1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0]
    assert (lasting(touching, 1) == touching).all()


def test_grounds(g1, stepping, tmp_path):
    """A floor as a height, as a plane and as a field is the same floor; a slope has its own normal."""
    (tmp_path / "plane.yaml").write_text(
        "planes: [{point: [5, 5, 0.1], normal: [0, 0, 2]}, {point: [0, 0, -3], normal: [0, 0, 1]}]"
    )
    (tmp_path / "field.yaml").write_text("{origin: [-1, -1], step: [2, 2], heights: [[0.1, 0.1], [0.1, 0.1]]}")
    lifted = stepping.q + np.r_[0, 0, 0.1, np.zeros(33)]
    wanted = robots.states_of(g1, stepping.time, lifted, ground=0.1)
    for name in ("plane", "field"):
        assert_same(robots.states_of(g1, stepping.time, lifted, ground=tmp_path / f"{name}.yaml"), wanted)
    (tmp_path / "slope.yaml").write_text("{origin: [-1, -1], step: [2, 2], heights: [[-0.1, -0.1], [0.1, 0.1]]}")
    slope = robots.read_ground(tmp_path / "slope.yaml").under(np.array([[0.5, 0.2]]))
    assert slope.height == pytest.approx(0.05) and slope.normal[0] == pytest.approx(
        np.array([-0.1, 0, 1]) / np.hypot(0.1, 1)
    )
    with pytest.raises(InputError, match="no ground"):
        robots.read_ground(tmp_path / "bad.yaml" if (tmp_path / "bad.yaml").write_text("{planes: [{point: 3}]}") else "")


def test_a_pickle_is_not_executed(tmp_path, g1):
    class Evil:
        def __reduce__(self):
            return exec, ("raise SystemExit('executed')",)

    path = tmp_path / "log.pkl"
    path.write_bytes(pickle.dumps({"root_pos": Evil()}))
    with pytest.raises(InputError, match=r"log\.pkl: it holds builtins\.exec, which is not executed"):
        Log(path, g1)
    path.write_bytes(pickle.dumps({"root_pos": np.array([Evil()], dtype=object)}))
    with pytest.raises(InputError, match="is not executed"):
        Log(path, g1)


def bad_log(tmp_path, one, change, name="log.npz"):
    fields = {"time": one.time, "qpos": np.c_[one.q[:, :3], one.q[:, [6, 3, 4, 5]], one.q[:, 7:]]}
    change(fields)
    np.savez(tmp_path / name, **fields)
    return tmp_path / name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.update(time=f["time"][::-1].copy()), r"time\[1\] = .* is not later than the row before"),
        (lambda f: f.update(time=f["time"][:-1]), "time has 149 rows"),
        (lambda f: f.update(qpos=f["qpos"][:, :-1]), "joint_positions has 28 columns, but .* has 29 joints"),
        (lambda f: f.update(qpos=f["qpos"][:0], time=f["time"][:0]), "no rows"),
        (lambda f: f["qpos"].__setitem__((3, 9), np.nan), r"joint_positions\[3, 2\] = nan"),
        (lambda f: f["qpos"].__setitem__((4, slice(3, 7)), 0), r"base_orientation\[4\] is zero"),
        (lambda f: f["qpos"].__setitem__((slice(None), slice(3, 7)), 3), "has norm 6"),
        (lambda f: f.update(qpos=f["qpos"][:, 0]), r"'qpos' has shape \(150,\)"),
        (lambda f: f.update(qpos=f["qpos"].astype(str)), "expected an array of numbers|no base pose"),
        (lambda f: f.pop("time"), "no known layout fits"),
    ],
)
def test_what_is_refused(change, message, g1, stepping, tmp_path):
    with pytest.raises(InputError, match=message):
        list(Log(bad_log(tmp_path, stepping, change), g1))


def test_files_that_are_refused(g1, stepping, tmp_path):
    refused = lambda path, message, layout=None: pytest.raises(InputError, match=message)
    with refused(0, "no such file"):
        Log(tmp_path / "none.npz", g1)
    (tmp_path / "log.bin").write_bytes(b"")
    with refused(0, r"unknown extension '\.bin'"):
        Log(tmp_path / "log.bin", g1)
    for name, kind in (
        ("isaac_lab", "hdf5"),
        ("ros2", "mcap"),
        ("named_parquet", "parquet"),
        ("gmr", "pickle"),
        ("isaac_amp", "npz"),
    ):
        path = tmp_path / LAYOUTS[name].file
        LAYOUTS[name].write(path, stepping, g1.model)
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        with refused(0, rf"{path.name}: cannot be read as {kind}"):
            list(Log(path, g1))


def test_a_robot_s_log_is_not_another_s(stepping, g1, tmp_path):
    path = tmp_path / "log.csv"
    LAYOUTS["lafan1_g1"].write(path, stepping, g1.model)
    with pytest.raises(InputError, match="joint 'left_hip_pitch_joint' is no joint of talos"):
        list(Log(path, robots.load("talos")))


def test_a_set_without_base_pose_is_refused_by_name(g1, stepping, tmp_path):
    path = tmp_path / "set"
    robot_logs.lerobot(path, stepping, g1.model)
    info = json.loads((path / "meta/info.json").read_text())
    file = next(path.glob("data/*/*.parquet"))
    import pyarrow.parquet as pq

    pq.write_table(pq.read_table(file).drop_columns(["observation.base_position"]), file)
    with pytest.raises(InputError, match=r"no base pose: base_position 'observation.base_position' is not there"):
        list(Log(path, g1, robots.layout_of("lerobot")))
    assert info["fps"] == 50


def test_two_layouts_with_the_same_fields_are_asked_for(g1, stepping, tmp_path):
    path = tmp_path / "log.npz"
    LAYOUTS["mjlab"].write(path, stepping, g1.model)
    with pytest.raises(InputError, match=r"fits more than one layout, say which with --layout .beyondmimic: .*mjlab: "):
        Log(path, g1)


def test_one_bad_episode_does_not_cost_the_others(g1, stepping, tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "log.hdf5"
    LAYOUTS["isaac_lab"].write(path, stepping, g1.model)
    with h5py.File(path, "a") as file:
        file["data/demo_0/states/articulation/robot/root_pose"][5, 0] = np.nan
    log = Log(path, g1)
    (found,) = log
    assert set(found.episode) == {"data/demo_1"} and log.episodes == 1
    assert log.notes == (f"{path}: data/demo_0: base_position[5, 0] = nan (expected a finite number)",)
    with pytest.raises(InputError, match=r"base_position\[5, 0\]"):
        list(Log(path, g1, None, Options(strict=True)))


LAYOUT = (
    "format: npz\ntime: t\nbase_position: p\nbase_orientation: o\nquaternion: xyzw\njoint_positions: j\njoint_names: [a]\n"
)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("quaternion: xyzw\n", ""), r"needs one of 'quaternion' \(xyzw or wxyz\) and 'euler'"),
        (("xyzw", "xwyz"), r"quaternion = 'xwyz' \(expected xyzw or wxyz\)"),
        (("time: t\n", ""), "expected one of 'time', 'rate' and 'step'"),
        (("joint_names: [a]\n", ""), "the joints have no names"),
        (("base_position: p\n", ""), "no field 'base_position'"),
        (("format: npz", "format: bag"), "format = 'bag'"),
        (("time: t", "time: t\nbase_linear_velocity: v"), "base_linear_velocity needs 'linear_velocity_frame'"),
        (("time: t", "tim: t"), "unknown field 'tim'"),
        (("format: npz", "["), "cannot be read as YAML"),
    ],
)
def test_layouts_that_are_refused(change, message, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(LAYOUT.replace(*change))
    with pytest.raises(InputError, match=f"mine.yaml: .*{message}"):
        robots.layout_of(path)


def test_an_unknown_layout_names_the_known_ones():
    assert set(robots.known_layouts()) == set(LAYOUTS)
    with pytest.raises(InputError, match=re.escape("layout 'lafan' is unknown (expected asap, beyondmimic")):
        robots.layout_of("lafan")
