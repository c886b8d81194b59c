"""Small state and contact files for the tests of records and of the command line, and a predictor that needs no JAX."""

import json

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jaxcap.one_state.result import Capturability, Case, Status

SOLE = {"type": "rectangle", "half_length": 0.1, "half_width": 0.05, "friction": 0.5}
FEET = {
    "contacts": [
        {**SOLE, "name": "left", "position": [0, 0.1, 0]},
        {**SOLE, "name": "right", "position": [0, -0.1, 0]},
    ]
}


def states(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """CoM positions (n, 3) [m] over the feet, and velocities (n, 3) [m/s]."""
    rng = np.random.default_rng(seed)
    return rng.uniform([-0.1, -0.1, 0.7], [0.1, 0.1, 0.9], (n, 3)), rng.uniform(-1, 1, (n, 3))


def vectors(values: np.ndarray, kind=None) -> pa.Array:
    """(n, 3) as an Arrow column of lists."""
    return pa.array(list(values.tolist()), kind or pa.list_(pa.float64(), 3))


def write_states(path, n: int = 10, **columns):
    """Writes n states, and other columns, in the format of the extension. Returns the path."""
    coms, velocities = states(n)
    if path.suffix == ".npz":
        np.savez(path, **{"com": coms, "com_velocity": velocities, **columns})
    else:
        table = {"com": vectors(coms), "com_velocity": vectors(velocities), **columns}
        pq.write_table(pa.table({name: column for name, column in table.items() if column is not None}), path)
    return path


def write_contacts(path, document=FEET):
    """Writes a contact file as JSON, which is YAML as well. Returns the path."""
    path.write_text(json.dumps(document))
    return path


def contact_lists(n: int, seed: int = 1, most: int = 8) -> dict[str, list]:
    """Columns of contacts near the ground for n rows, each with 0 to `most` of them, as nested lists."""
    rng = np.random.default_rng(seed)
    points, frames, friction = [], [], []
    for k in rng.integers(0, most + 1, n):
        turns, half = np.linalg.qr(rng.normal(size=(k, 3, 3)))[0], rng.uniform([-0.3, -0.2, 0], [0.3, 0.2, 0.05], (k, 3))
        turns[:, :, 2] *= np.linalg.det(turns)[:, None]
        upward = np.where(turns[:, 2, 2] < 0, -1, 1)[:, None]
        turns[:, :, 1:] *= upward[..., None]
        points.append(half.tolist())
        frames.append(turns.tolist())
        friction.append(rng.uniform(0.3, 1, k).tolist())
    return {"contact_points": points, "contact_frames": frames, "contact_friction": friction}


def padded_contacts(lists: dict[str, list], size: int = 8) -> dict[str, np.ndarray]:
    """The same columns as arrays with `size` contacts a row, padded with NaN."""
    inner = {"contact_points": (3,), "contact_frames": (3, 3), "contact_friction": ()}
    out = {name: np.full((len(rows), size, *inner[name]), np.nan) for name, rows in lists.items()}
    for name, rows in lists.items():
        for row, values in enumerate(rows):
            out[name][row, : len(values)] = np.reshape(values, (-1, *inner[name]))
    return out


def arrow_contacts(lists: dict[str, list], spelling: str = "nested") -> dict[str, pa.Array]:
    """The same columns for Parquet: nested lists, flat lists, or nested lists with inner lists of fixed size."""
    number = pa.float64()
    three = pa.list_(number, 3) if spelling == "fixed" else pa.list_(number)
    square = pa.list_(three, 3) if spelling == "fixed" else pa.large_list(three)
    kinds = {"contact_points": pa.list_(three), "contact_frames": pa.list_(square), "contact_friction": pa.list_(number)}
    if spelling == "flat":
        lists = {name: [np.ravel(row).tolist() for row in rows] for name, rows in lists.items()}
        kinds = dict.fromkeys(kinds, pa.list_(number))
    return {name: pa.array(rows, kinds[name]) for name, rows in lists.items()}


def read_columns(path) -> dict[str, np.ndarray]:
    """Every column of an output file as a NumPy array, but lists that may differ in length as lists."""
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files if name != "metadata"}
    table = pq.read_table(path)
    ragged = [field.name for field in table.schema if pa.types.is_list(field.type)]
    return {
        name: table[name].to_pylist() if name in ragged else np.array(table[name].to_pylist()) for name in table.column_names
    }


def read_metadata(path) -> dict:
    """What an output file says about itself."""
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as file:
            return json.loads(file["metadata"].item())
    return json.loads(pq.read_schema(path).metadata[b"jaxcap"])


def fake_score(
    cone, coms, com_velocities, gravity=(0, 0, -9.81), neighbours=False, specific_angular_momentum=None
) -> Capturability:
    """A predictor by a simple rule: capturable below 1 m/s, and in the other ways like the real one."""
    dtype = jax.dtypes.canonicalize_dtype(np.asarray(coms).dtype)  # as JAX takes them: the x64 switch decides
    coms, com_velocities = np.asarray(coms, dtype), np.asarray(com_velocities, dtype)
    bad = ~np.isfinite(np.hstack([coms, com_velocities])).all(axis=1)
    speed = np.where(bad, np.nan, np.linalg.norm(com_velocities, axis=1)).astype(coms.dtype)
    still = speed == 0
    margin = np.where(still, np.nan, 1 - speed).astype(coms.dtype)
    capturable = ~bad & (still | (margin >= 0))
    case = np.where(bad, Case.UNDECIDED, np.where(capturable, Case.C3_1, Case.C1)).astype(np.int8)
    status = np.where(bad, Status.NONFINITE, np.where(still, Status.NO_DIRECTION, Status.OK)).astype(np.int8)
    none = np.full_like(margin, np.nan)
    return Capturability(capturable, case, status, margin, 0 * margin, margin + speed, margin, speed, speed, 0 * speed, none)


def command(states, contacts, output, *options) -> list[str]:
    """Arguments of `jaxcap` that score a file. contacts: None for none."""
    given = [] if contacts is None else ["--contacts", str(contacts)]
    return ["score", str(states), *given, "-o", str(output), *options]


def leftovers(directory) -> list[str]:
    """Names of temporary files in a directory."""
    return [path.name for path in directory.iterdir() if path.name.startswith(".") or path.name.endswith(".tmp")]


N = 40
"""Rows of the contacts below."""
LISTS = contact_lists(N)
COLUMNS = {"parquet": arrow_contacts(LISTS), "npz": padded_contacts(LISTS)}
"""Contacts that differ from row to row, by the extension of the file."""
LEFT, RIGHT = FEET["contacts"]
SETS = {
    "sets": [
        {"name": "left", "contacts": [LEFT]},
        {"contacts": [LEFT, RIGHT]},
        {"name": "flight", "contacts": []},
    ]
}
NUMBERS = np.arange(N) % 3
"""Of the set that belongs to a row."""
