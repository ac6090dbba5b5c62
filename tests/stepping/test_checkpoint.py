"""Checkpoints: a simulation restored elsewhere continues bitwise identically; invalid files are rejected."""

import numpy as np
import pytest
from scenes import square

import warpcontact as wc
from warpcontact.stepping import checkpoint


def everything(ground_name="ground"):
    """A scene with all kinds of history: friction models, latches, cables, joints, shapes, neighbor lists."""
    scene = wc.Scene()
    ground = scene.add_surface(square(5.0), name=ground_name)
    grip = wc.ContactMaterial(
        law=wc.laws.HuntCrossley(stiffness=1e5, restitution=0.5),
        friction=wc.friction.LuGre(mu_static=0.5, mu_dynamic=0.4, stiffness=1e4, stribeck_speed=0.01),
    )
    ball = scene.add_body(
        mass=1.0, inertia=(4e-3,) * 3, position=(0, 0, 0.15), linear_velocity=(1, 0, 0), name="ball"
    )
    centre = scene.add_point(ball, (0, 0, 0), name="centre")
    scene.add_contact(centre, ground, grip, radius=0.1, name="touch")
    chip = scene.add_body(
        mass=0.1, inertia=(1e-4, 2e-4, 2.5e-4), position=(1, 0, 0.05), angular_velocity=(3, 5, 1), name="chip"
    )
    corners = scene.add_points(chip, np.array(np.meshgrid(*[(-0.05, 0.05)] * 3)).T.reshape(-1, 3), name="corners")
    scene.add_contact(corners, ground, grip, entry="latched", swept=True, name="fall")
    arm = scene.add_body(
        mass=1.0,
        inertia=(0.1, 0.1, 0.1),
        position=(3, 0, 1),
        motion=wc.motions.Hinge(axis=(0, 1, 0), anchor=(2, 0, 1)),
        name="arm",
    )
    hook = scene.add_point(None, (0, 0, 3), name="hook")
    scene.add_spring_damper(hook, scene.add_point(arm, (0, 0, 0)), stiffness=20.0, damping=0.1, name="spring")
    scene.add_catenary(hook, centre, length=4.0, mass_per_length=0.1, axial_stiffness=1e4, name="cable")
    egg = scene.add_body(mass=0.1, inertia=(1e-4,) * 3, position=(-1, 0, 0.09), name="egg")
    shell = scene.add_shape(egg, wc.shapes.Ellipsoid((0.12, 0.1, 0.08)), name="shell")
    plate = scene.add_shape(None, wc.shapes.Plane(), name="plate")
    scene.add_shape_contact(shell, plate, grip, name="tap")
    places = np.random.default_rng(0).uniform((-0.2, 2.8, -0.2), (0.2, 3.2, 0.2), (40, 3))
    grains = scene.add_bodies(places, mass=1e-2, inertia=(4e-7,) * 3, name="grains")
    scene.add_particle_contact(scene.add_shape(grains, wc.shapes.Sphere(0.05)), grip, name="pile")
    return scene


def nonsmooth_scene():
    scene = wc.Scene()
    ground = scene.add_surface(square(5.0), name="ground")
    box = scene.add_body(
        mass=1.0, inertia=(4e-3,) * 3, position=(0, 0, 0.11), angular_velocity=(2, 1, 0), name="box"
    )
    corners = np.array(np.meshgrid(*[(-0.1, 0.1)] * 3)).T.reshape(-1, 3)
    rigid = wc.ContactMaterial(law=wc.laws.Rigid(restitution=0.3), friction=wc.friction.Coulomb(mu=0.4))
    scene.add_contact(scene.add_points(box, corners, name="corners"), ground, rigid, name="feet")
    return scene


CASES = {
    "forces": (everything, {"dt": 5e-4, "crossing_substeps": 3}),
    "launches": (everything, {"dt": 5e-4, "capture_graphs": False}),
    "impulses": (nonsmooth_scene, {"dt": 1e-3, "integrator": wc.integrators.MoreauJean(theta=0.5)}),
}


def simulation(case, device, envs=3, **changes):
    make, options = CASES[case]
    model = make().build(envs=envs, device=device)
    body = model.scene.bodies[0].name
    model[f"{body}.linear_velocity"] = np.linspace((0.5, 0, -1), (1, 0, -2), envs)
    return wc.Simulation(model, deterministic=True, **(options | changes))


def state_bytes(sim):
    """Bytes of state and history. Caches are excluded, because they may differ without changing results."""
    return {name: values.tobytes() for name, values in checkpoint.state_of(sim).items()}


def sensors(sim):
    """All sensors, computed from state and history."""
    return {name: sim.model.sensor(name).tobytes() for name in sim.model.sensor_names if "_by_" not in name}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("devices", ["one", "two"])
def test_simulation_loaded_from_checkpoint_continues_bitwise_identically(case, devices, device, tmp_path):
    where = device if devices == "one" else [device, device]
    sim = simulation(case, where)
    sim.step(37)
    sim.save(tmp_path / "state.npz")
    before = state_bytes(sim)
    sim.step(50)
    other = simulation(case, where)
    other.step(3)
    other.load(tmp_path / "state.npz")
    assert state_bytes(other) == before
    assert other.steps == 37
    other.step(50)
    assert state_bytes(other) == state_bytes(sim)
    if devices == "one":
        assert sensors(other) == sensors(sim)
    # Saving does not change the simulation, and an earlier state can be loaded.
    sim.load(tmp_path / "state.npz")
    assert state_bytes(sim) == before


