"""Kernels address arrays with the declared strides."""

import numpy as np
import pytest
import warp as wp
from gpu_schedule_on_cpu import build_all_face_grids
from warpcontact.kernels.lowlevel.static_strides import assume_strides, record_fields

import warpcontact as wc


def arrays_of(struct):
    return {name: one.type for name, one in struct.vars.items() if isinstance(one.type, wp.array)}


def layout_of(instance, declared):
    """Returns address and strides of each array of a struct as seen by a thread, with or without declared strides."""
    struct = instance._cls
    names = arrays_of(struct)
    lines = [
        f"out.data[{3 * k}] = (long long)one.{name}.data;"
        + "".join(f"out.data[{3 * k + 1 + d}] = one.{name}.strides[{d}];" for d in range(own.ndim))
        for k, (name, own) in enumerate(names.items())
    ]

    @wp.func_native("\n".join(lines))
    def report(one: wp.ref[struct], out: wp.array(dtype=wp.int64)): ...

    assume = assume_strides(struct)

    @wp.kernel(module="unique", enable_backward=False)
    def record_layout(one: struct, out: wp.array(dtype=wp.int64)):
        if wp.static(declared):
            assume(one)
        report(one, out)

    out = wp.zeros(3 * len(names), dtype=wp.int64, device="cpu")
    wp.launch(record_layout, 1, [instance, out], device="cpu")
    return dict(zip(names, out.numpy().reshape(-1, 3), strict=True))


def one_sphere(scene, ground):
    ball = scene.add_body(mass=1.0, inertia=(0.1, 0.1, 0.1))
    centre = scene.add_point(ball, (0, 0, 0))
    scene.add_contact(centre, ground, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4)), radius=0.1)


def boxes_with_friction(scene, ground):
    law = wc.laws.KelvinVoigt(stiffness=1e4, damping=10.0)
    material = wc.ContactMaterial(law=law, friction=wc.friction.Tanh(mu=0.3))
    rng = np.random.default_rng(1)
    for number in range(3):
        box = scene.add_body(mass=1.0 + number, inertia=(0.1, 0.2, 0.3))
        scene.add_contact(scene.add_points(box, rng.uniform(-0.1, 0.1, (40, 3))), ground, material)


def no_contacts(scene, _):
    scene.add_body(mass=1.0, inertia=(0.1, 0.1, 0.1))


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("use_face_grids", [False, True])
@pytest.mark.parametrize("fill", [one_sphere, boxes_with_friction, no_contacts])
def test_array_strides_match_the_declared_layout(fill, use_face_grids, precision, monkeypatch):
    if use_face_grids:
        build_all_face_grids(monkeypatch)
    scene = wc.Scene()
    fill(scene, scene.add_surface(wc.meshes.sinusoidal_terrain((2, 2), (10, 10), 0.1, 1.0)))
    model = scene.build(envs=3, device="cpu", precision=precision)
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(2)
    own = model.arrays
    instances = [
        own.model,
        own.state,
        sim._buffers[0].other_state,
        own.history,
        own.contacts,
        own.active_contacts,
        own.cache,
    ]
    instances += [group.coefficients for group in model.groups]
    for instance in instances:
        actual, declared = layout_of(instance, False), layout_of(instance, True)
        for name, kind in arrays_of(instance._cls).items():
            array = getattr(instance, name)
            if array is None or not array.size:
                continue
            key = f"{instance._cls.cls.__name__}.{name}"
            # The stride along an axis with one item is not used.
            leads = [False, False, False]
            leads[0] = True
            leads[1 : 1 + kind.ndim] = [length > 1 for length in array.shape]
            assert actual[name][leads].tolist() == declared[name][leads].tolist(), key


def test_arrays_read_together_are_adjacent_in_memory():
    scene = wc.Scene()
    boxes_with_friction(scene, scene.add_surface(wc.meshes.sinusoidal_terrain((2, 2), (10, 10), 0.1, 1.0)))
    own = scene.build(envs=2, device="cpu").arrays
    for instance, sizes in (
        (own.history, [32]),
        (own.contacts, [96]),
        (own.active_contacts, [64]),
        (own.cache, [64, 64]),
    ):
        lies = layout_of(instance, False)
        for names, size in zip(record_fields(instance._cls), sizes, strict=True):
            begins = [lies[name][0] for name in names]
            assert max(begins) - min(begins) < size
            assert {lies[name][2] for name in names} == {size}
