"""Are the answers of two trees the same, bit for bit? `python -m bench.same OTHER`, OTHER a checkout of another commit.

On the shipped states and contact sets, in both precisions: `score` by faces and by rays (each state its own set, and warm
starts), support distances, and maps; all fields, compared as bytes. Each tree answers in a process of its own. Prints a
line for each comparison, and exits with 1 if anything differs.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1]

ANSWERS = """
import sys
import jax, numpy as np, pyarrow.parquet as pq, yaml
jax.config.update("jax_enable_x64", True)
import jaxcap
from jaxcap.maps import kernel_map
data, out = sys.argv[1], {}

def one(contact):
    frame = np.array(contact.get("rotation", np.eye(3)))
    if contact["type"] == "rectangle":
        sizes = contact["half_length"], contact["half_width"]
        return jaxcap.rectangle(contact["position"], frame, *sizes, contact["friction"])
    return jaxcap.ContactSet([contact["position"]], frame, contact["friction"])

def keep(name, answers):
    fields = answers._asdict() if hasattr(answers, "_asdict") else answers
    out.update({f"{name}.{field}": np.asarray(value) for field, value in fields.items()})

for stance in ("talos_two_feet", "talos_hand_on_wall", "talos_slopes_and_rail", "anymal_four_points"):
    table = pq.read_table(f"{data}/{stance}.parquet")
    contacts = sum([one(c) for c in yaml.safe_load(open(f"{data}/{stance}.yaml"))["contacts"]][1:],
                   one(yaml.safe_load(open(f"{data}/{stance}.yaml"))["contacts"][0]))
    coms, velocities = (np.stack(table[name].to_pylist()) for name in ("com", "com_velocity"))
    cone = jaxcap.centroidal_cone(contacts)
    for dtype in (np.float32, np.float64):
        keep(f"{stance}.faces.{np.dtype(dtype)}", jaxcap.score(cone, coms.astype(dtype), velocities.astype(dtype)))
    n = 512
    shifts = np.random.default_rng(0).uniform(-0.02, 0.02, (n, 1, 3))
    sets = jaxcap.ContactSet(contacts.points + shifts, np.broadcast_to(contacts.frames, (n, *contacts.frames.shape)), 0.5)
    rays = jaxcap.cone_rays(sets)
    if stance == "talos_hand_on_wall":
        keep("rays.float64", jaxcap.score(rays, coms[:n], velocities[:n]))
        keep("rays.neighbours", jaxcap.score(rays, coms[:n], velocities[:n], neighbours=True))
        keep("support", {"distance": jaxcap.support_distance(rays, coms[:n, :2])})
        axes = {"com_x": "-0.2:0.2:9", "com_y": 0, "com_z": 0.8, "heading": "0:360deg:24"}
        keep("map.limits", {k: v.values for k, v in kernel_map(contacts, axes).items()})
        axes |= {"speed": "0:1:5"}
        fields = ["margin", "case", "time", "distance"]
        keep("map.fields", {k: v.values for k, v in kernel_map(contacts, axes, fields).items()})
np.savez(sys.argv[2], **out)
"""


def answers(tree: Path, folder: Path) -> dict[str, np.ndarray]:
    """What the tree answers."""
    path = folder / f"{abs(hash(tree))}.npz"
    program = [sys.executable, "-c", ANSWERS, str(HERE / "bench" / "data"), str(path)]
    subprocess.run(program, check=True, cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)})
    return dict(np.load(path))


def main() -> int:
    """Compares the two trees. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m bench.same", description=__doc__.split("\n\n")[0])
    parser.add_argument("other", type=Path, help="a checkout of another commit")
    other = parser.parse_args().other.resolve()
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = (answers(tree, Path(folder)) for tree in (HERE, other))
    same = {name: name in theirs and ours[name].tobytes() == theirs[name].tobytes() for name in ours}
    for name in ours:
        print(f"{'same ' if same[name] else 'OTHER'} {name:44s} {ours[name].size} values")
    print(f"{sum(same.values())} of {len(same)} the same, {sum(ours[name].size for name in ours)} values")
    return 0 if all(same.values()) and set(ours) == set(theirs) else 1


if __name__ == "__main__":
    sys.exit(main())
