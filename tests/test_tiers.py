"""No test is lost between the quick ones and the others."""

import ast
from pathlib import Path
from types import SimpleNamespace

import pytest
from tiers import MARKS, QUICK, chosen, is_quick, kind_of, mark, part

HERE = Path(__file__).parent


class Item(SimpleNamespace):
    """What `mark` needs of a collected test."""

    def add_marker(self, name):
        self.marks.add(name)

    def get_closest_marker(self, name):
        return name if name in self.marks else None


def marks_of(file, name):
    item = Item(path=Path(file), name=name, marks=set())
    mark([item])
    return item.marks


@pytest.mark.parametrize("file", QUICK)
def test_every_name_in_the_table_is_a_test(file):
    names = [node.name for node in ast.parse((HERE / file).read_text()).body if isinstance(node, ast.FunctionDef)]
    for begin in QUICK[file]:
        name, bracket, _ = begin.partition("[")
        assert name in names if bracket else any(one.startswith(begin) for one in names if one.startswith("test_")), begin


def test_what_is_not_quick_has_a_registered_mark(request):
    registered = {line.partition(":")[0] for line in request.config.getini("markers")}
    assert set(MARKS) <= registered
    assert {kind_of(file) for file in ("test_tsid_x.py", "test_evaluation.py", "test_maps.py")} == set(MARKS)


def test_a_mark_is_given_by_file_and_name():
    assert marks_of("test_tsid_new.py", "test_any") == {"sim"}
    assert marks_of("test_evaluation_new.py", "test_any") == {"evaluation"}
    assert marks_of("test_batch.py", "test_gradient_through_score") == {"slow"}
    assert marks_of("test_batch.py", "test_fields_have_their_types") == set()
    assert marks_of("test_new.py", "test_any") == set()
    assert is_quick(Item(marks=set())) and not any(is_quick(Item(marks={name})) for name in MARKS)


def test_quick_and_others_are_all(found):
    """Each test is in one of the two parts, and in one only."""
    quick, others = chosen(found, "quick"), chosen(found, "others")
    assert set(quick).isdisjoint(others)
    assert set(quick) | set(others) == set(found) == set(chosen(found, "all"))
    assert all(map(is_quick, quick)) and not any(map(is_quick, others))


@pytest.mark.parametrize(
    ("given", "expected"),
    [({}, "quick"), ({"others": True}, "others"), ({"everything": True}, "all"), ({"markexpr": "sim"}, "all")],
)
def test_the_options_ask_for_a_part(given, expected):
    assert part(SimpleNamespace(**{"everything": False, "others": False, "markexpr": ""} | given)) == expected


def test_a_run_has_the_part_that_it_is_asked_for(found, request):
    option = request.config.option
    if not option.markexpr and not option.keyword:
        assert request.session.items == chosen(found, part(option))
