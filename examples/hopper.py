"""A hopper: thousands of spheres flow through a funnel, and their rate is compared with Beverloo's law.

Beverloo, Leniger and van de Velde (Chem. Eng. Sci. 15 (1961) 260) found the mass flow rate W = C ρ √g (D − k
d)^(5/2) of a hopper with a round orifice of diameter D, grains of diameter d and their bulk density ρ, with C ≈
0.58 and k ≈ 1.4, independent of the filling height. Shallow funnels like this one behave like flat floors, because
grains at rest on them form a steeper funnel.
"""

import argparse
import math

import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

import warpcontact as wc

GRAVITY = 9.81  # m/s²
DIAMETER = 0.01  # m, mean diameter of the spheres; they vary by ± 10 %
DENSITY = 2500.0  # kg/m³, of their material
FRICTION, RESTITUTION = 0.5, 0.5
STIFFNESS = 2000.0  # in weights of a sphere per diameter: N/m = STIFFNESS m g / d
SLOPE = math.radians(30.0)  # of the funnel
C, K = 0.58, 1.4  # of Beverloo's law

UNIT = math.sqrt(DIAMETER / GRAVITY)  # s
MASS = DENSITY * math.pi / 6.0 * DIAMETER**3  # kg


def lathe(profile: list[tuple[float, float]], sides: int = 72) -> wc.Mesh:
    """Returns the surface of revolution of a line (radius, height) about z, its outer side towards the axis.

    The line must run downwards.
    """
    angles = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    vertices = np.concatenate([np.insert(radius * ring, 2, height, axis=1) for radius, height in profile])
    here = np.arange(sides)
    beside = (here + 1) % sides
    faces = []
    for row in range(len(profile) - 1):
        upper, lower = row * sides, (row + 1) * sides
        faces += [
            np.stack([upper + here, lower + beside, lower + here], axis=-1),
            np.stack([upper + here, upper + beside, lower + beside], axis=-1),
        ]
    return wc.Mesh(vertices, np.concatenate(faces))


def bin_radius(spheres: int, orifice: float) -> float:
    """Returns the radius of a bin 5 diameters wider than the orifice, and about as high as wide when full [m]."""
    return max((spheres / 5.5) ** (1.0 / 3.0), 0.5 * orifice + 5.0) * DIAMETER


def fewest(orifice: float) -> int:
    """Returns the number of spheres that fill the funnel and four diameters of the narrowest bin above it."""
    width, mouth = 0.5 * orifice + 5.0, 0.5 * orifice
    funnel = (width - mouth) * math.tan(SLOPE) * (width**2 + width * mouth + mouth**2) / 3.0
    # Packed to 0.6 of the volume; a sphere of unit diameter has a volume of π/6.
    return math.ceil(0.6 * 6.0 * (funnel + 4.0 * width**2))


