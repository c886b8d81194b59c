"""How long things take: the first call apart, contenders in turn, ceilings of the machine."""

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

PRODUCT = 2048
"""Rows and columns of the matrices whose product is timed."""
COPY = 1 << 30
"""Bytes of the array that is read and written: it fits no cache."""


class Timing(NamedTuple):
    """What one contender took."""

    first: float
    """Seconds of the first call, with compiling."""
    seconds: list[float]
    """Of the calls after it, a round each."""
    answer: Any
    """What the last call returned."""

    @property
    def best(self) -> float:
        """[s]"""
        return min(self.seconds)

    @property
    def compiling(self) -> float:
        """[s]"""
        return max(0.0, self.first - self.best)


def spent(call: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds until the answer of `call()` is there, and the answer."""
    start = time.perf_counter()
    answer = jax.block_until_ready(call())
    return time.perf_counter() - start, answer


def in_turn(calls: Mapping[str, Callable[[], Any]], rounds: int) -> dict[str, Timing]:
    """Every call once, nothing compiled before; then all of them in turn, so that a busy machine hits all alike."""
    jax.clear_caches()
    first = {name: spent(call)[0] for name, call in calls.items()}
    seconds, answers = {name: [] for name in calls}, {}
    for _ in range(rounds):
        for name, call in calls.items():
            took, answers[name] = spent(call)
            seconds[name].append(took)
    return {name: Timing(first[name], seconds[name], answers[name]) for name in calls}


def ratio(slow: Timing, fast: Timing) -> float:
    """How many times as long the one takes as the other: the median over the rounds."""
    return statistics.median(a / b for a, b in zip(slow.seconds, fast.seconds, strict=True))


class Ceilings(NamedTuple):
    """What the machine can do at best, in this run."""

    operations: float
    """Per second: a product of two large matrices, a multiplication and an addition counted as two."""
    bytes: float
    """Per second: a large array read once and written once, in place. Memory that is new to a process is slower by far."""


def ceilings(dtype: str, rounds: int = 5) -> Ceilings:
    """The two ceilings in this precision, the best of the rounds."""
    matrix = jnp.asarray(np.random.default_rng(0).uniform(size=(PRODUCT, PRODUCT)), dtype)
    negated = jax.jit(jnp.negative, donate_argnums=0)
    arrays = [jnp.zeros(COPY // matrix.itemsize, dtype)]

    def copy():
        arrays.append(negated(arrays.pop()))
        return arrays[-1]

    found = in_turn({"product": lambda: matrix @ matrix, "copy": copy}, rounds)
    return Ceilings(2 * PRODUCT**3 / found["product"].best, 2 * COPY / found["copy"].best)
