"""The rooms of the library: imports run downwards, every room says where to begin, functions are short and documented."""

import ast
import re

import pytest

from bench.rooms import HERE, arrows, between_rooms, floors, functions, hidden, missing, modules, room, undocumented

ORDER = (
    "errors",
    "version",
    "numerics",
    "contacts",
    "one_state",
    "batch",
    "regions",
    "jaxcap",
    "exported",
    "files",
    "robots",
    "engine",
    "maps",
    "plotting",
    "commands",
)
"""A room may import the rooms before it. `jaxcap` is the package's `__init__`, the public names; `exported` a second name of
`jaxcap.batch.exported`."""
LONGEST = 60
"""Lines of a function without its docstring."""


@pytest.fixture(scope="module")
def trees():
    return modules(HERE)


def test_every_room_has_its_place(trees):
    assert {room(module) for module in trees} <= set(ORDER)


def test_imports_run_downwards(trees):
    upwards = [
        f"{importer} imports {imported}"
        for importer, imported in sorted(arrows(trees))
        if ORDER.index(room(importer)) < ORDER.index(room(imported))
    ]
    assert not upwards


def test_no_circle_between_modules(trees):
    """Within a room too: what a file needs can be read before it."""
    assert floors(trees, arrows(trees)) is not None


def test_every_room_says_where_to_begin_and_what_it_may_import(trees):
    rooms = [module for module in trees if module.count(".") == 1 and (HERE / room(module)).is_dir()]
    assert len(rooms) >= 9
    for module in rooms:
        words = " ".join((ast.get_docstring(trees[module]) or "").split())
        assert "Begin with" in words, module
        assert "May import" in words or "Imports no other room" in words, module


def test_a_room_imports_only_what_it_says(trees):
    """What its docstring names after "May import"; errors, version and public names are for everyone."""
    unsaid = []
    for importer, imported in sorted(between_rooms(arrows(trees))):
        if (HERE / importer).is_dir() and imported not in ("errors", "version", "jaxcap"):
            words = " ".join((ast.get_docstring(trees[f"jaxcap.{importer}"]) or "").split())
            unsaid += [] if imported in allowed(words) else [f"{importer} imports {imported}"]
    assert not unsaid


def test_the_reference_shares_no_mathematics(trees):
    """It hands its work to processes by the engine, and takes nothing else; nothing here knows it."""
    reference = modules(HERE.parent / "reference")
    theirs = {node.module for tree in reference.values() for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    theirs |= {
        name.name
        for tree in reference.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for name in node.names
    }
    assert {name for name in theirs if name and name.split(".")[0] == "jaxcap"} == {"jaxcap.engine", "jaxcap.errors"}
    ours = {node.module for tree in trees.values() for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not [name for name in ours if name and name.split(".")[0] == "reference"]


def allowed(words: str) -> set[str]:
    """The rooms that a docstring allows: "May import `one`, `two`", "`one` to `four`", or "every room"."""
    may = words.partition("May import ")[2]
    if may.startswith("every room"):
        return set(ORDER)
    ranges = re.findall(r"`(\w+)` to `(\w+)`", may)
    between = {name for first, last in ranges for name in ORDER[ORDER.index(first) : ORDER.index(last)]}
    return between | set(re.findall(r"`(\w+)`", may))


def test_functions_are_short(trees):
    assert not [function for function in functions(trees) if function.lines > LONGEST]


def test_what_is_public_is_documented(trees):
    assert not undocumented(trees)


def test_no_function_hides_a_module(trees):
    """`import jaxcap.room.module` gives the module."""
    assert not hidden(trees)


def test_every_imported_name_is_there():
    """Also in what no test runs: measurements and campaigns that are begun by hand."""
    packages = [modules(HERE.parent / name) for name in ("jaxcap", "bench", "reference")]
    theirs = {name: tree for package in packages for name, tree in package.items()}
    assert {"jaxcap", "bench.rooms", "reference"} <= set(theirs)
    assert not missing({**theirs, **modules(HERE.parent / "tests")}, theirs)


def test_the_tools_see_what_they_should(tmp_path):
    """On a package of two rooms with one fault of each kind."""
    package = tmp_path / "jaxcap"
    files = {
        "__init__.py": '"""A package."""\nfrom jaxcap.files.table import table\n',
        "numerics/__init__.py": '"""Low."""\nfrom jaxcap.numerics.root import root\n',
        "numerics/root.py": '"""Up, lazily."""\ndef root():\n    from jaxcap.files import table\n    return table\n',
        "files/__init__.py": "",
        "files/table.py": '"""Back, for types."""\nif TYPE_CHECKING:\n    import jaxcap.numerics.root\nclass Table: ...\n',
    }
    for name, text in files.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)
    found = modules(package)
    names = {(one.importer, one.imported) for one in arrows(found)}
    assert {("jaxcap.numerics.root", "jaxcap.files.table"), ("jaxcap.files.table", "jaxcap.numerics.root")} <= names
    assert ("numerics", "files") in between_rooms(arrows(found))
    assert floors(found, arrows(found)) is None
    assert hidden(found) == ["jaxcap.numerics.root"]
    assert undocumented(found) == ["jaxcap.files:", "jaxcap.files.table:Table", "jaxcap.numerics.root:root"]
    assert [function.lines for function in functions(found)] == [3]
    text = "import jaxcap.files.rows\nfrom jaxcap import numerics, shelves\nfrom jaxcap.files.table import Table, Chair\n"
    assert missing({"user": ast.parse(text)}, found) == [
        "user: jaxcap.files.rows",
        "user: jaxcap.files.table.Chair",
        "user: jaxcap.shelves",
    ]
