"""State files in and out: spellings, streaming, columns carried through, metadata, whole or nothing."""

import os
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from state_files import fake_score, leftovers, read_columns, read_metadata, states, vectors, write_states

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.errors import InputError
from jaxcap.files.columns import VECTORS, describe
from jaxcap.files.fields import FIELDS
from jaxcap.files.records import read_states, write_scores
from jaxcap.files.whole_file import whole_file
from jaxcap.one_state.result import Capturability, Case, Status

METADATA = describe(ContactSet(np.zeros((1, 3)), np.eye(3), 0.5), (0, 0, -9.81), 4, np.dtype("float32"))
PAIRS = [(i, o) for i in ("parquet", "npz") for o in ("parquet", "npz")]


def convert(source, target, batch_size=4, dtype=np.float32, **options):
    """Scores a file with the fake predictor."""
    with (
        read_states(source, batch_size, dtype) as file,
        write_scores(target, file.types, METADATA, dtype, **options) as out,
    ):
        for batch in file:
            out.write(batch.columns, fake_score(None, batch.coms, batch.com_velocities))
    return target


def read_all(path, batch_size=4, dtype=np.float64):
    with read_states(path, batch_size, dtype) as file:
        batches = list(file)
    return np.concatenate([b.coms for b in batches]), np.concatenate([b.com_velocities for b in batches])


def split(values, name):
    return {f"{name}_{axis}": values[:, i] for i, axis in enumerate("xyz")}


def parquet_lists(kind):
    return lambda path, *states: pq.write_table(pa.table([vectors(x, kind) for x in states], VECTORS), path)


def npz(change):
    return lambda path, c, v: np.savez(path, com=change(c), com_velocity=change(v))


SPELLINGS = {
    "fixed-size lists.parquet": parquet_lists(pa.list_(pa.float64(), 3)),
    "lists.parquet": parquet_lists(pa.list_(pa.float64())),
    "large lists.parquet": parquet_lists(pa.large_list(pa.float64())),
    "x y z.parquet": lambda path, c, v: pq.write_table(pa.table(split(c, "com") | split(v, "com_velocity")), path),
    "mixed.parquet": lambda path, c, v: pq.write_table(pa.table({"com": vectors(c), **split(v, "com_velocity")}), path),
    "array.npz": npz(lambda x: x),
    "fortran order.npz": npz(np.asfortranarray),
    "big endian.npz": npz(lambda x: x.astype(">f8")),
    "x y z.npz": lambda path, c, v: np.savez(path, **split(c, "com"), **split(v, "com_velocity")),
    "compressed.npz": lambda path, c, v: np.savez_compressed(path, com=np.asfortranarray(c), com_velocity=v),
    "upper case.NPZ": lambda path, c, v: np.savez(path.open("wb"), com=c, com_velocity=v),
}


@pytest.mark.parametrize("name", SPELLINGS)
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_every_spelling_reads_the_same(tmp_path, name):
    coms, velocities = states(11)
    SPELLINGS[name](tmp_path / name, coms, velocities)
    read = read_all(tmp_path / name)
    np.testing.assert_array_equal(read[0], coms)
    np.testing.assert_array_equal(read[1], velocities)


@pytest.mark.parametrize("extension", ["parquet", "npz"])
@pytest.mark.parametrize("kind", ["float16", "float32", "float64", "int8", "uint16", "int64"])
def test_floats_and_integers_are_numbers(tmp_path, extension, kind):
    whole = np.array([[0, 0, 1], [3, 2, 1]], dtype=kind)
    columns = split(whole, "com") | split(whole, "com_velocity")
    path = tmp_path / f"states.{extension}"
    np.savez(path, **columns) if extension == "npz" else pq.write_table(pa.table(columns), path)
    np.testing.assert_array_equal(read_all(path)[0], [[0, 0, 1], [3, 2, 1]])


