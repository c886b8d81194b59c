"""Rows as a Parquet file: the same rows and settings give the same bytes, and a file appears whole or not at all.

Columns: index; com [m], com_velocity [m/s], angular_momentum [kg m^2/s]; contacts (a list of rectangles: effector, position,
quaternion x, y, z, w; the settings have an effector's sizes); effort [-]; q, v (what was simulated, see `sampling`; null
from row `settings.states` on: they follow from the seed); outcome and best_of_four (`labels.judge`); error (null but for a
failed sample); then for each controller its outcome, reason, steps, and what was counted in its run. Columns of a controller
that did not run are null. All floats are float32.
"""

from __future__ import annotations

import json
import os
import secrets
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from reference.tsid.labels import Row, Settings, labels_of

KEY = b"tsid"
"""Under which the file's metadata hold, as JSON, `settings` and `versions` (of the libraries that made the rows)."""

WORD = pa.dictionary(pa.int32(), pa.string())

FLOAT = pa.float32()

VECTOR = pa.list_(FLOAT, 3)

CONTACT = pa.struct({"effector": pa.string(), "position": VECTOR, "quaternion": pa.list_(FLOAT, 4)})

RUN = {"outcome": WORD, "reason": WORD, "steps": pa.int32()}
"""Columns of a controller, before its counters."""

NOISY = ("q", "v", "position", "quaternion", "com", "com_velocity", "angular_momentum", "effort")
"""Floats without repetition, which shrink by splitting their bytes into streams."""


class Unreadable(Exception):
    """A file that is no campaign's."""


def schema(settings: Settings, rows: list[Row], nq: int, nv: int) -> pa.Schema:
    """Of the columns above; the counters are those that occur in `rows`, in the order of their names."""
    fields: dict[str, pa.DataType] = {"index": pa.int32(), "com": VECTOR, "com_velocity": VECTOR, "angular_momentum": VECTOR}
    fields |= {"contacts": pa.list_(CONTACT), "effort": FLOAT, "q": pa.list_(FLOAT, nq), "v": pa.list_(FLOAT, nv)}
    fields |= dict.fromkeys(labels_of(settings), WORD) | {"error": pa.string()}
    for controller in settings.controllers:
        fields |= {f"{controller}_{name}": kind for name, kind in RUN.items()}
        fields |= dict.fromkeys(_counters(settings, rows, controller), pa.int32())
    return pa.schema(list(fields.items()))


def _counters(settings: Settings, rows: list[Row], controller: str) -> list[str]:
    """Columns of what a controller's solver counted; another controller's name may begin with this one's."""
    others = tuple(f"{name}_" for name in settings.controllers if len(name) > len(controller))
    known = {f"{controller}_{name}" for name in RUN}
    present = {name for row in rows for name in row if name.startswith(f"{controller}_") and not name.startswith(others)}
    return sorted(present - known)


def _filled(settings: Settings, rows: list[Row]) -> list[Row]:
    """The rows with 0 for what a controller that ran did not count."""
    zeros = {name: dict.fromkeys(_counters(settings, rows, name), 0) for name in settings.controllers}
    filled = []
    for row in rows:
        ran = [zero for name, zero in zeros.items() if f"{name}_outcome" in row]
        filled.append({key: value for zero in ran for key, value in zero.items()} | row)
    return filled


def write(path: Path, settings: Settings, versions: list[dict[str, str]], rows: list[Row], nq: int, nv: int) -> None:
    """Write the rows, in the order given, under a temporary name and then as `path`, replacing what was there."""
    layout = schema(settings, rows, nq, nv)
    table = pa.Table.from_pylist(_filled(settings, rows), schema=layout)
    metadata = {"settings": settings._asdict(), "versions": versions}
    table = table.replace_schema_metadata({KEY: json.dumps(metadata, sort_keys=True)})
    leaves = _leaves(layout)
    encodings = {leaf: "BYTE_STREAM_SPLIT" for leaf in leaves if any(part in NOISY for part in leaf.split("."))}
    encodings["index"] = "DELTA_BINARY_PACKED"
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}.tmp")  # two machines may end their shards at a time
    try:
        with open(temporary, "wb") as file:
            pq.write_table(
                table,
                file,
                compression="zstd",
                compression_level=12,
                use_dictionary=[leaf for leaf in leaves if leaf not in encodings],
                column_encoding=encodings,
                row_group_size=1 << 16,
                write_statistics=False,
            )
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _leaves(layout: pa.Schema) -> list[str]:
    """Paths of the Parquet columns that a schema's fields become."""

    def below(kind: pa.DataType) -> list[str]:
        if pa.types.is_struct(kind):
            return [f".{field.name}{rest}" for field in kind for rest in below(field.type)]
        if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
            return [f".list.element{rest}" for rest in below(kind.value_type)]
        return [""]

    return [f"{field.name}{rest}" for field in layout for rest in below(field.type)]


def columns(path: Path, first: int | None = None) -> tuple[dict[str, Any], list[dict[str, str]], pa.Table]:
    """Settings, versions and columns of a file that `write` wrote, of its first rows only if `first` says how many.

    Raises `Unreadable` naming the file if it is another.
    """
    try:
        table = pq.read_table(path)
        metadata = json.loads(table.schema.metadata[KEY])
        if "effort" not in table.column_names:
            raise KeyError("no column 'effort'")
        return metadata["settings"], metadata["versions"], table if first is None else table.slice(0, first)
    except (pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise Unreadable(f"{path}: not the file of a campaign ({error})") from error


def read(path: Path, first: int | None = None) -> tuple[dict[str, Any], list[dict[str, str]], list[Row]]:
    """Settings, versions and rows, without what is null, as `columns` has them."""
    settings, versions, table = columns(path, first)
    return settings, versions, [{n: value for n, value in row.items() if value is not None} for row in table.to_pylist()]
