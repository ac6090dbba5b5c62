"""Measures of shape contacts that are computed on request: points, curvatures and gradients."""

from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.kernels.shapes import measures
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.shapes.curvature import pair_curvature

if TYPE_CHECKING:
    from warpcontact.forces.shape_contact.contact_sets import ShapeContactSet
    from warpcontact.model.model import DeviceModel


def measure(name: str, own: "ShapeContactSet", model: "DeviceModel") -> None:
    """Computes the measure ``name`` of a set of shape contacts from their last evaluation."""
    for kinds, items in own.ranges:
        if name == "shape_points":
            kernel, inputs = _points(model, own, kinds, items.start)
        elif has_curvatures(kinds):
            make = measures.curvatures if name == "shape_curvatures" else measures.gradients
            kernel, inputs = make(*kinds, own.real), _inputs(model, own, kinds, items.start)
        else:
            continue
        shape, outputs = (model.envs, items.stop - items.start), [own.measures[name]]
        wp.launch(kernel, dim=shape, inputs=inputs, outputs=outputs, device=model.device)


def has_curvatures(kinds: tuple[type[Form], type[Form]]) -> bool:
    """Returns whether curvatures of a pair of kinds are available; custom shapes may not have them."""
    try:
        pair_curvature(*kinds)
    except TypeError:
        return False
    return True


def _points(
    model: "DeviceModel", own: "ShapeContactSet", kinds: tuple[type[Form], type[Form]], first: int
) -> tuple[wp.Kernel, list[Any]]:
    shape_poses = own.shapes[kinds[1]].arrays.pose
    inputs = [
        model.arrays.state,
        first,
        own.contact_shapes,
        shape_poses,
        own.settings,
        own.shape_contacts,
    ]
    return measures.points(own.real), inputs


def _inputs(
    model: "DeviceModel", own: "ShapeContactSet", kinds: tuple[type[Form], type[Form]], first: int
) -> list[Any]:
    arrays = [own.shapes[kind].arrays for kind in kinds]
    return [model.arrays.state, first, own.contact_shapes, *arrays, own.warm_starts]
