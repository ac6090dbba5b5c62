"""Bodies at rest on faces: a stack of ten boxes for a minute, a nut over a hole, and hammers that slide to the edge of a table.

Body contact carries load over the common area of two solids, so the results are those of statics:

* Contact i of N boxes, counted from below, carries N − i weights and is (N − i) m g/(k A) deep. The stack does not drift.
* A nut over a hole rests on the ring outside of the hole: A = 2 √3 r² − (n/2) R² sin(2π/n), for a hexagon with the inner
  radius r and a hole with n sides and the circumscribed radius R.
* A hammer with the initial speed v stops after v²/(2 μ g), also on a smaller and smaller area. It falls if its center of mass
  passes the edge of the table on that distance.

Run it with ``python examples/resting_bodies.py``; ``--usd hammers.usdc`` writes an animation of the hammers.
"""

import argparse
import math
import time

import numpy as np

import warpcontact as wc

GRAVITY = 9.81  # m/s²
# Stack
BOXES, SIDE, BOX_MASS = 10, 0.1, 1.0  # -, m, kg
# A hexagonal nut on a plate with a hole
NUT_RADIUS, THREAD_RADIUS, NUT_HEIGHT = 0.015, 0.006, 0.01  # m, inner radius of the hexagon; m
HOLE_RADIUS, PLATE_RADIUS = 0.01, 0.04  # m
SIDES = 12  # of the circles
STEEL = 7850.0  # kg/m³
# A hammer on a table with its edge at x = 0
HANDLE, HANDLE_MASS = np.array([0.24, 0.06, 0.01]), 0.2  # m, along x, y, z; kg
HEAD, HEAD_MASS = np.array([0.04, 0.12, 0.01]), 0.6  # m, kg
TO_EDGE = 0.06  # m, from the center of mass to the edge at the start
SLIDING_FRICTION = 0.1
#: Lengths v²/(2 μ g) of the slides, relative to the distance of the center of mass from the edge.
SLIDES = np.array([0.3, 0.6, 0.9, 0.96, 1.01, 1.1, 1.3])


def material(stiffness: float, mass: float, friction: float, area: float) -> wc.ContactMaterial:
    """Returns a material for bodies of a mass [kg] on an area [m²]: friction is as stiff as the foundation [Pa/m]."""
    stick = wc.friction.CundallStrack.from_overshoot(
        mu_static=friction, mu_dynamic=friction, stiffness=stiffness * area, mass=0.4 * mass, overshoot=0.1
    )
    return wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=stiffness, damping=20.0), friction=stick)


def simulation_of(scene: wc.Scene, dt: float, device: str, envs: int = 1) -> tuple[wc.Model, wc.Simulation]:
    """Returns a model in float32, and its simulation; there is no warning about its time step [s]."""
    model = scene.build(envs=envs, device=device, precision="float32")
    simulation = wc.Simulation(model, dt)
    if warnings := simulation.check():
        raise RuntimeError("; ".join(warnings))
    return model, simulation


