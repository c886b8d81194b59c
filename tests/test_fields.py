"""One table of fields: README, help, closing table, metadata, maps and pictures take their words from it, and agree."""

import ast
import inspect
import re
import textwrap
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jaxcap.commands.score_help import SCORE
from jaxcap.commands.summary import Summary
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.files.columns import describe
from jaxcap.files.fields import BASELINES, CASES, FIELDS, STATUSES, field_list, markdown_table, output_types
from jaxcap.maps.labels import attributes_of
from jaxcap.one_state.result import Capturability, Case, Status
from jaxcap.plotting.kernels import CODES
from jaxcap.plotting.words import label_of
from jaxcap.regions.capture_point import Baselines

README = Path(__file__).parents[1] / "README.md"


def docstrings(kind: type) -> dict[str, str]:
    """What stands below each field of a named tuple, in one line."""
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    pairs = zip(body.body, body.body[1:], strict=False)
    return {
        one.target.id: " ".join(text.value.value.split())
        for one, text in pairs
        if isinstance(one, ast.AnnAssign) and isinstance(text, ast.Expr)
    }


def units(text: str) -> set[str]:
    return set(re.findall(r"\[(.*?)\]", text))


def test_every_field_is_in_the_table():
    assert tuple(FIELDS) == Capturability._fields and tuple(BASELINES) == Baselines._fields
    assert set(CASES) == set(Case) and set(STATUSES) == set(Status)


def test_the_readme_holds_the_table():
    assert f"\n\n{markdown_table()}\n\n" in README.read_text()


def test_the_docstrings_of_the_result_agree():
    """Units, and what is infinite or NaN: the rest is for readers to compare."""
    said = docstrings(Capturability)
    assert list(said) == list(FIELDS)
    for name, field in FIELDS.items():
        told = units(said[name]) or {""}
        assert told == (units(field.meaning) or {field.unit}), name
        assert ("infinite" in said[name].lower()) == ("infinite" in field.meaning), name
    for name in ("distance", "time"):
        assert "NaN where there is no stop" in said[name] and "NaN where there is no stop" in FIELDS[name].meaning


def test_the_table_says_what_a_margin_at_rest_is():
    assert "NaN at rest" in FIELDS["margin"].meaning and "`robustness`" in FIELDS["margin"].meaning
    assert "NaN at rest" in SCORE


def test_the_help_lists_every_field():
    for fields in (FIELDS, BASELINES):
        text = field_list(fields)
        assert re.findall(r"^    (\w+)", text, re.M) == list(fields)
        assert max(map(len, text.splitlines())) <= 79
        assert all(f"[{unit}]" in text for unit in {field.unit for field in fields.values()} - {"", "m/s^2 or m/s"})
    assert field_list(FIELDS) in SCORE


def test_files_and_maps_say_what_the_table_says():
    contacts = ContactSet(np.zeros((1, 3)), np.eye(3), 0.5)
    about = describe(contacts, (0, 0, -9.81), 4, np.dtype(np.float32))
    for name, field in FIELDS.items():
        assert (about["units"][name], about["meanings"][name]) == (field.unit, field.meaning)
        told = attributes_of(name)
        assert (told["units"], told["long_name"], told["comment"]) == (field.unit or "1", field.label, field.meaning)


@pytest.mark.parametrize("name", FIELDS)
def test_pictures_say_what_the_table_says(name):
    shown = label_of(xr.DataArray(np.zeros(2, output_types(np.float32)[name]), name=name, attrs=attributes_of(name)))
    unit = FIELDS[name].unit
    assert shown == (f"{FIELDS[name].label} [{unit}]" if unit else FIELDS[name].label)


def test_closing_table_and_legend_use_the_same_words():
    table = Summary().table()
    assert all(words in table for words in (*CASES.values(), *STATUSES.values()))
    assert all(CODES["case"][case][0].endswith(words) for case, words in CASES.items())
    assert CASES[Case.EMPTY] == "no contact or nowhere to stand"
