"""Motion with friction: stiction, sliding, stick–slip and presliding against closed forms and ODEs."""

import numpy as np
import pytest
from scenes import square
from scipy.integrate import solve_ivp

import warpcontact as wc

F = wc.friction
G = 9.81
LOAD = 1e5  # N/m, of the plate


def resting_block(
    friction, *, gravity=(0.0, 0.0, -G), speed=0.0, envs=1, device="cpu", precision="float64", **scene
):
    """A 1 kg point without rotation, in equilibrium on a plate under the normal weight, sliding along x.

    ``springs``: linear springs of that stiffness to x = 0; ``wall``: a spring whose end moves at that speed.
    """
    made = wc.Scene(gravity=gravity)
    plate = made.add_surface(square(50.0), name="plate")
    block = made.add_body(
        1.0, (1e6, 1e6, 1e6), position=(0, 0, gravity[2] / LOAD), linear_velocity=(speed, 0, 0), name="block"
    )
    point = made.add_point(block, (0, 0, 0))
    law = wc.laws.Hooke(stiffness=LOAD)
    made.add_contact(point, plate, wc.ContactMaterial(law=law, friction=friction), name="touch")
    if "springs" in scene:
        spring = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=scene["springs"]))
        # A compliant wall on either side of x = 0 replaces the springs.
        for turn in (-np.sqrt(0.5), np.sqrt(0.5)):
            wall = made.add_surface(square(50.0), orientation=(0, turn, 0, np.sqrt(0.5)))
            made.add_contact(point, wall, spring)
    if "wall" in scene:
        stiffness, wall_speed = scene["wall"]
        carrier = made.add_body(1e9, (1e9, 1e9, 1e9), linear_velocity=(wall_speed, 0, 0), name="wall")
        wall = made.add_surface(square(500.0), carrier, orientation=(0, -np.sqrt(0.5), 0, np.sqrt(0.5)))
        made.add_contact(point, wall, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=stiffness)))
    return made.build(envs=envs, device=device, precision=precision)


def place(model):
    return model.sensor("block.position")[:, 0]


STICKING = [
    F.CundallStrack(mu_static=0.3, mu_dynamic=0.3, stiffness=1e5, damping=500.0),
    F.LuGre(mu_static=0.3, mu_dynamic=0.3, stribeck_speed=0.01, stiffness=1e4, damping=50.0),
]


def name_of(friction):
    return type(friction).__name__


@pytest.mark.parametrize("precision", ["float32", "float64"])
# Bristle models settle slowly near their limit.
@pytest.mark.parametrize(("friction", "steepest"), list(zip(STICKING, (16.65, 15.0), strict=True)))
def test_block_sticks_below_friction_angle_and_slides_above(friction, steepest, precision, device):
    # FORCE_LAWS G8: stick limit arctan 0.3 = 16.69924°.
    angles = np.radians([5.0, steepest, 16.75, 30.0])
    model = resting_block(friction, envs=4, device=device, precision=precision)
    model["scene.gravity"] = G * np.column_stack([np.sin(angles), 0 * angles, -np.cos(angles)])
    model["block.position"] = np.column_stack([0 * angles, 0 * angles, -G * np.cos(angles) / LOAD])
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(5000)
    path, speed = place(model), model.sensor("block.linear_velocity")[:, 0]
    sim.step(5000)
    # At rest; near the limit after the small slip of a sudden load. A spring ignores displacements per step below
    # half a rounding of its stretch, here at most 3e-5 m.
    unfelt = {"float32": 5000 * 0.5 * np.spacing(np.float32(3e-5)), "float64": 1e-12}[precision]
    np.testing.assert_allclose(place(model)[:2], path[:2], rtol=1e-6, atol=unfelt)
    assert (path[:2] < 2e-3).all()
    if isinstance(friction, F.CundallStrack):
        np.testing.assert_allclose(path[0], G * np.sin(angles[0]) / 1e5, rtol=1e-3)
    # Sliding at the acceleration of G8, at 30° 2.356287237 m/s².
    acceleration = (model.sensor("block.linear_velocity")[:, 0] - speed)[2:] / 0.5
    np.testing.assert_allclose(
        acceleration, [G * (np.sin(angles[2]) - 0.3 * np.cos(angles[2])), 2.356287237], rtol=2e-4
    )


