"""A hopper discharges hexagonal parts: parts and hopper are triangle meshes.

While the gate is closed, hopper and gate carry the weight of all parts, and afterwards the floor does. All parts leave through the
mouth, and none passes through a wall.

Run it with ``python examples/hopper_of_parts.py --usd parts.usdc``.
"""

import argparse
import math
import time

import numpy as np
from scipy.spatial.transform import Rotation

import warpcontact as wc

GRAVITY = 9.81  # m/s²
RADIUS, LENGTH, DENSITY = 0.015, 0.03, 2700.0  # m, of the hexagon; m; kg/m³
TOP, MOUTH, RISE, WALL = 0.12, 0.06, 0.09, 0.01  # m, half widths, height and thickness of the hopper
FLOOR = -0.2  # m, below the mouth
STIFFNESS, FRICTION = 5e7, 0.3  # Pa/m
OPENING, END = 1.0, 2.5  # s, times at which the gate opens and the run ends
DT, FRAME = 1e-4, 0.01  # s
WINDOW = 20  # frames of a mean over time


def loft(outlines: np.ndarray) -> wc.Mesh:
    """Returns the closed surface through polygons, (m, n, 3) [m], and back from the last to the first one."""
    rows, n, _ = outlines.shape
    number = np.arange(rows * n).reshape(rows, n)
    there, above = np.roll(number, -1, axis=1), np.roll(number, -1, axis=0)
    beyond = np.roll(there, -1, axis=0)
    faces = [np.stack([number, there, beyond], axis=-1), np.stack([number, beyond, above], axis=-1)]
    return wc.Mesh(outlines.reshape(-1, 3), np.concatenate(faces).reshape(-1, 3))


