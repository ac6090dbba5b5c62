"""Radius of rolling of two shapes, which relates Newton's coefficient of rolling friction, a length, to ours."""

from warpcontact.kernels.shapes import shapes
from warpcontact.kernels.shapes.base import Shape as Form

_FLAT = (shapes.Plane, shapes.RoundedBox)


def rolling_radius(form: Form, other: Form) -> float | None:
    """Returns the radius R of rolling of two shapes [m], see ``add_shape_contact``.

    ``None``: R depends on where they touch. The edges of boxes and the end faces of cylinders are ignored, because
    nothing rolls on them.
    """
    for one, two in ((form, other), (other, form)):
        if isinstance(one, shapes.Sphere | shapes.Capsule | shapes.Cylinder) and isinstance(two, _FLAT):
            return one.radius
        if isinstance(one, shapes.Sphere) and isinstance(two, shapes.Sphere | shapes.Capsule):
            return one.radius * two.radius / (one.radius + two.radius)
    return None