def test_checkpoint_restores_parameters(device, tmp_path):
    sim = simulation("forces", device)
    sim.model["ball.mass"] = [1.0, 2.0, 3.0]
    sim.model["touch.law.stiffness"] = 2e5
    sim.model.external.force.assign(np.ones((3, sim.model.body_count, 3), np.float32))
    sim.step(20)
    sim.save(tmp_path / "state.npz")
    sim.step(20)
    other = simulation("forces", device)
    other.model["chip.mass"] = [0.2, 0.3, 0.4]
    other.load(tmp_path / "state.npz")
    for name in sim.model:
        np.testing.assert_array_equal(other.model[name], sim.model[name], err_msg=name)
    other.step(20)
    assert state_bytes(other) == state_bytes(sim)


def test_unstepped_model_loaded_from_checkpoint_still_follows_its_parameters(device, tmp_path):
    sim = simulation("impulses", device)
    sim.save(tmp_path / "start.npz")
    other = simulation("impulses", device)
    other.step(5)
    other.load(tmp_path / "start.npz")
    other.model["box.position"] = (0, 0, 2.0)
    assert other.model.sensor("box.position")[:, 2].tolist() == [2.0] * 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dt": 1e-3}, r"dt: 0\.0005 in the file, 0\.001 in the simulation"),
        ({"crossing_substeps": 2}, "crossing_substeps: 3 in the file, 2 in the simulation"),
        ({"envs": 4}, r"envs: \[3\] in the file, \[4\] in the simulation"),
    ],
)
def test_checkpoint_of_another_simulation_is_refused_without_changes(changes, message, device, tmp_path):
    sim = simulation("forces", device)
    sim.step(3)
    sim.save(tmp_path / "state.npz")
    other = simulation("forces", device, **changes)
    before = state_bytes(other)
    with pytest.raises(wc.CheckpointError, match=f"state.npz: is of another simulation: {message}"):
        other.load(tmp_path / "state.npz")
    assert state_bytes(other) == before


def test_checkpoint_of_another_scene_is_refused_with_the_difference(device, tmp_path):
    sim = simulation("forces", device)
    sim.save(tmp_path / "state.npz")
    with pytest.raises(wc.CheckpointError, match=r"another simulation: .*integrator|dt"):
        simulation("impulses", device).load(tmp_path / "state.npz")
    other = wc.Simulation(everything("floor").build(envs=3, device=device), 5e-4, crossing_substeps=3)
    with pytest.raises(wc.CheckpointError, match=r"parameters: the file has 'ground\.\w+' and has no 'floor"):
        other.load(tmp_path / "state.npz")


def test_damaged_checkpoint_is_refused(device, tmp_path):
    sim = simulation("impulses", device)
    path = tmp_path / "state.npz"
    sim.save(path)
    whole = path.read_bytes()
    before = state_bytes(sim)
    rng = np.random.default_rng(0)
    # After the directory at the end of the file, only the data it refers to are checked.
    for place in rng.integers(200, len(whole) * 3 // 4, 20):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x41]) + whole[place + 1 :])
        try:
            sim.load(path)
        except wc.CheckpointError:
            continue
        assert state_bytes(sim) == before  # a byte between two arrays
    for length in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(wc.CheckpointError, match="is no complete checkpoint"):
            sim.load(path)
    for text in ("not a checkpoint", "import numpy\n", ""):
        path.write_text(text)
        with pytest.raises(wc.CheckpointError, match=r"is no complete checkpoint: it is no \.npz file") as caught:
            sim.load(path)
        assert "pickle" not in str(caught.value)
    np.savez(path, header=np.array([{}], dtype=object))
    with pytest.raises(
        wc.CheckpointError, match="is no complete checkpoint: Object arrays cannot be loaded"
    ) as caught:
        sim.load(path)
    assert "pickle" not in str(caught.value)
    with pytest.raises(FileNotFoundError):
        sim.load(tmp_path / "none.npz")


def test_checkpoint_of_later_schema_is_refused(device, tmp_path):
    checkpoint.write(tmp_path / "state.npz", {}, {"schema": 99})
    with pytest.raises(wc.CheckpointError, match=r"schema 99, .*this version reads schema 5"):
        simulation("impulses", device).load(tmp_path / "state.npz")


def test_checkpoint_write_is_atomic(device, tmp_path, monkeypatch):
    sim = simulation("impulses", device)
    path = tmp_path / "state.npz"
    sim.save(path)
    before = path.read_bytes()

    def fails(*_, **__):
        raise OSError("No space left on device")

    monkeypatch.setattr(np, "savez", fails)
    sim.step()
    with pytest.raises(OSError, match="No space"):
        sim.save(path)
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == ["state.npz"]


@pytest.mark.parametrize(
    "watched",
    [
        {"outcomes": {"far": wc.outcomes.Max("box.position", component="x")}},
        {"outcomes": {"far": wc.outcomes.Min("box.position", component="z")}},
        {"outcomes": {"high": wc.outcomes.Max("box.position", component="z")}},
        {"quarantine": "reset"},
    ],
)
def test_checkpoint_with_other_monitors_is_refused(watched, device, tmp_path):
    given = {"outcomes": {"far": wc.outcomes.Max("box.position", component="z")}}
    sim = simulation("impulses", device, **given)
    sim.step(5)
    sim.save(tmp_path / "state.npz")
    again = simulation("impulses", device, **given)
    again.load(tmp_path / "state.npz")
    assert again.outcomes().identical(sim.outcomes())
    with pytest.raises(
        wc.CheckpointError, match=r"another simulation: watched: the file has .(far: Max|quarantine: fr)"
    ):
        simulation("impulses", device, **(given | watched)).load(tmp_path / "state.npz")
