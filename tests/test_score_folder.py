"""`jaxcap score` of many files: the bytes of one process, whatever ran it and however it was broken off."""

import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from state_files import fake_score, states, vectors, write_contacts, write_states

import jaxcap
import jaxcap.files.folders
from jaxcap.commands.cli import main

FILES = ("a.parquet", "b.parquet", "deep/c.parquet", "deep/d.parquet")


@pytest.fixture
def fake(monkeypatch):
    """Replaces the predictor by a simple rule."""
    monkeypatch.setattr(jaxcap, "score", fake_score)


@pytest.fixture
def folder(tmp_path):
    """A dataset of four files, and what readers of datasets leave out."""
    for number, name in enumerate(FILES):
        file = tmp_path / "in" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        coms, velocities = states(20 + number, number)
        pq.write_table(pa.table({"com": vectors(coms), "com_velocity": vectors(velocities)}), file)
    (tmp_path / "in" / "_SUCCESS").touch()
    (tmp_path / "in" / ".git").mkdir()
    (tmp_path / "in" / ".git" / "config").touch()
    write_contacts(tmp_path / "feet.yaml")
    return tmp_path


def run(folder: Path, *options: str, output: str = "out", given: str | None = None) -> int:
    """The exit code of a run."""
    source = str(folder / "in") if given is None else given
    return main(["score", source, "--contacts", str(folder / "feet.yaml"), "-o", str(folder / output), *options])


def tree(path: Path) -> dict[str, bytes]:
    """All files of a folder."""
    return {file.relative_to(path).as_posix(): file.read_bytes() for file in path.rglob("*") if file.is_file()}


def test_every_file_is_scored_as_if_it_were_alone(fake, folder, capsys):
    assert run(folder) == 0
    assert "out: 4 of 4 files" in capsys.readouterr().out
    for name in FILES:
        alone = folder / "alone.parquet"
        assert run(folder, "--force", output="alone.parquet", given=str(folder / "in" / name)) == 0
        assert alone.read_bytes() == (folder / "out" / name).read_bytes()
    summary = json.loads((folder / "out" / "_SUMMARY.json").read_text())
    assert (summary["files"], summary["states"]) == (4, sum(20 + i for i in range(4)))
    scores = pq.read_table(folder / "out")  # as any reader of datasets does
    assert scores.num_rows == summary["states"] == sum(summary["cases"].values())
    assert summary["capturable"] == int(np.sum(scores["capturable"].to_numpy()))
    margin = np.sort(scores["margin"].to_numpy())
    middle = margin[int(np.ceil(0.5 * np.isfinite(margin).sum())) - 1]
    assert summary["margin_quantiles"]["50%"] == pytest.approx(middle, rel=8e-3)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_shards_make_the_whole(fake, folder, order, capsys):
    assert run(folder, output="whole") == 0
    for number in order:
        assert not (folder / "out" / "_SUMMARY.json").exists()
        assert run(folder, "--shard", f"{number}/3") == 0
    assert tree(folder / "out") == tree(folder / "whole")


def test_what_is_done_is_not_done_again(fake, folder, capsys):
    assert run(folder) == 0
    before = tree(folder / "out")
    times = {name: (folder / "out" / name).stat().st_mtime_ns for name in FILES}
    (folder / "out" / "b.parquet").unlink()
    (folder / "out" / ".jaxcap-dead.tmp").touch()  # of a process that was killed
    capsys.readouterr()
    assert run(folder) == 0
    assert "3 files were there" in capsys.readouterr().out
    assert tree(folder / "out") == before
    now = {name: (folder / "out" / name).stat().st_mtime_ns for name in FILES}
    assert [name for name in FILES if now[name] != times[name]] == ["b.parquet"]


