"""Robot states: conventions, contacts kept, files that can be made again."""

from pathlib import Path

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")

import pyarrow.parquet as pq  # noqa: E402
import yaml  # noqa: E402
from scipy.spatial import ConvexHull  # noqa: E402

from bench import robot_states  # noqa: E402
from jaxcap import robots  # noqa: E402

DATA = Path(robot_states.__file__).parent / "data"
NAMES = [stance.name for stance in robot_states.STANCES]


@pytest.fixture(scope="module")
def samplers():
    return {stance.name: robot_states.Sampler(stance) for stance in robot_states.STANCES}


@pytest.fixture(scope="module")
def talos():
    return robots.talos(collisions=True)


def replaced(array, index, value):
    array = array.copy()
    array[index] = value
    return array


def random_states(model, n, seed=0):
    """Random configurations with turned bases, and velocities of all coordinates."""
    rng = np.random.default_rng(seed)
    q = [pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv)) for _ in range(n)]
    return np.array(q), rng.normal(size=(n, model.nv))


@pytest.mark.parametrize("name", NAMES)
def test_samples_keep_the_contacts_at_rest_and_respect_limits(samplers, name):
    sampler, limits = samplers[name], samplers[name].model
    for i in range(20):
        q, v = sampler.sample(i)
        error, jacobian = sampler.contact_error(q)
        assert np.abs(error).max() < 1e-9
        assert np.abs(jacobian @ v).max() < 1e-12
        assert (limits.lowerPositionLimit <= q).all() and (q <= limits.upperPositionLimit).all()
        assert (np.abs(v[6:]) <= limits.upperVelocityLimit[6:] * (1 + 1e-12)).all()
        assert not sampler.collides(q)


@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith("talos")])
def test_contact_placement_is_the_contact_file_s(samplers, name):
    q, _ = samplers[name].sample(3)
    for contact in yaml.safe_load((DATA / f"{name}.yaml").read_text())["contacts"]:
        patch = robots.TALOS_CONTACTS[contact["name"]]
        position, rotation = robots.contact_placement(samplers[name].model, q, patch)
        np.testing.assert_allclose(position, contact["position"], atol=1e-9)
        np.testing.assert_allclose(rotation, contact["rotation"], atol=1e-9)
        assert (contact["half_length"], contact["half_width"]) == (patch.half_length, patch.half_width)


