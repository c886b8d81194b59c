"""`jaxcap` in a process of its own: how long it takes, and in how much memory.

The peak is the largest resident memory of the process, interpreter and JAX included, as Linux counts it for the program
alone (VmHWM: ru_maxrss would begin with what the parent held); elsewhere ru_maxrss.
"""

import json
import subprocess
import sys
from typing import NamedTuple

CHILD = """
import json, resource, sys, time
from jaxcap.commands.cli import main

def peak():
    try:
        with open("/proc/self/status") as status:
            return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmHWM"))
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)

start = time.perf_counter()
code = main(sys.argv[1:])
print(json.dumps({"seconds": time.perf_counter() - start, "peak_bytes": peak()}))
sys.exit(code)
"""


class Cost(NamedTuple):
    """What one command took."""

    seconds: float
    """Of the whole command without starting Python."""
    peak_bytes: int
    """Largest resident memory."""


def in_process(command: list[str]) -> Cost:
    """Runs `jaxcap` with these arguments. Raises RuntimeError, with what it wrote to standard error, where it fails."""
    done = subprocess.run([sys.executable, "-c", CHILD, *command], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return Cost(**json.loads(done.stdout.splitlines()[-1]))
