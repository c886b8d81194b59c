"""Files of surfaces."""

import json

import numpy as np
import pytest

from jaxcap.contacts.surfaces import box, rail, surface
from jaxcap.errors import InputError
from jaxcap.files.surface_files import read_surfaces

PLANE = {"type": "plane", "position": [0, 0, 0], "half_length": 1, "half_width": 0.5, "friction": 0.6}
RAIL = {"type": "rail", "start": [0, 0, 1], "end": [1, 0, 1], "normal": [0, 0, 1], "half_width": 0.02, "friction": 0.5}
BOX = {"type": "box", "name": "table", "position": [1, 0, 0.4], "half_sizes": [0.3, 0.4, 0.4], "friction": 0.5}


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


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ([], "expected a mapping with the one key 'surfaces'"),
        ({"surfaces": []}, "expected a list of at least one entry"),
        ({"surfaces": [{"type": "sphere"}]}, r"surfaces\[0\]: type = 'sphere' \(expected plane or rail or box\)"),
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
