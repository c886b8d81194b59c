"""The tables about a campaign's file count what its rows say: `reference.tsid.summary` and `bench.verdicts`."""

import numpy as np
import pytest

from bench import verdicts
from reference.tsid import campaign, summary
from reference.tsid.labels import labeller
from reference.tsid.robot import load
from reference.tsid.table import write

OUTCOMES = np.array(["fallen", "fallen", "stopped", "undecided", "stopped", "fallen", "stopped"])
CAPTURABLE = np.array([False, True, True, True, False, False, True])
MARGIN = np.array([-0.5, 0.2, 0.3, 9.0, -0.1, -np.inf, np.inf])


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
    assert "4 samples, 1 errors" in about and "seed 3" in about
    for controller, line in zip(campaign.BEST_OF_THREE, lines, strict=False):
        name, its, ran, *cells = line.split()
        reasons = [row[f"{controller}_reason"] for row in rows if f"{controller}_reason" in row]
        assert (name, its, int(ran)) == ("two", controller, len(reasons))
        assert [int(cell) for cell in cells[:5]] == [reasons.count(reason) for reason in summary.REASONS]
        assert sum(map(int, cells[:5])) == len(reasons)
    assert lines[-1] == "two.parquet: sample 3: ArithmeticError: none"


def test_summary_of_a_folder(best, capsys, tmp_path):
    assert summary.main([str(best[0].parent)]) == 0
    assert "1 files" in capsys.readouterr().out
    (tmp_path / "other.parquet").write_bytes(b"nothing")
    assert summary.main([str(tmp_path)]) == 1
    assert "other.parquet: not the file of a campaign" in capsys.readouterr().err


def test_the_four_cells_hold_every_sample_once():
    cells = verdicts.count(OUTCOMES, CAPTURABLE)
    assert cells == verdicts.Counts(detected=2, missed=1, false=1, right=2, undecided=1)
    assert sum(cells) == len(OUTCOMES)


def test_area_under_roc_is_the_share_of_ordered_pairs():
    pairs = [(s > f) + 0.5 * (s == f) for s in MARGIN[OUTCOMES == "stopped"] for f in MARGIN[OUTCOMES == "fallen"]]
    assert verdicts.area_under_roc(MARGIN, OUTCOMES) == pytest.approx(np.mean(pairs))
    assert verdicts.area_under_roc(-MARGIN, OUTCOMES) == pytest.approx(1 - np.mean(pairs))
    assert verdicts.area_under_roc(np.zeros(7), OUTCOMES) == 0.5
    assert np.isnan(verdicts.area_under_roc(MARGIN[:2], OUTCOMES[:2]))


def test_wilson_interval():
    assert verdicts.interval(0, 0) == (0.0, 1.0)
    low, high = verdicts.interval(0, 10)
    assert low == pytest.approx(0.0, abs=1e-12) and high == pytest.approx(0.2775, abs=1e-4)  # tabulated
    for hits in range(11):
        low, high = verdicts.interval(hits, 10)
        assert low - 1e-12 <= hits / 10 <= high + 1e-12
        other = verdicts.interval(10 - hits, 10)
        assert (low, high) == pytest.approx((1 - other[1], 1 - other[0]))


def test_verdicts_of_a_file(best):
    path, rows = best
    (line,) = verdicts.lines(path, None)
    (
        name,
        *_,
    ) = line.split()
    cells = [int(cell) for cell in line.removeprefix(f"{'two':22}{'best of 3':22}").split()[:5]]
    assert name == "two" and sum(cells) == len(rows)
    outcomes = [row.get("outcome") for row in rows]
    assert cells[0] + cells[1] == outcomes.count("fallen") and cells[2] + cells[3] == outcomes.count("stopped")


def test_a_line_for_each_controller_where_all_ran(tmp_path):
    written(tmp_path / "all.parquet", "--all", "--controllers", "standard", "no_limits", samples=2)
    first, second = verdicts.lines(tmp_path / "all.parquet", 2)
    assert first.split()[:2] == ["all", "standard"] and second.split()[:2] == ["all", "no_limits"]
    assert " of " in second
