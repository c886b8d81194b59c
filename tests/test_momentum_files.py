"""Angular momentum in files, maps, exported programs and regions: what is read, what is answered, what is refused."""

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from state_files import command, read_columns, read_metadata, states, vectors, write_contacts, write_states

import jaxcap
from jaxcap import Status
from jaxcap.batch import exported
from jaxcap.commands.cli import main
from jaxcap.errors import InputError
from jaxcap.files.records import read_states
from jaxcap.maps import kernel_map
from jaxcap.maps.grid import grid_of

MASS, N = 40.0, 10
FEET = jaxcap.rectangle([0, 0.1, 0], np.eye(3), 0.1, 0.05, 0.5) + jaxcap.rectangle([0, -0.1, 0], np.eye(3), 0.1, 0.05, 0.5)
"""Those of the contact file."""
MOMENTA = np.random.default_rng(4).normal(size=(N, 3)) * 4.0
"""[kg m^2/s]"""
AXES = {"com_x": "-0.1:0.1:3", "com_y": 0.0, "com_z": 0.8, "heading": "0:360deg:4", "speed": [0.0, 0.2, 0.6]}


@pytest.fixture(scope="module")
def scored():
    """With the momenta, and without."""
    coms, velocities = (x.astype(np.float32) for x in states(N))
    cone = jaxcap.centroidal_cone(FEET)
    momenta = (MOMENTA / MASS).astype(np.float32)
    with_momenta = jaxcap.score(cone, coms, velocities, specific_angular_momentum=momenta)
    return jax.tree.map(np.asarray, (with_momenta, jaxcap.score(cone, coms, velocities)))


def written(path, **columns):
    """A file of states with these columns, as its extension wants them."""
    if path.suffix != ".npz":
        columns = {name: vectors(x) if x.ndim == 2 else pa.array(x) for name, x in columns.items()}
    return write_states(path, N, **columns)


def run(tmp_path, file, *options):
    """The columns of the scores of a file."""
    contacts, out = write_contacts(tmp_path / "feet.yaml"), tmp_path / "out.parquet"
    assert main(command(file, contacts, out, *options, "--force", "--batch-size", str(N))) == 0
    return read_columns(out), read_metadata(out)


@pytest.mark.parametrize("extension", ["parquet", "npz"])
def test_columns_that_count(tmp_path, scored, capsys, extension):
    expected, without = scored
    assert (expected.margin != without.margin).any()
    both = written(tmp_path / f"both.{extension}", angular_momentum=MOMENTA)
    columns, metadata = run(tmp_path, both, "--mass", str(MASS))
    np.testing.assert_allclose(columns["margin"], expected.margin, rtol=1e-5, atol=1e-6)
    assert metadata["mass"] == MASS and metadata["units"]["angular_momentum"] == "kg m^2/s"
    np.testing.assert_array_equal(columns["angular_momentum"], MOMENTA)
    assert capsys.readouterr().err.count("angular_momentum") == 0

    specific = written(tmp_path / f"specific.{extension}", specific_angular_momentum=MOMENTA / MASS)
    columns, metadata = run(tmp_path, specific)
    np.testing.assert_allclose(columns["margin"], expected.margin, rtol=1e-5, atol=1e-6)
    assert metadata["units"]["specific_angular_momentum"] == "m^2/s" and "mass" not in metadata

    columns, _ = run(tmp_path, both)
    np.testing.assert_array_equal(columns["margin"], without.margin)
    assert "note: " in (said := capsys.readouterr().err) and "'angular_momentum' does not count without --mass" in said


def test_three_columns_in_a_csv(tmp_path):
    coms, velocities = states(N)
    arrays = {"com": coms, "com_velocity": velocities, "angular_momentum": MOMENTA}
    names = [f"{name}_{axis}" for name in arrays for axis in "xyz"]
    path = tmp_path / "states.csv"
    np.savetxt(path, np.hstack(list(arrays.values())), delimiter=",", header=",".join(names), comments="", fmt="%.17g")
    with read_states(path, N, np.float64, mass=MASS) as file:
        assert file.momentum == tuple(names[6:])
        (batch,) = file
    np.testing.assert_array_equal(batch.specific_angular_momenta, MOMENTA / MASS)
    with read_states(path, N, np.float64) as file:
        (batch,) = file
    assert batch.specific_angular_momenta is None and file.momentum == ()


def test_a_bad_row_is_counted_and_leaves_the_others_alone(tmp_path, scored, capsys):
    bad = MOMENTA.copy()
    bad[3, 1] = np.nan
    rows = [None if row == 5 else x.tolist() for row, x in enumerate(bad)]
    coms, velocities = (vectors(x) for x in states(N))
    path = tmp_path / "states.parquet"
    kind = pa.list_(pa.float64(), 3)
    pq.write_table(pa.table({"com": coms, "com_velocity": velocities, "angular_momentum": pa.array(rows, kind)}), path)
    out, contacts = tmp_path / "out.parquet", write_contacts(tmp_path / "feet.yaml")
    assert main(command(path, contacts, out, "--batch-size", str(N), "--mass", str(MASS))) == 0
    status, margin = (np.array(pq.read_table(out)[name]) for name in ("status", "margin"))
    others = ~np.isin(np.arange(N), (3, 5))
    assert (status == Status.NONFINITE).tolist() == (~others).tolist()
    np.testing.assert_allclose(margin[others], scored[0].margin[others], rtol=1e-5, atol=1e-6)
    assert "first row 3: angular_momentum = " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("columns", "options", "said"),
    [
        ({}, ["--mass", "40"], "no column 'angular_momentum'"),
        ({"angular_momentum": MOMENTA}, ["--mass", "0"], "--mass 0.0 (expected a positive number of kilograms)"),
        ({"angular_momentum": MOMENTA}, ["--mass", "nan"], "--mass nan (expected a positive number of kilograms)"),
        ({"angular_momentum": MOMENTA[:, 0]}, ["--mass", "40"], "'angular_momentum' has shape (10,) (expected (n, 3))"),
        ({"specific_angular_momentum": MOMENTA}, ["--mass", "40"], "is per unit mass already"),
        ({"specific_angular_momentum": MOMENTA[:, :2]}, [], "'specific_angular_momentum' has shape (10, 2)"),
    ],
)
def test_what_is_refused(tmp_path, capsys, columns, options, said):
    file = write_states(tmp_path / "states.npz", N, **columns)
    assert main(command(file, write_contacts(tmp_path / "feet.yaml"), tmp_path / "out.parquet", *options)) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out.parquet").exists()


