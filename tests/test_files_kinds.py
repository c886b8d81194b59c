"""Files as people have them: pandas indices, uneven lists, CSV, damaged bytes; bad rows are named, never fatal."""

import json
import zipfile

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from state_files import command, fake_score, read_columns, read_metadata, states, vectors, write_contacts, write_states

import jaxcap
from jaxcap.commands.cli import main
from jaxcap.errors import InputError
from jaxcap.files.records import read_states
from jaxcap.one_state.result import Case, Status

N = 8


@pytest.fixture(autouse=True)
def fake(monkeypatch):
    """A predictor that compiles nothing: it is the files that are tested."""
    monkeypatch.setattr(jaxcap, "score", fake_score)


@pytest.fixture
def scored(tmp_path, capsys):
    """A function that scores a file: the output's path, and what was said on stderr."""

    def run(path, *options, output="out.parquet", code=0):
        out = tmp_path / output
        contacts = write_contacts(tmp_path / "feet.json")
        found = main(command(path, contacts, out, *options))
        said = capsys.readouterr().err
        assert found == code, said
        return out, said

    return run


def frame(index=None) -> pd.DataFrame:
    coms, velocities = states(N)
    names = [f"com_{axis}" for axis in "xyz"] + [f"com_velocity_{axis}" for axis in "xyz"]
    return pd.DataFrame(np.hstack([coms, velocities]), columns=names, index=index)


