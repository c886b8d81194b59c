"""How long a user waits for the first answer: from the start of the process to the output, nothing compiled, and all kept.

    python -m bench.first_answer [--against OTHER] [--rounds 3] [--tasks NAME ...] [--rows 5000]

Every task runs in a process of its own: `cold` with an empty folder of kept programs, then `warm` with what that left there.
With --against, OTHER being a checkout of another commit, the two trees take turns in every round; each has its own folder.

    seconds     process start to output, the median over the rounds, as all columns
    processor   seconds of all cores together, which a busy machine hardly changes
    imports     until what the task names is imported; what is imported later counts as `other`
    tracing     Python to jaxprs, and `lowering` jaxprs to what XLA takes
    compiling   by XLA, or reading what was kept
    other       the rest: reading files, running, writing
    programs    asked of XLA, the small ones of single operations included, and `large` those that took 0.1 s or more
    kept        programs that came from the folder

Needs the extras cli, data, maps and plots.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench.maps import CONTACTS
from bench.memory import write_states
from bench.speed import table

HERE = Path(__file__).resolve().parents[1]
LARGE = 0.1
"""A program that takes longer to compile is no single operation [s]."""

CHILD = """
import json, resource, sys, time
began, task, large = float(sys.argv[1]), sys.argv[2], float(sys.argv[3])
spans, events = {}, {}

def duration(name, seconds, **_):
    spans.setdefault(name.rsplit("/", 1)[-1], []).append((time.perf_counter() - seconds, time.perf_counter()))

def covered(name):  # a trace may contain another
    total, until = 0.0, 0.0
    for start, end in sorted(spans.get(name, ())):
        total += max(0.0, end - max(start, until))
        until = max(until, end)
    return total

import jax
jax.monitoring.register_event_duration_secs_listener(duration)
jax.monitoring.register_event_listener(lambda name, **_: events.update({name: events.get(name, 0) + 1}))
exec(sys.argv[4])
imported = time.time()
exec(sys.argv[5])
end = time.time()
of_xla = [stop - start for start, stop in spans.get("backend_compile_duration", ())]
parts = {
    "seconds": end - began,
    "processor": sum(resource.getrusage(resource.RUSAGE_SELF)[:2]),
    "imports": imported - began,
    "tracing": covered("jaxpr_trace_duration"),
    "lowering": covered("jaxpr_to_mlir_module_duration"),
    "compiling": covered("backend_compile_duration"),
}
parts["other"] = parts["seconds"] - sum(list(parts.values())[2:])
parts["programs"] = len(of_xla)
parts["large"] = sum(seconds >= large for seconds in of_xla)
parts["kept"] = events.get("/jax/compilation_cache/cache_hits", 0)
print("FIRST ANSWER", json.dumps(parts))
"""
"""Takes the time when it was started, the task's name, LARGE, what to import, and what to do."""

COMMAND = "from jaxcap.commands.cli import main; import jaxcap.commands.app"
LIBRARY = "import numpy as np, jaxcap, yaml"
GIVEN = """
jaxcap.keep_programs()
data = np.load("states.npz")
coms, velocities = data["com"], data["com_velocity"]
foot = lambda y: jaxcap.rectangle([0, y, 0], np.eye(3), 0.1, 0.05, 0.5)
feet = foot(0.1) + foot(-0.1)
"""
SHOWN = "\njax.block_until_ready(answer); print(answer)"

