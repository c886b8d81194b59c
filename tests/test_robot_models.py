"""Robots by name and from files, where they can touch, and their links held against Pinocchio."""

from pathlib import Path

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")

from jaxcap import robots  # noqa: E402
from jaxcap.errors import InputError  # noqa: E402
from jaxcap.robots.models import look_for_patches  # noqa: E402
from jaxcap.robots.tree import links  # noqa: E402

JOINTS = """<robot name="joints"><link name="base"><inertial><mass value="3"/><inertia ixx="1" iyy="2" izz="3" ixy=".1"
ixz=".2" iyz=".3"/></inertial></link>{links}</robot>"""
LINK = """<link name="{name}"><inertial><origin xyz=".1 .2 .3" rpy="1 2 3"/><mass value="2"/>
<inertia ixx="1" iyy="1.2" izz="1.3" ixy=".1" ixz="0" iyz="0"/></inertial></link>
<joint name="j_{name}" type="{kind}"><origin xyz=".3 -.2 .1" rpy=".3 .2 .1"/>
<parent link="{parent}"/><child link="{name}"/><axis xyz="{axis}"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""
KINDS = [
    ("revolute", "0.6 0 0.8"),
    ("prismatic", "0 1 0"),
    ("continuous", "0 0 1"),
    ("prismatic", ".6 .8 0"),
    ("revolute", "1 0 0"),
]

FOOT = """<mujoco model="hopper"><worldbody><body name="base" pos="0 0 1">
<freejoint name="root"/><inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/><body name="foot" pos="0 0 -.5"><joint
name="slide" type="slide" axis="0 0 1" range="-.2 .2"/> <inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/><geom
type="box" size=".1 .05 .01" pos="0.02 0 -.04"/></body></body> </worldbody></mujoco>"""


def random_states(model, n, seed=0):
    rng = np.random.default_rng(seed)
    q = [pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv)) for _ in range(n)]
    return np.array(q), rng.normal(size=(n, model.nv))


def every_kind():
    """A robot with every kind of joint that a URDF can have, in a chain, and a branch."""
    names = ["base", *(f"l{i}" for i in range(len(KINDS)))]
    chain = [LINK.format(name=names[i + 1], parent=names[i], kind=k, axis=a) for i, (k, a) in enumerate(KINDS)]
    branch = LINK.format(name="branch", parent="l1", kind="revolute", axis="0 1 0")
    return pin.buildModelFromXML(JOINTS.format(links="".join([*chain, branch])), pin.JointModelFreeFlyer())


def others():
    """Joints that no URDF has: a ball, a plane, a screw."""
    model, parent = pin.Model(), 0
    for i, joint in enumerate([pin.JointModelSpherical(), pin.JointModelPlanar(), pin.JointModelSphericalZYX()]):
        placement = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.1, 0.2, 0.3]))
        parent = model.addJoint(parent, joint, placement, f"j{i}")
        inertia = pin.Inertia(2.0, np.array([0.1, 0.0, 0.2]), np.diag([1.0, 2.0, 2.5]))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return model


@pytest.mark.parametrize("make", [lambda: robots.load("g1").model, every_kind, others], ids=["g1", "kinds", "others"])
def test_links_and_momentum_are_pinocchio_s(make):
    model = make()
    q, v = random_states(model, 7)
    states, found, data = robots.centroidal_states(model, q, v), links(model, q, v), model.createData()
    for i in range(len(q)):
        momentum = pin.computeCentroidalMomentum(model, data, q[i], v[i])
        np.testing.assert_allclose(states.com[i], data.com[0], atol=1e-12)
        np.testing.assert_allclose(states.com_velocity[i], data.vcom[0], atol=1e-12)
        np.testing.assert_allclose(states.angular_momentum[i], momentum.angular, atol=1e-11)
        for joint, link in enumerate(found[1:], 1):
            world = pin.getVelocity(model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            np.testing.assert_allclose(link.rotation[..., i], data.oMi[joint].rotation, atol=1e-12)
            np.testing.assert_allclose(link.position[:, i], data.oMi[joint].translation, atol=1e-12)
            np.testing.assert_allclose(link.linear[:, i], world.linear, atol=1e-12)
            np.testing.assert_allclose(link.angular[:, i], world.angular, atol=1e-12)


def test_blocks_do_not_show(monkeypatch):
    model = robots.load("go1").model
    q, v = random_states(model, 9)
    whole = robots.centroidal_states(model, q, v)
    monkeypatch.setattr("jaxcap.robots.centroidal.BLOCK", 4)
    for one, other in zip(whole, robots.centroidal_states(model, q, v), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-14)


@pytest.mark.parametrize("name", robots.ROBOTS)
def test_a_robot_by_its_name_has_feet(name):
    robot = robots.load(name)
    assert robot.model.joints[1].nq == 7 and len(robot.patches) in (2, 4)
    assert all(robot.model.existFrame(patch.frame) for patch in robot.patches.values())


def test_found_soles_of_talos_are_those_shipped():
    """In the plane of the sole frame to a millimetre; the flat bottom of the mesh is a little smaller than the box."""
    model, found = robots.talos().model, look_for_patches("talos")
    assert len(found) == 2
    for name, patch in zip(("left_sole", "right_sole"), found.values(), strict=True):
        shipped, q = robots.TALOS_CONTACTS[name], robots.talos().postures["half_sitting"]
        there, here = robots.contact_placement(model, q, shipped), robots.contact_placement(model, q, patch)
        assert abs(there.position[2] - here.position[2]) < 1e-3
        assert np.abs(there.position - here.position).max() < 0.01
        assert 0.85 < patch.half_length / shipped.half_length < 1 and 0.85 < patch.half_width / shipped.half_width < 1
        np.testing.assert_allclose(here.rotation, there.rotation, atol=2e-3)


def test_found_feet_of_anymal_are_balls_that_end_8_mm_below_those_shipped():
    robot, found = robots.anymal(), look_for_patches("anymal")
    q = robot.postures["standing"]
    shipped = [robots.contact_placement(robot.model, q, patch).position for patch in robots.ANYMAL_FEET.values()]
    for patch in found.values():
        assert patch.is_point and patch.radius == pytest.approx(0.031)
        place = robots.contact_placement(robot.model, q, patch).position
        nearest = min(shipped, key=lambda other: np.linalg.norm(other - place))
        assert np.linalg.norm(nearest[:2] - place[:2]) < 0.02 and 0 < nearest[2] - place[2] < 0.012


@pytest.mark.parametrize(
    "name", ["go1", pytest.param("g1", marks=pytest.mark.slow), pytest.param("romeo", marks=pytest.mark.slow)]
)
def test_the_files_of_feet_are_what_is_found(name):
    assert robots.patches_yaml(look_for_patches(name)) == (Path(robots.__file__).parent / f"feet/{name}.yaml").read_text()


def test_patches_come_back_from_their_yaml(tmp_path):
    path, model = tmp_path / "feet.yaml", robots.talos().model
    path.write_text(robots.patches_yaml(robots.TALOS_CONTACTS))
    assert robots.read_patches(path, model) == robots.TALOS_CONTACTS
    ball = {"ball": robots.ContactPatch("left_sole_link", (0.1, 0.2, 0.3), radius=0.02)}
    path.write_text(robots.patches_yaml(ball))
    assert robots.load("talos", feet=path).patches == ball


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("feet: {}", "no patches"),
        ("patches: {a: {position: [0, 0, 0]}}", "'frame' among them"),
        ("patches: {a: {frame: nose}}", r"patches\.a\.frame = 'nose' is no frame of"),
        ("patches: {a: {frame: left_sole_link, size: 3}}", "unknown field 'size'"),
        ("patches: {a: {frame: left_sole_link, half_width: -1}}", r"half_width = -1 \(expected a number of metres"),
        ("patches: {a: {frame: left_sole_link, position: [0, 0]}}", r"position = \[0, 0\] \(expected 3 finite"),
        ("patches: {a: {frame: left_sole_link, rotation: [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}}", "is not a rotation"),
        ("patches: [", "cannot be read as YAML"),
    ],
)
def test_patches_that_are_refused(tmp_path, text, message):
    path = tmp_path / "feet.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        robots.read_patches(path, robots.talos().model)


def test_mjcf(tmp_path):
    path = tmp_path / "hopper.xml"
    path.write_text(FOOT)
    robot = robots.load(path)
    assert (robot.model.nq, list(robot.model.names)[2:]) == (8, ["slide"])
    (patch,) = robot.patches.values()
    assert (patch.half_length, patch.half_width) == pytest.approx((0.1, 0.05))
    assert patch.position == pytest.approx((0.02, 0, -0.05))


def test_robots_that_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"robot 'tallos' is unknown \(expected talos, g1, .* or a \.urdf or \.xml file\)"):
        robots.load("tallos")
    with pytest.raises(InputError, match="no such file"):
        robots.load(tmp_path / "a.urdf")
    (tmp_path / "a.urdf").write_text("<robot")
    with pytest.raises(InputError, match="cannot read it"):
        robots.load(tmp_path / "a.urdf")
