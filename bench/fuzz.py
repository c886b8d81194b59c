"""Faces against rays on contact sets of every kind, and linear programs as the judge where they differ.

    python -m bench.fuzz [--seed S] [--sets N] [--states-per-set M] [--dtype float64 float32] [--kinds ...] [--json OUT]

Every kind in turn, `bench.fuzz_kinds` says which; the same seed draws the same sets and states in both precisions, rounded
to each. Both forms answer every state. Counted are, kind by kind:

    states, sets       where both forms were asked
    differ             states with two verdicts, unless both margins are within the band: 1e-6 of the speed in double
                       precision, 1e-3 in single
    limits             states with one verdict, but a largest or smallest speed that differs by more than twice the band (of
                       it, or of the speed of a fall over the state's size): at the speed in the middle of the two, the forms
                       claim different verdicts
    agreed             states where the forms agree that were judged all the same, one in every tenth set
    wrong faces, rays  claims, of those above, that `bench.fuzz_judge` finds true of no state within rounding of the state
    unjudged           states where the judge found no answer
    left               states that were not judged, as they were more than --judge of their kind and sort
    undecided          states that a form does not decide
    refused            contact sets that `centroidal_cone` refuses, and which get no faces

Ends with status 1 if a claim is wrong or not judged, a projection refused, or more states undecided than 1 in 10^6 in double
and 1 in 10^5 in single precision. An interrupt prints the table so far. --json OUT saves failing states with their contacts,
at most --keep of each kind and sort.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter, defaultdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxcap
from bench.fuzz_judge import BAND, capturable, sizes, state_of, true_of_some
from bench.fuzz_kinds import CONTACTS, KINDS, Sample, draw
from reference.contacts import GRAVITY

UNDECIDED = {"float64": 1e-6, "float32": 1e-5}
"""Share of states that may be undecided."""
FACES = tuple(32 * 4**k for k in range(6))
"""Faces are padded to these numbers, and rays to RAYS: a program is compiled for each."""
RAYS = (32, 64, 128)
TOGETHER = 32
"""Contact sets whose states are scored by rays in one call."""
FASTEST = 1e3
"""Limits above it are as good as infinite [m/s]."""
CHECKED = 10
"""One agreed state is judged in every so many sets."""
EVERY = 10.0
"""Seconds between lines of progress."""
FIELDS = ("capturable", "case", "status", "margin", "min_speed", "max_speed", "paper_margin", "distance", "time")
COLUMNS = (
    "states", "sets", "differ", "limits", "agreed", "wrong faces", "wrong rays", "unjudged", "left",
    "undecided faces", "undecided rays", "refused",
)  # fmt: skip


class Claims(NamedTuple):
    """What one form says of the states of a set; arrays (n,) of NumPy."""

    fields: dict[str, np.ndarray]

    def __getattr__(self, name: str) -> np.ndarray:
        try:
            return self.fields[name]
        except KeyError:
            raise AttributeError(name) from None

    @property
    def decided(self) -> np.ndarray:
        """Whether there is a verdict."""
        return ~np.isin(self.status, (jaxcap.Status.MAX_STEPS, jaxcap.Status.NONFINITE))

    def at(self, row: int, speed: float | None) -> bool:
        """The verdict on a state, at its own speed or another [m/s]."""
        if speed is None:
            return bool(self.capturable[row])
        return bool(self.max_speed[row] > 0 and self.min_speed[row] <= speed <= self.max_speed[row])

    def of(self, row: int) -> dict[str, float | None]:
        """The fields of one state, for JSON."""
        values = {name: float(values[row]) for name, values in self.fields.items()}
        plain = lambda value: value if np.isfinite(value) else None if np.isnan(value) else str(value)
        return {name: plain(value) for name, value in values.items()}


def claims(answer) -> Claims:
    """Of an answer of `score`."""
    return Claims({name: np.asarray(getattr(answer, name)) for name in FIELDS})


class Difference(NamedTuple):
    """States of a set on which two forms differ."""

    verdicts: np.ndarray
    """Rows with two verdicts."""
    limits: list[tuple[int, float]]
    """Rows with one verdict, and a speed at which there would be two [m/s]."""


def difference(faces: Claims, rays: Claims, speeds: np.ndarray, falls: np.ndarray, band: float) -> Difference:
    """Where the forms differ outside the band; speeds, falls: of the states, and of a fall over their size (n,) [m/s]."""
    both = faces.decided & rays.decided
    with np.errstate(invalid="ignore"):
        far = np.maximum(np.abs(faces.margin), np.abs(rays.margin)) > band * speeds
        differ = both & (faces.capturable != rays.capturable) & far
        limits = []
        for name in ("max_speed", "min_speed"):
            one, other = (np.minimum(getattr(form, name).astype(float), FASTEST) for form in (faces, rays))
            least = np.minimum(one, other)
            scale = np.maximum(least, np.maximum(speeds, falls))
            apart = np.abs(one - other) > 2 * band * scale
            for row in np.flatnonzero(both & ~differ & apart):
                speed = float(one[row] + other[row]) / 2
                if faces.at(row, speed) != rays.at(row, speed):
                    limits.append((int(row), speed))
    return Difference(np.flatnonzero(differ), limits)


class Scorer:
    """Both forms of a contact set, batched such that few programs are compiled."""

    def __init__(self, dtype: str):
        self.dtype = dtype
        self.rays_of = jax.jit(jaxcap.cone_rays, static_argnames="sides")

    def faces(self, sample: Sample) -> Claims | None:
        """By faces; None if the projection is refused."""
        try:
            cone = jaxcap.centroidal_cone(contacts_of(sample), sample.sides)
        except ValueError:
            return None
        cone = cone.padded(next(size for size in FACES if size >= len(cone.faces)))
        return claims(jaxcap.score(cone, *self._states([sample], 1)))

    def rays(self, samples: list[Sample], size: int) -> list[Claims]:
        """By rays, padded to `size` of them: one call for up to TOGETHER sets of equally many states."""
        n = len(samples[0].coms)
        cones = [self._cone(sample, size) for sample in samples]
        cones += cones[:1] * (TOGETHER - len(cones))
        own = jax.tree.map(lambda *leaves: np.repeat(np.stack(leaves), n, axis=0), *cones)
        answer = claims(jaxcap.score(own, *self._states(samples, TOGETHER)))
        part = lambda i: Claims({name: values[i * n : (i + 1) * n] for name, values in answer.fields.items()})
        return [part(i) for i in range(len(samples))]

    def _states(self, samples: list[Sample], sets: int):
        filled = samples + samples[:1] * (sets - len(samples))
        return (np.concatenate([getattr(s, f) for s in filled]).astype(self.dtype) for f in ("coms", "velocities"))

    def _cone(self, sample: Sample, size: int) -> jaxcap.ConeRays:
        cone = self.rays_of(contacts_of(sample).padded(CONTACTS), sides=sample.sides)
        rays, mask = np.asarray(cone.rays)[:size], np.asarray(cone.mask)[:size]
        extra = size - len(rays)
        return cone._replace(rays=np.pad(rays, ((0, extra), (0, 0))), mask=np.pad(mask, (0, extra)))


def contacts_of(sample: Sample) -> jaxcap.ContactSet:
    """The contacts of a sample."""
    return jaxcap.ContactSet(sample.points, sample.frames, sample.friction)


class Report:
    """Counts by kind, and the states that failed."""

    def __init__(self, dtype: str, judged: int, kept: int):
        self.dtype, self.judged, self.kept = dtype, judged, kept
        self.counts: dict[str, Counter] = defaultdict(Counter)
        self.sorts: Counter = Counter()
        self.failures: list[dict[str, Any]] = []

    def refused(self, sample: Sample) -> None:
        """A set without faces."""
        self.counts[sample.kind]["refused"] += 1
        self._keep(sample, 0, "refused")

    def compare(self, sample: Sample, faces: Claims | None, rays: Claims) -> None:
        """Count, and judge what differs."""
        count = self.counts[sample.kind]
        for name, form in (("faces", faces), ("rays", rays)):
            rows = np.flatnonzero(~form.decided) if form is not None else ()
            count[f"undecided {name}"] += len(rows)
            for row in rows:
                self._keep(sample, row, f"undecided {name}", faces, rays)
        if faces is None:
            return
        count["states"] += len(sample.coms)
        count["sets"] += 1
        falls = np.sqrt(2 * np.linalg.norm(GRAVITY) * sizes(sample))
        found = difference(faces, rays, np.linalg.norm(sample.velocities, axis=1), falls, BAND[self.dtype])
        for row in found.verdicts:
            self._judge("differ", sample, row, None, faces, rays)
        for row, speed in found.limits:
            self._judge("limits", sample, row, speed, faces, rays)
        if sample.index // len(KINDS) % CHECKED == 0:
            differing = [*found.verdicts, *(row for row, _ in found.limits)]
            alike = np.setdiff1d(np.flatnonzero(faces.decided & rays.decided), differing)
            for row in np.random.default_rng(sample.index).permutation(alike)[:1]:
                if faces.capturable[row] == rays.capturable[row]:
                    self._judge("agreed", sample, row, None, faces, rays)

    def _judge(self, what: str, sample: Sample, row: int, speed: float | None, faces: Claims, rays: Claims) -> None:
        count = self.counts[sample.kind]
        count[what] += 1
        if what != "agreed" and count[what] > self.judged:
            count["left"] += 1
            return
        state = state_of(sample, row, self.dtype, speed)
        said = {"faces": faces.at(row, speed), "rays": rays.at(row, speed)}
        true = {claim: true_of_some(state, claim) for claim in set(said.values())}
        wrong = [name for name, claim in said.items() if true[claim] is False]
        unknown = None in true.values()
        count["unjudged"] += unknown
        for name in wrong:
            count[f"wrong {name}"] += 1
        if wrong or unknown:
            sort = f"{what}, " + (f"wrong {' and '.join(wrong)}" if wrong else "unjudged")
            self._keep(sample, row, sort, faces, rays, speed=speed, reference=capturable(state))

    def _keep(self, sample: Sample, row: int, what: str, faces=None, rays=None, **more) -> None:
        self.sorts[sample.kind, what] += 1
        if self.sorts[sample.kind, what] > self.kept:
            return
        arrays = {name: getattr(sample, name).tolist() for name in ("points", "frames", "friction")}
        state = {"com": sample.coms[row].tolist(), "com_velocity": sample.velocities[row].tolist()}
        says = {f"{n}_say": form.of(row) for n, form in (("faces", faces), ("rays", rays)) if form is not None}
        name = f"fuzz_{sample.index}_{row}_{sample.kind}_{self.dtype}".replace(" ", "_")
        head = {"name": name, "kind": sample.kind, "what": what, "dtype": self.dtype, "sides": sample.sides}
        self.failures.append(head | arrays | state | more | says)

    def totals(self) -> Counter:
        """Over all kinds."""
        return sum((Counter(count) for count in self.counts.values()), Counter())

    def failed(self) -> bool:
        """Whether the goals are missed."""
        total = self.totals()
        most = UNDECIDED[self.dtype] * total["states"]
        bad = total["wrong faces"] + total["wrong rays"] + total["unjudged"] + total["left"] + total["refused"]
        return bad > 0 or total["undecided faces"] > most or total["undecided rays"] > most

    def table(self) -> str:
        """A line for each kind, and the totals."""
        widths = [max(len(name), 8) + 2 for name in COLUMNS]
        line = lambda first, values: f"{first:15}" + "".join(f"{v:>{w}}" for v, w in zip(values, widths, strict=True))
        rows = [line(kind, [count[name] for name in COLUMNS]) for kind, count in self.counts.items()]
        total = self.totals()
        return "\n".join([line(self.dtype, COLUMNS), *rows, line("total", [total[name] for name in COLUMNS])])


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)


def run(dtype: str, options: argparse.Namespace, report: Report, save) -> None:
    """All sets in one precision; save() is called now and then."""
    scorer, start = Scorer(dtype), time.monotonic()
    waiting: dict[int, list[tuple[Sample, Claims | None]]] = defaultdict(list)
    said = start

    def flush(size: int) -> None:
        samples = waiting.pop(size, [])
        if samples:
            answers = scorer.rays([sample for sample, _ in samples], size)
            for (sample, faces), rays in zip(samples, answers, strict=True):
                report.compare(sample, faces, rays)
            save()

    for i in range(options.first, options.first + options.sets):
        sample = draw(options.seed, i, options.kinds[i % len(options.kinds)], options.states_per_set).rounded(dtype)
        faces = scorer.faces(sample)
        if faces is None:
            report.refused(sample)
        size = next(size for size in RAYS if size >= len(sample.points) * sample.sides)
        waiting[size].append((sample, faces))
        if len(waiting[size]) == TOGETHER:
            flush(size)
        if time.monotonic() - said > EVERY or i == options.first:
            said, total = time.monotonic(), report.totals()
            wrong = f"differ {total['differ']}, wrong {total['wrong faces']} + {total['wrong rays']}"
            undecided = f"undecided {total['undecided faces']} + {total['undecided rays']}"
            _say(f"{dtype}: set {i + 1 - options.first} of {options.sets}, {said - start:.0f} s: {wrong}, {undecided}")
    for size in RAYS:
        flush(size)


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print; the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m bench.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    whole = partial(parser.add_argument, type=int, metavar="N")
    whole("--seed", default=0, help="(default: 0)")
    whole("--sets", default=5000, help="contact sets (default: 5000)")
    whole("--first", default=0, help="number of the first set: a run can be continued, or cut in parts (default: 0)")
    whole("--states-per-set", default=256, help="(default: 256)")
    whole("--judge", default=100, help="states of a kind and sort that are judged at most (default: 100)")
    whole("--keep", default=3, help="states of a kind and sort that are saved (default: 3)")
    parser.add_argument("--dtype", nargs="+", choices=list(BAND), default=list(BAND), help="(default: both)")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS), metavar="KIND", help="(default: all)")
    parser.add_argument("--json", type=Path, metavar="OUT", help="where failing states are saved")
    options = parser.parse_args(arguments)
    if options.sets < 1 or options.states_per_set < 1:
        parser.error("--sets and --states-per-set: expected at least 1")
    _say(f"jaxcap: {Path(jaxcap.__file__).parent}, seed {options.seed}; the first sets compile")
    reports, interrupted = [], False

    def save() -> None:
        if options.json is not None:
            failures = [failure for report in reports for failure in report.failures]
            options.json.write_text("[\n" + ",\n".join(map(json.dumps, failures)) + "\n]\n")

    for dtype in options.dtype:
        reports.append(Report(dtype, options.judge, options.keep))
        try:
            with jax.enable_x64(dtype == "float64"):
                run(dtype, options, reports[-1], save)
        except KeyboardInterrupt:
            interrupted = True
        print(f"\n{reports[-1].table()}\n", flush=True)
        save()
        if interrupted:
            return 130
    return int(any(report.failed() for report in reports))


if __name__ == "__main__":
    sys.exit(main())
