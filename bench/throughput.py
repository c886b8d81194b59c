"""States/s of `jaxcap.score` in one large batch: over two baselines, beside two ceilings, and what the states are."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap
from bench import counts, peers
from bench.stances import Batch, batch
from bench.timing import Ceilings, in_turn, ratio

SETS = (
    ("face", "coplanar feet"),
    ("face", "tilted feet"),
    ("face", "talos_two_feet"),
    ("face", "talos_hand_on_wall"),
    ("face", "talos_slopes_and_rail"),
    ("face", "3 random rectangles"),
    ("face", "4 random rectangles"),
    ("ray", "coplanar feet"),
    ("ray", "4 random rectangles"),
    ("own", "own sets of 2 rectangles"),
    ("own", "own sets of 4 rectangles"),
)
"""Producers and contact sets."""
VMAP = 100_000
"""Most states of the `vmap` baseline: its memory grows with the batch."""
SAMPLE = 4096
"""States whose pieces and pivots are counted."""
BAND = {"float64": 1e-6, "float32": 1e-3}
"""Margins smaller than this are too close for a verdict to be compared [m/s]."""


def cone_of(producer: str, states: Batch, sides: int, dtype: str):
    """The cone of these states, on the device."""
    cone = jaxcap.centroidal_cone(states.contacts, sides) if producer == "face" else jaxcap.cone_rays(states.contacts, sides)
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype if leaf.dtype != bool else bool), cone)


def line(producer: str, name: str, dtype: str, limits: Ceilings, options) -> tuple[dict, dict]:
    """A line of the first table, and of that which says what the states are."""
    n = options.batch if producer == "face" else options.own_batch
    states = batch(name, n)
    cone = cone_of(producer, states, peers.SIDES, dtype)
    coms, velocities = (jnp.asarray(x, dtype) for x in states[2:])
    calls = {"ours": lambda: jaxcap.score(cone, coms, velocities)}
    if producer == "face" and not options.quick:
        plain = jax.jit(jax.vmap(jaxcap.capturability, in_axes=(None, 0, 0)))
        calls["vmap"] = lambda: plain(cone, coms[:VMAP], velocities[:VMAP])
    if producer == "face":
        calls["paper"] = peers.paper(states.first(options.peer_states))
    timed = in_turn(calls, options.rounds)
    ours, few = timed["ours"], min(n, SAMPLE)
    found = counts.work(jax.tree.map(lambda x: x[:few], cone) if producer == "own" else cone, coms[:few], velocities[:few])
    operations, traffic = counts.operations(cone, found), counts.traffic(cone, dtype)
    over = lambda peer, m: ratio(timed[peer], ours) * n / m if peer in timed else np.nan
    line = {
        "x vmap": over("vmap", min(n, VMAP)),
        "x paper": over("paper", min(n, options.peer_states)),
        "producer": producer,
        "contacts": states.name,
        "sides": peers.SIDES,
        "rows": counts.rows(cone),
        "dtype": dtype,
        "batch": n,
        "states/s": n / ours.best,
        "median": n / float(np.median(ours.seconds)),
        "compile s": ours.compiling,
        "flop": operations,
        "bytes": traffic,
        "% flop": 100 * operations * n / ours.best / limits.operations,
        "% bytes": 100 * traffic * n / ours.best / limits.bytes,
    }
    answer = jax.tree.map(np.asarray, ours.answer)
    cases = {case.name: 100 * float(np.mean(answer.case == case)) for case in jaxcap.Case if case >= 0}
    said = {"producer": producer, "contacts": states.name, "capturable %": 100 * float(answer.capturable.mean()), **cases}
    said |= {"pieces": found.pieces, "pivots": found.pivots, "not ok": int(np.sum(answer.status != jaxcap.Status.OK))}
    if "paper" in timed:
        triples = zip(timed["paper"].answer, answer.capturable, answer.margin, strict=False)
        said["differ"] = int(sum(a is not None and a != b and abs(m) > BAND[dtype] for a, b, m in triples))
    return line, said
