"""The program, with contacts that differ from row to row: what is done, what is refused, which rows suffer."""

import os

import jax
import numpy as np
import pyarrow as pa
import pytest
from state_files import (
    COLUMNS,
    FEET,
    LISTS,
    NUMBERS,
    SETS,
    N,
    arrow_contacts,
    command,
    contact_lists,
    fake_score,
    padded_contacts,
    read_columns,
    read_metadata,
    states,
    write_contacts,
    write_states,
)

import jaxcap
from jaxcap.commands import scorers as contact_rows
from jaxcap.commands.cli import main
from jaxcap.contacts.contact_set import ContactSet, rectangle
from jaxcap.files.contact_files import read_contact_sets
from jaxcap.files.fields import FIELDS
from jaxcap.one_state.result import Case, Status


@pytest.fixture
def scored(monkeypatch):
    """Replaces the predictor by a simple rule; the list holds the options of each call."""
    calls = []

    def score(cone, coms, com_velocities, **options):
        calls.append({"rows": len(coms), "type": type(cone), **options})
        return fake_score(cone, coms, com_velocities)

    monkeypatch.setattr(jaxcap, "score", score)
    return calls


def run(tmp_path, columns, document=None, name="a.parquet", output="out.parquet", options=()):
    """Scores N states with these columns. Returns the exit code."""
    n = len(next(iter(columns.values())))
    contacts = None if document is None else write_contacts(tmp_path / "contacts.json", document)
    return main(command(write_states(tmp_path / name, n, **columns), contacts, tmp_path / output, *options))


def assert_scores(path, expected, tolerance):
    columns = read_columns(path)
    for name in list(FIELDS)[:3]:
        np.testing.assert_array_equal(columns[name], getattr(expected, name))
    for name in list(FIELDS)[3:]:
        np.testing.assert_allclose(columns[name], getattr(expected, name), atol=tolerance, rtol=tolerance)


# what is done


