"""Contact files: YAML or JSON lists of rectangles and points, in one set or in several."""

import json
import re
from collections import Counter
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxcap.contacts.contact_set import ContactSet, rectangle
from jaxcap.errors import InputError, needs_extra

EXTENSIONS = (".yaml", ".yml", ".json")

SHAPES = {"position": (3,), "rotation": (3, 3), "half_length": (), "half_width": (), "friction": ()}
"""Shape of every field that holds numbers."""

REQUIRED = {
    "rectangle": ("position", "half_length", "half_width", "friction"),
    "point": ("position", "friction"),
}
"""Types of contact, and the fields that each needs; `type` itself, `name` and `rotation` may be there as well."""


class ContactSets(NamedTuple):
    """The contact sets of a file, in its order."""

    sets: tuple[ContactSet, ...]
    names: tuple[str | None, ...]
    """None for a set without a name."""


def read_contacts(path: str | Path) -> ContactSet:
    """Reads a contact file that holds one set; see `read_contact_sets`, which says what it raises."""
    sets = read_contact_sets(path).sets
    if len(sets) > 1:
        raise InputError(f"{path}: holds {len(sets)} sets of contacts (expected one)")
    return sets[0]


def read_contact_sets(path: str | Path) -> ContactSets:
    """Reads a contact file.

    The file is a mapping with one key. Either `contacts`: a list of entries, the contacts of one set without a name. Or
    `sets`: a list of mappings with a key `contacts`, a list of entries that may be empty, and perhaps a `name`. An entry
    has a `type` and

        rectangle  position, half_length, half_width, friction       four contacts, at the corners
        point      position, friction                                one contact

    position: [x, y, z], the centre [m]. rotation: 3x3, columns tangent (of the length), tangent (of the width), normal
    pointing at the robot; without it, the identity. half_length, half_width: [m]. friction: > 0. An entry may have a
    name, a label for messages. All in one inertial frame, z up; the contacts are in the order of the entries.

    Raises InputError naming file, entry and field. Raises MissingExtra for YAML without PyYAML.
    """
    path = Path(path)
    document = load(path)
    if not isinstance(document, dict) or list(document) not in (["contacts"], ["sets"]):
        found = f"keys {', '.join(map(repr, document)) or 'none'}" if isinstance(document, dict) else shown(document)
        raise InputError(f"{path}: {found} (expected a mapping with the one key 'contacts' or 'sets')")
    ((key, entries),) = document.items()
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{path}: {key}: {shown(entries)} (expected a list of at least one entry)")
    if key == "contacts":
        return ContactSets((_set(f"{path}: ", entries),), (None,))
    named = [_named_set(f"{path}: sets[{i}]", entry) for i, entry in enumerate(entries)]
    names = tuple(name for name, _ in named)
    repeated = next((name for name, n in Counter(names).items() if name is not None and n > 1), None)
    if repeated is not None:
        raise InputError(f"{path}: sets: more than one has the name {repeated!r}")
    return ContactSets(tuple(contacts for _, contacts in named), names)


def _named_set(where: str, entry: Any) -> tuple[str | None, ContactSet]:
    """One entry of `sets`. where: file and index, for messages."""
    if not isinstance(entry, dict):
        raise InputError(f"{where}: {shown(entry)} (expected a mapping)")
    name = entry.get("name")
    if name is not None and not isinstance(name, str):
        raise InputError(f"{where}: name = {shown(name)} (expected text)")
    where = f"{where} ({name})" if name else where
    for key in entry:
        if key not in ("name", "contacts"):
            raise InputError(f"{where}: unknown field {key!r} (expected name, contacts)")
    if "contacts" not in entry:
        raise InputError(f"{where}: no field 'contacts', which a set needs")
    if not isinstance(entry["contacts"], list):
        raise InputError(f"{where}: contacts: {shown(entry['contacts'])} (expected a list, empty for no contact)")
    return name, _set(f"{where}: ", entry["contacts"])


def _set(where: str, entries: list) -> ContactSet:
    """A list of entries as one set. where: beginning of messages."""
    none = ContactSet(np.zeros((0, 3)), np.eye(3), 1.0)
    return reduce(add, (_contact(f"{where}contacts[{i}]", entry) for i, entry in enumerate(entries)), none)


