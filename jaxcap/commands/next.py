"""`jaxcap next`: parse, call, write. Importing this module needs tyro (extra `cli`)."""

import json
import sys
import time
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import numpy as np
import tyro

from jaxcap.commands.compile_cache import compilation_cache
from jaxcap.commands.limb_options import LimbOptions
from jaxcap.commands.options import check_mass, check_momentum_box, check_sides, without_mass
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.conventions import GRAVITY
from jaxcap.contacts.surfaces import Candidates, candidates_on
from jaxcap.errors import InputError
from jaxcap.files.contact_files import read_contacts
from jaxcap.files.records import read_states
from jaxcap.files.surface_files import read_surfaces
from jaxcap.files.whole_file import check_output, whole_file
from jaxcap.regions.next_contact import NextContacts, next_contacts
from jaxcap.version import __version__

NEXT = """Find the next contact: where a hand or foot must go so that a robot stops.

EXAMPLES
  jaxcap next pushed.parquet --contacts feet.yaml --surfaces room.yaml \\
      --delay 0.3 -o next.npz
  jaxcap next pushed.parquet --contacts feet.yaml --surfaces room.yaml \\
      --limb 0.2 0.3 0.9 --limb-speed 2 --reaction 0.1 -o next.npz

WHAT IS ASKED
  Until the new contact bears, the robot brakes as hard as its present contacts
  allow; then: can it stop with the new one? Contacts bear whatever friction
  allows, arms do not: the answer ranks the places, and rules out those that do
  not help.

STATES and CONTACTS are those of jaxcap score; one contact set for all states.
  A column specific_angular_momentum counts, as it does there, and with --mass
  a column angular_momentum. What the robot may do besides is --momentum-box.

DELAY
  One for all places (--delay), or for each its distance from --limb over
  --limb-speed, after --reaction. With --limb-root and --limb-length, places
  farther from hip or shoulder than that are out of reach.

SURFACES is YAML (.yaml, .yml) or JSON (.json), in the frame of the contacts:
    surfaces:
      - type: plane              # a floor, a wall, a slope
        position: [0.8, 0, 1]    # centre [m]
        rotation: [[0, 0, -1], [0, 1, 0], [1, 0, 0]]
        half_length: 1           # along the first column of the rotation [m]
        half_width: 0.7          # along the second column [m]
        friction: 0.6
      - type: rail
        start: [0, 0.7, 0.9]
        end: [1, 0.7, 0.9]
        normal: [0, 0, 1]        # from where it is pressed on
        half_width: 0.03
        friction: 0.6
      - type: box
        position: [1, 0, 0.4]
        half_sizes: [0.3, 0.4, 0.4]
        friction: 0.5
      - type: height_field       # uneven ground
        heights: [[0, 0.1], [0, 0.2]]  # [m], rows along y; or a file's name
        origin: [0, -0.5, 0]     # of the first height [m]
        spacing: 1               # between heights, along x and y [m]
        friction: 0.6
  The third column of a rotation is the normal, pointing at the robot. A file of
  heights is .npy, or .npz with an array "heights". A grid of places, SPACING
  apart, is tried on all of them.

OUT is NPZ (.npz), for n states and m places:
    centres         (m, 3)  of the places [m]
    normals         (m, 3)
    surface         (m,)    which surface of the file; a box counts as six
    delay           (m,)    until a contact there bears [s]
    reachable       (m,)    whether it is in reach
    best            (n,)    the best place of each state, -1 where none has one
    margin          (n, m)  with a contact there [m/s]; NaN where there is none
    margin_without  (n, m)  without it
    capturable      (n, m)  whether the model can stop with it
    progress        (n, m)  how the robot comes to touchdown: 0 moving, 1 at
                            rest, 2 turned back, 3 contacts lost, 4 flying
    status          (n, m)  as that of jaxcap score
    metadata                JSON: options, gravity, version

EXIT CODES
  0 done; 2 bad input, and one line says which; 130 interrupted.
"""
"""What `jaxcap next --help` says above the list of options; its first line also stands in `jaxcap --help`."""
WRITTEN = ("best", "margin", "margin_without", "capturable", "progress", "status")
"""Of `NextContacts`."""