@pytest.mark.parametrize("friction", STICKING, ids=name_of)
def test_sliding_block_stops_and_remains_at_rest(friction, device):
    # FORCE_LAWS G8: from 2 m/s on level ground, it stops after 0.6795786612 s and 0.6795786612 m.
    model = resting_block(friction, speed=2.0, device=device)
    sim = wc.Simulation(model, dt=1e-4)
    recording = sim.run(0.7, ["block.linear_velocity"], every=1e-4)
    speed = recording["block.linear_velocity"].sel(axis="x", env=0)
    nearly = float(speed.time[np.argmax(speed.values < 0.1)])
    np.testing.assert_allclose(nearly, 0.95 * 0.6795786612, atol=2e-4)
    # Up to the stretch of the springs, 3e-5 m.
    np.testing.assert_allclose(place(model), 0.6795786612, rtol=3e-4)
    sim.step(2000)
    rest = place(model)
    sim.step(3000)
    np.testing.assert_allclose(place(model), rest, rtol=1e-7)


def test_block_thrown_up_a_slope_returns_slower(device):
    # FORCE_LAWS G8: 3 m/s up 30°: 0.6037259743 m, back at 1.686743494 m/s.
    slope = np.radians(30.0)
    model = resting_block(
        STICKING[0], gravity=(-G * np.sin(slope), 0, -G * np.cos(slope)), speed=3.0, device=device
    )
    recording = wc.Simulation(model, dt=1e-4).run(1.3, ["block.linear_velocity"], every=1e-4)
    path = recording["block.position"].sel(axis="x", env=0).values
    speed = recording["block.linear_velocity"].sel(axis="x", env=0).values
    np.testing.assert_allclose(path.max(), 0.6037259743, rtol=5e-4)
    back = np.argmax((np.arange(len(path)) > path.argmax()) & (path < 0.0))
    np.testing.assert_allclose(-speed[back], 1.686743494, rtol=5e-4)


def test_stick_spring_oscillates_until_it_slides(device):
    # FORCE_LAWS G23: m = 1, μ = 0.5, k_t = 1e5: 50.3292121 Hz; slips at 4.905e-5 m, for speeds above 0.01551097192
    # m/s.
    speeds = 0.01551097192 * np.array([0.5, 0.999, 1.001, 1.2])
    friction = F.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=1e5)
    model = resting_block(friction, envs=4, device=device)
    model["block.linear_velocity"] = np.column_stack([speeds, 0 * speeds, 0 * speeds])
    period, dt = 1 / 50.3292121, 1 / 50.3292121 / 4000
    recording = wc.Simulation(model, dt=dt).run(3 * period, ["touch.friction_force"], every=dt)
    path = recording["block.position"].sel(axis="x").values
    force = recording["touch.friction_force"].sel(axis="x").values
    # Symplectic scheme: amplitude to dt ω/2 = 8e-4, and period to (dt ω)²/24.
    np.testing.assert_allclose(path[:, :2].max(axis=0), speeds[:2] / np.sqrt(1e5), rtol=1e-3)
    np.testing.assert_allclose(path[4000, :2], 0.0, atol=1e-3 * 4.905e-5)
    assert np.abs(force).max() <= 0.5 * G * (1 + 1e-9)
    # The center of the later oscillation shows whether slip occurred.
    middle = 0.5 * (path[4000:].max(axis=0) + path[4000:].min(axis=0))
    np.testing.assert_allclose(middle[:2], 0.0, atol=1e-3 * 4.905e-5)
    # The remaining energy at the first slip is dissipated by sliding: x = (½ m v² − ½ k ξ²)/(μ N).
    slid = (0.5 * speeds**2 - 0.5 * 1e5 * 4.905e-5**2)[2:] / (0.5 * G)
    np.testing.assert_allclose(middle[2:], slid, atol=2e-3 * 4.905e-5)


