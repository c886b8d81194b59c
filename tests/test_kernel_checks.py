"""Independent checks of the kernel: the linear inverted pendulum in closed form, and backward reachability by polygons.

Backward reachability. Along one line the dynamics are linear, the feasible (alpha, acceleration) polygon and the places of
rest are convex, so the set of states (alpha, alphadot) that can come to rest is convex. It is computed from accelerations
that HiGHS gives on a grid of alpha, and from nothing else: start with the places of rest; of every point on the edge, ask
from where it is reached in one time step under an extreme acceleration; take the hull; repeat. No walk, no case, no energy.

Twice, with roundings that bracket the answer. Cautious: chords of the convex boundaries, constant accelerations that are
feasible at both ends of a step. Generous: chords prolonged beyond their ends, the best acceleration anywhere on the step,
and positions that are as far off as an acceleration that changes within the step could carry them.
"""

from typing import NamedTuple

import numpy as np
import pytest
from samplers import random_contacts, rectangle, rotation
from scipy.spatial import ConvexHull
from states import ROWS, SHARED, contact_set

import jaxcap
from reference.contacts import wrench_rays
from reference.linear_programs import line_program, solve_acceleration
from reference.oracles import static_interval

pytestmark = pytest.mark.usefixtures("x64")
G = 9.81
CELL = np.array([0.02, 0.05])
"""A cell in alpha [m] and alphadot [m/s]: the two kernels must lie closer than this."""
GRID = 0.01
"""Spacing of the linear programs along the line [m]."""
STEP = 0.005
"""Time step of the backward reachability [s]."""
FARTHEST = 1.0
"""Half the length of the line that is looked at, about the middle of the places of rest [m]."""
SETTLED = 1e-5
"""The kernel is complete when its edge moves by less than this in a time step, on average, in cells."""
STATES = SHARED
"""Scored together: compiled once."""
ROUNDING = 1e-6
"""[m/s]"""
STRONGEST, STEEPEST = 40.0, 100.0
"""Largest acceleration [m/s^2] and slope of it [1/s^2] on a random line: what is stiffer changes too much within a step."""
INSIDE = 1e-3
"""Share of the feasible accelerations that the cautious steps keep off at either bound."""


class Edges(NamedTuple):
    """Smallest and largest acceleration [m/s^2] along a line, and their slopes [1/s^2], by linear programs on a grid."""

    alpha: np.ndarray
    low: np.ndarray
    low_slope: np.ndarray
    high: np.ndarray
    high_slope: np.ndarray
    rest: tuple[float, float]
    """Places of rest [m]."""

    def is_gentle(self) -> bool:
        """The time step is short for these accelerations."""
        strong, steep = (np.abs(x).max() for x in ((self.low, self.high), (self.low_slope, self.high_slope)))
        return strong < STRONGEST and steep < STEEPEST

    def chords(self, alpha):
        """Bounds on the acceleration that are too narrow between the knots."""
        return np.interp(alpha, self.alpha, self.low), np.interp(alpha, self.alpha, self.high)

    def tangents(self, start, stop):
        """Bounds that are too wide: the best between start and stop (n,), by tangents at the knots."""
        at = np.arange(start.min(), stop.max() + 1e-3, 1e-3)
        low = (self.low + self.low_slope * (at[:, None] - self.alpha)).max(axis=1)
        high = (self.high + self.high_slope * (at[:, None] - self.alpha)).min(axis=1)
        best = lambda values, where: np.interp(np.clip(where, start, stop), at, values)
        return best(low, at[low.argmin()]), best(high, at[high.argmax()])


def edges(arrays, com, along) -> Edges | None:
    """None where there are hardly any places of rest, or no bound on the acceleration."""
    rest = static_interval(*arrays, com, along)
    if rest is None or not CELL[0] < rest[1] - rest[0] < FARTHEST:
        return None
    program = line_program(com, along, wrench_rays(*arrays))
    found = []
    for alpha in (rest[0] + rest[1]) / 2 + np.arange(-FARTHEST, FARTHEST, GRID):
        bounds = [solve_acceleration(program, alpha, sign) for sign in (1, -1)]
        if any(bound is None for bound in bounds):
            continue
        if any(bound.status == 3 for bound in bounds):
            return None
        slopes = [bound.eqlin.marginals @ program.slope for bound in bounds]
        found.append((alpha, bounds[0].fun, slopes[0], -bounds[1].fun, -slopes[1]))
    return Edges(*np.array(found).T, rest)


