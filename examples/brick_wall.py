"""A wall of bricks without mortar is hit by a ball; bricks and ball are triangle meshes.

One call puts every body in contact with every other one. Before the ball arrives, each course carries the weight of the courses
above, and the ground that of all. From the impact on, the energy decreases.

Run it with ``python examples/brick_wall.py --usd bricks.usdc``.
"""

import argparse
import itertools
import time

import numpy as np

import warpcontact as wc

GRAVITY = 9.81  # m/s²
LENGTH, DEPTH, HEIGHT = 0.4, 0.2, 0.2  # m, of a brick
DENSITY = 700.0  # kg/m³, of bricks
BALL_MASS, BALL_RADIUS, BALL_SPEED = 60.0, 0.17, 7.0  # kg, m, m/s
STIFFNESS = 1e8  # Pa/m
DT = 1e-4  # s
ARRIVAL = 0.5  # s, time at which the ball arrives
FRAME = 0.01  # s


def courses(columns: int, rows: int) -> list[list[tuple[float, float]]]:
    """Returns center and length along x of the bricks of each course [m]; every second one begins and ends with half a brick."""
    wall = []
    for row in range(rows):
        ends = np.arange(columns + 1.0) if row % 2 == 0 else np.array([0.0, *(np.arange(columns) + 0.5), columns])
        ends = (ends - 0.5 * columns) * LENGTH
        wall.append([(0.5 * (a + b), b - a) for a, b in itertools.pairwise(ends)])
    return wall


def scene_of_wall(columns: int, rows: int) -> tuple[wc.Scene, list[list[wc.Body]]]:
    """Returns the scene of a wall in the plane y = 0 and a ball, and the bricks of each course."""
    scene = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
    ground = scene.add_shape(None, wc.shapes.Plane(), name="ground")
    bricks: list[list[wc.Body]] = []
    # Heights of the bottoms of the courses at rest: each is pressed in by the weight above it.
    load = DENSITY * DEPTH * HEIGHT * GRAVITY  # N, per length of a course
    bottom = 0.0
    for row, course in enumerate(courses(columns, rows)):
        bottom -= (rows - row) * load / (STIFFNESS * DEPTH)
        bricks.append([])
        for number, (x, length) in enumerate(course):
            # Bricks of a course do not touch at the start.
            size = np.array([length - 1e-3, DEPTH, HEIGHT])
            mass = DENSITY * size.prod()
            inertia = mass / 12.0 * (np.square(size).sum() - np.square(size))
            brick = scene.add_body(
                mass, inertia, position=(x, 0, bottom + 0.5 * HEIGHT), name=f"brick_{row}_{number}"
            )
            shade = 0.08 * (number % 3)
            scene.add_surface(wc.meshes.box(tuple(size)), brick, color=(0.65 + shade, 0.3 + shade, 0.2))
            bricks[-1].append(brick)
        bottom += HEIGHT
    height = 0.45 * rows * HEIGHT + 0.05
    ball = scene.add_body(
        BALL_MASS,
        [0.4 * BALL_MASS * BALL_RADIUS**2] * 3,
        # It rises and falls as much until it arrives.
        position=(0.07, -BALL_SPEED * ARRIVAL - BALL_RADIUS - 0.5 * DEPTH, height),
        linear_velocity=(0.0, BALL_SPEED, 0.5 * GRAVITY * ARRIVAL),
        name="ball",
    )
    scene.add_surface(wc.meshes.icosphere(BALL_RADIUS, subdivisions=2), ball, color=(0.2, 0.25, 0.3))
    material = wc.ContactMaterial(
        law=wc.laws.ElasticFoundation(stiffness=STIFFNESS, damping=5.0),
        friction=wc.friction.CundallStrack.from_overshoot(
            mu_static=0.5, mu_dynamic=0.5, stiffness=2e6, mass=2.0, overshoot=0.1
        ),
    )
    bodies = [*(brick for course in bricks for brick in course), ball]
    scene.add_body_contact(bodies, material, name="bodies")
    scene.add_body_contact(bodies, ground, material, name="on_ground")
    return scene, bricks


