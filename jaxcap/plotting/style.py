"""What the pictures have in common: colours, new axes, lines that are seen on any ground."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import Stroke, withStroke

BLUE, ORANGE, RED = "#0060a0", "#e69f00", "#8b1a00"  # told apart by colour-blind readers, and in grey
PALE, GREY, DARK = "#d9e6f2", "#909090", "#303030"


def axes_or_new(ax: Axes | None, size: tuple[float, float] = (6.4, 4.8), projection: str | None = None) -> Axes:
    """The axes given, or those of a new figure that pyplot does not know of. size: of that figure [inches]."""
    if ax is None:
        return Figure(figsize=size, layout="compressed").add_subplot(projection=projection)
    if getattr(ax, "name", None) != (projection or "rectilinear"):
        raise ValueError(f"ax has the projection {getattr(ax, 'name', None)!r} (expected {projection or 'rectilinear'!r})")
    return ax


def halo(width: float = 3.5, color: str = "white") -> list[Stroke]:
    """A path effect: an outline, for lines and text on coloured ground."""
    return [withStroke(linewidth=width, foreground=color)]
