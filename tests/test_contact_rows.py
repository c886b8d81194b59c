"""Contacts that differ from row to row: every spelling says the same, and both forms score the same."""

import jax
import numpy as np
import pyarrow as pa
import pytest
from state_files import arrow_contacts, contact_lists, padded_contacts, states, write_contacts, write_states

import jaxcap
from jaxcap.commands import scorers as contact_rows
from jaxcap.commands.scorers import OwnContacts, SharedSets
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.projection import ProjectionError
from jaxcap.files.contact_columns import BadRows, RowChoices, chosen, from_arrays
from jaxcap.files.contact_files import read_contact_sets
from jaxcap.files.records import read_states
from jaxcap.one_state.result import Case, Status

N = 40
LISTS = contact_lists(N)
ARRAYS = padded_contacts(LISTS)
EXTENSIONS = ["parquet", "npz"]


def read_all(path, batch_size=N, dtype=np.float64):
    with read_states(path, batch_size, dtype) as file:
        return list(file)


def contacts_of(path, dtype=np.float64):
    (batch,) = read_all(path, dtype=dtype)
    return batch.contacts


def assert_same(one, other):
    for name in ("points", "frames", "friction", "mask"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.bad.rows, other.bad.rows)


def masked(arrays):
    """Arrays whose padding is said by a mask, and holds anything."""
    mask = np.isfinite(arrays["contact_friction"])
    return {**{name: np.where(np.isnan(x), 7.0, x) for name, x in arrays.items()}, "contact_mask": mask}


def fixed(arrays):
    """Arrays as lists of fixed size."""
    out = {}
    for name, values in arrays.items():
        kind = pa.from_numpy_dtype(values.dtype)
        for size in reversed(values.shape[1:]):
            kind = pa.list_(kind, size)
        out[name] = pa.array(values.tolist(), kind)
    return out


SPELLINGS = {
    "nested.parquet": lambda: arrow_contacts(LISTS),
    "flat.parquet": lambda: arrow_contacts(LISTS, "flat"),
    "inner lists of fixed size.parquet": lambda: arrow_contacts(LISTS, "fixed"),
    "padded with nan.parquet": lambda: fixed(ARRAYS),
    "padded with a mask.parquet": lambda: fixed(masked(ARRAYS)),
    "padded with nulls.parquet": lambda: arrow_contacts(
        {name: [[*row, *[None] * (8 - len(row))] for row in rows] for name, rows in LISTS.items()}
    ),
    "one list of fixed size.parquet": lambda: fixed({name: x.reshape(N, -1) for name, x in ARRAYS.items()}),
    "padded with nan.npz": lambda: ARRAYS,
    "padded with a mask.npz": lambda: masked(ARRAYS),
    "fortran order.npz": lambda: {name: np.asfortranarray(x) for name, x in ARRAYS.items()},
    "flat.npz": lambda: {name: x.reshape(N, -1) for name, x in ARRAYS.items()},
    "in ten places.npz": lambda: padded_contacts(LISTS, 10),
}


