"""Units of work, handed to a place with bounded lookahead; what fails is tried again, and what dies takes nothing along."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from typing import Any, NamedTuple

from jaxcap.engine.places import Place
from jaxcap.engine.workers import Attempt, Unit, attempt
from jaxcap.errors import InputError

TRIES = 3
"""How often a unit is tried in all."""


class Finished(NamedTuple):
    """What became of a unit."""

    unit: Unit
    value: Any
    """What the work returned."""
    error: str = ""
    """Why it failed, the last time; empty where it is done."""
    died: bool = False
    """It failed because its process died."""


class _Try(NamedTuple):
    """A unit that waits or runs."""

    unit: Unit
    failed_at: tuple[str, ...] = ()
    """The workers on which it failed, or died."""
    alone: bool = False
    """It ran when a process died, and one such unit may be to blame: nothing runs beside it until that is known."""


def over_units(place: Place, work: Callable[[Any], Any], units: Iterable[Unit], tries: int = TRIES) -> Iterator[Finished]:
    """Units as they are finished, in any order. A unit that fails is tried again, elsewhere if there is an elsewhere, and
    then reported, while the others go on.

    Args:
        place: Where they run.
        work: What is done with `Unit.what`; can be pickled, does the same however often it runs, and ends in an atomic
            rename, or what serves as one.
        units: They are taken and handed over in this order, a few more at a time than there are workers.
        tries: How often each is tried at most.

    Raises:
        InputError: If the place is lost, as with a scheduler that died. Then, and for an interruption, what is done stays
            done, and nothing more is handed over.
    """
    hand = _Hand(place, work, map(_Try, units), tries)
    try:
        while hand.fill():
            yield from hand.collected()
    finally:
        for future in hand.running:
            future.cancel()


class _Hand:
    """What waits, what runs, and how one becomes the other."""

    def __init__(self, place: Place, work: Callable[[Any], Any], fresh: Iterator[_Try], tries: int):
        self._place, self._work, self._fresh, self._tries = place, work, fresh, tries
        self._suspects: deque[_Try] = deque()
        self._again: deque[_Try] = deque()
        self.running: dict[Future[Attempt], _Try] = {}

    def fill(self) -> bool:
        """Hands over as much as the place may have. Returns whether anything runs: else all is done."""
        while len(self.running) < self._room() and (one := self._next()) is not None:
            about = self._place.terms.about, self._place.about
            try:
                self.running[self._place.submit(one.failed_at, attempt, self._work, one.unit, *about)] = one
            except BrokenExecutor:  # a process died since we looked
                self._suspects.append(one)
                self._renewed()
        return bool(self.running)

    def _next(self) -> _Try | None:
        """What failed is tried again at the end: by then other workers are free."""
        if self._suspects:
            return self._suspects.popleft()
        return next(self._fresh, None) or (self._again.popleft() if self._again else None)

    def _room(self) -> int:
        lonely = self._suspects or any(one.alone for one in self.running.values())
        return 1 if lonely else self._place.ahead

    def collected(self) -> Iterator[Finished]:
        """Waits for a unit at least."""
        dead = []
        for future in wait(self.running, return_when=FIRST_COMPLETED).done:
            one = self.running.pop(future)
            if future.cancelled():
                raise InputError(f"{self._place.words}: lost (what is done stays done: the same command goes on from there)")
            error = future.exception()
            if isinstance(error, BrokenExecutor):
                dead.append(one)
            elif error is not None and (told := self._place.deaths(error)):
                yield Finished(one.unit, None, told, died=True)
            elif error is not None:  # nothing of ours: it could not be sent, for one
                yield from self._failed(one, "", f"{type(error).__name__}: {error}")
            elif (done := future.result()).error:
                yield from self._failed(one, done.where, done.error)
            else:
                yield Finished(one.unit, done.value)
        if dead:
            lonely = len(dead) + len(self.running) == 1
            how = self._renewed()
            for one in dead:
                yield from self._died(one._replace(alone=one.alone or lonely), how)

    def _failed(self, one: _Try, where: str, error: str) -> Iterator[Finished]:
        failed_at = (*one.failed_at, where)
        if len(failed_at) >= self._tries:
            yield Finished(one.unit, None, error)
        else:  # at the end: by then other workers are free
            self._again.append(one._replace(failed_at=failed_at, alone=False))

    def _died(self, one: _Try, how: str) -> Iterator[Finished]:
        """A process died, and with it all of its executor: it was this unit's doing only if nothing else ran."""
        failed_at = (*one.failed_at, "") if one.alone else one.failed_at
        if len(failed_at) >= self._tries:
            yield Finished(one.unit, None, f"its process died {how}".strip(), died=True)
        else:
            self._suspects.append(one._replace(failed_at=failed_at, alone=True))

    def _renewed(self) -> str:
        self._suspects.extend(one._replace(alone=True) for one in self.running.values())
        self.running.clear()
        return self._place.renew()
