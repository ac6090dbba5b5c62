"""Helpers for tests of the live view: small runs, pages that are closed, and waiting for threads."""

import contextlib
import threading
import time

import sharded_runs
import warp as wp

import warpcontact as wc


def make_run(folder, **replaced):
    """Runs the small study into ``folder / "run"``, in shards of 4 environments; returns the folder."""
    experiment = wc.Experiment.from_toml(sharded_runs.study(folder, **replaced))
    experiment.run(folder / "run", shard=4, device="cpu", progress=False)
    return folder / "run"


@contextlib.contextmanager
def viewing(target, **options):
    """Shows ``target`` on a page; yields its viewer thread after it has started."""
    with wc.view(target, port=0, block=False, device="cpu", **options) as viewer:
        wait_for_thread(viewer.viewer_thread)
        yield viewer.viewer_thread


def wait_for_thread(show):
    """Waits until the thread has processed all requests so far and has drawn the result."""
    done = threading.Event()
    show.post(done.set)
    # The first call compiles kernels, possibly on a slow machine.
    assert done.wait(900.0), "the thread of the page does not answer"
    seen = show.frames
    poll_until(lambda: show.frames > seen)


def poll_until(holds, timeout=60.0):
    """Waits until ``holds()``."""
    end = time.monotonic() + timeout
    while not holds():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def ball_on_ground(envs=3, **contact):
    """A simulation of a ball at rest on the ground, in several environments."""
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((4.0, 4.0)), name="ground")
    ball = scene.add_body(1.0, (4e-3, 4e-3, 4e-3), position=(0, 0, 0.0999), name="ball")
    centre = scene.add_point(ball, (0, 0, 0), name="centre")
    soft = wc.ContactMaterial(law=wc.laws.KelvinVoigt(stiffness=1e5, damping=600.0))
    scene.add_contact(centre, ground, soft, radius=0.1, name="touch", **contact)
    wp.config.log_level = wp.LOG_ERROR
    return wc.Simulation(scene.build(envs, "cpu", "float64"), dt=1e-3)
