"""Scenes of contact couplings that are shared by several tests."""

import numpy as np

import warpcontact as wc

AREA, RANGE, CLOSEST, SPEED = 0.02, 0.02, 0.005, 1.5
MASS, OTHER_MASS = 50.0, 20.0


def divided_box(n, size=(0.4, 0.3, 0.2)):
    """An axis-aligned box whose sides are n × n squares of two triangles each."""
    vertices, faces = [], []
    for axis in range(3):
        for side in (-1, 1):
            u, v = (other for other in range(3) if other != axis)
            ticks = np.arange(n + 1) / n - 0.5
            grid = np.zeros((n + 1, n + 1, 3))
            grid[..., axis], grid[..., u], grid[..., v] = 0.5 * side, ticks[:, None], ticks
            number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1) + len(vertices) * (n + 1) ** 2
            a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
            own = np.stack((a, b, c, a, c, d), axis=-1).reshape(-1, 3)
            outward = np.cross(np.eye(3)[u], np.eye(3)[v])[axis] * side > 0
            faces.append(own if outward else own[:, ::-1])
            vertices.append(grid.reshape(-1, 3) * size)
    return wc.Mesh(np.concatenate(vertices), np.concatenate(faces), name="box")


def sole(half_x=0.1, half_y=0.05):
    """A rectangle of two faces, outer side down."""
    corners = [
        [x, y, 0.0] for x, y in ((-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y))
    ]
    return wc.Mesh(corners, [[0, 2, 1], [0, 3, 2]], name="sole")


def expected(other_mass=None, damping_ratio=0.0):
    """Contact range of the impact of SPEC 5."""
    return wc.ContactRange.from_impact(
        mass=MASS,
        other_mass=other_mass,
        area=AREA,
        speed=SPEED,
        effective_range=RANGE,
        closest=CLOSEST,
        damping_ratio=damping_ratio,
    )


def impact_scene(other_mass=None, contact_range=None, friction=None, **options):
    """A rectangle of 0.02 m² at distance d₀ above a plate that is fixed, or free and parallel to it."""
    scene = wc.Scene(gravity=(0, 0, 0))
    carrier = None if other_mass is None else scene.add_body(other_mass, [1.0] * 3, name="anvil")
    plate = scene.add_surface(wc.meshes.grid((1.0, 1.0)), carrier, name="plate")
    block = scene.add_body(MASS, [1.0] * 3, (0, 0, RANGE), linear_velocity=(0, 0, -SPEED), name="block")
    face = scene.add_surface(sole(), block, name="face")
    coupling = scene.add_contact_coupling(
        face, plate, contact_range or expected(other_mass), friction, name="keep", **options
    )
    return scene, coupling
