"""A heavy ball breaks through a wall of boxes in running bond: nonsmooth contact of many bodies, both solvers.

There is contact between boxes, ground and ball. Between two boxes, the corners of each are in contact with the
faces of the other.

Run it with ``python examples/wall_of_boxes.py --usd wall.usdc --picture wall.png``.
"""

import argparse
import itertools
import time
import warnings

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

import warpcontact as wc

GRAVITY = 9.81  # m/s²
LENGTH, DEPTH, HEIGHT = 0.4, 0.2, 0.2  # m, of a box with its joint
JOINT = 2e-3  # m, between boxes of a course
ROUNDING = 0.01  # m, radius of the corner spheres
DENSITY = 700.0  # kg/m³, of boxes
BALL_MASS, BALL_RADIUS, BALL_SPEED = 60.0, 0.17, 7.0  # kg, m, m/s
FRICTION, RESTITUTION = 0.5, 0.1
DT, FRAME = 1e-3, 1e-2  # s
TOLERANCE = 1e-6  # of a solve, relative to its impulses


def bond(columns: int, rows: int) -> list[tuple[float, float, float]]:
    """Returns center and length of each box (x, z, length) [m]; odd courses begin and end with half a box."""
    boxes = []
    for row in range(rows):
        ends = np.arange(columns + 1.0)
        if row % 2:
            ends = np.concatenate([[0.0], ends[:-1] + 0.5, [columns]])
        for left, right in itertools.pairwise((ends - 0.5 * columns) * LENGTH):
            boxes.append((0.5 * (left + right), (row + 0.5) * HEIGHT, right - left - JOINT))
    return boxes


def wall(columns: int, rows: int) -> wc.Scene:
    """Returns the scene of a wall in the plane y = 0 and a ball in front of it."""
    scene = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
    ground = scene.add_surface(wc.meshes.grid((20.0, 20.0)), name="ground", color=(0.5, 0.55, 0.5))
    material = wc.ContactMaterial(
        law=wc.laws.Rigid(restitution=RESTITUTION), friction=wc.friction.Coulomb(mu=FRICTION)
    )
    points, surfaces = [], []
    for number, (x, z, length) in enumerate(bond(columns, rows)):
        size = np.array([length, DEPTH, HEIGHT])
        mass = DENSITY * size.prod()
        inertia = mass / 12.0 * (np.square(size).sum() - np.square(size))
        shade = 0.08 * (number % 3)
        color = (0.65 + shade, 0.3 + shade, 0.2)
        box = scene.add_body(mass, inertia, position=(x, 0.0, z), name=f"box{number}", color=color)
        corners = (0.5 * size - ROUNDING) * _SIGNS
        points.append(scene.add_points(box, corners, name=f"corners{number}"))
        surfaces.append(scene.add_surface(wc.meshes.box(tuple(size)), box, name=f"hull{number}", color=color))
    ball = scene.add_body(
        BALL_MASS,
        [0.4 * BALL_MASS * BALL_RADIUS**2] * 3,
        position=(0.07, -1.0, 0.45 * rows * HEIGHT + 0.05),
        linear_velocity=(0.0, BALL_SPEED, 1.0),
        name="ball",
        color=(0.2, 0.25, 0.3),
    )
    centre = scene.add_point(ball, (0.0, 0.0, 0.0), name="centre")
    scene.add_contact(centre, ground, material, radius=BALL_RADIUS, name="ball_on_ground")
    # A corner with a larger penetration came from the other side.
    half = 0.5 * min(DEPTH, HEIGHT)
    for number, corners in enumerate(points):
        scene.add_contact(corners, ground, material, radius=ROUNDING, name=f"feet{number}")
        scene.add_contact(centre, surfaces[number], material, radius=BALL_RADIUS, name=f"hit{number}")
        for other, surface in enumerate(surfaces):
            if other != number:
                scene.add_contact(
                    corners, surface, material, radius=ROUNDING, max_depth=half, name=f"on{number}_{other}"
                )
    return scene


def strike(
    columns: int, rows: int, duration: float, solver: str, device: str
) -> tuple[dict[str, float], wc.Recording]:
    """Runs the wall with a solver; returns figures and the recording."""
    scene = wall(columns, rows)
    model = scene.build(device=device, precision="float64")
    integrator = wc.integrators.MoreauJean(solver=solver, tolerance=TOLERANCE)
    simulation = wc.Simulation(model, DT, integrator)
    depths = [f"{contact.name}.penetration" for contact in scene.contacts]
    record = ["scene.kinetic_energy", "scene.potential_energy", "scene.closed_contacts", "scene.solve_failures"]
    record += ["scene.solve_iterations", "scene.friction_dissipation", "scene.impact_dissipation"]
    record += [f"{body.name}.{key}" for body in scene.bodies for key in ("linear_velocity", "angular_velocity")]
    simulation.step(1)  # compiles the kernels
    simulation.reset()
    with warnings.catch_warnings():
        # Steps that miss the tolerance are counted by solve_failures.
        warnings.filterwarnings("ignore", message="the contact problem did not converge")
        began = time.perf_counter()
        simulation.step(round(duration / DT))
        took = time.perf_counter() - began
        simulation.reset()
        recording = simulation.run(duration, [*record, *depths], every=FRAME)
    energy = (recording["scene.kinetic_energy"] + recording["scene.potential_energy"]).values[:, 0]
    reach = {body.name: 0.5 * np.linalg.norm([LENGTH, DEPTH, HEIGHT]) for body in scene.bodies}
    reach["ball"] = BALL_RADIUS
    speed = max(
        float(
            (
                _size(recording[f"{name}.linear_velocity"]) + arm * _size(recording[f"{name}.angular_velocity"])
            ).max()
        )
        for name, arm in reach.items()
    )
    return {
        "penetration": max(float(recording[name].max()) for name in depths),
        "bound": speed * DT,
        "gain": float(np.diff(energy).max()),
        "lost": float(energy[0] - energy[-1]),
        "friction": float(recording["scene.friction_dissipation"][-1, 0]),
        "impact": float(recording["scene.impact_dissipation"][-1, 0]),
        "converged": 1.0 - float(recording["scene.solve_failures"][-1, 0]) / simulation.steps,
        "iterations": float(recording["scene.solve_iterations"].mean()),
        "contacts": float(recording["scene.closed_contacts"].mean()),
        "step": took / simulation.steps,
    }, recording


