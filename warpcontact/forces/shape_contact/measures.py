"""Measures of shape contacts that are computed on request: points, curvatures and gradients."""

from typing import TYPE_CHECKING, Any

from warpcontact.kernels.shapes import measures
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.shapes.curvature import pair_curvature
from warpcontact.system.launches import launch_kernel

if TYPE_CHECKING:
    from warpcontact.forces.shape_contact.contact_sets import ShapeContactSet
    from warpcontact.model.model import DeviceModel


def measure(name: str, own: "ShapeContactSet", model: "DeviceModel") -> None:
    """Computes the measure ``name`` of a set of shape contacts from their last evaluation."""
    for kinds, items in own.ranges:
        if name == "shape_points":
            kernel, inputs = measures.points(own.real), _point_inputs(own, kinds)
        elif has_curvatures(kinds):
            make = measures.curvatures if name == "shape_curvatures" else measures.gradients
            kernel, inputs = make(*kinds, own.real), _curvature_inputs(own, kinds)
        else:
            continue
        launch_kernel(
            kernel,
            (model.envs, items.stop - items.start),
            device=model.device,
            state=model.arrays.state,
            first=items.start,
            contact_shapes=own.contact_shapes,
            measured=own.measures[name],
            **inputs,
        )


def has_curvatures(kinds: tuple[type[Form], type[Form]]) -> bool:
    """Returns whether curvatures of a pair of kinds are available; custom shapes may not have them."""
    try:
        pair_curvature(*kinds)
    except TypeError:
        return False
    return True


def _point_inputs(own: "ShapeContactSet", kinds: tuple[type[Form], type[Form]]) -> dict[str, Any]:
    poses = own.shapes[kinds[1]].arrays.pose
    return {"shape_poses_b": poses, "settings": own.settings, "shape_contacts": own.shape_contacts}


def _curvature_inputs(own: "ShapeContactSet", kinds: tuple[type[Form], type[Form]]) -> dict[str, Any]:
    shapes_a, shapes_b = (own.shapes[kind].arrays for kind in kinds)
    return {"shapes_a": shapes_a, "shapes_b": shapes_b, "warm_starts": own.warm_starts}
