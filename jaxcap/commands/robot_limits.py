"""What `jaxcap score --robot` knows of the robot besides its states: its mass, and what its joints can bear in each row."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxcap.contacts.actuation import Actuation
from jaxcap.contacts.contact_set import ContactSet
from jaxcap.errors import InputError
from jaxcap.files.columns import StateBatch
from jaxcap.files.contact_columns import RowContacts

if TYPE_CHECKING:
    from jaxcap.robots import Robot

ROWS = 1 << 14
"""At a time where limits count: the Jacobians of a row of TALOS are 11 kB."""


class TorqueLimits:
    """What the joints of a robot can bear in the rows of its log, all batches in one size: compiling takes a minute.

    Args:
        robot: With its patches, whose points are the contacts of each row.

    Raises:
        InputError: If a joint between the base and a patch has no limit, or more than one axis.
    """

    def __init__(self, robot: "Robot"):
        import pinocchio as pin

        self._robot, self._neutral = robot, pin.neutral(robot.model)
        self._contacts = sum(len(patch.points) for patch in robot.patches.values())
        all_touch = ContactSet(np.zeros((self._contacts, 3)), np.eye(3), np.ones(self._contacts))
        self.joints = self._actuation(self._neutral, all_touch).joints
        """Those between the base and a patch."""

    def of(self, batch: StateBatch) -> Actuation:
        """Of each row of a batch of the log's states. Rows that are not finite have no CoM either, which marks them."""
        from jaxcap.files.arrow_columns import to_numpy

        contacts = batch.contacts
        assert isinstance(contacts, RowContacts), "a log gives each row its contacts"
        q = to_numpy(batch.columns["configuration"], "configuration")
        q = np.where(np.isfinite(q).all(axis=1, keepdims=True), q, self._neutral)
        sets = ContactSet.unchecked(*(field[:, : self._contacts] for field in contacts[:4]))
        return self._actuation(q, sets).padded(contacts.mask.shape[1], self.joints)

    def _actuation(self, q: np.ndarray, contacts: ContactSet) -> Actuation:
        from jaxcap.robots import actuation

        return actuation(self._robot.model, q, contacts, self._robot.patches)


class Counted(NamedTuple):
    """What of the robot counts."""

    mass: float | None = None
    """That the column of angular momentum is divided by [kg]; None: it does not count."""
    limits: TorqueLimits | None = None
    """None: joints bear anything."""
    words: str = ""
    """The same, to be told; nothing where the states are no log."""

    def rows(self, batch_size: int) -> int:
        """At a time, at most."""
        return batch_size if self.limits is None else min(batch_size, ROWS)


def counted(robot: "Robot | None", point_mass: bool, mass: float | None) -> Counted:
    """What of a robot counts: all that is known of it.

    Args:
        robot: None for states that are no log.
        point_mass: Nothing does.
        mass: In place of the robot's [kg].

    Raises:
        InputError: For options that contradict each other.
    """
    if point_mass and (robot is None or mass is not None):
        raise InputError(f"--point-mass (expected {'with --robot' if robot is None else 'without --mass'})")
    if robot is None:
        return Counted(mass)
    name = robot.model.name
    if point_mass:
        return Counted(words=f"{name} is a point mass: neither torque limits nor angular momentum count")
    import pinocchio as pin

    mass = pin.computeTotalMass(robot.model) if mass is None else mass
    momentum = f"angular momentum, over {mass:.4g} kg"
    try:
        limits = TorqueLimits(robot)
    except InputError as error:
        why = str(error).partition(":")[0]  # what follows is for Python
        return Counted(mass, None, f"{why}: torque limits do not count, but {momentum}")
    return Counted(mass, limits, f"{name}: torque limits of {limits.joints} joints count, and {momentum} (see --point-mass)")