INDICES = {
    "a range with steps": pd.RangeIndex(0, 2 * N, 2, name="step"),
    "times": pd.date_range("2026-01-01", periods=N, freq="5ms", name="stamp"),
    "two levels": pd.MultiIndex.from_product([["a", "b"], range(N // 2)], names=["run", "step"]),
}


@pytest.mark.parametrize("name", INDICES)
def test_the_index_of_a_pandas_frame_is_that_of_its_scores(scored, tmp_path, name):
    """F1: scores join their origin, row by row."""
    given = frame(INDICES[name])
    given.to_parquet(tmp_path / "a.parquet")
    out, _ = scored(tmp_path / "a.parquet")
    found = pd.read_parquet(out)
    assert found.index.equals(given.index) and found.index.names == given.index.names
    joined = given.join(found[["margin"]])
    np.testing.assert_array_equal(joined["margin"], np.array(read_columns(out)["margin"]))
    assert read_metadata(out)["sides"] == 4


@pytest.mark.parametrize("target", ["out.parquet", "out.npz"])
@pytest.mark.parametrize(
    ("entry", "why"),
    [
        ([], "com has 0 numbers"),
        ([1.0, 2.0], "com has 2 numbers"),
        (None, "com is null"),
        ([0.0, np.nan, 1.0], "com = [0.0, nan, 1.0]"),
    ],
)
def test_a_row_that_is_no_state_costs_no_other(scored, tmp_path, target, entry, why):
    """F3, F4, F5: empty, short and missing lists; Parquet as pandas writes it; the first bad row and its column named."""
    coms = states(N)[0].tolist()
    coms[6] = entry
    write_states(tmp_path / "a.parquet", N, com=pa.array(coms, pa.list_(pa.float64())))
    out, said = scored(tmp_path / "a.parquet", "--batch-size", "4", output=target)
    found = read_columns(out)
    expected = fake_score(None, *(x.astype(np.float32) for x in states(N)))
    rest = np.arange(N) != 6
    assert found["status"][6] == Status.NONFINITE and found["case"][6] == Case.UNDECIDED
    np.testing.assert_array_equal(found["margin"][rest], expected.margin[rest])
    assert "states of 1 rows cannot be used" in said and f"first row 6: {why}" in said
    assert any(why in note for note in read_metadata(out)["notes"])


def test_lists_of_any_length_become_an_array_in_npz(scored, tmp_path):
    """F4: that there are three numbers is known, whatever the type says."""
    coms, velocities = states(N)
    write_states(
        tmp_path / "a.parquet",
        N,
        com=vectors(coms, pa.list_(pa.float64())),
        com_velocity=vectors(velocities, pa.large_list(pa.float32())),
    )
    out, _ = scored(tmp_path / "a.parquet", output="out.npz")
    found = read_columns(out)
    np.testing.assert_array_equal(found["com"], coms)
    np.testing.assert_array_equal(found["com_velocity"], velocities.astype(np.float32))


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("com_y", np.nan, "com_y = nan"),
        ("com_velocity_z", np.inf, "com_velocity_z = inf"),
    ],
)
def test_a_bad_column_is_named(scored, tmp_path, name, value, why):
    """F5, for columns of one axis each, in Parquet and NPZ."""
    given = frame()
    given.loc[3, name] = value
    given.to_parquet(tmp_path / "a.parquet")
    np.savez(tmp_path / "a.npz", **{column: given[column].to_numpy() for column in given})
    for path in ("a.parquet", "a.npz"):
        _, said = scored(tmp_path / path, "--force")
        assert f"first row 3: {why}" in said


@pytest.mark.parametrize("target", ["out.parquet", "out.npz"])
def test_csv_is_read(scored, tmp_path, target):
    """F6: whole numbers in the first rows, a missing value, other columns."""
    given = frame()
    given.loc[0] = [0, 0, 1, 0, 0, 0]
    given.loc[2, "com_x"] = np.nan
    given["name"] = [f"row {i}" for i in range(N)]
    given.to_csv(tmp_path / "a.csv", index=False)
    out, said = scored(tmp_path / "a.csv", output=target)
    found = read_columns(out)
    numbers = given.iloc[:, :6].to_numpy().astype(np.float32)
    expected = fake_score(None, numbers[:, :3], numbers[:, 3:])
    np.testing.assert_array_equal(found["margin"], expected.margin)
    assert found["name"].tolist() == given["name"].tolist() and "first row 2: com_x = nan" in said


def test_csv_is_read_in_pieces(monkeypatch, tmp_path):
    from jaxcap.files import csv

    monkeypatch.setattr(csv, "BLOCK_BYTES", 4096)
    given = pd.concat([frame()] * 100, ignore_index=True)
    given.to_csv(tmp_path / "a.csv", index=False)
    with read_states(tmp_path / "a.csv", 96) as file:
        sizes = [len(batch.coms) for batch in file]
        assert file.rows == 100 * N and sizes == [96] * 8 + [32]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "com_x,com_y\n1,2\n",
        "com_x;com_y\n1;2\n",
        "\xff\xfe\x00",
        "com_x,com_y,com_z,com_velocity_x,com_velocity_y,com_velocity_z\n1,2,3,4,5,no\n",
    ],
)
def test_a_csv_that_holds_no_states_is_told_in_one_line(scored, tmp_path, text):
    (tmp_path / "a.csv").write_text(text, encoding="latin-1")
    _, said = scored(tmp_path / "a.csv", code=2)
    assert said.splitlines()[-1].startswith("error: ") and "a.csv" in said and "Traceback" not in said


@pytest.mark.parametrize("extension", ["parquet", "npz", "csv"])
def test_no_rows_are_worth_a_note(scored, tmp_path, capsys, extension):
    """F7."""
    path = tmp_path / f"a.{extension}"
    if extension == "csv":
        frame().iloc[:0].to_csv(path, index=False)
    else:
        write_states(path, 0)
    out, said = scored(path)
    assert "no rows" in said and len(read_columns(out)["margin"]) == 0
    assert read_metadata(out)["notes"] == ["no rows: there is nothing to score"]


