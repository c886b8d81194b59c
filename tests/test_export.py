"""Programs for processes without jaxcap: a fresh one loads them and answers as `score` does."""

import subprocess
import sys

import jax
import numpy as np
import pytest

import jaxcap
from jaxcap import Case, Status
from jaxcap.batch import exported
from jaxcap.errors import MissingExtra

pytest.importorskip("flatbuffers")

SOLE = lambda y: jaxcap.rectangle([0, y, 0], np.eye(3), 0.105, 0.065, 0.5)
FEET = SOLE(0.1) + SOLE(-0.1)
PALM = jaxcap.rectangle([0, -0.3, 0.8], [[1, 0, 0], [0, 0, 1], [0, -1, 0]], 0.1, 0.05, 0.5)
OPPOSITE = jaxcap.rectangle([0, 0.3, 0.8], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], 0.1, 0.05, 0.5)
POINT = jaxcap.ContactSet([[0, 0, 0]], np.eye(3), [0.5])
SETS = {"feet": FEET, "palms": PALM + OPPOSITE, "point": POINT, "flight": FEET}
MANY = exported.ANY_BLOCK + 88
"""Two blocks, the second not full."""
FEW = 7

LOADING = """
import sys
sys.modules["jaxcap"] = None   # an import of it fails
import jax
import numpy as np
with np.load("in.npz") as file:
    given = dict(file)
load = lambda name: jax.jit(jax.export.deserialize(open(name, "rb").read()).call)
out, feet, contacts = {}, load("feet.jax"), load("contacts.jax")
def answer(name, program, *arguments):
    out.update({f"{name}.{field}": value for field, value in program(*arguments).items()})
states = given["coms"], given["velocities"]
answer("many", feet, *states)
answer("one", feet, *(x[:1] for x in states))
for name in SETS:
    fields = [given[f"{name}.{field}"] for field in ("points", "frames", "friction", "mask")]
    answer(name, contacts, *fields, *(x[:FEW] for x in states))
assert not [name for name in sys.modules if name.startswith("jaxcap.")]
np.savez("out.npz", **out)
"""


def states():
    """The first three: above the feet and moving, at rest, and not a number."""
    rng = np.random.default_rng(0)
    coms = rng.uniform([-0.2, -0.2, 0.7], [0.2, 0.2, 1], (MANY, 3)).astype(np.float32)
    velocities = rng.uniform(-1, 1, (MANY, 3)).astype(np.float32)
    coms[:3], velocities[:2] = [[0, 0, 0.8], [0, 0, 0.8], [np.nan, 0, 0.8]], [[0.2, 0, 0], [0, 0, 0]]
    return coms, velocities


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """The answers of the fresh process: "many.margin", "feet.case", ..."""
    directory = tmp_path_factory.mktemp("export")
    (directory / "feet.jax").write_bytes(exported.export(jaxcap.centroidal_cone(FEET)))
    (directory / "contacts.jax").write_bytes(exported.export_contacts(len(FEET) + 2, n=FEW))
    arrays = dict(zip(("coms", "velocities"), states(), strict=True))
    for name, contacts in SETS.items():
        full = contacts.padded(len(FEET) + 2)
        arrays |= {f"{name}.{key}": getattr(full, key).astype(np.float32) for key in ("points", "frames", "friction")}
        arrays[f"{name}.mask"] = full.mask & (name != "flight")
    np.savez(directory / "in.npz", **arrays)
    program = LOADING.replace("SETS", repr(list(SETS))).replace("FEW", str(FEW))
    # Compiled as here: with other optimizations the last digit differs, and next to a stop a residual speed is its root.
    subprocess.run([sys.executable, "-W", "error", "-c", program], check=True, cwd=directory)
    with np.load(directory / "out.npz") as file:
        return dict(file)


@pytest.fixture(scope="module")
def scored():
    return jaxcap.score(jaxcap.centroidal_cone(FEET), *states())


def field(answers, program):
    """What one program answered, under the names of the fields."""
    return {name.partition(".")[2]: x for name, x in answers.items() if name.startswith(f"{program}.")}


