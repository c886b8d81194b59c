"""`jaxcap plot`: a picture of a kernel map, or of a scored log. Importing this module needs tyro (extra `cli`)."""

import math
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

from jaxcap.commands.options import named_values
from jaxcap.commands.states import said_of_log
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.errors import InputError, needs_extra
from jaxcap.files.contact_files import read_contact_sets
from jaxcap.files.whole_file import check_output, whole_file
from jaxcap.maps.grid import AXES

PLOT = """Draw a kernel map, or a scored log over time.

EXAMPLES
  jaxcap map feet.yaml -o kernel.zarr
  jaxcap plot kernel.zarr                    # kernel.png
  jaxcap plot kernel.zarr -o left.pdf --select heading=90deg
  jaxcap plot all.zarr -o margin.png --quantity margin --x com_x --y speed
  jaxcap plot scores.parquet                 # a log: scores.png

MAP is what jaxcap map writes (.zarr, .nc), or jaxcap score of a log (.parquet).

A LOG
  Margin, how each state ends, and which feet touch, over time; episodes follow
  each other, with a line between them.

A MAP WITHOUT OPTIONS
  A map with max_speed over com_x, com_y and heading becomes two pictures of the
  stance from above. Left: the largest CoM speed that can be stopped, whatever
  its heading, over the CoM's position; zero outside the support polygon. Right:
  the velocities that can be stopped from a few positions, as polar plots.
  Any other map becomes a slice: margin, max_speed or its first quantity, over
  its first two axes.

A SLICE
  --quantity, --x and --y choose what is drawn over which axes of the map.
  --select NAME=VALUE, perhaps several times, chooses the value of another axis;
  the nearest grid point is taken, and angles may end in deg. Axes that are not
  named are taken at the middle of the map, headings and contact sets at the
  first, and a note says so. The thick line is the zero level, of the effort
  the level one. Infinite figures and those that are no numbers are hatched, and
  the legend says why.

FIGURE
  .png, .pdf or .svg; by default MAP with the extension .png. It is written
  whole or not at all.

EXIT CODES
  0 done; 2 bad input, and one line says which; 130 interrupted.
"""
"""What `jaxcap plot --help` says above the list of options; its first line also stands in `jaxcap --help`."""

FIGURES = (".png", ".pdf", ".svg")
OF_LOG = ("t", "episode", "margin", "case", "contact_mask")
"""Columns of a scored log that are drawn."""
DOTS = 200
"""Dots per inch of a PNG."""


def plot(
    map_file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MAP")],
    *,
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FIGURE")] = None,
    quantity: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    x: Annotated[str | None, tyro.conf.arg(metavar="AXIS")] = None,
    y: Annotated[str | None, tyro.conf.arg(metavar="AXIS")] = None,
    select: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUE")] = (),
    force: bool = False,
) -> None:
    """Draws a map; see PLOT.

    Raises InputError before anything is drawn if an option or a file cannot be used, and MissingExtra.

    Args:
        map_file: Map to draw, .zarr or .nc, or scored log, .parquet.
        output: Figure to write, .png, .pdf or .svg; by default MAP with the extension .png.
        quantity: What to draw; by default the margin, or max_speed, or the first quantity of the map.
        x: Axis of the map that goes to the right; by default the first.
        y: Axis of the map that goes up; by default the second.
        select: Value of another axis; as often as needed.
        force: Overwrite FIGURE if it exists.
    """
    output = map_file.with_suffix(".png") if output is None else output
    check_output(output, force=force, extensions=FIGURES, inputs=(map_file,) if map_file.is_file() else ())
    if map_file.suffix.lower() == ".parquet":
        if quantity or x or y or select:
            raise InputError(f"{map_file}: is a log (--quantity, --x, --y and --select are for maps)")
        figure = _log(map_file)
    else:
        figure = _map(map_file, quantity, (x, y), _selection(select))
    with whole_file(output, force=force) as handle:
        figure.savefig(handle, format=output.suffix[1:].lower(), dpi=DOTS)
    print(output)


def _map(path: Path, quantity: str | None, axes: tuple[str | None, str | None], selection: dict[str, float]) -> Any:
    """The figure of a map; what was chosen for the reader is a note."""
    from jaxcap.plotting.map_figure import map_figure
    from jaxcap.plotting.words import value_of

    with _opened(path) as dataset:
        sets = _contact_sets(path, dataset.attrs)
        try:
            figure, chosen = map_figure(dataset, sets, quantity, axes, selection)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from error
        for name, value in chosen.items():
            shown, size = value_of(dataset[name].sel({name: value})), dataset.sizes[name]
            print(f"note: {path}: {name} = {shown}, one of {size} (--select {name}=...)", file=sys.stderr)
    return figure


def _log(path: Path) -> Any:
    """The figure of a scored log, its contacts by the names of the patches that the file tells."""
    from jaxcap.plotting import timeline

    with needs_extra("data", "reading scores"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    try:
        schema = pq.read_schema(path)
        table = pq.read_table(path, columns=[name for name in OF_LOG if name in schema.names])
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read as Parquet: {error}") from error
    patches = said_of_log(schema.metadata or {}).get("read", {}).get("patches", {})
    sizes = {name: 4 if patch["half_length"] or patch["half_width"] else 1 for name, patch in patches.items()}
    try:
        axes = timeline({name: table[name].to_pylist() for name in table.column_names}, sizes or None)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    return axes[0].figure


def _selection(given: tuple[str, ...]) -> dict[str, float]:
    """Names and values, angles in radians."""
    selection = {}
    for name, value in named_values("--select", given, "NAME=VALUE, for example heading=90deg").items():
        degrees = value.endswith("deg") and name in AXES and AXES[name].unit == "rad"
        try:
            number = float(value.removesuffix("deg") if degrees else value)
        except ValueError:
            raise InputError(f"--select {name}={value} (expected a number after {name}=)") from None
        if not math.isfinite(number):
            raise InputError(f"--select {name}={value} (expected a finite number)")
        selection[name] = math.radians(number) if degrees else number
    return selection


def _opened(path: Path) -> Any:
    """The map, lazily. Raises InputError for what is not there, and what is no map."""
    with needs_extra("maps", "reading a map"):
        import xarray as xr
        import zarr  # noqa: F401
    extension = path.suffix.lower()
    if extension not in (".zarr", ".nc"):
        raise InputError(f"{path}: unknown extension {path.suffix!r} (expected .zarr or .nc, from jaxcap map)")
    if not path.exists():
        partial = path.with_name(path.name + ".partial").exists()
        raise InputError(f"{path}: {'not complete: jaxcap map goes on with it' if partial else 'no such file'}")
    try:
        if extension == ".zarr":
            dataset = xr.open_dataset(path, engine="zarr", consolidated=False)
        else:
            dataset = xr.open_dataset(path, engine="h5netcdf")
    except ImportError as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: cannot be read as a map: {str(error).partition(chr(10))[0]}") from error
    if not dataset.data_vars:
        raise InputError(f"{path}: holds no quantity (expected a map from jaxcap map)")
    return dataset


def _contact_sets(path: Path, attributes: Mapping[str, Any]) -> tuple[ContactSet, ...]:
    """The contact sets of the map, as far as it tells them."""
    if "contacts" not in attributes:
        return ()
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "contacts.json"
        file.write_text(str(attributes["contacts"]), encoding="utf-8")
        try:
            return read_contact_sets(file).sets
        except InputError as error:
            raise InputError(f"{path}: attribute 'contacts': {str(error).removeprefix(f'{file}: ')}") from error
