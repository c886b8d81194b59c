"""How long one state takes, from NumPy in to NumPy out: every field of the answer as a NumPy array.

    plain       `jaxcap.capturability(cone, com, com_velocity)`
    compiled    the same, compiled ahead of time: jax.jit(jaxcap.capturability).lower(...).compile()
    one output  compiled, the ten fields stacked to one array inside: what ten arrays out cost
    nothing     a compiled function that adds numbers to one of its inputs, ten arrays out: what JAX takes for itself

The four take turns, `BLOCK` calls at a time, with another state each call, on the default device. The paper needs up to
11 ms for the linear programs of a state alone. On a CPU, JAX hands a call to another thread and waits for it, which may take
longer than the answer. It does not after jax.config.update("jax_cpu_enable_async_dispatch", False), which has to come before
anything is computed: `python -m bench.speed --inline`. That is a switch of the whole process, and there is none of a call:
XLA's CPU client runs in place what it takes for cheap (`nothing`; no state), what is asked for inside a host callback, and
what `ExecuteOptions.execution_mode` tells it to, which JAX leaves to no caller.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap
from bench.stances import batch

BLOCK, WARM = 100, 5
"""Calls in a row, and calls before them that are not timed."""
SETS = ("one foot", "coplanar feet", "4 random rectangles")


def line(name: str, producer: str, calls: int, dtype: str = "float32") -> dict:
    """One line of the table: microseconds, median and 99th percentile of so many calls each."""
    jax.clear_caches()
    states = batch(name, BLOCK)
    coms, velocities = states.coms.astype(dtype), states.com_velocities.astype(dtype)
    kind = jaxcap.centroidal_cone if producer == "face" else jaxcap.cone_rays
    cone = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype if leaf.dtype != bool else bool), kind(states.contacts))
    stacked = lambda *state: jnp.stack([field.astype(dtype) for field in jaxcap.capturability(*state)])
    ten = lambda _, com, velocity: tuple(com[0] + k for k in range(10))
    ahead = lambda function: jax.jit(function).lower(cone, coms[0], velocities[0]).compile()
    start = time.perf_counter()
    functions = {"plain": jaxcap.capturability, "compiled": ahead(jaxcap.capturability)}
    compiling = time.perf_counter() - start
    functions |= {"one output": ahead(stacked), "nothing": ahead(ten)}
    seconds = {which: [] for which in functions}
    for _ in range(-(-calls // BLOCK)):
        for which, function in functions.items():
            for k in range(-WARM, BLOCK):
                start = time.perf_counter()
                jax.tree.map(np.asarray, function(cone, coms[k], velocities[k]))
                if k >= 0:
                    seconds[which].append(time.perf_counter() - start)
    quantiles = ("", 50), (" 99 %", 99)
    micro = {which + q: 1e6 * float(np.percentile(seconds[which], p)) for which in functions for q, p in quantiles}
    return {"contacts": name, "producer": producer, "dtype": dtype, "calls": calls, "compile s": compiling, **micro}


def lines(names, producers, calls: int) -> list[dict]:
    """The table [us]."""
    return [line(name, producer, calls) for name in names for producer in producers]
