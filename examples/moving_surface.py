"""Two free bodies collide in space: a spinning block carries a mesh surface, the other is a ball.

Like a point, a surface can be fixed to a body. Both bodies get equal and opposite forces at the same point. So the
total linear and angular momentum is constant to rounding for any law and friction model.
"""

import argparse

import numpy as np

import warpcontact as wc

SIZE = np.array([0.4, 0.2, 0.3])  # m, edges of the block
RADIUS = 0.05  # m, of the ball


def scene_in_space() -> wc.Scene:
    """Returns the scene of a spinning block that a faster ball hits from behind, off its center."""
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    mass = 2.0
    block = scene.add_body(
        mass=mass,
        inertia=mass / 12.0 * (SIZE @ SIZE - SIZE**2),
        position=(1.0, 0.0, 0.0),
        linear_velocity=(0.2, 0.0, 0.1),
        angular_velocity=(0.3, -0.2, 0.5),
        name="block",
    )
    hull = scene.add_surface(wc.meshes.box(SIZE), body=block, name="hull")
    ball = scene.add_body(
        mass=0.5,
        inertia=[0.4 * 0.5 * RADIUS**2] * 3,
        position=(0.7, 0.05, 0.02),
        linear_velocity=(2.0, 0.0, 0.3),
        angular_velocity=(0.0, 10.0, 0.0),
        name="ball",
    )
    material = wc.ContactMaterial(
        law=wc.laws.HuntCrossley(stiffness=1.0e7, exponent=1.5, restitution=0.5),
        friction=wc.friction.Tanh(mu=0.3, velocity_scale=0.02),
    )
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), hull, material, radius=RADIUS, name="touch")
    return scene


def collide(envs: int = 5, device: str = "auto", precision: str = "float64") -> dict[str, float]:
    """Prints the result of the collision; returns relative drifts of momentum and the error of restitution."""
    model = scene_in_space().build(envs=envs, device=device, precision=precision)
    prescribed = np.linspace(0.1, 0.9, envs)
    model["touch.law.restitution"] = prescribed
    sim = wc.Simulation(model, dt=1.0e-5)
    conserved = ["scene.linear_momentum", "scene.angular_momentum"]
    recording = sim.run(duration=0.06, record=[*conserved, "scene.kinetic_energy", "touch.approach_speed"])

    result = {}
    for name in conserved:
        momentum = recording[name]
        before, after = momentum.isel(time=0, env=0).values, momentum.isel(time=-1, env=0).values
        # Relative to the length of the vector, over all times and environments.
        drift = np.abs(momentum - momentum.isel(time=0)).max() / np.linalg.norm(before)
        result[name] = float(drift)
        unit = momentum.attrs["units"]
        print(f"{name:22}  before {before} {unit}\n{'':22}  after  {after} {unit}, environment 0")

    # The speed at the contact point is > 0 on the way in, < 0 on the way out, and 0 before and after.
    touching = [approach[approach != 0.0] for approach in recording["touch.approach_speed"].values.T]
    restitution = np.array([-approach[-1] / approach[0] for approach in touching])
    energy = recording["scene.kinetic_energy"].values
    print("restitution asked    got  kinetic energy lost")
    for e, got, loss in zip(prescribed, restitution, 1.0 - energy[-1] / energy[0], strict=True):
        print(f"{e:17.3f}  {got:.3f}  {100 * loss:17.1f} %")
    result["restitution"] = float(np.abs(restitution - prescribed).max())
    print(
        f"drift of momentum {result[conserved[0]]:.1e} linear, {result[conserved[1]]:.1e} angular; "
        f"largest error of restitution {result['restitution']:.4f}"
    )
    return result


def main(argv: list[str] | None = None) -> dict[str, float]:
    parser = argparse.ArgumentParser(description="Two free bodies push each other in space.")
    parser.add_argument("--envs", type=int, default=5, help="number of restitutions (default: 5)")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    parser.add_argument("--precision", default="float64", choices=("float32", "float64"))
    options = parser.parse_args(argv)
    return collide(options.envs, options.device, options.precision)


if __name__ == "__main__":
    main()
