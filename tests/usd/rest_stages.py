"""USD stages of bodies that come to rest, as other programs write them, with their poses at rest.

Lengths are in meters, masses in kilograms and poses with z up; ``text`` of ``physics_stages`` has the units of a stage.
"""

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from physics_stages import BODY, COLLIDER, body, mesh, moved, prim
from scipy.optimize import brentq

#: Duration of an impact [s], the default of ``Scene.from_usd``, and gravity [m/s²].
CONTACT_TIME, GRAVITY = 0.01, 9.81
FLOOR = prim("Plane", "floor", COLLIDER, 'uniform token axis = "Z"')
BOX_FLOOR = prim("Cube", "floor", COLLIDER, "double size = 1\n" + moved(0, 0, -0.25, scale=(3, 3, 0.5)))
OPEN_FLOOR = prim(
    "Mesh",
    "floor",
    COLLIDER,
    mesh("(-2,-2,0), (0,-2,0), (2,-2,0), (-2,2,0), (0,2,0), (2,2,0)", "0,1,4,3, 1,2,5,4", "4,4"),
)
# A collider whose convex hull is used.
HULL = 'prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"]'
FILTERED = BODY.replace('"PhysicsMassAPI"', '"PhysicsMassAPI", "PhysicsFilteredPairsAPI"')


@dataclass
class RestStage:
    """A stage, and the poses of its bodies at rest.

    Attributes:
        content: Prims of the stage.
        heights: Height of the center of mass of each body, by name, with rigid contact, and how much lower it is with
            the contact of ``Scene.from_usd`` [m].
        metadata: Units and axes, as for ``physics_stages.text``.
        filtered: Names of the two elements of pairs without contact.
        tolerance: Tolerance of the heights [m]. The default is the rounding of mesh points to single precision. Heights of
            bodies that tilt under an eccentric load are to first order in the tilt.
    """

    content: str
    heights: dict[str, tuple[float, float]]
    metadata: dict[str, object] = field(default_factory=dict)
    filtered: tuple[tuple[str, str], ...] = ()
    tolerance: float = 2e-8


def sunk(load: float, *masses: float) -> float:
    """Depth of a contact of bodies of ``masses`` [kg] under the weight of ``load`` [kg]: N/k, k = m (π/T)² [m]."""
    reduced = 1.0 / sum(1.0 / mass for mass in masses)
    return load * GRAVITY / reduced * (CONTACT_TIME / np.pi) ** 2


#: Depth of a contact of 1 kg with a fixed body under its weight [m].
ONE = sunk(1.0, 1.0)


def tilted(arm: float, width: float, other_arm: float | None = None) -> float:
    """Depth at ``other_arm`` from the center of a face of ``width``, loaded at ``arm``, over the mean depth.

    The pressure is linear across the face. ``other_arm``: by default ``arm`` [m].
    """
    return 1.0 + 12.0 * arm * (arm if other_arm is None else other_arm) / width**2


def lying(radius: float, length: float, caps: bool) -> float:
    """Depth of a lying cylinder, or capsule, of 1 kg whose mean depth over the area of contact is N/k [m]."""

    def excess(depth: float) -> float:
        half = np.sqrt(depth * (2.0 * radius - depth))
        segment = radius**2 * np.arccos(1.0 - depth / radius) - (radius - depth) * half
        volume = length * segment + caps * np.pi * depth**2 * (radius - depth / 3.0)
        return volume / (2.0 * half * length + caps * np.pi * half**2) - ONE

    return brentq(excess, ONE, 3.0 * ONE, xtol=1e-12)


def cells(x, y, z, missing=()):
    """Quadrilateral faces around the cells of a grid without those of ``missing``: points, indices and counts as text."""
    axes, sizes = (x, y, z), tuple(len(axis) - 1 for axis in (x, y, z))
    filled = {cell for cell in product(*map(range, sizes)) if cell not in missing}
    points, faces = {}, []
    for cell in sorted(filled):
        for axis, side in product(range(3), (0, 1)):
            if tuple(c + (2 * side - 1) * (k == axis) for k, c in enumerate(cell)) in filled:
                continue
            u, v = (axis + 1) % 3, (axis + 2) % 3
            loop = [(0, 0), (1, 0), (1, 1), (0, 1)]
            corners = []
            for du, dv in loop if side else loop[::-1]:
                corner = list(cell)
                corner[axis], corner[u], corner[v] = cell[axis] + side, cell[u] + du, cell[v] + dv
                corners.append(points.setdefault(tuple(corner), len(points)))
            faces.append(corners)
    places = ", ".join(str(tuple(axes[k][i] for k, i in enumerate(corner))) for corner in points)
    return places, ", ".join(str(i) for face in faces for i in face), ", ".join("4" for _ in faces)


