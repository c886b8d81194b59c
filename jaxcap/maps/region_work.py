"""Regions of a map that other processes compute, each alone. Needs the extra `maps`."""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax

from jaxcap.contacts.conventions import ArrayLike
from jaxcap.engine.shards import WHOLE, Shard
from jaxcap.errors import InputError
from jaxcap.files.settings import differences
from jaxcap.maps.asked import checked, prepared
from jaxcap.maps.blocks import Answers
from jaxcap.maps.contact_axes import Mapped
from jaxcap.maps.store import partial_path, settings_in, write_chunks


class Elsewhere(NamedTuple):
    """Where the regions of a map are computed, if not all in this process."""

    run: Callable[["RegionWork", list[int]], Iterable[int]] | None = None
    """Calls what it is given, which can be pickled, with each of these numbers in any process that sees the file, and yields
    those that are done. None: this process does."""
    backend: str | None = None
    """Of JAX, there."""
    shard: Shard = WHOLE
    """The part of the map that is grown."""


@dataclass(frozen=True)
class RegionWork:
    """What computes a region of an unfinished map and writes its chunks. It can be sent to other processes."""

    path: Path
    cone: Mapped
    axes: dict[str, Any]
    quantities: tuple[str, ...]
    gravity: ArrayLike
    sides: int
    dtype: str
    settings: dict[str, Any]
    said: Mapping[str, str] | None = None

    def __call__(self, number: int) -> int:
        """Computes the region with this number, and writes it. Returns the number."""
        with jax.enable_x64(self.dtype == "float64"):
            (region, values), *_ = (answers := self._answers()).over([number])
        write_chunks(self.path, {name: answers.place(region, name) for name in values}, values)
        return number

    def _answers(self) -> Answers:
        """Kept from region to region: cones and programs are made once a process."""
        settings = json.loads(json.dumps(self.settings))
        key = f"{self.path} {json.dumps(settings, sort_keys=True)}"
        if key not in _KEPT:
            asked = checked(self.cone, self.axes, self.quantities, self.dtype)
            answers, about = prepared(self.cone, asked, self.gravity, self.sides, progress=False, said=self.said)
            here = json.loads(json.dumps(about.settings))
            for name in differences(settings, here)[:1]:
                raise InputError(f"{self.path}: {name} of the map is {settings.get(name)} (a worker has {here.get(name)})")
            _KEPT.clear()
            _KEPT[key] = answers
        if settings_in(self.path) != settings:
            raise InputError(f"{partial_path(self.path)}: is another map now")
        return _KEPT[key]


_KEPT: dict[str, Answers] = {}
"""The one map that this process last computed a region of, for `RegionWork`."""