@pytest.mark.parametrize("name", SPELLINGS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_every_spelling_reads_the_same(tmp_path, name, dtype):
    contacts = contacts_of(write_states(tmp_path / name, N, **SPELLINGS[name]()), dtype)
    assert contacts.points.dtype == contacts.frames.dtype == contacts.friction.dtype == dtype
    assert not contacts.bad.rows.any() and contacts.bad.first is None
    assert contacts.mask.shape == (N, 8 if "ten" not in name else 12)
    assert set(contacts.mask.sum(axis=1)) == set(range(9))
    for row in range(N):
        own = contacts.mask[row]
        k = len(LISTS["contact_friction"][row])
        assert own[:k].all() and not own[k:].any()
        for field, column in (("points", "contact_points"), ("frames", "contact_frames"), ("friction", "contact_friction")):
            read, written = getattr(contacts, field)[row], np.array(LISTS[column][row], dtype)
            np.testing.assert_array_equal(read[own], written.reshape(read[own].shape))
    unused = ~contacts.mask
    assert (contacts.points[unused] == 0).all() and (contacts.friction[unused] == 1).all()
    np.testing.assert_array_equal(contacts.frames[unused], np.broadcast_to(np.eye(3), (unused.sum(), 3, 3)))


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_one_friction_a_row(tmp_path, extension):
    friction = np.linspace(0.3, 1, N)
    columns = (arrow_contacts(LISTS) if extension == "parquet" else ARRAYS) | {"contact_friction": friction}
    contacts = contacts_of(write_states(tmp_path / f"a.{extension}", N, **columns))
    assert not contacts.bad.rows.any()
    expected = np.where(contacts.mask, friction[:, None], 1)
    np.testing.assert_array_equal(contacts.friction, expected)


def test_whole_numbers_and_single_precision(tmp_path):
    columns = {
        "contact_points": np.zeros((3, 4, 3), np.int32),
        "contact_frames": np.tile(np.eye(3, dtype=np.float32), (3, 4, 1, 1)),
        "contact_friction": np.ones(3, np.uint8),
    }
    contacts = contacts_of(write_states(tmp_path / "a.npz", 3, **columns))
    assert contacts.mask.all() and (contacts.friction == 1).all() and not contacts.bad.rows.any()


@pytest.mark.parametrize(
    "columns",
    [
        {name: [[]] * 3 for name in LISTS},
        {name: x[:3, :0] for name, x in ARRAYS.items()},
        {name: x[:3] * np.nan for name, x in ARRAYS.items()},
        {**{name: x[:3] for name, x in ARRAYS.items()}, "contact_mask": np.zeros((3, 8), bool)},
    ],
)
def test_no_contact_in_any_row(tmp_path, columns):
    extension = "parquet" if isinstance(columns["contact_points"], list) else "npz"
    contacts = contacts_of(write_states(tmp_path / f"a.{extension}", 3, **columns))
    assert not contacts.mask.any() and not contacts.bad.rows.any() and contacts.mask.shape[1] in (4, 8)


def test_contacts_are_padded_in_each_batch_to_a_multiple_of_four(tmp_path):
    lists = {name: sorted(rows, key=len) for name, rows in contact_lists(60, most=16).items()}
    path = write_states(tmp_path / "a.parquet", 60, **arrow_contacts(lists))
    batches = read_all(path, 13)
    widths = [batch.contacts.mask.shape[1] for batch in batches]
    assert widths == sorted(widths) and set(widths) == {4, 8, 12, 16}
    counts = np.concatenate([batch.contacts.mask.sum(axis=1) for batch in batches])
    np.testing.assert_array_equal(counts, [len(row) for row in lists["contact_points"]])


PLAIN = [[2, 0, 1], ["c", "a", "b"], np.array([2, 0, 1], np.uint64), np.array(["c", "a", "b"])]
ARROW = [
    pa.array([2, 0, 1], pa.uint8()),
    pa.array(["c", "a", "b"], pa.large_string()),
    pa.array(["c", "a", "b"]).dictionary_encode(),
]


@pytest.mark.parametrize(("extension", "column"), [*(("parquet", x) for x in PLAIN + ARROW), *(("npz", x) for x in PLAIN)])
def test_choices_by_number_and_by_name(tmp_path, column, extension):
    choices = contacts_of(write_states(tmp_path / f"a.{extension}", 3, contact_set=column))
    numbers, bad = SharedSets([ContactSet([[0, 0, i]], np.eye(3), 1) for i in range(3)], "abc").choose(choices)
    assert numbers.tolist() == [2, 0, 1] and not bad.rows.any()


@pytest.mark.parametrize(
    ("column", "why"),
    [
        (np.array([0, 3, 1]), "contact_set = 3 (expected 0 to 2)"),
        (np.array([0, -1, 1]), "contact_set = -1 (expected 0 to 2)"),
        (np.array([0, 2**64 - 1, 1], np.uint64), "contact_set = 18446744073709551615 (expected 0 to 2)"),
        (np.array(["b", "1", "a"]), "contact_set = '1' (expected 'a', 'b')"),
    ],
)
def test_a_choice_that_there_is_not(column, why):
    sets = SharedSets([ContactSet([[0, 0, i]], np.eye(3), 1) for i in range(3)], ["a", "b", None])
    numbers, bad = sets.choose(chosen(column))
    assert bad.rows.tolist() == [False, True, False] and (bad.first, bad.why) == (1, why)
    assert numbers.tolist() == ([0, 0, 1] if column.dtype.kind != "U" else [1, 0, 0])


def test_no_choice(tmp_path):
    for column in (pa.array([0, None, 1]), pa.array(["a", None, "b"]), pa.array(["a", None, "b"]).dictionary_encode()):
        choices = contacts_of(write_states(tmp_path / "a.parquet", 3, contact_set=column))
        _, bad = SharedSets([ContactSet([[0, 0, i]], np.eye(3), 1) for i in range(2)], "ab").choose(choices)
        assert bad.rows.tolist() == [False, True, False] and "contact_set is null" in bad.why


def test_only_the_reason_of_the_first_bad_row_is_kept():
    bad, asked = BadRows(5), []
    bad.add(np.array([0, 0, 1, 0, 1], bool), lambda row: asked.append(row) or "one")
    bad.add(np.array([0, 0, 1, 1, 0], bool), lambda row: asked.append(row) or "two")
    bad.add(np.array([0, 1, 0, 0, 0], bool), lambda row: asked.append(row) or "three")
    assert bad.rows.tolist() == [False, True, True, True, True]
    assert (bad.first, bad.why, asked) == (1, "three", [2, 1])


# scores

COMS, VELOCITIES = np.array([1, 0.4])[:, None, None] * states(N)  # slow enough to stop on two feet
NUMBERS = np.random.default_rng(3).integers(0, 4, N)


def sole(y, angle=0.0):
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    return jaxcap.rectangle([0, y, 0], turn, 0.1, 0.05, 0.5)


SETS = [sole(0.1), sole(0.1) + sole(-0.1), ContactSet(np.zeros((0, 3)), np.eye(3), 1.0), sole(0.1) + sole(-0.1, 0.4)]


BROKEN = {
    "points": [np.nan, np.inf, -np.inf],
    "friction": [np.nan, np.inf, 0.0, -0.5],
    "frames": [np.nan, np.inf, 0.0, -1.0, 1.1],
}
"""Values that a contact cannot have; of a frame, its first entry."""


@pytest.mark.parametrize(("field", "value"), [(field, value) for field, values in BROKEN.items() for value in values])
def test_a_row_is_bad_if_and_only_if_it_makes_no_contact_set(field, value):
    """Contacts are checked in `ContactSet`, which raises, and in columns, where a bad row must not cost the others."""
    good = {"points": np.zeros((2, 1, 3)), "frames": np.tile(np.eye(3), (2, 1, 1, 1)), "friction": np.full((2, 1), 0.5)}
    bad = {name: values.copy() for name, values in good.items()}
    bad[field][1].reshape(-1)[0] = value
    rows = from_arrays({f"contact_{name}": values for name, values in bad.items()}, np.dtype(np.float64)).bad.rows
    assert rows.tolist() == [False, True]
    ContactSet(*(values[1] for values in good.values()))
    with pytest.raises(ValueError, match=field):
        ContactSet(*(values[1] for values in bad.values()))


def assert_close(one, other, tolerance=1e-9):
    for name in ("capturable", "case", "status"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in one._fields[3:]:
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=tolerance, rtol=tolerance)


def test_rows_with_their_own_contacts_score_as_alone(x64):
    contacts = from_arrays(ARRAYS, np.dtype(np.float64))
    out, bad = OwnContacts().score(contacts, COMS, VELOCITIES)
    assert not bad.rows.any() and out.margin.dtype == np.float64
    rays = jaxcap.cone_rays(ContactSet(*contacts[:4]))
    assert_close(out, jax.device_get(jaxcap.score(rays, COMS, VELOCITIES)))
    empty = np.array([not row for row in LISTS["contact_points"]])
    assert empty.any() and (out.case[empty] == Case.EMPTY).all() and (out.status[empty] == Status.OK).all()
    assert not out.capturable[empty].any() and out.capturable.any()


def test_neighbours_score_the_same(x64):
    contacts = from_arrays(ARRAYS, np.dtype(np.float64))
    one, _ = OwnContacts().score(contacts, COMS, VELOCITIES)
    other, _ = OwnContacts(neighbours=True).score(contacts, COMS, VELOCITIES)
    assert_close(one, other, 1e-8)


def test_a_later_batch_with_fewer_rows_and_contacts_needs_no_compiling(monkeypatch):
    shapes, real = [], jaxcap.score

    def spy(cone, coms, *rest, **options):
        shapes.append((cone.rays.shape, coms.shape))
        return real(cone, coms, *rest, **options)

    monkeypatch.setattr(jaxcap, "score", spy)
    scorer = OwnContacts()
    for n, k in ((N, 8), (7, 4)):
        few = {name: x[:n, :k] for name, x in ARRAYS.items()}
        coms, velocities = (x[:n].astype(np.float32) for x in (COMS, VELOCITIES))
        out, _ = scorer.score(from_arrays(few, np.dtype(np.float32)), coms, velocities)
        assert len(out.margin) == n
    assert shapes == [((N, 32, 6), (N, 3))] * 2


@pytest.mark.parametrize("many", [1, 9, 10**6])
def test_both_forms_score_the_same(x64, monkeypatch, many):
    monkeypatch.setattr(contact_rows, "MANY", many)
    scorer = SharedSets(SETS)
    out, bad = scorer.score(chosen(NUMBERS), COMS, VELOCITIES)
    counts = np.bincount(NUMBERS, minlength=4)
    assert set(scorer._cones) == set(np.flatnonzero(counts >= many).tolist()) and not bad.rows.any()
    assert (out.case[NUMBERS == 2] == Case.EMPTY).all() and out.capturable[NUMBERS == 1].any()
    own = jax.tree.map(lambda *leaves: np.stack(leaves), *(SETS[i].padded(8) for i in NUMBERS))
    assert_close(out, jax.device_get(jaxcap.score(jaxcap.cone_rays(own), COMS, VELOCITIES)), 1e-7)


def test_faces_are_projected_once(x64, monkeypatch):
    seen, real = [], jaxcap.centroidal_cone
    monkeypatch.setattr(contact_rows, "MANY", 1)
    monkeypatch.setattr(jaxcap, "centroidal_cone", lambda *given: seen.append(1) or real(*given))
    scorer = SharedSets(SETS)
    for _ in range(2):
        scorer.score(chosen(NUMBERS), COMS, VELOCITIES)
    assert len(seen) == 3  # the empty set needs none


def test_a_set_without_faces_is_scored_by_rays(x64, monkeypatch):
    def fail(*_):
        raise ProjectionError("no")

    expected, _ = SharedSets(SETS).score(chosen(NUMBERS), COMS, VELOCITIES)
    monkeypatch.setattr(contact_rows, "MANY", 1)
    monkeypatch.setattr(jaxcap, "centroidal_cone", fail)
    out, _ = SharedSets(SETS).score(chosen(NUMBERS), COMS, VELOCITIES)
    assert_close(out, expected)


@pytest.mark.parametrize("many", [1, 10**6])
def test_rows_without_a_set_cost_no_other_row(x64, monkeypatch, many):
    monkeypatch.setattr(contact_rows, "MANY", many)
    expected, _ = SharedSets(SETS).score(chosen(NUMBERS), COMS, VELOCITIES)
    wrong = NUMBERS.copy()
    wrong[[3, 17]] = 9
    out, bad = SharedSets(SETS).score(chosen(wrong), COMS, VELOCITIES)
    assert np.flatnonzero(bad.rows).tolist() == [3, 17] and bad.first == 3
    assert (out.status[[3, 17]] == Status.NONFINITE).all() and (out.case[[3, 17]] == Case.UNDECIDED).all()
    rest = ~bad.rows
    assert_close(*(jax.tree.map(lambda x: x[rest], one) for one in (out, expected)))


def test_no_row_chooses_a_set_that_there_is(x64):
    nowhere = RowChoices(np.full(N, 9), None, np.zeros(N, dtype=bool))
    out, bad = SharedSets(SETS).score(nowhere, COMS, VELOCITIES)
    assert bad.rows.all() and (out.status == Status.NONFINITE).all()


def test_no_rows():
    none = np.zeros((0, 3), np.float32)
    contacts = from_arrays({name: x[:0] for name, x in ARRAYS.items()}, np.dtype(np.float32))
    for out, bad in (OwnContacts().score(contacts, none, none), SharedSets(SETS).score(chosen(NUMBERS[:0]), none, none)):
        assert out.margin.shape == (0,) and bad.rows.shape == (0,)


def test_a_file_of_one_set_is_set_zero_without_a_name(tmp_path):
    one = read_contact_sets(write_contacts(tmp_path / "a.json"))
    scorer = SharedSets(*one)
    assert scorer.choose(chosen(np.array([0, 0])))[1].first is None
    assert scorer.choose(chosen(np.array([0, 1])))[1].why == "contact_set = 1 (expected 0 to 0)"
    assert "no set has" in scorer.choose(chosen(np.array(["left"])))[1].why
