"""Shared fixtures: devices, memory, run folders, and the shared reference data if available."""

import gc
import os
import shutil
import signal
import threading
from pathlib import Path

import pytest
import warp as wp

wp.config.log_level = wp.LOG_ERROR


def pytest_addoption(parser):
    parser.addoption("--device", default="cpu", help="Warp device to test on, such as cuda:0")
    parser.addoption("--thorough", action="store_true", help="five times as many random cases in slow tests")
    parser.addoption(
        "--kernels",
        choices=("quick", "release"),
        default="quick",
        help="compile kernels for short compile times, or as users run them (WARPCONTACT_COMPILE)",
    )
    parser.addoption("--bounds-check", action="store_true", help="compile kernels with array bounds checks")


def pytest_configure(config):
    # Background processes of a shell ignore Ctrl-C, and so would the processes that tests start and interrupt.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # Test modules and subprocesses read it when they import the package.
    os.environ["WARPCONTACT_COMPILE"] = config.getoption("--kernels")
    from warpcontact.kernels.lowlevel import unique_kernel

    assert config.getoption("--kernels") == unique_kernel.MODE, (
        "the package was imported before its options were set"
    )
    # Also for kernels of tests: LLVM compiles concurrently only with equal options.
    wp.config.cpu_compiler_flags = unique_kernel.OPTIONS["cpu_compiler_flags"]
    if config.getoption("--bounds-check"):
        wp.config.mode = "debug"
    wp.init()


def pytest_collection_modifyitems(items):
    for item in items:
        if "times" in getattr(item, "fixturenames", ()):
            item.add_marker("sampled")


def pytest_collection_finish():
    # Modules and test items exist until the end; garbage collection skips them.
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def state_folder(tmp_path_factory):
    """State folder of the user, here and in subprocesses, so that tests do not change the real one."""
    with pytest.MonkeyPatch.context() as patched:
        folder = tmp_path_factory.mktemp("state")
        patched.setenv("LOCALAPPDATA" if os.name == "nt" else "XDG_STATE_HOME", str(folder))
        yield folder


@pytest.fixture(scope="session")
def device(request):
    """The device of the simulations under test."""
    return request.config.getoption("--device")


@pytest.fixture(scope="session")
def times(request):
    """Factor for the number of random cases of slow tests."""
    return 5 if request.config.getoption("--thorough") else 1


@pytest.fixture(scope="session")
def shared():
    """Folder of reference texts, oracles and measured data next to a checkout; not in a clone of a user."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    folder = Path(os.environ.get("WARPCONTACT_SHARED", beside))
    if not folder.is_dir():
        pytest.skip("the folder of reference data is not beside this checkout (WARPCONTACT_SHARED)")
    return folder


@pytest.fixture(scope="session")
def shared_data(shared):
    """Folder of measured tosses and real meshes."""
    return shared / "data"


class CountingAllocator:
    """An allocator that counts the allocated bytes."""

    def __init__(self, allocator):
        self.allocator = allocator
        self.used = 0

    def allocate(self, size_in_bytes):
        self.used += size_in_bytes
        return self.allocator.allocate(size_in_bytes)

    def deallocate(self, ptr, size_in_bytes):
        self.used -= size_in_bytes
        self.allocator.deallocate(ptr, size_in_bytes)


@pytest.fixture
def counting_allocator(device, monkeypatch):
    """Counts the bytes of Warp arrays that are allocated on the device from now on."""
    where = wp.get_device(device)
    gc.collect()
    if where.is_cpu:
        counter = CountingAllocator(where.default_allocator)
        monkeypatch.setattr(where, "default_allocator", counter)
        yield counter
    else:
        counter = CountingAllocator(wp.get_device_allocator(where))
        wp.set_device_allocator(where, counter)
        yield counter
        wp.set_device_allocator(where, None)
    gc.collect()


@pytest.fixture(params=["two", "three", "all GPUs"])
def devices(request, device):
    """Devices over which a model is split."""
    if request.param != "all GPUs":
        return [device] * {"two": 2, "three": 3}[request.param]
    if not device.startswith("cuda") or wp.get_cuda_device_count() < 2:
        pytest.skip("asked for with --device cuda:0 on a machine of at least two GPUs")
    return "cuda"


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory):
    """A finished run of three shards, with chunks of 19 frames."""
    import sharded_runs

    folder = tmp_path_factory.mktemp("whole")
    code, _, err = sharded_runs.run(sharded_runs.study(folder), "--out", folder / "out", *sharded_runs.OPTIONS)
    assert code == 0, err
    return folder / "out"


@pytest.fixture(scope="session")
def part_run(tmp_path_factory):
    """The same run, killed when one shard was finished and another in progress."""
    import sharded_runs

    folder = tmp_path_factory.mktemp("part")
    study, out = sharded_runs.study(folder), folder / "out"
    process = sharded_runs.start_run(study, "--out", out, *sharded_runs.OPTIONS, first=sharded_runs.COMMIT_OFTEN)

    def halfway():
        shards = sharded_runs.records(out)
        return 1 in shards and shards[1]["frames"] > 0 and not shards[1]["finished"]

    try:
        assert sharded_runs.wait_until(halfway, process)
    finally:
        sharded_runs.kill(process)
    return out


@pytest.fixture
def copied_run(tmp_path):
    """Copies the folder of a run, so that it can be damaged."""

    def copy(folder):
        return shutil.copytree(folder, tmp_path / "copy")

    return copy


@pytest.fixture
def no_pictures(monkeypatch):
    """Replaces the pictures of runs in this process by one pixel."""
    import blank_pictures

    for name in blank_pictures.FUNCTIONS:
        monkeypatch.setattr(f"{blank_pictures.MODULE}.{name}", blank_pictures.write_blank)


@pytest.fixture(autouse=True)
def fused_kernels(request, monkeypatch):
    """Fuses stages in tests of launch shapes, also if kernels are compiled for short compile times."""
    if request.node.get_closest_marker("launch_shapes"):
        monkeypatch.setattr("warpcontact.forces.launch_shape.FUSE_STAGES", True)


@pytest.fixture
def write_step_outputs(monkeypatch):
    """Makes steps write contact sensors averaged over the step, as for a monitor."""
    monkeypatch.setattr(
        "warpcontact.forces.execution_plan.ExecutionPlan.write_outputs", property(lambda _: True, lambda *_: None)
    )
