"""The program `jaxcap`: exit codes, signals and messages. The subcommands are in `commands`."""

import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType

import jaxcap
from jaxcap.errors import InputError, MissingExtra, needs_extra

BAD_INPUT = 2
SIGNALLED = 128
"""The exit code of what signal n ended is n more than this."""
INTERRUPTED = SIGNALLED + signal.SIGINT
BROKEN_PIPE = SIGNALLED + 13
AGAIN = 0.05
"""A signal whose exception was lost is sent again after this time [s]."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the program.

    Args:
        arguments: Without the program's name; by default those of the process, which then is left for good by a signal.

    Returns:
        The exit code: 0 done, 2 bad input (one line on stderr says which), 130 interrupted, 128 + n for signal n.
    """
    code = _outcome(sys.argv[1:] if arguments is None else list(arguments))
    if arguments is None and code > SIGNALLED:
        _leave(code)
    return code


def _leave(code: int) -> None:
    """Ends the process at once: threads that are still inside XLA would meet an interpreter that is being taken down, and
    then the process ends by a segmentation fault, not by this code. What had to be removed or closed is, by unwinding.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # a closed pipe
            stream.flush()
    os._exit(code)


def _outcome(arguments: list[str]) -> int:
    """Runs a subcommand; what it raises becomes a line and an exit code."""
    if arguments == ["--version"]:
        print(f"jaxcap {jaxcap.__version__}")
        return 0
    try:
        with _signals_unwind():
            with needs_extra("cli", "the command line"):
                from jaxcap.commands.app import run
            run(arguments)
            sys.stdout.flush()
    except (InputError, MissingExtra) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our text went away, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the interpreter meets it again at its end
        return BROKEN_PIPE
    except SystemExit as stop:  # --help and wrong usage by tyro, a signal by the handler below
        return stop.code if isinstance(stop.code, int) else 0
    return 0


@contextmanager
def _signals_unwind() -> Iterator[None]:
    """While it lasts, SIGTERM and SIGHUP raise SystemExit, so that temporary files are removed on the way out.

    An exception that a handler raises inside a callback of a library is lost: Python reports it and goes on. Then the signal
    is sent again.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set handlers
        return

    def unwind(number: int, _frame: FrameType | None) -> None:
        raise SystemExit(SIGNALLED + number)

    report = sys.unraisablehook

    def send_again(lost: "sys.UnraisableHookArgs") -> None:
        error = lost.exc_value
        if isinstance(error, KeyboardInterrupt):
            number = int(signal.SIGINT)
        elif isinstance(error, SystemExit) and isinstance(error.code, int) and error.code > SIGNALLED:
            number = error.code - SIGNALLED
        else:
            report(lost)
            return
        threading.Timer(AGAIN, os.kill, (os.getpid(), number)).start()

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    numbers = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]  # nohup ignores SIGHUP
    for number in numbers:
        signal.signal(number, unwind)
    sys.unraisablehook = send_again
    try:
        yield
    finally:
        sys.unraisablehook = report
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(main())
