"""Bad input: exit code 2, one line that names what is at fault, and no output; bad rows: only those rows suffer."""

import errno
import io
import os
import resource
import sys
import zipfile
from contextlib import contextmanager

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from state_files import (
    FEET,
    command,
    fake_score,
    leftovers,
    read_columns,
    states,
    vectors,
    write_contacts,
    write_states,
)

import jaxcap
from jaxcap.commands.cli import main
from jaxcap.one_state.result import Case, Status

POINT = {"type": "point", "position": [0, 0, 0], "friction": 0.5}
SOLE = FEET["contacts"][0]


@pytest.fixture(autouse=True)
def scored(monkeypatch):
    """Replaces the predictor; the list counts the rows of each call."""
    calls = []

    def score(cone, coms, com_velocities, gravity, neighbours, specific_angular_momentum):
        calls.append(len(coms))
        return fake_score(cone, coms, com_velocities, gravity)

    monkeypatch.setattr(jaxcap, "score", score, raising=False)
    return calls


@pytest.fixture
def refused(tmp_path, capsys, scored):
    """A function that runs `jaxcap score` and asserts that it refuses, with one line that holds all of these words."""

    def run(*words, states="states.npz", contacts="feet.json", output="out.parquet", options=(), early=True):
        if not (tmp_path / "feet.json").exists():
            write_contacts(tmp_path / "feet.json")
        before = set(os.listdir(tmp_path))
        code = main(command(tmp_path / states, tmp_path / contacts, tmp_path / output, *options))
        error = capsys.readouterr().err
        assert code == 2, error
        line = error.splitlines()[-1]
        assert line.startswith("error: ") and all(word in line for word in words), error
        assert "Traceback" not in error
        assert set(os.listdir(tmp_path)) == before and not leftovers(tmp_path)
        assert not (early and scored), "refused only after computing"
        return line

    return run


@pytest.fixture
def good(tmp_path):
    """A good state file."""
    return write_states(tmp_path / "states.npz").name


# the state file


def test_missing_file(refused):
    refused("nowhere.parquet: no such file", states="nowhere.parquet")


def test_directory_for_a_file(refused, tmp_path):
    (tmp_path / "a.npz").mkdir()
    refused("a.npz: not a file", states="a.npz")


@pytest.mark.parametrize("name", ["states.txt", "states", "states.npy"])
def test_unknown_extension(refused, tmp_path, name):
    (tmp_path / name).write_text("com")
    refused(name, "unknown extension", ".parquet, .npz or .csv", states=name)


@pytest.mark.parametrize("extension", ["parquet", "npz"])
@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["com"], ["no column 'com_velocity'", "(columns: com)"]),
        (["com_velocity"], ["no column 'com' and no com_x, com_y, com_z"]),
        (["com", "com_velocity_x", "com_velocity_z"], ["no column 'com_velocity_y'"]),
        (["com", "com_x", "com_velocity"], ["both 'com' and 'com_x'"]),
        ([], ["no column 'com'", "(columns: none)"]),
    ],
)
def test_missing_column(refused, tmp_path, extension, names, words):
    values = states(4)[0]
    columns = {name: values[:, 0] if name[-2] == "_" else values for name in names}
    path = tmp_path / f"a.{extension}"
    if extension == "npz":
        np.savez(path, **columns)
    else:
        pq.write_table(pa.table({n: vectors(x) if x.ndim == 2 else x for n, x in columns.items()}), path)
    refused(path.name, *words, states=path.name)


@pytest.mark.parametrize("com", [np.zeros((4, 2)), np.zeros((4, 3, 1)), np.zeros(12), np.zeros(()), np.zeros((3, 4))])
def test_wrong_shape_in_npz(refused, tmp_path, com):
    write_states(tmp_path / "a.npz", 4, com=com)
    refused("a.npz: 'com' has shape", str(com.shape), "(expected (n, 3))", states="a.npz")


def test_rows_that_do_not_match_in_npz(refused, tmp_path):
    write_states(tmp_path / "a.npz", 4, com=np.zeros((5, 3)))
    refused("a.npz: 'com_velocity' has 4 rows (expected 5, as 'com' has)", states="a.npz")


@pytest.mark.parametrize("kind", ["U3", "S3", "?", "complex128", "M8[s]", "V8"])
def test_wrong_dtype_in_npz(refused, tmp_path, kind):
    write_states(tmp_path / "a.npz", 4, com=np.zeros((4, 3), kind))
    refused("a.npz: 'com' has dtype", "(expected floats or integers)", states="a.npz")


