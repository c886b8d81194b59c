"""Surface files: YAML or JSON lists of what a hand or a foot may be put on."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxcap.contacts.surfaces import HeightField, Surface, box, height_field, rail, surface
from jaxcap.errors import InputError
from jaxcap.files.contact_files import load, numbers, shown
from jaxcap.files.npz import readable


class _Kind(NamedTuple):
    """How one type of surface is written, and made."""

    make: Callable[..., Surface | HeightField | list[Surface]]
    shapes: dict[str, tuple[int, ...] | None]
    """Of every field, None for a grid of any size; `rotation` need not be there."""


KINDS = {
    "plane": _Kind(
        surface, {"position": (3,), "rotation": (3, 3), "half_length": (), "half_width": (), "friction": ()}
    ),
    "rail": _Kind(rail, {"start": (3,), "end": (3,), "normal": (3,), "half_width": (), "friction": ()}),
    "box": _Kind(box, {"position": (3,), "rotation": (3, 3), "half_sizes": (3,), "friction": ()}),
    "height_field": _Kind(height_field, {"heights": None, "origin": (3,), "spacing": (), "friction": ()}),
}  # fmt: skip


def read_surfaces(path: str | Path) -> list[Surface | HeightField]:
    """Reads a file of surfaces.

    The file is a mapping with the key `surfaces`: a list of entries, each with a `type` and

        plane  position, half_length, half_width, friction, and perhaps rotation     a part of a floor, a wall, a slope
        rail   start, end, normal, half_width, friction                              pressed on against its normal
        box    position, half_sizes, friction, and perhaps rotation                  its six sides
        height_field  heights, origin, spacing, friction                             uneven ground

    as `surface`, `rail`, `box` and `height_field` take them; all in the frame of the contacts. Heights are a list of rows,
    or the name of a file beside this one, .npy, or .npz with an array `heights`. An entry may have a name, for messages.

    Args:
        path: .yaml, .yml or .json.

    Returns:
        The surfaces, in the file's order; six for a box.

    Raises:
        InputError: naming file, entry and field.
        MissingExtra: for YAML without PyYAML.
    """
    path = Path(path)
    document = load(path)
    if not isinstance(document, dict) or list(document) != ["surfaces"]:
        raise InputError(f"{path}: {shown(document)} (expected a mapping with the one key 'surfaces')")
    entries = document["surfaces"]
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{path}: surfaces: {shown(entries)} (expected a list of at least one entry)")
    return [one for i, entry in enumerate(entries) for one in _made(f"{path}: surfaces[{i}]", entry, path.parent)]


def _made(where: str, entry: Any, folder: Path) -> list[Any]:
    """One entry. where: file and index, for messages. folder: that of the file."""
    if not isinstance(entry, dict):
        raise InputError(f"{where}: {shown(entry)} (expected a mapping)")
    where = f"{where} ({entry['name']})" if isinstance(entry.get("name"), str) else where
    name = entry.get("type")
    if not isinstance(name, str) or name not in KINDS:
        raise InputError(f"{where}: type = {shown(name)} (expected {' or '.join(KINDS)})")
    kind = KINDS[name]
    for key in entry:
        if key not in ("type", "name", *kind.shapes):
            raise InputError(f"{where}: unknown field {key!r} (expected {', '.join(kind.shapes)})")
    for key in kind.shapes:
        if key not in entry and key != "rotation":
            raise InputError(f"{where}: no field {key!r}, which a {name} needs")
    values = {
        key: _heights(where, entry[key], folder) if shape is None else numbers(where, key, entry[key], shape)
        for key, shape in kind.shapes.items()
        if key in entry
    }
    if "rotation" in kind.shapes:
        values.setdefault("rotation", np.eye(3))
    try:
        made = kind.make(**values)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error
    return made if isinstance(made, list) else [made]


def _heights(where: str, given: Any, folder: Path) -> np.ndarray:
    """From the list of rows, or from the file named. Raises InputError."""
    if isinstance(given, list):
        rows, columns = len(given), len(given[0]) if given and isinstance(given[0], list) else 0
        return numbers(where, "heights", given, (rows, columns))
    if not isinstance(given, str) or Path(given).suffix.lower() not in (".npy", ".npz"):
        raise InputError(f"{where}: heights = {shown(given)} (expected a list of rows, or the name of a file, .npy or .npz)")
    file = folder / given
    if not file.is_file():
        raise InputError(f"{where}: heights: {file}: no such file")
    with readable(f"{where}: heights: {file}", file.suffix[1:].upper()):
        held = np.load(file, allow_pickle=False)
        if isinstance(held, np.ndarray):
            return held
        with held:
            if "heights" not in held:
                raise InputError(f"{where}: {file} has no array 'heights'")
            return held["heights"]