def stack(seconds: float, device: str) -> dict[str, float]:
    """Lets ten boxes settle for a second and stand; returns drift, and errors of reactions and heights."""
    scene = wc.Scene()
    stiffness = 1e8  # Pa/m
    touch = material(stiffness, BOX_MASS, 0.5, SIDE**2)
    below = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    for i in range(BOXES):
        box = scene.add_body(
            BOX_MASS, [BOX_MASS * SIDE**2 / 6.0] * 3, position=(0, 0, (i + 0.5) * SIDE), name=f"box_{i}"
        )
        shape = scene.add_shape(box, wc.shapes.RoundedBox((0.5 * SIDE,) * 3))
        scene.add_body_contact(shape, below, touch, name=f"touch_{i}")
        below = shape
    dt = 1e-4  # s, a thirtieth of the duration π √(m/(k A)) of an impact
    model, simulation = simulation_of(scene, dt, device)

    def values(sensor: str) -> np.ndarray:
        return np.stack([model.sensor(f"box_{i}.{sensor}")[0] for i in range(BOXES)])

    simulation.step(round(1.0 / dt))
    settled = values("position")
    began = time.perf_counter()
    simulation.step(round(seconds / dt))
    took = time.perf_counter() - began
    carried = (BOXES - np.arange(BOXES)) * BOX_MASS * GRAVITY
    heights = (np.arange(BOXES) + 0.5) * SIDE - np.cumsum(carried / (stiffness * SIDE**2))
    reactions = np.stack([model.sensor(f"touch_{i}.force")[0, 2] for i in range(BOXES)])
    result = {
        "drift": float(np.abs(values("position") - settled).max()),
        "height": float(np.abs(values("position")[:, 2] - heights).max()),
        "reaction": float(np.abs(reactions / carried - 1.0).max()),
        "speed": float(np.abs(values("linear_velocity")).max()),
        "spin": float(np.abs(values("angular_velocity")).max()),
    }
    print(f"stack of {BOXES} boxes for {seconds:g} s, {1e6 * took * dt / seconds:.0f} µs per step")
    print(f"  drift {result['drift']:.1e} m, speed {result['speed']:.1e} m/s, {result['spin']:.1e} rad/s")
    print(f"  largest error of heights {result['height']:.1e} m, of reactions {result['reaction']:.1e}")
    return result


