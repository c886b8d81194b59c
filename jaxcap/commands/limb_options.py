"""How long a hand or a foot takes to a place: options of `jaxcap next`. Importing this module needs tyro."""

import dataclasses
from typing import Annotated, Any

import numpy as np
import tyro

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.errors import InputError
from jaxcap.regions.limb_reach import LimbReach, limb_reach

Place = tuple[float, float, float]
PLACE = tyro.conf.arg(metavar="X Y Z")


@dataclasses.dataclass(frozen=True)
class LimbOptions:
    """The delay by a model, in place of --delay."""

    limb: Annotated[Place | None, PLACE] = None
    """In place of --delay: where the hand or foot is now [m]; it goes straight to each place ..."""
    limb_speed: Annotated[float | None, tyro.conf.arg(metavar="V")] = None
    """... as fast as this [m/s] ..."""
    reaction: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """... after this time [s]; 0 by default."""
    limb_root: Annotated[Place | None, PLACE] = None
    """With --limb and --limb-length: hip or shoulder at touchdown [m]."""
    limb_length: Annotated[float | None, tyro.conf.arg(metavar="L")] = None
    """Of the outstretched limb [m]: places farther from its root are out of reach."""

    @property
    def given(self) -> dict[str, Any]:
        """What is not left out, by name."""
        return {name: value for name, value in dataclasses.asdict(self).items() if value is not None}

    def reach(self, candidates: ContactSet, delay: float | None) -> LimbReach:
        """When each candidate bears, and which are in reach: all of them with a `delay` [s].

        Raises:
            InputError: for options that contradict each other, or cannot be used.
        """
        m, given = len(candidates.mask), self.given
        if delay is not None:
            for option in map(_spelt, given):
                raise InputError(f"{option} beside --delay {delay} (expected --delay, or --limb with --limb-speed)")
            if not 0 <= delay < np.inf:
                raise InputError(f"--delay = {delay} (expected a finite number of seconds, not negative)")
            return LimbReach(np.full(m, delay), np.ones(m, bool))
        for option in ("limb", "limb_speed"):
            if option not in given:
                more = f" beside {_spelt(next(iter(given)))}" if given else ", and no --delay"
                raise InputError(f"no {_spelt(option)}{more} (expected --delay, or --limb with --limb-speed)")
        for option in ("limb", "limb_root"):
            if not np.isfinite(given.get(option, 0)).all():
                raise InputError(f"{_spelt(option)} {given[option]} (expected three finite numbers of metres)")
        names = {"limb_speed": "speed", "limb_root": "root", "limb_length": "length"}
        try:
            return limb_reach(candidates, **{names.get(name, name): value for name, value in given.items()})
        except ValueError as error:
            words = str(error)
            limbs = words.split(" ", 1)[0] in names.values()
            raise InputError(f"--{'limb-' if limbs else ''}{words}") from error


def _spelt(name: str) -> str:
    """An option as it is typed."""
    return f"--{name.replace('_', '-')}"
