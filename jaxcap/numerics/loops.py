"""A loop that runs as often as it must, and can be differentiated in reverse all the same."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

FEW = 4
"""Steps up to which a loop is unrolled: nothing is stored between them, and steps that change nothing cost little."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def bounded_loop(step: Callable, bound: int, count: Any, arguments: Any, start: Any) -> Any:
    """`for k in range(count): state = step(k, arguments, state)`, count <= bound.

    step must not close over values that are differentiated: they belong in `arguments`. JAX cannot reverse a loop of
    unknown length, so the derivative is that of a loop over all of `bound`, whose idle steps change nothing.
    """
    if bound <= FEW:
        for k in range(bound):
            start = step(k, arguments, start)
        return start
    return jax.lax.fori_loop(0, count, lambda k, state: step(k, arguments, state), start)


@bounded_loop.defjvp
def _bounded_loop_jvp(step, bound, primals, tangents):
    count, arguments, start = primals

    def scanned(arguments, start):
        def one(state, k):
            after = step(k, arguments, state)
            return jax.tree.map(lambda new, old: jnp.where(k < count, new, old), after, state), None

        return jax.lax.scan(one, start, jnp.arange(bound))[0]

    return jax.jvp(scanned, (arguments, start), tuple(tangents[1:]))
