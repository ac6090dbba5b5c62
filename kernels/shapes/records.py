"""Defines the structs of shape contacts: shapes on a device, settings, results and warm starts."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.catalogue.device_model import coefficient_struct, named_struct
from warpcontact.kernels.shapes.base import Shape, WarmStart
from warpcontact.kernels.types import Struct, structs


@wp.struct
class ShapePose:
    """Pose of a shape on its body."""

    position: wp.vec3d  # origin of the shape frame in B, or in W if fixed to the world [m]
    orientation: wp.quatd  # shape frame → B (or W)


@wp.struct
class ContactShapes:
    """Index arrays of shape contacts: [contact]."""

    shape_a: wp.array(dtype=wp.int32)  # index among the shapes of its kind
    shape_b: wp.array(dtype=wp.int32)
    body_a: wp.array(dtype=wp.int32)  # or WORLD
    body_b: wp.array(dtype=wp.int32)


@wp.struct
class ShapeContactSettings:
    """Parameters of a shape contact."""

    kappa: wp.float64  # K = P_b + kappa (P_a − P_b) [-]
    max_depth: wp.float64  # deepest penetration that still counts as contact [m]
    torsion_radius: wp.float64  # arm at which torsion acts [m]; < 0: radius of the overlap
    force_scale: wp.float64  # factor on forces and couples [-]
    contact_tolerance: wp.float64  # gap below which there is contact [m]: 0, or the tolerance of nonsmooth contact
    enabled: wp.int32  # 0 or 1


@wp.struct
class WarmStarts:
    """Initial guesses of the next search."""

    warm_start: wp.array2d(dtype=WarmStart)  # [env, contact]


@functools.cache
def shapes_struct(kind: type[Shape]) -> Struct:
    """Returns the struct of arrays [env, shape] of one kind: ``coefficients`` and ``pose``."""
    coefficients = coefficient_struct(kind, wp.float64)
    fields = (("coefficients", wp.array2d(dtype=coefficients)), ("pose", wp.array2d(dtype=ShapePose)))
    return named_struct(f"{kind.__name__}Shapes", fields)


class ShapeContactStructs(NamedTuple):
    """Structs of shape contacts, in one precision."""

    ShapeContacts: Struct  # contacts of a set of shape pairs


@functools.cache
def shape_contact_structs(real: type) -> ShapeContactStructs:
    """Returns the structs of shape contacts in one precision. Normals point out of shape b, towards shape a."""
    t = structs(real)
    vec3, quat = t.vec3, t.quat

    @wp.struct
    class ShapeContacts:
        gap: wp.array2d(dtype=real)  # [env, contact] < 0 in overlap [m]
        penetration: wp.array2d(dtype=real)  # [env, contact] 0 unless status is CONTACT [m]
        normal: wp.array2d(dtype=vec3)  # [env, contact] W
        arm_a: wp.array2d(dtype=vec3)  # [env, contact] to K from the origin of B of shape a, W [m]
        arm_b: wp.array2d(dtype=vec3)  # [env, contact] likewise; for a shape fixed to the world from its origin
        status: wp.array2d(dtype=wp.int32)  # [env, contact] OPEN, CONTACT, …
        converged: wp.array2d(dtype=wp.int32)  # [env, contact] 1: the solver converged
        iterations: wp.array2d(dtype=wp.int32)  # [env, contact]
        residual: wp.array2d(dtype=real)  # [env, contact] [-]
        failures: wp.array2d(dtype=wp.int32)  # [env, contact] steps without a solution since reset
        # Read only by some laws and friction models
        curvature_1: wp.array2d(dtype=real)  # [env, contact] smaller principal curvature of the gap [1/m]
        curvature_2: wp.array2d(dtype=real)  # [env, contact] larger principal curvature of the gap [1/m]
        radius: wp.array2d(dtype=real)  # [env, contact] radius of rolling and of the contact patch [m]
        orientation: wp.array2d(dtype=quat)  # [env, contact] frame of b → W
        # Written with the force
        approach_speed: wp.array2d(dtype=real)  # [env, contact] dδ/dt at K, 0 unless CONTACT [m/s]
        slip_speed: wp.array2d(dtype=real)  # [env, contact] tangential, at K, 0 unless CONTACT [m/s]
        normal_force: wp.array2d(dtype=real)  # [env, contact] [N]
        friction_force: wp.array2d(dtype=vec3)  # [env, contact] on the body of a, W [N]
        torque: wp.array2d(dtype=vec3)  # [env, contact] of rolling and torsion on the body of a, W [N·m]
        # History
        entry_speed: wp.array2d(dtype=real)  # [env, contact] approach speed at entry [m/s]; < 0: not in contact

    return ShapeContactStructs(ShapeContacts=ShapeContacts)


#: Arrays that are allocated only if a law or a friction model reads them.
CURVATURE_ARRAYS = ("curvature_1", "curvature_2", "radius")
ORIENTATION_ARRAYS = ("orientation",)
