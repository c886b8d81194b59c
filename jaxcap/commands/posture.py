"""A robot in one posture, as commands are given it: where it touches there, and what its joints bear."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np

from jaxcap.commands.states import load_robot
from jaxcap.contacts.actuated_cone import actuated_cone
from jaxcap.contacts.actuation import ActuatedRays, Actuation, actuated
from jaxcap.contacts.cone import CentroidalCone, cone_rays
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.contacts.limbs import SeveralLinksError
from jaxcap.contacts.sums import TooManyFacesError
from jaxcap.errors import InputError

if TYPE_CHECKING:
    from jaxcap.robots import Robot

NEEDED = ("configuration", "contact_points", "contact_frames", "contact_friction", "contact_mask")
"""Columns of a posture, as `jaxcap states` writes them."""


class Posture(NamedTuple):
    """Of one robot."""

    contacts: ContactSet
    actuation: Actuation
    height: float
    """Of its CoM [m]."""
    words: str
    """Robot, posture, and how many of its joints count."""


class Limited(NamedTuple):
    """What a robot can exert."""

    cone: CentroidalCone | ActuatedRays
    note: str = ""
    """Why it is rays."""


def posture_of(robot: str, posture: str, row: int, joints: Sequence[str], friction: float = 0.5) -> Posture:
    """A robot in one posture.

    Args:
        robot: Its name or file.
        posture: A name that its SRDF has: it then stands on what is at the height of its lowest patch, level; or a Parquet
            file of states, as `jaxcap states` writes it.
        row: Of that file.
        joints: Parts of names: joints whose name holds one of them count; none for all that carry a contact.
        friction: Of a named posture.

    Raises:
        InputError: For a posture, a row or a joint that is not there, and for joints without a limit.
    """
    whose = load_robot(robot, "robots")
    if posture in whose.postures:
        if row != 0:
            raise InputError(f"--row {row} (expected with a file as --posture, {posture!r} is one of {robot}'s own)")
        q, contacts = _named(whose, posture, friction)
    elif Path(posture).suffix == ".parquet":
        q, contacts = _read(Path(posture), row, whose)
    else:
        own = ", ".join(sorted(whose.postures)) or "none"
        raise InputError(f"--posture {posture!r} (expected a .parquet file of states, or a posture of {robot}: {own})")
    if not np.asarray(contacts.mask).any():
        raise InputError(f"--posture {posture}: no contact touches")
    import pinocchio as pin

    model = whose.model
    bearing = _bearing(whose, q, contacts, joints)
    height = float(pin.centerOfMass(model, model.createData(), q)[2])
    where = posture if posture in whose.postures else f"{posture} row {row}"
    return Posture(contacts, bearing, height, f"{model.name}, {where}: limits of {int(bearing.mask.sum())} joints")


def limited_cone(posture: Posture, sides: int) -> Limited:
    """What the robot can exert, by faces where they are not too many, else by rays."""
    try:
        return Limited(actuated_cone(posture.contacts, posture.actuation, sides))
    except TooManyFacesError as error:
        why = str(error).partition(" (")[0]
    except SeveralLinksError:
        why = "a limb touches with several links"
    except ValueError as error:
        raise InputError(str(error)) from error
    rays = cone_rays(posture.contacts, sides)
    return Limited(actuated(rays, posture.actuation), f"{why}: computed by rays, which takes several times as long")


def _bearing(robot: "Robot", q: np.ndarray, contacts: ContactSet, joints: Sequence[str]) -> Actuation:
    from jaxcap.robots import actuation

    names = list(robot.model.names)[2:]
    for part in joints:
        if not any(part in name for name in names):
            raise InputError(f"--joints {part!r} is in no name of a joint (expected a part of {', '.join(names)})")
    wanted = [name for name in names if any(part in name for part in joints)] if joints else None
    return actuation(robot.model, q, contacts, robot.patches, joints=wanted)


def _named(robot: "Robot", name: str, friction: float) -> tuple[np.ndarray, ContactSet]:
    """The lowest patch says where the ground is."""
    from jaxcap.robots import states_of

    q = robot.postures[name]
    found = states_of(robot, np.array([0.0, 0.01]), np.stack([q, q]), np.zeros((2, robot.model.nv)), friction=friction)
    return q, jax.tree.map(lambda field: np.asarray(field)[0], found.contacts)


def _read(path: Path, row: int, robot: "Robot") -> tuple[np.ndarray, ContactSet]:
    """A row of states."""
    from jaxcap.commands.view import read_columns

    columns = read_columns(path)
    rows = len(columns["configuration"])
    if not 0 <= row < rows:
        raise InputError(f"--row {row} (expected 0 to {rows - 1}: {path} has {rows} rows)")
    one = {name: columns[name][row] for name in NEEDED}
    if one["configuration"].shape != (robot.model.nq,):
        shape = one["configuration"].shape
        raise InputError(f"{path}: 'configuration' has rows of shape {shape} (expected ({robot.model.nq},), the robot's)")
    points = sum(len(patch.points) for patch in robot.patches.values())
    if len(one["contact_mask"]) != points:
        raise InputError(
            f"{path}: rows of {len(one['contact_mask'])} contacts (expected {points}, those of the robot's patches)"
        )
    if not np.isfinite(one["configuration"]).all():
        raise InputError(f"{path}: 'configuration' of row {row} is not finite")
    fields = (one["contact_points"], one["contact_frames"], one["contact_friction"])
    return one["configuration"], ContactSet(*fields, mask=one["contact_mask"].astype(bool))
