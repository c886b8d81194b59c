"""Maps of a robot's posture hold the effort: that of `score`, over the places of the CoM alone."""

import jax
import numpy as np
import pytest
import xarray as xr
from samplers import limited_stance

import jaxcap
from jaxcap import Actuation
from jaxcap.contacts.actuation import actuated
from jaxcap.errors import InputError
from jaxcap.maps import blocks as map_blocks
from jaxcap.maps import kernel_map, write_map
from jaxcap.maps.grid import grid_of

GIVEN, (JACOBIANS, TORQUE, LIMIT) = limited_stance()
CONTACTS = jaxcap.ContactSet(*GIVEN)
ARM = Actuation(JACOBIANS, TORQUE, 0.25 * LIMIT, mask=np.arange(6) >= 3)
AXES = {"com_x": "-0.15:0.5:7", "com_y": "-0.15:0.2:4", "com_z": 0.8, "heading": "0:360deg:4", "speed": [0, 0.1, 0.3]}
NAMES = ("effort", "capturable", "margin", "max_speed")
PLACES = ("com_x", "com_y")
SHARED = {"float32": 1e-4, "float64": 1e-9}
"""Two programs of one figure differ by rounding [relative, and m/s]."""


pytestmark = pytest.mark.usefixtures("x64")


@pytest.fixture(scope="module")
def faces():
    """What the posture can exert."""
    with jax.enable_x64(True):
        return jaxcap.actuated_cone(CONTACTS, ARM)


def scored(axes, dtype):
    """Answers of `score` by rays at the states of a grid, in its shape."""
    points = grid_of(axes)
    coms, velocities = points.states(np.arange(points.size), dtype)
    rays = jax.tree.map(lambda x: x if x.dtype.kind != "f" else np.asarray(x, dtype), jaxcap.cone_rays(CONTACTS))
    found = jaxcap.score(
        rays, coms, velocities, actuation=ARM, specific_angular_momentum=points.momenta(np.arange(points.size))
    )
    return jax.tree.map(lambda field: np.asarray(field).reshape(points.shape), found)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("form", ["faces", "rays"])
def test_the_map_has_the_effort_of_score(faces, form, dtype):
    """At every direction and speed of a place, also at rest; above one no speed is capturable."""
    cone = faces if form == "faces" else actuated(jaxcap.cone_rays(CONTACTS), ARM)
    found, expected = kernel_map(cone, AXES, NAMES, dtype=dtype), scored(AXES, dtype)
    assert found.effort.dims == PLACES and found.effort.dtype == dtype and found.effort.units == "1"
    everywhere = np.broadcast_to(found.effort.values[:, :, None, None], expected.effort.shape)
    np.testing.assert_allclose(everywhere, expected.effort, rtol=SHARED[dtype])
    for name in ("max_speed", "margin"):
        ours, theirs = found[name].values, getattr(expected, name)
        theirs = theirs[..., 1] if name == "max_speed" else theirs
        np.testing.assert_allclose(ours, theirs, rtol=SHARED[dtype], atol=SHARED[dtype], err_msg=name)
    effort, capturable = found.effort.values, found.capturable.values
    unheld = np.isfinite(effort) & (effort > 1)
    assert unheld.sum() > 3 and np.isinf(effort).any()
    assert not capturable[unheld].any() and capturable[effort <= 1].any()


def test_the_effort_needs_no_speed_and_knows_no_momentum(faces):
    expected = kernel_map(faces, AXES, NAMES, dtype="float64").effort
    lines = {name: values for name, values in AXES.items() if name != "speed"}
    by_components = {
        **{name: AXES[name] for name in ("com_x", "com_y", "com_z")},
        "velocity_x": [0.2, -0.1],
        "velocity_y": 0.1,
    }
    spinning = {**AXES, "specific_angular_momentum_x": [0.05, -0.02]}
    for axes, names in ((lines, ("effort",)), (by_components, ("margin", "effort")), (spinning, ("effort", "max_speed"))):
        found = kernel_map(faces, axes, names, dtype="float64").effort
        assert found.dims == PLACES
        np.testing.assert_allclose(found, expected, rtol=SHARED["float64"])
    assert kernel_map(faces, {**lines, "com_x": 0.1, "com_y": 0}, "effort").effort.dims == ()


def test_regions_that_share_a_place_write_its_effort_once(tmp_path, monkeypatch, faces):
    """Whatever the regions, and in the order in which they come."""
    expected = kernel_map(faces, AXES, NAMES, dtype="float64")
    monkeypatch.setattr(map_blocks, "REGION", 20)
    monkeypatch.setattr(map_blocks, "SPEEDS", 2)
    parts = map_blocks.regions(grid_of(AXES))
    assert parts.counts[-1] == 2 and parts.counts[0] > 1
    write_map(tmp_path / "map.zarr", faces, AXES, NAMES, dtype="float64")
    with xr.open_dataset(tmp_path / "map.zarr", engine="zarr") as found:
        assert found.effort.dims == PLACES
        np.testing.assert_allclose(found.effort, expected.effort, rtol=SHARED["float64"])
        np.testing.assert_allclose(found.margin, expected.margin, rtol=SHARED["float64"], atol=SHARED["float64"])


@pytest.mark.parametrize(
    "cone",
    [
        CONTACTS,
        jaxcap.centroidal_cone(CONTACTS),
        jaxcap.cone_rays(CONTACTS),
        actuated(jaxcap.cone_rays(CONTACTS), None, 0.1),
    ],
    ids=["contacts", "faces", "rays", "box alone"],
)
def test_without_a_posture_there_is_no_effort(cone):
    with pytest.raises(InputError, match=r"quantity 'effort' needs a robot's posture .*--robot.*actuated_cone"):
        kernel_map(cone, AXES, "effort")
