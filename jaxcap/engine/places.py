"""Places where units run on this machine: in this process, or in spawned ones."""

import multiprocessing
import os
import signal
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import cached_property
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from jaxcap.engine.workers import Terms, set_up

ASKED_TO = (None, 0, -signal.SIGTERM, 128 + signal.SIGTERM)
"""Exit codes of processes that ended because another had died."""


class Place(ABC):
    """Where units run. An executor of `concurrent.futures` does the work."""

    words: str
    """What it is, in a few words."""
    terms: Terms = Terms()
    """What the job asks of its workers."""

    @property
    @abstractmethod
    def ahead(self) -> int:
        """How many units it may have at a time."""

    @property
    @abstractmethod
    def about(self) -> dict[str, str]:
        """What `Terms.about` finds of its workers, which are alike."""

    @abstractmethod
    def submit(self, avoid: Sequence[str], call: Callable, *arguments: Any) -> Future:
        """Hands over a call. avoid: workers on which it failed, as `workers.where` names them."""

    def renew(self) -> str:
        """Has workers again, when a process has died and took its executor along. Returns how it died, if that is known."""
        raise NotImplementedError(f"{self.words}: has no executor that breaks")

    def deaths(self, error: BaseException) -> str:
        """What an error of the executor says if it gave a unit up because processes died over it; else nothing."""
        return ""


class Here(Place):
    """This process, one unit after the other; Ctrl-C ends a unit where it stands."""

    words, ahead = "this process", 1

    def __init__(self, terms: Terms = Terms()):  # noqa: B008
        self.terms = terms

    @cached_property
    def about(self) -> dict[str, str]:
        """Of this process."""
        return self.terms.about()

    def submit(self, avoid: Sequence[str], call: Callable, *arguments: Any) -> Future:
        """Runs it at once."""
        future: Future = Future()
        future.set_result(call(*arguments))
        return future


class Processes(Place):
    """Processes of this machine, spawned, each with its share of the cores. See `processes`."""

    def __init__(self, jobs: int, end: Connection, terms: Terms):
        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
        self._cores = [frozenset(cores[i::jobs]) for i in range(jobs)] if len(cores) >= jobs else []
        threads = f"{min(map(len, self._cores))} threads each" if self._cores else "threads as many as cores"
        self.words = "a process of its own" if jobs == 1 else f"{jobs} processes, {threads}"
        self.terms, self._jobs, self._end = terms, jobs, end
        self._children: set[BaseProcess] = set()
        self.executor: Executor = self._begun()

    @property
    def ahead(self) -> int:
        """A few for each process."""
        return self.terms.ahead * self._jobs

    @cached_property
    def about(self) -> dict[str, str]:
        """Of the first of them: this process may leave the devices alone."""
        return self.submit((), self.terms.about).result()

    def submit(self, avoid: Sequence[str], call: Callable, *arguments: Any) -> Future:
        """To the first that is free."""
        return self.executor.submit(call, *arguments)

    def renew(self) -> str:
        """In new processes."""
        self.executor.shutdown(wait=True, cancel_futures=True)
        codes = {child.exitcode for child in self._children} - set(ASKED_TO)
        self.executor = self._begun()
        return f"with exit code {codes.pop()}" if len(codes) == 1 else ""

    def _begun(self) -> Executor:
        context = multiprocessing.get_context("spawn")  # a process that has imported JAX is never forked
        arguments = context.Value("i", 0), self._cores, self._end, self.terms.niceness
        executor = ProcessPoolExecutor(self._jobs, context, set_up, arguments)
        before = set(multiprocessing.active_children())
        with begetting(self.terms.environment):
            while len(children := set(multiprocessing.active_children()) - before) < self._jobs:
                executor.submit(os.getpid)  # starts a process if none is idle
        executor.submit(os.getpid)  # or nobody would look whether the last one lives
        self._children = children
        return executor


@contextmanager
def begetting(environment: Mapping[str, str]) -> Iterator[None]:
    """A process that is started in this block has this environment, and no Ctrl-C until it is set up."""
    before = {name: os.environ.get(name) for name in environment}
    resource_tracker.ensure_running()  # it is started with the first process, and unblocks Ctrl-C
    masked = hasattr(signal, "pthread_sigmask")
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masked else set()
    os.environ.update(environment)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
        if masked:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextmanager
def processes(jobs: int, terms: Terms = Terms()) -> Iterator[Processes]:  # noqa: B008
    """Spawned processes, in a `with` block. When it ends by an error, the units that run are broken off.

    Args:
        jobs: How many; each has as many threads as its share of the cores that this process may use.
        terms: What the job asks of them.
    """
    end, ours = multiprocessing.get_context("spawn").Pipe(duplex=False)
    place = Processes(jobs, end, terms)
    try:
        yield place
    except BaseException:
        ours.close()
        raise
    finally:
        place.executor.shutdown(wait=True, cancel_futures=True)
        ours.close()
        end.close()