def _contact(where: str, entry: Any) -> ContactSet:
    """One entry as contacts. where: file and index, for messages."""
    if not isinstance(entry, dict):
        raise InputError(f"{where}: {shown(entry)} (expected a mapping)")
    name, kind = entry.get("name"), entry.get("type")
    if name is not None and not isinstance(name, str):
        raise InputError(f"{where}: name = {shown(name)} (expected text)")
    where = f"{where} ({name})" if name else where
    if "type" not in entry:
        raise InputError(f"{where}: no field 'type' (expected {' or '.join(REQUIRED)})")
    if not isinstance(kind, str) or kind not in REQUIRED:
        raise InputError(f"{where}: type = {shown(kind)} (expected {' or '.join(REQUIRED)})")
    allowed = ("type", "name", "rotation", *REQUIRED[kind])
    for key in entry:
        if key not in allowed:
            raise InputError(f"{where}: unknown field {key!r} (expected {', '.join(allowed)})")
    for key in REQUIRED[kind]:
        if key not in entry:
            raise InputError(f"{where}: no field {key!r}, which a {kind} needs")
    values = {key: numbers(where, key, entry[key], SHAPES[key]) for key in SHAPES if key in entry}
    values.setdefault("rotation", np.eye(3))
    try:
        if kind == "rectangle":
            return rectangle(**values)
        return ContactSet(points=values["position"][None], frames=values["rotation"], friction=values["friction"])
    except ValueError as error:
        # ContactSet speaks of rows of its arrays; here the reader wants the field of the entry
        message = re.sub(r"^frames\[0\]", "rotation", re.sub(r"^friction\[0\]", "friction", str(error)))
        raise InputError(f"{where}: {message}") from error


def numbers(where: str, key: str, value: Any, shape: tuple[int, ...]) -> Any:
    """A field as an array, or as a float where its shape is (). Raises InputError unless it holds finite numbers."""
    expected = f"{'x'.join(map(str, shape))} numbers" if shape else "a number"
    if not _all_numbers(value):
        raise InputError(f"{where}: {key} = {shown(value)} (expected {expected})")
    try:
        array = np.array(value, dtype=np.float64)
    except (ValueError, OverflowError):  # ragged, or an integer beyond any float
        raise InputError(f"{where}: {key} = {shown(value)} (expected {expected})") from None
    if array.shape != shape:
        raise InputError(f"{where}: {key} has shape {array.shape} (expected {expected})")
    if not np.isfinite(array).all():
        raise InputError(f"{where}: {key} = {shown(value)} (expected finite numbers)")
    return array if shape else float(array)


def _all_numbers(value: Any) -> bool:
    if isinstance(value, list):
        return all(map(_all_numbers, value))
    return isinstance(value, int | float) and not isinstance(value, bool)


def load(path: Path) -> Any:
    """What the file says, as dicts, lists, texts and numbers."""
    extension = path.suffix.lower()
    if extension not in EXTENSIONS:
        raise InputError(f"{path}: unknown extension {path.suffix!r} (expected {', '.join(EXTENSIONS)})")
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text: {error}") from error
    try:
        return _load_json(path, text) if extension == ".json" else _load_yaml(path, text)
    except RecursionError:
        raise InputError(f"{path}: nested too deeply") from None


def _load_json(path: Path, text: str) -> Any:
    try:
        return json.loads(text, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: line {error.lineno}: not JSON: {error.msg}") from error
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def _load_yaml(path: Path, text: str) -> Any:
    with needs_extra("cli", "reading YAML"):
        import yaml

    class Loader(yaml.SafeLoader):
        """Safe YAML, where 1e-3 is a number (as in YAML 1.2) and a key given twice is an error."""

        def compose_mapping_node(self, anchor):
            node = super().compose_mapping_node(anchor)
            keys = [key.value for key, _ in node.value]
            repeated = next((key for key in keys if keys.count(key) > 1), None)
            if repeated is not None:
                raise yaml.composer.ComposerError(None, None, f"{repeated!r} is given twice", node.start_mark)
            return node

    number = re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", number, list("-+.0123456789"))
    try:
        return yaml.load(text, Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark else ""
        raise InputError(f"{path}: {line}not YAML: {error.problem}") from error
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"{path}: not YAML: {str(error).splitlines()[0]}") from error


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object, unless a key is given twice."""
    keys = [key for key, _ in pairs]
    repeated = next((key for key in keys if keys.count(key) > 1), None)
    if repeated is not None:
        raise ValueError(f"{repeated!r} is given twice")
    return dict(pairs)


def shown(value: Any) -> str:
    """The value, cut to fit into one line."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
