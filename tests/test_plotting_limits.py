"""Pictures of a robot's limits: the polygon with and without them, the joint that binds, and where the effort is one."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.contour import QuadContourSet
from samplers import limited_stance

import jaxcap
from jaxcap import Actuation, plotting
from jaxcap.plotting.travel import travel

pytestmark = pytest.mark.usefixtures("x64")
GIVEN, (JACOBIANS, TORQUE, LIMIT) = limited_stance()
CONTACTS = jaxcap.ContactSet(*GIVEN)
ARM = Actuation(JACOBIANS, TORQUE, LIMIT, mask=np.arange(6) >= 3)
COM, VELOCITY = np.array([0.15, 0, 0.8]), np.array([0.5, 0.1, 0])
GRAVITY = (0, 0, -9.81)


def legend(ax) -> list[str]:
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_the_polygon_with_limits_lies_in_the_one_without():
    limited, plain = jaxcap.actuated_cone(CONTACTS, ARM), jaxcap.centroidal_cone(CONTACTS)
    joints = {"elbow": 0.3, "wrist": 0.2, 7: 0.1, "shoulder": 0.05}
    binding = jaxcap.BindingJoints("max_speed", joints)
    ax = plotting.polygon(limited, COM, VELOCITY, unlimited=plain, binding=binding)
    inner, outer = (patch.get_path().vertices for patch in ax.patches)
    wide = travel(plain, COM, VELOCITY, GRAVITY)
    room = wide.bounds[:, None] - wide.normals @ inner.T
    assert (room > -1e-6).all() and np.ptp(inner[:, 1]) < 0.9 * np.ptp(outer[:, 1])
    assert {"feasible for the robot's joints", "for the contacts alone"} <= set(legend(ax))
    assert ax.get_title().splitlines()[1] == "what binds: elbow, wrist, joint 7 and 1 more"
    alone = plotting.polygon(plain, COM, VELOCITY)
    assert len(alone.patches) == 1 and "feasible" in legend(alone) and "\n" not in alone.get_title()
    free = plotting.polygon(plain, COM, VELOCITY, binding=jaxcap.BindingJoints("max_speed", {}))
    assert free.get_title().endswith("\nno joint binds")


def test_a_posture_that_cannot_be_held_is_not_said_to_stop():
    weak = Actuation(JACOBIANS, TORQUE, 0.25 * LIMIT, mask=np.arange(6) >= 3)
    ax = plotting.polygon(jaxcap.actuated_cone(CONTACTS, weak), [-0.05, 0, 0.8], VELOCITY)
    assert ax.get_title().startswith("not capturable: to hold still takes 1.")


def test_the_thick_line_of_the_effort_is_at_one():
    """And where it is infinite the legend does not speak of speeds."""
    x, y = np.linspace(-0.3, 0.3, 13), np.linspace(-0.2, 0.2, 9)
    effort = 4 * np.hypot(*np.meshgrid(x, y, indexing="ij"))
    effort[:2] = np.inf
    axes = {"com_x": ("com_x", x, {"units": "m"}), "com_y": ("com_y", y, {"units": "m"})}
    dataset = xr.Dataset({"effort": (("com_x", "com_y"), effort, {"units": "1"})}, axes)
    ax = plotting.kernel_slice(dataset, "effort")
    (thick,) = (part for part in ax.collections if isinstance(part, QuadContourSet) and part.levels.tolist() == [1.0])
    place = np.concatenate([path.vertices for path in thick.get_paths()])
    np.testing.assert_allclose(np.hypot(*place.T), 0.25, atol=0.01)
    assert set(legend(ax)) == {"no torques hold it", "the most that torques hold"}
    held = plotting.kernel_slice(dataset.assign(effort=dataset.effort.clip(max=0.8)), "effort")
    assert held.get_legend() is None
