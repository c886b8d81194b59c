"""The program `jaxcap`: exit codes, signals and messages. The subcommands are in `commands`."""

import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import jaxcap
from jaxcap.errors import InputError, MissingExtra, needs_extra

BAD_INPUT = 2
INTERRUPTED = 128 + signal.SIGINT
BROKEN_PIPE = 128 + 13


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the program. arguments: without the program's name; by default those of the process.

    Returns the exit code: 0 done, 2 bad input (one line on stderr says which), 130 interrupted, 128 + n for signal n.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
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
    """While it lasts, SIGTERM and SIGHUP raise SystemExit, so that temporary files are removed on the way out."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set handlers
        return

    def unwind(number, _frame):
        raise SystemExit(128 + number)

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    numbers = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]  # nohup ignores SIGHUP
    for number in numbers:
        signal.signal(number, unwind)
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(main())
