"""How fast is jaxcap, how fast are others, what bounds it, and how does cost grow? One command, all tables, and a JSON file.

    python -m bench.speed [--sections throughput peers own growth latency memory] [--json FILE] [--quick]

How to read it. Ratios come first: they are medians over rounds in which all contenders run in turn, so they survive a busy
or a faster machine; states/s, best of the rounds, do not. Compiled functions are waited for to their end, states already on
the device. `compile` is the first call less the best.

    throughput  `jaxcap.score`, all fields, in one large batch, over `vmap`, a plain jax.jit(jax.vmap(jaxcap.capturability)),
                and `paper`, the paper's algorithm one state at a time (see bench/peers.py). `face` is one cone for all
                states, `ray` the rays of one contact set, `own` a contact set for each state. `rows` are faces or rays.
                Operations (`flop`) and bytes of a state are counted by hand (bench/counts.py); `% flop`, `% bytes`: of a
                large matrix product and of a large copy, measured in this run. A second table says what the states are
    peers       on the same contacts, pyramids and states, over the C++ libraries of bench/peers.py; agreement of verdicts,
                and a reason for each disagreement (bench/disagreements.py). Skipped where they are not installed
    own         a contact set for each state, over projections and linear programs; warm starts; pivots (bench/rays.py)
    growth      cost against batch, faces, rays (bench/growth.py)
    latency     one state, NumPy to NumPy [us] (bench/latency.py)
    memory      peak memory against the number of states (bench/memory.py)

Everything is seeded. All of it takes about half an hour on two cores; --quick less than a minute, and proves nothing. Needs
the extras sim, data and cli; memory also maps.
"""

import argparse
import json
import os
import sys
from pathlib import Path

import jax

import jaxcap
from bench import growth, latency, peers, rays, throughput, versus
from bench.timing import ceilings
from jaxcap.files.whole_file import whole_file

SECTIONS = ("throughput", "peers", "own", "growth", "latency", "memory")
QUICK = {
    "batch": 20_000,
    "own_batch": 256,
    "rounds": 1,
    "peer_states": 20,
    "calls": 200,
    "most": 1000,
    "most_states": 100_000,
}
"""What --quick stands for, beside fewer contact sets."""


def table(lines: list[dict]) -> str:
    """Aligned columns."""

    def show(x) -> str:
        if isinstance(x, str) or x is None:
            return x or "-"
        if x != x:
            return "-"
        return f"{x:,.0f}" if abs(x) >= 100 or x == int(x) else f"{x:.1f}" if abs(x) >= 10 else f"{x:.2f}"

    names = list(dict.fromkeys(name for line in lines for name in line))
    cells = [names, *([show(line.get(name)) for name in names] for line in lines)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in cells)


def sections(options):
    """Runs what is asked for; yields the name and the lines of each table when it is there."""
    quick, first = options.quick, slice(1 if options.quick else None)
    if "throughput" in options.sections:
        for dtype in options.dtypes:
            limits = precisely(dtype, ceilings, dtype)
            yield f"ceilings {dtype}", [{"operations/s": limits.operations, "bytes/s": limits.bytes}]
            pairs = [precisely(dtype, throughput.line, *s, dtype, limits, options) for s in throughput.SETS[first]]
            yield f"throughput {dtype}", [line for line, _ in pairs]
            yield f"states {dtype}", [said for _, said in pairs]
    if "peers" in options.sections:
        modules = peers.hpp()
        if modules is None:
            print(f"peers: skipped, the C++ libraries are not there ({peers.INSTALL})\n", flush=True)
        else:
            for dtype in options.dtypes:
                pairs = [precisely(dtype, versus.line, modules, name, dtype, options) for name in versus.SETS[first]]
                yield f"peers {dtype}", [line for line, _ in pairs]
                yield f"verdicts {dtype}", [said for _, said in pairs]
    if "own" in options.sections:
        sizes = options.own_batch, min(options.peer_states, 40), options.rounds
        found = [precisely(dtype, rays.line, k, dtype, *sizes) for dtype in options.dtypes for k in (2, 3, 4)[first]]
        yield "own", found
        kinds = [f"{k} random rectangles" for k in (2, 3, 4)]
        asked = [*((kind, 4) for kind in [*kinds, *rays.KINDS]), *((kind, 8) for kind in kinds)]
        yield "pivots", [precisely("float64", rays.pivots, *kind) for kind in asked[first]]
    if "growth" in options.sections:
        for producer in ("face",) if quick else ("face", "ray"):
            most = options.most if producer == "face" else min(options.most, options.own_batch)
            yield f"batch, {producer}", growth.with_batch(producer, most, options.rounds, "float32")
        yield "faces", growth.with_faces(min(options.batch, 100_000), options.rounds, "float32", growth.FACES[first])
        own = min(options.own_batch, 16_384)
        yield "rays", growth.with_rays(own, options.rounds, "float32", growth.RECTANGLES[first])
    if "latency" in options.sections:
        yield "latency", latency.lines(latency.SETS[first], ("face",) if quick else ("face", "ray"), options.calls)
    if "memory" in options.sections:
        from bench import memory

        yield "memory", memory.lines(options.most_states)


