"""Fixtures that tests share: devices, their memory, folders of runs, and the shared data if it is there."""

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
    # What a shell starts in the background ignores Ctrl-C, and so would what tests start and interrupt.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # Test modules and the processes that tests start read it when they import the package.
    os.environ["WARPCONTACT_COMPILE"] = config.getoption("--kernels")
    from warpcontact.kernels.lowlevel import unique_kernel

    assert config.getoption("--kernels") == unique_kernel.MODE, (
        "the package was imported before its options were set"
    )
    # Kernels of tests too: LLVM compiles concurrently only with equal options.
    wp.config.cpu_compiler_flags = unique_kernel.OPTIONS["cpu_compiler_flags"]
    if config.getoption("--bounds-check"):
        wp.config.mode = "debug"
    wp.init()


def pytest_collection_modifyitems(items):
    for item in items:
        if "times" in getattr(item, "fixturenames", ()):
            item.add_marker("sampled")


def pytest_collection_finish():
    # Modules and test items stay until the end: later collections of garbage skip them.
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def state_folder(tmp_path_factory):
    """The state folder of the user, here and in processes that tests start: what tests trust stays there."""
    with pytest.MonkeyPatch.context() as patched:
        folder = tmp_path_factory.mktemp("state")
        patched.setenv("LOCALAPPDATA" if os.name == "nt" else "XDG_STATE_HOME", str(folder))
        yield folder


@pytest.fixture(scope="session")
def device(request):
    """The device that simulations under test run on."""
    return request.config.getoption("--device")


@pytest.fixture(scope="session")
def times(request):
    """By how many times the random cases of slow tests are multiplied."""
    return 5 if request.config.getoption("--thorough") else 1


@pytest.fixture(scope="session")
def shared():
    """Folder of reference texts, oracles and measured data beside a checkout; a user's clone has none."""
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
    """An allocator that counts the bytes that are in use."""

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
    """Counts what Warp arrays on the device take from now on."""
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
    """What a model is split over."""
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
    """The same, killed when one shard was finished and another on its way."""
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
    """Copies the folder of a run, to be damaged."""

    def copy(folder):
        return shutil.copytree(folder, tmp_path / "copy")

    return copy


@pytest.fixture(autouse=True)
def fused_kernels(request, monkeypatch):
    """Lets tests of launch shapes fuse stages if kernels are compiled for short compile times as well."""
    if request.node.get_closest_marker("launch_shapes"):
        monkeypatch.setattr("warpcontact.forces.execution_plan.FUSE_STAGES", True)


@pytest.fixture
def write_step_outputs(monkeypatch):
    """Has steps tell of contacts what they computed, over the step, as if somebody watched."""
    monkeypatch.setattr(
        "warpcontact.forces.execution_plan.ExecutionPlan.write_outputs", property(lambda _: True, lambda *_: None)
    )
    monkeypatch.setattr("warpcontact.forces.execution_plan.ExecutionPlan.fuses_step", False)
