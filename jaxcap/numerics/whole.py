"""Whole numbers: how many boxes hold so many things."""


def ceil_div(n: int, size: int) -> int:
    """How many boxes of this size hold n things."""
    return -(-n // size)


def round_up(n: int, multiple: int) -> int:
    """The smallest multiple that is not less than n."""
    return ceil_div(n, multiple) * multiple