def next_contact(
    states: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="STATES")],
    *,
    contacts: Annotated[Path, tyro.conf.arg(metavar="CONTACTS")],
    surfaces: Annotated[Path, tyro.conf.arg(metavar="SURFACES")],
    delay: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None,
    limb: tyro.conf.OmitArgPrefixes[LimbOptions] = LimbOptions(),  # noqa: B008
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT")],
    half_length: float = 0.06,
    half_width: float = 0.05,
    spacing: float = 0.1,
    lifted: tuple[int, ...] = (),
    mass: Annotated[float | None, tyro.conf.arg(metavar="M")] = None,
    momentum_box: Annotated[float, tyro.conf.arg(metavar="BOX")] = 0.0,
    dtype: Literal["float32", "float64"] = "float32",
    sides: int = 4,
    cache: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    no_cache: bool = False,
    force: bool = False,
) -> None:
    """Finds and writes them; see NEXT.

    Raises InputError before anything is computed if an option or a file cannot be used, and MissingExtra.

    Args:
        states: File of states, .parquet, .npz or .csv.
        contacts: File of contacts, .yaml or .json: where the robot stands.
        surfaces: File of surfaces, .yaml or .json: what it may touch.
        delay: Until the new contact bears [s], at all places.
        limb: The same by a model.
        output: File to write, .npz.
        half_length: Of the hand or foot, along a surface's length [m].
        half_width: Along its width [m].
        spacing: Between places that are tried [m], at most.
        lifted: Rows of the contacts, from 0, that bear nothing from now on; a rectangle has four.
        mass: Of the robot [kg]: the column angular_momentum counts then.
        momentum_box: How much the rate of angular momentum over mass may differ, in each component, from what
            braking brings about [m^2/s^2].
        dtype: Precision of the computation and of the figures written.
        sides: Edges of the pyramid that replaces each friction cone, at least 3.
        cache: Keep compiled programs in this directory, not in your cache folder.
        no_cache: Keep none and take none.
        force: Overwrite OUT if it exists.
    """
    check_mass(mass)
    check_momentum_box(momentum_box)
    check_sides(sides)
    if output.suffix.lower() != ".npz":
        raise InputError(f"{output}: unknown extension {output.suffix!r} (expected .npz)")
    check_output(output, force=force, inputs=(states, contacts, surfaces))
    stance = read_contacts(contacts)
    candidates = _candidates(surfaces, half_length, half_width, spacing)
    reach = limb.reach(candidates.contacts, delay)
    start = time.perf_counter()
    with jax.enable_x64(dtype == "float64"), compilation_cache(cache, no_cache):
        options: dict[str, Any] = {
            "delay": reach.delay if delay is None else delay,  # one for all is much faster
            "reachable": reach.reachable,
            "lifted": lifted or None,
            "momentum_box": momentum_box,
            "sides": sides,
        }
        found = _found(states, stance, candidates, mass, dtype, options)
    seconds = time.perf_counter() - start
    metadata = {"delay": delay, "gravity": GRAVITY, "sides": sides, "lifted": lifted, "version": __version__}
    metadata |= limb.given | ({} if mass is None else {"mass": mass})
    metadata |= {"momentum_box": momentum_box} if momentum_box else {}
    figures: dict[str, Any] = {name: getattr(found, name) for name in WRITTEN}
    figures |= {name: figures[name].astype(dtype) for name in ("margin", "margin_without")}
    normals = np.asarray(candidates.contacts.frames)[:, 0, :, 2]
    figures |= {"centres": candidates.centres, "normals": normals, "surface": candidates.surface}
    figures |= reach._asdict()
    with whole_file(output, force=force) as handle:
        np.savez(handle, **figures, metadata=json.dumps(metadata))
    n, m = found.margin.shape
    saved = int(found.capturable.any(axis=1).sum())
    print(f"{output}: {n:,} states, {m:,} places on {surfaces}; {saved:,} states with one after which the model can stop")
    print(f"{n * m / seconds:.3g} pairs/s ({seconds:.2f} s with compiling; {dtype}, {jax.default_backend()})")


def _candidates(path: Path, half_length: float, half_width: float, spacing: float) -> Candidates:
    surfaces = read_surfaces(path)
    try:
        return candidates_on(surfaces, half_length, half_width, spacing)
    except ValueError as error:
        raise InputError(f"--{str(error).replace('_', '-')}") from error


def _found(
    path: Path, stance: ContactSet, candidates: Candidates, mass: float | None, dtype: str, options: dict[str, Any]
) -> NextContacts:
    """Of all states of the file. Raises InputError."""
    rows = max(1, (1 << 20) // len(candidates.surface))
    parts = []
    with read_states(path, rows, np.float64, mass) as source:
        if words := without_mass(source):
            print(f"note: {path}: {words}", file=sys.stderr)
        if source.contacts:
            raise InputError(f"{path}: column {source.contacts[0]!r} gives each row its contacts (expected one set for all)")
        for batch in source:
            state = batch.coms.astype(dtype), batch.com_velocities.astype(dtype)
            options["specific_angular_momentum"] = batch.specific_angular_momenta
            try:
                parts.append(next_contacts(stance, *state, candidates.contacts, **options))
            except ValueError as error:
                raise InputError(f"--{error}") from error
    if not parts:
        raise InputError(f"{path}: no rows (expected at least one state)")
    return jax.tree.map(lambda *fields: np.concatenate(fields), *parts)
