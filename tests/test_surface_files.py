"""Files of surfaces."""

import json

import numpy as np
import pytest

from jaxcap.contacts.surfaces import box, height_field, rail, surface
from jaxcap.errors import InputError
from jaxcap.files.surface_files import read_surfaces

PLANE = {"type": "plane", "position": [0, 0, 0], "half_length": 1, "half_width": 0.5, "friction": 0.6}
RAIL = {"type": "rail", "start": [0, 0, 1], "end": [1, 0, 1], "normal": [0, 0, 1], "half_width": 0.02, "friction": 0.5}
BOX = {"type": "box", "name": "table", "position": [1, 0, 0.4], "half_sizes": [0.3, 0.4, 0.4], "friction": 0.5}

FIELD = {"type": "height_field", "heights": [[0, 0.1, 0], [0, 0, 0.2]], "origin": [0, 0, 1], "spacing": 0.5, "friction": 0.6}


def written(tmp_path, document):
    path = tmp_path / "surfaces.json"
    path.write_text(json.dumps(document))
    return path


def test_what_is_in_the_file(tmp_path):
    found = read_surfaces(written(tmp_path, {"surfaces": [PLANE, RAIL, BOX]}))
    expected = [
        surface([0, 0, 0], np.eye(3), 1, 0.5, 0.6),
        rail([0, 0, 1], [1, 0, 1], [0, 0, 1], 0.02, 0.5),
        *box([1, 0, 0.4], np.eye(3), [0.3, 0.4, 0.4], 0.5),
    ]
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        for field in one._fields:
            np.testing.assert_array_equal(getattr(one, field), getattr(other, field))


def test_heights_in_the_file_or_in_one_beside_it(tmp_path):
    np.save(tmp_path / "ground.npy", np.array(FIELD["heights"]))
    np.savez(tmp_path / "ground.npz", heights=np.array(FIELD["heights"]))
    entries = [FIELD, FIELD | {"heights": "ground.npy"}, FIELD | {"heights": "ground.npz"}]
    expected = height_field(FIELD["heights"], [0, 0, 1], 0.5, 0.6)
    for one in read_surfaces(written(tmp_path, {"surfaces": entries})):
        for field in one._fields:
            np.testing.assert_array_equal(getattr(one, field), getattr(expected, field))


def test_heights_that_cannot_be_read(tmp_path):
    np.savez(tmp_path / "other.npz", ground=np.zeros((2, 2)))
    (tmp_path / "none.npy").write_text("no array")
    for name, words in (
        ("other.npz", "has no array 'heights'"),
        ("none.npy", "cannot be read"),
        ("missing.npy", "no such file"),
        ("ground.csv", "expected a list of rows, or the name of a file"),
    ):
        with pytest.raises(InputError, match=rf"surfaces\[0\]: .*{words}"):
            read_surfaces(written(tmp_path, {"surfaces": [FIELD | {"heights": name}]}))


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ([], "expected a mapping with the one key 'surfaces'"),
        ({"surfaces": []}, "expected a list of at least one entry"),
        (
            {"surfaces": [{"type": "sphere"}]},
            r"surfaces\[0\]: type = 'sphere' \(expected plane or rail or box or height_field\)",
        ),
        ({"surfaces": [FIELD | {"heights": [[0, 1], [0]]}]}, "heights = "),
        ({"surfaces": [FIELD | {"heights": [[0, 1]]}]}, r"heights: float64 of shape \(1, 2\) \(expected numbers of shape"),
        ({"surfaces": [FIELD | {"spacing": 0}]}, r"spacing = 0.0 \(expected a positive number of metres\)"),
        ({"surfaces": [PLANE, PLANE | {"half_width": 0}]}, r"surfaces\[1\]: half_width = 0.0 \(expected a positive"),
        ({"surfaces": [PLANE | {"size": 0}]}, "unknown field 'size'"),
        (
            {"surfaces": [{key: PLANE[key] for key in PLANE if key != "friction"}]},
            "no field 'friction', which a plane needs",
        ),
        ({"surfaces": [RAIL | {"normal": [0, 0, 2]}]}, "normal has length 2.000000"),
        ({"surfaces": [BOX | {"half_sizes": [1, 1]}]}, r"\(table\): half_sizes has shape \(2,\)"),
    ],
)
def test_what_cannot_be_is_named(tmp_path, document, words):
    with pytest.raises(InputError, match=words):
        read_surfaces(written(tmp_path, document))


@pytest.mark.parametrize("name", ["h.npy", "h.npz"])
def test_a_damaged_file_of_heights_is_told_in_a_line(name, tmp_path):
    """Whatever NumPy's parsers make of it: tokenize, zipfile and zlib have errors of their own."""
    heights, room = tmp_path / name, written(tmp_path, {"surfaces": [FIELD | {"heights": name}]})
    grid = np.zeros((3, 3))
    np.save(heights, grid) if name.endswith("npy") else np.savez(heights, heights=grid)
    whole, rng = heights.read_bytes(), np.random.default_rng(0)
    refused = 0
    for place in rng.integers(128, size=300):
        heights.write_bytes(whole[:place] + bytes([rng.integers(256)]) + whole[place + 1 :])
        try:
            read_surfaces(room)
        except InputError as error:
            refused += 1
            assert "surfaces[0]: " in str(error) and "\n" not in str(error)
    assert refused > 100
