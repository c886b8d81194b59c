"""Half-planes -> the polygon of them that lies in a window; empty, thin and unbounded sets are as good as any."""

import numpy as np
from jaxtyping import Float


def clipped(
    window: tuple[float, float, float, float], normals: Float[np.ndarray, "m 2"], bounds: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "k 2"]:
    """Vertices of the points of a window with `normals @ point <= bounds`, in order around it; none where it is empty.

    window: left, right, bottom, top. A set without area has vertices that lie on a line, or on each other.
    """
    left, right, bottom, top = window
    vertices = np.array([[left, bottom], [right, bottom], [right, top], [left, top]], float)
    for normal, bound in zip(normals, bounds, strict=True):
        outside = vertices @ normal - bound
        after = np.roll(outside, -1)
        kept = []
        for i, vertex in enumerate(vertices):
            if outside[i] <= 0:
                kept.append(vertex)
            if min(outside[i], after[i]) < 0 < max(outside[i], after[i]):
                share = outside[i] / (outside[i] - after[i])
                kept.append(vertex + share * (vertices[(i + 1) % len(vertices)] - vertex))
        vertices = np.array(kept).reshape(-1, 2)
    return vertices
