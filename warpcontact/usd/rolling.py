"""Rolling radius of two shapes, the ratio of Newton's rolling friction coefficient [m] to that of warpcontact."""

from warpcontact.kernels.shapes import shapes
from warpcontact.kernels.shapes.base import Shape as Form

_FLAT = (shapes.Plane, shapes.RoundedBox)


def rolling_radius(form: Form, other: Form) -> float | None:
    """Returns the rolling radius R of two shapes [m]; see ``Scene.add_shape_contact``.

    ``None`` if R depends on the contact point. Edges of boxes and end faces of cylinders are ignored, because
    nothing rolls on them.
    """
    for one, two in ((form, other), (other, form)):
        if isinstance(one, shapes.Sphere | shapes.Capsule | shapes.Cylinder) and isinstance(two, _FLAT):
            return one.radius
        if isinstance(one, shapes.Sphere) and isinstance(two, shapes.Sphere | shapes.Capsule):
            return one.radius * two.radius / (one.radius + two.radius)
    return None