def hopper(spheres: int, orifice: float, part: float, seed: int = 0) -> tuple[wc.Scene, np.ndarray]:
    """Returns the scene of spheres above a funnel with a gate in its orifice, and their radii.

    ``orifice`` is its width in mean diameters. The floor is so deep that a heap of ``part`` of the spheres does
    not reach the orifice.
    """
    rng = np.random.default_rng(seed)
    radii = 0.5 * DIAMETER * rng.uniform(0.9, 1.1, spheres)
    width, mouth = bin_radius(spheres, orifice), 0.5 * orifice * DIAMETER
    rise = (width - mouth) * math.tan(SLOPE)

    # Loose layers with small random displacements.
    pitch = 1.15 * DIAMETER
    lines = np.arange(-width, width, pitch)
    row = np.stack(np.meshgrid(lines, lines), axis=-1).reshape(-1, 2)
    row = row[np.linalg.norm(row, axis=1) < width - 0.7 * DIAMETER]
    rows = -(-spheres // len(row))
    heights = rise + pitch * (0.5 + np.arange(rows))
    places = np.concatenate([np.insert(row, 2, height, axis=1) for height in heights])[:spheres]
    places += 0.02 * DIAMETER * rng.uniform(-1, 1, places.shape)

    scene = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
    masses = DENSITY * 4.0 / 3.0 * np.pi * radii**3
    moments = 0.4 * (masses * radii**2)[:, None] * np.ones(3)
    grains = scene.add_bodies(places, masses, moments, name="grains")
    centres = scene.add_point(grains, (0, 0, 0), name="centres")
    stiffness = STIFFNESS * MASS * GRAVITY / DIAMETER
    material = wc.ContactMaterial(
        law=wc.laws.KelvinVoigt(stiffness=stiffness, restitution=RESTITUTION),
        friction=wc.friction.CundallStrack(
            mu_static=FRICTION,
            mu_dynamic=FRICTION,
            stiffness=0.8 * stiffness,
            damping=0.2 * math.sqrt(stiffness * MASS),
        ),
    )
    top = heights[-1] + 2.0 * DIAMETER
    wall = scene.add_surface(lathe([(width, top), (width, rise), (mouth, 0.0)]), name="funnel")
    gate = scene.add_surface(wc.meshes.grid((2.2 * mouth, 2.2 * mouth)), name="gate")
    heap = (part * spheres) ** (1.0 / 3.0) * DIAMETER
    depth = 0.6 * heap + 10.0 * DIAMETER
    ground = scene.add_surface(wc.meshes.grid((16.0 * heap, 16.0 * heap)), position=(0, 0, -depth), name="floor")
    # Limits penetration, so that spheres below the funnel are not in contact with its wall.
    options = {"radius": radii, "max_depth": 0.5 * DIAMETER}
    scene.add_contact(centres, wall, material, boundary="outer", name="on_funnel", **options)
    scene.add_contact(centres, gate, material, name="on_gate", **options)
    scene.add_contact(centres, ground, material, name="on_floor", **options)
    forms = [wc.shapes.Sphere(float(radius)) for radius in radii]
    scene.add_particle_contact(scene.add_shape(grains, forms), material, name="pile")
    return scene, radii


def packed_fraction(places: np.ndarray, radii: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Returns the packing fraction in a cylinder about z with radius ``low[0]``, from 100 000 sample points."""
    rng = np.random.default_rng(2)
    distance = low[0] * np.sqrt(rng.uniform(size=100_000))
    angle = rng.uniform(0.0, 2.0 * np.pi, distance.shape)
    points = np.stack(
        [distance * np.cos(angle), distance * np.sin(angle), rng.uniform(low[1], high[1], 100_000)], 1
    )
    near = cKDTree(places).query(points, k=4)
    return float((near[0] < radii[near[1]]).any(axis=1).mean())


def discharge(spheres: int, orifice: float, part: float, device: str, progress: bool = True) -> dict[str, object]:
    """Fills a hopper, opens it, and measures the flow rate while ``part`` of the spheres leave it."""
    scene, radii = hopper(spheres, orifice, part)
    model = scene.build(device=device)
    model["on_gate.enabled"] = 1.0
    # 17 steps per contact of two spheres, more for a light sphere and the wall.
    dt = math.pi * math.sqrt(0.5 / STIFFNESS) * UNIT / 17.0
    sim = wc.Simulation(model, dt=dt)
    every = round(0.5 * UNIT / dt)
    width, mouth = bin_radius(spheres, orifice), 0.5 * orifice * DIAMETER
    rise = (width - mouth) * math.tan(SLOPE)
    law = C * math.sqrt(GRAVITY) * ((orifice - K) * DIAMETER) ** 2.5  # m³/s of filling

    def places() -> np.ndarray:
        return model.sensor("grains.position")[0]

    with tqdm(total=1.0, disable=not progress, bar_format="{desc}: {percentage:3.0f}% |{bar}| {elapsed}") as bar:
        bar.set_description("filling")
        weight = radii**3 * DENSITY * 4.0 / 3.0 * np.pi
        start = sim.time
        while True:
            sim.step(4 * every)
            bar.update(min(0.01, 0.15 - bar.n))
            energy = float(model.sensor("scene.kinetic_energy")[0])
            # At rest: the kinetic energy would lift the spheres by a thousandth of a diameter.
            if sim.time - start > 10.0 * UNIT and energy < 1.0e-3 * weight.sum() * GRAVITY * DIAMETER:
                break
        settled = places()
        height = float(np.quantile(settled[:, 2], 0.98))
        inner = max(width - 2.5 * DIAMETER, 0.5 * width)
        fraction = packed_fraction(
            settled, radii, np.array([inner, rise + DIAMETER]), np.array([inner, height - 2.0 * DIAMETER])
        )
        bulk = fraction * DENSITY
        model["on_gate.enabled"] = 0.0
        bar.set_description("flowing")
        opened, times, left = sim.time, [], []
        picture = settled
        while not left or left[-1] < part * weight.sum():
            sim.step(every)
            now = places()
            times.append(sim.time - opened)
            left.append(float(weight[now[:, 2] < -0.5 * DIAMETER].sum()))
            bar.update(max(0.0, 0.15 + 0.85 * min(1.0, left[-1] / (part * weight.sum())) - bar.n))
            if left[-1] < 0.6 * part * weight.sum():
                picture = now
            if times[-1] > 6.0 * part * weight.sum() / (bulk * law):
                break
    # Steady flow: the first tenth is affected by the gate.
    time, mass = np.array(times), np.array(left)
    steady = mass > 0.1 * mass[-1]
    rate = float(np.polyfit(time[steady], mass[steady], 1)[0])
    return {
        "rate": rate,
        "law": bulk * law,
        "fraction": fraction,
        "C": rate / (bulk * law / C),
        "time": time,
        "mass": mass,
        "places": picture,
        "radii": radii,
        "steps": sim.steps,
        "health": model.health(),
    }


def draw(result: dict[str, object], file: str) -> None:
    """Plots a slice through the hopper during flow, and the discharged mass over time."""
    import matplotlib.pyplot as plt
    from matplotlib.collections import EllipseCollection

    places, radii = np.asarray(result["places"]), np.asarray(result["radii"])
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5))
    shown = np.abs(places[:, 1]) < DIAMETER
    order = np.argsort(-places[shown][:, 1])
    x, y, z = places[shown][order].T
    size = 2.0 * radii[shown][order]
    grains = EllipseCollection(
        size, size, np.zeros(len(size)), units="xy", offsets=np.stack([x, z], 1), transOffset=left.transData,
        array=y, cmap="YlOrBr", edgecolors="black", linewidths=0.3,
    )  # fmt: skip
    left.add_collection(grains)
    high = z[z < np.quantile(z, 0.999)].max()
    left.set(
        xlim=(1.1 * x.min(), 1.1 * x.max()), ylim=(min(z.min(), 0.0) - DIAMETER, high + DIAMETER), aspect="equal"
    )
    left.set(xlabel="x [m]", ylabel="z [m]", title="a slice two diameters thick, in flow")
    time, mass = np.asarray(result["time"]), np.asarray(result["mass"])
    right.plot(time, mass, label="simulated")
    # Through the center of the measured points.
    law = float(result["law"])  # type: ignore[arg-type]
    right.plot(time, mass.mean() + law * (time - time.mean()), "--", label="slope of Beverloo's law")
    right.set(xlabel="time since the gate opened [s]", ylabel="mass that has left [kg]", ylim=(0, None))
    right.legend()
    figure.tight_layout()
    figure.savefig(file, dpi=110)
    plt.close(figure)


def main(argv: list[str] | None = None) -> dict[str, object]:
    parser = argparse.ArgumentParser(description="Spheres run through a funnel.")
    parser.add_argument("--spheres", type=int, default=20_000, help="number of spheres (default: 20 000)")
    parser.add_argument("--orifice", type=float, default=8.0, help="its width in diameters (default: 8)")
    parser.add_argument("--part", type=float, default=0.15, help="part of them to let out (default: 0.15)")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    parser.add_argument("--picture", help="file to draw to, such as hopper.png")
    options = parser.parse_args(argv)
    if options.spheres < (least := fewest(options.orifice)):
        parser.error(
            f"--spheres must be at least {least} to fill a funnel with an orifice of {options.orifice:g} "
            f"diameters, got {options.spheres}"
        )
    result = discharge(options.spheres, options.orifice, options.part, options.device)
    if options.picture:
        draw(result, options.picture)
    print(
        f"{options.spheres} spheres, packed to {result['fraction']:.3f}, {result['steps']} steps\n"
        f"flow rate {result['rate']:.4f} kg/s; Beverloo's law with C = {C}, k = {K}: {result['law']:.4f} kg/s\n"
        f"C of this flow: {result['C']:.3f}"
    )
    return result


if __name__ == "__main__":
    main()
