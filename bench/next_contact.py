"""How fast next contacts are found: pairs of state and candidate a second, and one state with 64 candidates.

    python -m bench.next_contact [--pairs 65536] [--float64]

Two feet, and hands at random on a wall in reach of them; states are pushes towards it.
"""

import argparse
import statistics

import jax
import numpy as np

import jaxcap
from bench.timing import spent

WALL = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0.0]])
"""Frame of a hand on the wall x = 0.6 m: its normal points back at the robot."""
CANDIDATES = 64
ROUNDS = 9


def feet() -> jaxcap.ContactSet:
    """Both soles of a humanoid on the floor."""
    sole = lambda y: jaxcap.rectangle([0, y, 0], np.eye(3), 0.1, 0.065, 0.5)
    return sole(0.1) + sole(-0.1)


def hands(rng: np.random.Generator, count: int) -> jaxcap.ContactSet:
    """Palms on the wall."""
    centres = np.column_stack([np.full(count, 0.6), rng.uniform(-0.5, 0.5, count), rng.uniform(0.7, 1.5, count)])
    palms = [jaxcap.rectangle(centre, WALL, 0.05, 0.04, 0.6) for centre in centres]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *palms)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=1 << 16)
    parser.add_argument("--float64", action="store_true")
    options = parser.parse_args()
    dtype = np.float64 if options.float64 else np.float32
    with jax.enable_x64(options.float64):
        rng = np.random.default_rng(0)
        candidates, n = hands(rng, CANDIDATES), options.pairs // CANDIDATES
        coms = np.column_stack([rng.uniform(-0.05, 0.15, n), rng.uniform(-0.1, 0.1, n), rng.uniform(0.8, 0.9, n)])
        velocities = np.column_stack([rng.uniform(0.2, 0.8, n), rng.uniform(-0.3, 0.3, n), np.zeros(n)])
        coms, velocities = coms.astype(dtype), velocities.astype(dtype)
        many = lambda: jaxcap.next_contacts(feet(), coms, velocities, candidates, 0.2)
        one = lambda: jaxcap.next_contacts(feet(), coms[0], velocities[0], candidates, 0.2)
        print(f"{dtype.__name__}, {jax.default_backend()}")
        for name, call, pairs in (("many states", many, n * CANDIDATES), ("one state", one, CANDIDATES)):
            first, _ = spent(call)
            seconds = [spent(call)[0] for _ in range(ROUNDS)]
            best, middle = min(seconds), statistics.median(seconds)
            print(
                f"{name:12} {pairs:7,} pairs  first call {first:5.1f} s  median {1e3 * middle:8.2f} ms  "
                f"best {1e3 * best:8.2f} ms  {pairs / middle:9,.0f} pairs/s"
            )


if __name__ == "__main__":
    main()