@pytest.mark.parametrize("extension", ["parquet", "npz"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_scores_of_own_contacts_are_those_of_the_library(tmp_path, extension, dtype):
    out = f"out.{extension}"
    options = ["--dtype", dtype, "--batch-size", "32"]
    assert run(tmp_path, COLUMNS[extension], None, f"a.{extension}", out, options) == 0
    columns = padded_contacts(LISTS)
    mask = np.isfinite(columns["contact_friction"])
    neutral = {"contact_points": np.zeros(3), "contact_frames": np.eye(3), "contact_friction": np.ones(())}
    for name, values in neutral.items():
        columns[name][~mask] = values
    with jax.enable_x64(dtype == "float64"):
        rays = jaxcap.cone_rays(ContactSet(*(columns[name].astype(dtype) for name in neutral), mask))
        expected = jaxcap.score(rays, *(x.astype(dtype) for x in states(N)))
        assert expected.margin.dtype == dtype
        expected = jax.device_get(expected)
    assert_scores(tmp_path / out, expected, 1e-9 if dtype == "float64" else 1e-3)
    assert (expected.case[~mask.any(axis=1)] == Case.EMPTY).all() and expected.capturable.any()


@pytest.mark.parametrize("many", [1, 10**6])
def test_scores_of_chosen_sets_are_those_of_the_library(tmp_path, monkeypatch, many):
    monkeypatch.setattr(contact_rows, "MANY", many)
    assert run(tmp_path, {"contact_set": NUMBERS}, SETS, options=["--dtype", "float64"]) == 0
    feet = [rectangle([0, y, 0], np.eye(3), 0.1, 0.05, 0.5) for y in (0.1, -0.1)]
    sets = [feet[0].padded(8), feet[0] + feet[1], ContactSet(np.zeros((0, 3)), np.eye(3), 1).padded(8)]
    own = jax.tree.map(lambda *leaves: np.stack(leaves), *(sets[i] for i in NUMBERS))
    with jax.enable_x64(True):
        expected = jax.device_get(jaxcap.score(jaxcap.cone_rays(own), *states(N)))
    assert_scores(tmp_path / "out.parquet", expected, 1e-7)


@pytest.mark.parametrize(("source", "target"), [(i, o) for i in ("parquet", "npz") for o in ("parquet", "npz")])
def test_columns_of_contacts_are_carried_through(tmp_path, scored, source, target):
    padded = padded_contacts(LISTS)
    assert run(tmp_path, COLUMNS[source] | {"step": np.arange(N)}, None, f"a.{source}", f"out.{target}") == (
        0 if (source, target) != ("parquet", "npz") else 2  # an NPZ cannot hold ragged lists
    )
    if (source, target) == ("parquet", "npz"):
        return
    columns = read_columns(tmp_path / f"out.{target}")
    assert list(columns) == ["com", "com_velocity", *LISTS, "step", *FIELDS]
    for name in LISTS:
        if source == "parquet":
            assert columns[name] == LISTS[name]
        else:
            np.testing.assert_array_equal(np.array(columns[name]), padded[name])


@pytest.mark.parametrize("target", ["parquet", "npz"])
def test_metadata_says_where_the_contacts_come_from(tmp_path, scored, target):
    out = f"out.{target}"
    columns = {**padded_contacts(LISTS), "contact_mask": np.ones((N, 8), bool)}
    assert run(tmp_path, columns, None, "a.npz", out) == 0
    metadata = read_metadata(tmp_path / out)
    assert metadata["contacts"] == ["contact_points", "contact_frames", "contact_friction", "contact_mask"]
    assert metadata["units"]["contact_points"] == "m" and metadata["sides"] == 4
    assert run(tmp_path, {"contact_set": NUMBERS}, SETS, "a.npz", out, ["--force"]) == 0
    contacts = read_metadata(tmp_path / out)["contacts"]
    assert [one["name"] for one in contacts] == ["left", None, "flight"]
    assert [len(one["points"]) for one in contacts] == [4, 8, 0] and contacts[0]["friction"] == [0.5] * 4


@pytest.mark.parametrize("columns", [COLUMNS["parquet"], {"contact_set": NUMBERS}])
def test_options_reach_the_scores(tmp_path, scored, monkeypatch, columns):
    seen, real = [], contact_rows.cone_rays
    monkeypatch.setattr(contact_rows, "cone_rays", lambda contacts, sides: seen.append(sides) or real(contacts, sides))
    document = SETS if "contact_set" in columns else None
    assert run(tmp_path, columns, document, options=["--sides", "5", "--neighbours"]) == 0
    assert set(seen) == {5} and all(call["neighbours"] for call in scored)
    assert read_metadata(tmp_path / "out.parquet")["sides"] == 5
    scored.clear()
    assert run(tmp_path, columns, document, options=["--force"]) == 0
    assert scored and not any(call["neighbours"] for call in scored)


def test_neighbours_are_nothing_to_faces(tmp_path, scored, monkeypatch):
    monkeypatch.setattr(contact_rows, "MANY", 1)
    assert run(tmp_path, {"contact_set": NUMBERS}, SETS, options=["--neighbours"]) == 0
    assert {call["type"] for call in scored} == {jaxcap.CentroidalCone} and not any(call["neighbours"] for call in scored)
    assert run(tmp_path, {"x": NUMBERS}, FEET, options=["--neighbours", "--force"]) == 0


def test_one_set_needs_no_choice_and_allows_one(tmp_path, scored):
    for columns, document in (({"x": NUMBERS}, {"sets": SETS["sets"][:1]}), ({"contact_set": 0 * NUMBERS}, FEET)):
        assert run(tmp_path, columns, document, options=["--force"]) == 0
    assert len(read_metadata(tmp_path / "out.parquet")["contacts"]) == 1


@pytest.mark.parametrize("size", [1, 7, 16, 40, 100])
def test_every_batch_size_gives_the_same(tmp_path, scored, capsys, size):
    lists = {name: list(rows) for name, rows in LISTS.items()}
    lists["contact_friction"][33] = None
    assert run(tmp_path, arrow_contacts(lists), options=["--batch-size", str(size)]) == 0
    assert "1 rows cannot be used" in (note := capsys.readouterr().err) and "first row 33: contact_friction is null" in note
    columns = read_columns(tmp_path / "out.parquet")
    good = np.arange(N) != 33
    expected = fake_score(None, *(x.astype(np.float32) for x in states(N)))
    np.testing.assert_array_equal(columns["margin"][good], expected.margin[good])
    assert columns["status"][33] == Status.NONFINITE


def test_rows_without_any_state(tmp_path, scored, capsys):
    for columns, document in (
        ({name: rows[:0] for name, rows in COLUMNS["parquet"].items()}, None),
        ({"contact_set": NUMBERS[:0]}, SETS),
    ):
        assert run(tmp_path, columns, document, options=["--force"]) == 0
        assert "no states" in capsys.readouterr().out and not scored


# rows that cannot be used


def nan_point(point):
    point[0][1] = float("nan")


def turned(frames):
    frames[0][2] = [-x for x in frames[0][2]]


def stretched(frames):
    frames[0] = [[1.0001 * x for x in row] for row in frames[0]]


WRONG = {
    "a point with nan": ("contact_points", nan_point, "contact_points[0] = ["),
    "a short point": ("contact_points", lambda p: p[0].pop(), "contact_points[0] does not hold 3 numbers"),
    "a point less": ("contact_points", lambda p: p.pop(), "(expected"),
    "a long list": ("contact_points", lambda p: p.extend([p[0]] * 70), "contacts (expected at most 64)"),
    "a mirror": ("contact_frames", turned, "contact_frames[0] is not a rotation: det = -1.000 (expected +1)"),
    "a stretched frame": ("contact_frames", stretched, "is not a rotation: det = 1.000"),
    "a frame of zeros": ("contact_frames", lambda f: f.__setitem__(0, [[0.0] * 3] * 3), "det = 0.000"),
    "a null in a frame": ("contact_frames", lambda f: f[0][1].__setitem__(1, None), "contact_frames[0] is not a rotation"),
    "a frame of two rows": ("contact_frames", lambda f: f[0].pop(), "contact_frames[0] does not hold 3 x 3 numbers"),
    "a frame with a short row": ("contact_frames", lambda f: f[0][1].pop(), "contact_frames[0] does not hold 3 x 3 numbers"),
    "friction zero": ("contact_friction", lambda f: f.__setitem__(0, 0.0), "contact_friction[0] = 0.0 (expected a positive"),
    "friction nan": ("contact_friction", lambda f: f.__setitem__(0, None), "contact_friction[0] = nan (expected a positive"),
    "friction infinite": ("contact_friction", lambda f: f.__setitem__(0, np.inf), "contact_friction[0] = inf"),
    "a friction too many": ("contact_friction", lambda f: f.append(1.0), "as contact_points has)"),
}


@pytest.mark.parametrize("name", WRONG)
def test_one_row_that_cannot_be_used(tmp_path, scored, capsys, name):
    column, spoil, words = WRONG[name]
    lists = contact_lists(N)
    row = next(i for i in range(20, N) if len(lists["contact_points"][i]) > 1)
    spoil(lists[column][row])
    assert run(tmp_path, arrow_contacts(lists), options=["--batch-size", "15"]) == 0
    printed = capsys.readouterr()
    assert f"the contacts of 1 rows cannot be used, these have status nonfinite; first row {row}: contact_" in printed.err
    assert words in printed.err and "Traceback" not in printed.err
    columns = read_columns(tmp_path / "out.parquet")
    assert np.flatnonzero(columns["status"] == Status.NONFINITE).tolist() == [row]
    assert columns["case"][row] == Case.UNDECIDED and not columns["capturable"][row]
    good = np.arange(N) != row
    expected = fake_score(None, *(x.astype(np.float32) for x in states(N)))
    np.testing.assert_array_equal(columns["margin"][good], expected.margin[good])


@pytest.mark.parametrize("column", list(LISTS))
@pytest.mark.parametrize("spelling", ["nested", "flat"])
def test_a_row_of_null(tmp_path, scored, capsys, column, spelling):
    columns = arrow_contacts(LISTS, spelling)
    columns[column] = pa.array(
        [None if i in (5, 9) else row for i, row in enumerate(columns[column].to_pylist())], columns[column].type
    )
    assert run(tmp_path, columns) == 0
    assert f"2 rows cannot be used, these have status nonfinite; first row 5: {column} is null" in capsys.readouterr().err
    assert np.flatnonzero(read_columns(tmp_path / "out.parquet")["status"]).tolist() == [5, 9]


def test_flat_lists_of_a_wrong_length(tmp_path, scored, capsys):
    columns = arrow_contacts(LISTS, "flat")
    rows = columns["contact_frames"].to_pylist()
    rows[12] = [1.0] * 10
    assert run(tmp_path, columns | {"contact_frames": pa.array(rows)}) == 0
    assert "first row 12: contact_frames has 10 numbers (expected a multiple of 9)" in capsys.readouterr().err


def test_a_mask_that_does_not_match(tmp_path, scored, capsys):
    mask = [[True] * len(row) for row in LISTS["contact_points"]]
    rows = [i for i, row in enumerate(mask) if row][:2]
    mask[rows[0]], mask[rows[1]] = [*mask[rows[0]], True], [None, *mask[rows[1]][1:]]
    assert run(tmp_path, COLUMNS["parquet"] | {"contact_mask": pa.array(mask)}) == 0
    error = capsys.readouterr().err
    assert "2 rows cannot be used" in error and f"first row {rows[0]}: contact_mask has" in error


def test_a_mask_decides_alone(tmp_path, scored, capsys):
    columns = padded_contacts(LISTS)
    mask = np.isfinite(columns["contact_friction"])
    row = int(np.argmin(mask.all(axis=1)))
    mask[row, 7] = True
    assert run(tmp_path, columns | {"contact_mask": mask}, None, "a.npz") == 0
    assert f"first row {row}: contact_points[7] = [nan, nan, nan] (expected finite numbers)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            np.where(NUMBERS == 2, 3, NUMBERS),
            "13 rows cannot be used, these have status nonfinite; first row 2: contact_set",
        ),
        (
            ["left"] * 39 + ["right"],
            "1 rows cannot be used, these have status nonfinite; first row 39: contact_set = 'right'",
        ),
        ([None] + [0] * 39, "first row 0: contact_set is null"),
    ],
)
def test_choices_that_there_are_not(tmp_path, scored, capsys, values, words):
    assert run(tmp_path, {"contact_set": values}, SETS) == 0
    assert words in capsys.readouterr().err
    assert (read_columns(tmp_path / "out.parquet")["status"] == Status.NONFINITE).any()


