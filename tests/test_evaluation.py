"""`python -m reference.evaluation`: samples, margins by the program `jaxcap`, files that are written, the whole command."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from reference.algorithm import is_state_capturable
from reference.evaluation import __main__ as command
from reference.evaluation import figure_style, findings, margins, output, paper, roc_figures, tables
from reference.evaluation.samples import BEST, FILES, FOUR, MissingFile, among, read, read_all
from reference.tsid import campaign, table
from reference.tsid.labels import BEST_OF_FOUR, Settings
from reference.tsid.robot import Contact
from reference.tsid.sampling import SCENARIOS
from reference.tsid.wrench_cone import corner_points

DATA = Path("reference/tsid/data")
FIRST = 40


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """First samples of the committed files; of `three` also as if two controllers had run on all but one, which failed."""
    folder = tmp_path_factory.mktemp("data")
    for name in SCENARIOS:
        settings, versions, rows = table.read(DATA / f"{name}.parquet")
        settings = Settings(**settings)._replace(controllers=tuple(settings["controllers"]))
        table.write(folder / f"{name}.parquet", settings, versions, rows[:FIRST], 37, 36)
        if name == "three":
            rows = [_twice(row) for row in rows[:FIRST]] + [{"index": FIRST, "error": "ArithmeticError: none"}]
            both = settings._replace(every=True, controllers=("standard", "no_torque"))
            table.write(folder / "three_ablations.parquet", both, versions, rows, 37, 36)
    return folder


def _twice(row):
    """The standard controller's run under two names, falls of even samples turned into stops under the other."""
    others = ("straight", "fast", "brake", "outcome", "best_of_four")
    kept = {key: value for key, value in row.items() if not key.startswith(others)}
    other = {key.replace("standard", "no_torque"): value for key, value in kept.items() if key.startswith("standard")}
    if row["index"] % 2 == 0:
        other["no_torque_outcome"] = "stopped"
    return kept | other


@pytest.fixture
def without_jaxcap(monkeypatch):
    """Scores of a stand-in that costs nothing: the margin is that of a limit on the speed. Returns the options it got."""
    calls = []

    def run(columns, destination, options):
        calls.append(options)
        speed = np.linalg.norm(columns["com_velocity"], axis=1)
        n = len(speed)
        numbers = {name: 0.5 - speed for name in ("margin", "paper_margin", "capture_point_support", "capture_point_hull")}
        names = {"case": np.zeros(n, np.int8), "status": np.zeros(n, np.int8), "capturable": speed <= 0.5}
        codes = b'{"case": {"C1": 0}, "status": {"ok": 0, "no_direction": 1, "max_steps": 2}}'
        pq.write_table(pa.table(numbers | names).replace_schema_metadata({b"jaxcap": codes}), destination)

    monkeypatch.setattr(margins, "_run", run)
    return calls


def test_the_evaluation_never_imports_jaxcap():
    code = "import sys, reference.evaluation.__main__; sys.exit(any(name.split('.')[0] == 'jaxcap' for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_samples_hold_the_rows(data):
    rows = table.read(data / "three.parquet")[2]
    samples = read(data / "three.parquet")
    assert samples.outcomes[BEST].tolist() == [row["outcome"] for row in rows] and samples.scenario == "three"
    assert samples.outcomes[FOUR].tolist() == [row["best_of_four"] for row in rows]
    assert list(samples.outcomes) == [BEST, FOUR, "standard"] and list(samples.runs) == list(BEST_OF_FOUR)
    for name in ("q", "v", "com", "com_velocity", "angular_momentum", "effort"):
        np.testing.assert_array_equal(getattr(samples, name), [row[name] for row in rows])
    ran = ["fast_outcome" in row for row in rows]
    assert (samples.runs["fast"].outcomes != "").tolist() == ran
    assert np.isfinite(samples.runs["fast"].times).tolist() == ran
    steps = [row["standard_steps"] for row in rows]
    assert samples.runs["standard"].times == pytest.approx(1e-3 * np.array(steps))
    for contacts, row in zip(zip(*samples.contacts, strict=True), rows, strict=True):
        effectors, positions, rotations, lengths, _, friction = contacts
        assert effectors.tolist() == [contact["effector"] for contact in row["contacts"]]
        np.testing.assert_array_equal(positions, [contact["position"] for contact in row["contacts"]])
        for rotation, contact in zip(rotations, row["contacts"], strict=True):
            expected = pin.Quaternion(np.array(contact["quaternion"])).normalized().toRotationMatrix()
            np.testing.assert_allclose(rotation, expected, atol=1e-12)
        assert lengths[0] == 0.105 and set(friction) == {0.5}


