"""`jaxcap map`: a kernel map from a contacts file. Importing this module needs tyro (extra `cli`)."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import jax
import tyro

from jaxcap.commands.compile_cache import compilation_cache
from jaxcap.commands.options import check_sides, named_values
from jaxcap.commands.where import WHERE, Where, check_where, place_of
from jaxcap.engine import Here, Place, Unit, over_units, shard_of
from jaxcap.errors import InputError
from jaxcap.files.contact_files import read_contact_sets
from jaxcap.maps.contact_axes import Contacts, Mapped, given_sets, with_sets
from jaxcap.maps.grid import axes_around, grid_of

MAP = """Map where a robot can stop: capturability over a grid of states.

EXAMPLES
  jaxcap map feet.yaml -o kernel.zarr
  jaxcap map feet.yaml -o kernel.nc --axis com_z=0.8 --axis heading=0:360deg:144
  jaxcap map feet.yaml -o all.zarr --axis com_x=-0.4:0.4:201 --axis com_y=0 \\
      --axis speed=0:1.5:101 --quantity margin --quantity case
  jaxcap map feet.yaml -o ice.zarr --axis friction=0.05:0.8:31
  jaxcap map --robot talos --posture half_sitting --joints leg -o legs.zarr
  jaxcap map --robot g1 --posture walk.parquet --row 120 -o step.zarr

CONTACTS is YAML or JSON with one set of contacts, or several; see jaxcap score
--help.

A ROBOT
  --robot ROBOT --posture POSTURE, in place of CONTACTS: of a robot that holds
  one posture, whose joints bear only so much. ROBOT is its name, or a URDF or
  MJCF file; POSTURE one of its SRDF file, which stands on level ground, or a
  file that jaxcap states wrote, with --row. Joints between the base and a
  contact count; with --joints NAME, perhaps several times, those whose name
  holds NAME. By faces, or, where there would be more than 50,000 of them, by
  rays, which take several times as long: a note says so. com_z is the CoM's
  height in that posture if not given. The CoM moves, the posture stays.

AXES
  --axis NAME=VALUE, NAME=FIRST:LAST:COUNT (both ends included) or NAME=A,B,C:
    com_x, com_y, com_z     CoM position [m]
    heading                 direction of travel, from x towards y [rad]
    pitch                   the same, above the horizontal [rad]
    speed                   [m/s]
  or, in place of the last three,
    velocity_x, velocity_y, velocity_z   CoM velocity [m/s]
  and, with a speed, 0 if not given,
    specific_angular_momentum_x, _y, _z  angular momentum about the CoM, over
                            the mass [m^2/s]
  and axes along which the contacts change,
    friction                the coefficient of all contacts
    slope                   tilt of all contacts as one body, about a level axis
                            through their centroid [rad]; the CoM stays
    downhill                where the slope goes down [rad]; 0 if not given
    contact_set             numbers of sets in CONTACTS, from 0; all of them if
                            there are several
  All in the frame of the contacts, z up. Angles may be given in degrees:
  heading=0:360deg:72. A range of headings over a full circle leaves out its
  end, which is its beginning.
  Axes that are not given: com_x and com_y from 0.1 m before the contacts to
  0.1 m beyond, 41 values each; com_z 0.8 m above the lowest contact;
  72 headings all around; pitch or velocity_z 0.

QUANTITIES
  min_speed and max_speed, the capturable speeds along each direction [m/s],
  are exact and need no speed: they are the whole kernel, and what is mapped
  where no speed is given. Otherwise capturable, margin and case.
  --quantity NAME, perhaps several times: any column that jaxcap score writes;
  effort with --robot, over com_x, com_y and com_z alone, and without a speed.

OUT
  .zarr  Zarr, written piece by piece: may be larger than memory. While it grows
         it is OUT.partial. After an interruption, of whatever kind, the same
         command goes on from there, and the result is the same to the bit.
  .nc    netCDF: has to fit into memory, and is written whole or not at all.
  Both open with xarray.open_dataset: dimensions in the order given, units, the
  contacts, gravity, sides and version as attributes. Angles are in radians.
  In Zarr, a piece whose file is lost reads as NaN, and as -1 in capturable,
  case and status, which are whole numbers there.