def kernel(line: Edges, generous: bool) -> ConvexHull:
    """The states (alpha [m], alphadot [m/s]), in cells, that come to rest."""
    back = generous_step if generous else cautious_step
    knots = line.alpha[(line.low <= 0) & (line.high >= 0)]
    rest = np.zeros((2, 2))
    rest[:, 0] = line.rest if generous else knots[[0, -1]]
    hull = ConvexHull(np.concatenate([rest, back(line, rest)]) / CELL)
    for _ in range(5000):
        edge = on_edge(hull.points[hull.vertices])
        larger = ConvexHull(np.concatenate([edge, back(line, edge * CELL) / CELL]))
        if larger.volume - hull.volume < SETTLED * hull.area:  # in the plane, `volume` is the area and `area` the perimeter
            return larger
        hull = larger
    raise AssertionError(f"the kernel still grows by {larger.volume - hull.volume} cells a step")


def on_edge(corners):
    """The corners of a polygon (n, 2), and more points where a side is longer than half a cell."""
    sides = np.diff(corners, axis=0, append=corners[:1])
    parts = np.ceil(2 * np.linalg.norm(sides, axis=1)).astype(int)
    share = (np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)) / np.repeat(parts, parts)
    return np.repeat(corners, parts, axis=0) + share[:, None] * np.repeat(sides, parts, axis=0)


def cautious_step(line: Edges, states):
    """States (m, 2) from which `states` (n, 2) are reached in one step, the acceleration changing linearly in time.

    alpha then is a cubic of time, and (alpha, acceleration) stays in the hull of four points, which must be feasible.
    """
    alpha, speed = states.T
    found = []
    for share in (INSIDE, 0.5, 1 - INSIDE):
        blend = lambda at, share=share: (1 - share) * line.chords(at)[0] + share * line.chords(at)[1]
        last = blend(alpha)
        first = blend(alpha - speed * STEP + last * STEP**2 / 2)
        before = speed - (first + last) * STEP / 2
        start = alpha - speed * STEP + (2 * last + first) * STEP**2 / 6
        holds = np.ones(len(alpha), bool)
        for at, acc in (
            (start, first),
            (start + before * STEP / 3, (2 * first + last) / 3),
            (alpha - speed * STEP / 3, (first + 2 * last) / 3),
            (alpha, last),
        ):
            low, high = line.chords(at)
            holds &= (low <= acc) & (acc <= high) & (line.alpha[0] <= at) & (at <= line.alpha[-1])
        found.append(np.stack([start, before], axis=1)[holds])
    return np.concatenate(found)


def generous_step(line: Edges, states):
    """States (m, 2) whose hull holds all from which `states` (n, 2) can be reached in one step.

    Jensen: the mean acceleration of a step is feasible at its mean alpha, the bounds being convex and concave.
    """
    alpha, speed = states.T
    strongest = max(abs(line.low).max(), abs(line.high).max())
    mean, room = alpha - speed * STEP / 2, strongest * STEP**2 / 6
    low, high = line.tangents(mean - room, mean + room)
    off = np.abs(high - low) * STEP**2 / 8  # the acceleration may change within the step
    found = [
        (alpha - speed * STEP + acc * STEP**2 / 2 + sign * off, speed - acc * STEP)
        for acc in (low, high)
        for sign in (-1, 1)
    ]
    found = np.concatenate(np.moveaxis(found, 1, 2))
    return found[(line.alpha[0] - GRID <= found[:, 0]) & (found[:, 0] <= line.alpha[-1] + GRID)]


def column(hull: ConvexHull, alpha):
    """Smallest and largest alphadot of a kernel at these alphas (n,) [m/s]; NaN outside of it."""
    a, b, c = hull.equations.T
    upper, lower = b > 0, b < 0
    at = -(a * (alpha / CELL[0])[:, None] + c) / np.where(b == 0, 1, b) * CELL[1]
    high, low = at[:, upper].min(axis=1), at[:, lower].max(axis=1)
    return np.where(low <= high, (low, high), np.nan)