def damaged(tmp_path, old: bytes, new: bytes):
    """An NPZ whose members hold other bytes: their checksums are right."""
    write_states(tmp_path / "good.npz", N)
    with zipfile.ZipFile(tmp_path / "good.npz") as source, zipfile.ZipFile(tmp_path / "a.npz", "w") as target:
        for name in source.namelist():
            target.writestr(name, source.read(name).replace(old, new, 1))
    return tmp_path / "a.npz"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"(8, 3)", b"(8, 3 "),
        (b"'shape'", b"'shap\xe9'"),
        (b"{'descr'", b"['descr'"),
        (b"'<f8'", b"'<q9'"),
        (b"False", b"Fals("),
        (b"\x93NUMPY", b"\x93NUMPX"),
    ],
)
def test_a_damaged_header_is_told_in_one_line(scored, tmp_path, old, new):
    """F8: NumPy's parser of headers raises what its tools raise, a TokenError for one."""
    _, said = scored(damaged(tmp_path, old, new), code=2)
    assert "a.npz: cannot be read as NPZ" in said and "Traceback" not in said


def test_a_column_whose_name_is_not_text_is_told_in_one_line(scored, tmp_path):
    """F8: Parquet's names are bytes, Python's are UTF-8."""
    path = write_states(tmp_path / "a.parquet", N, other=pa.array(np.arange(N)))
    data = path.read_bytes()
    assert data.count(b"other") >= 2
    path.write_bytes(data.replace(b"other", b"oth\xff\xfe"))
    _, said = scored(path, code=2)
    assert "a.parquet: cannot be read as Parquet" in said and "Traceback" not in said


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_random_damage_is_never_a_traceback(tmp_path, extension):
    """F8: whatever happens to the bytes, the file is read or refused."""
    path = write_states(tmp_path / f"a.{extension}", 40)
    good = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(300):
        data = bytearray(good)
        for place in rng.integers(0, len(data), rng.integers(1, 8)):
            data[place] = rng.integers(0, 256)
        path.write_bytes(bytes(data[: rng.integers(1, len(data) + 1)] if rng.random() < 0.2 else data))
        try:
            with read_states(path, 16) as file:
                list(file)
        except InputError as error:
            assert str(error).startswith(str(path)) and json.dumps(str(error))


MILLIMETRES = np.array([0.0, 0.0, 850.0])
UNLIKELY = {
    "millimetres": (lambda coms: 1000 * coms, "more than 10 m from all contacts"),
    "y up": (lambda coms: coms[:, [0, 2, 1]] - [0, 0, 0.2], "below all contacts"),
}


@pytest.mark.parametrize("name", UNLIKELY)
def test_what_is_hardly_plausible_is_noted(scored, tmp_path, name):
    """R4: states that are not metres, or not in the frame of the contacts."""
    change, words = UNLIKELY[name]
    coms, _ = states(N)
    write_states(tmp_path / "a.npz", N, com=change(coms))
    out, said = scored(tmp_path / "a.npz")
    assert sum(words in line for line in said.splitlines()) == 1
    assert any(words in note for note in read_metadata(out)["notes"])
    _, said = scored(tmp_path / "a.npz", "--strict", output="strict.parquet", code=2)
    assert said.startswith("error: --strict: ") and words in said and not (tmp_path / "strict.parquet").exists()


def test_contacts_that_are_hardly_plausible_are_noted(tmp_path, capsys):
    """R4: contacts in millimetres are far apart; normals that point down, away from the CoM."""
    sole = {"type": "rectangle", "half_length": 0.1, "half_width": 0.05, "friction": 0.5}
    path = write_states(tmp_path / "a.npz", N)
    down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    for name, entries, words in (
        ("wide", [{**sole, "position": [0, y, 0]} for y in (-4, 4)], "more than 5 m apart"),
        ("down", [{**sole, "position": [0, 0, 0], "rotation": down}], "point away from the CoM"),
    ):
        contacts = write_contacts(tmp_path / f"{name}.json", {"contacts": entries})
        assert main(command(path, contacts, tmp_path / f"{name}.parquet")) == 0
        assert words in capsys.readouterr().err


def test_what_is_plausible_is_not_noted(scored, tmp_path):
    """A single row that is far off is no matter."""
    coms, _ = states(N)
    coms[2] = 1e6
    out, said = scored(write_states(tmp_path / "a.npz", N, com=coms), "--strict")
    assert "note" not in said and read_metadata(out)["notes"] == []
