"""A boat comes alongside a quay: a contact coupling keeps two fenders on its side off the wall.

The range of the coupling is computed for a design speed, with weak damping. Environments differ in speed; faster
boats come closer than intended, which the report lists. Relative to the undamped stopping distance v/ω and to the
initial speed, the closest distance and the final speed are

    d = d₀ − (v/ω) exp(−ς arccos(ς)/√(1 − ς²)),    e = exp(−ς (π − atan2(2ς √(1 − ς²), 1 − 2ς²))/√(1 − ς²))

There is no force of the water on the boat.
"""

import argparse
import math

import numpy as np

import warpcontact as wc

MASS = 40e3  # kg
BOAT = (12.0, 4.0, 2.0)  # m
FENDER = (1.0, 0.3, 1.0)  # m, along the side, out of it, up
FENDERS_AT = (-4.0, 4.0)  # m, along the side
RANGE, CLOSEST = 0.5, 0.1  # m
DESIGN_SPEED = 0.3  # m/s
DAMPING_RATIO = 0.05
DT = 0.02  # s


def fenders() -> wc.Mesh:
    """Returns the fenders, in the frame of the boat."""
    box = wc.meshes.box(FENDER)
    places = [(x, -0.5 * (BOAT[1] + FENDER[1]), 0.0) for x in FENDERS_AT]
    vertices = np.concatenate([box.vertices + place for place in places])
    faces = np.concatenate([box.faces + number * len(box.vertices) for number in range(len(places))])
    return wc.Mesh(vertices, faces, name="fenders")


def harbour() -> tuple[wc.Scene, wc.ContactCoupling]:
    """Returns the scene of a wall, whose outer side faces +y, and a boat next to it, and their contact coupling."""
    x, y, z = BOAT
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    laid = (-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))  # z → y
    wall = scene.add_surface(wc.meshes.grid((30.0, 6.0)), orientation=laid, name="wall", color=(0.6, 0.6, 0.6))
    boat = scene.add_body(
        mass=MASS,
        inertia=MASS / 12.0 * np.array([y**2 + z**2, x**2 + z**2, x**2 + y**2]),
        position=(0.0, 0.5 * y + FENDER[1] + RANGE + 0.1, 0.0),
        name="boat",
        color=(0.2, 0.35, 0.6),
    )
    scene.add_surface(wc.meshes.box(BOAT), boat, name="hull")
    skin = scene.add_surface(fenders(), boat, name="fenders", color=(0.1, 0.1, 0.1))
    contact_range = wc.ContactRange.from_impact(
        mass=MASS,
        area=len(FENDERS_AT) * FENDER[0] * FENDER[2],
        speed=DESIGN_SPEED,
        effective_range=RANGE,
        closest=CLOSEST,
        damping_ratio=DAMPING_RATIO,
    )
    friction = wc.friction.Tanh(mu=0.3, velocity_scale=0.05)
    return scene, scene.add_contact_coupling(skin, wall, contact_range, friction, name="berth")


def main(argv: list[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description="A boat that berths on fenders.")
    parser.add_argument("--envs", type=int, default=8, help="number of speeds, from 0.05 to 0.4 m/s (default 8)")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    parser.add_argument("--usd", help="file to write an animation to")
    options = parser.parse_args(argv)

    scene, coupling = harbour()
    model = scene.build(envs=options.envs, device=options.device, precision="float64")
    speed = np.linspace(0.05, 0.4, options.envs)
    model["boat.linear_velocity"] = np.column_stack([0.0 * speed, -speed, 0.0 * speed])
    arrows = [f"berth_first.{key}" for key in ("point", "normal", "normal_force", "friction_force")]
    record = ["boat.linear_velocity", "berth.minimum_distance", "berth.force", *arrows]
    recording = wc.Simulation(model, dt=DT).run(15.0, record=record, every=0.1)

    root = math.sqrt(1.0 - DAMPING_RATIO**2)
    turn = math.exp(-DAMPING_RATIO / root * math.acos(DAMPING_RATIO))
    leave = math.pi - math.atan2(2.0 * DAMPING_RATIO * root, 1.0 - 2.0 * DAMPING_RATIO**2)
    closest = RANGE - speed / DESIGN_SPEED * (RANGE - CLOSEST) * turn
    rebound = math.exp(-DAMPING_RATIO / root * leave)

    report = coupling.report(model)
    after = recording["boat.linear_velocity"].sel(axis="y").isel(time=-1).values / speed
    print("speed, m/s     closest, m     expected     speed after/before     expected")
    for v, found, known, ratio in zip(speed, report.minimum_distance, closest, after, strict=True):
        print(f"{v:10.3f} {found:14.4f} {known:12.4f} {ratio:22.4f} {rebound:12.4f}")
    print(report)
    result = {
        "distance": float(np.abs(report.minimum_distance - closest).max() / (RANGE - CLOSEST)),
        "rebound": float(np.abs(after / rebound - 1.0).max()),
        "passed": int(report.passed.sum()),
    }
    print(f"largest error of the distance {result['distance']:.2%} of the way, of speed {result['rebound']:.2%}")
    if options.usd:
        print("animation:", wc.export_usd(recording, options.usd, spacing=(40.0, 20.0)))
    return result


if __name__ == "__main__":
    main()
