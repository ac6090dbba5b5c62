"""Fixtures that tests share: the device, small scenes, and the shared data if it is there."""

import os
import signal
import threading
from pathlib import Path

import pytest
import warp as wp

wp.config.log_level = wp.LOG_ERROR


def pytest_addoption(parser):
    parser.addoption("--device", default="cpu", help="Warp device to test on, such as cuda:0")
    parser.addoption("--bounds-check", action="store_true", help="compile kernels with array bounds checks")


def pytest_configure(config):
    # What a shell starts in the background ignores Ctrl-C, and so would what tests start and interrupt.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if config.getoption("--bounds-check"):
        wp.config.mode = "debug"
    wp.init()


@pytest.fixture(scope="session")
def device(request):
    """The device that simulations under test run on."""
    return request.config.getoption("--device")


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
