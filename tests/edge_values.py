"""Right answers for the states of `tests/edges.json`, by linear programs: python -m tests.edge_values tests/edges.json

Prints the file again with `true` filled in: for a quarter, once and four times the state's speed, which of the two verdicts
holds for some state within rounding of this one (`bench.fuzz_judge`). Both do where the state lies on a boundary. No line of
jaxcap takes part.
"""

import json
import sys
from pathlib import Path

import numpy as np

from bench.fuzz_judge import state_of, true_of_some
from bench.fuzz_kinds import Sample

FACTORS = (0.25, 1.0, 4.0)
"""Of the state's speed."""


def truths(entry: dict) -> list[list[bool]]:
    """The verdicts that are true of some state near this one, at each of the speeds."""
    arrays = {name: np.array(entry[name], float) for name in ("points", "frames", "friction", "com", "com_velocity")}
    frames = np.broadcast_to(arrays["frames"], (len(arrays["points"]), 3, 3))
    states = arrays["com"][None], arrays["com_velocity"][None]
    sample = Sample(entry["kind"], 0, entry["sides"], arrays["points"], frames, arrays["friction"], *states)
    sample = sample.rounded(entry["dtype"])
    speed = float(np.linalg.norm(sample.velocities[0]))
    at = lambda factor: state_of(sample, 0, entry["dtype"], factor * speed)
    return [[claim for claim in (False, True) if true_of_some(at(factor), claim)] for factor in FACTORS]


def main(path: str) -> None:
    """Print the file with the truths."""
    entries = json.loads(Path(path).read_text())
    for entry in entries:
        entry["true"] = truths(entry)
        print(entry["name"], entry["true"], file=sys.stderr, flush=True)
    print("[\n" + ",\n".join(map(json.dumps, entries)) + "\n]")


if __name__ == "__main__":
    main(sys.argv[1])
