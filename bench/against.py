"""Is this tree as fast as another? `python -m bench.against OTHER`, OTHER a checkout of another commit.

Times `score` on the shipped states (single precision, all fields, one million of them by repetition), on contact sets of
each state's own, and on few and many rows of NumPy's, each as one call; and the import. The two trees take turns, each turn
in a process of its own; what is printed are the best of all turns and their ratio, old to new in time. Compiling is not
counted.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
STATES = 1_000_000
OWN = 65_536
ROWS = (1, 2, 100, 500, 501, 5000, 100_000)
"""Rows of a call: what a call costs besides its states shows in the small ones."""

TURN = """
import json, sys, time
start = time.perf_counter()
import jaxcap
spent = {"import": time.perf_counter() - start}
import jax, numpy as np, pyarrow.parquet as pq, yaml
data, states, own, rounds = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), 3

def timed(name, call, rounds=rounds):
    jax.block_until_ready(call())
    for _ in range(rounds):
        start = time.perf_counter()
        jax.block_until_ready(call())
        spent[name] = min(spent.get(name, 1e9), time.perf_counter() - start)

def one(contact):
    frame = np.array(contact.get("rotation", np.eye(3)))
    sizes = contact["half_length"], contact["half_width"]
    return jaxcap.rectangle(contact["position"], frame, *sizes, contact["friction"])

for stance in ("talos_two_feet", "talos_hand_on_wall", "talos_slopes_and_rail"):
    table = pq.read_table(f"{data}/{stance}.parquet")
    first, *others = [one(c) for c in yaml.safe_load(open(f"{data}/{stance}.yaml"))["contacts"]]
    contacts = sum(others, first)
    on_device = lambda name, n: jax.device_put(np.resize(np.stack(table[name].to_pylist()), (n, 3)).astype(np.float32))
    cone = jax.tree.map(lambda leaf: jax.device_put(np.asarray(leaf, np.float32)), jaxcap.centroidal_cone(contacts))
    coms, velocities = on_device("com", states), on_device("com_velocity", states)
    timed(stance, lambda: jaxcap.score(cone, coms, velocities))
    if stance == "talos_two_feet":
        here = jaxcap.centroidal_cone(contacts), np.asarray(coms), np.asarray(velocities)
        for n in map(int, sys.argv[4:]):
            first = lambda: jaxcap.score(here[0], here[1][:n], here[2][:n])
            timed(f"{n} rows", first, max(rounds, min(100, 100_000 // n)))
shifts = np.random.default_rng(0).uniform(-0.02, 0.02, (own, 1, 3))
frames = np.broadcast_to(contacts.frames, (own, *contacts.frames.shape))
rays = jaxcap.cone_rays(jaxcap.ContactSet(contacts.points + shifts, frames, 0.5))
rays = jax.tree.map(lambda leaf: jax.device_put(np.asarray(leaf, np.float32 if leaf.dtype != bool else bool)), rays)
timed("own contact sets", lambda: jaxcap.score(rays, coms[:own], velocities[:own]))
print(json.dumps(spent))
"""


def turn(tree: Path, states: int, own: int) -> dict[str, float]:
    """Seconds of each part, best of three."""
    numbers = map(str, (states, own, *ROWS))
    program = [sys.executable, "-c", TURN, str(HERE / "bench" / "data"), *numbers]
    out = subprocess.run(
        program, check=True, cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)}, capture_output=True, text=True
    )
    return json.loads(out.stdout)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(prog="python -m bench.against", description=__doc__.split("\n\n")[0])
    parser.add_argument("other", type=Path, help="a checkout of another commit")
    parser.add_argument("--states", type=int, default=STATES, help=f"of the shipped ones (default: {STATES:,})")
    parser.add_argument("--own", type=int, default=OWN, help=f"with contacts of their own (default: {OWN:,})")
    parser.add_argument("--turns", type=int, default=3, help="of each tree (default: 3)")
    options = parser.parse_args()
    best: tuple[dict[str, float], dict[str, float]] = ({}, {})
    for number in range(options.turns):
        for tree, kept in zip((options.other.resolve(), HERE), best, strict=True):
            print(f"turn {number + 1} of {options.turns}: {tree.name}", file=sys.stderr, flush=True)
            for name, seconds in turn(tree, options.states, options.own).items():
                kept[name] = min(kept.get(name, seconds), seconds)
    print(f"{'':24s}{'old s':>10s}{'new s':>10s}{'old / new':>10s}")
    for name, old in best[0].items():
        print(f"{name:24s}{old:10.5f}{best[1][name]:10.5f}{old / best[1][name]:10.3f}")


if __name__ == "__main__":
    main()
