"""Faceted bodies: continuity across edges and vertices, and convergence to the smooth body with finer facets."""

import numpy as np
import pytest
from scenes import dropped_sphere, probe

import warpcontact as wc

STIFFNESS = 1e4
CONVEX = {
    "cube": wc.meshes.box,
    "tetrahedron": lambda: wc.Mesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    ),
    "faceted ball": lambda: wc.meshes.icosphere(0.6, 2),
}


# Half an epsilon per coordinate of order one, at both ends of a step.
@pytest.mark.parametrize(("precision", "exact"), [("float32", 1e-6), ("float64", 2e-15)])
@pytest.mark.parametrize("body", CONVEX)
def test_gap_and_force_are_continuous_while_sphere_rolls_over_edges_and_vertices(body, precision, exact, device):
    mesh, radius = CONVEX[body](), 0.3
    rng = np.random.default_rng(8)
    # Paths through the layer around the body where a sphere is in contact with its center outside: along edges,
    # across edges, and over vertices.
    corners = mesh.vertices[rng.integers(len(mesh.vertices), size=(30, 2))]
    away = corners - mesh.vertices.mean(axis=0)
    ends = corners + away * rng.uniform(0.1, 0.5, (30, 2, 1)) + rng.normal(size=(30, 2, 3)) * 0.1
    steps = np.linspace(0.0, 1.0, 1001)[None, :, None]
    paths = ends[:, :1] + steps * (ends[:, 1:] - ends[:, :1])
    points = paths.reshape(-1, 3).astype(precision).astype(np.float64)
    spring = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=STIFFNESS))
    sensors = probe(mesh, points, radius=radius, material=spring, precision=precision, device=device)
    gap, force = (sensors[name].astype(np.float64).reshape(30, 1001) for name in ("gap", "normal_force"))
    normal = sensors["normal"].astype(np.float64).reshape(30, 1001, 3)
    moved = np.linalg.norm(np.diff(points.reshape(30, 1001, 3), axis=1), axis=2)
    assert (np.abs(np.diff(gap, axis=1)) <= moved + exact).all()

    # At distance d outside a convex body, the normal turns by at most |Δp|/d.
    distance = gap + radius
    outside = np.minimum(distance[:, 1:], distance[:, :-1])
    touching = (outside > 0.02) & (np.minimum(gap[:, 1:], gap[:, :-1]) < 0)
    assert touching.sum() > 2000
    turned = np.linalg.norm(np.diff(normal, axis=1), axis=2)
    assert (turned[touching] <= ((moved + 2 * exact) / outside)[touching]).all()
    change = np.linalg.norm(np.diff(force[..., None] * normal, axis=1), axis=2)
    bound = STIFFNESS * (moved + 2 * exact) * (1 + radius / np.maximum(outside, 0.02))
    assert (change[touching] <= bound[touching]).all()


def directions(count, seed=3):
    x = np.random.default_rng(seed).normal(size=(count, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def orders(errors):
    """Order of convergence per halving of the facets."""
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


def test_gap_and_force_on_faceted_sphere_converge_at_second_order(device):
    """A sphere of radius 0.2 in a sphere of radius 1.0, penetration 20 mm: the force is that of two spheres."""
    radius, depth = 0.2, 0.02
    points = (1.0 + radius - depth) * directions(2000)
    spring = wc.ContactMaterial(law=wc.laws.Hertz(stiffness=1e6))
    gaps, forces = [], []
    for level in (1, 2, 3, 4, 5):
        sensors = probe(
            wc.meshes.icosphere(1.0, level), points, radius=radius, material=spring, precision="float64",
            device=device,
        )  # fmt: skip
        gaps.append(np.abs(sensors["gap"] + depth).max())
        forces.append(np.abs(sensors["normal_force"] - 1e6 * depth**1.5).max() / (1e6 * depth**1.5))
    # The center of a facet with edge length h is up to h²/6 inside the sphere of radius 1.
    assert gaps[-1] < 0.04**2 / 4
    assert (orders(gaps)[1:] > 1.9).all()
    assert (orders(forces)[2:] > 1.9).all()


def test_bounce_on_faceted_sphere_converges_at_second_order(device):
    """Duration, rebound height and speed of a central impact equal those on a plane."""
    radius, speed, dt, steps = 0.2, 1.0, 2e-4, 400
    law = wc.laws.HuntCrossley(stiffness=1e5, exponent=1.5, restitution=0.7)

    def impact(model):
        """Returns height and speed at the end, and the duration of contact to a fraction of a step, from the
        force.
        """
        sim = wc.Simulation(model, dt=dt)
        impulse, lasted = np.zeros(model.envs), np.zeros(model.envs)
        for _ in range(steps):
            force = model.sensor("touch.normal_force")
            impulse += force * dt
            lasted += force**2 * dt
            sim.step()
        # Duration of a pulse of known shape: squared impulse over the integral of the squared force.
        return impulse**2 / lasted

    plane = dropped_sphere(
        law, radius=radius, height=0.01, velocity=(0, 0, -speed), precision="float64", device=device
    )
    duration = impact(plane)[0]
    height = plane.sensor("ball.position")[0, 2] - radius
    rebound = plane.sensor("ball.linear_velocity")[0, 2]
    assert 0.5 < rebound < 0.8
    aims = directions(64)
    errors = []
    for level in (1, 2, 3, 4):
        scene = wc.Scene(gravity=(0, 0, 0))
        surface = scene.add_surface(wc.meshes.icosphere(1.0, level))
        ball = scene.add_body(1.0, [0.4 * radius**2] * 3, name="ball")
        scene.add_contact(
            scene.add_point(ball, (0, 0, 0)), surface, wc.ContactMaterial(law=law), radius=radius, name="touch"
        )
        model = scene.build(envs=len(aims), precision="float64", device=device)
        model["ball.position"] = (1.0 + radius + 0.01) * aims
        model["ball.linear_velocity"] = -speed * aims
        lasted = impact(model)
        out = np.einsum("ni,ni->n", model.sensor("ball.position"), aims) - 1.0 - radius
        fast = np.linalg.norm(model.sensor("ball.linear_velocity"), axis=1)
        errors.append([np.abs(x).mean() for x in (lasted / duration - 1, out - height, fast - rebound)])
    order = orders(errors)
    assert (order[1:] > 1.8).all(), order
