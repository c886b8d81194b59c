"""`score`: any number of states, in order, bad rows alone, the same as one at a time."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap
import jaxcap.batch.score
from jaxcap import Case, Status
from jaxcap.batch.blocks import BLOCK, LANES, SMALL_BLOCK, padded_cone
from jaxcap.batch.rounds import unsettled

FEET = jaxcap.rectangle([0, 0.1, 0], np.eye(3), 0.1, 0.05, 0.5) + jaxcap.rectangle([0, -0.1, 0], np.eye(3), 0.1, 0.05, 0.5)
CONE = jaxcap.centroidal_cone(FEET)


def states(n, seed=0):
    rng = np.random.default_rng(seed)
    coms = rng.uniform([-0.3, -0.3, 0.4], [0.3, 0.3, 1.2], (n, 3)).astype(np.float32)
    return coms, rng.uniform(-1, 1, (n, 3)).astype(np.float32)


@pytest.mark.parametrize("n", [0, 1, LANES - 1, LANES, LANES + 1, BLOCK - 1, BLOCK + 1])
def test_every_state_is_answered_in_its_place(n):
    """A batch of any size equals the beginning of a larger one, bit for bit."""
    coms, velocities = states(BLOCK + 100)
    every = jaxcap.score(CONE, coms, velocities)
    some = jaxcap.score(CONE, coms[:n], velocities[:n])
    for field, whole in zip(some, every, strict=True):
        assert field.shape == (n,)
        np.testing.assert_array_equal(field, whole[:n])


ANY_ROWS = (1, 2, 500, 501, 1500, 4096, 100_000)
"""Numbers of rows, of which users meet any."""


@pytest.fixture
def compiled():
    """How long XLA took for each program since this list was cleared."""
    seconds = []

    def listen(name, duration, **_):
        if name.endswith("backend_compile_duration"):
            seconds.append(duration)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield seconds
    jax.monitoring.unregister_event_duration_listener(listen)


def meets_two_programs(call, compiled):
    """call(n) scores n rows. No number of rows compiles anything, however small, that 1 and 100,000 have not."""
    before = jaxcap.batch.score._compiled.jitted._cache_size()
    for n in (min(ANY_ROWS), max(ANY_ROWS)):
        call(n)
    assert jaxcap.batch.score._compiled.jitted._cache_size() - before <= 2
    compiled.clear()
    for n in ANY_ROWS:
        call(n)
    assert not compiled


def test_any_number_of_rows_meets_two_programs(compiled):
    coms, velocities = states(max(ANY_ROWS))
    meets_two_programs(lambda n: jaxcap.score(CONE, coms[:n], velocities[:n]), compiled)


def test_the_same_holds_of_arrays_on_the_device(compiled):
    """But for the cuts that the caller makes."""
    rows = {n: tuple(map(jnp.asarray, states(n))) for n in ANY_ROWS}
    meets_two_programs(lambda n: jaxcap.score(CONE, *rows[n]), compiled)


def test_any_number_of_rows_with_contacts_of_their_own_meets_two_programs(compiled):
    rays = jax.tree.map(np.asarray, jaxcap.cone_rays(FEET))
    own = jax.tree.map(lambda x: np.broadcast_to(x, (max(ANY_ROWS), *x.shape)), rays)
    coms, velocities = states(max(ANY_ROWS))
    of_first = lambda n: jax.tree.map(lambda x: x[:n], own)
    meets_two_programs(lambda n: jaxcap.score(of_first(n), coms[:n], velocities[:n]), compiled)


@pytest.mark.parametrize("n", [SMALL_BLOCK - 1, SMALL_BLOCK, SMALL_BLOCK + 1])
def test_one_more_row_than_the_small_block_holds(n):
    coms, velocities = states(n)
    every, last = jaxcap.score(CONE, coms, velocities), jaxcap.score(CONE, coms[-1:], velocities[-1:])
    np.testing.assert_array_equal(every.margin[-1:], last.margin)
    assert every.margin.shape == (n,) and not np.isnan(every.margin).any()


@pytest.mark.parametrize("n", [1, 100, BLOCK, 1 << 20])
def test_what_is_left_is_sorted_by_kind_and_slope(n):
    """Every unsettled state once, those with the same left together, the steepest falls first, whatever the slopes."""
    rng = np.random.default_rng(4)
    left = rng.integers(0, 8, n).astype(np.int8)
    slope = rng.normal(scale=10, size=n).astype(np.float32)
    odd = rng.random(n) < 0.1
    slopes = np.where(odd, rng.choice([np.nan, np.inf, -np.inf], n), slope).astype(np.float32)
    order, count = unsettled(jnp.asarray(left), jnp.asarray(slopes), LANES)
    assert len(order) % LANES == 0 and count == (left > 0).sum()
    order = np.asarray(order)[:count]
    np.testing.assert_array_equal(np.sort(order), np.flatnonzero(left))
    assert (np.diff(left[order]) >= 0).all()
    if n == BLOCK:
        regular = order[~odd[order]]
        same = np.diff(left[regular]) == 0
        assert (np.diff(slope[regular])[same] > -0.1 * (1 + np.abs(slope[regular][1:][same])) ** 2).all()


def test_fields_have_their_types():
    answer = jaxcap.score(CONE, *states(10))
    assert answer.capturable.dtype == bool
    assert answer.case.dtype == answer.status.dtype == np.int8
    assert {getattr(answer, name).dtype for name in answer._fields[3:]} == {np.dtype(np.float32)}


@pytest.mark.parametrize("kinds", [("f4", "f4"), ("f4", "f8"), ("f8", "f8")])
def test_no_state_is_answered_with_the_types_of_some_and_compiles_nothing(kinds, x64):
    coms, velocities = (np.zeros((1, 3), kind) for kind in kinds)
    some = jax.eval_shape(lambda *states: jaxcap.score(CONE, *states), coms, velocities)
    programs = jaxcap.batch.score._compiled.jitted._cache_size()
    for cone in (CONE, jaxcap.cone_rays(FEET)):
        none = jaxcap.score(cone, coms[:0], velocities[:0])
        assert [(x.shape, x.dtype) for x in none] == [((0,), x.dtype) for x in some]
    assert jax.jit(jaxcap.score)(CONE, coms[:0], velocities[:0]).margin.shape == (0,)
    assert jaxcap.batch.score._compiled.jitted._cache_size() == programs


def test_up_to_four_contacts_share_a_program_by_rays():
    """Up to sixteen rays, as up to sixteen faces: contacts change from row to row of a log. The padding bears nothing."""
    points = np.array([[0.1, 0.1, 0], [0.1, -0.1, 0], [-0.1, 0.1, 0], [-0.1, -0.1, 0.02]])
    several = [jaxcap.cone_rays(jaxcap.ContactSet(points[:k], np.eye(3), 0.5)) for k in (1, 2, 3, 4)]
    for cones in (several, [jax.tree.map(lambda leaf: jnp.stack([leaf] * 3), cone) for cone in several]):
        padded = [padded_cone(cone) for cone in cones]
        assert len({tuple((leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(cone)) for cone in padded}) == 1
        for given, cone in zip(cones, padded, strict=True):
            rows = given.rays.shape[-2]
            np.testing.assert_array_equal(cone.rays[..., :rows, :], given.rays)
            assert not np.any(cone.rays[..., rows:, :]) and not np.any(cone.mask[..., rows:])


def test_one_bad_row_costs_no_other():
    coms, velocities = states(200)
    good = jaxcap.score(CONE, coms, velocities)
    coms[17, 1], velocities[40, 2], velocities[90] = np.nan, np.inf, 0
    answer = jaxcap.score(CONE, coms, velocities)
    assert answer.status[17] == answer.status[40] == Status.NONFINITE
    assert answer.case[17] == answer.case[40] == Case.UNDECIDED
    assert answer.status[90] == Status.NO_DIRECTION
    others = np.delete(np.arange(200), [17, 40, 90])
    for one, other in zip(answer, good, strict=True):
        np.testing.assert_array_equal(np.asarray(one)[others], np.asarray(other)[others])


def test_double_precision_reaches_every_block():
    """Blocks run in threads, and JAX keeps its x64 switch by thread."""
    coms, velocities = (x.astype(np.float64) for x in states(2 * BLOCK + 5))
    with jax.enable_x64(True):
        answer = jaxcap.score(CONE, coms, velocities)
        last = jaxcap.score(CONE, coms[-LANES:], velocities[-LANES:])
    assert answer.margin.dtype == np.float64
    np.testing.assert_allclose(answer.margin[-LANES:], last.margin, rtol=1e-12)


def test_lists_and_whole_numbers_are_taken():
    answer = jaxcap.score(CONE, jnp.array([[0, 0, 1]]), jnp.array([[0, 0, 1]]))
    assert answer.capturable.all()
    assert answer.margin.dtype == np.float32


def test_gradient_through_score():
    coms, velocities = states(5)
    total = lambda velocities: jnp.sum(jaxcap.score(CONE, coms, velocities).margin)
    one = jax.jit(jax.vmap(jax.grad(lambda com, velocity: jaxcap.capturability(CONE, com, velocity).margin, argnums=1)))
    slopes = jax.jit(jax.grad(total))(jnp.asarray(velocities))
    np.testing.assert_allclose(slopes, one(coms, velocities), rtol=1e-3, atol=1e-3)


def test_importing_costs_no_extra():
    """The core alone: no reader, plotter, robot or command line is imported with it; the x64 switch stays as it is."""
    program = (
        "import sys, jaxcap, jax; heavy = {'pyarrow', 'matplotlib', 'pinocchio', 'tyro', 'tqdm', 'yaml', 'scipy'};"
        "heavy &= set(sys.modules); assert not heavy, heavy; assert not jax.config.jax_enable_x64"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
