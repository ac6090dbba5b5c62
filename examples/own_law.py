"""A custom contact law and a custom friction model: a ball with horizontal speed falls on a plate.

Both classes are defined in this file and compiled into the contact kernel like those of the catalogue. Every
environment has a different damping. The rebound is compared with the closed form of the impact.
"""

import argparse
from typing import Any

import numpy as np
import warp as wp
from scipy.special import lambertw

import warpcontact as wc

GRAVITY = 9.81  # m/s²
MASS, RADIUS = 0.5, 0.05  # kg, m
DROP = 0.2  # m, from the lowest point of the ball to the plate
SIDEWAYS = 1.0  # m/s, horizontal speed of the ball, which has no spin initially
DRAG = 0.03  # s/m, drag coefficient of the friction model


class CubicSpring(wc.Law):
    """N = k δ³ (1 + χ δ̇): hardens with penetration; damping vanishes at the start and the end of contact."""

    stiffness: float = wc.parameter("N/m³", "stiffness k", above=0.0)
    damping: float = wc.parameter("s/m", "damping χ", default=0.0, at_least=0.0)

    @wp.func
    def force(p: Any, c: Any):
        """Returns the normal force from coefficients ``p`` and contact state ``c``; also compiles in float64."""
        one = type(c.delta)(1.0)
        return p.stiffness * c.delta * c.delta * c.delta * (one + p.damping * c.delta_dot)


class Lubricated(wc.Friction):
    """F = −β N v: proportional to load and slip velocity, as on a thin film; never sticks."""

    drag: float = wc.parameter("s/m", "drag β", at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        """Returns the force on the ball from coefficients ``p`` and slip state ``s``."""
        return (-p.drag * s.normal_force) * s.velocity


def drop(dampings: np.ndarray, device: str = "auto") -> wc.Recording:
    """Drops one ball per damping and records it past the top of its rebound."""
    scene = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
    plate = scene.add_surface(wc.meshes.grid((2.0, 2.0)), name="plate")
    ball = scene.add_body(
        mass=MASS,
        inertia=[0.4 * MASS * RADIUS**2] * 3,
        position=(0.0, 0.0, RADIUS + DROP),
        linear_velocity=(SIDEWAYS, 0.0, 0.0),
        name="ball",
    )
    material = wc.ContactMaterial(law=CubicSpring(stiffness=1.0e14), friction=Lubricated(drag=DRAG))
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), plate, material, radius=RADIUS, name="touch")

    model = scene.build(envs=len(dampings), device=device)
    model["touch.law.damping"] = dampings  # one value per environment; nothing is compiled again
    # The impact lasts about 0.7 ms with a penetration of half a millimeter, so gravity is negligible in it.
    sim = wc.Simulation(model, dt=1.0e-5)
    return sim.run(duration=2.2 * np.sqrt(2.0 * DROP / GRAVITY), record=["ball.linear_velocity"], every=1.0e-3)


def expected(dampings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns rebound height [m] and horizontal speed after the impact [m/s], without gravity in the impact.

    With x = χ v_in, the work of N in compression and restitution gives v_out = [1 + W₀(−(1+x) e^−(1+x))]/χ for any
    spring. The impulse of N is m (v_in + v_out). Slip u decays by du/dt = −(7/2)(β N/m) u, because friction both
    decelerates a solid ball and spins it up.
    """
    fall_speed = np.sqrt(2.0 * GRAVITY * DROP)
    chi = np.where(dampings > 0.0, dampings, 1.0)
    x = chi * fall_speed
    rebound_speed = (1.0 + np.real(lambertw(-(1.0 + x) * np.exp(-(1.0 + x))))) / chi
    rebound_speed = np.where(dampings > 0.0, rebound_speed, fall_speed)  # χ = 0: an elastic bounce
    slip = SIDEWAYS * np.exp(-3.5 * DRAG * (fall_speed + rebound_speed))
    return rebound_speed**2 / (2.0 * GRAVITY), SIDEWAYS - 2.0 / 7.0 * (SIDEWAYS - slip)


def compare(envs: int = 16, device: str = "auto") -> tuple[float, float]:
    """Prints simulated and expected values; returns the largest relative errors of rebound height and speed."""
    dampings = np.linspace(0.0, 0.6, envs)
    recording = drop(dampings, device)
    after = recording.sel(time=slice(1.05 * np.sqrt(2.0 * DROP / GRAVITY), None))
    heights = after["ball.position"].sel(axis="z").max("time").values - RADIUS
    speeds = after["ball.linear_velocity"].sel(axis="x").isel(time=0).values
    expected_heights, expected_speeds = expected(dampings)

    print("damping χ   rebound height [mm]     horizontal speed [m/s]")
    print("    [s/m]  simulated   expected     simulated   expected")
    for row in zip(dampings, 1e3 * heights, 1e3 * expected_heights, speeds, expected_speeds, strict=True):
        print("{:9.3f}  {:9.2f}  {:9.2f}     {:9.4f}  {:9.4f}".format(*row))
    height_error = float(np.abs(heights / expected_heights - 1.0).max())
    speed_error = float(np.abs(speeds / expected_speeds - 1.0).max())
    print(f"largest error of rebound height {100 * height_error:.2f} %, of speed {100 * speed_error:.2f} %")
    return height_error, speed_error


def main(argv: list[str] | None = None) -> tuple[float, float]:
    parser = argparse.ArgumentParser(description="A custom contact law and friction model.")
    parser.add_argument("--envs", type=int, default=16, help="number of dampings (default: 16)")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    options = parser.parse_args(argv)
    return compare(options.envs, options.device)


if __name__ == "__main__":
    main()