def test_an_interruption_leaves_what_is_done(folder, monkeypatch, capsys):
    calls = []

    def interrupt(*arguments, **options):
        calls.append(0)
        if len(calls) == 3:  # in the third file
            raise KeyboardInterrupt
        return fake_score(*arguments, **options)

    monkeypatch.setattr(jaxcap, "score", interrupt)
    assert run(folder) == 130
    assert sorted(name for name in tree(folder / "out") if name.endswith("parquet")) == ["a.parquet", "b.parquet"]
    assert not (folder / "out" / "_SUMMARY.json").exists()
    assert run(folder) == 0 and len(calls) == 3 + 2
    assert set(FILES) < set(tree(folder / "out"))


def test_a_file_that_fails_leaves_the_others(fake, folder, capsys):
    write_states(folder / "in" / "b.parquet", 10)
    damaged = bytearray((folder / "in" / "b.parquet").read_bytes())
    damaged[20:60] = bytes(40)
    (folder / "in" / "b.parquet").write_bytes(damaged)
    assert run(folder) == 2
    printed = capsys.readouterr()
    assert "failed: number 1, b.parquet: " in printed.err and "1 of 4 files failed" in printed.err
    assert "3 of 4 files, 1 to come" in printed.out
    assert not (folder / "out" / "_SUMMARY.json").exists()


def test_a_full_disk_leaves_what_is_done(fake, folder, capsys):
    """One file does not fit: it is named, the others are done; with more room the same command does it."""
    resource = pytest.importorskip("resource")
    write_states(folder / "in" / "b.parquet", 5000)
    assert run(folder, output="whole") == 0
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    try:
        assert run(folder) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "out/b.parquet: cannot be written: File too large" in capsys.readouterr().err
    assert sorted(name for name in tree(folder / "out") if name.endswith("parquet")) == [n for n in FILES if n[0] != "b"]
    assert not list((folder / "out").rglob("*.tmp"))
    assert run(folder) == 0
    assert "3 files were there" in capsys.readouterr().out and tree(folder / "out") == tree(folder / "whole")


def test_other_settings_and_other_inputs_are_refused(fake, folder, capsys):
    assert run(folder) == 0
    before = tree(folder / "out")
    assert run(folder, "--sides", "8") == 2
    assert "sides 4 there and 8 now" in capsys.readouterr().err
    write_states(folder / "in" / "b.parquet", 7)
    assert run(folder) == 2
    assert "1 files were made from other states, b.parquet for one" in capsys.readouterr().err
    assert tree(folder / "out") == before
    assert run(folder, "--force", "--sides", "8") == 0
    assert pq.read_metadata(folder / "out" / "b.parquet").num_rows == 7


def test_strange_files_are_listed_before_anything_runs(folder, capsys):
    (folder / "in" / "notes.txt").write_text("all of it")
    assert run(folder) == 2
    assert "1 of 5 files cannot be used" in (error := capsys.readouterr().err) and "notes.txt: not .parquet" in error
    write_states(folder / "in" / "b.parquet", 5, more=pa.array(range(5)))
    write_states(folder / "in" / "deep" / "c.parquet", 5, com=None)
    assert run(folder, given=str(folder / "in" / "**" / "*.parquet")) == 2
    error = capsys.readouterr().err
    assert (
        "2 of 4 files" in error and "b.parquet: column 'more' more" in error and "deep/c.parquet: no column 'com'" in error
    )
    assert not (folder / "out").exists()


def bits(table: pa.Table) -> dict[str, bytes]:
    """The numbers of each column, NaN too."""
    flat = {name: table[name].combine_chunks() for name in table.column_names}
    flat = {name: column.flatten() if pa.types.is_fixed_size_list(column.type) else column for name, column in flat.items()}
    return {name: column.to_numpy(zero_copy_only=False).tobytes() for name, column in flat.items()}


@pytest.fixture
def large(tmp_path, monkeypatch):
    """A file of seven row groups, of which two at most make a part."""
    coms, velocities = states(70)
    table = pa.table({"com": vectors(coms), "com_velocity": vectors(velocities), "frame": range(70)})
    pq.write_table(table, tmp_path / "large.parquet", row_group_size=10)
    write_contacts(tmp_path / "feet.yaml")
    monkeypatch.setattr(jaxcap.files.folders, "CUT_ROWS", 25)
    return tmp_path