def box(name, half, place, turn=None, mass=None, more=""):
    """A body with one Cube of half extents ``half``."""
    collider = prim("Cube", f"{name}_box", COLLIDER, "double size = 2\n" + moved(0, 0, 0, scale=half))
    weight = "" if mass is None else f"float physics:mass = {mass}\n"
    return body(name, weight + more + collider, moved(*place, turn=turn))


def round_body(name, kind, axis, place, turn=None):
    """A body of 1 kg with one Cylinder, Capsule or Cone of radius 0.1 m and height 0.2 m."""
    sizes = f'double radius = 0.1\ndouble height = 0.2\nuniform token axis = "{axis}"'
    collider = prim(kind, f"{name}_{kind}", COLLIDER, sizes)
    return body(name, "float physics:mass = 1\n" + collider, moved(*place, turn=turn))


def part(name, faces, place, turn=None, approximation=None, mass=1.0):
    """A body of given mass with one mesh."""
    more = "" if approximation is None else f'uniform token physics:approximation = "{approximation}"'
    collider = prim("Mesh", f"{name}_mesh", HULL if approximation else COLLIDER, mesh(*faces, more))
    return body(name, f"float physics:mass = {mass}\n" + collider, moved(*place, turn=turn))


def bin_of_five(half, wall):
    """A floor and four walls around a square of half side ``half``, of thickness ``wall`` [m]."""
    walls = [((0, 0, -wall), (half, half, wall))]
    for axis, sign in product((0, 1), (-1, 1)):
        place = [sign * (half + wall) * (k == axis) for k in range(2)]
        extent = [wall if k == axis else half + 2 * wall for k in range(2)]
        walls.append(((*place, half), (*extent, half + 2 * wall)))
    return "".join(
        prim("Cube", f"wall_{i}", COLLIDER, "double size = 2\n" + moved(*place, scale=extent))
        for i, (place, extent) in enumerate(walls)
    )


CUBE_CELLS = cells((-0.1, 0.1), (-0.1, 0.1), (-0.1, 0.1))
L_CELLS = cells((0.0, 0.1, 0.3), (-0.1, 0.1), (0.0, 0.1, 0.3), missing={(1, 0, 1)})
# No contact among them: nonsmooth contact does not support two cylinders.
ROUND_GROUP = prim(
    "PhysicsCollisionGroup",
    "rounds",
    "",
    "rel collection:colliders:includes = [</standing>, </lying>, </capsule>, </cone>]\n"
    "rel physics:filteredGroups = </rounds>",
)
# A bracket: a plate of 0.4 × 0.2 × 0.05 m on two legs of 0.05 × 0.2 × 0.1 m.
BRACKET = cells((-0.2, -0.15, 0.15, 0.2), (-0.1, 0.1), (-0.1, 0.0, 0.05), missing={(1, 0, 0)})
# Centroids above the lowest face: L of areas 0.03 and 0.02 m², bracket of 0.02 and 2 × 0.005 m²; and from the side of L.
L_CENTER, L_ACROSS = (0.03 * 0.05 + 0.02 * 0.2) / 0.05, (0.03 * 0.15 + 0.02 * 0.05) / 0.05
BRACKET_CENTER = (0.02 * 0.125 + 0.01 * 0.05) / 0.03

