"""An ellipsoid slides and tumbles in a bowl, a custom parametric surface; without losses, energy is conserved.

Run it with ``python examples/ellipsoid_in_bowl.py``.
"""

from typing import Any

import numpy as np
import warp as wp

import warpcontact as wc

MASS, AXES = 1.0, (0.12, 0.08, 0.06)
STIFFNESS = 1e6


class Bowl(wc.ParametricSurface):
    """z = c (1 − √(1 − (x/a)² − (y/b)²)), the lower part of an ellipsoid, open to the top."""

    semi_axes: tuple[float, float, float] = wc.parameter("m", "semi-axes a, b, c", shape=(3,), above=0.0)

    u_range = (-0.6, 0.6)
    v_range = (-0.6, 0.6)

    @wp.func
    def position(p: Any, u: Any, v: Any):
        """Returns the point of the bowl at x = a u, y = b v."""
        one = wp.float64(1.0)
        height = p.semi_axes[2] * (one - wp.sqrt(one - u * u - v * v))
        return wp.vec3d(p.semi_axes[0] * u, p.semi_axes[1] * v, height)


def energy_kept(duration: float = 1.0) -> float:
    """Returns the largest energy change of a run, relative to the range of potential energy."""
    scene = wc.Scene()
    squares = np.square(AXES)
    inertia = MASS / 5.0 * (squares.sum() - squares)
    start = {"position": (0.3, 0.15, 0.25), "angular_velocity": (1.0, 2.0, 3.0)}
    egg = scene.add_body(MASS, inertia, **start, name="egg")
    hull = scene.add_shape(egg, wc.shapes.Ellipsoid(AXES), name="hull")
    bowl = scene.add_shape(None, Bowl(semi_axes=(1.0, 0.8, 0.7)), name="bowl")
    material = wc.ContactMaterial(law=wc.laws.PowerLaw(stiffness=STIFFNESS, exponent=1.5))
    scene.add_shape_contact(hull, bowl, material, name="touch")
    model = scene.build(1, "cpu", precision="float64")
    sensors = ["egg.kinetic_energy", "egg.potential_energy", "touch.penetration", "touch.converged"]
    recording = wc.Simulation(model, dt=5e-5).run(duration, sensors, every=5e-3)
    if not recording["touch.converged"].all():
        raise RuntimeError("a contact was not found")
    spring = STIFFNESS / 2.5 * recording["touch.penetration"] ** 2.5
    energy = recording["egg.kinetic_energy"] + recording["egg.potential_energy"] + spring
    fallen = float(np.ptp(recording["egg.potential_energy"].values))
    return float(np.abs(energy - energy[0]).max()) / fallen


if __name__ == "__main__":
    print(f"energy changes by at most {energy_kept():.1e} of what was exchanged")
