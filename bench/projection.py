"""Projections of random contact sets: how long they take, how many are refused, and how wrong they are. Seeded.

    python -m bench.projection                                  a table, one line a kind of `bench.projection_kinds`
    python -m bench.projection --before OLD/jaxcap/contacts/projection.py --every 5
                                                                the same, and another version of that file in turn with it

    ms          CPU time of `cone_faces` for a set, the mean
    refused     sets for which there is an error in place of faces
    violation   the farthest that any unit ray stands out of any unit face: at most 1e-10 is allowed
    gap         the farthest that any of the wrenches tried is outside the rays' cone though it satisfies all faces. Ten
                wrenches of unit length for each set, near the cone and anywhere, moved onto the cone where they are outside
                of it: distances by least squares, those above 1e-7 judged again in exact arithmetic

"touching edges" is beyond what contact sets are like: in single precision it is chance whether such a cone holds a line.
"""

import argparse
import importlib.util
import time
from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

import jaxcap
from bench.projection_kinds import KINDS, sample
from jaxcap.contacts import projection, rationals
from jaxcap.contacts.friction import wrench_rays

WRENCHES = 10
DOUBTFUL = 1e-7
"""A larger distance by least squares is judged again: where large weights cancel, least squares does not find them."""


class Projected(NamedTuple):
    """What became of one set."""

    seconds: float
    faces: np.ndarray | None
    """None where it was refused."""


def unit_rays(contacts: jaxcap.ContactSet, sides: int) -> np.ndarray:
    """As `centroidal_cone` takes them, of unit length."""
    origin = contacts.points.mean(axis=0)
    length = np.linalg.norm(contacts.points - origin, axis=1).max() or 1.0
    rays = np.asarray(wrench_rays(contacts, sides, origin)) / np.array([1, 1, 1, length, length, length])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def projected(module: ModuleType, rays: np.ndarray) -> Projected:
    """One call of this version's `cone_faces`."""
    start = time.process_time()
    try:
        faces = module.cone_faces(rays)
    except module.ProjectionError:
        faces = None
    return Projected(time.process_time() - start, faces)


def gap(rays: np.ndarray, faces: np.ndarray, rng: np.random.Generator) -> float:
    """The largest distance to the rays' cone of wrenches within the faces."""
    middle = rays.mean(axis=0)
    tried = (_within(faces, _wrench(rays, rng), middle) for _ in range(WRENCHES))
    return max((distance(rays, wrench) for wrench in tried if wrench is not None), default=0.0)


def distance(rays: np.ndarray, wrench: np.ndarray) -> float:
    """Of a wrench to the cone of the rays."""
    try:
        near = nnls(rays.T, wrench)[1]
    except RuntimeError:
        near = np.inf
    if near <= DOUBTFUL:
        return float(near)
    return min(float(near), rationals.distance(rays, wrench))


def _wrench(rays: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Near a part of the cone's boundary, or anywhere."""
    some = rng.integers(0, len(rays), rng.integers(1, 7))
    wrench = rng.exponential(size=len(some)) @ rays[some]
    return wrench / (np.linalg.norm(wrench) or 1.0) + rng.normal(size=6) * 10 ** rng.uniform(-7, 1)


def _within(faces: np.ndarray, wrench: np.ndarray, middle: np.ndarray, steps: int = 100) -> np.ndarray | None:
    """The wrench, moved onto the face that it violates most until none is violated; None where it does not get there.

    The last step is towards the cone's middle, as far as it takes: in a cone that is 1e-11 thin, 1e-13 is much.
    """
    wrench = wrench / np.linalg.norm(wrench)
    depths = -(faces @ middle)
    proper = depths > 1e-13  # equalities have no depth
    for _ in range(steps if len(faces) else 0):
        products = faces @ wrench
        worst = products.argmax()
        if products[worst] <= 1e-13:
            break
        wrench = wrench - products[worst] * faces[worst]
    if proper.any():
        wrench = wrench + max(0.0, ((faces @ wrench)[proper] / depths[proper]).max()) * middle
    size = np.linalg.norm(wrench)
    inside = size > 1e-3 and (faces @ wrench).max(initial=0) <= 1e-12
    return wrench / size if inside else None


def line(kind: str, sets: int, seed: int, before: ModuleType | None, every: int) -> dict[str, object]:
    """One line of the table."""
    now, then, violation, open_, single, rays_of = [], [], 0.0, 0.0, 0, []
    for number in range(sets):
        contacts, sides, rounded = sample(kind, seed, number)
        rays = unit_rays(contacts, sides)
        if before is not None and number % every == 0:
            then.append(projected(before, rays))
        now.append(projected(projection, rays))
        single, faces = single + rounded, now[-1].faces
        rays_of.append(len(rays))
        if faces is not None:
            violation = max(violation, float((faces @ rays.T).max(initial=0)))
            open_ = max(open_, gap(rays, faces, np.random.default_rng((seed, number))))
    out: dict[str, object] = {"kind": kind, "sets": sets, "float32": single, "rays": np.mean(rays_of)}
    out |= _summary("", now)
    if then:
        out |= _summary(" before", then) | {"ms there": 1e3 * np.mean([one.seconds for one in now[::every]])}
    return out | {"violation": violation, "gap": open_}


def _summary(name: str, results: list[Projected]) -> dict[str, object]:
    known = [len(one.faces) for one in results if one.faces is not None]
    return {
        f"faces{name}": np.mean(known) if known else np.nan,
        f"ms{name}": 1e3 * np.mean([one.seconds for one in results]),
        f"refused{name}": f"{len(results) - len(known)} of {len(results)}",
    }


def _module(path: str) -> ModuleType:
    """Another version of jaxcap/contacts/projection.py, one that imports nothing of jaxcap."""
    spec = importlib.util.spec_from_file_location("projection_before", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{path}: no Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.1e}" if 0 < abs(value) < 1e-3 else f"{value:.2f}" if value < 100 else f"{value:.0f}"
    return str(value)


def main(arguments: list[str] | None = None, show: Callable[[str], None] = print) -> None:
    """The table."""
    parser = argparse.ArgumentParser(prog="python -m bench.projection", description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=715, help="of each kind (default: 715, 10,010 of the kinds that count)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--before", help="another version of jaxcap/contacts/projection.py, to be run in turn")
    parser.add_argument("--every", type=int, default=1, help="run it on one set of so many")
    chosen = parser.parse_args(arguments)
    before = _module(chosen.before) if chosen.before else None
    header = None
    for kind in chosen.kinds:
        found = line(kind, chosen.sets, chosen.seed, before, chosen.every)
        if header is None:
            header = list(found)
            show("| " + " | ".join(header) + " |\n|" + "---|" * len(header))
        show("| " + " | ".join(_shown(found[name]) for name in header) + " |")


if __name__ == "__main__":
    main()