def test_rows_without_states_are_read(data, tmp_path):
    settings, versions, rows = table.read(data / "two.parquet")
    bare = [{key: value for key, value in row.items() if key not in "qv" or row["index"] < 2} for row in rows]
    settings = Settings(**settings)._replace(controllers=tuple(settings["controllers"]), states=2)
    table.write(tmp_path / "two.parquet", settings, versions, bare, 37, 36)
    samples, whole = read(tmp_path / "two.parquet"), read(data / "two.parquet")
    for found, expected in ((samples.q, whole.q), (samples.v, whole.v)):
        assert np.isnan(found[2:]).all() and np.array_equal(found[:2], expected[:2])
    np.testing.assert_array_equal(samples.com, whole.com)


def test_the_files_are_small():
    """What is committed holds at most 45 MB in all, also at 40,000 samples a scenario."""
    paths = sorted(DATA.glob("*.parquet"))
    assert {path.stem for path in paths} >= set(SCENARIOS)
    assert sum(path.stat().st_size for path in paths) < 45e6


def test_failed_rows_are_counted_and_left_out(data):
    samples = read(data / "three_ablations.parquet")
    assert samples.failed == 1 and len(samples.index) == FIRST and BEST not in samples.outcomes


def test_first_samples(data):
    assert read(data / "two.parquet", 3).index.tolist() == [0, 1, 2]


def test_a_file_without_results_is_refused(data, tmp_path):
    settings, versions, _ = table.read(data / "two.parquet")
    settings = Settings(**settings)._replace(controllers=("standard",))
    table.write(tmp_path / "two.parquet", settings, versions, [{"index": 0, "error": "none"}], 37, 36)
    with pytest.raises(table.Unreadable, match="none of its 1 rows holds a result"):
        read(tmp_path / "two.parquet")


def test_files_of_any_name_are_read(data, tmp_path):
    (tmp_path / "mine.parquet").symlink_to(data / "two.parquet")
    (tmp_path / "two.parquet").symlink_to(data / "two.parquet")
    assert list(read_all(tmp_path, 2)) == ["two", "mine"]


def test_a_missing_file_says_what_makes_it(data):
    samples = read_all(data)
    assert list(samples) == [*SCENARIOS, "three_ablations"]
    with pytest.raises(MissingFile, match=r"reference.tsid.campaign two -o two_ablations.parquet .* --all --controllers"):
        among(samples, "two_ablations")


@pytest.mark.parametrize("name", FILES)
def test_the_command_of_a_missing_file_is_one(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MissingFile) as missing:
        among({}, name)
    arguments = str(missing.value).split("reference.tsid.campaign ")[1].split()
    assert campaign.settings_of(campaign._parse(arguments)).zero_momentum == name.endswith("zero_momentum")


def test_scores_agree_with_the_papers_algorithm(data, tmp_path, monkeypatch):
    monkeypatch.setattr(margins, "OPTIONS", ("--dtype", "float64"))  # the capture point's take long to compile
    samples = read(data / "two.parquet", 10)
    scores = margins.score(samples, tmp_path)
    points, frames, friction = margins.corners(samples.contacts)
    for row in range(10):
        state = points[row], frames[row], friction[row], samples.com[row], samples.com_velocity[row]
        assert is_state_capturable(*state).capturable == scores["capturable"][row] == (scores["margin"][row] >= 0)
    assert 0 < scores["capturable"].sum() < 10 and set(scores["status"]) == {"ok"}
    np.testing.assert_array_equal(scores["com"], samples.com)


def test_corners_are_those_of_the_simulator(data):
    samples = read(data / "three.parquet", 5)
    points, frames, friction = margins.corners(samples.contacts)
    for row in range(5):
        effectors, positions, rotations, lengths, widths, mu = (part[row] for part in samples.contacts)
        for k, effector in enumerate(effectors):
            placement = pin.SE3(rotations[k], positions[k])
            expected = corner_points(Contact(str(effector), placement, lengths[k], widths[k], mu[k]))
            own = slice(4 * k, 4 * k + 4)
            np.testing.assert_allclose(points[row, own], expected, atol=1e-14)
            assert (frames[row, own] == rotations[k]).all() and (friction[row, own] == mu[k]).all()