def test_one_file_is_scored_by_row_groups(fake, large, capsys):
    given = str(large / "large.parquet")
    assert run(large, "--batch-size", "16", output="alone.parquet", given=given) == 0
    alone = pq.read_table(large / "alone.parquet")
    for number in (2, 0, 1):
        assert run(large, "--batch-size", "16", "--shard", f"{number}/3", given=given) == 0
    assert "out: 4 of 4 files" in capsys.readouterr().out
    parts = sorted((large / "out").glob("*.parquet"))
    assert [file.name for file in parts] == [f"part-0000{number}.parquet" for number in range(4)]
    assert [pq.read_metadata(file).num_rows for file in parts] == [20, 20, 20, 10]
    assert bits(pa.concat_tables(map(pq.read_table, parts))) == bits(alone)
    assert json.loads((large / "out" / "_SUMMARY.json").read_text())["states"] == 70
    before = tree(large / "out")
    parts[1].unlink()
    assert run(large, "--batch-size", "16", given=given) == 0
    assert "3 files were there" in capsys.readouterr().out and tree(large / "out") == before


def test_a_part_is_whole_row_groups(fake, large, monkeypatch):
    given = str(large / "large.parquet")
    monkeypatch.setattr(jaxcap.files.folders, "CUT_ROWS", 5)
    assert run(large, given=given) == 0
    assert [pq.read_metadata(large / "out" / f"part-0000{number}.parquet").num_rows for number in range(7)] == [10] * 7
    write_states(large / "none.parquet", 0)
    assert run(large, output="empty", given=str(large / "none.parquet")) == 0
    assert pq.read_metadata(large / "empty" / "part-00000.parquet").num_rows == 0


def test_another_large_file_is_refused(fake, large, capsys):
    assert run(large, given=str(large / "large.parquet")) == 0
    write_states(large / "large.parquet", 30)
    assert run(large, given=str(large / "large.parquet")) == 2
    assert "files were made from other states, part-00000.parquet for one" in capsys.readouterr().err


def test_a_glob_leaves_files_out(fake, folder):
    assert run(folder, given=str(folder / "in" / "**" / "[ac].parquet")) == 0
    assert {"a.parquet", "deep/c.parquet"} == {name for name in tree(folder / "out") if name.endswith("parquet")}


@pytest.mark.parametrize(
    "options, why",
    [
        (["--shard", "3/3"], "--shard 3/3 (expected 0/3 to 2/3"),
        (["--shard", "0/3", "--force"], "--shard 0/3 (expected without --force"),
        (["--jobs", "0"], "--jobs 0 (expected at least 1)"),
        (["--jobs", "2", "--dask", "tcp://here:1"], "--jobs 2 (expected without --dask tcp://here:1"),
        (["--layout", "asap"], "--layout says how a log is read"),
    ],
)
def test_options_that_cannot_be_used(folder, capsys, options, why):
    assert run(folder, *options) == 2
    assert why in capsys.readouterr().err
    assert not (folder / "out").exists()


def test_places_that_cannot_be_used(folder, capsys):
    assert run(folder, output="in/out") == 2
    assert "which is read" in capsys.readouterr().err
    (folder / "out").mkdir()
    (folder / "out" / "thesis.tex").touch()
    assert run(folder) == 2
    assert "no earlier run" in capsys.readouterr().err
    shutil.rmtree(folder / "in")
    (folder / "in").mkdir()
    assert run(folder, output="new") == 2
    assert "no Parquet files" in capsys.readouterr().err


def test_one_file_runs_here(folder, capsys):
    assert run(folder, "--shard", "0/2", output="a.parquet", given=str(folder / "in" / "a.parquet")) == 2
    assert "--shard 0/2 (expected with many Parquet files as STATES, or one and a folder as OUT)" in capsys.readouterr().err
