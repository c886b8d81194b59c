"""The table about a campaign's file counts what its rows say: `reference.tsid.summary`."""

import pytest

from reference.tsid import campaign, summary
from reference.tsid.labels import BEST_OF_FOUR, labeller
from reference.tsid.robot import load
from reference.tsid.table import write


def written(path, *more, samples=3):
    """A file of samples of `two`, runs cut off after 20 ms; the last row is that of a failure. Returns its rows too."""
    arguments = ["two", "--samples", str(samples), "-o", str(path), "--seed", "3", "--set", "time_limit=0.02", *more]
    settings = campaign.settings_of(campaign._parse(arguments))
    label = labeller(settings, "talos")
    rows = [*map(label, range(samples)), {"index": samples, "error": "ArithmeticError: none"}]
    model = load("talos").model
    write(path, settings, [{"numpy": "2"}], rows, model.nq, model.nv)
    return rows


@pytest.fixture(scope="module")
def best(tmp_path_factory):
    path = tmp_path_factory.mktemp("best") / "two.parquet"
    return path, written(path)


def test_summary_counts_every_run_once(best):
    path, rows = best
    about, *lines = summary.lines(path)
    assert "4 samples, 1 errors" in about and "seed 3" in about and "best of four: " in about
    assert f"{sum(row['effort'] <= 1 for row in rows[:3])} of 3 can be held" in about
    for controller, line in zip(BEST_OF_FOUR, lines, strict=False):
        name, its, ran, *cells = line.split()
        reasons = [row[f"{controller}_reason"] for row in rows if f"{controller}_reason" in row]
        assert (name, its, int(ran)) == ("two", controller, len(reasons))
        assert [int(cell) for cell in cells[:5]] == [reasons.count(reason) for reason in summary.REASONS]
        assert sum(map(int, cells[:5])) == len(reasons)
    assert lines[-1] == "two.parquet: sample 3: ArithmeticError: none"


def test_a_dip_changes_the_label_of_what_did_not_stop(tmp_path):
    """The row of a failure has no label, what stopped keeps its own, and a dip under "brake" is one of the best of four."""
    path = tmp_path / "two.parquet"
    options = ["two", "--samples", "5", "-o", str(path), "--seed", "3", "--set", "dwell=0.2"]
    settings = campaign.settings_of(campaign._parse(options))
    found = [("fallen", "fallen", {}), ("fallen", "stopped", {"fast_dips": 1}), ("stopped", "stopped", {"standard_dips": 1})]
    found += [("undecided", "undecided", dips) for dips in ({"brake_dips": 2}, {"standard_dips": 1, "fast_dips": 1})]
    rows = [{"outcome": three, "best_of_four": four} | dips for three, four, dips in found] + [{"error": "none"}]
    dwell = "stops changed by the dwell of 0.2 s"
    assert summary._changed(settings._asdict(), rows) == [
        f"outcome: 2 {dwell} (1 fallen, 1 undecided)",
        f"best_of_four: 2 {dwell} (2 undecided)",
    ]
    assert summary._changed(settings._asdict() | {"options": {"dwell": 0.0}}, rows) == []


def test_summary_of_a_folder(best, capsys, tmp_path):
    assert summary.main([str(best[0].parent)]) == 0
    assert "1 files" in capsys.readouterr().out
    (tmp_path / "other.parquet").write_bytes(b"nothing")
    assert summary.main([str(tmp_path)]) == 1
    assert "other.parquet: not the file of a campaign" in capsys.readouterr().err
