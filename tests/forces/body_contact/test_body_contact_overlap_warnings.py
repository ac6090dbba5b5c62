"""Warnings about bodies that start in overlap in compliant body contact."""

import numpy as np
import pytest

import warpcontact as wc

MASS, SIDE, MODULUS = 2.0, 0.1, 1e7
STIFFNESS = MODULUS * SIDE**2


def overlapping(depth, *, law=None, free=False, mesh=False):
    """A cube that is ``depth`` deep [m] in a block, or in a free cube, without gravity."""
    scene = wc.Scene(gravity=(0, 0, 0))
    solids = []
    for name, height, moves in (("below", -SIDE / 2, free), ("cube", SIDE / 2 - depth, True)):
        body = None
        if moves:
            body = scene.add_body(mass=MASS, inertia=[MASS * SIDE**2 / 6] * 3, position=(0, 0, height), name=name)
        pose = {} if moves else {"position": (0, 0, height)}
        if mesh:
            solids.append(scene.add_surface(wc.meshes.box((SIDE,) * 3), body, **pose))
        else:
            solids.append(scene.add_shape(body, wc.shapes.RoundedBox((SIDE / 2,) * 3), **pose))
    law = law or wc.laws.ElasticFoundation(stiffness=MODULUS)
    scene.add_body_contact(solids[1], solids[0], wc.ContactMaterial(law=law), name="press")
    return scene.build(device="cpu", precision="float64")


def warned_speed(model):
    """Returns the ejection speed of a warning [m/s]; ``None``: there is no warning."""
    found = [one for one in wc.Simulation(model, dt=1e-5).check() if "eject" in one]
    assert len(found) <= 1
    return float(found[0].split("at about ")[1].split(" m/s")[0]) if found else None


@pytest.mark.parametrize("mesh", [False, True], ids=["box", "mesh"])
@pytest.mark.parametrize("free", [False, True], ids=["fixed", "free"])
def test_warning_has_the_speed_of_the_ejected_body(free, mesh):
    """½ k δ² becomes kinetic energy of one body, or of two."""
    model = overlapping(0.02, free=free, mesh=mesh)
    expected = 0.02 * np.sqrt(STIFFNESS / MASS / (1 + free))
    assert warned_speed(model) == pytest.approx(expected, rel=1e-2)
    wc.Simulation(model, dt=1e-5).step(4000)
    assert model.sensor("cube.linear_velocity")[0, 2] == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize(
    ("depth", "law"),
    [
        (0.008, None),
        # Most of the energy is lost.
        (0.02, wc.laws.KelvinVoigt(stiffness=STIFFNESS, restitution=0.1)),
        (0.02, wc.laws.KelvinVoigt(stiffness=STIFFNESS, damping=2 * np.sqrt(STIFFNESS * MASS))),
    ],
    ids=["shallow", "restitution", "damping"],
)
def test_slow_bodies_are_not_reported(depth, law):
    assert warned_speed(overlapping(depth, law=law)) is None


def test_solids_whose_boxes_overlap_are_not_reported():
    """Two upright cylinders side by side, in a diagonal."""
    scene = wc.Scene(gravity=(0, 0, 0))
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e9))
    shapes = []
    for i in (0, 1):
        body = scene.add_body(mass=MASS, inertia=[1e-3] * 3, position=(0.15 * i, 0.15 * i, 0))
        shapes.append(scene.add_shape(body, wc.shapes.Cylinder(0.1, 0.2)))
    scene.add_body_contact(*shapes, material)
    model = scene.build(device="cpu", precision="float64")
    assert warned_speed(model) is None
