"""A few processes that answer questions: spawned, never forked; one core each; a death is an answer too."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any

SPAWN = multiprocessing.get_context("spawn")

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Environment variables that make a process's linear algebra use one core."""

NICENESS = 10

TRIALS = 2
"""How often a question is asked whose process dies over it: a kill from outside hits it once, a crash of its own again."""


class Died(str):
    """The answer where the process died: what is known of it."""


def answers(
    build: Callable[..., Callable[[int], Any]], arguments: tuple, questions: Iterable[int], jobs: int
) -> Iterator[tuple[int, Any]]:
    """(question, answer) in the order in which answers come.

    build: called in each process with `arguments`, returns what answers questions; both must be picklable. What it
    raises ends the process, so it should raise nothing. Closing the iterator ends the processes at once.
    """
    questions, todo = iter(questions), []
    active: dict[Connection, tuple[Any, int, int]] = {}  # connection -> process, question, trial
    idle: list[tuple[Connection, Any]] = []
    try:
        while True:
            while len(active) < jobs:
                question, trial = todo.pop() if todo else (next(questions, None), 1)
                if question is None:
                    break
                connection, process = idle.pop() if idle else _start(build, arguments)
                active[connection] = (process, question, trial)
                _ask(connection, question)
            if not active:
                return
            for connection in wait(list(active)):
                process, question, trial = active.pop(connection)
                try:
                    answer = connection.recv()
                except (EOFError, ConnectionResetError):
                    process.join()
                    connection.close()
                    if trial < TRIALS:
                        todo.append((question, trial + 1))
                        continue
                    answer = Died(f"its process died with exit code {process.exitcode}")
                else:
                    idle.append((connection, process))
                yield question, answer
    finally:
        _end([(connection, process) for connection, (process, _, _) in active.items()] + idle)


def _ask(connection: Connection, question: int) -> None:
    with suppress(BrokenPipeError, ConnectionResetError):  # dead already: receiving will say so
        connection.send(question)


def _start(build: Callable, arguments: tuple) -> tuple[Connection, Any]:
    ours, theirs = SPAWN.Pipe()
    process = SPAWN.Process(target=_work, args=(theirs, build, arguments), daemon=True)
    with _environment(), _no_interrupts():
        process.start()
    theirs.close()  # so that its death reads as an end of file
    return ours, process


def _work(connection: Connection, build: Callable, arguments: tuple) -> None:
    """In the process: answers until the other side closes, or is killed."""
    os.nice(NICENESS)
    answer = build(*arguments)
    while True:
        try:
            question = connection.recv()
            connection.send(answer(question))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return


def _end(processes: list[tuple[Connection, Any]]) -> None:
    for connection, process in processes:
        connection.close()
        process.terminate()
    for _, process in processes:
        process.join()


@contextmanager
def _environment() -> Iterator[None]:
    """One thread for the libraries that the new process will import."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """The new process inherits that Ctrl-C is ignored: its parent ends it."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
