"""Of the bases of a program that tie, the one whose derivative is right.

Where contacts are coplanar, several bases are optimal, and each of them moves in its own way with the contacts, also where
the optimum has one derivative only. Once the contacts have been moved a little, each its own way, nothing ties: the basis
that is optimal then is optimal before too, and its derivative is the limit of those nearby.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxcap.numerics import simplex
from jaxcap.numerics.guarded import tolerances
from jaxcap.numerics.simplex import FREE, UNIT, Outcome, Program

TURNS = (12.9898, 78.233, 37.719)
"""Of the directions in which contacts move: any numbers without a common measure [rad]."""


class Tied(NamedTuple):
    """A program whose optimum is known, in the lanes that are asked."""

    chosen: Int[Array, "6 *n"]
    """A basis of it, or where a search may begin."""
    program: Program
    optimum: Float[Array, "*n"]
    """Of the free variable."""
    noise: Float[Array, "*n"]
    """Optima this close are equal."""
    asked: Bool[Array, "*n"]


class Untied(NamedTuple):
    """The basis of the program that is left when its contacts are moved."""

    chosen: Int[Array, "6 *n"]
    """The one that was given where there is none."""
    known: Bool[Array, "*n"]
    """There is one."""
    apart: Bool[Array, "*n"]
    """It is a basis of the moved contacts only: of the others two of its columns are one, and what moves they do not say."""


def jiggled(rays: Float[Array, "6 r *#n"], contact: Int[Array, "r *#n"], less: float = 1.0) -> Float[Array, "6 r *#n"]:
    """The rays of contacts that are moved a little, each in a direction of its own; torques over the size of the stance.

    less: a factor of how far: to choose a basis, pivots have to be seen; to differentiate it, the nearer the better.
    """
    turns = jnp.array(TURNS, rays.dtype).reshape(3, *[1] * contact.ndim)
    ways = jnp.sin(turns * (1 + contact.astype(rays.dtype)))
    far = less * tolerances(rays.dtype).slack ** 0.5
    return jnp.concatenate([rays[:3], rays[3:] + far * jnp.cross(ways, rays[:3], axis=0)])


def untied(tied: Tied, moved: Float[Array, "6 r *n"]) -> Untied:
    """moved: the rays of the contacts after they were moved, and what else the program has among its rays as it is."""
    program = tied.program
    apart = program._replace(rays=moved)
    found = simplex.solve(apart, simplex.factorised(apart, tied.chosen), tied.asked)
    basis = simplex.factorised(program, found.basis.chosen)
    optimum = jnp.sum(jnp.where(basis.chosen == FREE, simplex.times(basis.inverse, program.target), 0), axis=0)
    # Where the contacts are flat, moved ones are not, and may have another optimum.
    known = tied.asked & (found.outcome == Outcome.OPTIMAL) & (jnp.abs(optimum - tied.optimum) <= tied.noise)
    units = lambda basis: jnp.sum(basis.chosen <= UNIT, axis=0)
    return Untied(jnp.where(known, found.basis.chosen, tied.chosen), known, known & (units(basis) > units(found.basis)))