STAGES = {
    "boxes of two sizes on a Cube": RestStage(
        BOX_FLOOR
        + box("small", (0.05, 0.05, 0.05), (-0.5, 0, 0.06), (3, 2, 0), 1.0)
        + box("large", (0.3, 0.2, 0.1), (0.5, 0, 0.11), (0, 1, 10), 50.0),
        {"small": (0.05, ONE), "large": (0.1, ONE)},
    ),
    "tilted cube on a Plane": RestStage(
        FLOOR + box("cube", (0.1, 0.1, 0.1), (0, 0, 0.15), (10, 0, 0)), {"cube": (0.1, ONE)}
    ),
    "stack of Cubes": RestStage(
        FLOOR
        + "".join(box(f"box_{i}", (0.1, 0.1, 0.1), (0, 0, 0.1 + 0.201 * i), (0, 0, 7 * i), 2.0) for i in range(3)),
        {
            "box_0": (0.1, sunk(6, 2)),
            "box_1": (0.3, sunk(6, 2) + sunk(4, 2, 2)),
            "box_2": (0.5, sunk(6, 2) + sunk(4, 2, 2) + sunk(2, 2, 2)),
        },
    ),
    # The upper box loads the lower one at 0.04 m from its center, and rests on 0.16 m, at 0.02 m from the center of that.
    # Their tilts of 1.2e-3 and 3e-3 move the load by 0.4 mm, 2 % of 0.02 m, and change squares of arms, which give 85 µm of
    # the depth, by 4 %.
    "box on a box, offset": RestStage(
        FLOOR + box("lower", (0.1, 0.1, 0.1), (0, 0, 0.1), mass=1.0) + box("upper", (0.1, 0.1, 0.1), (0.04, 0, 0.3), mass=1.0),
        {
            "lower": (0.1, sunk(2, 1)),
            "upper": (0.3, sunk(2, 1) * tilted(0.02, 0.2, 0.04) + sunk(1, 1, 1) * tilted(0.02, 0.16)),
        },
        tolerance=4e-6,
    ),
    "stack of mesh cubes": RestStage(
        FLOOR + part("lower", CUBE_CELLS, (0, 0, 0.1)) + part("upper", CUBE_CELLS, (0, 0, 0.3)),
        {"lower": (0.1, sunk(2, 1)), "upper": (0.3, sunk(2, 1) + sunk(1, 1, 1))},
    ),
    "mesh bracket on a Cube, with a Cube on it": RestStage(
        BOX_FLOOR
        + part("bracket", BRACKET, (0, 0, 0.104), (0, 1, 0), mass=2.0)
        + box("load", (0.04, 0.04, 0.04), (0, 0, 0.2), mass=1.0),
        {
            "bracket": (BRACKET_CENTER, sunk(3, 2)),
            "load": (0.15 + 0.04, sunk(3, 2) + sunk(1, 1, 2)),
        },
    ),
    "mesh L on an open mesh": RestStage(
        OPEN_FLOOR + part("angle", L_CELLS, (0, 0, 0.005), (0, 0, 30)),
        {"angle": (L_CENTER, ONE * tilted(0.15 - L_ACROSS, 0.3))},
        tolerance=1e-7,
    ),
    "cube and mesh cube in a bin of five Cubes": RestStage(
        bin_of_five(0.3, 0.05)
        + box("cube", (0.1, 0.1, 0.1), (0.15, 0.1, 0.15), (20, 0, 0), 1.0)
        + part("mesh_cube", CUBE_CELLS, (-0.12, -0.1, 0.13), (0, 15, 0)),
        {"cube": (0.1, ONE), "mesh_cube": (0.1, ONE)},
    ),
    "convex hull of a mesh bracket": RestStage(
        FLOOR + part("bracket", BRACKET, (0, 0, 0.11), (0, 2, 0), "convexHull"), {"bracket": (0.075, ONE)}
    ),
    "cylinder, capsule and cone on a Plane": RestStage(
        FLOOR
        + round_body("standing", "Cylinder", "Z", (-0.5, 0, 0.11), (4, 0, 0))
        + round_body("lying", "Cylinder", "X", (0, 0, 0.105), (0, 2, 20))
        + round_body("capsule", "Capsule", "Y", (0.5, 0, 0.105), (2, 0, 0))
        + round_body("cone", "Cone", "Z", (0, 0.5, 0.105), (0, 3, 0))
        + ROUND_GROUP,
        {
            "standing": (0.1, ONE),
"lying": (0.1, lying(0.1, 0.2, False)),
"capsule": (0.1, lying(0.1, 0.2, True)),
            "cone": (0.05, ONE),
        },
        # Integration over round outlines: 1e-3 of the depth.
        tolerance=1e-7,
    ),
    "scaled Xforms": RestStage(
        FLOOR
        + prim("Xform", "group", "", moved(0, 0, 0.4, scale=(2, 1, 0.5), turn=(0, 0, 90))
               + body("cube", prim("Cube", "skin", COLLIDER, "double size = 0.2"), moved(0, 0, -0.7))),
        {"cube": (0.05, ONE)},
    ),
    "centimeters, y up": RestStage(
        prim("Plane", "floor", COLLIDER, 'uniform token axis = "Y"')
        + body("cube", prim("Cube", "skin", COLLIDER, "double size = 20"), moved(0, 12, 0, turn=(5, 0, 0))),
        {"cube": (0.1, ONE)},
        {"metres": 0.01, "up": "Y"},
    ),
    "grams": RestStage(
        FLOOR + box("cube", (0.1, 0.1, 0.1), (0, 0, 0.11), mass=500.0) + box("top", (0.1, 0.1, 0.1), (0, 0, 0.32), mass=500.0),
        {"cube": (0.1, sunk(1.0, 0.5)), "top": (0.3, sunk(1.0, 0.5) + sunk(0.5, 0.5, 0.5))},
        {"header": "kilogramsPerUnit = 0.001\n"},
    ),
    "filtered pair": RestStage(
        FLOOR
        + box("lower", (0.1, 0.1, 0.1), (0, 0, 0.1), mass=1.0)
        + box("upper", (0.1, 0.1, 0.1), (0.05, 0, 0.15), mass=1.0, more="rel physics:filteredPairs = </lower>\n").replace(BODY, FILTERED),
        {"lower": (0.1, ONE), "upper": (0.1, ONE)},
        filtered=(("lower_box", "upper_box"),),
    ),
}  # fmt: skip
