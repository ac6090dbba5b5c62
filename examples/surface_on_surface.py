"""A meshed sphere is pressed into a plate: contact of two surfaces by sample points, with a law per area.

The force converges with the number of points. Its limit depends on the surface that has the points: springs on the
sphere push along the normal of the plate, springs on the plate along that of the sphere. The limits are

    π k R δ²  (points of the sphere)    and    π k (R − δ) δ²  (points of the plate)

and their mean for points on both surfaces with half the weight.
"""

import argparse
import math

import numpy as np

import warpcontact as wc

RADIUS = 0.05  # m
DEPTH = 0.004  # m, penetration of the lowest point
MODULUS = 1.0e9  # Pa/m
COUNTS = (250, 1000, 4000)


def force(sides: str, first: str, count: int, device: str) -> float:
    """Returns the contact force on the sphere [N]."""
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    plate = scene.add_surface(wc.meshes.grid((0.06, 0.06)), name="plate")
    ball = scene.add_body(mass=1.0, inertia=(1e-3, 1e-3, 1e-3), position=(0, 0, RADIUS - DEPTH), name="ball")
    skin = scene.add_surface(wc.meshes.icosphere(RADIUS, subdivisions=6), ball, name="skin")
    pair = (skin, plate) if first == "sphere" else (plate, skin)
    # Each point represents an area of its surface, which the law uses.
    pad = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=MODULUS))
    scene.add_surface_contact(*pair, pad, samples=count, sides=sides, name="press")
    model = scene.build(device=device, precision="float64")
    return float(model.sensor("ball.force")[0, 2])


def main(argv: list[str] | None = None) -> dict[str, np.ndarray]:
    parser = argparse.ArgumentParser(description="A meshed sphere pressed into a plate.")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    options = parser.parse_args(argv)

    sphere = math.pi * MODULUS * RADIUS * DEPTH**2
    plate = math.pi * MODULUS * (RADIUS - DEPTH) * DEPTH**2
    cases = {
        "points of the sphere": ("first", "sphere", sphere),
        "points of the plate": ("first", "plate", plate),
        "both, half each": ("average", "sphere", 0.5 * (sphere + plate)),
    }
    errors = {}
    print(
        f"{'force in N, points per surface':32}" + "".join(f"{count:>10}" for count in COUNTS) + f"{'limit':>10}"
    )
    for label, (sides, first, limit) in cases.items():
        values = np.array([force(sides, first, count, options.device) for count in COUNTS])
        print(f"{label:32}" + "".join(f"{value:10.1f}" for value in values) + f"{limit:10.1f}")
        errors[label] = np.abs(values / limit - 1.0)
    return errors


if __name__ == "__main__":
    main()