def test_scores_are_kept_for_the_same_data_only(data, tmp_path, without_jaxcap):
    two, shorter = read(data / "two.parquet"), read(data / "two.parquet", 3)
    first = margins.score(two, tmp_path)
    np.testing.assert_array_equal(margins.score(two, tmp_path)["margin"], first["margin"])
    assert len(without_jaxcap) == 1
    margins.score(two, tmp_path, "--height", "0.7")
    margins.score(shorter, tmp_path)
    margins.score(two._replace(com=two.com + 1e-9), tmp_path)
    assert len(without_jaxcap) == 4 and without_jaxcap[1][-2:] == ("--height", "0.7")


def test_what_jaxcap_refuses_is_told(data, tmp_path):
    with pytest.raises(margins.NotScored, match=r"(?s)exit code 2: .*no-such-option"):
        margins.score(read(data / "two.parquet", 2), tmp_path, "--no-such-option")
    assert not list((tmp_path / "scores").glob("*.parquet"))


def test_states_at_rest_have_a_verdict_for_a_margin(data, tmp_path, monkeypatch):
    samples = read(data / "two.parquet", 3)
    scores = {margin.column: np.array([0.5, np.nan, np.nan]) for margin in margins.MARGINS}
    scores |= {"status": np.array(["ok", "no_direction", "no_direction"]), "capturable": np.array([True, True, False])}
    monkeypatch.setattr(margins, "score", lambda *_: scores)
    found = margins.compared(samples, tmp_path)
    assert found["margin"].tolist() == found["paper_margin"].tolist() == [0.5, np.inf, -np.inf]
    assert margins.everywhere(found).tolist() == [True, False, False]
    scores["status"][2] = "max_steps"
    with pytest.raises(margins.NotScored, match="1 states have the status max_steps"):
        margins.compared(samples, tmp_path)


def test_foreign_files_are_not_overwritten(tmp_path):
    path = tmp_path / "figure.pdf"
    output.write(path, b"one")
    output.write(path, b"two")
    assert path.read_bytes() == b"two"
    path.write_bytes(b"edited")
    with pytest.raises(output.Foreign, match=r"figure.pdf: was not written by this command"):
        output.write(path, b"three")
    assert path.read_bytes() == b"edited" and sorted(p.name for p in tmp_path.iterdir()) == ["figure.pdf", output.LIST]


def test_a_write_that_was_cut_off_is_continued(tmp_path, monkeypatch):
    path, replace = tmp_path / "figure.pdf", output._replace
    output.write(path, b"one")
    monkeypatch.setattr(output, "_replace", lambda target, content: target == path or replace(target, content))
    output.write(path, b"two")  # killed between list and file
    output.write(path, b"again")
    monkeypatch.undo()
    output.write(path, b"three")
    assert path.read_bytes() == b"three"


def test_the_text_of_the_paper():
    names = [(name, controller) for name, controller in paper.STATED if name in FILES]
    assert len(names) == len(paper.STATED)
    assert paper.STATED["three_ablations", "no_position_torque"] == (0.81, 0.04)
    assert set(paper.FALSE_ALARMS) <= {stated.false_alarms for stated in paper.STATED.values()}


def test_lines_of_a_picture_are_told_apart():
    strokes = figure_style.STROKES
    assert len(set(strokes)) == len(strokes) >= max(len(roc_figures.LIMITS), len(margins.MARGINS))
    assert len({stroke.linestyle for stroke in strokes[: len(margins.MARGINS)]}) == len(margins.MARGINS)  # in grey


def test_tables_of_one_outcome(data, tmp_path, without_jaxcap):
    two = read(data / "two.parquet")
    for outcome in ("fallen", "stopped", "undecided"):
        one = two._replace(outcomes={BEST: np.full(FIRST, outcome)})
        for make in (tables.beside_the_paper, tables.five_margins, tables.undecided_either_way, findings.order):
            assert "| -" in make({"two": one}, tmp_path) or make is findings.order
        assert len(roc_figures.five_margins({"two": one}, tmp_path)) == 2


def test_the_tables_count_every_sample(data, tmp_path, without_jaxcap):
    samples = read_all(data)
    lines = [line.split(" | ") for line in tables.beside_the_paper(samples, tmp_path).splitlines()[2:]]
    for line in lines:
        assert sum(int(cell) for cell in line[2:6]) + int(line[6].split()[0]) == FIRST
        assert ("failed" in line[6]) == (line[0] == "| three_ablations")


