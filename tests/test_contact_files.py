"""Contact files: what they say becomes a ContactSet, or an error that names file, entry, field and value."""

import json
import sys

import numpy as np
import pytest
from state_files import FEET, write_contacts

from jaxcap.contacts.contact_set import ContactSet, rectangle
from jaxcap.errors import InputError
from jaxcap.files.contact_files import read_contact_sets, read_contacts

POINT = {"type": "point", "position": [0, 0, 0], "friction": 0.5}
SOLE = FEET["contacts"][0]

TEXT = """
# two kinds of contact
contacts:
  - type: rectangle
    name: left_sole
    position: [0.1, 0.2, 0]
    rotation: [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    half_length: 0.105
    half_width: 65e-3      # a number in YAML 1.2
    friction: 0.5
  - {type: point, position: [1, 2, 3], friction: 1}
"""


def assert_same(one: ContactSet, other: ContactSet):
    for name in ("points", "frames", "friction", "mask"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_yaml(tmp_path):
    turned = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    expected = rectangle([0.1, 0.2, 0], turned, 0.105, 0.065, 0.5) + ContactSet([[1, 2, 3]], np.eye(3), 1)
    for name in ("contacts.yaml", "contacts.yml", "CONTACTS.YAML"):
        (tmp_path / name).write_text(TEXT)
        assert_same(read_contacts(tmp_path / name), expected)


def test_yaml_merges_defaults(tmp_path):
    (tmp_path / "a.yaml").write_text("""
contacts:
  - &left {type: rectangle, position: [0, 0.1, 0], half_length: 0.1, half_width: 0.05, friction: 0.5}
  - &right {<<: *left, position: [0, -0.1, 0]}
""")
    assert_same(read_contacts(tmp_path / "a.yaml"), read_contacts(write_contacts(tmp_path / "a.json")))


def test_json_says_the_same_as_yaml(tmp_path):
    assert_same(read_contacts(write_contacts(tmp_path / "a.json")), read_contacts(write_contacts(tmp_path / "a.yaml")))


def test_several_sets(tmp_path):
    document = {"sets": [{"name": "left", "contacts": [SOLE]}, FEET, {"name": "flight", "contacts": []}]}
    for extension in ("json", "yaml"):
        file = read_contact_sets(write_contacts(tmp_path / f"a.{extension}", document))
        assert file.names == ("left", None, "flight") and [len(contacts) for contacts in file.sets] == [4, 8, 0]
        assert_same(file.sets[1], read_contacts(write_contacts(tmp_path / "b.json")))
        assert file.sets[2].frames.shape == (0, 3, 3)


def test_a_file_of_one_set(tmp_path):
    one = read_contact_sets(write_contacts(tmp_path / "a.json"))
    assert one.names == (None,) and len(one.sets) == 1
    assert_same(one.sets[0], read_contacts(tmp_path / "a.json"))
    assert_same(read_contacts(write_contacts(tmp_path / "b.json", {"sets": [FEET]})), one.sets[0])
    path = write_contacts(tmp_path / "c.json", {"sets": [FEET, FEET]})
    assert_refused(path, "holds 2 sets of contacts (expected one)")


def test_entries_keep_their_order(tmp_path):
    contacts = read_contacts(write_contacts(tmp_path / "a.json"))
    assert len(contacts) == 8
    assert (contacts.points[:4, 1] > 0).all() and (contacts.points[4:, 1] < 0).all()


def test_json_numbers_keep_their_digits(tmp_path):
    third = 1 / 3
    entry = {"type": "point", "position": [third, 0, 0], "friction": third}
    contacts = read_contacts(write_contacts(tmp_path / "a.json", {"contacts": [entry]}))
    assert contacts.points[0, 0] == contacts.friction[0] == third


def test_json_needs_no_yaml(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "yaml", None)
    (tmp_path / "a.json").write_text(json.dumps(FEET))
    assert len(read_contacts(tmp_path / "a.json")) == 8


def assert_refused(path, *words):
    """The file is refused, with a message that holds all of these words."""
    with pytest.raises(InputError) as caught:
        read_contacts(path)
    assert all(word in str(caught.value) for word in (path.name, *words)), caught.value


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"contacts": []}, ["contacts: []", "at least one entry"]),
        ({"contacts": {}}, ["at least one entry"]),
        ({"contacts": None}, ["at least one entry"]),
        ({}, ["the one key 'contacts'"]),
        ({"contacts": [POINT], "gravity": 9.81}, ["'gravity'", "the one key 'contacts'"]),
        ([POINT], ["expected a mapping"]),
        ("rectangle", ["expected a mapping"]),
        ({"sets": []}, ["sets: []", "at least one entry"]),
        ({"sets": {"left": FEET}}, ["sets: {'left'", "expected a list"]),
        ({"sets": [FEET], "contacts": [POINT]}, ["keys 'sets', 'contacts'", "the one key 'contacts' or 'sets'"]),
        ({"sets": [[POINT]]}, ["sets[0]: [{", "expected a mapping"]),
        ({"sets": [FEET, {"name": "left"}]}, ["sets[1] (left): no field 'contacts'"]),
        ({"sets": [{"name": 1, "contacts": []}]}, ["sets[0]: name = 1 (expected text)"]),
        ({"sets": [{"contacts": None}]}, ["sets[0]: contacts: None (expected a list, empty for no contact)"]),
        ({"sets": [{"contacts": [], "points": 3}]}, ["sets[0]: unknown field 'points' (expected name, contacts)"]),
        ({"sets": [{"name": "a", "contacts": []}] * 2}, ["sets: more than one has the name 'a'"]),
        (
            {"sets": [{"name": "a", "contacts": [POINT, {**POINT, "mu": 1}]}]},
            ["sets[0] (a): contacts[1]: unknown field 'mu'"],
        ),
        ({"contacts": ["sole"]}, ["contacts[0]: 'sole' (expected a mapping)"]),
        ({"contacts": [POINT, {**POINT, "type": "sphere"}]}, ["[1]: type = 'sphere' (expected rectangle or point)"]),
        ({"contacts": [{**POINT, "type": ["point"]}]}, ["contacts[0]: type = ['point']"]),
        ({"contacts": [{"position": [0, 0, 0]}]}, ["contacts[0]: no field 'type'"]),
        ({"contacts": [{**POINT, "half_length": 0.1}]}, ["contacts[0]: unknown field 'half_length'"]),
        ({"contacts": [{**POINT, "mu": 0.1}]}, ["contacts[0]: unknown field 'mu'"]),
        ({"contacts": [{**POINT, "name": 3}]}, ["contacts[0]: name = 3 (expected text)"]),
        ({"contacts": [{"type": "point", "position": [0, 0, 0]}]}, ["contacts[0]: no field 'friction'"]),
        ({"contacts": [{**SOLE, "half_width": -0.1}]}, ["contacts[0] (left): half_width = -0.1 (expected a positive"]),
        ({"contacts": [{**SOLE, "half_width": True}]}, ["contacts[0] (left): half_width = True (expected a number)"]),
        ({"contacts": [{**SOLE, "half_width": "wide"}]}, ["half_width = 'wide' (expected a number)"]),
        ({"contacts": [{**POINT, "position": [0, 0]}]}, ["contacts[0]: position has shape (2,) (expected 3 numbers)"]),
        ({"contacts": [{**POINT, "position": [0, [0], 0]}]}, ["contacts[0]: position = [0, [0], 0] (expected 3 numbers)"]),
        ({"contacts": [{**POINT, "position": [0, None, 0]}]}, ["position = [0, None, 0] (expected 3 numbers)"]),
        ({"contacts": [{**POINT, "position": [0, float("nan"), 0]}]}, ["position", "expected finite numbers"]),
        ({"contacts": [{**POINT, "position": [0, 10**400, 0]}]}, ["position", "expected 3 numbers"]),
        ({"contacts": [{**POINT, "rotation": [1, 0, 0]}]}, ["rotation has shape (3,) (expected 3x3 numbers)"]),
    ],
)
@pytest.mark.parametrize("extension", ["json", "yaml"])
def test_contact_file_with_wrong_entries(tmp_path, document, words, extension):
    write_contacts(tmp_path / f"c.{extension}", document)
    if "finite" in words[-1] and extension == "yaml":
        (tmp_path / "c.yaml").write_text("contacts: [{type: point, friction: 1, position: [0, .nan, 0]}]")
    assert_refused(tmp_path / f"c.{extension}", *words)