@pytest.mark.parametrize("kind", [pa.list_(pa.float64(), 3), pa.list_(pa.float32()), pa.list_(pa.int32(), 3)])
def test_nulls_are_nan(tmp_path, kind):
    column = pa.array([[1, 2, 3], None, [4, None, 6]], kind)
    columns = {"com": column, **{f"com_velocity_{axis}": pa.array([1, 2, None]) for axis in "xyz"}}
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    coms, velocities = read_all(tmp_path / "a.parquet")
    np.testing.assert_array_equal(coms, [[1, 2, 3], [np.nan] * 3, [4, np.nan, 6]])
    np.testing.assert_array_equal(velocities[:, 0], [1, 2, np.nan])


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_too_large_for_float32_is_infinite(tmp_path, extension):
    values = np.array([[0, 0, 1e300], [0, 0, 1]])
    write_states(tmp_path / f"a.{extension}", 2, com=vectors(values) if extension == "parquet" else values)
    assert np.isinf(read_all(tmp_path / f"a.{extension}", dtype=np.float32)[0][0, 2])


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_batches_have_the_size_asked_for_and_the_count_is_known(tmp_path, extension):
    path = write_states(tmp_path / f"states.{extension}", 1000)
    with read_states(path, 300) as file:
        assert file.rows == 1000
        assert [len(batch.coms) for batch in file] == [300, 300, 300, 100]
        assert all(batch.coms.dtype == np.float32 for batch in file)


def test_batches_do_not_follow_row_groups(tmp_path):
    coms, velocities = states(1000)
    label = pa.array(["a", "b"] * 500).dictionary_encode()  # Arrow ends a batch of such a column at each row group
    pq.write_table(
        pa.table({"com": vectors(coms), "com_velocity": vectors(velocities), "label": label}),
        tmp_path / "a.parquet",
        row_group_size=70,
    )
    with read_states(tmp_path / "a.parquet", 256, np.float64) as file:
        batches = list(file)
    assert [len(batch.coms) for batch in batches] == [256, 256, 256, 232]
    np.testing.assert_array_equal(np.concatenate([batch.coms for batch in batches]), coms)
    assert [x for batch in batches for x in batch.columns["label"].to_pylist()] == ["a", "b"] * 500


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_an_npz_is_never_read_at_once(tmp_path, monkeypatch, save):
    coms, velocities = states(50_000)
    save(tmp_path / "a.npz", com=coms, com_velocity=np.asfortranarray(velocities))
    sizes, read = [], zipfile.ZipExtFile.read
    monkeypatch.setattr(zipfile.ZipExtFile, "read", lambda self, n=-1: sizes.append(n) or read(self, n))
    with read_states(tmp_path / "a.npz", 500) as file:
        for batch in file:
            assert len(batch.coms) == 500
    pieces = [n for n in sizes if n != -1]
    assert len(pieces) == len(sizes) >= 400
    assert sorted(set(pieces))[-1] <= zipfile.ZipExtFile.MAX_SEEK_READ


def test_reading_parquet_is_lazy(tmp_path):
    path = write_states(tmp_path / "a.parquet", 100)
    with read_states(path, 10) as file:
        first = next(iter(file))
    assert len(first.coms) == 10


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_other_columns_are_carried_through(tmp_path, source, target):
    n = 10
    others = {
        "name": np.array(["walk", "a much longer name", "ä", ""] * 3)[:n],
        "step": np.arange(n),
        "fallen": np.arange(n) % 3 == 0,
        "q": np.arange(5.0 * n).reshape(n, 5),
        "stamp": np.arange(n).astype("M8[us]"),
        "inertia": np.arange(9 * n, dtype=np.float32).reshape(n, 3, 3),
    }
    written = dict(others)
    if source == "parquet":
        written["q"] = pa.array(others["q"].tolist(), pa.list_(pa.float64(), 5))
        written["inertia"] = pa.array(others["inertia"].tolist(), pa.list_(pa.list_(pa.float32(), 3), 3))
    path = write_states(tmp_path / f"states.{source}", n, **written)
    columns = read_columns(convert(path, tmp_path / f"out.{target}"))
    assert list(columns) == ["com", "com_velocity", *others, *FIELDS]
    for name, values in others.items():
        np.testing.assert_array_equal(columns[name], values)
        if target == "npz":
            assert columns[name].dtype.kind == values.dtype.kind
    np.testing.assert_array_equal(columns["com"], states(n)[0])  # in its own precision, not that of the computation


