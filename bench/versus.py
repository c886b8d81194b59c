"""`jaxcap.score` against other software on the same states: ratios, agreement of verdicts, reasons where they disagree."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxcap
from bench import disagreements, peers
from bench.stances import batch
from bench.throughput import cone_of
from bench.timing import in_turn, ratio

SETS = ("coplanar feet", "tilted feet", "talos_hand_on_wall", "talos_slopes_and_rail", "4 random rectangles")


def line(modules, name: str, dtype: str, options) -> tuple[dict, dict]:
    """A line of the table of peers, and one of reasons for disagreements."""
    few = options.peer_states
    states = batch(name, options.batch)
    states = states._replace(contacts=peers.with_their_tangents(states.contacts))
    shown, cone = states.first(few), jaxcap.centroidal_cone(states.contacts, peers.SIDES)
    placed = cone_of("face", states, peers.SIDES, dtype)
    coms, velocities = (jnp.asarray(x, dtype) for x in states[2:])
    calls = {"ours": lambda: jaxcap.score(placed, coms, velocities), **peers.beziers(modules, shown)}
    calls |= {"LP": peers.static(modules, shown), "paper": peers.paper(shown)}
    calls |= {"our faces": lambda: jaxcap.centroidal_cone(states.contacts, peers.SIDES)}
    calls |= {"cdd": lambda: peers.equilibrium(modules, states.contacts, "PP")}
    timed = in_turn(calls, options.rounds)
    asked = [which for which in calls if which not in ("ours", "our faces", "cdd")]
    ratios = {f"x {which}": ratio(timed[which], timed["ours"]) * len(coms) / few for which in asked}
    micro = {f"{which} us": 1e6 * timed[which].best / few for which in asked}
    faces = {"faces": len(cone.faces), "cdd ms": 1e3 * timed["cdd"].best, "ours ms": 1e3 * timed["our faces"].best}
    first = jax.tree.map(lambda x: np.asarray(x)[:few], timed["ours"].answer)
    still = np.asarray(jaxcap.score(placed, coms[:few], jnp.zeros_like(coms[:few])).capturable)
    durations = timed["bezier all"].answer
    verdicts = disagreements.reasons(modules, shown, cone, first, durations)
    agreement = {
        "contacts": states.name,
        "states": few,
        "bezier %": _share(np.isfinite(timed["bezier"].answer), first.capturable),
        "all %": _share(np.isfinite(durations), first.capturable),
        "LP %": _share(timed["LP"].answer, still),
        **verdicts,
    }
    return {**ratios, "contacts": states.name, "states/s": len(coms) / timed["ours"].best, **micro, **faces}, agreement


def _share(a, b) -> float:
    """Share of equal verdicts [%]."""
    return 100 * float(np.mean(np.asarray(a) == np.asarray(b)))
