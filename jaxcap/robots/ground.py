"""The ground: a height, planes, or a field of heights."""

import os
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from jaxcap.errors import InputError, needs_extra


class Under(NamedTuple):
    """The ground under points."""

    height: Float[np.ndarray, " m"]
    """[m]"""
    normal: Float[np.ndarray, "m 3"]


class Ground(Protocol):
    """What robots stand on."""

    def under(self, places: Float[np.ndarray, "m 2"]) -> Under:
        """The ground at these places (x, y) [m]."""


class Flat(NamedTuple):
    """A level floor."""

    height: float
    """[m]"""

    def under(self, places: Float[np.ndarray, "m 2"]) -> Under:
        """The same everywhere."""
        return Under(np.full(len(places), self.height), np.tile([0.0, 0.0, 1.0], (len(places), 1)))


class Planes(NamedTuple):
    """Planes, each within a rectangle of x and y; of those at a place the highest counts."""

    points: Float[np.ndarray, "p 3"]
    """One of each [m]."""
    normals: Float[np.ndarray, "p 3"]
    """Upwards."""
    low: Float[np.ndarray, "p 2"]
    """Of x and y [m]."""
    high: Float[np.ndarray, "p 2"]

    def under(self, places: Float[np.ndarray, "m 2"]) -> Under:
        """The highest plane there; NaN where there is none."""
        away = places[:, None] - self.points[:, :2]
        heights = self.points[:, 2] - np.einsum("mpi,pi->mp", away, self.normals[:, :2]) / self.normals[:, 2]
        there = ((places[:, None] >= self.low) & (places[:, None] <= self.high)).all(axis=-1)
        heights = np.where(there, heights, -np.inf)
        highest = heights.argmax(axis=1)
        height = heights[np.arange(len(places)), highest]
        return Under(np.where(np.isfinite(height), height, np.nan), self.normals[highest])


class Field(NamedTuple):
    """Heights on a grid, linear between its points; beyond its edge those of the edge."""

    origin: tuple[float, float]
    """Of the first height, x and y [m]."""
    step: tuple[float, float]
    """[m]"""
    heights: Float[np.ndarray, "nx ny"]
    """[m]"""

    def under(self, places: Float[np.ndarray, "m 2"]) -> Under:
        """Height and normal of the surface."""
        nx, ny = self.heights.shape
        x, y = np.clip((places - self.origin) / self.step, 0, (nx - 1, ny - 1)).T
        i, j = np.minimum(x.astype(int), nx - 2), np.minimum(y.astype(int), ny - 2)
        u, w = x - i, y - j
        a, b, c, d = (self.heights[i + k, j + m] for k, m in ((0, 0), (1, 0), (0, 1), (1, 1)))
        slope_x = ((b - a) * (1 - w) + (d - c) * w) / self.step[0]
        slope_y = ((c - a) * (1 - u) + (d - b) * u) / self.step[1]
        normal = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=1)
        height = a * (1 - u) * (1 - w) + b * u * (1 - w) + c * (1 - u) * w + d * u * w
        return Under(height, normal / np.linalg.norm(normal, axis=1, keepdims=True))


def read_ground(given: float | str | os.PathLike) -> Ground:
    """A ground: its height [m], or a YAML file with `planes` or `heights`.

    Under `planes` a list of {point: [x, y, z], normal: [x, y, z], x: [low, high], y: [low, high]}, of which x and y may
    be left out; or `heights`, rows along x of numbers along y, with `origin: [x, y]` and `step: [dx, dy]`. All in metres.

    Raises:
        InputError: Naming file and field.
    """
    try:
        return Flat(float(given))  # type: ignore[arg-type]
    except (TypeError, ValueError):
        pass
    path = Path(given)  # type: ignore[arg-type]
    with needs_extra("logs", "reading YAML"):
        import yaml
    try:
        said = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise InputError(f"ground {os.fspath(path)!r} is no height and cannot be read as YAML: {error}") from error
    try:
        return _planes(said["planes"]) if "planes" in said else _field(said)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: no ground: {error!r} (expected 'planes', or 'heights', 'origin' and 'step')") from error


def _planes(listed: list[dict[str, Any]]) -> Planes:
    points = np.array([plane["point"] for plane in listed], float).reshape(-1, 3)
    normals = np.array([plane["normal"] for plane in listed], float).reshape(-1, 3)
    if not len(points) or not (normals[:, 2] > 0).all():
        raise ValueError("normals point upwards, and there is a plane")
    sides = np.array([[plane.get(axis, (-np.inf, np.inf)) for axis in "xy"] for plane in listed], float)
    return Planes(points, normals / np.linalg.norm(normals, axis=1, keepdims=True), sides[:, :, 0], sides[:, :, 1])


def _field(said: dict[str, Any]) -> Field:
    heights, origin, step = (np.array(said[name], float) for name in ("heights", "origin", "step"))
    if heights.ndim != 2 or min(heights.shape) < 2 or origin.shape != (2,) or step.shape != (2,) or not (step > 0).all():
        raise ValueError(f"heights of shape {heights.shape}, origin {origin.tolist()}, step {step.tolist()}")
    return Field(tuple(origin), tuple(step), heights)
