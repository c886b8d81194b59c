"""The picture of a capture region: what is painted is the margin, and the line lies where it is zero."""

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxcap
from jaxcap.plotting import capture_region

FLOOR = jaxcap.surface([0.3, 0, 0], np.eye(3), 0.5, 0.4, 0.5)
PLACES = jaxcap.candidates_on([FLOOR, jaxcap.rail([0, 1, 1], [1, 1, 1], [0, 0, 1], 0.02, 0.5)], 0.05, 0.05, 0.1)


def test_the_line_is_where_the_margin_is_zero():
    margin = np.where(PLACES.surface == 0, PLACES.centres[:, 0] - 0.32, np.inf)
    ax = capture_region(PLACES, margin, ax=Figure().add_subplot())
    (line,) = ax.lines
    np.testing.assert_allclose(line.get_xdata(), 0.32, atol=1e-12)
    assert np.ptp(line.get_ydata()) == pytest.approx(0.7)
    assert len(ax.patches) == len(margin)
    assert ax.get_xlabel() == "x [m]" and "[m/s]" in ax.figure.axes[1].get_ylabel()


def test_the_line_lies_on_uneven_ground():
    """Cells of neighbours meet, and the line bends with them."""
    x = 0.1 * np.arange(11)
    ground = jaxcap.height_field(np.repeat(x[:, None] ** 2, 8, axis=1), [0, 0, 0], 0.1, 0.5)
    places = jaxcap.candidates_on([ground], 0.05, 0.05, 0.1)
    ax = capture_region(places, places.centres[:, 0] - 0.42)
    (line,) = [one for one in ax.collections if "Line" in type(one).__name__]
    points = np.concatenate(line._segments3d)
    np.testing.assert_allclose(points[:, 0], 0.42, atol=1e-12)
    below, above = (places.centres[np.argmin(np.abs(places.centres[:, 0] - x)), 2] for x in (0.35, 0.45))
    np.testing.assert_allclose(points[:, 2], below + 0.7 * (above - below), atol=1e-12)


def test_in_space():
    ax = capture_region(PLACES, np.full(len(PLACES.surface), np.nan))
    assert ax.name == "3d" and ax.get_zlabel() == "z [m]" and not ax.lines


@pytest.mark.parametrize(
    ("given", "words"),
    [((np.zeros(3), 1.0), r"margin has shape \(3,\)"), ((np.zeros(len(PLACES.surface)), 0.0), "limit = 0.0")],
)
def test_what_cannot_be_is_named(given, words):
    with pytest.raises(ValueError, match=words):
        capture_region(PLACES, given[0], limit=given[1])