@pytest.mark.parametrize("friction", [0, -0.5])
@pytest.mark.parametrize("entry", [POINT, SOLE])
def test_friction_that_is_not_positive(tmp_path, friction, entry):
    write_contacts(tmp_path / "c.json", {"contacts": [{**entry, "friction": friction}]})
    expected = f"friction = {float(friction)} (expected a positive finite number)"
    assert_refused(tmp_path / "c.json", "c.json: contacts[0]", expected)


@pytest.mark.parametrize("friction", [float("nan"), float("inf"), -float("inf")])
def test_friction_that_is_not_finite(tmp_path, friction):
    write_contacts(tmp_path / "c.json", {"contacts": [{**POINT, "friction": friction}]})
    assert_refused(tmp_path / "c.json", "c.json: contacts[0]: friction", "finite")


@pytest.mark.parametrize("entry", [POINT, SOLE])
@pytest.mark.parametrize("rotation", [np.diag([1, 1, -1]), np.zeros((3, 3)), 2 * np.eye(3), np.triu(np.ones((3, 3)))])
def test_frame_that_is_not_a_rotation(tmp_path, entry, rotation):
    write_contacts(tmp_path / "c.json", {"contacts": [{**entry, "rotation": rotation.tolist()}]})
    assert_refused(tmp_path / "c.json", "c.json: contacts[0]", "rotation is not a rotation", "(expected +1)")


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("c.yaml", "contacts:\n  - type: point\n   position: [0", ["c.yaml: line 3: not YAML"]),
        ("c.yaml", "contacts: [{type: point, type: point}]", ["c.yaml: line 1", "'type' is given twice"]),
        ("c.yaml", "contacts: !!python/object/apply:os.getcwd []", ["c.yaml: line 1: not YAML"]),
        ("c.yaml", "a: \x00", ["c.yaml: not YAML"]),
        ("c.yaml", "", ["c.yaml: None (expected a mapping"]),
        ("c.yaml", "? [a]\n: 1", ["c.yaml"]),
        ("c.yaml", "[" * 5000, ["c.yaml"]),
        ("c.json", '{"contacts": [\n{"type" "point"}]}', ["c.json: line 2: not JSON"]),
        ("c.json", '{"contacts": [{"type": "point", "type": "point"}]}', ["c.json: 'type' is given twice"]),
        ("c.json", "[" * 200_000, ["c.json"]),
        ("c.json", "", ["c.json: line 1: not JSON"]),
    ],
)
def test_contact_file_with_wrong_syntax(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    assert_refused(tmp_path / name, *words)


def test_contact_file_that_is_not_text(tmp_path):
    (tmp_path / "c.yaml").write_bytes(b"\xff\xfe\x80")
    assert_refused(tmp_path / "c.yaml", "c.yaml: not UTF-8 text")


def test_contact_file_missing_or_unknown(tmp_path):
    assert_refused(tmp_path / "c.yaml", "c.yaml: no such file")
    assert_refused(tmp_path / "c.toml", "c.toml: unknown extension '.toml'")
    (tmp_path / "d.yaml").mkdir()
    assert_refused(tmp_path / "d.yaml", "d.yaml: cannot be read")
