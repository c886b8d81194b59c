"""`jaxcap score --baselines`: the columns it adds, for contacts given in every way, and what is refused."""

import jax
import numpy as np
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
from jaxcap.files.fields import BASELINES, FIELDS

FOOT = [rectangle([0, y, 0], np.eye(3), 0.1, 0.05, 0.5) for y in (0.1, -0.1)]


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """A predictor that compiles nothing: it is the baselines that are tested."""
    score = lambda cone, coms, com_velocities, **_: fake_score(cone, coms, com_velocities)
    monkeypatch.setattr(jaxcap, "score", score)


def run(tmp_path, *options, columns=None, document=None, name="a.parquet", output="out.parquet"):
    """Scores N states in double precision. Returns the exit code."""
    contacts = None if document is None else write_contacts(tmp_path / "contacts.json", document)
    source = write_states(tmp_path / name, N, **(columns or {}))
    return main(command(source, contacts, tmp_path / output, "--dtype", "float64", *options))


def assert_baselines(path, expected):
    columns = read_columns(path)
    assert list(columns)[-2:] == list(BASELINES)
    for name in BASELINES:
        assert columns[name].dtype == np.float64
        np.testing.assert_allclose(columns[name], getattr(expected, name), atol=1e-9)


def own_contacts(lists):
    columns = padded_contacts(lists)
    mask = np.isfinite(columns["contact_friction"])
    neutral = {"contact_points": np.zeros(3), "contact_frames": np.eye(3), "contact_friction": np.ones(())}
    for name, value in neutral.items():
        columns[name][~mask] = value
    return ContactSet(*columns.values(), mask)


def expected_of(contacts, height=None):
    with jax.enable_x64(True):
        return jax.device_get(jaxcap.baselines(jaxcap.cone_rays(contacts), contacts, *states(N), height))


def test_one_set_of_contacts(tmp_path):
    assert run(tmp_path, "--baselines", document=FEET) == 0
    both = FOOT[0] + FOOT[1]
    with jax.enable_x64(True):
        expected = jax.device_get(jaxcap.baselines(jaxcap.centroidal_cone(both), both, *states(N)))
    assert_baselines(tmp_path / "out.parquet", expected)
    about = read_metadata(tmp_path / "out.parquet")
    assert all(about["units"][name] == "m" and "capture point" in about["meanings"][name] for name in BASELINES)
    assert "mean of the contact points" in about["capture_point_height"]


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_contacts_in_columns(tmp_path, extension):
    """Rows without a contact among them: nowhere to stand."""
    options = {"columns": COLUMNS[extension], "name": f"a.{extension}", "output": f"out.{extension}"}
    assert run(tmp_path, "--baselines", **options) == 0
    contacts = own_contacts(LISTS)
    expected = expected_of(contacts)
    assert_baselines(tmp_path / f"out.{extension}", expected)
    assert (expected.capture_point_support[~contacts.mask.any(axis=1)] == -np.inf).all()
    assert (expected.capture_point_support > 0).any()


@pytest.mark.parametrize("many", [1, 10**6])
def test_chosen_sets(tmp_path, monkeypatch, many):
    """By faces and by rays; with a height that is given."""
    monkeypatch.setattr(contact_rows, "MANY", many)
    assert run(tmp_path, "--baselines", "--height", "0.7", columns={"contact_set": NUMBERS}, document=SETS) == 0
    sets = [FOOT[0].padded(8), FOOT[0] + FOOT[1], ContactSet(np.zeros((0, 3)), np.eye(3), 1).padded(8)]
    own = jax.tree.map(lambda *leaves: np.stack(leaves), *(sets[i] for i in NUMBERS))
    assert_baselines(tmp_path / "out.parquet", expected_of(own, 0.7))
    assert read_metadata(tmp_path / "out.parquet")["capture_point_height"] == 0.7


def test_rows_whose_contacts_cannot_be_used_are_nan(tmp_path, capsys):
    wrong = {name: [list(row) for row in rows] for name, rows in LISTS.items()}
    row = next(i for i, friction in enumerate(wrong["contact_friction"]) if friction)
    wrong["contact_friction"][row][0] = -1.0
    assert run(tmp_path, "--baselines", columns=arrow_contacts(wrong)) == 0
    found, expected = read_columns(tmp_path / "out.parquet"), expected_of(own_contacts(LISTS))
    for name in BASELINES:
        assert np.isnan(found[name][row])
        others = np.arange(N) != row
        np.testing.assert_allclose(found[name][others], getattr(expected, name)[others], atol=1e-9)
    assert f"first row {row}" in capsys.readouterr().err


def test_without_the_option_nothing_changes(tmp_path):
    """No column, no metadata; and a column of that name is carried through."""
    column = np.arange(N, dtype=float)
    assert run(tmp_path, columns={"capture_point_hull": column}, document=FEET) == 0
    columns, about = read_columns(tmp_path / "out.parquet"), read_metadata(tmp_path / "out.parquet")
    assert list(columns) == ["com", "com_velocity", "capture_point_hull", *FIELDS]
    np.testing.assert_array_equal(columns["capture_point_hull"], column)
    assert "capture_point_height" not in about and not set(BASELINES) & set(about["units"])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--height", "0.8"], "--height 0.8 (expected with --baselines"),
        (["--baselines", "--height", "0"], "--height 0.0 (expected a positive number of metres)"),
        (["--baselines", "--height", "nan"], "--height nan (expected a positive number of metres)"),
    ],
)
def test_heights_that_are_refused(tmp_path, capsys, options, message):
    assert run(tmp_path, *options, document=FEET) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out.parquet").exists()


def test_a_column_of_that_name_is_refused(tmp_path, capsys):
    assert run(tmp_path, "--baselines", columns={"capture_point_hull": np.zeros(N)}, document=FEET) == 2
    assert "column 'capture_point_hull' has the name of an output column" in capsys.readouterr().err


def test_help_names_the_columns(capsys):
    assert main(["score", "--help"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in (*BASELINES, "--baselines", "--height"))
