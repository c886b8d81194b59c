"""`jaxcap next`: what it writes is what the library says, and bad input is named."""

import json

import numpy as np
import pytest

import jaxcap
from jaxcap.commands.cli import main
from jaxcap.files.contact_files import read_contacts
from jaxcap.files.surface_files import read_surfaces

FEET = """contacts:
  - {type: rectangle, position: [0, 0.1, 0], half_length: 0.1, half_width: 0.05, friction: 0.6}
  - {type: rectangle, position: [0, -0.1, 0], half_length: 0.1, half_width: 0.05, friction: 0.6}
"""
ROOM = """surfaces:
  - {type: plane, position: [0.7, 0, 1], rotation: [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
     half_length: 0.3, half_width: 0.3, friction: 0.6}
"""


@pytest.fixture
def given(tmp_path):
    """Arguments of the command, by file."""
    (tmp_path / "feet.yaml").write_text(FEET)
    (tmp_path / "room.yaml").write_text(ROOM)
    coms, velocities = np.array([[0.05, 0, 0.85], [0, 0, 0.85]]), np.array([[0.6, 0.1, 0], [0.1, 0, 0]])
    np.savez(tmp_path / "states.npz", com=coms, com_velocity=velocities)
    command = ["next", str(tmp_path / "states.npz"), "--contacts", str(tmp_path / "feet.yaml")]
    return [*command, "--surfaces", str(tmp_path / "room.yaml"), "--delay", "0.1", "-o", str(tmp_path / "out.npz")]


def test_what_is_written_is_what_the_library_says(given, tmp_path, capsys):
    assert main([*given, "--spacing", "0.5"]) == 0
    assert "2 states, 4 places" in capsys.readouterr().out
    candidates = jaxcap.candidates_on(read_surfaces(tmp_path / "room.yaml"), 0.06, 0.05, 0.5)
    states = np.load(tmp_path / "states.npz")
    coms, velocities = (states[name].astype(np.float32) for name in ("com", "com_velocity"))
    found = jaxcap.next_contacts(read_contacts(tmp_path / "feet.yaml"), coms, velocities, candidates.contacts, 0.1)
    with np.load(tmp_path / "out.npz") as out:
        for name in ("margin", "margin_without", "capturable", "best", "progress", "status"):
            np.testing.assert_array_equal(out[name], getattr(found, name))
        np.testing.assert_array_equal(out["centres"], candidates.centres)
        np.testing.assert_allclose(out["normals"], np.tile([-1, 0, 0], (4, 1)), atol=1e-12)
        assert json.loads(str(out["metadata"]))["delay"] == 0.1
    assert main(given) == 2 and "exists already" in capsys.readouterr().err


def test_a_momentum_box_counts(given, tmp_path, capsys):
    assert main([*given, "--spacing", "0.5", "--momentum-box", "0.2"]) == 0
    candidates = jaxcap.candidates_on(read_surfaces(tmp_path / "room.yaml"), 0.06, 0.05, 0.5)
    states, feet = np.load(tmp_path / "states.npz"), read_contacts(tmp_path / "feet.yaml")
    state = [states[name].astype(np.float32) for name in ("com", "com_velocity")]
    found = jaxcap.next_contacts(feet, *state, candidates.contacts, 0.1, momentum_box=0.2)
    with np.load(tmp_path / "out.npz") as out:
        np.testing.assert_array_equal(out["margin_without"], found.margin_without)
        assert json.loads(str(out["metadata"]))["momentum_box"] == 0.2
    assert main([*given, "--force", "--momentum-box", "-0.2"]) == 2
    assert "--momentum-box -0.2 (expected a number of m^2/s^2, not negative" in capsys.readouterr().err


def test_angular_momentum_of_a_column_counts(given, tmp_path):
    states, momenta = dict(np.load(tmp_path / "states.npz")), np.array([[0, 0.2, 0], [0.1, 0, 0.05]])
    np.savez(tmp_path / "states.npz", **states, specific_angular_momentum=momenta)
    assert main([*given, "--spacing", "0.5"]) == 0
    candidates = jaxcap.candidates_on(read_surfaces(tmp_path / "room.yaml"), 0.06, 0.05, 0.5)
    coms, velocities, momenta = (field.astype(np.float32) for field in (states["com"], states["com_velocity"], momenta))
    found = jaxcap.next_contacts(
        read_contacts(tmp_path / "feet.yaml"), coms, velocities, candidates.contacts, 0.1, specific_angular_momentum=momenta
    )
    with np.load(tmp_path / "out.npz") as out:
        np.testing.assert_array_equal(out["margin_without"], found.margin_without)


