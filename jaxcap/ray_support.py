"""Rays of the cone -> the way around its support polygon, without ever forming it.

With weights in units of the robot's weight, the static region is the image of a polytope:

    c = sum of weights * positions  such that  sum of weights * (force, vertical torque) = (upwards, 0),  weights >= 0,

where a ray's position is that of a CoM which its torque balances. A vertex is a basis and an edge is a pivot: of the rays
outside the basis, the one that takes the CoM the most outwards comes in. The rows of the program are force (3), torque about
gravity, and load; the sixth serves to find the first vertex.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxcap import simplex
from jaxcap.cone import ConeRays
from jaxcap.numerics import tolerances
from jaxcap.plane import Edge, across, first_edge, upward, walk_around
from jaxcap.simplex import FREE, UNIT, Basis, Outcome, Program

LOAD = 1e3
"""All contact forces together are at most this many times the weight, so that every region is bounded; edges that are due to
it count as infinitely far away."""
SHORT = {64: 1e-8, 32: 1e-5}
"""How far below zero a weight may come for the sake of a larger pivot, by the bits of a number. Soles that are parallel but
for rounding have nearly equal rays; a basis must not hold two of them."""
MAX_EDGES = 512
"""Most pivots around a region."""

def nearest_of_rays(rays: ConeRays, points: Float[Array, "2 m *n"], gravity: Float[Array, "3"]):
    """`Nearest` of points to the support polygon; whether the polygon is not empty; whether to trust that.

    rays: with lanes last. points, and the answer: relative to the contacts' centroid, in sizes of the stance.
    """
    rays, points = jax.lax.stop_gradient((rays, points))
    program, positions = _program(rays, gravity)
    bounds = tolerances(points.dtype)
    everywhere = jnp.all(jnp.isfinite(program.rays), axis=(0, 1))
    start = simplex.identity(everywhere.shape, points.dtype)
    found = simplex.solve(program, simplex.freed(program, start), everywhere)
    stands, decided = found.outcome == Outcome.OPTIMAL, found.outcome != Outcome.UNDECIDED
    slack_ray = program.rays.shape[1] - 1

    def follow(normal, vertex, basis: Basis) -> Edge:
        dual = _dual(positions, basis)
        ways = positions - jnp.stack([simplex.combination(row, program.rays) for row in dual])
        entering, sound = first_edge(normal, ways, 1 + jnp.max(jnp.abs(dual), axis=(0, 1)), bounds.reduced_cost)
        exists = entering < ways.shape[1]
        direction = simplex.times(basis.inverse, simplex.ray(program.rays, entering))
        leaving, pivots = _leaving(program, basis, direction)
        following = simplex.improved(program, simplex.pivot(basis, leaving, entering, direction, exists & pivots))
        way = simplex.ray(ways, entering)
        way = way / jnp.where(exists, jnp.sqrt(jnp.sum(way * way, axis=0)), 1)
        loaded = jnp.any(basis.index == slack_ray, axis=0) | (entering == slack_ray)
        end = _vertex(program, positions, following)
        return Edge(way, end, exists, loaded | ~exists, (pivots | ~exists) & sound, following)

    basis = simplex.improved(program, simplex.factorised(program, found.basis.index))   # pivots have spoilt the inverse
    first = _vertex(program, positions, basis)
    nearest, sound = walk_around(follow, first, basis, points, everywhere & stands, MAX_EDGES)
    return nearest, stands, everywhere & decided & (sound | ~stands)


def _program(rays: ConeRays, gravity) -> tuple[Program, Float[Array, "2 r *n"]]:
    """The program of the vertex farthest along the first axis, and the rays' positions; the last ray is the load's slack."""
    up, axes = upward(gravity), across(gravity)
    columns = jnp.swapaxes(rays.rays, 0, 1)
    forces, torques = columns[:3], columns[3:] / rays.length
    project = lambda vector: jnp.tensordot(vector, torques, axes=1, precision=jax.lax.Precision.HIGHEST)
    positions = jnp.stack([-project(axes[1]), project(axes[0])])
    load = rays.mask.astype(forces.dtype) / LOAD
    columns = jnp.concatenate([forces, project(up)[None], load[None], positions[:1]])
    unit = lambda row, k: jnp.zeros((k, *columns.shape[2:]), columns.dtype).at[row].set(1)
    columns = jax.lax.optimization_barrier(jnp.concatenate([columns, unit(4, 6)[:, None]], axis=1))
    positions = jnp.concatenate([positions, unit(0, 2)[:, None] * 0], axis=1)
    target = jnp.concatenate([up, jnp.array([0, 1, 0], up.dtype)])
    target = jnp.broadcast_to(target.reshape(6, *[1] * (columns.ndim - 2)), (6, *columns.shape[2:]))
    # A random amount of every ray: ties are broken, and the cone is closed in spite of rounding.
    amounts = jnp.asarray(np.random.default_rng(0).exponential(size=columns.shape[1]), columns.dtype)
    inside = jnp.tensordot(amounts, columns, axes=(0, 1)) * (4 / columns.shape[1])
    target = target + tolerances(columns.dtype).slack * inside
    return Program(columns, unit(5, 6), target, jnp.ones(columns.shape[2:], columns.dtype)), positions


def _at_basis(positions, basis: Basis) -> Float[Array, "2 6 *n"]:
    """Positions of the rays of a basis; unit columns and the free one have none."""
    found = jnp.take_along_axis(positions, jnp.clip(basis.index, 0, positions.shape[1] - 1)[None], axis=1)
    return jnp.where(basis.index >= 0, found, 0)


def _dual(positions, basis: Basis) -> Float[Array, "2 6 *n"]:
    """What a change of each row moves the CoM by."""
    own = _at_basis(positions, basis)
    return jnp.stack([simplex.combination(own[i], basis.inverse) for i in range(2)])


def _vertex(program: Program, positions, basis: Basis) -> Float[Array, "2 *n"]:
    held = simplex.times(basis.inverse, program.target)
    return jnp.sum(_at_basis(positions, basis) * held, axis=1)


def _leaving(program: Program, basis: Basis, direction) -> tuple[Bool[Array, "6 *n"], Bool[Array, "*n"]]:
    """The column that comes to zero first as a ray comes in, as far as rounding can tell, and whether there is any."""
    bounds = tolerances(direction.dtype)
    held = simplex.times(basis.inverse, program.target)
    unit = basis.index <= UNIT
    size = jnp.where(unit, jnp.abs(direction), direction)
    falls = (basis.index != FREE) & (size > bounds.pivot)
    left = jnp.where(unit, 0, jnp.maximum(held, 0))
    safe = jnp.where(falls, size, 1)
    short = SHORT[jnp.finfo(direction.dtype).bits]
    reach = jnp.min(jnp.where(falls, (left + short) / safe, jnp.inf), axis=0)
    element, leaving = simplex.largest(jnp.where(falls & (left / safe <= reach), size, 0))
    return leaving, element > 0