def test_wrong_length_of_fixed_lists(refused, tmp_path):
    write_states(tmp_path / "a.parquet", 2, com=pa.array([[0.0, 1], [0, 1]], pa.list_(pa.float64(), 2)))
    refused("a.parquet: column 'com' holds 2 numbers a row (expected 3)", states="a.parquet")


def test_wrong_length_of_one_list(tmp_path, capsys):
    rows = [[0.0, 0.0, 1.0]] * 20
    rows[13] = [0.0, 1.0]
    write_states(tmp_path / "a.parquet", 20, com=pa.array(rows))
    out = tmp_path / "out.parquet"
    assert main(command(tmp_path / "a.parquet", write_contacts(tmp_path / "feet.json"), out, "--batch-size", "5")) == 0
    assert np.flatnonzero(read_columns(out)["status"] == Status.NONFINITE).tolist() == [13]
    assert "first row 13: com has 2 numbers (expected 3)" in capsys.readouterr().err


@pytest.mark.parametrize(
    "column",
    [
        pa.array(["a", "b"]),
        pa.array([1.0, 2.0]),
        pa.array([["a"] * 3] * 2),
        pa.array([[True] * 3] * 2),
        pa.array([{"x": 1.0}] * 2),
        pa.array([[[1.0] * 3]] * 2),
        pa.nulls(2),
    ],
)
def test_wrong_type_in_parquet(refused, tmp_path, column):
    write_states(tmp_path / "a.parquet", 2, com=column)
    refused("a.parquet: column 'com' has type", "(expected lists of 3 floats or integers)", states="a.parquet")


def test_wrong_type_of_one_axis(refused, tmp_path):
    write_states(tmp_path / "a.parquet", 2, com=None, com_x=[0.0, 1.0], com_y=["0", "1"], com_z=[0.0, 1.0])
    refused("a.parquet: column 'com_y' has type string (expected floats or integers)", states="a.parquet")


def test_two_columns_of_one_name(refused, tmp_path):
    column = vectors(np.zeros((2, 3)))
    pq.write_table(pa.Table.from_arrays([column] * 3, ["com", "com_velocity", "com"]), tmp_path / "a.parquet")
    refused("a.parquet: 2 columns have the name 'com'", states="a.parquet")


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_column_named_like_an_output(refused, tmp_path, extension):
    write_states(tmp_path / f"a.{extension}", 10, margin=np.zeros(10))
    refused("column 'margin' has the name of an output column", states=f"a.{extension}")


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_output_scored_again(refused, tmp_path, good, extension):
    write_contacts(tmp_path / "feet.json")
    assert main(command(tmp_path / good, tmp_path / "feet.json", tmp_path / f"first.{extension}")) == 0
    refused("has the name of an output column", states=f"first.{extension}", early=False)


def test_column_named_metadata_does_not_fit_into_npz(refused, tmp_path):
    write_states(tmp_path / "a.parquet", 10, metadata=np.zeros(10))
    refused("'metadata'", states="a.parquet", output="out.npz")


@pytest.mark.parametrize(
    "column",
    [
        pa.array([[1], [2, 3]]),
        pa.array([{"x": 1}, None]),
        pa.array([b"a", b"b"]),
        pa.array([0, 1], pa.timestamp("s", "UTC")),
    ],
)
def test_columns_that_do_not_fit_into_npz(refused, tmp_path, column):
    write_states(tmp_path / "a.parquet", 2, thing=column)
    refused("column 'thing' has type", "write Parquet", states="a.parquet", output="out.npz")


@pytest.mark.parametrize("column", [pa.array([1, None]), pa.array(["a", None]), pa.array([True, None])])
def test_nulls_that_do_not_fit_into_npz(refused, tmp_path, column):
    write_states(tmp_path / "a.parquet", 2, thing=column)
    refused("column 'thing' has nulls", states="a.parquet", output="out.npz", early=False)


def test_columns_that_do_not_fit_into_parquet(refused, tmp_path):
    write_states(tmp_path / "a.npz", 2, thing=np.zeros(2, complex))
    refused("column 'thing' has dtype complex128", "write NPZ", states="a.npz")


