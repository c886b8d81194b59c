"""Several devices share the states: same answers as one device, bit for bit, in order, and every device has its share.

All runs are in a process that takes the cores of its machine for four devices.
"""

import os
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("xarray")

DEVICES = 4
BLOCK = 64
COUNTS = (0, 1, BLOCK - 1, BLOCK, DEVICES * BLOCK, DEVICES * BLOCK + 1, 3 * DEVICES * BLOCK - 5)
"""Numbers of states: none, fewer than devices, one block for each, a second round of one, a third that is not full."""

RUNS = """
import jax
import numpy as np
import jaxcap
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxcap import maps
from jaxcap.batch import devices, score as batch
from jaxcap.maps import blocks as map_blocks
batch.BLOCK = batch.RAYS_BLOCK = map_blocks.BLOCK = BLOCK
all_devices = jax.local_devices()
assert len(all_devices) == DEVICES
out, used = {}, {}

def keep(name, answer):
    out.update({f"{name}.{field}": np.asarray(value) for field, value in answer.items()})

run = devices.Spread.__call__
def seen(self, common, rows):
    placed = jax.device_put(rows, self._rows)
    parts = jax.tree.leaves(self._run(common, placed))[0].addressable_shards
    used.setdefault(name, set()).update((part.device.id, part.data.shape[0]) for part in parts)
    return run(self, common, rows)
devices.Spread.__call__ = seen

def mark(shared, states, neighbours):
    found = states.coms[:, 0] + states.com_velocities[:, 0] + states.cones.rays[:, 5, 3]
    return jaxcap.Capturability(*[found] * len(jaxcap.Capturability._fields))

sole = lambda y: jaxcap.rectangle([0, y, 0], np.eye(3), 0.105, 0.065, 0.5)
cone = jaxcap.centroidal_cone(sole(0.1) + sole(-0.1))
rng = np.random.default_rng(0)
n = max(COUNTS)
coms = rng.uniform([-0.2, -0.2, 0.7], [0.2, 0.2, 1], (n, 3)).astype(np.float32)
velocities = rng.uniform(-1, 1, (n, 3)).astype(np.float32)
coms[7], velocities[n - 3] = np.nan, 0

with jax.default_device(all_devices[2]):
    name = "one"
    answer = jaxcap.score(cone, coms, velocities)
    assert answer.margin.devices() == {all_devices[2]}
    keep(name, answer._asdict())
for n in COUNTS:
    name = f"several{n}"
    answer = jaxcap.score(cone, coms[:n], velocities[:n])
    keep(name, answer._asdict())
assert answer.margin.devices() == {all_devices[0]} and not answer.margin.committed

there = lambda where: devices.spread_over((cone, jax.device_put(coms[:8], where), velocities))
assert there(all_devices[2]) == (all_devices[2],)
assert there(None) == tuple(all_devices)
name = "sharded"
rows = NamedSharding(Mesh(np.array(all_devices), ("robots",)), PartitionSpec("robots"))
assert there(rows) == tuple(all_devices)
m = DEVICES * (max(COUNTS) // DEVICES)
keep(name, jaxcap.score(cone, *jax.device_put((coms[:m], velocities[:m]), rows))._asdict())

axes = {"com_x": "-0.2:0.2:11", "com_y": 0, "com_z": 0.8, "heading": "0:360deg:72"}
for name, context in (("map", jax.default_device(None)), ("map_on_one", jax.default_device(all_devices[2]))):
    with context:
        computed = maps.kernel_map(cone, axes)
    keep(name, {field: computed[field].values for field in computed})
name, batch.scored_block = "own", mark
many = jaxcap.rectangle(np.zeros(3), np.eye(3), 0.1, 0.05, 0.5)
many = jaxcap.ContactSet(many.points + rng.uniform(-1, 1, (n, 4, 3)), np.eye(3), 0.5)
rays = jaxcap.cone_rays(many)
keep(name, jaxcap.score(rays, coms, velocities)._asdict())
out["expected"] = (coms - rays.origin).astype(np.float32)[:, 0] + velocities[:, 0] + np.asarray(rays.rays)[:, 5, 3]
np.savez("out.npz", **out, **{f"used.{name}": sorted(pairs) for name, pairs in used.items()})
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """All answers: "several63.margin", "one.case", ...; and who had how many rows: "used.several63"."""
    directory = tmp_path_factory.mktemp("devices")
    program = RUNS
    for name in ("DEVICES", "BLOCK", "COUNTS"):
        program = f"{name} = {globals()[name]!r}\n" + program
    flags = f"--xla_force_host_platform_device_count={DEVICES} --xla_backend_optimization_level=0"
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "XLA_FLAGS": flags}
    subprocess.run([sys.executable, "-W", "error", "-c", program], check=True, cwd=directory, env=environment)
    with np.load(directory / "out.npz") as file:
        return dict(file)


def fields(runs, name):
    found = {key.partition(".")[2]: values for key, values in runs.items() if key.startswith(f"{name}.")}
    assert found
    return found


@pytest.mark.parametrize("n", COUNTS)
def test_every_state_is_answered_in_its_place(runs, n):
    one = fields(runs, "one")
    for name, values in fields(runs, f"several{n}").items():
        np.testing.assert_array_equal(values, one[name][:n], err_msg=name)


def test_the_states_differ(runs):
    """Or else an order could not be seen."""
    margin = runs["one.margin"]
    assert len(np.unique(margin[np.isfinite(margin)])) > 0.6 * len(margin)


@pytest.mark.parametrize("run", [f"several{n}" for n in COUNTS if n] + ["sharded", "own", "map"])
def test_every_device_has_its_share(runs, run):
    devices, rows = np.array(runs[f"used.{run}"]).T
    assert devices.tolist() == list(range(DEVICES))
    assert len(set(rows.tolist())) == 1


def test_one_device_is_left_alone_where_it_is_asked_for(runs):
    assert not {"used.one", "used.map_on_one"} & set(runs)


def test_no_states_ask_for_no_device(runs):
    assert "several0.margin" in runs and "used.several0" not in runs


def test_states_that_lie_on_several_devices(runs):
    for name, values in fields(runs, "sharded").items():
        np.testing.assert_array_equal(values, runs[f"one.{name}"][: len(values)], err_msg=name)


def test_contacts_of_their_own_stay_with_their_states(runs):
    """With a predictor that adds up a number of each: compiling the real one takes long."""
    assert len(np.unique(runs["expected"])) > 0.9 * len(runs["expected"])
    np.testing.assert_array_equal(runs["own.margin"], runs["expected"])


def test_a_map_is_the_same_to_the_bit(runs):
    one = fields(runs, "map_on_one")
    assert (one["max_speed"] > 0).any() and (one["max_speed"] == 0).any()
    for name, values in fields(runs, "map").items():
        assert values.shape == (11, 72)
        np.testing.assert_array_equal(values, one[name], err_msg=name)
