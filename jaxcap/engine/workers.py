"""What runs on a worker, wherever that is: one try of a unit, and how a process of ours is set up."""

import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.connection import Connection
from types import MappingProxyType
from typing import Any, NamedTuple

import jax

from jaxcap.errors import InputError
from jaxcap.version import __version__

GRACE = 10.0
"""What a process that is told to end has to clean up in [s]."""


class Unit(NamedTuple):
    """A piece of a job that is done as a whole, and may be done twice."""

    number: int
    what: Any
    """What the work is given."""


class Attempt(NamedTuple):
    """One try of a unit."""

    value: Any
    error: str
    """Empty where it is done."""
    where: str
    """The worker: its address in a cluster, else host and process."""


def about_here() -> dict[str, str]:
    """What answers depend on besides the settings: versions, and what computes. JAX begins to compute by this."""
    return {"jaxcap": __version__, "jax": jax.__version__, "backend": jax.default_backend()}


class Terms(NamedTuple):
    """What a job asks of those who work on it."""

    about: Callable[[], dict[str, str]] = about_here
    """Of a process: what answers depend on besides the settings. It is the same in all of them, or they are refused."""
    ahead: int = 2
    """Units that are handed over for each worker: one runs, the others are there when that ends."""
    environment: Mapping[str, str] = MappingProxyType({})
    """Of the processes that are started for the job, before they import anything."""
    niceness: int = 0
    """Of these processes."""


class _Ended(SystemExit):
    """This process was told to end."""


def attempt(work: Callable[[Any], Any], unit: Unit, find: Callable[[], dict[str, str]], about: Mapping[str, str]) -> Attempt:
    """Tries a unit once; what goes wrong is told, not raised. about: what `find`, of `Terms`, has to find here."""
    try:
        here = find()
        if here != about:
            raise InputError(f"worker {where()} has {worded(here)} (expected {worded(about)})")
        return Attempt(work(unit.what), "", where())
    except _Ended as ended:  # the work has cleaned up; an executor would take this for an answer, and wait for more work
        os._exit(ended.code if isinstance(ended.code, int) else 1)
    except Exception as error:
        told = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        return Attempt(None, " ".join(told.split()) or type(error).__name__, where())


def worded(about: Mapping[str, str]) -> str:
    """For a message."""
    return ", ".join(f"{name} {value}" for name, value in about.items())


def where() -> str:
    """This worker."""
    distributed = sys.modules.get("distributed")
    if distributed is not None:
        try:
            return distributed.get_worker().address
        except ValueError:  # it is no worker of a cluster
            pass
    return f"{socket.gethostname()}:{os.getpid()}"


def set_up(places: Any, cores: Sequence[frozenset[int]], end: Connection, niceness: int) -> None:
    """Makes a new process a worker, before JAX begins to compute in it.

    Args:
        places: A shared number, of the workers that there are so far.
        cores: Those of each worker in turn; its threads are as many. Empty: the system decides.
        end: Closes when the parent wants an end, or has died.
        niceness: See `Terms`.
    """
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group: the parent decides
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # it was born with it blocked
    signal.signal(signal.SIGTERM, _unwind)
    if niceness:
        os.nice(niceness)
    with places.get_lock():
        place, places.value = places.value, places.value + 1
    if cores:
        os.sched_setaffinity(0, cores[place % len(cores)])
    threading.Thread(target=_end_with_parent, args=(end,), daemon=True).start()


def _unwind(number: int, _frame: Any) -> None:
    """Temporary files are removed on the way out."""
    raise _Ended(128 + number)


def _end_with_parent(end: Connection) -> None:
    try:
        end.recv_bytes()
    except (EOFError, OSError):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(GRACE)
        os._exit(1)