NOTES
  A line on stderr, and in the attribute notes, if most of the map is hardly
  plausible: the CoM more than 10 m from all contacts or below all of them,
  contacts more than 5 m apart, normals that all point away from the CoM. With
  --strict that is an error, and nothing is written.

WHERE
{where}
COMPILING
  Takes seconds, once: the programs are kept in your cache folder, or in DIR
  with --cache DIR, and the next run takes them from there. They are code: use
  no DIR that is written to by anyone whom you do not trust. --no-cache turns
  it off.

EXIT CODES
  0 done; 2 bad input, and one line says which; 130 interrupted.
""".replace("{where}", WHERE)
"""What `jaxcap map --help` says above the list of options; its first line also stands in `jaxcap --help`."""


Keep = Callable[[], AbstractContextManager[None]]
"""`compilation_cache` as it is asked for."""


def map_kernel(
    contacts: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="CONTACTS")] = None,
    *,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT")],
    axis: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUES")] = (),
    quantity: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME")] = (),
    dtype: Literal["float32", "float64"] = "float32",
    sides: int = 4,
    robot: Annotated[str | None, tyro.conf.arg(metavar="ROBOT")] = None,
    posture: Annotated[str | None, tyro.conf.arg(metavar="POSTURE")] = None,
    row: int = 0,
    joints: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME")] = (),
    cache: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    no_cache: bool = False,
    where: tyro.conf.OmitArgPrefixes[Where] = Where(),  # noqa: B008
    strict: bool = False,
    force: bool = False,
) -> None:
    """Computes a map and writes it; see MAP.

    Raises InputError before anything is computed if an option or a file cannot be used, and MissingExtra.

    Args:
        contacts: File of contacts, .yaml or .json.
        output: Map to write, .zarr or .nc.
        axis: Values of an axis of the grid; as often as needed.
        quantity: What to map; as often as needed.
        dtype: Precision of the computation and of the figures written.
        sides: Edges of the pyramid that replaces each friction cone, at least 3.
        robot: Whose limits count: its name, or URDF or MJCF file.
        posture: Of the robot: a name, or a Parquet file of states.
        row: Of that file.
        joints: Count if their name holds this; as often as needed. By default all that carry a contact.
        cache: Keep compiled programs in this directory, not in your cache folder.
        no_cache: Keep none and take none.
        where: Where a Zarr map is computed.
        strict: What is hardly plausible is an error, not a note.
        force: Overwrite OUT if it exists.
    """
    from jaxcap.maps.asked import notes_of
    from jaxcap.maps.kernel import write_map

    check_sides(sides)
    check_where(where)
    given = named_values("--axis", axis, "NAME=VALUES, for example com_x=-0.4:0.4:201")
    subject = _subject(contacts, robot, posture, row, joints, sides)
    sets = given_sets(subject.stance)
    axes = with_sets(subject.what, axes_around(sets.values(), subject.heights | given))
    points = grid_of(axes)
    notes = notes_of(list(sets.values()), points)
    if strict and notes:
        raise InputError(f"--strict: {'; '.join(notes)}")
    keep = partial(compilation_cache, cache and cache.absolute(), no_cache)
    start = time.perf_counter()
    try:
        with (
            jax.enable_x64(dtype == "float64"),
            compilation_cache(cache, no_cache),
            _elsewhere(where, keep, output, force) as other,
        ):
            options: dict[str, Any] = {"sides": sides, "dtype": dtype, "force": force, "progress": True, "elsewhere": other}
            computed = write_map(output, subject.what, axes, quantity or None, **options, said=subject.said)
    except (KeyboardInterrupt, SystemExit):
        if output.suffix.lower() == ".zarr":
            print(f"note: the same command goes on where this one ended ({output}.partial)", file=sys.stderr)
        raise
    seconds = time.perf_counter() - start
    for note in notes:
        print(f"note: {output}: {note}", file=sys.stderr)
    extent = " x ".join(f"{name} {size}" for name, size in zip(points.dims, points.shape, strict=True)) or "one point"
    shard = f"; shard {where.shard}{'' if output.exists() else ', other regions are to come'}" if where.shard else ""
    before = f"; {points.size - computed} were there" if computed < points.size and not shard else shard
    rate = f"{computed / seconds:.3g} states/s ({seconds:.2f} s with compiling; {dtype}, {jax.default_backend()})"
    print(f"{output}: {extent}, {points.size} states{before}\n{rate}")


@contextmanager
def _elsewhere(where: Where, keep: Keep, output: Path, force: bool) -> Iterator[Any]:
    """What `write_map` has to know of the place; None if it is this process, for all regions."""
    if where == Where():
        yield None
        return
    from jaxcap.maps.region_work import Elsewhere

    shard = shard_of(where.shard)
    if force and shard.of > 1:
        raise InputError(f"--shard {shard} (expected without --force: the last part gives the map its name)")
    if output.suffix.lower() != ".zarr":
        raise InputError(f"{where.given} (expected with a .zarr map, {output} is computed in one process)")
    with place_of(where) as place:
        run = None if isinstance(place, Here) else partial(_over, place, keep)
        yield Elsewhere(run, place.about["backend"], shard)


@dataclass(frozen=True)
class Cached:
    """Work that keeps compiled programs. It can be sent to workers."""

    work: Callable[[int], int]
    keep: Keep

    def __call__(self, number: int) -> int:
        """Does it."""
        with self.keep():
            return self.work(number)


def _over(place: Place, keep: Keep, work: Callable[[int], int], numbers: list[int]) -> Iterator[int]:
    """The numbers of regions as they are done. Raises InputError for those that failed, when the others are done."""
    failed = []
    for unit, _, error, _ in over_units(place, Cached(work, keep), [Unit(number, number) for number in numbers]):
        if error:
            failed.append(f"number {unit.number}: {error}")
        else:
            yield unit.number
    if failed:
        raise InputError(f"{len(failed)} of {len(numbers)} regions failed, the others are written; {'; '.join(failed[:3])}")


class _Subject(NamedTuple):
    """What the map is of."""

    stance: Contacts
    what: Mapped
    """The same contacts, or what a robot exerts on them."""
    said: dict[str, str]
    """In the map, besides."""
    heights: dict[str, str]
    """The axis com_z, where it is not given."""


def _subject(
    contacts: Path | None, robot: str | None, posture: str | None, row: int, joints: tuple[str, ...], sides: int
) -> _Subject:
    """Raises InputError for options that do not go together."""
    if robot is None:
        for name, given in (("--posture", posture is not None), ("--row", row != 0), ("--joints", bool(joints))):
            if given:
                raise InputError(f"{name} (expected with --robot)")
        if contacts is None:
            raise InputError("CONTACTS is missing (expected a file of contacts, or --robot and --posture)")
        stance = _contacts(contacts)
        return _Subject(stance, stance, {}, {})
    if contacts is not None or posture is None:
        raise InputError(
            "--robot (expected with --posture)" if posture is None else f"{contacts} (expected without --robot)"
        )
    from jaxcap.commands.posture import limited_cone, posture_of
    from jaxcap.maps.labels import as_file

    standing = posture_of(robot, posture, row, joints)
    limited = limited_cone(standing, sides)
    print(f"note: {standing.words}{limited.note and '; '}{limited.note}", file=sys.stderr)
    said = {"robot": standing.words, "sides": str(sides), "contacts": as_file({0: standing.contacts})}
    return _Subject(standing.contacts, limited.cone, said, {"com_z": f"{standing.height:.3f}"})


def _contacts(path: Path) -> Contacts:
    """The contact sets of a file, with their names if all have one."""
    sets, names = read_contact_sets(path)
    named = {name: contacts for name, contacts in zip(names, sets, strict=True) if name}
    return named if len(named) == len(sets) else sets
