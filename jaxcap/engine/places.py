"""Places where units run on this machine: in this process, or in spawned ones."""

import multiprocessing
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import cached_property
from multiprocessing.connection import Connection
from typing import Any

from jaxcap.engine.workers import about_here, set_up

LOOKAHEAD = 2
"""Units that are handed over for each worker: one runs, one is there when that ends."""


class Place(ABC):
    """Where units run. An executor of `concurrent.futures` does the work."""

    words: str
    """What it is, in a few words."""

    @property
    @abstractmethod
    def ahead(self) -> int:
        """How many units it may have at a time."""

    @property
    @abstractmethod
    def about(self) -> dict[str, str]:
        """`about_here` of its workers, which are alike."""

    @abstractmethod
    def submit(self, avoid: Sequence[str], call: Callable, *arguments: Any) -> Future:
        """Hands over a call. avoid: workers on which it failed, as `workers.where` names them."""

    def renew(self) -> None:
        """Has workers again, when a process has died and took its executor along."""
        raise NotImplementedError(f"{self.words}: has no executor that breaks")


class Here(Place):
    """This process, one unit after the other; Ctrl-C ends a unit where it stands."""

    words, ahead = "this process", 1

    @cached_property
    def about(self) -> dict[str, str]:
        """Of this process."""
        return about_here()

    def submit(self, avoid: Sequence[str], call: Callable, *arguments: Any) -> Future:
        """Runs it at once."""
        future: Future = Future()
        future.set_result(call(*arguments))
        return future


class Processes(Place):
    """Processes of this machine, spawned, each with its share of the cores. See `processes`."""

    def __init__(self, jobs: int, end: Connection):
        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
        self._cores = [frozenset(cores[i::jobs]) for i in range(jobs)] if len(cores) >= jobs else []
        threads = f"{min(map(len, self._cores))} threads each" if self._cores else "threads as many as cores"
        self.words, self._jobs, self._end = f"{jobs} processes, {threads}", jobs, end
        self.executor = self._begun()

    @property
    def ahead(self) -> int:
        """Twice as many as processes."""
        return LOOKAHEAD * self._jobs

    @cached_property
    def about(self) -> dict[str, str]:
        """Of the first of them: this process may leave the devices alone."""
        return self.executor.submit(about_here).result()

    def submit(self, avoid: Sequence[str], call: Callable, *arguments: Any) -> Future:
        """To the first that is free."""
        return self.executor.submit(call, *arguments)

    def renew(self) -> None:
        """In new processes."""
        self.executor.shutdown(wait=True, cancel_futures=True)
        self.executor = self._begun()

    def _begun(self) -> Executor:
        context = multiprocessing.get_context("spawn")  # a process that has imported JAX is never forked
        arguments = context.Value("i", 0), self._cores, self._end
        return ProcessPoolExecutor(self._jobs, context, set_up, arguments)


@contextmanager
def processes(jobs: int) -> Iterator[Processes]:
    """Spawned processes, in a `with` block. When it ends by an error, the units that run are broken off.

    jobs: how many; each has as many threads as its share of the cores that this process may use.
    """
    end, ours = multiprocessing.get_context("spawn").Pipe(duplex=False)
    place = Processes(jobs, end)
    try:
        yield place
    except BaseException:
        ours.close()
        raise
    finally:
        place.executor.shutdown(wait=True, cancel_futures=True)
        ours.close()
        end.close()