def test_a_fresh_process_answers_as_score_does(loaded, scored):
    """Same verdicts, cases and statuses; the figures are equal but for rounding."""
    many = field(loaded, "many")
    assert set(many) == set(scored._fields)
    assert 0.1 < scored.capturable.mean() < 0.9
    for name, expected in scored._asdict().items():
        assert many[name].dtype == expected.dtype and many[name].shape == (MANY,)
        np.testing.assert_allclose(many[name], expected, rtol=1e-5, atol=1e-6, err_msg=name)


def test_the_same_program_takes_one_state(loaded, scored):
    for name, values in field(loaded, "one").items():
        np.testing.assert_allclose(values, getattr(scored, name)[:1], rtol=1e-5, atol=1e-6, err_msg=name)


def test_rest_and_a_bad_row(loaded):
    assert field(loaded, "many")["status"][:3].tolist() == [Status.OK, Status.NO_DIRECTION, Status.NONFINITE]


def test_contacts_as_an_argument_answer_as_their_faces(loaded, scored):
    """Two rows of the eight are masked."""
    feet = field(loaded, "feet")
    for name in ("capturable", "case", "status"):
        np.testing.assert_array_equal(feet[name], getattr(scored, name)[:FEW], err_msg=name)
    np.testing.assert_allclose(feet["margin"], scored.margin[:FEW], atol=1e-3)


def test_opposing_palms_stop_everything(loaded):
    palms = field(loaded, "palms")
    assert palms["capturable"].tolist() == [True, True, False] + [True] * (FEW - 3)
    assert np.isposinf(palms["margin"][[0, *range(3, FEW)]]).all()


def test_one_contact_point_stops_nothing_that_moves_beside_it(loaded):
    point = field(loaded, "point")
    assert not point["capturable"][[0, *range(2, FEW)]].any()
    assert point["capturable"][1]  # at rest above the point


def test_no_contact_is_flight(loaded):
    flight = field(loaded, "flight")
    assert flight["case"].tolist() == [Case.EMPTY, Case.EMPTY, Case.UNDECIDED] + [Case.EMPTY] * (FEW - 3)
    assert not flight["capturable"].any()


def test_a_program_says_what_it_takes():
    program = jax.export.deserialize(exported.export(jaxcap.centroidal_cone(FEET), n="states", platforms=("cpu", "cuda")))
    assert [(str(x.dtype), str(x.shape[0]), x.shape[1]) for x in program.in_avals] == [("float32", "states", 3)] * 2
    assert program.platforms == ("cpu", "cuda")
    few, many = np.zeros((3, 3), np.float32), np.zeros((4, 3), np.float32)
    with pytest.raises(ValueError, match="states"):
        program.call(few, many)
    with pytest.raises(ValueError, match="Dtype mismatch"):
        program.call(few.astype(np.float16), few)


def test_double_precision_needs_no_switch_here():
    """The program is of double precision; whether the caller may hold such numbers is the caller's business."""
    program = jax.export.deserialize(exported.export(jaxcap.centroidal_cone(FEET), n=1, dtype="float64"))
    assert {str(x.dtype) for x in program.in_avals} == {"float64"}
    assert not jax.config.jax_enable_x64


def test_what_cannot_be_exported(monkeypatch):
    cone = jaxcap.centroidal_cone(FEET)
    both = jaxcap.cone_rays(jax.tree.map(lambda x: np.stack([x, x]), FEET))
    with pytest.raises(ValueError, match=r"2 contact sets \(expected one"):
        exported.export(both)
    with pytest.raises(ValueError, match=r"n = 0 \(expected at least 1"):
        exported.export(cone, n=0)
    with pytest.raises(ValueError, match=r"dtype = int32 \(expected float32 or float64"):
        exported.export(cone, dtype="int32")
    with pytest.raises(ValueError, match=r"contacts = 0 \(expected at least 1"):
        exported.export_contacts(0)
    monkeypatch.setitem(sys.modules, "flatbuffers", None)
    with pytest.raises(MissingExtra, match=r"flatbuffers.*jaxcap\[export\]"):
        exported.export(cone)
