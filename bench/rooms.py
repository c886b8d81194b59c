"""The rooms of the library: who imports whom, on how many floors, and how long the functions are.

    python -m bench.rooms [FOLDER]

FOLDER is a package, by default the `jaxcap/` beside this folder; that of another checkout may be given, to compare. Nothing
is imported, the files are read (`ast`). An arrow goes from a module to one that it imports, wherever the import stands: at
the top, inside a function, or under TYPE_CHECKING. Floors are the modules on the longest chain of arrows. A room is a folder
of the package, or a file that stands in it alone. `tests/test_rooms.py` holds the direction.
"""

import ast
import statistics
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent.parent / "jaxcap"
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
FUNCTION = ast.FunctionDef | ast.AsyncFunctionDef


class Arrow(NamedTuple):
    """One module imports another."""

    importer: str
    imported: str


class Function(NamedTuple):
    """A function or method, and its lines without the docstring; decorators are not counted."""

    name: str
    lines: int


def modules(folder: Path) -> dict[str, ast.Module]:
    """Every module of the package by its dotted name, parsed; a package goes by the name of its folder."""
    found = {}
    for file in sorted(folder.rglob("*.py")):
        parts = file.relative_to(folder.parent).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = ast.parse(file.read_text(encoding="utf-8"), str(file))
    return found


def arrows(trees: dict[str, ast.Module]) -> set[Arrow]:
    """All imports between these modules. The import of a name is an arrow to the module that the name is taken from."""
    return {Arrow(name, module) for name, tree in trees.items() for module in _imported(tree, set(trees))} - {
        Arrow(name, name) for name in trees
    }


def _imported(tree: ast.Module, known: set[str]) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                raise ValueError(f"line {node.lineno}: from {'.' * node.level}{node.module or ''} (expected the full name)")
            # `from package import name`: a module where there is one of this name, otherwise something inside the package
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (module for module in inside if module in known)
            if node.module in known and not all(module in known for module in inside):
                yield node.module


def room(module: str) -> str:
    """The room that a module stands in: the folder or file directly in the package, or the package's own `__init__`."""
    return module.split(".")[1] if "." in module else module


def between_rooms(found: set[Arrow]) -> set[Arrow]:
    """The arrows that leave a room, from room to room."""
    return {Arrow(room(importer), room(imported)) for importer, imported in found if room(importer) != room(imported)}


def floors(names, found: set[Arrow]) -> int | None:
    """How many of these stand on the longest chain of arrows; None where the arrows run in a circle."""
    below: dict[str, set[str]] = {name: set() for name in names}
    for importer, imported in found:
        below[importer].add(imported)
    height: dict[str, int] = {}
    try:
        for name in TopologicalSorter(below).static_order():
            height[name] = 1 + max((height[other] for other in below[name]), default=0)
    except CycleError:
        return None
    return max(height.values())


def functions(trees: dict[str, ast.Module]) -> list[Function]:
    """Every function, method and inner function, with its length."""
    return [
        Function(f"{module}:{node.name}", _length(node))
        for module, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, FUNCTION)
    ]


def _length(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    lines = (node.end_lineno or node.lineno) - node.lineno + 1
    if ast.get_docstring(node, clean=False) is None:
        return lines
    text = node.body[0]
    return lines - ((text.end_lineno or text.lineno) - text.lineno + 1)


def undocumented(trees: dict[str, ast.Module]) -> list[str]:
    """Public modules, classes, functions and methods without a docstring, by `module:name`."""
    return [name for module, tree in trees.items() for name in _bare(module, "", tree)]


def _bare(module: str, name: str, node: DOCUMENTED) -> Iterator[str]:
    if ast.get_docstring(node) is None:
        yield f"{module}:{name}"
    if isinstance(node, FUNCTION):
        return
    for child in node.body:
        if isinstance(child, FUNCTION | ast.ClassDef) and not child.name.startswith("_"):
            yield from _bare(module, f"{name}.{child.name}".lstrip("."), child)


def hidden(trees: dict[str, ast.Module]) -> list[str]:
    """Modules that cannot be reached by name, since their package's `__init__` gives that name to something else."""
    found = []
    for package, tree in trees.items():
        for node in ast.walk(tree):
            names = [(node.name, "")] if isinstance(node, FUNCTION | ast.ClassDef) else []
            if isinstance(node, ast.ImportFrom):
                names = [(alias.asname or alias.name, f"{node.module}.{alias.name}") for alias in node.names]
            found += [f"{package}.{name}" for name, source in names if f"{package}.{name}" in set(trees) - {source}]
    return sorted(set(found))


def missing(importers: dict[str, ast.Module], trees: dict[str, ast.Module]) -> list[str]:
    """What these import by name from a module of `trees` that has no such name, as `importer: module.name`."""
    names = {module: _names(tree) for module, tree in trees.items()}
    packages = {module.split(".")[0] for module in trees}
    found = []
    for importer, tree in importers.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                wanted = [alias.name for alias in node.names if alias.name.split(".")[0] in packages]
                found += [f"{importer}: {name}" for name in wanted if name not in trees]
            elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in packages:
                inside = [(f"{node.module}.{alias.name}", alias.name) for alias in node.names]
                known = names.get(node.module or "", set())
                found += [f"{importer}: {full}" for full, name in inside if full not in trees and name not in known]
    return sorted(found)


def _names(tree: ast.Module) -> set[str]:
    """What a module binds, wherever in it: too much, but nothing that is at its top is left out."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, FUNCTION | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return found


def main(folder: Path = HERE) -> None:
    """Print the figures."""
    trees = modules(folder)
    found = arrows(trees)
    rooms: dict[str, int] = {}
    for module in trees:
        rooms[room(module)] = rooms.get(room(module), 0) + 1
    crossing = between_rooms(found)
    lengths = sorted(function.lines for function in functions(trees))
    largest = max(rooms, key=lambda name: rooms[name])
    longest = max(functions(trees), key=lambda function: function.lines)
    alone = sum(1 for module in trees if module.count(".") == 1 and rooms[room(module)] == 1)
    print(f"modules     {len(trees):5}   {alone} of them directly in the package")
    print(f"arrows      {len(found):5}   floors {floors(trees, found) or 'none: a circle'}")
    print(f"rooms       {len(rooms):5}   largest {largest}, {rooms[largest]} modules")
    print(f"their arrows{len(crossing):5}   floors {floors(rooms, crossing) or 'none: a circle'}")
    print(
        f"functions   {len(lengths):5}   lines without docstring: median {statistics.median(lengths):g}, "
        f"p90 {statistics.quantiles(lengths, n=10)[-1]:g}, longest {longest.lines} ({longest.name})"
    )


if __name__ == "__main__":
    main(*(Path(argument).resolve() for argument in sys.argv[1:2]))
