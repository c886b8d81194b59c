"""Linear programs with the same rays, of one state and a robot's limits, each solved from the basis of the one before."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxcap.numerics import bounded_basis, bounded_simplex
from jaxcap.numerics.bounded_basis import Basis, Program


class Load(NamedTuple):
    """What rays and torques have to add up to."""

    wrench: Float[Array, "m *n"]
    """[m/s^2]"""
    target: Float[Array, "m *n"]
    """The same, moved a little into the cone: it breaks ties, and closes the cone in spite of rounding."""

    def moved(self, change: Float[Array, "m *n"]) -> "Load":
        """With this wrench added."""
        return Load(self.wrench + change, self.target + change)


class Solved(NamedTuple):
    """What is kept of a program that was solved."""

    basis: Basis
    found: Float[Array, "m *n"]
    """The weights of its columns, limits and wrench as they are."""
    outcome: Int[Array, "*n"]


class Own(NamedTuple):
    """What programs with the same rays do not share."""

    free: Float[Array, "p m *n"]
    target: Float[Array, "p m *n"]
    bound: Float[Array, "p m *n"]
    floor: Float[Array, "p *n"]


def stacked_programs(programs: list[Program]) -> Own:
    """Of all, one behind the other."""
    return Own(*(jnp.stack([getattr(one, name) for one in programs]) for name in Own._fields))


def solved_in_turn(programs: list[Program], loads: list[Load], basis: Basis, active: Bool[Array, "*n"]) -> list[Solved]:
    """The ends of programs with the same rays in active lanes, each from the basis of the one before.

    One loop for all, so that it is compiled once.

    Args:
        programs: of one polygon.
        loads: what each has to carry.
        basis: to start from.
        active: lanes that are solved.
    """
    rays, scale, bound = programs[0].rays, programs[0].scale, programs[0].bound
    nothing = Solved(basis, jnp.zeros_like(bound), jnp.zeros(scale.shape, jnp.int32))
    parts = stacked_programs(programs)

    def one(before: Solved, step: tuple) -> tuple[Solved, Solved]:
        own, wrench, exact = step
        program = Program(rays, own.free, own.target, own.bound, scale, own.floor)
        solution = bounded_simplex.solve(program, bounded_basis.renewed(program, before.basis), active)
        found = bounded_basis.times(solution.basis.inverse, wrench - solution.basis.side * exact)
        end = Solved(solution.basis, found, solution.outcome)
        return end, end

    wrenches = jnp.stack([load.wrench for load in loads])
    bounds = jnp.stack([jnp.where(program.bound > 0, bound, 0) for program in programs])
    ends = jax.lax.scan(one, nothing, (parts, wrenches, bounds))[1]
    return [jax.tree.map(lambda x, k=k: x[k], ends) for k in range(len(programs))]
