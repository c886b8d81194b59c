"""How much of a robot's torque limits it takes to stand still: by faces over all places of its CoM, on the host.

The weight's wrench depends on where the CoM is across gravity, two numbers, and the effort is the value of a linear program
with these on the right-hand side: convex, and linear in pieces. A program's dual is its piece. So the largest of the pieces
found so far is asked where it has its vertices; where the program says more, there is a new piece; where it does so at none,
the pieces are all there are.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxcap.contacts.cone_hull import ProjectionError
from jaxcap.contacts.limbs import Loads
from jaxcap.contacts.sums import Halfspaces

REACH = 100.0
"""Places farther than this from the contacts, in sizes of the stance, are not asked."""
INSIDE = 1e-7
"""Places on the edge of where the robot can stand are moved in by this part of the way to the middle."""
EXACT = 1e-9
"""A piece that is passed by less than this, relative to the effort, is all there is at that place."""
THIN = 1e-9
"""A region of places with an inner radius of less than this, in sizes of the stance, is a line."""
PROGRAMS = 3000
"""At most, and some."""
SOLVER = 1e-10
"""HiGHS's primal and dual feasibility."""


class Pieces(NamedTuple):
    """The effort is the largest of per_wrench @ wrench + constant; wrenches in weights, torques also over the size."""

    per_wrench: Float[np.ndarray, "e 6"]
    constant: Float[np.ndarray, " e"]


class Places(NamedTuple):
    """Where a robot at rest can have its CoM: edges @ (place, 1) <= 0, a place two numbers across gravity, in sizes."""

    edges: Float[np.ndarray, "h 3"]
    middle: Float[np.ndarray, "2"]
    """The one that is farthest from all edges."""
    corners: Float[np.ndarray, "k 2"]
    wrenches: Float[np.ndarray, "6 3"]
    """The wrench there is wrenches @ (place, 1)."""


def places_of(held: Halfspaces, up: Float[np.ndarray, "3"], axes: Float[np.ndarray, "2 3"]) -> Places | None:
    """The places at which the contacts balance the weight; None where there are none, or they are a line.

    Args:
        held: wrenches in weights.
        up: unit vector against gravity.
        axes: two unit vectors across it.
    """
    from scipy.optimize import linprog  # a heavy import, as in `cone_hull`

    # The wrench of a robot at rest is (up, arm x up).
    wrenches = np.zeros((6, 3))
    wrenches[:3, 2], wrenches[3:, :2] = up, np.cross(axes, up).T
    rows = held.normals @ wrenches - held.offsets[:, None] * [0, 0, 1]
    frame = np.concatenate([np.eye(2), -np.eye(2)])
    edges = np.concatenate([rows, np.pad(frame, ((0, 0), (0, 1)), constant_values=-REACH)])
    sizes = np.linalg.norm(edges[:, :2], axis=1, keepdims=True)
    deepest = linprog([0, 0, -1], A_ub=np.concatenate([edges[:, :2], sizes], axis=1), b_ub=-edges[:, 2], bounds=(None, None))
    if deepest.status != 0 or deepest.x[2] < THIN:
        return None
    edges, middle = edges[sizes[:, 0] > THIN], deepest.x[:2]
    return Places(edges, middle, _intersections(edges, middle), wrenches)


def pieces_of_effort(loads: Loads, places: Places) -> Pieces:
    """The effort over all places of the CoM, from what the contacts ask of the joints."""
    found, asked = [_asked(loads, places, places.middle)], set[tuple[float, ...]]()
    while True:
        rows = np.array([[*one.per_wrench, one.constant] for one in found if one is not None])
        lines = rows[:, :6] @ places.wrenches + rows[:, 6:] * [0, 0, 1]
        fresh = [place for place in _vertices(places, lines) if tuple(np.round(place, 7)) not in asked]
        if not fresh or len(asked) > PROGRAMS:
            return Pieces(rows[:, :6], rows[:, 6])
        asked |= {tuple(np.round(place, 7)) for place in fresh}
        for place in fresh:
            one = _asked(loads, places, place + INSIDE * (places.middle - place))
            if one is not None and one.effort > one.known(lines) + EXACT * max(1.0, one.effort):
                found.append(one)


class _Asked(NamedTuple):
    """What the program says of a place."""

    place: Float[np.ndarray, "2"]
    effort: float
    per_wrench: Float[np.ndarray, "6"]
    constant: float

    def known(self, lines: Float[np.ndarray, "e 3"]) -> float:
        """What the pieces say."""
        return float((lines[:, :2] @ self.place + lines[:, 2]).max())


def _asked(loads: Loads, places: Places, place: Float[np.ndarray, "2"]) -> _Asked | None:
    """The least effort, and its dual; None where no torques hold the robot, if only by rounding."""
    from scipy.optimize import linprog

    wrench = places.wrenches @ np.append(place, 1.0)
    rays, torques = (
        loads.rays.reshape(-1, 6),
        loads.torques.reshape(len(loads.limit), loads.rays.shape[0] * loads.rays.shape[1]),
    )
    share = np.tile(-loads.limit, 2)[:, None]
    bound = np.concatenate([loads.gravity, -loads.gravity])
    result = linprog(
        np.eye(1 + len(rays))[0],
        A_ub=np.concatenate([share, np.concatenate([torques, -torques])], axis=1),
        b_ub=bound,
        A_eq=np.concatenate([np.zeros((6, 1)), rays.T], axis=1),
        b_eq=wrench,
        method="highs-ds",
        options={"primal_feasibility_tolerance": SOLVER, "dual_feasibility_tolerance": SOLVER},
    )
    if result.status != 0:
        return None
    per_wrench, constant = result.eqlin.marginals, float(result.ineqlin.marginals @ bound)
    return _Asked(place, float(per_wrench @ wrench) + constant, per_wrench, constant)


def _vertices(places: Places, lines: Float[np.ndarray, "e 3"]) -> Float[np.ndarray, "v 2"]:
    """Where the largest of linear functions has its corners, on the edges of the places too."""
    at_middle = float((lines[:, :2] @ places.middle + lines[:, 2]).max())
    # No higher than need be, and seen from near the lines: Qhull's tolerance is that of the largest number.
    top = float((places.corners @ lines[:, :2].T + lines[:, 2]).max()) + 1
    below = np.column_stack([lines[:, :2], -np.ones(len(lines)), lines[:, 2]])
    beside = np.column_stack([places.edges[:, :2], np.zeros(len(places.edges)), places.edges[:, 2]])
    all_sides = np.concatenate([below, beside, [[0, 0, 1, -top]]])
    inner = np.append(places.middle, at_middle + 0.5)
    corners = _intersections(all_sides, inner)
    return np.unique(corners[:, :2], axis=0)


def _intersections(half_spaces: Float[np.ndarray, "h d1"], inside: Float[np.ndarray, " d"]) -> Float[np.ndarray, "v d"]:
    """Corners of half_spaces @ (point, 1) <= 0."""
    from scipy.spatial import HalfspaceIntersection, QhullError

    try:
        corners = HalfspaceIntersection(half_spaces, inside, qhull_options="Qt").intersections
    except QhullError as error:
        raise ProjectionError(f"Qhull: {str(error).splitlines()[0]}") from error
    return corners[np.isfinite(corners).all(axis=1)]