def draw(recording: wc.Recording, sizes: dict[str, np.ndarray], file: str) -> None:
    """Plots the wall at six instants."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    figure = Figure(figsize=(13.0, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    times = recording["time"].values
    names = list(sizes)
    faces = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])
    light = np.array([-0.35, -0.75, 0.55])
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 13))
    sphere = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1)
    patches = np.stack([sphere[:-1, :-1], sphere[1:, :-1], sphere[1:, 1:], sphere[:-1, 1:]], axis=2).reshape(
        -1, 4, 3
    )
    for number, moment in enumerate(np.linspace(0.0, 1.0, 6) ** 1.5 * times[-1]):
        frame = int(np.abs(times - moment).argmin())
        axes = figure.add_subplot(2, 3, number + 1, projection="3d", computed_zorder=False)
        quads, colors = [], []
        for index, name in enumerate(names):
            pose = (
                recording[f"{name}.position"].values[frame, 0],
                recording[f"{name}.orientation"].values[frame, 0],
            )
            turn = Rotation.from_quat(pose[1])
            corners = turn.apply(0.5 * sizes[name] * _SIGNS) + pose[0]
            shade = np.array([0.66, 0.36, 0.24]) + 0.07 * (index % 3)
            for face in faces:
                quad = corners[face]
                normal = quad.mean(axis=0) - pose[0]
                quads.append(quad)
                colors.append(
                    np.clip(shade * (0.55 + 0.55 * max(0.0, normal @ light / np.linalg.norm(normal))), 0, 1)
                )
        ball = recording["ball.position"].values[frame, 0]
        quads += list(BALL_RADIUS * patches + ball)
        glow = 0.35 + 0.4 * np.clip(patches.mean(axis=1) @ light, 0.0, None)
        colors += [np.array([0.6, 0.7, 0.8]) * part for part in glow]
        axes.add_collection3d(
            Poly3DCollection(quads, facecolors=colors, edgecolors=(0, 0, 0, 0.25), linewidths=0.3)
        )
        ground = np.array([[-1.6, -1.2, 0.0], [1.6, -1.2, 0.0], [1.6, 2.8, 0.0], [-1.6, 2.8, 0.0]])
        axes.add_collection3d(Poly3DCollection([ground], facecolors=["#dfe4dc"], zorder=-1))
        axes.set(xlim=(-1.6, 1.6), ylim=(-1.2, 2.8), zlim=(0.0, 1.4))
        axes.set_title(f"{times[frame]:.2f} s", y=0.88)
        axes.set_box_aspect((3.2, 4.0, 1.4), zoom=1.6)
        axes.view_init(elev=20.0, azim=-62.0)
        axes.set_axis_off()
    figure.savefig(file, dpi=110)


def main(argv: list[str] | None = None) -> dict[str, dict[str, float]]:
    parser = argparse.ArgumentParser(description="A heavy ball breaks through a wall of boxes.")
    parser.add_argument("--columns", type=int, default=5, help="boxes of a course (default: 5)")
    parser.add_argument("--rows", type=int, default=4, help="courses (default: 4)")
    parser.add_argument("--duration", type=float, default=1.2, help="simulated time [s] (default: 1.2)")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    parser.add_argument("--usd", metavar="FILE", help="write an animation, such as wall.usdc")
    parser.add_argument("--picture", metavar="FILE", help="draw some instants, such as wall.png")
    options = parser.parse_args(argv)
    results = {}
    print(f"{len(bond(options.columns, options.rows))} boxes")
    for solver in ("gauss_seidel", "accelerated"):
        r, recording = strike(options.columns, options.rows, options.duration, solver, options.device)
        results[solver] = r
        print(
            f"{solver}: {r['contacts']:.0f} closed contacts, {r['iterations']:.0f} iterations and "
            f"{1e3 * r['step']:.1f} ms a step, {100.0 * r['converged']:.1f} % of the solves to {TOLERANCE:g}\n"
            f"  deepest penetration {1e3 * r['penetration']:.2f} mm, "
            f"fastest corner times step {1e3 * r['bound']:.2f} mm\n"
            f"  energy {-r['lost']:.0f} J: friction took {r['friction']:.0f} J, impacts {r['impact']:.0f} J; "
            f"most that came in {FRAME:g} s: {r['gain']:.1e} J"
        )
    sizes = {
        f"box{n}": np.array([length, DEPTH, HEIGHT])
        for n, (_, _, length) in enumerate(bond(options.columns, options.rows))
    }
    if options.picture:
        draw(recording, sizes, options.picture)
        print(f"picture: {options.picture}")
    if options.usd:
        # Without the penetrations of the 500 contacts.
        poses = recording.drop_vars([name for name in recording.data_vars if str(name).endswith(".penetration")])
        wc.export_usd(poses, options.usd, scene=recording.scene)
        print(f"animation: {options.usd}")
    return results


def _size(vectors: xr.DataArray) -> np.ndarray:
    return np.linalg.norm(vectors.values, axis=-1)


_SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


if __name__ == "__main__":
    main()