def test_pickled_npz_is_refused_and_not_run(refused, tmp_path):
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "sprung"),)

    write_states(tmp_path / "a.npz", 2, extra=np.array([Trap(), Trap()], dtype=object))
    refused("a.npz: 'extra' holds pickled objects, which are never unpickled", states="a.npz")
    write_states(tmp_path / "b.npz", 2, com=np.array([Trap(), Trap()], dtype=object))
    refused("b.npz: 'com' holds pickled objects, which are never unpickled", states="b.npz")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_truncated_file(refused, tmp_path, extension):
    whole = write_states(tmp_path / f"whole.{extension}", 1000).read_bytes()
    for share in (0, 1, 4, 100, len(whole) // 2, len(whole) - 1):
        (tmp_path / f"a.{extension}").write_bytes(whole[:share])
        refused(f"a.{extension}: cannot be read as", states=f"a.{extension}")


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_text_for_a_file(refused, tmp_path, extension):
    (tmp_path / f"a.{extension}").write_text("com,com_velocity\n" * 100)
    refused(f"a.{extension}: cannot be read as", states=f"a.{extension}")


@pytest.mark.parametrize("compressed", [False, True])
def test_damage_in_the_middle_of_an_npz(refused, tmp_path, compressed):
    coms, velocities = states(1000)
    (np.savez_compressed if compressed else np.savez)(tmp_path / "a.npz", com=coms, com_velocity=velocities)
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[5000] ^= 0x55
    (tmp_path / "a.npz").write_bytes(data)
    refused("a.npz: cannot be read as NPZ", states="a.npz", early=False)


def test_damage_in_the_middle_of_a_parquet(refused, tmp_path):
    write_states(tmp_path / "a.parquet", 1000)
    data = bytearray((tmp_path / "a.parquet").read_bytes())
    data[4:2000] = bytes(1996)
    (tmp_path / "a.parquet").write_bytes(data)
    refused("a.parquet: cannot be read as Parquet", states="a.parquet", early=False)


@pytest.mark.parametrize("rows", [9, 11, -1, 10**18])
def test_npz_header_that_does_not_match_its_data(refused, tmp_path, rows):
    body = io.BytesIO()
    np.lib.format.write_array_header_1_0(body, {"descr": "<f8", "fortran_order": False, "shape": (rows, 3)})
    body.write(bytes(240))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for name in ("com.npy", "com_velocity.npy"):
            archive.writestr(name, body.getvalue())
    refused("a.npz: cannot be read as NPZ", "its header says", states="a.npz")


# the contact file: the commonest slips; `test_contact_files` has the others


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ([], ["contacts: []", "at least one entry"]),
        ([{**POINT, "friction": 0}], ["contacts[0]: friction = 0.0 (expected a positive finite number)"]),
        ([{**SOLE, "friction": -1}], ["contacts[0] (left): friction = -1.0 (expected a positive finite number)"]),
        ([{**POINT, "friction": float("inf")}], ["contacts[0]: friction = inf (expected finite numbers)"]),
        ([{**POINT, "friction": float("nan")}], ["contacts[0]: friction = nan (expected finite numbers)"]),
        ([{**POINT, "rotation": np.diag([1, 1, -1]).tolist()}], ["rotation is not a rotation", "det = -1.000"]),
        ([POINT, {**POINT, "mu": 0.5}], ["contacts[1]: unknown field 'mu'"]),
    ],
)
def test_wrong_contacts(refused, tmp_path, good, entries, words):
    write_contacts(tmp_path / "c.json", {"contacts": entries})
    refused("c.json: ", *words, contacts="c.json")


def test_contact_file_that_is_not_there(refused, tmp_path, good):
    refused("c.yaml: no such file", contacts="c.yaml")
    refused("c.toml: unknown extension '.toml'", contacts="c.toml")


# options


@pytest.mark.parametrize("sides", ["2", "0", "-4"])
def test_too_few_sides(refused, good, sides):
    refused(f"--sides {sides} (expected at least 3)", options=["--sides", sides])


@pytest.mark.parametrize("size", ["0", "-1"])
def test_batch_size_below_one(refused, good, size):
    refused(f"--batch-size {size} (expected at least 1)", options=["--batch-size", size])


@pytest.mark.parametrize("options", [["--dtype", "float16"], ["--sides", "four"], ["--bogus"]])
def test_wrong_usage(tmp_path, capsys, good, options):
    write_contacts(tmp_path / "feet.json")
    assert main(command(tmp_path / good, tmp_path / "feet.json", tmp_path / "out.npz", *options)) == 2
    assert options[0] in capsys.readouterr().err
    assert not (tmp_path / "out.npz").exists()


