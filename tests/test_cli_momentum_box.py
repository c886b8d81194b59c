"""`jaxcap score --momentum-box`: what the limbs may do besides braking, in every way in which contacts are given."""

import jax
import numpy as np
import pytest
from state_files import (
    LISTS,
    SETS,
    N,
    arrow_contacts,
    command,
    padded_contacts,
    read_columns,
    read_metadata,
    states,
    write_contacts,
    write_states,
)

import jaxcap
from jaxcap.commands.cli import main
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.files.contact_files import read_contact_sets, read_contacts
from jaxcap.files.fields import BASELINES

BOX = 0.3
"""[m^2/s^2]"""
EXACT = ["--dtype", "float64"]


def scored(where, contacts, name: str, *options) -> dict[str, np.ndarray]:
    """Columns of the output of the command."""
    output = where.parent / name
    assert main(command(where, contacts, output, *EXACT, *options)) == 0
    return read_columns(output)


def close(found, cone, coms, velocities, **options):
    """The verdicts and limits of the library, in double precision."""
    with jax.enable_x64(True):
        expected = jaxcap.score(cone, coms, velocities, **options)
    for name in ("capturable", "status", "max_speed", "margin"):
        np.testing.assert_allclose(found[name], getattr(expected, name), rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.slow
def test_one_set_for_all(tmp_path):
    """As the library says; no margin is lower than without, and the metadata say which box it was."""
    contacts, where = write_contacts(tmp_path / "feet.json"), write_states(tmp_path / "states.parquet", N)
    found = scored(where, contacts, "box.parquet", "--momentum-box", str(BOX))
    cone = jaxcap.centroidal_cone(read_contacts(contacts), momentum_box=BOX)
    close(found, cone, *states(N))
    said = read_metadata(tmp_path / "box.parquet")
    assert said["momentum_box"] == BOX and said["units"]["momentum_box"] == "m^2/s^2"
    plain = scored(where, contacts, "plain.parquet")
    assert (found["margin"] >= plain["margin"] - 1e-9).all() and (found["margin"] > plain["margin"] + 1e-3).any()
    assert "momentum_box" not in read_metadata(tmp_path / "plain.parquet")
    scored(where, contacts, "zero.parquet", "--momentum-box", "0")
    assert (tmp_path / "zero.parquet").read_bytes() == (tmp_path / "plain.parquet").read_bytes()


@pytest.mark.slow
def test_contacts_of_their_own(tmp_path):
    """By rays, whatever neighbours are said to be."""
    where = write_states(tmp_path / "states.parquet", N, **arrow_contacts(LISTS))
    found = scored(where, None, "box.parquet", "--momentum-box", str(BOX))
    padded = padded_contacts(LISTS)
    there = np.isfinite(padded["contact_friction"])
    frames = np.where(there[..., None, None], padded["contact_frames"], np.eye(3))
    points, friction = (
        np.where(there[..., None], padded["contact_points"], 0),
        np.where(there, padded["contact_friction"], 1),
    )
    with jax.enable_x64(True):
        rays = jaxcap.cone_rays(ContactSet(points, frames, friction, there))
    close(found, rays, *states(N), momentum_box=BOX)
    assert np.isnan(found["effort"]).all()  # no joint counts
    again = scored(where, None, "neighbours.parquet", "--momentum-box", str(BOX), "--neighbours")
    np.testing.assert_array_equal(again["capturable"], found["capturable"])


@pytest.mark.slow
def test_sets_that_rows_choose_from_and_baselines_that_know_no_box(tmp_path):
    contacts = write_contacts(tmp_path / "sets.json", SETS)
    sets = read_contact_sets(contacts).sets
    ids = np.arange(N) % len(sets)
    where = write_states(tmp_path / "states.parquet", N, contact_set=ids)
    found = scored(where, contacts, "box.parquet", "--momentum-box", str(BOX), "--baselines")
    coms, velocities = states(N)
    for number, contact_set in enumerate(sets):
        rows = ids == number
        if np.any(contact_set.mask):
            cone = jaxcap.centroidal_cone(contact_set, momentum_box=BOX)
            close({name: column[rows] for name, column in found.items()}, cone, coms[rows], velocities[rows])
    plain = scored(where, contacts, "plain.parquet", "--baselines")
    for name in BASELINES:
        np.testing.assert_array_equal(found[name], plain[name])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-1"], "--momentum-box -1.0 (expected a number of m^2/s^2, not negative: N m over the mass)"),
        (["nan"], "--momentum-box nan (expected"),
        (["inf"], "--momentum-box inf (expected"),
        (["0.1", "--robot", "g1", "--point-mass"], "--momentum-box 0.1 (expected without --point-mass"),
    ],
)
def test_boxes_that_cannot_be_used(tmp_path, capsys, options, message):
    contacts, where = write_contacts(tmp_path / "feet.json"), write_states(tmp_path / "states.parquet", 3)
    assert main(command(where, contacts, tmp_path / "out.parquet", "--momentum-box", *options)) == 2
    assert message in capsys.readouterr().err and not (tmp_path / "out.parquet").exists()
