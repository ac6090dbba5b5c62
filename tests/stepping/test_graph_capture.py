"""While one thread captures steps, Warp calls of other threads wait, and vice versa."""

import threading

import pytest
from scenes import dropped_sphere

import warpcontact as wc
from warpcontact.system.capture_lock import exclusive_capture_lock, shared_capture_lock

# Longer than any call here that does not wait [s].
LONG = 0.5


@pytest.fixture(scope="module")
def sim():
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), envs=2)
    made = wc.Simulation(model, dt=1e-3, capture_graphs=False)
    made.run(2e-3, ["touch.gap"])  # compiles
    return made


def start_thread(work):
    """Starts ``work`` in a separate thread."""
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


@pytest.mark.parametrize(
    "work",
    [
        lambda sim: sim.step(),
        lambda sim: sim.reset(),
        lambda sim: sim.model.sensor("touch.gap"),
        lambda sim: sim.run(1e-3),
        lambda sim: sim.model.__setitem__("ball.mass", 2.0),
        lambda sim: sim.model.scene.build(2, "cpu"),
        lambda sim: wc.Simulation(sim.model, dt=1e-3),
    ],
    ids=["steps", "resets", "sensors", "recordings", "parameters", "builds", "simulations"],
)
def test_stepping_thread_waits_for_graph_capture(work, sim):
    with exclusive_capture_lock():
        thread = start_thread(lambda: work(sim))
        thread.join(LONG)
        waits = thread.is_alive()
    thread.join()
    assert waits


def test_graph_capture_waits_for_stepping_thread(sim):
    captured = wc.Simulation(sim.model, dt=1e-3)
    with shared_capture_lock():
        thread = start_thread(captured.step)
        thread.join(LONG)
        waits = thread.is_alive()
    thread.join()
    assert waits


def test_graph_replay_does_not_wait_for_capture(sim):
    captured = wc.Simulation(sim.model, dt=1e-3)
    captured.step(8)
    with exclusive_capture_lock():
        thread = start_thread(lambda: captured.step(16))
        thread.join(60.0)
        assert not thread.is_alive()
    with shared_capture_lock():
        captured.step(8)
    assert captured.steps >= 32