def test_what_another_controller_saves(data, tmp_path, without_jaxcap):
    samples = read(data / "three_ablations.parquet")
    fell, slow = samples.outcomes["standard"] == "fallen", margins.score(samples, tmp_path)["margin"] >= 0
    saved = fell & slow & (samples.outcomes["no_torque"] == "stopped")
    (line,) = tables.other_controllers({"three_ablations": samples}, tmp_path).splitlines()[2:]
    assert f"| three_ablations | no_torque | {saved.sum()} of {(fell & slow).sum()} |" in line
    assert 0 < saved.sum() < (fell & slow).sum()


def test_the_whole_command(data, tmp_path, without_jaxcap, monkeypatch, capsys):
    own = {name: command.FIGURES[name] for name in ("figure_4", "figure_5", "figure_6", "figure_9")}
    others = {name: lambda *_: [] for name in command.FIGURES if name not in own}
    monkeypatch.setattr(command, "FIGURES", own | others)
    folder = tmp_path / "evaluation"
    arguments = ["--data", str(data), "-o", str(folder), "--first", "20"]
    assert command.main(arguments) == 0
    text = (folder / "evaluation.md").read_text(encoding="utf-8")
    written = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    assert {f"{name}.{kind}" for name in own for kind in ("pdf", "png")} < set(written)
    assert all(f"## {section.title}" in text for section in command.SECTIONS) and "nan" not in text
    assert "figure" in capsys.readouterr().out
    assert command.main(arguments) == 0
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == written
    (folder / "figure_9.png").write_bytes(b"mine")
    assert command.main(arguments) == 1 and "figure_9.png" in capsys.readouterr().err


def test_a_figure_that_fails_is_named_and_the_others_are_made(data, tmp_path, without_jaxcap, monkeypatch, capsys):
    def broken(*_):
        raise ZeroDivisionError("no such luck")

    others = {name: lambda *_: [] for name in command.FIGURES}
    monkeypatch.setattr(command, "FIGURES", others | {"figure_5": broken, "figure_4": roc_figures.five_margins})
    assert command.main(["--data", str(data), "-o", str(tmp_path / "out"), "--first", "20"]) == 1
    text, told = (tmp_path / "out" / "evaluation.md").read_text(encoding="utf-8"), capsys.readouterr()
    assert "figure_5 failed: ZeroDivisionError: no such luck" in text and (tmp_path / "out" / "figure_4.pdf").exists()
    assert "incomplete, failed: figure_5" in told.err
    assert told.out.startswith(f"reading {data / 'two_coplanar.parquet'} ...\n")


@pytest.mark.parametrize(
    "module, package, extra",
    [("reference.evaluation", "sklearn", "evaluation"), ("reference.tsid.campaign", "tqdm", "sim")],
)
def test_a_missing_extra_is_named_in_one_line(module, package, extra):
    block = f"import sys; sys.modules[{package!r}] = None; import runpy; runpy.run_module({module!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", block], capture_output=True, text=True)
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr == f'{package} is not installed; it comes with the extra {extra}: pip install -e ".[{extra}]"\n'


def test_files_that_are_missing_are_skipped_aloud(data, tmp_path, without_jaxcap, monkeypatch, capsys):
    monkeypatch.setattr(command, "FIGURES", {name: roc_figures.without_limits for name in command.FIGURES})
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "two.parquet").symlink_to(data / "two.parquet")
    assert command.main(["--data", str(tmp_path / "data"), "-o", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().err
    assert "skipped figure_5: no three_ablations.parquet, made by: python -m reference.tsid.campaign three" in told
    assert "is skipped" in (tmp_path / "out" / "evaluation.md").read_text(encoding="utf-8")


def test_wrong_use(tmp_path, capsys):
    for arguments, told in ((["--first", "0"], "at least 1"), (["--data", str(tmp_path)], "no file of a campaign")):
        with pytest.raises(SystemExit) as stop:
            command.main(arguments)
        assert stop.value.code == 2 and told in capsys.readouterr().err
    (tmp_path / "two.parquet").write_bytes(b"nothing")
    assert command.main(["--data", str(tmp_path), "-o", str(tmp_path / "out")]) == 1
    assert "two.parquet: not the file of a campaign" in capsys.readouterr().err


def test_every_figure_has_its_section():
    shown = [name for section in command.SECTIONS for name in section.figures]
    assert sorted(shown) == sorted(command.FIGURES)
