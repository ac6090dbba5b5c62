"""Scenes of bodies at rest, with their statics, for tests of compliant and nonsmooth body contact.

Each function takes a function ``material(name)`` of the body that is in contact.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from part_meshes import bracket, centered, l_section, prism, random_hull
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

import warpcontact as wc

GRAVITY = 9.81  # m/s²
SIDE = 0.1  # m, of cubes
RADIUS, HALF = 0.05, 0.08  # m, of cylinders and capsules: radius, and half of the length of the cylinder
CONE_HEIGHT = 0.12  # m
#: Axis along x.
LYING = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Part:
    """A body of 1 kg that stands on a floor.

    Attributes:
        solid: A mesh about its center of mass, or a shape.
        inertia: About the center of mass [kg·m²].
        height: Height of the center of mass above its lowest point [m].
        orientation: Body → world.
        offset: Position of the shape relative to the center of mass [m].
    """

    solid: object
    inertia: object
    height: float
    orientation: tuple[float, ...] = UPRIGHT
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)


def parts():
    """Returns all parts by name."""
    cylinder, capsule = wc.shapes.Cylinder(RADIUS, HALF), wc.shapes.Capsule(RADIUS, HALF)
    across = RADIUS**2 / 4 + HALF**2 / 3
    of_cylinder = (across, across, RADIUS**2 / 2)
    of_cone = (0.15 * RADIUS**2 + 0.0375 * CONE_HEIGHT**2,) * 2 + (0.3 * RADIUS**2,)
    hull, hull_inertia, _ = random_hull(SIDE / 2, seed=5)
    meshes = {
        "ell": l_section(SIDE, SIDE / 3, SIDE / 2),
        "bracket": bracket(0.15, 0.08, 0.03, 0.06),
        "hull": (hull, hull_inertia),
    }
    found = {
        "cube": Part(wc.shapes.RoundedBox((SIDE / 2,) * 3), [SIDE**2 / 6] * 3, SIDE / 2),
        "standing": Part(cylinder, of_cylinder, HALF),
        "lying": Part(cylinder, of_cylinder, RADIUS, LYING),
        # The inertia of a capsule is between those of the cylinders inside and outside of it.
        "capsule": Part(capsule, of_cylinder, RADIUS, LYING),
        # The base of a cone is at the origin of its shape.
        "cone": Part(
            wc.shapes.Cone(RADIUS, CONE_HEIGHT), of_cone, CONE_HEIGHT / 4, offset=(0, 0, -CONE_HEIGHT / 4)
        ),
    }
    for name, (mesh, inertia) in meshes.items():
        found[name] = Part(mesh, inertia, -mesh.vertices[:, 2].min())
    return found


def add_floor(scene, kind):
    """Adds a floor at z = 0, a ``"half-space"`` or a ``"mesh"``, and returns its solid."""
    if kind == "half-space":
        return scene.add_shape(None, wc.shapes.Plane(), name="floor")
    return scene.add_surface(wc.meshes.box((10.0, 10.0, 0.2)), position=(0, 0, -0.1), name="floor")


def parts_on_floor(floor, material, names, *, gap=0.0):
    """Returns the scene of parts in a row along y, each in the contact ``<name>_touch`` with the floor, ``gap`` above it."""
    scene = wc.Scene(gravity=(0, 0, -GRAVITY))
    ground = add_floor(scene, floor)
    known = parts()
    for number, name in enumerate(names):
        part = known[name]
        body = scene.add_body(
            mass=1.0,
            inertia=part.inertia,
            position=(0, 0.5 * number - 2.0, part.height + gap),
            orientation=part.orientation,
            name=name,
        )
        if isinstance(part.solid, wc.Mesh):
            solid = scene.add_surface(part.solid, body)
        else:
            solid = scene.add_shape(body, part.solid, position=part.offset)
        scene.add_body_contact(solid, ground, material(name), name=f"{name}_touch")
    return scene


def add_box(scene, height, name, *, below, place=(0.0, 0.0), mesh=False, material, side=SIDE):
    """Adds a cube of 1 kg in the contact ``<name>_on`` with solids below it; returns its solid."""
    body = scene.add_body(mass=1.0, inertia=[side**2 / 6] * 3, position=(*place, height + side / 2), name=name)
    if mesh:
        solid = scene.add_surface(wc.meshes.box((side,) * 3), body, name=f"{name}_solid")
    else:
        solid = scene.add_shape(body, wc.shapes.RoundedBox((side / 2,) * 3), name=f"{name}_solid")
    scene.add_body_contact(solid, below, material(name), name=f"{name}_on")
    return solid


def tower(count, floor, material, *, gap=0.0, side=SIDE):
    """Returns the scene of cubes ``box_i`` above each other, with gaps."""
    scene = wc.Scene(gravity=(0, 0, -GRAVITY))
    below = add_floor(scene, floor)
    for i in range(count):
        below = add_box(scene, i * side + (i + 1) * gap, f"box_{i}", below=below, material=material, side=side)
    return scene


#: Environments of ``vary_stacks``.
STACKS = ("aligned", "offset", "turned", "unequal")


def vary_stacks(model, count, *, gap=0.0, side=SIDE, offset=0.05):
    """Sets the environments of a tower to ``STACKS``, at rest without depth; offsets are multiples of ``offset`` × ``side``.

    Returns:
        Sides [m], masses [kg] and turns about the vertical [rad], each (count, stacks).
    """
    number = np.arange(count)
    sides = np.full((count, len(STACKS)), side)
    sides[:, 3] = side * np.array([1.2, 0.9, 1.1, 0.8, 1.0, 0.85, 0.7, 0.8, 0.6, 0.7])[:count]
    masses = (sides / side) ** 3
    turns = np.zeros_like(sides)
    turns[:, 2] = 0.3 * number
    turns[:, 3] = 0.1 * number
    bottoms = np.cumsum(sides + gap, axis=0) - sides
    for i in range(count):
        name = f"box_{i}"
        places = np.zeros((len(STACKS), 3))
        places[1, :2] = offset * side * np.array([i % 3, i % 2])
        places[:, 2] = bottoms[i] + sides[i] / 2
        model[f"{name}.position"] = places
        model[f"{name}.orientation"] = Rotation.from_rotvec(turns[i][:, None] * [0.0, 0.0, 1.0]).as_quat()
        model[f"{name}.mass"] = masses[i]
        model[f"{name}.inertia"] = (masses[i] * sides[i] ** 2 / 6)[:, None, None] * np.eye(3)
        model[f"{name}_solid.half_extents"] = sides[i][:, None] / 2 * np.ones(3)
    return sides, masses, turns


def pyramid(floor, material, *, gap=0.0):
    """Returns the scene of a cube ``top`` on the inner quarters of four cubes ``box_i``."""
    scene = wc.Scene(gravity=(0, 0, -GRAVITY))
    ground = add_floor(scene, floor)
    places = [(x, y) for x in (-0.07, 0.07) for y in (-0.07, 0.07)]
    lower = [add_box(scene, gap, f"box_{i}", below=ground, place=places[i], material=material) for i in range(4)]
    add_box(scene, SIDE + 2 * gap, "top", below=lower, mesh=True, material=material)
    return scene


#: Number of wedges of the arch, inner and outer radius, and width [m].
WEDGES, INNER, OUTER, WIDTH = 7, 0.2, 0.3, 0.1


def arch_radius():
    """Returns the distance of the center of mass of a wedge, a part of a flat-sided ring, from the center of the arch [m]."""
    # Trapezoid between the chords, at the distances r cos(half), of the lengths 2 r sin(half).
    half = np.pi / WEDGES / 2
    return np.cos(half) * 2 / 3 * (OUTER**3 - INNER**3) / (OUTER**2 - INNER**2)


def arch(floor, material):
    """Returns the scene of a half circle of mesh wedges, in the contacts ``joints`` with each other and ``feet`` with the floor."""
    half = np.pi / WEDGES / 2
    outline = np.array(
        [[r * np.sin(a), r * np.cos(a)] for r, a in ((INNER, -half), (INNER, half), (OUTER, half), (OUTER, -half))]
    )
    wedge = prism(outline, [[0, 1, 2], [0, 2, 3]], WIDTH)
    if wedge.report.volume < 0:
        wedge = wc.Mesh(wedge.vertices, wedge.faces[:, ::-1])
    # x, y, z → x, −z, y: the section is in the plane of x and z.
    upright = wc.Mesh(wedge.vertices[:, [0, 2, 1]] * [1, -1, 1], wedge.faces)
    mesh, inertia = centered(upright)
    radius = arch_radius()
    np.testing.assert_allclose(upright.vertices - mesh.vertices, [[0, 0, radius]] * len(mesh.vertices), atol=1e-12)
    scene = wc.Scene(gravity=(0, 0, -GRAVITY))
    ground = add_floor(scene, floor)
    solids = []
    for i in range(WEDGES):
        angle = (2 * i + 1) * half - np.pi / 2  # from the vertical
        body = scene.add_body(
            mass=1.0,
            inertia=inertia,
            position=(radius * np.sin(angle), 0, radius * np.cos(angle)),
            orientation=Rotation.from_rotvec([0, angle, 0]).as_quat(),
            name=f"wedge_{i}",
        )
        solids.append(scene.add_surface(mesh, body))
    apart = [(a, b) for i, a in enumerate(solids) for b in solids[i + 2 :]]
    scene.add_body_contact(solids, material("wedge"), name="joints", exclude=apart)
    scene.add_body_contact([solids[0], solids[-1]], ground, material("wedge"), name="feet")
    return scene


def thrust_range():
    """Returns the smallest and largest horizontal force on a support of the arch that statics allow [N].

    The force on each joint acts within the joint: its moment has opposite signs about the two ends.
    """
    angles = -np.pi / 2 + np.pi / WEDGES * np.arange(WEDGES + 1)
    middles = arch_radius() * np.sin((angles[:-1] + angles[1:]) / 2)
    # Unknowns are the thrust H, the left reaction V, and its moment p V for its place p at z = 0. The moments about (x, z) of the
    # forces on the wedges from the left support to a joint are −z H + x V − p V − Σ g (x − xᵢ), at least 0 for the inner end and at
    # most 0 for the outer one.
    rows, limits = [], []
    for j, angle in enumerate(angles):
        for sign, end in ((-1, INNER), (1, OUTER)):
            x, z = end * np.sin(angle), end * np.cos(angle)
            rows.append((-sign * z, sign * x, -sign))
            limits.append(sign * GRAVITY * (x - middles[:j]).sum())
    ends = []
    for direction in (1.0, -1.0):
        found = linprog([direction, 0.0, 0.0], A_ub=rows, b_ub=limits, bounds=[(0, None), (0, None), (None, None)])
        assert found.success, found.message
        ends.append(found.x[0])
    return ends


def push(model, name, force, arm):
    """Pushes a body along x, by environment [N], at the height ``arm`` [m] below its center."""
    model[f"{name}.external_force"] = force[:, None] * [1.0, 0.0, 0.0]
    model[f"{name}.external_torque"] = -arm * force[:, None] * [0.0, 1.0, 0.0]


def check_balance(forces, centers, weight, place=(0.0, 0.0), *, rtol):
    """Checks that vertical forces on a body carry its weight, and that their common center is below its center of mass.

    Args:
        forces: Vertical forces [N], (n,).
        centers: Their places along x and y [m], (n, 2).
        weight: Weight [N].
        place: Place of the center of mass along x and y [m].
        rtol: Tolerance relative to the weight, and to its moment at the distance of the farthest force.
    """
    assert (forces > 0).all()
    assert forces.sum() == pytest.approx(weight, rel=rtol)
    arms = centers - np.asarray(place)
    np.testing.assert_allclose(forces @ arms, 0, atol=rtol * weight * np.abs(arms).max())


class Rest:
    """Compares bodies with their state at the start of a period of rest.

    Args:
        model: The model.
        bodies: Bodies that are at rest.
    """

    def __init__(self, model, bodies):
        self.model, self.names = model, [body.name for body in bodies]
        self.start = {name: self._pose(name) for name in self.names}

    def _pose(self, name):
        return [self.model.sensor(f"{name}.{key}").astype(float) for key in ("position", "orientation")]

    def check(self, *, drift=1e-6, speed=1e-6, spin=1e-6, envs=slice(None)):
        """Checks speeds [m/s, rad/s] and changes of position and orientation [m, rad] since the start."""
        for name in self.names:
            for key, limit in (("linear_velocity", speed), ("angular_velocity", spin)):
                found = self.model.sensor(f"{name}.{key}")[envs]
                assert np.abs(found).max() < limit, (name, key, found)
            position, orientation = self._pose(name)
            assert np.abs(position - self.start[name][0])[envs].max() < drift, name
            # A rotation by a small angle changes its quaternion by half of it.
            assert 2 * np.abs(orientation - self.start[name][1])[envs].max() < drift / SIDE, name


def overlap_of_turned_squares(side, angle):
    """Returns the area of the overlap of two concentric squares [m²], one turned by ``angle``.

    It is an octagon around a circle of radius r = side/2, with the area r² Σ tan(θ/2) over the angles θ between its
    normals, which are alternately ``angle`` and the rest of 90°.
    """
    angle = np.mod(angle, np.pi / 2)
    return side**2 * (np.tan(angle / 2) + np.tan((np.pi / 2 - angle) / 2))