# what is refused

SQUARE = np.tile(np.eye(3), (N, 8, 1, 1))
OWN = {"contact_points": np.zeros((N, 8, 3)), "contact_frames": SQUARE, "contact_friction": np.ones((N, 8))}


@pytest.mark.parametrize(
    ("columns", "document", "words"),
    [
        ({}, None, ["no contacts (expected --contacts, or columns 'contact_points', ...)"]),
        ({"contact_set": NUMBERS}, None, ["no contacts (expected --contacts, in which 'contact_set' chooses)"]),
        ({}, SETS, ["no column 'contact_set', which chooses among the 3 sets of", "contacts.json"]),
        (OWN, FEET, ["column 'contact_points' gives each row its contacts (expected no --contacts"]),
        (OWN, SETS, ["column 'contact_points' gives each row its contacts (expected no --contacts"]),
        (OWN | {"contact_set": NUMBERS}, FEET, ["both 'contact_points' and 'contact_set'"]),
        (OWN | {"contact_points": None}, None, ["no column 'contact_points' beside 'contact_frames'"]),
        (OWN | {"contact_frames": None}, None, ["no column 'contact_frames' beside 'contact_points'"]),
        (OWN | {"contact_friction": None}, None, ["no column 'contact_friction' beside 'contact_points'"]),
        ({"contact_mask": np.ones((N, 8), bool)}, None, ["no column 'contact_points' beside 'contact_mask'"]),
        (OWN | {"contact_points": np.zeros((N, 8, 2))}, None, ["'contact_points' has rows of shape (8, 2)", "k x 3 or 3 k"]),
        (
            OWN | {"contact_points": np.zeros((N, 8))},
            None,
            ["'contact_points' has rows of shape (8) (expected k x 3 or 3 k"],
        ),
        (OWN | {"contact_points": np.zeros((N, 7, 3))}, None, ["'contact_frames' has 8 contacts a row (expected 7, as"]),
        (
            OWN | {"contact_points": np.zeros((N, 65, 3))},
            None,
            ["'contact_points' has 65 contacts a row (expected at most 64)"],
        ),
        (OWN | {"contact_frames": np.zeros((N, 3, 3))}, None, ["'contact_frames' has rows of shape (3, 3)"]),
        (OWN | {"contact_friction": np.ones((N, 8, 1))}, None, ["has rows of shape (8, 1) (expected k numbers, or one)"]),
        (OWN | {"contact_mask": np.ones(N, bool)}, None, ["'contact_mask' has rows of shape ()", "a list of k booleans"]),
        (OWN | {"contact_mask": np.ones((N, 8))}, None, ["'contact_mask' has", "booleans"]),
        (OWN | {"contact_points": np.zeros((N, 8, 3), "U1")}, None, ["'contact_points' has"]),
        ({"contact_set": NUMBERS + 0.5}, SETS, ["'contact_set' has", "(expected integers or names)"]),
        ({"contact_set": NUMBERS[:, None]}, SETS, ["'contact_set' has"]),
    ],
)
@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_columns_of_contacts_that_are_refused(tmp_path, scored, capsys, columns, document, words, extension):
    columns = {name: x for name, x in columns.items() if x is not None}
    if extension == "parquet":
        columns = {name: pa.array(x.tolist()) if name == "contact_set" else fixed(x) for name, x in columns.items()}
    columns["x"] = np.arange(N)
    assert run(tmp_path, columns, document, f"a.{extension}") == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and f"a.{extension}: " in error
    assert all(word in error for word in words), error
    assert not scored and set(os.listdir(tmp_path)) <= {f"a.{extension}", "contacts.json"}