# the output


def test_output_that_exists(refused, tmp_path, good):
    (tmp_path / "out.parquet").write_text("old")
    refused("out.parquet: exists already (--force overwrites it)", states="nowhere.npz")  # before anything is read
    assert (tmp_path / "out.parquet").read_text() == "old"


@pytest.mark.parametrize("options", [[], ["--force"]])
def test_output_that_is_an_input(refused, tmp_path, good, options):
    refused("is also an input", output=good, options=options)
    (tmp_path / "link.npz").symlink_to(tmp_path / good)
    refused("is also an input", output="link.npz", options=options)


def test_output_without_a_directory(refused, good):
    refused("no such directory", output="nowhere/out.npz")


def test_output_that_is_no_file(refused, tmp_path, good):
    (tmp_path / "out.npz").mkdir()
    refused("out.npz: exists and is not a file", output="out.npz", options=["--force"])
    (tmp_path / "null.npz").symlink_to("/dev/null")
    refused("null.npz: exists and is not a file", output="null.npz", options=["--force"])


def test_output_of_unknown_extension(refused, good):
    refused("out.csv: unknown extension '.csv'", output="out.csv")


@contextmanager
def full_after(size):
    """Lets no file of this process grow beyond size [bytes]: the kernel refuses, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.parametrize("size", [0, 1000, 100_000, 400_000])
@pytest.mark.parametrize("output", ["out.parquet", "out.npz"])
def test_disk_full_by_the_kernel(refused, tmp_path, output, size):
    write_states(tmp_path / "a.npz", 20_000)
    write_contacts(tmp_path / "feet.json")
    with full_after(size):
        refused(
            f"{output}: cannot be written: File too large",
            states="a.npz",
            output=output,
            early=False,
            options=["--batch-size", "2000"],
        )


@pytest.mark.parametrize("output", ["out.parquet", "out.npz"])
def test_disk_full_when_the_data_reach_it(refused, good, monkeypatch, output):
    def full(_descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    refused(f"{output}: cannot be written: No space left on device", output=output, early=False)


# a missing extra


@pytest.mark.parametrize(
    ("package", "importer", "extra"),
    [
        ("pyarrow", "jaxcap.files.parquet", "data"),
        ("tyro", "jaxcap.commands.", "cli"),
        ("tqdm", "jaxcap.commands.", "cli"),
        ("yaml", None, "cli"),
    ],
)
def test_missing_extra(refused, tmp_path, monkeypatch, package, importer, extra):
    write_states(tmp_path / "a.parquet")
    (tmp_path / "feet.yaml").write_bytes(write_contacts(tmp_path / "feet.json").read_bytes())
    monkeypatch.setitem(sys.modules, package, None)
    importers = {importer, "jaxcap.files.arrow_columns"} if package == "pyarrow" else {importer}
    for name in [name for name in sys.modules if importer and name.startswith(tuple(importers))]:
        monkeypatch.delitem(sys.modules, name)
    refused(package, f'pip install "jaxcap[{extra}]"', states="a.parquet", contacts="feet.yaml")


# rows


@pytest.mark.parametrize("output", ["out.parquet", "out.npz"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_bad_row_among_many(tmp_path, capsys, output, bad):
    coms, velocities = states(100)
    reference = fake_score(None, coms.astype(np.float32), velocities.astype(np.float32))
    coms[42, 1] = velocities[77, 2] = bad
    np.savez(tmp_path / "a.npz", com=coms, com_velocity=velocities)
    write_contacts(tmp_path / "feet.json")
    assert main(command(tmp_path / "a.npz", tmp_path / "feet.json", tmp_path / output, "--batch-size", "30")) == 0
    out = read_columns(tmp_path / output)
    rows = np.isin(np.arange(100), [42, 77])
    assert (out["status"][rows] == Status.NONFINITE).all() and (out["case"][rows] == Case.UNDECIDED).all()
    assert not out["capturable"][rows].any() and np.isnan(out["margin"][rows]).all()
    for name in reference._fields:
        np.testing.assert_array_equal(out[name][~rows], getattr(reference, name)[~rows])
    line = next(line for line in capsys.readouterr().out.splitlines() if "nonfinite" in line)
    assert "2" in line.split() and "2.00%" in line.split()
