"""Structs of body contacts: pairs of solids, settings and results."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.types import Struct, structs


@wp.struct
class SolidPairs:
    """Pairs of solids in contact: [pair]."""

    first: wp.array(dtype=wp.int32)  # solid
    second: wp.array(dtype=wp.int32)  # solid, out of which normals point


@wp.struct
class BodyContactSettings:
    """Parameters of a body contact."""

    kappa: wp.float64  # the force of a column acts at kappa × its length from the second solid [-]
    max_depth: wp.float64  # largest depth of the overlap that counts as contact [m]
    force_scale: wp.float64  # factor on forces and torques [-]
    margin: wp.float64  # smallest gap up to which nonsmooth contact finds points [m]
    reference: wp.float64  # weight of the columns on the second solid; < 0: it follows from the flatness of both
    enabled: wp.int32  # 0 or 1


@wp.struct
class Patches:
    """History of the patches of all pairs: [env, PATCH_COUNT × pair + patch]."""

    normal: wp.array2d(dtype=wp.vec3d)  # in the axes of the second solid; zero: no patch
    # Of laws with history variables; others have the entry speed of the pair
    entry_speed: wp.array2d(dtype=wp.float64)  # approach speed at entry [m/s]; < 0: no patch


class BodyContactStructs(NamedTuple):
    """Structs of body contacts, in one precision."""

    BodyContacts: Struct


@functools.cache
def body_contact_structs(real: type) -> BodyContactStructs:
    """Returns the structs of body contacts in one precision."""
    vec3 = structs(real).vec3

    @wp.struct
    class BodyContacts:
        status: wp.array2d(dtype=wp.int32)  # [env, pair] OPEN, CONTACT, WRONG_SIDE or DISABLED
        depth: wp.array2d(dtype=real)  # [env, pair] of the overlap, 0 without [m]
        # The following are 0 unless status is CONTACT
        share: wp.array2d(dtype=real)  # [env, pair] of the columns on the second solid [-]
        area: wp.array2d(dtype=real)  # [env, pair] of the columns [m²]
        volume: wp.array2d(dtype=real)  # [env, pair] of the columns [m³]
        normal: wp.array2d(dtype=vec3)  # [env, pair] mean, weighted by pressure, out of the second solid, W
        center: wp.array2d(dtype=vec3)  # [env, pair] of pressure, W [m]
        max_pressure: wp.array2d(dtype=real)  # [env, pair] [Pa]
        approach_speed: wp.array2d(dtype=real)  # [env, pair] mean of the columns [m/s]
        normal_force: wp.array2d(dtype=real)  # [env, pair] sum over the columns [N]
        friction_force: wp.array2d(dtype=vec3)  # [env, pair] on the first body, W [N]
        force: wp.array2d(dtype=vec3)  # [env, pair] on the first body, W [N]
        torque: wp.array2d(dtype=vec3)  # [env, pair] on the first body about its center of mass, W [N·m]
        # History
        entry_speed: wp.array2d(dtype=real)  # [env, pair] approach speed at entry [m/s]; < 0: not in contact

    return BodyContactStructs(BodyContacts=BodyContacts)
