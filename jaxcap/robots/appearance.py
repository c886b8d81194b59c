"""How a robot looks: the visual shapes of its links, as triangles, for pictures. One whose mesh is not there is left out."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float, Int

from jaxcap.errors import needs_extra
from jaxcap.robots.models import PathLike, file_of, mjcf_shapes, urdf_shapes


class Look(NamedTuple):
    """One shape of a link."""

    joint: int
    """Of the model, that carries the link."""
    vertices: Float[np.ndarray, "v 3"]
    """In the frame of that joint [m]."""
    triangles: Int[np.ndarray, "t 3"]
    color: tuple[int, int, int]
    """Red, green, blue, of 255."""


def looks(name_or_path: PathLike, model: pin.Model) -> tuple[Look, ...]:
    """The visual shapes of a robot.

    Args:
        name_or_path: As for `load`.
        model: What `load` made of it.

    Returns:
        One for each shape; perhaps none, where no mesh is there.

    Raises:
        InputError: For an unknown name, or a file that is not there.
    """
    path = file_of(name_or_path)
    whole, shapes = _visuals(path)
    found = []
    for shape in shapes.geometryObjects:
        triangles = _triangles(shape.geometry) if shape.parentJoint else None
        if triangles is not None:
            vertices, faces = triangles
            joint, place = _carrier(model, whole.names[shape.parentJoint])
            place = place * shape.placement
            vertices = vertices * np.asarray(shape.meshScale).reshape(3)
            red, green, blue = (round(255 * float(part)) for part in np.asarray(shape.meshColor).reshape(4)[:3])
            found.append(Look(joint, vertices @ place.rotation.T + place.translation, faces, (red, green, blue)))
    return tuple(found)


def _visuals(path: Path) -> tuple[pin.Model, pin.GeometryModel]:
    """The visual shapes, and the model with all joints that they hang on."""
    if path.suffix.lower() == ".urdf":
        whole = pin.buildModelFromUrdf(os.fspath(path), pin.JointModelFreeFlyer())
        return whole, urdf_shapes(path, whole, pin.GeometryType.VISUAL)
    return mjcf_shapes(path, pin.GeometryType.VISUAL)


def _carrier(model: pin.Model, joint: str) -> tuple[int, pin.SE3]:
    """The joint that carries what this one did before some were locked, and where that is in its frame."""
    if model.existJointName(joint):
        return model.getJointId(joint), pin.SE3.Identity()
    frame = model.frames[model.getFrameId(joint)]
    return frame.parentJoint, frame.placement


def _triangles(shape: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices and triangles of a shape in its own frame; None for a kind that is not drawn, such as a floor."""
    if isinstance(shape, coal.BVHModelBase):
        faces = [shape.tri_indices(i) for i in range(shape.num_tris)]
        return np.array(shape.vertices()).reshape(-1, 3), np.array([[face[0], face[1], face[2]] for face in faces])
    with needs_extra("view", "drawing shapes"):
        from trimesh import creation
    if isinstance(shape, coal.Box):
        mesh = creation.box(2 * np.asarray(shape.halfSide).reshape(3))
    elif isinstance(shape, coal.Sphere):
        mesh = creation.icosphere(radius=shape.radius)
    elif isinstance(shape, coal.Cylinder):
        mesh = creation.cylinder(shape.radius, 2 * shape.halfLength)
    elif isinstance(shape, coal.Capsule):
        mesh = creation.capsule(2 * shape.halfLength, shape.radius)
    else:
        return None
    vertices = np.array(mesh.vertices)
    return vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2, np.array(mesh.faces)
