"""A linear program in exact arithmetic: the last word on whether a cone holds a vector.

Where rays nearly oppose each other, a vector may need them with weights of 1e9, which cancel: then least squares and solvers
in double precision cannot tell. Fractions can; they are slow, and asked when nothing else is sure.
"""

from fractions import Fraction

import numpy as np
from jaxtyping import Float

BLAND_AFTER = 100
"""Pivots after which the first column that helps comes in, not the one that helps most: so that there is no circle."""


def distance(rays: Float[np.ndarray, "n d"], target: Float[np.ndarray, " d"]) -> float:
    """Of a vector from the cone of the rays, the sum of absolute values; exact but for the last rounding.

    The simplex method, for the least sum of errors with rays.T @ weights + errors = target and weights >= 0, in which each
    error is the difference of two numbers >= 0.
    """
    n, d = rays.shape
    signs = np.where(target < 0, -1.0, 1.0)  # so that the first basis, the errors of one sign, has weights >= 0
    columns = np.column_stack([signs[:, None] * rays.T, np.eye(d), -np.eye(d), signs * target])
    exact = [[Fraction(float(x)) for x in row] for row in columns]
    costs = [0] * n + [1] * (2 * d) + [0]
    gains = [sum(column, Fraction(-cost)) for column, cost in zip(zip(*exact, strict=True), costs, strict=True)]
    basis = list(range(n, n + d))
    for pivots in range(100 * n):
        helpful = [j for j, gain in enumerate(gains[:-1]) if gain > 0]
        if not helpful:
            break
        entering = max(helpful, key=lambda j: gains[j]) if pivots < BLAND_AFTER else helpful[0]
        rows = [(row[-1] / row[entering], basis[i], i) for i, row in enumerate(exact) if row[entering] > 0]
        leaving = min(rows)[2]
        pivot = exact[leaving][entering]
        exact[leaving] = [x / pivot for x in exact[leaving]]
        for i in range(d):
            if i != leaving:
                exact[i] = _less(exact[i], exact[i][entering], exact[leaving])
        gains = _less(gains, gains[entering], exact[leaving])
        basis[leaving] = entering
    return float(gains[-1])


def _less(row: list[Fraction], factor: Fraction, other: list[Fraction]) -> list[Fraction]:
    return [x - factor * y for x, y in zip(row, other, strict=True)] if factor else row