def test_parquet_columns_of_any_type_stay_what_they_are(tmp_path):
    others = pa.table(
        {
            "maybe": pa.array([1, None, 3]),
            "tags": pa.array([["a"], [], None]),
            "pose": pa.array([{"x": 1.0}, {"x": 2.0}, None]),
            "label": pa.array(["u", None, "u"]).dictionary_encode(),
            "raw": pa.array([b"\0", b"", None]),
            "when": pa.array([0, 1, 2], pa.timestamp("us", "Europe/Paris")),
        }
    )
    path = write_states(tmp_path / "a.parquet", 3, **{name: others[name] for name in others.column_names})
    written = pq.read_table(convert(path, tmp_path / "out.parquet", batch_size=2))
    assert written.select(others.column_names).to_pylist() == others.to_pylist()
    assert [written.schema.field(n).type for n in others.column_names] == others.schema.types


def test_null_floats_and_times_become_nan_and_nat_in_npz(tmp_path):
    columns = {
        "speed": pa.array([1.0, None]),
        "day": pa.array([0, None], pa.date32()),
        "pair": pa.array([None, [1.0, 2.0]], pa.list_(pa.float64(), 2)),
    }
    out = read_columns(convert(write_states(tmp_path / "a.parquet", 2, **columns), tmp_path / "out.npz"))
    np.testing.assert_array_equal(out["speed"], [1, np.nan])
    np.testing.assert_array_equal(out["pair"], [[np.nan, np.nan], [1, 2]])
    assert np.isnat(out["day"][1]) and out["day"].dtype == "M8[D]"


def test_npz_arrays_that_are_no_columns_are_named(tmp_path):
    others = {"dt": np.array(0.01), "joints": np.array(["hip", "knee"]), "empty": np.zeros((5, 0))}
    path = write_states(tmp_path / "a.npz", 5, **others)
    with read_states(path, 4) as file:
        assert file.skipped == list(others)
    assert not set(others) & set(read_columns(convert(path, tmp_path / "out.npz")))


@pytest.mark.parametrize(("source", "target"), PAIRS)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_output_holds_every_field_in_its_type(tmp_path, source, target, dtype):
    path = write_states(tmp_path / f"a.{source}", 10)
    out = convert(path, tmp_path / f"out.{target}", dtype=np.dtype(dtype))
    expected = fake_score(None, *(x.astype(dtype) for x in states(10)))
    columns = read_columns(out)
    for name in FIELDS:
        np.testing.assert_array_equal(columns[name], getattr(expected, name))
    kinds = {"capturable": "bool", "case": "int8", "status": "int8"}
    for name in FIELDS:
        if target == "npz":
            assert columns[name].dtype == kinds.get(name, dtype)
        else:
            arrow = {"bool": "bool", "int8": "int8", "float32": "float", "float64": "double"}[kinds.get(name, dtype)]
            assert str(pq.read_schema(out).field(name).type) == arrow


@pytest.mark.parametrize(("source", "target"), PAIRS)
@pytest.mark.parametrize("extra", [True, False])
def test_zero_rows(tmp_path, source, target, extra):
    columns = {"name": np.array([], dtype=str)} if extra else {}
    path = write_states(tmp_path / f"a.{source}", 0, **columns)
    out = read_columns(convert(path, tmp_path / f"out.{target}"))
    assert set(out) == {"com", "com_velocity", *columns, *FIELDS}
    assert all(len(column) == 0 for column in out.values())
    if target == "npz":
        assert out["com"].shape == (0, 3) and out["margin"].dtype == np.float32


def test_the_fields_are_those_of_the_result():
    assert tuple(FIELDS) == Capturability._fields