@pytest.mark.parametrize("friction", STICKING, ids=name_of)
def test_oscillator_with_dry_friction_matches_closed_form_turning_points(friction, device):
    # FORCE_LAWS G20 with μ N = 0.981 N: the amplitude falls by 2 μ N/k every half period.
    friction = {F.CundallStrack: F.CundallStrack(mu_static=0.1, mu_dynamic=0.1, stiffness=1e5, damping=100.0)}.get(
        type(friction), F.LuGre(mu_static=0.1, mu_dynamic=0.1, stribeck_speed=0.01, stiffness=1e5, damping=50.0)
    )
    model = resting_block(friction, device=device, springs=100.0)
    model["block.position"] = (0.1, 0.0, -G / LOAD)
    recording = wc.Simulation(model, dt=5e-5).run(2.0, every=5e-5)
    path = recording["block.position"].sel(axis="x", env=0)
    turns = [float(path.sel(time=k * np.pi / 10, method="nearest")) for k in range(6)]
    # Presliding displaces the turning points by μ N/k_t = 1e-5 m, and the first-order scheme by as much.
    np.testing.assert_allclose(turns, [0.1, -0.08038, 0.06076, -0.04114, 0.02152, -0.0019], atol=5e-5)
    np.testing.assert_allclose(path[-1], -0.0019, atol=5e-5)


def test_stick_slip_on_belt_matches_closed_form(device):
    # FORCE_LAWS G19: m = 1, k = 100, belt 0.1 m/s, F_s = 5, F_k = 3. In the frame of the belt, the end of the
    # spring moves.
    friction = F.CundallStrack(mu_static=5 / G, mu_dynamic=3 / G, stiffness=1e6, damping=1500.0)
    model = resting_block(friction, device=device, wall=(100.0, -0.1))
    recording = wc.Simulation(model, dt=5e-5).run(4.0, ["block.linear_velocity", "wall.position"], every=1e-4)
    stretch = (recording["block.position"] - recording["wall.position"]).sel(axis="x", env=0).values
    sliding = np.abs(recording["block.linear_velocity"].sel(axis="x", env=0).values) > 1e-3
    starts = np.flatnonzero(np.diff(sliding.astype(int)) == 1)
    ends = np.flatnonzero(np.diff(sliding.astype(int)) == -1)
    assert len(starts) >= 4
    slip = 1e-4 * (ends[:4] - starts[:4])
    stick = 1e-4 * (starts[1:4] - ends[:3])
    # Slip is detected with a delay, when its speed exceeds 1 mm/s.
    np.testing.assert_allclose(slip, 0.4068887872, rtol=5e-3)
    np.testing.assert_allclose(stick, 0.4, rtol=5e-3)
    np.testing.assert_allclose(stretch.max(), 0.05236067977, rtol=1e-3)


def belt_of(friction, device, duration, dt):
    model = resting_block(friction, device=device, wall=(100.0, -0.1))
    recording = wc.Simulation(model, dt=dt).run(duration, ["block.linear_velocity"], every=1e-2)
    return recording.time.values, recording["block.position"].sel(axis="x", env=0).values


def test_stick_slip_with_lugre_matches_integrated_equations(device):
    s0, s1, vs, ms, md = 5e3, 8.0, 0.02, 0.5, 0.3
    friction = F.LuGre(mu_static=ms, mu_dynamic=md, stribeck_speed=vs, stiffness=s0, damping=s1, viscosity=0.4)

    def rates(t, y):
        x, v, z = y
        rate = v - s0 * abs(v) * z / (md + (ms - md) * np.exp(-((v / vs) ** 2)))
        spring = -100.0 * max(x + 0.1 * t, 0.0)
        return v, spring - G * (s0 * z + s1 * rate) - 0.4 * v, rate

    times, path = belt_of(friction, device, 2.0, 1e-5)
    exact = solve_ivp(rates, (0, 2.0), (0, 0, 0), "LSODA", times, rtol=1e-9, atol=1e-12).y[0]
    assert np.ptp(np.diff(exact)) > 2e-3  # stick and slip alternate
    # First order in dt: halving dt halves the error.
    _, coarse = belt_of(friction, device, 2.0, 2e-5)
    assert np.abs(path - exact).max() < 2e-4 * np.abs(exact).max()
    np.testing.assert_allclose(np.abs(path - exact).max() / np.abs(coarse - exact).max(), 0.5, atol=0.05)


