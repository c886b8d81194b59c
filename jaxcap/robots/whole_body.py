"""A block of robot states (q, v): what is scored of them, and where and how fast the points of the patches are."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float, Int

from jaxcap.robots.centroidal import CentroidalStates, momentum
from jaxcap.robots.ground import Ground
from jaxcap.robots.patches import ContactPatch, Patches
from jaxcap.robots.tree import BLOCK, Link, links

STEEP = 0.1
"""A tangent shorter than this, projected onto the ground, says nothing."""


class Feet(NamedTuple):
    """The points of all patches, k of them, in n states; world frame."""

    points: Float[np.ndarray, "n k 3"]
    """On the ground below (or above) where they are [m]: what they push on."""
    heights: Float[np.ndarray, "n k"]
    """Of the points themselves above the ground [m]."""
    speeds: Float[np.ndarray, "n k"]
    """[m/s]"""
    frames: Float[np.ndarray, "n k 3 3"]
    """Columns: along the patch's length, along its width, the ground's normal."""
    tilts: Float[np.ndarray, "n k"]
    """Cosine between the normals of patch and ground."""

    def on_floor(self, height: float) -> "Feet":
        """The same feet over a level floor there [m], where these are over one at zero."""
        points = np.concatenate([self.points[..., :2], np.full_like(self.points[..., 2:], height)], axis=-1)
        return self._replace(points=points, heights=self.heights - height)


class Soles(NamedTuple):
    """The patches, p of them, by their lowest points."""

    heights: Float[np.ndarray, "n p"]
    """Above the ground [m]."""
    speeds: Float[np.ndarray, "n p"]
    """[m/s]"""
    tilts: Float[np.ndarray, "n p"]
    """Cosine between the normals of patch and ground."""


class WholeBody(NamedTuple):
    """All of that."""

    states: CentroidalStates
    feet: Feet


class Points(NamedTuple):
    """The points of a robot's patches, in one list."""

    patch: Int[np.ndarray, " k"]
    """Which patch each belongs to."""
    flat: Bool[np.ndarray, " p"]
    """Which patches are rectangles."""

    @staticmethod
    def of(patches: Patches) -> "Points":
        """The points of these patches."""
        sizes = [len(patch.points) for patch in patches.values()]
        flat = [not patch.is_point for patch in patches.values()]
        return Points(np.repeat(np.arange(len(sizes)), sizes), np.array(flat, dtype=bool))

    def centres(self, feet: Feet) -> Float[np.ndarray, "n p 3"]:
        """The middle of each patch [m]."""
        places = feet.points + feet.heights[..., None] * [0.0, 0.0, 1.0]
        return np.stack([places[:, self.patch == patch].mean(axis=1) for patch in range(len(self.flat))], axis=1)

    def soles(self, feet: Feet) -> Soles:
        """The patches by their lowest points."""
        found = []
        for patch in range(len(self.flat)):
            mine = self.patch == patch
            lowest = np.nan_to_num(feet.heights[:, mine], nan=np.inf).argmin(axis=1)[:, None]
            those = (feet.heights, feet.speeds, feet.tilts)
            found.append([np.take_along_axis(each[:, mine], lowest, axis=1)[:, 0] for each in those])
        return Soles(*(np.stack(parts, axis=1) for parts in zip(*found, strict=True)))


def whole_body(
    model: pin.Model, patches: Patches, ground: Ground, q: Float[np.ndarray, "n nq"], v: Float[np.ndarray, "n nv"]
) -> WholeBody:
    """What is scored of n robot states, and their feet.

    Args:
        model: Pinocchio's.
        patches: Where the robot can touch, at least one.
        ground: What it stands on.
        q: (n, nq) in Pinocchio's conventions.
        v: (n, nv) likewise.
    """
    blocks = [_block(model, patches, ground, q[i : i + BLOCK], v[i : i + BLOCK]) for i in range(0, max(len(q), 1), BLOCK)]
    states = CentroidalStates(*(np.concatenate(parts) for parts in zip(*(block.states for block in blocks), strict=True)))
    feet = Feet(*(np.concatenate(parts) for parts in zip(*(block.feet for block in blocks), strict=True)))
    return WholeBody(states, feet)


def _block(model: pin.Model, patches: Patches, ground: Ground, q: np.ndarray, v: np.ndarray) -> WholeBody:
    found = links(model, q, v)
    feet = [_foot(model, found, patch, ground) for patch in patches.values()]
    return WholeBody(momentum(model, found), Feet(*(np.concatenate(parts, axis=1) for parts in zip(*feet, strict=True))))


def _foot(model: pin.Model, found: list[Link], patch: ContactPatch, ground: Ground) -> Feet:
    """The points of one patch."""
    frame = model.frames[model.getFrameId(patch.frame)]
    link, inside = found[frame.parentJoint], frame.placement
    rotation = np.einsum("ijn,jk->ikn", link.rotation, inside.rotation @ np.array(patch.rotation))
    places = [link.point(inside.act(point)) for point in patch.points]
    below = ground.under(places[0].T[:, :2]).normal.T
    places = [place - patch.radius * below for place in places]
    along = rotation[:, 0] if not patch.is_point else np.broadcast_to(np.array([[1.0], [0], [0]]), below.shape)
    under = [ground.under(place.T[:, :2]) for place in places]
    return Feet(
        points=np.stack(
            [np.column_stack([place.T[:, :2], here.height]) for place, here in zip(places, under, strict=True)], 1
        ),
        heights=np.stack([place[2] - here.height for place, here in zip(places, under, strict=True)], axis=1),
        speeds=np.stack([np.linalg.norm(link.velocity(place), axis=0) for place in places], axis=1),
        frames=np.stack([_frames(here.normal, along.T) for here in under], axis=1),
        tilts=np.stack([(rotation[:, 2].T * here.normal).sum(axis=1) for here in under], axis=1),
    )


def _frames(normals: Float[np.ndarray, "n 3"], along: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Rotations whose third column is the normal and whose first is `along`, laid onto the ground."""
    laid = lambda vectors: vectors - (vectors * normals).sum(axis=1, keepdims=True) * normals
    tangent, spare = laid(along), laid(np.broadcast_to([1.0, 0.0, 0.0], normals.shape))
    tangent = np.where(np.linalg.norm(tangent, axis=1, keepdims=True) < STEEP, spare, tangent)
    tangent = tangent / np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.stack([tangent, np.cross(normals, tangent), normals], axis=2)