def assert_bracketed(arrays, com, along, line: Edges):
    """Cautious and generous kernel are within a cell, and the speeds of jaxcap lie between them, forwards and backwards.

    Returns at how many places a speed is too slow.
    """
    cautious, generous = kernel(line, generous=False), kernel(line, generous=True)
    apart = generous.points[generous.vertices] @ cautious.equations[:, :2].T + cautious.equations[:, 2]
    assert apart.max() < 1
    alpha = np.linspace(line.alpha[0], line.alpha[-1], STATES + 2)[1:-1]
    coms = com + alpha[:, None] * along
    cone = jaxcap.centroidal_cone(contact_set(*arrays)).padded(ROWS)
    places = too_slow = 0
    for heading in (1, -1):
        found = jaxcap.score(cone, coms, np.tile(heading * along, (len(alpha), 1)))
        assert (found.status == jaxcap.Status.OK).all()
        (low, high), (lowest, highest) = (np.sort(heading * column(hull, alpha), axis=0) for hull in (cautious, generous))
        proven = high > 0
        assert (found.max_speed >= high - ROUNDING)[proven].all()
        assert (found.min_speed <= np.maximum(low, 0) + ROUNDING)[proven].all()
        claimed = np.asarray(found.max_speed) > ROUNDING
        assert (found.max_speed <= highest + ROUNDING)[claimed].all()
        assert (found.min_speed >= np.maximum(lowest, 0) - ROUNDING)[claimed].all()
        places += claimed.sum()
        too_slow += (proven & (lowest > 0)).sum()
    assert places > 50
    return too_slow


def test_kernel_of_a_foot_on_the_ground():
    arrays, com, along = rectangle([0, 0, 0], np.eye(3)), np.array([0, 0, 0.8]), np.array([1.0, 0, 0])
    assert_bracketed(arrays, com, along, edges(arrays, com, along))


def test_kernel_of_a_robot_that_hangs():
    """C3.3: it swings."""
    arrays, com, along = rectangle([0, 0, 2], np.eye(3)), np.array([0, 0, 1.2]), np.array([1.0, 0, 0])
    assert_bracketed(arrays, com, along, edges(arrays, com, along))


def test_kernels_over_contacts_that_are_not_coplanar():
    """Lines over three random rectangles. Some have their places of rest ahead: too slow is as bad as too fast there."""
    rng, lines, too_slow = np.random.default_rng(4), 0, 0
    while lines < 4:
        arrays = random_contacts(rng, 3)
        low, high = arrays[0].min(axis=0), arrays[0].max(axis=0)
        com, along = rng.uniform(low - 0.1, high + np.array([0.1, 0.1, 1])), rng.normal(size=3)
        along /= np.linalg.norm(along)
        line = edges(arrays, com, along)
        if line is not None and line.is_gentle():
            lines += 1
            too_slow += assert_bracketed(arrays, com, along, line)
    assert too_slow > 50


def test_inverted_pendulum_with_finite_feet():
    """Flat ground, ample friction, level motion: capturable from x to x + xdot/omega within the feet, for random feet,
    positions and headings; the smallest speed reaches their near edge, the largest their far edge."""
    rng = np.random.default_rng(8)
    seen = np.zeros(2, int)
    for _ in range(8):
        half_length, half_width, yaw, height = rng.uniform([0.05, 0.03, -np.pi, 0.5], [0.2, 0.1, np.pi, 1.1])
        arrays = rectangle(rng.uniform(-1, 1, 3), rotation(0, 0, yaw), half_length, half_width, friction=5.0)
        other = rectangle(arrays[0][0] + [0.2, 0.1, 0], rotation(0, 0, -yaw), half_length, half_width, friction=5.0)
        arrays = tuple(np.concatenate(pair) for pair in zip(arrays, other, strict=True))
        arrays[0][:, 2] = ground = arrays[0][0, 2]
        centre, omega = arrays[0].mean(axis=0), np.sqrt(G / height)
        coms = centre + rng.uniform([-0.5, -0.5, 0], [0.5, 0.5, 0], (STATES, 3))
        coms[:, 2] = ground + height
        angles = rng.uniform(-np.pi, np.pi, STATES)
        along = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(STATES)])
        sides = ConvexHull(arrays[0][:, :2]).equations
        rate = along[:, :2] @ sides[:, :2].T
        at = -(coms[:, :2] @ sides[:, :2].T + sides[:, 2]) / rate
        near, far = np.where(rate < 0, at, -np.inf).max(axis=1), np.where(rate > 0, at, np.inf).min(axis=1)
        met = (near < far) & (far > 0)
        cone = jaxcap.centroidal_cone(contact_set(*arrays)).padded(ROWS)
        found = jaxcap.score(cone, coms, along)
        np.testing.assert_allclose(found.max_speed, np.where(met, omega * far, 0), rtol=1e-8, atol=ROUNDING)
        np.testing.assert_allclose(found.min_speed, np.where(met, omega * np.maximum(near, 0), 0), rtol=1e-8, atol=ROUNDING)
        seen += (met & (near <= 0)).sum(), (met & (near > 0)).sum()
    assert (seen > 100).all()
