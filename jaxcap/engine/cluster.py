"""A Dask cluster as a place. Importing this module needs `distributed` (extra `dask`)."""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from pydoc import locate
from typing import Any

import jax
from distributed import Client, LocalCluster
from distributed.scheduler import KilledWorker

from jaxcap.engine.places import Place, begetting
from jaxcap.engine.workers import Terms, worded
from jaxcap.errors import InputError
from jaxcap.version import __version__

ANSWERS = 8.0
"""A scheduler that does not answer within this time is told of [s]."""
FRESH = 2.0
"""How long it is not asked again which workers there are [s]."""


class Cluster(Place):
    """Workers of a Dask scheduler; they may come and go."""

    def __init__(self, client: Client, words: str, terms: Terms):
        self.words, self._client, self.terms = words, client, terms
        self._executor = client.get_executor(pure=False)  # Dask would answer what it has failed at from memory
        self._seen = 0.0
        self._workers: dict[str, int] = {}
        self._about = _alike(client, words, terms.about)

    @property
    def about(self) -> dict[str, str]:
        """Of all of them; a worker that comes later and is different fails its units."""
        return self._about

    @property
    def ahead(self) -> int:
        """A few for each worker."""
        return self.terms.ahead * max(1, len(self._known()))

    def submit(self, avoid: Sequence[str], call: Callable, *arguments: Any) -> Future:
        """To any worker where it has not failed; where it has on all, to any."""
        others = [address for address in self._known() if address not in avoid] if any(avoid) else []
        where = {"workers": others, "allow_other_workers": True} if others else {}
        try:
            return self._executor.submit(call, *arguments, **where)
        except Exception as error:  # tornado's, Dask's or the system's, by the moment at which the connection broke
            raise InputError(f"{self.words}: lost: {error} (what is done stays done)") from error

    def deaths(self, error: BaseException) -> str:
        """Dask has given a unit to other workers until so many had died."""
        return f"its process died on {error.allowed_failures + 1} workers" if isinstance(error, KilledWorker) else ""

    def _known(self) -> dict[str, int]:
        """Workers and their task threads, as of a moment ago."""
        if time.monotonic() - self._seen > FRESH:
            self._workers = _asked(self._client.nthreads, self.words)
            self._seen = time.monotonic()
        return self._workers


@contextmanager
def cluster(address: str, jobs: int, terms: Terms = Terms()) -> Iterator[Cluster]:  # noqa: B008
    """A cluster, in a `with` block.

    Args:
        address: Of its scheduler, as tcp://host:8786; or "local", for one of this machine that lives as long as the block.
        jobs: Workers of a local one.
        terms: What the job asks of workers. The environment and the niceness of those that others started are theirs.

    Raises:
        InputError: If the scheduler does not answer, or a worker has another version of jaxcap or JAX, another kind of
            device, or several task threads.
    """
    if address == "local":
        with begetting(terms.environment):  # a thread of Dask's begins here, and what it starts is spared Ctrl-C
            options = {"n_workers": jobs, "threads_per_worker": 1, "env": dict(terms.environment)}
            local = LocalCluster(dashboard_address=None, **options)
        with local, Client(local, set_as_default=False) as client:
            yield Cluster(client, f"{jobs} workers of a local cluster", terms)
        return
    client = _connected(address)
    try:
        yield Cluster(client, f"scheduler {address}", terms)
    finally:
        client.close(timeout=ANSWERS)


def _connected(address: str) -> Client:
    try:
        return Client(address, timeout=ANSWERS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"--dask {address}: no scheduler answers there (expected tcp://HOST:PORT, or local)") from error


def _alike(client: Client, words: str, find: Callable[[], dict[str, str]]) -> dict[str, str]:
    """What the workers are like. Raises InputError, naming one that is different."""
    while not (threads := _asked(client.nthreads, words)):
        print(f"note: {words} has no worker yet; waiting", file=sys.stderr)
        _asked(lambda: client.wait_for_workers(1), words)
    for worker, count in threads.items():
        if count != 1:
            raise InputError(f"worker {worker} has {count} task threads (expected 1: dask worker --nthreads 1)")
    for name, expected in (("jaxcap", __version__), ("jax", jax.__version__)):
        # a function of Python's own: a worker may have no jaxcap, or one that does not know this module
        found = _asked(lambda: client.run(locate, f"{name}.__version__", on_error="return"), words)  # noqa: B023
        for worker, version in found.items():
            if version != expected:
                has = f"{name} {version}" if isinstance(version, str) else f"no {name}"
                raise InputError(f"worker {worker} has {has} (expected {expected}, as here)")
    module = find.__module__
    for worker, name in _asked(lambda: client.run(locate, f"{module}.__name__", on_error="return"), words).items():
        if name != module:
            raise InputError(f"worker {worker} has no {module} (expected on its PYTHONPATH, as here)")
    abouts = _asked(lambda: client.run(find), words)
    (first, about), *others = abouts.items()
    for worker, other in others:
        if other != about:
            raise InputError(f"worker {worker} has {worded(other)} (expected {worded(about)}, as worker {first})")
    return about


def _asked(question: Callable[[], Any], words: str) -> Any:
    """An answer of the scheduler."""
    try:
        return question()
    except (OSError, TimeoutError) as error:
        raise InputError(f"{words}: does not answer: {error}") from error
