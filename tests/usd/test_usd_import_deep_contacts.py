"""A remark on body contacts that are deep under the weight of a heavy body, with a stiffness from the duration of an impact."""

import re

import pytest
from physics_stages import prim, stage
from rest_stages import FLOOR, sunk

import warpcontact as wc

SIDE = 0.2
APIS = 'prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI"]'


def stack(tmp_path, light, heavy, **metadata):
    """A cube of the mass ``heavy`` on one of the mass ``light``, on a floor [kg]."""
    cubes = [
        prim(
            "Cube",
            name,
            APIS,
            f"double size = {SIDE}\nfloat physics:mass = {mass}\ndouble3 xformOp:translate = (0, 0, {height})\n"
            'uniform token[] xformOpOrder = ["xformOp:translate"]',
        )
        for name, mass, height in (("light", light, SIDE / 2), ("heavy", heavy, 1.5 * SIDE))
    ]
    return stage(tmp_path, FLOOR + "".join(cubes), **metadata)


def remarks(scene):
    return [one for one in scene.import_warnings if "deep" in one]


@pytest.mark.parametrize(("heavy", "is_deep"), [(1.5, False), (19.0, False), (22.0, True)])
def test_contact_that_is_deeper_than_a_hundredth_of_a_body_is_reported(tmp_path, heavy, is_deep):
    """The pair has the depth N/k with k = m (π/T)² of its effective mass m, and the load of the heavy cube."""
    scene = wc.Scene.from_usd(stack(tmp_path, 1.0, heavy), trusted=True)
    depth = sunk(heavy, 1.0, heavy)
    assert (depth > 0.01 * SIDE) == is_deep
    assert len(remarks(scene)) == is_deep
    if is_deep:
        assert f"is {depth:.2g} m deep under the weight of 22 kg, {100 * depth / SIDE:.2g} %" in remarks(scene)[0]


def test_recommended_contact_time_keeps_contacts_shallow(tmp_path):
    """Two cubes of 40 kg and 1 kg: measured depths, before and after."""
    path = stack(tmp_path, 1.0, 40.0)
    depths = []
    scene, duration = wc.Scene.from_usd(path, trusted=True), 0.01
    for _ in range(2):
        model = scene.build(device="cpu", precision="float64")
        wc.Simulation(model, dt=duration / 50).step(5000)
        (pair,) = (one for one in scene.body_contacts if "light" in one.name and "heavy" in one.name)
        depths.append(float(model.sensor(f"{pair.name}.depth").max()))
        if found := remarks(scene):
            duration = float(re.search(r"contact_time ≤ (\S+) s", found[0]).group(1))
            scene = wc.Scene.from_usd(path, trusted=True, contact_time=0.99 * duration)
    assert depths[0] == pytest.approx(sunk(40.0, 1.0, 40.0), rel=0.01)
    assert depths[1] < 0.0101 * SIDE
    assert remarks(scene) == []


def test_depth_is_compared_with_the_smaller_body(tmp_path):
    """A cube of 4 mm sinks by 0.1 mm under its own weight, more than a hundredth of its size, for any mass."""
    tiny = stack(tmp_path, 1.0, 1.0, metres=0.02)
    (text,) = remarks(wc.Scene.from_usd(tiny, trusted=True))
    # Each cube on the floor: one weight. Cube on cube: two of them.
    assert text.startswith("3 contacts are deep if they are compliant")
    assert f"{100 * sunk(1.0, 1.0, 1.0) / (0.02 * SIDE):.2g} % of the size" in text
    assert remarks(wc.Scene.from_usd(tiny, trusted=True, contact_time=1e-3)) == []
    weightless = prim("PhysicsScene", "scene", "", "float physics:gravityMagnitude = 0")
    path = stage(tmp_path, tiny.read_text().split(")\n", 1)[1] + weightless, metres=0.02)
    assert remarks(wc.Scene.from_usd(path, trusted=True)) == []
