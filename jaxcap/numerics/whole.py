"""Whole numbers: how many boxes hold so many things."""

from typing import TypeVar

from jaxtyping import Array

Count = TypeVar("Count", int, Array)


def ceil_div(n: Count, size: int) -> Count:
    """How many boxes of this size hold n things."""
    return -(-n // size)


def round_up(n: int, multiple: int) -> int:
    """The smallest multiple that is not less than n."""
    return ceil_div(n, multiple) * multiple
