"""Shards: a job in n parts, each an independent command, in any queue."""

import re
from typing import NamedTuple, TypeVar

from jaxcap.errors import InputError

T = TypeVar("T")


class Shard(NamedTuple):
    """One of the parts of a job."""

    number: int
    """From 0."""
    of: int

    def part(self, units: list[T]) -> list[T]:
        """Its units: each belongs to one shard."""
        return units[self.number :: self.of]

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


WHOLE = Shard(0, 1)
"""All, as one."""


def shard_of(text: str | None) -> Shard:
    """The shard "i/n", i from 0 to n - 1; None: all, as one. Raises InputError."""
    if text is None:
        return WHOLE
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    if found is None:
        raise InputError(f"--shard {text} (expected i/n, for example 0/3)")
    shard = Shard(*map(int, found.groups()))
    if shard.number >= shard.of:
        last = f"0/{shard.of} to {shard.of - 1}/{shard.of}" if shard.of else "at least one, 0/1"
        raise InputError(f"--shard {text} (expected {last}: shards count from 0)")
    return shard
