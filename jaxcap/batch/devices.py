"""Several devices: which of them compute, and a program that runs on all at a time."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

AXIS = "devices"
"""Name of the mesh's one axis."""


def spread_over(arrays: Any) -> tuple[jax.Device, ...]:
    """The devices among which rows are divided. Fewer than two: nothing is divided, and JAX places as it always does.

    An array that was placed (`jax.device_put` with a device or a sharding) says where: on its devices. Without one,
    `jax.default_device` does, and without that it is all devices of this process.
    """
    for leaf in jax.tree.leaves(arrays):
        if isinstance(leaf, jax.Array) and leaf.committed:
            return tuple(sorted(leaf.devices(), key=lambda device: device.id))
    default = jax.config.jax_default_device  # type: ignore[attr-defined]   # JAX makes these at run time
    return () if default is not None else tuple(jax.local_devices())


class Spread:
    """A function of (common, rows) that several devices run at a time, each on its share of the rows, in order.

    It is compiled once for all of them. No device waits for another: loops may be of different length on each.
    """

    def __init__(self, one: Callable, devices: tuple[jax.Device, ...]):
        mesh = Mesh(np.array(devices), (AXIS,))
        self._common, self._rows = NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(AXIS))
        # check_vma: loops begin with zeros that are the same on every device, and end with what is not
        specs = self._common.spec, self._rows.spec
        self._run = jax.jit(jax.shard_map(one, mesh=mesh, check_vma=False, in_specs=specs, out_specs=self._rows.spec))

    def everywhere(self, common):
        """The same on every device."""
        return jax.device_put(common, self._common)

    def __call__(self, common, rows):
        """The answers on the host. common: from `everywhere`. rows: as many as devices, or a multiple."""
        return jax.device_get(self._run(common, jax.device_put(rows, self._rows)))
