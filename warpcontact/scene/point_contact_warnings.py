"""Warnings about contacts at points that should be body contacts, because they have no force on some faces."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from warpcontact.scene.body_contact import unsupported_reason
from warpcontact.scene.elements import Contact, Points, Surface
from warpcontact.scene.shapes import ShapeContact

if TYPE_CHECKING:
    from warpcontact.scene.scene_data import SceneData

# Number of contacts that a warning names.
_NAMED = 3


def point_contact_warnings(scene: "SceneData") -> list[str]:
    """Returns warnings about contacts of a scene that ``add_body_contact`` should replace.

    These are contacts of the vertices of a closed mesh with another closed mesh, and shape contacts of a solid with flat faces and
    one with flat faces or straight sides, if body contact supports them, also with sharp instead of rounded edges.
    """
    found = []
    vertices = [one.name for one in scene.contacts if _is_of_vertices(one)]
    if vertices:
        found.append(
            f"{_listed(vertices)}: contact of the vertices of a closed mesh with a closed mesh has no force on faces "
            "without vertices of the other mesh. Two equal boxes fall through each other. Use add_body_contact"
        )
    flat = [one.name for one in scene.shape_contacts if _is_of_flat_faces(one)]
    if flat:
        found.append(
            f"{_listed(flat)}: shape contact has one contact point, so that solids do not come to rest on flat faces or "
            "straight sides. Use add_body_contact"
        )
    rounded = [one.name for one in scene.shape_contacts if _has_rounded_box(one) and _has_flat_faces(one)]
    if rounded:
        found.append(
            f"{_listed(rounded)}: shape contact has one contact point, so that boxes with rounded edges do not come to rest on flat "
            "faces. Use add_body_contact, with boxes of radius 0 or closed meshes"
        )
    return found


def _is_of_vertices(contact: Contact) -> bool:
    """Returns whether the points of a contact are the vertices of a closed mesh, and the surface is closed."""
    return (
        contact.facing is None
        and all(mesh.report.closed for mesh in contact.surface.meshes)
        and _are_vertices(contact.points, contact.points.surface)
    )


def _are_vertices(points: Points, surface: Surface | None) -> bool:
    if surface is None or len(surface.meshes) > 1 or not surface.mesh.report.closed:
        return False
    mesh = surface.mesh
    return np.array_equal(points.positions, mesh.vertices[np.unique(mesh.welded[mesh.faces])])


def _is_of_flat_faces(contact: ShapeContact) -> bool:
    """Returns whether body contact supports a shape contact of a flat face with a flat face or straight side."""
    pair = contact.shape, contact.other_shape
    return _has_flat_faces(contact) and unsupported_reason(*pair, contact.material) is None


def _has_rounded_box(contact: ShapeContact) -> bool:
    """Returns whether one of two single shapes is a box with rounded edges."""
    from warpcontact.kernels.shapes.rounded_box import RoundedBox

    pair = contact.shape, contact.other_shape
    rounded = any(issubclass(one.kind, RoundedBox) and one.sizes["radius"].any() for one in pair)
    return rounded and all(one.single for one in pair)


def _has_flat_faces(contact: ShapeContact) -> bool:
    """Returns whether a shape contact is of a flat face with a flat face or straight side."""
    # Imported on demand, because only shape contacts need them.
    from warpcontact.kernels.shapes.base import Plane
    from warpcontact.kernels.shapes.revolution import Cone, Cylinder
    from warpcontact.kernels.shapes.rounded_box import RoundedBox
    from warpcontact.kernels.shapes.spheres import Capsule

    # Shapes with flat faces, on which bodies rest, and those with straight sides, which lie on them.
    flat = (Plane, RoundedBox, Cylinder, Cone)
    pair = contact.shape, contact.other_shape
    has_faces = any(issubclass(one.kind, flat) for one in pair)
    is_straight = all(issubclass(one.kind, (*flat, Capsule)) for one in pair)
    return has_faces and is_straight


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more
