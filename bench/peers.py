"""Other software on the same states: the paper's algorithm, and two C++ libraries of its second author's group.

    paper       Algorithms 1 to 3 to the letter, in `reference/`: NumPy, linear programs by HiGHS, the QP by ProxQP
    bezier      hpp-bezier-com-traj, `zeroStepCapturability`: is there a cubic Bezier curve of a given duration, from the
                state to rest, whose wrench stays in the cone? Needs the cone's faces beforehand, not counted
    bezier all  the same at each of `DURATIONS` until one is found: it does not know how long a stop takes
    bezier l    the same at one duration, with a free angular momentum and a check every 0.02 s: another model, and slower
    LP          hpp-centroidal-dynamics, one linear program by qpOASES: static equilibrium only, which is one step of many
    cdd         hpp-centroidal-dynamics, the faces of a contact set by the double description method

The C++ libraries are installed for a comparison only, `pip install hpp-bezier-com-traj hpp-centroidal-dynamics`; they bring
parts under the GPL (cddlib, GLPK), so nothing here may ever depend on them. All work in double precision.
"""

import ctypes
import importlib.metadata
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np

import jaxcap
from bench.stances import Batch

INSTALL = "pip install hpp-bezier-com-traj hpp-centroidal-dynamics"
LIBRARIES = (
    "libcdd.so.0",
    "libCoinUtils.so.3",
    "libClp.so.1",
    "libqpOASES.so.3.2",
    "libglpk.so.40",
    "libhpp-centroidal-dynamics.so",
    "libhpp-bezier-com-traj.so",
)
"""Loaded by hand, in this order: the wheels' modules do not know where theirs are."""
DURATION, DURATIONS = 0.8, tuple(np.round(np.arange(0.2, 2.01, 0.2), 1))
"""[s]; the one finds about the most verdicts of all."""
STEP = 0.02
"""[s]"""
SIDES = 4
"""Of the pyramids: `hpp` is run with four."""
MASS = 1.0
"""[kg]; of no account."""


def hpp():
    """The two libraries' modules, `dynamics` and `bezier`; None where they are not installed or cannot be loaded."""
    try:
        folder = importlib.metadata.distribution("hpp-bezier-com-traj").locate_file("cmeel.prefix/lib")
        import pinocchio  # noqa: F401, loads what they share with it

        for name in LIBRARIES:
            ctypes.CDLL(str(folder / name))
        import hpp_bezier_com_traj as bezier
        import hpp_centroidal_dynamics as dynamics
    except (importlib.metadata.PackageNotFoundError, ImportError, OSError):
        return None
    return SimpleNamespace(bezier=bezier, dynamics=dynamics)


def with_their_tangents(contacts: jaxcap.ContactSet) -> jaxcap.ContactSet:
    """The contacts with the tangents that hpp-centroidal-dynamics gives to a normal: normal x y, or normal x x.

    Its contacts have no tangents, so its pyramids stand as these have them; ours must stand the same way.
    """
    normals = contacts.frames[:, :, 2]
    across = np.cross(normals, [0.0, 1.0, 0.0])
    across = np.where(np.linalg.norm(across, axis=1)[:, None] < 1e-5, np.cross(normals, [1.0, 0.0, 0.0]), across)
    across /= np.linalg.norm(across, axis=1)[:, None]
    frames = np.stack([across, np.cross(normals, across), normals], axis=2)
    return jaxcap.ContactSet(contacts.points, frames, contacts.friction)


def equilibrium(modules, contacts: jaxcap.ContactSet, algorithm: str):
    """Their contact set, for the faces ("PP") or a linear program ("DLP").

    Raises ValueError where friction differs from contact to contact, which they cannot have, or where cddlib fails.
    """
    if np.ptp(contacts.friction):
        raise ValueError(f"friction from {contacts.friction.min()} to {contacts.friction.max()} (expected one coefficient)")
    dynamics = modules.dynamics
    found = dynamics.Equilibrium("", MASS, SIDES, dynamics.SolverLP.SOLVER_LP_QPOASES, True, 10, False)
    kind = getattr(dynamics.EquilibriumAlgorithm, f"EQUILIBRIUM_ALGORITHM_{algorithm}")
    if not found.setNewContacts(contacts.points, contacts.frames[:, :, 2], float(contacts.friction[0]), kind):
        raise ValueError("cddlib found no faces")
    return found


def paper(batch: Batch) -> Callable[[], list]:
    """The paper's verdicts: a call that returns one for each state, None where it has none."""
    from reference.algorithm import is_state_capturable
    from reference.contacts import wrench_rays

    contacts = batch.contacts
    wrenches = wrench_rays(contacts.points, contacts.frames, contacts.friction, SIDES)

    def verdict(com, velocity):
        try:
            return is_state_capturable(None, None, None, com, velocity, sides=SIDES, wrenches=wrenches).capturable
        except ArithmeticError:
            return None

    return lambda: [verdict(*state) for state in zip(batch.coms, batch.com_velocities, strict=True)]


def beziers(modules, batch: Batch) -> dict[str, Callable[[], np.ndarray]]:
    """The three ways to ask `zeroStepCapturability`: calls that return (n,) the duration of a curve [s], NaN for none."""
    faces, still = equilibrium(modules, batch.contacts, "PP"), np.zeros(3)
    ask = modules.bezier.zeroStepCapturability

    def way(durations, angular: bool = False, step: float = -1.0):
        def one(com, velocity):
            found = (t for t in durations if ask(faces, com, velocity, still, angular, t, step).success)
            return next(found, np.nan)

        return lambda: np.array([one(*state) for state in zip(batch.coms, batch.com_velocities, strict=True)])

    return {
        "bezier": way([DURATION]),
        "bezier all": way(sorted(DURATIONS, key=lambda duration: abs(duration - DURATION))),
        "bezier l": way([DURATION], angular=True, step=STEP),
    }


def curve_end(modules, batch: Batch, index: int, duration: float) -> np.ndarray:
    """Where the curve of one state ends (3,) [m]; its control points are com, com + velocity duration/3, end, end."""
    faces = equilibrium(modules, batch.contacts, "PP")
    state = batch.coms[index], batch.com_velocities[index]
    return np.ravel(modules.bezier.zeroStepCapturability(faces, *state, np.zeros(3), False, duration, -1.0).x)


def static(modules, batch: Batch) -> Callable[[], np.ndarray]:
    """Whether the CoM is in static equilibrium, by one linear program each: a call that returns (n,) bools."""
    program = equilibrium(modules, batch.contacts, "DLP")

    def verdicts():
        with unheard():
            return np.array([program.computeEquilibriumRobustness(com)[1] >= 0 for com in batch.coms])

    return verdicts


@contextmanager
def unheard() -> Iterator[None]:
    """Without what C code prints: qpOASES warns of small steps, thousands of times."""
    kept = [os.dup(stream) for stream in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        yield
    finally:
        for stream, before in zip((1, 2), kept, strict=True):
            os.dup2(before, stream)
            os.close(before)
        os.close(nowhere)