@pytest.mark.parametrize("name", NAMES)
def test_normals_point_at_the_robot_and_the_stance_stands(samplers, name):
    sampler = samplers[name]
    com = pin.centerOfMass(sampler.model, sampler.data, sampler.nominal)
    assert robot_states.in_equilibrium(com, sampler.stance.contacts)
    assert not robot_states.in_equilibrium(com + np.array([0.7, 0, 0]), sampler.stance.contacts)
    for contact in sampler.stance.contacts:
        assert (com - contact.position) @ contact.rotation[:, 2] > 0.1
        np.testing.assert_allclose(contact.rotation.T @ contact.rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(contact.rotation) > 0


@pytest.mark.parametrize("name", NAMES)
def test_a_sample_is_the_same_alone_and_in_any_order(samplers, name):
    backwards = [samplers[name].sample(i) for i in (2, 1, 0)][::-1]
    alone = robot_states.Sampler(samplers[name].stance).sample(1)
    np.testing.assert_array_equal(np.concatenate(alone), np.concatenate(backwards[1]))
    for i in range(3):
        np.testing.assert_array_equal(np.concatenate(samplers[name].sample(i)), np.concatenate(backwards[i]))


@pytest.mark.parametrize("name", NAMES)
def test_shipped_files_can_be_made_again(samplers, name):
    table = pq.read_table(DATA / f"{name}.parquet")
    assert len(table) >= 5000
    assert table.column_names == ["com", "com_velocity", "angular_momentum", "sample"]
    assert {b"robot", b"units", b"frame", b"conventions", b"seed", b"made_by"} <= set(table.schema.metadata)
    assert int(table.schema.metadata[b"seed"]) == robot_states.SEED
    q, v = zip(*(samplers[name].sample(i) for i in range(10)), strict=True)
    states = robots.centroidal_states(samplers[name].model, q, v)
    for field, values in states._asdict().items():
        stored = np.stack(table[field].to_numpy())
        assert stored.shape == (len(table), 3) and np.isfinite(stored).all()
        np.testing.assert_allclose(stored[:10], values, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(table["sample"], np.arange(len(table)))
    assert (DATA / f"{name}.yaml").read_bytes() == robot_states.contact_file(samplers[name].stance)


def test_shipped_states_are_small_and_a_useful_mix():
    assert sum(path.stat().st_size for path in DATA.glob("*.parquet")) < 3e6
    for name in NAMES:
        velocity = np.stack(pq.read_table(DATA / f"{name}.parquet")["com_velocity"].to_numpy())
        counts, _ = np.histogram(np.linalg.norm(velocity, axis=1), bins=[0.0, 0.3, 0.6, 0.9, 1.2, 1.5 + 1e-9])
        assert counts.sum() == len(velocity) and counts.min() > 300


def test_the_script_writes_what_it_ships_and_keeps_what_exists(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(robot_states, "STANCES", robot_states.STANCES[:1])
    monkeypatch.setattr(robot_states, "STATIC_SAMPLES", 3)
    robot_states.main(["-o", str(tmp_path), "--samples", "3"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["talos_two_feet.parquet", "talos_two_feet.yaml"]
    made, shipped = (pq.read_table(folder / "talos_two_feet.parquet") for folder in (tmp_path, DATA))
    np.testing.assert_allclose(made["com"].to_pylist(), shipped["com"][:3].to_pylist(), rtol=0, atol=1e-9)
    before = (tmp_path / "talos_two_feet.parquet").read_bytes()
    with pytest.raises(SystemExit) as refusal:
        robot_states.main(["-o", str(tmp_path), "--samples", "2"])
    assert refusal.value.code == 2
    assert "exists" in capsys.readouterr().err
    assert (tmp_path / "talos_two_feet.parquet").read_bytes() == before


def assert_velocity_is_derivative(model, q, v, dt=1e-5):
    later = [
        robots.centroidal_states(model, [pin.integrate(model, a, t * b) for a, b in zip(q, v, strict=True)], v).com
        for t in (dt, -dt)
    ]
    velocity = robots.centroidal_states(model, q, v).com_velocity
    np.testing.assert_allclose(velocity, (later[0] - later[1]) / (2 * dt), atol=1e-8)


def test_com_velocity_is_the_derivative_of_the_com(talos):
    assert_velocity_is_derivative(talos.model, *random_states(talos.model, 5))


@pytest.mark.parametrize("name", NAMES)
def test_com_velocity_of_samples_is_the_derivative_of_the_com(samplers, name):
    assert_velocity_is_derivative(samplers[name].model, *zip(*map(samplers[name].sample, range(5)), strict=True))


def test_angular_momentum_is_the_sum_over_bodies(talos):
    model, data = talos.model, talos.model.createData()
    q, v = random_states(model, 5)
    states = robots.centroidal_states(model, q, v)
    for i in range(5):
        pin.forwardKinematics(model, data, q[i], v[i])
        momentum, total = np.zeros(3), np.zeros(3)
        for j in range(1, model.njoints):
            body, placement = model.inertias[j], data.oMi[j]
            position = placement.act(body.lever)
            turning = placement.rotation @ data.v[j].angular
            velocity = placement.rotation @ data.v[j].linear + np.cross(turning, placement.rotation @ body.lever)
            spin = placement.rotation @ body.inertia @ placement.rotation.T @ turning
            momentum += spin + np.cross(position - states.com[i], body.mass * velocity)
            total += body.mass * velocity
        np.testing.assert_allclose(states.angular_momentum[i], momentum, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(states.com_velocity[i], total / pin.computeTotalMass(model), rtol=1e-9, atol=1e-12)


def test_moving_and_turning_the_world_moves_and_turns_the_states(talos):
    q, v = random_states(talos.model, 4)
    before = robots.centroidal_states(talos.model, q, v)
    turn = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 1.2), np.array([3.0, -2.0, 0.5]))
    moved = q.copy()
    for row in moved:
        row[:7] = pin.SE3ToXYZQUAT(turn * pin.XYZQUATToSE3(row[:7]))
    after = robots.centroidal_states(talos.model, moved, v)  # v is in the base frame, and stays
    np.testing.assert_allclose(after.com, before.com @ turn.rotation.T + turn.translation, atol=1e-10)
    np.testing.assert_allclose(after.com_velocity, before.com_velocity @ turn.rotation.T, atol=1e-10)
    np.testing.assert_allclose(after.angular_momentum, before.angular_momentum @ turn.rotation.T, atol=1e-10)


def test_convention_error_finds_a_wrong_convention(talos):
    model, dt = talos.model, 1e-3
    q, (velocity,) = map(list, random_states(model, 1, seed=3))
    v = np.tile(velocity, (20, 1))
    while len(q) < 20:
        q.append(pin.integrate(model, q[-1], velocity * dt))
    q = np.array(q)
    right = robots.convention_error(model, q, v, dt)
    assert right.shape == (20,) and right.max() < 1e-4
    half = robots.convention_error(model, q[::2], v[::2], 2 * dt)
    assert 3 < half.max() / right.max() < 5  # second order
    world = v.copy()
    for row, base in zip(world, q, strict=True):
        turn = pin.XYZQUATToSE3(base[:7]).rotation
        row[:3], row[3:6] = turn @ row[:3], turn @ row[3:6]
    assert robots.convention_error(model, q, world, dt).min() > 0.1
    wxyz = q.copy()
    wxyz[:, 3:7] = q[:, [6, 3, 4, 5]]
    assert robots.convention_error(model, wxyz, v, dt).min() > 0.1


@pytest.mark.parametrize("side", ["left", "right"])
def test_hand_patch_lies_on_the_hull_of_the_collision_meshes(talos, side):
    shapes, patch = talos.collisions, robots.TALOS_CONTACTS[f"{side}_hand"]
    data, shape_data = talos.model.createData(), shapes.createData()
    pin.updateGeometryPlacements(talos.model, data, shapes, shape_data, q := talos.postures["half_sitting"])
    position, rotation = robots.contact_placement(talos.model, q, patch)
    points = []
    for shape, placement in zip(shapes.geometryObjects, shape_data.oMg, strict=True):
        if f"gripper_{side}" in shape.name or f"arm_{side}_7" in shape.name:
            vertices = np.asarray(shape.geometry.vertices()) @ placement.rotation.T + placement.translation
            points.append((vertices - position) @ rotation)
    points = np.concatenate(points)
    assert abs(points[:, 2].min()) < 2e-4
    tips = ConvexHull(points[points[:, 2] < 2e-4][:, :2])
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [patch.half_length, patch.half_width]
    assert (corners @ tips.equations[:, :2].T + tips.equations[:, 2] < 0).all()


def test_robots_are_what_their_docstrings_say(talos):
    assert (talos.model.nq, talos.model.nv) == (37, 36)
    assert pin.computeTotalMass(talos.model) == pytest.approx(90.3, abs=0.05)
    assert talos.postures["half_sitting"].shape == (37,)
    anymal = robots.anymal()
    assert (anymal.model.nq, anymal.model.nv, anymal.collisions) == (19, 18, None)
    assert pin.computeTotalMass(anymal.model) == pytest.approx(30.5, abs=0.05)
    assert all(anymal.model.existFrame(foot.frame) for foot in robots.ANYMAL_FEET.values())
    for sole in ("left_sole", "right_sole"):
        patch, q = robots.TALOS_CONTACTS[sole], talos.postures["half_sitting"]
        position, rotation = robots.contact_placement(talos.model, q, patch)
        assert abs(position[2]) < 1e-5 and rotation[2, 2] > 0.9999


@pytest.mark.parametrize("name", robots.ANYMAL_FEET)
def test_points_are_placed_as_patches_are(name):
    """R3: the origin of the foot's frame, which stands on the ground as its SRDF's posture does."""
    anymal = robots.anymal()
    model, q, foot = anymal.model, anymal.postures["standing"], robots.ANYMAL_FEET[name]
    position, rotation = robots.contact_placement(model, q, foot)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    placed = data.oMf[model.getFrameId(foot.frame)]
    np.testing.assert_allclose(position, placed.translation, atol=1e-12)
    np.testing.assert_allclose(rotation, placed.rotation, atol=1e-12)
    assert foot.is_point and not robots.TALOS_CONTACTS["left_sole"].is_point


def test_quaternion_in_single_precision_is_normalised(talos):
    q, v = random_states(talos.model, 3)
    single = robots.centroidal_states(talos.model, q.astype(np.float32), v.astype(np.float32))
    assert single.com.dtype == np.float64
    np.testing.assert_allclose(single.com, robots.centroidal_states(talos.model, q, v).com, atol=1e-6)


def test_no_states_give_no_states(talos):
    states = robots.centroidal_states(talos.model, np.empty((0, 37)), np.empty((0, 36)))
    assert [x.shape for x in states] == [(0, 3)] * 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda q, v: (q[:, :-1], v), r"configurations has shape \(4, 36\) \(expected \(n, 37\): nq = 37\)"),
        (lambda q, v: (q, v[:, :-1]), r"velocities has shape \(4, 35\) \(expected \(n, 36\): nv = 36\)"),
        (lambda q, v: (q[0], v[0]), r"configurations has shape \(37,\)"),
        (lambda q, v: (q, v[:3]), r"velocities has 3 rows \(expected 4, as configurations\)"),
        (lambda q, v: (replaced(q, (2, 5), np.nan), v), r"configurations\[2, 5\] = nan \(expected a finite number\)"),
        (lambda q, v: (q, replaced(v, (1, 0), np.inf)), r"velocities\[1, 0\] = inf \(expected a finite number\)"),
        (lambda q, v: (replaced(q, (3, slice(3, 7)), 0.0), v), r"configurations\[3, 3:7\]: quaternion .* has norm 0 "),
        (lambda q, v: (replaced(q, (1, slice(3, 7)), 1.0), v), r"quaternion \(x, y, z, w\) of root_joint has norm 2 "),
        (lambda q, v: (q.astype(str), v), r"configurations has dtype <U\d+ \(expected numbers\)"),
    ],
)
def test_bad_states_raise_with_field_expectation_and_value(talos, change, message):
    q, v = change(*random_states(talos.model, 4))
    with pytest.raises(ValueError, match=message):
        robots.centroidal_states(talos.model, q, v)


def test_bad_arguments_raise(talos, tmp_path):
    q, v = random_states(talos.model, 4)
    for dt in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="expected a positive number of seconds"):
            robots.convention_error(talos.model, q, v, dt)
    with pytest.raises(ValueError, match="configurations has 2 rows"):
        robots.convention_error(talos.model, q[:2], v[:2], 0.1)
    patch = robots.TALOS_CONTACTS["left_sole"]._replace(frame="tail")
    with pytest.raises(ValueError, match=r"patch\.frame = 'tail' is no frame of talos"):
        robots.contact_placement(talos.model, q[0], patch)
    with pytest.raises(ValueError, match=r"configuration has shape \(36,\) \(expected \(37,\): nq = 37\)"):
        robots.contact_placement(talos.model, q[0, 1:], robots.TALOS_CONTACTS["left_sole"])
    with pytest.raises(FileNotFoundError, match=r"none\.urdf: no such file"):
        robots.load_robot(tmp_path / "none.urdf")


URDF = """<robot name="arm"><link name="base"/>
<link name="link"><inertial><origin xyz="1 0 0"/><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="link"/><axis xyz="0 0 1"/></joint></robot>"""


def test_a_robot_of_one_s_own(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    arm = robots.load_robot(path, free_flyer=False)
    assert (arm.model.nq, arm.model.nv, arm.postures, arm.collisions) == (2, 1, {}, None)
    states = robots.centroidal_states(arm.model, [[0.0, 1.0]], [[3.0]])
    np.testing.assert_allclose(states.com, [[0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(states.com_velocity, [[-3, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(states.angular_momentum, [[0, 0, 3]], atol=1e-12)
    with pytest.raises(ValueError, match=r"cosine and sine of hinge has norm 0.5 "):
        robots.centroidal_states(arm.model, [[0.0, 0.5]], [[3.0]])
    with pytest.raises(ValueError, match="locked_joints: 'knee' is no joint of arm"):
        robots.load_robot(path, locked_joints=["knee"])
    assert robots.load_robot(path, locked_joints=["hinge"]).model.nv == 6
