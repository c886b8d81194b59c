"""Contacts and centre of mass of a live MuJoCo simulation."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from jaxcap.errors import InputError
from jaxcap.robots import from_mujoco

BLOCK = """<mujoco><option timestep="0.002"/><worldbody>{before}<body name="block" pos="0 0 .099"><freejoint/>
<geom type="box" size=".2 .1 .1" mass="3"/><body name="arm" pos="0 0 .1"><joint type="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .3 0 .2" size=".02" mass="1"/></body></body>{after}</worldbody></mujoco>"""
FLOOR = '<geom name="floor" type="plane" size="5 5 .1"/>'
SHELF = '<body name="shelf"><geom type="box" size="1 1 .01" pos="0 0 -.01"/></body>'


@pytest.fixture
def mujoco():
    return pytest.importorskip("mujoco")


def simulated(mujoco, **parts):
    model = mujoco.MjModel.from_xml_string(BLOCK.format(**{"before": "", "after": "", **parts}))
    data = mujoco.MjData(model)
    data.qvel[:] = 0.3, 0.1, 0.0, 0.1, -0.2, 0.3, 1.0
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize("parts", [{"before": FLOOR}, {"after": SHELF}], ids=["floor first", "robot first"])
def test_normals_point_at_the_robot_whichever_geom_is_first(mujoco, parts):
    model, data = simulated(mujoco, **parts)
    found = from_mujoco(model, data, "block")
    assert found.contacts.mask.all() and found.contacts.points.shape[1] >= 4
    np.testing.assert_allclose(
        found.contacts.frames[..., 2], np.broadcast_to([0, 0, 1.0], found.contacts.points.shape), atol=1e-6
    )
    np.testing.assert_allclose(np.linalg.det(found.contacts.frames), 1)
    assert sorted(found.contacts.points[0, :, 0].round(2).tolist())[0] == -0.2


def test_velocity_is_the_derivative_of_the_centre_of_mass(mujoco):
    model, data = simulated(mujoco, before=FLOOR)
    found, step = from_mujoco(model, data), 1e-6
    places = []
    for sign in (-1, 1):
        moved = mujoco.MjData(model)
        moved.qpos[:] = data.qpos
        mujoco.mj_integratePos(model, moved.qpos, data.qvel, sign * step)
        mujoco.mj_forward(model, moved)
        places.append(from_mujoco(model, moved).com[0])
    np.testing.assert_allclose(found.com_velocity[0], (places[1] - places[0]) / (2 * step), atol=1e-8)


def test_a_trajectory_is_its_states(mujoco):
    model, data = simulated(mujoco, before=FLOOR)
    row = np.r_[data.qpos, data.qvel]
    flying = row.copy()
    flying[2] += 1.0
    alone = from_mujoco(model, data)
    both = from_mujoco(model, data, trajectory=np.stack([row, flying]), forward=mujoco.mj_forward)
    assert both.contacts.mask.tolist() == [[True] * 4, [False] * 4]
    np.testing.assert_array_equal(both.contacts.points[0], alone.contacts.points[0])
    np.testing.assert_array_equal(both.com[0], alone.com[0])
    with pytest.raises(InputError, match=r"trajectory has shape \(15,\) \(expected \(n, 15\)"):
        from_mujoco(model, data, trajectory=row)
    with pytest.raises(InputError, match="body 'tail' is not there"):
        from_mujoco(model, data, "tail")


def test_without_mujoco():
    """Its structs are read, whatever they are: a ball on a wall whose normal MuJoCo lets point away from it."""
    frame = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]).ravel()  # the normal, by rows, from the ball to the wall
    contact = SimpleNamespace(geom=[1, 0], dist=0.0, pos=[0.1, 0, 1], frame=frame, friction=[0.6, 0, 0])
    model = SimpleNamespace(
        nbody=2, body_mass=np.array([0.0, 2.0]), body_parentid=[0, 0], body_rootid=[0, 1], geom_bodyid=[0, 1], nq=7, nv=6
    )
    data = SimpleNamespace(
        xipos=np.array([[0, 0, 0], [0, 0, 1.0]]),
        cvel=np.array([[0.0] * 6, [0, 0, 1, 0.5, 0, 0]]),
        subtree_com=np.array([[0, 0, 1.0], [0, 0, 1.0]]),
        contact=[contact],
        ncon=1,
    )
    found = from_mujoco(model, data)
    assert found.contacts.frames[0, 0, :, 2].tolist() == [-1, 0, 0] and found.contacts.friction.tolist() == [[0.6]]
    assert found.com.tolist() == [[0, 0, 1]] and found.com_velocity.tolist() == [[0.5, 0, 0]]