TASKS = {
    "jaxcap score": (
        COMMAND,
        'assert main(["score", "states.parquet", "--contacts", "c.yaml", "-o", "scores.parquet", "--force"]) == 0',
    ),
    "score": (LIBRARY, GIVEN + "answer = jaxcap.score(jaxcap.centroidal_cone(feet), coms, velocities)" + SHOWN),
    "ray form": (
        LIBRARY,
        GIVEN
        + "n = len(coms); shifts = np.random.default_rng(0).uniform(-0.02, 0.02, (n, 1, 3))\n"
        + "sets = jaxcap.ContactSet(feet.points + shifts, np.broadcast_to(feet.frames, (n, *feet.frames.shape)), 0.5)\n"
        + "answer = jaxcap.score(jaxcap.cone_rays(sets), coms, velocities)"
        + SHOWN,
    ),
    "grad": (
        LIBRARY,
        GIVEN
        + "cone = jaxcap.centroidal_cone(feet)\n"
        + "margin = lambda com: jaxcap.capturability(cone, com, velocities[0]).margin\n"
        + "answer = jax.grad(margin)(coms[0])"
        + SHOWN,
    ),
    "jaxcap map": (COMMAND, 'assert main(["map", "c.yaml", "-o", "new.zarr", "--force"]) == 0'),
    "jaxcap plot": (COMMAND, 'assert main(["plot", "map.zarr", "-o", "map.png", "--force"]) == 0'),
}
"""What to import, and what to do then, in a folder with states, contacts and a map."""


def prepare(folder: Path, rows: int) -> None:
    """What the tasks read."""
    write_states(folder / "states.parquet", rows)
    rng = np.random.default_rng(0)
    coms = rng.uniform([-0.2, -0.2, 0.7], [0.2, 0.2, 1.0], (rows, 3)).astype(np.float32)
    np.savez(folder / "states.npz", com=coms, com_velocity=rng.uniform(-1, 1, (rows, 3)).astype(np.float32))
    (folder / "c.yaml").write_text(CONTACTS.read_text())
    code = 'from jaxcap.commands.cli import main; assert main(["map", "c.yaml", "-o", "map.zarr", "--no-cache"]) == 0'
    subprocess.run([sys.executable, "-c", code], check=True, cwd=folder, env=_environment(HERE, folder), capture_output=True)


def _environment(tree: Path, kept: Path) -> dict[str, str]:
    """That of a user who has told JAX of no folder: programs are kept below `kept`."""
    others = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    return others | {"PYTHONPATH": str(tree), "XDG_CACHE_HOME": str(kept)}


def measured(tree: Path, task: str, folder: Path, kept: Path) -> dict[str, float]:
    """One process. Raises RuntimeError, with what it wrote to standard error, where it fails."""
    program = [sys.executable, "-c", CHILD, str(time.time()), task, str(LARGE), *TASKS[task]]
    run = subprocess.run(program, cwd=folder, env=_environment(tree, kept), capture_output=True, text=True)
    if run.returncode:
        raise RuntimeError(run.stderr)
    return json.loads(run.stdout.rpartition("FIRST ANSWER")[2])


def compared(trees: Sequence[Path], tasks: Sequence[str], rounds: int, rows: int) -> list[dict]:
    """A line for each task, cold and warm, and tree."""
    found: dict[tuple[str, str, Path], list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder, rows)
        for number in range(rounds):
            for task in tasks:
                for cache in ("cold", "warm"):
                    for which, tree in enumerate(trees):
                        print(f"round {number + 1} of {rounds}: {task}, {cache}, {tree}", file=sys.stderr, flush=True)
                        kept = folder / f"kept {number} {task} {which}"
                        found.setdefault((task, cache, tree), []).append(measured(tree, task, folder, kept))
    lines = []
    for (task, cache, tree), runs in found.items():
        middle = {column: statistics.median(run[column] for run in runs) for column in runs[0]}
        lines.append({"task": task, "cache": cache, "tree": "this" if tree == HERE else "other", **middle})
    return lines


def main() -> None:
    """Parse, measure, print."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.first_answer", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--against", type=Path, metavar="OTHER", help="a checkout of another commit, measured in turn")
    parser.add_argument(
        "--tasks", nargs="+", choices=tuple(TASKS), default=tuple(TASKS), metavar="NAME", help="(default: all)"
    )
    parser.add_argument("--rounds", type=int, default=3, help="(default: 3)")
    parser.add_argument("--rows", type=int, default=5000, help="states of score and ray form (default: 5000)")
    options = parser.parse_args()
    trees = [HERE] if options.against is None else [options.against.resolve(), HERE]
    print(table(compared(trees, options.tasks, options.rounds, options.rows)))


if __name__ == "__main__":
    main()