@pytest.mark.parametrize("target", ["parquet", "npz"])
def test_metadata_explains_the_file(tmp_path, target):
    metadata = read_metadata(convert(write_states(tmp_path / "a.npz", 3), tmp_path / f"out.{target}"))
    assert metadata["written_by"].startswith("jaxcap ")
    assert metadata["case"] == {case.name: int(case) for case in Case}
    assert metadata["status"] == {status.name.lower(): int(status) for status in Status}
    assert metadata["units"]["margin"] == "m/s" and set(FIELDS) <= set(metadata["units"])
    assert metadata["gravity"] == [0, 0, -9.81] and metadata["sides"] == 4 and metadata["dtype"] == "float32"
    assert metadata["contacts"] == {"points": [[0, 0, 0]], "frames": [np.eye(3).tolist()], "friction": [0.5]}
    assert "z up" in metadata["conventions"]


def test_parquet_fields_carry_unit_and_names(tmp_path):
    schema = pq.read_schema(convert(write_states(tmp_path / "a.npz", 3), tmp_path / "out.parquet"))
    assert schema.field("margin").metadata[b"unit"] == b"m/s"
    assert b'"nonfinite": 4' in schema.field("status").metadata[b"names"]


def test_small_batches_make_no_small_row_groups(tmp_path):
    path = write_states(tmp_path / "a.npz", 1000)
    assert pq.ParquetFile(convert(path, tmp_path / "out.parquet", batch_size=10)).num_row_groups == 1


def test_only_what_repeats_is_written_by_dictionary(tmp_path):
    more = {"word": pa.array(["left"] * 9), "at": pa.array([[{"x": 1.5}]] * 9), "friction": pa.array([0.5] * 9)}
    group = pq.read_metadata(convert(write_states(tmp_path / "a.parquet", 9, **more), tmp_path / "out.parquet")).row_group(0)
    columns = [group.column(i) for i in range(group.num_columns)]
    found = {column.path_in_schema.split(".")[0] for column in columns if "RLE_DICTIONARY" in column.encodings}
    assert found >= {"word", "at", "friction", "case"} and not found & {"com", "com_velocity", "margin", "time", "effort"}


@pytest.mark.parametrize("target", ["parquet", "npz"])
def test_an_error_leaves_nothing(tmp_path, target):
    path = write_states(tmp_path / "a.npz", 10)
    with (
        pytest.raises(ZeroDivisionError),
        read_states(path, 4) as file,
        write_scores(tmp_path / f"out.{target}", file.types, METADATA) as out,
    ):
        for batch in file:
            out.write(batch.columns, fake_score(None, batch.coms, batch.com_velocities))
            raise ZeroDivisionError
    assert os.listdir(tmp_path) == ["a.npz"]


@pytest.mark.parametrize("target", ["parquet", "npz"])
def test_an_error_leaves_the_old_file(tmp_path, target):
    old = tmp_path / f"out.{target}"
    old.write_text("old")
    with pytest.raises(KeyboardInterrupt), write_scores(old, {}, METADATA, force=True):
        raise KeyboardInterrupt
    assert old.read_text() == "old" and not leftovers(tmp_path)


def test_a_file_written_in_the_meantime_is_kept(tmp_path):
    with pytest.raises(InputError, match="in the meantime"), whole_file(tmp_path / "out", force=False):
        (tmp_path / "out").write_text("another's")
    assert (tmp_path / "out").read_text() == "another's"


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "out.npz").symlink_to(tmp_path / "real" / "scores.npz")
    convert(write_states(tmp_path / "a.npz", 3), tmp_path / "out.npz")
    assert (tmp_path / "out.npz").is_symlink() and (tmp_path / "real" / "scores.npz").is_file()


def test_permissions_follow_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        out = convert(write_states(tmp_path / "a.npz", 3), tmp_path / "out.npz")
    finally:
        os.umask(before)
    assert out.stat().st_mode & 0o777 == 0o640
