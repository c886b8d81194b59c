"""Answers over grids: kernel maps in memory, Zarr or netCDF. `kernel_map` and `write_map` need the extra `maps`.

Begin with `kernel`, then `asked` (what a map is asked for), `grid` (axes), `blocks` (how a grid is cut and answered),
`store` (files that grow and resume), `region_work` (regions in other processes). May import every room but
`plotting` and `commands`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxcap.maps.kernel import EXTENSIONS as EXTENSIONS
    from jaxcap.maps.kernel import kernel_map as kernel_map
    from jaxcap.maps.kernel import write_map as write_map


def __getattr__(name: str) -> Any:
    """The public functions when they are asked for: pictures and commands use the grid alone, and have no need of xarray."""
    if name not in ("EXTENSIONS", "kernel_map", "write_map"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("jaxcap.maps.kernel"), name)
