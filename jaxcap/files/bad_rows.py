"""Rows of a batch that cannot be used, and why the first of them."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float


class BadRows:
    """Which rows of a batch cannot be used, and why the first of them."""

    def __init__(self, n: int):
        self.rows = np.zeros(n, dtype=bool)
        self.first: int | None = None
        self.why = ""

    def add(self, wrong: Bool[np.ndarray, " n"], why: Callable[[int], str]) -> None:
        """Adds rows. why: the reason for one of them; only that of the first is asked for. Rows added before stay."""
        new = wrong & ~self.rows
        if new.any():
            row = int(np.argmax(new))
            if self.first is None or row < self.first:
                self.first, self.why = row, why(row)
            self.rows |= new

    def add_not_finite(self, names: tuple[str, ...], vectors: Float[np.ndarray, "n 3"]) -> None:
        """Adds rows in which a vector is not finite. names: of the column that holds it, or of three."""
        bad = ~np.isfinite(vectors)

        def why(row: int) -> str:
            if len(names) == 1:
                return f"{names[0]} = {vectors[row].tolist()} (expected finite numbers)"
            axis = int(np.argmax(bad[row]))
            return f"{names[axis]} = {vectors[row, axis]} (expected a finite number)"

        self.add(bad.any(axis=1), why)