def without_delay(given):
    """The same arguments but for --delay."""
    at = given.index("--delay")
    return given[:at] + given[at + 2 :]


def test_a_mass_makes_a_column_count(given, tmp_path, capsys):
    """Over the mass; without it a note says that the column does not."""
    states, momenta = dict(np.load(tmp_path / "states.npz")), np.array([[0, 8.0, 0], [4.0, 0, 2.0]])
    command = [*given, "--spacing", "0.5", "--force"]
    written = {}
    for name, values, more in (
        ("specific_angular_momentum", momenta / 40, ()),
        ("angular_momentum", momenta, ("--mass", "40")),
    ):
        np.savez(tmp_path / "states.npz", **states, **{name: values})
        assert main([*command, *more]) == 0
        written[name] = dict(np.load(tmp_path / "out.npz"))
    assert capsys.readouterr().err == ""
    for name in ("margin", "margin_without", "best"):
        np.testing.assert_array_equal(*(one[name] for one in written.values()))
    assert json.loads(str(written["angular_momentum"]["metadata"]))["mass"] == 40
    assert main(command) == 0
    assert "'angular_momentum' does not count without --mass" in capsys.readouterr().err
    assert (np.load(tmp_path / "out.npz")["margin_without"] != written["angular_momentum"]["margin_without"]).all()


def test_a_delay_by_a_model_is_that_of_the_library(given, tmp_path):
    limb = ("--limb", "0.2", "-0.3", "0.9", "--limb-speed", "5", "--reaction", "0.02")
    root = ("--limb-root", "0", "-0.2", "1", "--limb-length", "0.8")
    assert main([*without_delay(given), "--spacing", "0.5", *limb, *root]) == 0
    candidates = jaxcap.candidates_on(read_surfaces(tmp_path / "room.yaml"), 0.06, 0.05, 0.5)
    reach = jaxcap.limb_reach(candidates.contacts, [0.2, -0.3, 0.9], 5, 0.02, root=[0, -0.2, 1], length=0.8)
    assert 0 < reach.reachable.sum() < 4
    states = np.load(tmp_path / "states.npz")
    state = (states[name].astype(np.float32) for name in ("com", "com_velocity"))
    found = jaxcap.next_contacts(read_contacts(tmp_path / "feet.yaml"), *state, candidates.contacts, **reach._asdict())
    with np.load(tmp_path / "out.npz") as out:
        for name in ("margin", "margin_without", "capturable", "best", "progress", "status"):
            np.testing.assert_array_equal(out[name], getattr(found, name))
        np.testing.assert_array_equal(out["delay"], reach.delay)
        np.testing.assert_array_equal(out["reachable"], reach.reachable)
        assert json.loads(str(out["metadata"]))["limb_speed"] == 5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), "no --limb, and no --delay (expected --delay, or --limb with --limb-speed)"),
        (("--limb", "0", "0", "1"), "no --limb-speed beside --limb (expected --delay, or --limb with --limb-speed)"),
        (("--reaction", "0.1"), "no --limb beside --reaction"),
        (("--delay", "0.1", "--limb-speed", "2"), "--limb-speed beside --delay 0.1 (expected --delay, or"),
        (("--limb", "0", "0", "nan", "--limb-speed", "2"), "--limb (0.0, 0.0, nan) (expected three finite numbers"),
        (("--limb", "0", "0", "1", "--limb-speed", "0"), "--limb-speed = 0.0 (expected a positive number"),
        (("--limb", "0", "0", "1", "--limb-speed", "1", "--reaction", "-1"), "--reaction = -1.0 (expected"),
        (("--limb", "0", "0", "1", "--limb-speed", "1", "--limb-length", "1"), "--limb-length is given alone"),
    ],
)
def test_one_delay_or_one_model(given, options, words, capsys, tmp_path):
    assert main([*without_delay(given), *options]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out.npz").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("--delay", "-0.1"), "--delay = -0.1 (expected a finite number of seconds, not negative)"),
        (("--spacing", "0"), "--spacing = 0"),
        (("--sides", "2"), "--sides 2"),
        (("--mass", "0"), "--mass 0.0 (expected a positive number of kilograms)"),
        (("--mass", "40"), "no column 'angular_momentum'"),
        (("--lifted", "9"), "--lifted[0] = 9"),
        (("-o", "out.csv"), "unknown extension"),
        (("--surfaces", "nowhere.yaml"), "nowhere.yaml: no such file"),
    ],
)
def test_what_cannot_be_is_named(given, change, words, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main([*given, *change]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out.npz").exists()


def test_help(capsys):
    main(["next", "--help"])
    text = capsys.readouterr().out
    assert "SURFACES is YAML" in text
    assert max(map(len, text.splitlines())) <= 80