def test_stick_slip_with_stribeck_matches_integrated_equations(device):
    ms, md, vs, scale = 0.5, 0.3, 0.05, 0.002
    friction = F.Stribeck(mu_static=ms, mu_dynamic=md, stribeck_speed=vs, velocity_scale=scale)

    def rates(t, y):
        x, v = y
        mu = (md + (ms - md) * np.exp(-((v / vs) ** 2))) * np.tanh(v / scale)
        return v, -100.0 * max(x + 0.1 * t, 0.0) - G * mu

    times, path = belt_of(friction, device, 2.0, 1e-5)
    exact = solve_ivp(rates, (0, 2.0), (0, 0), "LSODA", times, rtol=1e-9, atol=1e-12).y[0]
    assert np.ptp(np.diff(exact)) > 2e-3
    _, coarse = belt_of(friction, device, 2.0, 2e-5)
    assert np.abs(path - exact).max() < 2e-4 * np.abs(exact).max()
    np.testing.assert_allclose(np.abs(path - exact).max() / np.abs(coarse - exact).max(), 0.5, atol=0.05)


def test_block_slowed_by_tanh_friction_matches_closed_form(device):
    # SPEC 5: v(t) = asinh(sinh(k_t v₀) e^(−μ g k_t t))/k_t; μ = 0.4, k_t = 200 s/m, v₀ = 0.5 m/s.
    friction = F.Tanh(mu=0.4, velocity_scale=1 / 200)
    model = resting_block(friction, speed=0.5, device=device)
    recording = wc.Simulation(model, dt=1e-5).run(0.12, ["block.linear_velocity"], every=1e-2)
    speed = recording["block.linear_velocity"].sel(axis="x", env=0)
    # Explicit scheme: the error is below the change in a step, 4e-5 m/s.
    np.testing.assert_allclose(speed.sel(time=0.05, method="nearest"), 0.3038, atol=5e-5)
    np.testing.assert_allclose(speed.sel(time=0.12, method="nearest"), 0.029120044, atol=5e-5)


def test_creep_speed_with_tanh_friction_matches_closed_form(device):
    # SPEC 5: μ = 0.4, k_t = 200 s/m, 15°: artanh(tan θ/μ)/k_t = 0.004052563 m/s.
    slope = np.radians(15.0)
    gravity = (G * np.sin(slope), 0, -G * np.cos(slope))
    model = resting_block(F.Tanh(mu=0.4, velocity_scale=1 / 200), gravity=gravity, device=device)
    wc.Simulation(model, dt=1e-4).step(5000)
    np.testing.assert_allclose(model.sensor("block.linear_velocity")[0, 0], 0.004052563, rtol=1e-6)


def test_elliptic_friction_conserves_its_invariant(device):
    # FORCE_LAWS G26: μ = (0.4, 0.2), v = (1, 1): v₁ = 0.0625 when v₂ = 0.5, at 0.3615177588 s. The surface is
    # rotated by 30°, and axis 1 by another 20° relative to it.
    turn, extra = np.radians(30.0), np.radians(20.0)
    axis_1 = np.array([np.cos(turn + extra), np.sin(turn + extra), 0.0])
    axis_2 = np.array([-axis_1[1], axis_1[0], 0.0])
    friction = F.Elliptic(mu_1=0.4, mu_2=0.2, angle=extra, velocity_scale=1e-4)
    model = resting_block(friction, device=device)
    model["plate.orientation"] = (0, 0, np.sin(turn / 2), np.cos(turn / 2))
    model["block.linear_velocity"] = axis_1 + axis_2
    wc.Simulation(model, dt=0.3615177588 / 20000).step(20000)
    velocity = model.sensor("block.linear_velocity")[0]
    np.testing.assert_allclose((velocity @ axis_1, velocity @ axis_2), (0.0625, 0.5), rtol=2e-4)