def fixed(values):
    """An array as lists of fixed size."""
    kind = pa.string() if values.dtype.kind == "U" else pa.from_numpy_dtype(values.dtype)
    for size in reversed(values.shape[1:]):
        kind = pa.list_(kind, size)
    return pa.array(values.tolist(), kind)


def test_rows_that_do_not_match_in_npz(tmp_path, scored, capsys):
    assert run(tmp_path, {"x": NUMBERS, **OWN, "contact_friction": np.ones((N + 1, 8))}, None, "a.npz") == 2
    assert f"'contact_friction' has {N + 1} rows (expected {N}, as 'com' has)" in capsys.readouterr().err


def test_ragged_lists_do_not_fit_into_npz(tmp_path, scored, capsys):
    assert run(tmp_path, COLUMNS["parquet"], output="out.npz") == 2
    assert "column 'contact_points' has type" in (error := capsys.readouterr().err) and "write Parquet" in error
    assert not scored and os.listdir(tmp_path) == ["a.parquet"]


def test_help_explains_contacts_of_rows(capsys, tmp_path):
    assert main(["score", "--help"]) == 0
    text = capsys.readouterr().out
    words = ["contact_points", "contact_frames", "contact_friction", "contact_mask", "contact_set", "sets:", "--neighbours"]
    assert [word for word in words if word not in text] == []
    lines = text.splitlines()
    assert max(map(len, lines)) <= 80
    first = next(i for i, line in enumerate(lines) if line.strip() == "sets:")
    last = next(i for i, line in enumerate(lines) if "contacts: []" in line)
    (tmp_path / "help.yaml").write_text("\n".join(lines[first : last + 1]))
    assert [len(contacts) for contacts in read_contact_sets(tmp_path / "help.yaml").sets] == [1, 0]