def test_a_mass_that_is_none():
    with pytest.raises(InputError, match=r"mass = -1 \(expected a positive number of kilograms\)"):
        read_states("states.npz", 1, mass=-1)


def test_help_names_them(capsys):
    assert main(["score", "--help"]) == 0
    text = capsys.readouterr().out
    assert all(
        word in text for word in ("angular_momentum", "specific_angular_momentum", "--mass M", "[kg m^2/s]", "[m^2/s]")
    )
    assert max(map(len, text.splitlines())) <= 80


def test_a_map_has_the_answers_of_score():
    axes = {**AXES, "specific_angular_momentum_x": 0.05, "specific_angular_momentum_y": [-0.1, 0.0, 0.2]}
    points, cone = grid_of(axes), jaxcap.centroidal_cone(FEET)
    index = np.arange(points.size)
    (coms, velocities), momenta = points.states(index, np.float32), points.momenta(index, np.float32)
    np.testing.assert_array_equal(np.unique(momenta[:, 1]), np.float32([-0.1, 0, 0.2]))
    expected = jaxcap.score(cone, coms, velocities, specific_angular_momentum=momenta)
    found = kernel_map(cone, axes, ("capturable", "margin", "max_speed", "status"), dtype=np.float32)
    assert found["max_speed"].dims == points.dims and found["specific_angular_momentum_y"].attrs["units"] == "m^2/s"
    for name in ("capturable", "margin", "max_speed", "status"):
        values = np.asarray(getattr(expected, name)).reshape(points.shape)
        np.testing.assert_allclose(found[name], values, rtol=1e-4, atol=1e-5, err_msg=name)
    without = kernel_map(cone, AXES, ("margin",), dtype=np.float32)
    assert (found["margin"].isel(specific_angular_momentum_y=1) != without["margin"]).any()


def test_a_map_of_limits_needs_a_speed():
    with pytest.raises(InputError, match="axis specific_angular_momentum_y needs a speed"):
        kernel_map(
            FEET, {name: value for name, value in AXES.items() if name != "speed"} | {"specific_angular_momentum_y": 0.1}
        )


def test_an_exported_program_takes_it():
    pytest.importorskip("flatbuffers")
    cone = jaxcap.centroidal_cone(FEET)
    coms, velocities = (x.astype(np.float32) for x in states(N))
    momenta = (MOMENTA / MASS).astype(np.float32)
    program = jax.jit(jax.export.deserialize(exported.export(cone, n=N, momentum=True)).call)
    found = program(coms, velocities, momenta)
    expected = jaxcap.score(cone, coms, velocities, specific_angular_momentum=momenta)
    for name, values in expected._asdict().items():
        np.testing.assert_allclose(found[name], values, rtol=1e-5, atol=1e-6, err_msg=name)


def test_a_push_beside_the_com():
    """`velocity_area` is `score` of velocities with the angular momentum of the push."""
    cone, com, arm = jaxcap.centroidal_cone(FEET), np.array([0.0, 0.0, 0.8]), np.array([0.0, 0.05, 0.4])
    towards = jaxcap.headings(16)
    area = jaxcap.velocity_area(cone, com, towards, push_arm=arm)
    velocities = 0.3 * towards
    coms, momenta = np.tile(com, (16, 1)), np.cross(arm, velocities)
    expected = jaxcap.score(cone, coms, velocities, specific_angular_momentum=momenta)
    np.testing.assert_allclose(area.max_speed, expected.max_speed, rtol=1e-4)
    through = jaxcap.velocity_area(cone, com, towards)
    assert area.standing and (area.max_speed < through.max_speed).all(), "a push high up is harder to take"
    with pytest.raises(TypeError, match=r"push_arm has shape \(2,\)"):
        jaxcap.velocity_area(cone, com, towards, push_arm=arm[:2])


def test_positions_from_which_it_stops(x64):
    cone, velocity, momentum = jaxcap.centroidal_cone(FEET), np.array([0.3, 0.0, 0.0]), np.array([0.0, 0.1, 0.0])
    area = jaxcap.com_area(cone, velocity, 0.8, lines=6, specific_angular_momentum=momentum)
    shift = np.array([1e-4, 0.0])
    for edge, inwards in ((area.front, -shift), (area.rear, shift)):
        for sign, capturable in ((1, True), (-1, False)):
            coms = np.column_stack([edge + sign * inwards, np.full(len(edge), 0.8)])
            rows = [np.tile(x, (len(coms), 1)) for x in (velocity, momentum)]
            found = jaxcap.score(cone, coms, rows[0], specific_angular_momentum=rows[1])
            assert (np.asarray(found.capturable) == capturable).all()
    with pytest.raises(ValueError, match=r"specific_angular_momentum = .* \(expected three finite numbers"):
        jaxcap.com_area(cone, velocity, 0.8, specific_angular_momentum=[0.0, np.nan, 0.0])
