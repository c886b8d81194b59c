"""The waist: all that verdict and margins need of the (alpha, acceleration) polygon of a state, whatever it is made of."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

from jaxtyping import Array, Bool, Float

from jaxcap.one_state.boundary import Boundary


class Survey(NamedTuple):
    """The static region, and the polygon at alpha = 0."""

    s_min: Float[Array, "*n"]
    """Zero acceleration is feasible for alpha from here ... [m]"""
    s_max: Float[Array, "*n"]
    """... to here [m]; infinite where nothing bounds them."""
    standing: Bool[Array, "*n"]
    """The static region is not empty."""
    feasible: Bool[Array, "*n"]
    """Some acceleration keeps the contacts at alpha = 0 ..."""
    pulled_back: Bool[Array, "*n"]
    """... and each that does is negative."""
    known: Bool[Array, "*n"]
    """False where the survey failed."""
    hangs: Bool[Array, "*n"]
    """What ends the static region ahead bounds the acceleration from above, as far as rounding can tell: the polygon goes on
    beyond."""
    start: Any = ()
    """From where the walk may start."""
    near: Any = ()
    """From where the survey of a similar state may start."""
    effort: Float[Array, "*n"] | None = None
    """Share of the robot's torque limits that holding still takes; infinite where no torques do; None without limits."""


@runtime_checkable
class Producer(Protocol):
    """The (alpha, acceleration) polygon of one state, whatever it is made of: all that verdict and margins need of it."""

    @property
    def size(self) -> Float[Array, "*n"]:
        """Scale of alpha [m]: size of the stance plus the CoM's distance from it."""

    def survey(self, near: Any = None) -> Survey:
        """Static region, and polygon at alpha = 0. near: `Survey.near` of a similar state."""

    def knowing(self, survey: Survey) -> "Producer":
        """The same, with what its survey has found: ready to be walked."""

    def boundary(
        self,
        limit: Float[Array, "*n"],
        rising: bool | Bool[Array, ""] = False,
        most: int | None = None,
        enough: Float[Array, "*n"] | None = None,
    ) -> Boundary:
        """The lower boundary from alpha = 0, where the polygon must be feasible, to where it turns non-negative while
        rising (C1; not with `rising`), to the polygon's right end (C2), or a little beyond `limit` at most, or beyond where
        it has taken the energy `enough` [m^2/s^2] from the CoM.

        Lanes whose limit is not positive are not walked. After `most` pieces (MAX_PIECES) a walk ends with End.MAX_PIECES.
        """

    def seen(
        self, start: Float[Array, "*n"], heading: int | Float[Array, ""], acceleration: int | Float[Array, ""]
    ) -> "Producer":
        """With alpha counted from `start`, onwards (heading +1) or back (-1); and the acceleration as it is (+1) or with its
        sign turned (-1): the lower boundary is then minus the upper boundary of this one.
        """