def precisely(dtype: str, function, *arguments):
    """function(*arguments), with JAX's switch for double precision as this dtype needs it. Says on stderr that it begins."""
    print(function.__module__, *(x for x in arguments if isinstance(x, str | int)), file=sys.stderr, flush=True)
    with jax.enable_x64(dtype == "float64"):
        return function(*arguments)


def parse(arguments=None):
    """The options."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.speed", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--sections", nargs="+", choices=SECTIONS, metavar="SECTION", help="(default: all; --quick: throughput, peers)")
    add("--dtypes", nargs="+", choices=("float32", "float64"), default=["float32"], help="(default: float32)")
    add("--batch", type=int, default=1_000_000, help="states on one contact set (default: 10^6)")
    add("--own-batch", type=int, default=131_072, help="states of the ray form, a multiple of 64 (default: 131,072)")
    add("--rounds", type=int, default=5, help="timed calls after the first (default: 5)")
    add("--peer-states", type=int, default=400, help="states for each of the others (default: 400)")
    add("--calls", type=int, default=5000, help="of the latency (default: 5000)")
    add("--most", type=int, default=10_000_000, help="largest batch of `growth` (default: 10^7)")
    add("--most-states", type=int, default=10_000_000, help="most states of `memory` (default: 10^7)")
    add("--inline", action="store_true", help="without JAX's asynchronous dispatch: for one state the shorter way on a CPU")
    add("--json", type=Path, metavar="FILE", help="write all figures to this new file as well")
    add("--quick", action="store_true", help="one contact set, few states and calls")
    options = parser.parse_args(arguments)
    vars(options).update(QUICK if options.quick else {})
    options.sections = options.sections or (("throughput", "peers") if options.quick else SECTIONS)
    sizes = options.batch, options.rounds, options.peer_states, options.calls, options.most, options.most_states
    if min(sizes) < 1 or options.own_batch < rays.STEPS or options.own_batch % rays.STEPS:
        parser.error(f"expected numbers of at least 1, and --own-batch a positive multiple of {rays.STEPS}")
    if options.json and options.json.exists():
        parser.error(f"--json {options.json}: exists already")
    return options


def main(arguments=None) -> None:
    """Parse, measure, print, save."""
    options = parse(arguments)
    if options.inline:
        jax.config.update("jax_cpu_enable_async_dispatch", False)  # before the first device is asked for
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    device = jax.devices()[0]
    about = {"jaxcap": jaxcap.__version__, "jax": jax.__version__, "platform": device.platform, "device": device.device_kind}
    about |= {"machine": machine(), "cores": cores, "rounds": options.rounds, "batch": options.batch}
    about |= {"dispatch": "inline" if options.inline else "asynchronous"}
    print(", ".join(f"{key} {value}" for key, value in about.items()), end="\n\n", flush=True)
    tables = {}
    for name, lines in sections(options):
        tables[name] = lines
        print(f"{name}\n{table(lines)}\n", flush=True)
    if options.json:
        known = lambda line: {name: None if value != value else value for name, value in line.items()}  # JSON has no NaN
        tables = {name: [known(line) for line in lines] for name, lines in tables.items()}
        with whole_file(options.json, force=False) as file:
            file.write((json.dumps({**about, "tables": tables}, indent=1) + "\n").encode())


def machine() -> str:
    """The processor's name, where the system tells."""
    try:
        names = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    except OSError:
        names = []
    return names[0].split(":")[1].strip() if names else "unknown"


if __name__ == "__main__":
    main()
