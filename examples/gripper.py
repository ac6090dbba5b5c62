"""A gripper with two compliant pads lifts a part, shakes it, and lays it down.

Pad and part are compliant: on a column of length h their pressures k₁ h₁ = k₂ h₂ with h₁ + h₂ = h balance, so pads of area A
that are pressed in by s have the grip force N = k₁ k₂/(k₁ + k₂) A s. On a circle of radius a with the angular frequency ω, the
friction of both pads carries the part if

    2 μ N ≥ m (g + a ω²)

Environments differ by the margin, the ratio of both sides. The part slips below a margin of 1 and stays in its place above it.
"""

import argparse
import math
import time
from typing import Any

import numpy as np
import warp as wp

import warpcontact as wc

GRAVITY = 9.81  # m/s²
SIDE, MASS = 0.04, 0.2  # m, kg; of the part, a cube
PAD = 0.02  # m, side of a pad
CLEARANCE = 1e-3  # m, between open pads and the part
PAD_MODULUS, PART_MODULUS = 1e8, 3e8  # Pa/m
FRICTION, STICK_STIFFNESS = 0.5, 1e5  # -, N/m
LIFT, RADIUS, FREQUENCY = 0.1, 0.01, 5.0  # m, m, Hz
#: Start and duration of each part of the motion [s]; those from ``STOP`` on are later by the time of shaking.
CLOSE, RISE, SHAKE = wp.vec2d(0.0, 0.2), wp.vec2d(0.3, 0.5), wp.vec2d(0.9, 0.4)
STOP, LOWER, OPEN, END = wp.vec2d(0.5, 0.4), wp.vec2d(1.0, 0.5), wp.vec2d(1.6, 0.2), 2.0
MARGINS = np.array([0.97, 1.03, 1.5])
DT = 2e-4  # s


@wp.func
def ramp(t: Any, phase: wp.vec2d):
    """Returns a polynomial that rises from 0 to 1 in a phase, with a continuous acceleration."""
    s = wp.clamp((t - phase[0]) / phase[1], wp.float64(0.0), wp.float64(1.0))
    return s * s * s * (wp.float64(10.0) + s * (wp.float64(-15.0) + wp.float64(6.0) * s))


class Grip(wc.Motion):
    """Closes along x, lifts, moves on a circle in the plane x = 0, lowers, and opens."""

    stroke: float = wc.parameter("m", "displacement along x that closes the pad")
    shaking: float = wc.parameter("s", "time on the circle", above=0.0)

    @wp.func
    def displacement(p: Any, t: Any):
        """Returns the displacement at the time ``t`` with the parameters ``p`` of the pad."""
        after = t - p.shaking
        closed = ramp(t, CLOSE) - ramp(after, OPEN)
        up = ramp(t, RISE) - ramp(after, LOWER)
        size = wp.float64(RADIUS) * (ramp(t, SHAKE) - ramp(after, STOP))
        angle = wp.float64(2.0 * math.pi * FREQUENCY) * t
        return wp.vec3d(p.stroke * closed, size * wp.cos(angle), wp.float64(LIFT) * up + size * wp.sin(angle))


def gripper(shaking: float) -> wc.Scene:
    """Returns the scene of a part on a table, and two open pads."""
    scene = wc.Scene(gravity=(0.0, 0.0, -GRAVITY))
    table = scene.add_shape(None, wc.shapes.Plane(), name="table")
    part = scene.add_body(MASS, [MASS * SIDE**2 / 6.0] * 3, position=(0, 0, 0.5 * SIDE), name="part")
    scene.add_surface(wc.meshes.box((SIDE,) * 3), part, name="skin", color=(0.8, 0.5, 0.2))
    friction = wc.friction.CundallStrack.from_overshoot(
        mu_static=FRICTION, mu_dynamic=FRICTION, stiffness=STICK_STIFFNESS, mass=0.2 * MASS, overshoot=0.1
    )
    foot = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=5e7, damping=20.0), friction=friction)
    scene.add_body_contact(part, table, foot, name="on_table")
    law = wc.laws.PressureField(modulus=PART_MODULUS, other_modulus=PAD_MODULUS, damping=5.0)
    for name, side in (("left", -1.0), ("right", 1.0)):
        pad = scene.add_body(
            0.1,
            [1e-5] * 3,
            position=(side * (0.5 * SIDE + CLEARANCE + 0.005), 0, 0.5 * SIDE),
            motion=Grip(stroke=0.0, shaking=shaking),
            name=name,
        )
        shape = scene.add_shape(pad, wc.shapes.RoundedBox((0.005, 0.5 * PAD, 0.5 * PAD)), color=(0.3, 0.3, 0.35))
        scene.add_body_contact(part, shape, wc.ContactMaterial(law=law, friction=friction), name=f"{name}_grip")
    return scene


def main(argv: list[str] | None = None) -> dict[str, np.ndarray]:
    parser = argparse.ArgumentParser(description="A gripper lifts, shakes and lays down a part.")
    parser.add_argument(
        "--shaking", type=float, default=10.0, help="time of shaking [s], at least 1 (default: 10)"
    )
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto (default)")
    parser.add_argument("--usd", metavar="FILE", help="write an animation, such as gripper.usdc")
    options = parser.parse_args(argv)
    if not options.shaking >= 1.0:
        parser.error(f"--shaking must be at least 1 s, got {options.shaking:g}")

    model = gripper(options.shaking).build(envs=len(MARGINS), device=options.device, precision="float32")
    grip_force = MARGINS * MASS * (GRAVITY + RADIUS * (2.0 * math.pi * FREQUENCY) ** 2) / (2.0 * FRICTION)
    modulus = PAD_MODULUS * PART_MODULUS / (PAD_MODULUS + PART_MODULUS)
    stroke = CLEARANCE + grip_force / (modulus * PAD**2)
    model["left.motion.stroke"], model["right.motion.stroke"] = stroke, -stroke
    simulation = wc.Simulation(model, DT)
    if warnings := simulation.check():
        raise RuntimeError("; ".join(warnings))
    record = ["part.position", "part.orientation", "left.position", "right.position", "left.orientation"]
    record += ["right.orientation", "left_grip.normal_force", "on_table.normal_force"]
    began = time.perf_counter()
    recording = simulation.run(END + options.shaking, record, every=0.01)
    took = time.perf_counter() - began

    times = recording["time"].values
    pads = 0.5 * (recording["left.position"].values + recording["right.position"].values)
    moved = recording["part.position"].values - pads
    held = (times > float(SHAKE[0])) & (times < float(LOWER[0]) + options.shaking)
    slip = np.abs(moved[held] - moved[held][0])[..., 1:].max(axis=(0, 2))
    result = {
        "margin": MARGINS,
        "grip_force": recording["left_grip.normal_force"].values[held][0] / grip_force - 1.0,
        "slip": slip,
        "place": np.abs(recording["part.position"].values[-1] - recording["part.position"].values[0]).max(axis=1),
        "weight": recording["on_table.normal_force"].values[-1] / (MASS * GRAVITY) - 1.0,
    }
    print("margin   N, N   slip in the gripper   distance from the start")
    for margin, force, one, place in zip(MARGINS, grip_force, slip, result["place"], strict=True):
        print(f"{margin:6.2f} {force:6.2f} {one:18.2e} m {place:22.2e} m")
    print(
        f"{END + options.shaking:g} s, {1e6 * took / simulation.steps:.0f} µs per step of {len(MARGINS)} environments"
    )
    if options.usd:
        print("animation:", wc.export_usd(recording, options.usd, spacing=(0.2, 0.2)))
    return result


if __name__ == "__main__":
    main()
