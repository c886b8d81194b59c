"""Peak memory against the number of states: it has to stay level. `jaxcap map` and `jaxcap score`, each in its own process.

`peak` is that of `bench/process.py`. The map is that of `bench.maps` (the verdict alone), the file a Parquet file of random
states.
"""

import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from bench.maps import CONTACTS, axes
from bench.process import in_process

SEED = 0
ROWS = 1 << 20
"""Rows of a file that are drawn and written at a time."""


def write_states(path: Path, count: int) -> None:
    """A Parquet file of random states over two feet, float32."""
    rng = np.random.default_rng(SEED)
    vectors = pa.list_(pa.float32(), 3)
    with pq.ParquetWriter(path, pa.schema({"com": vectors, "com_velocity": vectors})) as file:
        for begin in range(0, count, ROWS):
            rows = min(ROWS, count - begin)
            coms = rng.uniform([-0.2, -0.2, 0.7], [0.2, 0.2, 1.0], (rows, 3)).astype(np.float32)
            velocities = rng.uniform(-1, 1, (rows, 3)).astype(np.float32)
            columns = [pa.FixedSizeListArray.from_arrays(pa.array(x.ravel()), 3) for x in (coms, velocities)]
            file.write_table(pa.table(columns, schema=file.schema))


def write_dataset(folder: Path, files: int, rows: int) -> None:
    """all.parquet, and the same rows in so many files of the folder `in`."""
    write_states(folder / "all.parquet", files * rows)
    table = pq.read_table(folder / "all.parquet")
    (folder / "in").mkdir()
    for number in range(files):
        pq.write_table(table.slice(number * rows, rows), folder / "in" / f"{number:05}.parquet")


def lines(most: int) -> list[dict]:
    """One line for each command and power of ten from 10^5 states up to `most`."""
    found = []
    sizes = [10**k for k in range(5, 12) if 10**k <= most] or [most]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for count in sizes:
            options = [f"--axis={axis}={text}" for axis, text in axes(CONTACTS, count).items()]
            command = ["map", str(CONTACTS), "-o", str(folder / f"{count}.zarr"), *options]
            found.append(("map", count, in_process([*command, "--quantity=capturable", "--quantity=margin"])))
        for count in sizes:
            states, scores = folder / f"{count}.parquet", folder / f"{count}.scores.parquet"
            write_states(states, count)
            command = ["score", str(states), "--contacts", str(CONTACTS), "-o", str(scores)]
            found.append(("score", count, in_process(command)))
            states.unlink()
            scores.unlink()
    return [
        {"command": which, "states": count, "peak MB": cost.peak_bytes / 1e6, "states/s": count / cost.seconds}
        for which, count, cost in found
    ]
