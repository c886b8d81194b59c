"""Rays of the cone -> the way around its support polygon, without ever forming it.

With weights in units of the robot's weight, the static region is the image of a polytope:

    c = sum of weights * positions  such that  sum of weights * (force, vertical torque) = (upwards, 0),  weights >= 0,

where a ray's position is that of a CoM which its torque balances. A vertex is a basis and an edge is a pivot: of the rays
outside the basis, the one that takes the CoM the most outwards comes in. The rows of the program are force (3), torque about
gravity, and load; the sixth serves to find the first vertex.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxcap.contacts.cone import ConeRays
from jaxcap.numerics import simplex, simplex_basis
from jaxcap.numerics.guarded import tolerances
from jaxcap.numerics.simplex import Outcome
from jaxcap.numerics.simplex_basis import FREE, UNIT, Basis, Program
from jaxcap.regions.plane import Edge, Nearest, across, column, first_edge, upward, walk_around

LOAD = 1e3
"""All contact forces together are at most this many times the weight, so that every region is bounded; edges that are due to
it count as infinitely far away."""
SHORT = {64: 1e-8, 32: 1e-5}
"""How far below zero a weight may come for the sake of a larger pivot, by the bits of a number. Soles that are parallel but
for rounding have nearly equal rays, and a basis should not hold two of them. The target then moves to where the weight is
zero: a weight that stays below zero would become a long step back over a small pivot."""
LOST = 30
"""A weight that is below zero by more than this many times SHORT shows that the vertex is none."""
ATTEMPTS = 3
"""Where the walk gets lost, it begins again from another side of the polygon, so many times in all."""
MAX_EDGES = 512
"""Most pivots around a region."""


class Corner(NamedTuple):
    """A vertex of the polytope."""

    basis: Basis
    target: Float[Array, "6 *n"]
    """What the rays have to add up to, moved as `SHORT` says."""
    weights: Float[Array, "6 *n"]
    """Of the basis, those of rays not negative."""
    sound: Bool[Array, "*n"]
    """No weight was farther below zero than it may be."""


def nearest_of_rays(
    rays: ConeRays, points: Float[Array, "2 m *n"], gravity: Float[Array, "3"]
) -> tuple[Nearest, Bool[Array, "*n"], Bool[Array, "*n"]]:
    """`Nearest` of points to the support polygon; whether the polygon is not empty; whether to trust that.

    rays: with lanes last. points, and the answer: relative to the contacts' centroid, in sizes of the stance.
    """
    rays, points = jax.lax.stop_gradient((rays, points))
    finite = jnp.all(jnp.isfinite(rays.rays), axis=(0, 1))

    def attempt(state):
        count, *old = state
        todo = finite & ~old[-1]
        angle = count.astype(points.dtype)
        turn = jnp.array([[jnp.cos(angle), -jnp.sin(angle)], [jnp.sin(angle), jnp.cos(angle)]])
        turned = lambda matrix, vectors: jnp.tensordot(matrix, vectors, axes=1, precision=jax.lax.Precision.HIGHEST)
        new = _nearest(*_program(rays, upward(gravity), turned(turn, across(gravity))), turned(turn, points), todo)
        nearest = new[0]._replace(normal=turned(turn.T, new[0].normal), foot=turned(turn.T, new[0].foot))
        return count + 1, *jax.tree.map(lambda new, old: jnp.where(todo, new, old), (nearest, *new[1:]), tuple(old))

    nothing = Nearest(jnp.zeros_like(points), jnp.zeros_like(points[0]), jnp.zeros_like(points))
    start = jnp.int32(0), nothing, jnp.zeros_like(finite), jnp.zeros_like(finite)
    again = lambda state: jnp.any(finite & ~state[-1]) & (state[0] < ATTEMPTS)
    return jax.lax.while_loop(again, attempt, start)[1:]


def _nearest(
    program: Program, positions: Array, points: Array, active: Bool[Array, "*n"]
) -> tuple[Nearest, Bool[Array, "*n"], Bool[Array, "*n"]]:
    """`nearest_of_rays` in lanes that are active, the walk beginning on the side of the first axis."""
    start = simplex_basis.identity(active.shape, points.dtype)
    found = simplex.solve(program, simplex_basis.freed(program, start), active)
    stands, decided = found.outcome == Outcome.OPTIMAL, found.outcome != Outcome.UNDECIDED
    slack_ray, same = program.rays.shape[1] - 1, tolerances(points.dtype).reduced_cost

    def follow(normal: Array, vertex: Array, corner: Corner) -> Edge:
        basis = corner.basis
        dual = _dual(positions, basis)
        ways = positions - jnp.stack([simplex_basis.combination(row, program.rays) for row in dual])
        entering, sound = first_edge(normal, ways, 1 + jnp.max(jnp.abs(dual), axis=(0, 1)), same)
        exists = entering < ways.shape[1]
        direction = simplex_basis.times(basis.inverse, simplex_basis.ray(program.rays, entering))
        leaving, pivots = _leaving(corner, direction)
        following = _corner(
            program, simplex_basis.pivot(basis, leaving, entering, direction, exists & pivots), corner.target
        )
        way = column(ways, entering)
        way = way / jnp.where(exists, jnp.sqrt(jnp.sum(way * way, axis=0)), 1)
        loaded = jnp.any(basis.chosen == slack_ray, axis=0) | (entering == slack_ray)
        sound &= (pivots | ~exists) & following.sound
        return Edge(way, _position(positions, following), exists, loaded | ~exists, sound, following)

    # The pivots until here have spoilt the inverse.
    first = _corner(program, simplex_basis.factorised(program, found.basis.chosen), program.target)
    nearest, sound = walk_around(follow, _position(positions, first), first, points, active & stands, MAX_EDGES)
    return nearest, stands, decided & (sound & first.sound | ~stands)


def _program(rays: ConeRays, up: Array, axes: Array) -> tuple[Program, Float[Array, "2 r *n"]]:
    """The program of the vertex farthest along the first axis, and the rays' positions; the last ray is the load's slack."""
    columns = jnp.swapaxes(rays.rays, 0, 1)
    forces, torques = columns[:3], columns[3:] / rays.length
    project = lambda vector: jnp.tensordot(vector, torques, axes=1, precision=jax.lax.Precision.HIGHEST)
    positions = jnp.stack([-project(axes[1]), project(axes[0])])
    load = rays.mask.astype(forces.dtype) / LOAD
    columns = jnp.concatenate([forces, project(up)[None], load[None], positions[:1]])
    unit = lambda row, k: jnp.zeros((k, *columns.shape[2:]), columns.dtype).at[row].set(1)
    columns = jax.lax.optimization_barrier(jnp.concatenate([columns, unit(4, 6)[:, None]], axis=1))
    positions = jnp.concatenate([positions, jnp.zeros_like(positions[:, :1])], axis=1)
    target = jnp.concatenate([up, jnp.array([0, 1, 0], up.dtype)])
    target = jnp.broadcast_to(target.reshape(6, *[1] * (columns.ndim - 2)), (6, *columns.shape[2:]))
    target = target + tolerances(columns.dtype).slack * simplex_basis.mixture(columns)
    return Program(columns, unit(5, 6), target, jnp.ones(columns.shape[2:], columns.dtype)), positions


def _at_basis(positions: Array, basis: Basis) -> Float[Array, "2 6 *n"]:
    """Positions of the rays of a basis; unit columns and the free one have none."""
    found = jnp.take_along_axis(positions, jnp.clip(basis.chosen, 0, positions.shape[1] - 1)[None], axis=1)
    return jnp.where(basis.chosen >= 0, found, 0)


def _dual(positions: Array, basis: Basis) -> Float[Array, "2 6 *n"]:
    """What a change of each row moves the CoM by."""
    own = _at_basis(positions, basis)
    return jnp.stack([simplex_basis.combination(own[i], basis.inverse) for i in range(2)])


def _corner(program: Program, basis: Basis, target: Float[Array, "6 *n"]) -> Corner:
    """The vertex of a basis, its inverse improved."""
    basis = simplex_basis.improved(program, basis)
    held = simplex_basis.times(basis.inverse, target)
    missing = jnp.where(basis.chosen >= 0, jnp.maximum(-held, 0), 0)
    moved = target + jnp.sum(simplex_basis.columns(program, basis.chosen) * missing, axis=1)
    sound = jnp.max(missing, axis=0) <= LOST * SHORT[jnp.finfo(held.dtype).bits]
    return Corner(basis, moved, held + missing, sound)


def _position(positions: Array, corner: Corner) -> Float[Array, "2 *n"]:
    return jnp.sum(_at_basis(positions, corner.basis) * corner.weights, axis=1)


def _leaving(corner: Corner, direction: Array) -> tuple[Bool[Array, "6 *n"], Bool[Array, "*n"]]:
    """The column that comes to zero first as a ray comes in, as far as rounding can tell, and whether there is any."""
    index = corner.basis.chosen
    unit = index <= UNIT
    size = jnp.where(unit, jnp.abs(direction), direction)
    falls = (index != FREE) & (size > tolerances(direction.dtype).pivot)
    above = jnp.where(unit, 0, corner.weights)
    return simplex.leaving_of(falls, above, size, SHORT[jnp.finfo(direction.dtype).bits], size)