def hopper() -> wc.Mesh:
    """Returns a square funnel with walls, its mouth at z = 0."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    profile = [(TOP, RISE), (MOUTH, 0.0), (MOUTH + WALL, 0.0), (TOP + WALL, RISE)]
    return loft(np.stack([np.insert(half * corners, 2, z, axis=1) for half, z in profile]))


def part() -> wc.Mesh:
    """Returns a hexagonal prism about the origin, along z."""
    angles = np.pi / 3.0 * np.arange(6)
    ring = RADIUS * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    vertices = np.concatenate([np.insert(ring, 2, z, axis=1) for z in (-0.5 * LENGTH, 0.5 * LENGTH)])
    here = np.arange(6)
    there = np.roll(here, -1)
    fan = np.stack([np.zeros(4, int), here[1:5], here[2:]], axis=1)
    sides = [np.stack([here, there, 6 + there], axis=1), np.stack([here, 6 + there, 6 + here], axis=1)]
    return wc.Mesh(vertices, np.concatenate([fan[:, ::-1], fan + 6, *sides]))


def scene_of_hopper(parts: int, seed: int = 0) -> wc.Scene:
    """Returns the scene of parts above a hopper with a closed gate, in layers of nine."""
    scene = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
    floor = scene.add_shape(None, wc.shapes.Plane(), position=(0, 0, FLOOR), name="floor")
    funnel = scene.add_surface(hopper(), name="funnel", color=(0.6, 0.65, 0.7))
    gate = scene.add_shape(
        None, wc.shapes.RoundedBox((MOUTH + WALL, MOUTH + WALL, 0.005)), position=(0, 0, -0.005), name="gate"
    )
    area = 1.5 * math.sqrt(3.0) * RADIUS**2
    mass = DENSITY * area * LENGTH
    # Inertia of a hexagonal prism
    across = mass * (5.0 / 24.0 * RADIUS**2 + LENGTH**2 / 12.0)
    inertia = (across, across, 5.0 / 12.0 * mass * RADIUS**2)
    mesh = part()
    rng = np.random.default_rng(seed)
    turns = Rotation.random(parts, random_state=seed).as_quat()
    bodies = []
    for number in range(parts):
        layer, place = divmod(number, 9)
        x, y = np.array(divmod(place, 3)) - 1.0
        position = 1.6 * LENGTH * np.array([x, y, layer]) + [0.0, 0.0, 0.8 * RISE] + 1e-3 * rng.uniform(-1, 1, 3)
        body = scene.add_body(mass, inertia, position=position, orientation=turns[number], name=f"part_{number}")
        scene.add_surface(mesh, body, color=(0.85, 0.6 - 0.4 * number / parts, 0.2))
        bodies.append(body)
    friction = wc.friction.CundallStrack.from_overshoot(
        mu_static=FRICTION, mu_dynamic=FRICTION, stiffness=1e4, mass=0.2 * mass, overshoot=0.2
    )
    material = wc.ContactMaterial(
        law=wc.laws.ElasticFoundation(stiffness=STIFFNESS, damping=20.0), friction=friction
    )
    scene.add_body_contact(bodies, material, name="among")
    for name, other in (("on_funnel", funnel), ("on_gate", gate), ("on_floor", floor)):
        scene.add_body_contact(bodies, other, material, name=name)
    return scene


def main(argv: list[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description="A hopper discharges parts.")
    parser.add_argument("--parts", type=int, default=27, help="number of parts (default: 27)")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    parser.add_argument("--usd", metavar="FILE", help="write an animation, such as parts.usdc")
    options = parser.parse_args(argv)
    scene = scene_of_hopper(options.parts)
    model = scene.build(device=options.device, precision="float32")
    simulation = wc.Simulation(model, DT)
    if warnings := simulation.check():
        raise RuntimeError("; ".join(warnings))
    weight = options.parts * float(scene.bodies[0].mass) * GRAVITY

    names = [body.name for body in scene.bodies]
    record = [f"{name}.{key}" for name in names for key in ("position", "orientation", "linear_velocity")]
    record += [f"{name}.{key}" for name in ("on_funnel", "on_gate", "on_floor") for key in ("force", "depth")]
    record.append("among.depth")
    began = time.perf_counter()
    before = simulation.run(OPENING, record, every=FRAME)
    model["on_gate.enabled"] = 0.0
    after = simulation.run(END - OPENING, record, every=FRAME)
    took = time.perf_counter() - began

    def carried(recording: wc.Recording, name: str) -> float:
        """Returns the mean vertical force of a contact over the last ``WINDOW``, relative to the weight of all parts."""
        return float(recording[f"{name}.force"].values[-WINDOW:, 0, :, 2].sum(axis=1).mean()) / weight

    def fastest(recording: wc.Recording) -> float:
        """Returns the largest vertical speed of a part in the last ``WINDOW`` [m/s]."""
        return max(float(abs(recording[f"{name}.linear_velocity"][-WINDOW:, 0, 2]).max()) for name in names)

    places = np.stack([after[f"{name}.position"].values[:, 0] for name in names], axis=1)
    below = places[..., 2] < -0.5 * LENGTH
    # Where each part is when it leaves, or at the end.
    leaving = places[np.where(below.any(axis=0), below.argmax(axis=0), -1), np.arange(options.parts), :2]
    result = {
        "closed": carried(before, "on_funnel") + carried(before, "on_gate"),
        "open": carried(after, "on_floor"),
        # Parts that rock: the mean force differs from the weight by their change of momentum.
        "speed": max(fastest(before), fastest(after)),
        "left": float(below[-1].mean()),
        "through_mouth": float((np.abs(leaving) < MOUTH).all(axis=1).mean()),
        "depth": max(
            float(r[f"{n}.depth"].max()) for r in (before, after) for n in ("among", "on_funnel", "on_floor")
        ),
    }
    print(f"{options.parts} parts, {len(scene.body_contacts[0].pairs) + 3 * options.parts} pairs, ", end="")
    print(f"{1e6 * took / simulation.steps:.0f} µs per step")
    print(
        f"weight carried by hopper and gate {result['closed']:.4f}, at the end by the floor {result['open']:.4f}"
    )
    print(f"{result['left']:.0%} of the parts left, {result['through_mouth']:.0%} of all through the mouth")
    print(f"deepest overlap {1e3 * result['depth']:.1f} mm")
    if options.usd:
        print("animation:", wc.export_usd(after, options.usd))
    return result


if __name__ == "__main__":
    main()