def support_forces(recording: wc.Recording, bricks: list[list[wc.Body]], frame: int) -> np.ndarray:
    """Returns the vertical force on each course from below [N], (rows,)."""
    row_of = {brick: row for row, course in enumerate(bricks) for brick in course}
    contacts = {contact.name: contact for contact in recording.scene.body_contacts}
    supports = np.zeros(len(bricks))
    on_ground = recording["on_ground.force"].values[frame, 0, :, 2]
    supports[0] = on_ground[: len(on_ground) - 1].sum()  # the last one is the ball
    for pair, force in zip(
        contacts["bodies"].pairs, recording["bodies.force"].values[frame, 0, :, 2], strict=True
    ):
        rows = [row_of.get(solid.body, -1) for solid in pair]
        if rows[0] != rows[1] and -1 not in rows:
            supports[max(rows)] += force if rows[0] > rows[1] else -force
    return supports


def main(argv: list[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description="A ball hits a wall of bricks.")
    parser.add_argument("--columns", type=int, default=5, help="bricks of a course (default: 5)")
    parser.add_argument("--rows", type=int, default=4, help="courses (default: 4)")
    parser.add_argument("--duration", type=float, default=3.0, help="simulated time [s] (default: 3)")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    parser.add_argument("--usd", metavar="FILE", help="write an animation, such as bricks.usdc")
    options = parser.parse_args(argv)
    scene, bricks = scene_of_wall(options.columns, options.rows)
    model = scene.build(device=options.device, precision="float32")
    simulation = wc.Simulation(model, DT)
    if warnings := simulation.check():
        raise RuntimeError("; ".join(warnings))
    record = ["scene.kinetic_energy", "scene.potential_energy", "bodies.force", "on_ground.force"]
    record += ["bodies.depth", "on_ground.depth"]
    record += [f"{body.name}.{key}" for body in scene.bodies for key in ("position", "orientation")]
    began = time.perf_counter()
    recording = simulation.run(options.duration, record, every=FRAME)
    took = time.perf_counter() - began

    frame = round(ARRIVAL / FRAME) - 2  # the last one before the ball arrives
    supports = support_forces(recording, bricks, frame)
    weights = GRAVITY * np.array([sum(float(brick.mass) for brick in course) for course in bricks])
    carried = np.cumsum(weights[::-1])[::-1]
    energy = (recording["scene.kinetic_energy"] + recording["scene.potential_energy"]).values[:, 0]
    force = recording["on_ground.force"].values[-1, 0, :, 2].sum()
    result = {
        "supports": float(np.abs(supports / carried - 1.0).max()),
        "gain": float(np.diff(energy[frame + 3 :], prepend=energy[frame]).max()),
        "lost": float(energy[frame] - energy[-1]),
        "depth": max(float(recording[f"{name}.depth"].max()) for name in ("bodies", "on_ground")),
        "kinetic": float(recording["scene.kinetic_energy"][-1, 0]),
        "reaction": float(force / (weights.sum() + BALL_MASS * GRAVITY) - 1.0),
    }
    pairs = sum(contact.count for contact in scene.body_contacts)
    print(f"{sum(map(len, bricks))} bricks, {pairs} pairs, {1e6 * took / simulation.steps:.0f} µs per step")
    print("course   carries, N   closed form, N")
    for row, (force, weight) in enumerate(zip(supports, carried, strict=True)):
        print(f"{row:6} {force:12.3f} {weight:16.3f}")
    print(
        f"energy {-result['lost']:.0f} J, largest gain in {FRAME:g} s {result['gain']:.1e} J; at the end {result['kinetic']:.1e} J kinetic"
    )
    print(
        f"deepest overlap {1e3 * result['depth']:.1f} mm; ground carries the weight of all to {result['reaction']:.1e}"
    )
    if options.usd:
        print("animation:", wc.export_usd(recording, options.usd))
    return result


if __name__ == "__main__":
    main()