def circle(radius: float, sides: int) -> np.ndarray:
    """Returns the corners of a regular polygon, (sides, 2) [m]."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def divided(polygon: np.ndarray, parts: int) -> np.ndarray:
    """Returns a polygon with each side divided into equal parts, (parts · n, 2) [m]."""
    step = (np.roll(polygon, -1, axis=0) - polygon) / parts
    return (polygon[:, None] + np.arange(parts)[:, None] * step[:, None]).reshape(-1, 2)


def ring(outer: np.ndarray, inner: np.ndarray, height: float) -> wc.Mesh:
    """Returns a prism with a hole, about the origin; both outlines have the same number of corners, (n, 2) [m]."""
    n = len(outer)
    layers = [
        np.insert(outline, 2, z, axis=1) for z in (-0.5 * height, 0.5 * height) for outline in (outer, inner)
    ]
    here = np.arange(n)
    there = np.roll(here, -1)
    # Numbers of the vertices of the outlines: below and outside, below and inside, above and outside, above and inside.
    low, low_hole, high, high_hole = 0, n, 2 * n, 3 * n
    faces = []
    for first, second in ((low, high), (high, high_hole), (high_hole, low_hole), (low_hole, low)):
        faces += [
            np.stack([first + here, first + there, second + there], axis=1),
            np.stack([first + here, second + there, second + here], axis=1),
        ]
    return wc.Mesh(np.concatenate(layers), np.concatenate(faces))


def nut(device: str) -> dict[str, float]:
    """Lays a nut on a plate, turned by 0.3 rad; returns the relative errors of area, depth and pressure."""
    hexagon = divided(circle(2.0 / math.sqrt(3.0) * NUT_RADIUS, 6), SIDES // 6)
    mesh = ring(hexagon, circle(THREAD_RADIUS, SIDES), NUT_HEIGHT)
    hole = circle(HOLE_RADIUS, SIDES)
    plate = ring(circle(PLATE_RADIUS, SIDES), hole, NUT_HEIGHT)
    mass = STEEL * mesh.report.volume
    area = 2.0 * math.sqrt(3.0) * NUT_RADIUS**2 - 0.5 * SIDES * HOLE_RADIUS**2 * math.sin(2.0 * math.pi / SIDES)
    stiffness = 1e8  # Pa/m
    scene = wc.Scene()
    table = scene.add_surface(plate, position=(0, 0, -0.5 * NUT_HEIGHT), name="plate")
    body = scene.add_body(
        mass,
        # About that of a cylinder with the same hole
        mass * np.array([0.25, 0.25, 0.5]) * (NUT_RADIUS**2 + THREAD_RADIUS**2),
        position=(0, 0, 0.5 * NUT_HEIGHT),
        orientation=(0, 0, math.sin(0.15), math.cos(0.15)),
        name="nut",
    )
    scene.add_body_contact(
        scene.add_surface(mesh, body), table, material(stiffness, mass, 0.2, area), name="touch"
    )
    dt = 1e-4
    model, simulation = simulation_of(scene, dt, device)
    simulation.step(round(0.2 / dt))
    depth = mass * GRAVITY / (stiffness * area)
    result = {
        "area": float(model.sensor("touch.area")[0]) / area - 1.0,
        "depth": float(model.sensor("touch.depth")[0]) / depth - 1.0,
        "force": float(model.sensor("touch.normal_force")[0]) / (mass * GRAVITY) - 1.0,
    }
    print(f"nut of {1e3 * mass:.1f} g on a ring of {1e6 * area:.1f} mm², {1e6 * depth:.2f} µm deep")
    print("  relative errors: " + ", ".join(f"{name} {error:.1e}" for name, error in result.items()))
    return result


def hammers(device: str) -> tuple[dict[str, float], wc.Recording]:
    """Lets hammers slide towards the edge of a table; returns results and the recording."""
    mass = HANDLE_MASS + HEAD_MASS
    apart = 0.5 * (HANDLE[0] + HEAD[0])
    # x of the centers of handle and head, from the center of mass.
    x = np.array([-HEAD_MASS, HANDLE_MASS]) / mass * apart
    inertia = np.zeros(3)
    for part_mass, size, distance in ((HANDLE_MASS, HANDLE, x[0]), (HEAD_MASS, HEAD, x[1])):
        inertia += part_mass * ((np.square(size).sum() - np.square(size)) / 12.0 + [0.0, distance**2, distance**2])
    thickness = HANDLE[2]
    scene = wc.Scene()
    top = scene.add_shape(None, wc.shapes.RoundedBox((0.3, 0.2, 0.02)), position=(-0.3, 0, -0.02), name="table")
    hammer = scene.add_body(mass, inertia, position=(-TO_EDGE, 0, 0.5 * thickness), name="hammer")
    parts = [
        scene.add_shape(hammer, wc.shapes.RoundedBox(tuple(0.5 * size)), position=(distance, 0, 0), name=name)
        for name, size, distance in (("handle", HANDLE, x[0]), ("head", HEAD, x[1]))
    ]
    area = HANDLE[0] * HANDLE[1] + HEAD[0] * HEAD[1]
    scene.add_body_contact(parts, top, material(1e9, mass, SLIDING_FRICTION, area), name="touch")
    model, simulation = simulation_of(scene, 2.5e-5, device, envs=len(SLIDES))
    speed = np.sqrt(2.0 * SLIDING_FRICTION * GRAVITY * SLIDES * TO_EDGE)
    model["hammer.linear_velocity"] = speed[:, None] * [1.0, 0.0, 0.0]
    recording = simulation.run(1.0, ["hammer.position", "hammer.orientation"], every=0.01)
    end = recording["hammer.position"].values[-1]
    fallen = end[:, 2] < 0.0
    print("initial speed, m/s   v²/(2 μ g), mm   slide, mm")
    for v, slide, place, fell in zip(speed, SLIDES * TO_EDGE, end[:, 0] + TO_EDGE, fallen, strict=True):
        print(f"{v:18.3f} {1e3 * slide:16.2f} " + ("      falls" if fell else f"{1e3 * place:11.2f}"))
    error = np.abs(end[:, 0] + TO_EDGE - SLIDES * TO_EDGE)[~fallen]
    return {"slide": float(error.max()), "right": float((fallen == (SLIDES > 1.0)).mean())}, recording


def main(argv: list[str] | None = None) -> dict[str, dict[str, float]]:
    parser = argparse.ArgumentParser(description="Bodies at rest on faces.")
    parser.add_argument("--seconds", type=float, default=60.0, help="time that the stack stands [s] (default: 60)")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    parser.add_argument("--usd", metavar="FILE", help="write an animation of the hammers, such as hammers.usdc")
    options = parser.parse_args(argv)
    results = {"stack": stack(options.seconds, options.device), "nut": nut(options.device)}
    results["hammers"], recording = hammers(options.device)
    if options.usd:
        print("animation:", wc.export_usd(recording, options.usd, spacing=(0.6, 0.6)))
    return results


if __name__ == "__main__":
    main()
