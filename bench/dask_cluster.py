"""A Dask cluster of real processes, for tests and measurements: a scheduler and workers, each started as a command."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

ROOT = Path(__file__).parents[1]
PATIENCE = 60.0
"""What takes longer does not work [s]."""


class DaskCluster:
    """A scheduler and its workers. Everything ends with the `with` block."""

    def __init__(self, folder: Path, workers: int = 2):
        self._folder, self._processes = folder, []
        with closing(socket.socket()) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{port}"
        self._port = str(port)
        self.scheduler = self.start_scheduler()
        self.workers = [self.start_worker() for _ in range(workers)]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in self._processes:
            process.kill()
            process.wait()

    def start_scheduler(self) -> subprocess.Popen:
        """Once more at the same address, after the one before was killed."""
        options = ["--host", "127.0.0.1", "--port", self._port, "--no-dashboard"]
        return self._start("distributed.cli.dask_scheduler", *options)

    def start_worker(self, threads: int = 1, path: str = "") -> subprocess.Popen:
        """A worker, without a nanny that would start it again. path: before all else where it looks for packages."""
        options = ["--nthreads", str(threads), "--no-nanny", "--no-dashboard", "--local-directory", str(self._folder)]
        return self._start("distributed.cli.dask_worker", self.address, *options, path=path)

    def _start(self, module: str, *options: str, path: str = "") -> subprocess.Popen:
        where = os.pathsep.join(filter(None, [path, str(ROOT), str(ROOT / "tests")]))
        log = open(self._folder / f"log-{len(self._processes)}", "wb")  # noqa: SIM115
        process = subprocess.Popen(
            [sys.executable, "-m", module, *options],
            stdout=log,
            stderr=log,
            env={**os.environ, "PYTHONPATH": where},
            cwd=self._folder,  # or the packages beside the tests would come before those of `path`
        )
        log.close()
        self._processes.append(process)
        return process


def until(true, process: subprocess.Popen | None = None, patience: float = PATIENCE) -> None:
    """Waits until something is true; fails if it takes too long, or if the process ends before."""
    end = time.monotonic() + patience
    while not true():
        assert time.monotonic() < end and (process is None or process.poll() is None)
        time.sleep(0.02)


def jaxcap(*arguments) -> subprocess.Popen:
    """The program, in a process of its own."""
    return program("jaxcap.commands.cli", *arguments)


def program(module: str, *arguments) -> subprocess.Popen:
    """A module that is run, in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", module, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def kill(process: subprocess.Popen) -> None:
    """SIGKILL."""
    process.send_signal(signal.SIGKILL)
    process.wait()
