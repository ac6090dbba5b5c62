"""Opens a page on a run, a recording, an experiment or a simulation."""

import importlib.util
import math
import time
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from warpcontact.experiment.experiment import Experiment
from warpcontact.experiment.run import Run
from warpcontact.experiment.shards import make_simulation
from warpcontact.experiment.trust import Trust
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.stepping.recording import Recording
from warpcontact.stepping.simulation import Simulation

if TYPE_CHECKING:
    from warpcontact.visualize.viewer.viewer_thread import ViewerThread

PORT = 8080
#: Environments of an experiment that is stepped live.
ENVS = 16
# How often it is looked whether somebody wants to end it [s].
_WAKE = 0.2

Target = str | PathLike[str] | Run | Experiment | Simulation | Recording


class Viewer:
    """A page that is served; a context manager that ends it.

    Attributes:
        viewer_thread: What goes on behind it.
        url: Its address.
    """

    def __init__(self, viewer_thread: "ViewerThread") -> None:
        self.viewer_thread = viewer_thread
        self.url: str = viewer_thread.server.url
        self._serves = True

    def open(self) -> None:
        """Opens it in the browser."""
        import webbrowser

        webbrowser.open(self.url)

    def wait(self) -> None:
        """Waits until Ctrl-C is pressed, and ends it."""
        try:
            while self._serves:
                time.sleep(_WAKE)
        except KeyboardInterrupt:
            pass
        finally:
            self.close()

    def close(self) -> None:
        """Ends the page; a simulation stays as it is then, and may be stepped by others."""
        if self._serves:
            self._serves = False
            self.viewer_thread.close()

    def __enter__(self) -> "Viewer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Viewer at {self.url}>"


@explain_keywords
def view(
    target: Target,
    *,
    port: int = PORT,
    block: bool = True,
    open_browser: bool = False,
    speed: float = 1.0,
    envs: int | None = None,
    device: str | Sequence[str] = "auto",
    trust: Trust = False,
) -> Viewer:
    """Shows a run, a recording, or a simulation that steps, on a page for a browser of this machine.

    The page is served on 127.0.0.1 alone. That of a run shows what is committed, and follows a run that goes on.
    That of an experiment or a simulation steps it, and lets parameters be changed meanwhile.

    Args:
        target: Folder of a run, an experiment file, a ``Run``, an ``Experiment``, a ``Simulation``, which belongs
            to the page until it is closed, or what ``Simulation.run`` returned.
        port: Port of the page, or the first that is tried; 0: any that is free.
        block: Whether to wait until Ctrl-C is pressed.
        open_browser: Whether to open it in the browser.
        speed: Simulated time to that on the wall.
        envs: Number of environments of an experiment; ``None``: its own, 16 at most.
        device: Device of an experiment, as of ``Experiment.model``.
        trust: As for ``wc.open_run``, if ``target`` is a folder or file.

    Returns:
        The page; ended already if ``block``.

    Raises:
        ImportError: If viser is not installed.
        ExperimentError: If the folder holds no run, or the file no experiment that is right.
        RunDataError: If what was committed of a run is not there.
        ValueError: If an option is not allowed, or nothing was recorded over time.
    """
    if importlib.util.find_spec("viser") is None:
        raise ImportError("a live view needs viser, which is not installed: pip install 'warpcontact[view]'")
    from warpcontact.visualize.viewer.viewer_thread import FASTEST, SLOWEST

    if not (isinstance(speed, int | float) and math.isfinite(speed) and SLOWEST <= speed <= FASTEST):
        raise ValueError(f"speed must be from {SLOWEST:g} to {FASTEST:g}, got {speed!r}")
    if isinstance(target, str | PathLike) and not Path(target).is_dir():
        target = Experiment.from_toml(target, trust=trust)
    if envs is not None and not isinstance(target, Experiment):
        raise ValueError(f"envs is of an experiment, got {envs!r}; the page of a run has all it has")
    viewer = Viewer(_make_viewer_thread(target, port, float(speed), envs, device, trust))
    try:
        viewer.viewer_thread.start()
        if open_browser:
            viewer.open()
    except BaseException:
        viewer.close()
        raise
    if block:
        viewer.wait()
    return viewer


def _make_viewer_thread(
    target: "Target", port: int, speed: float, envs: int | None, device: str | Sequence[str], trust: Trust
) -> "ViewerThread":
    """Makes what is behind the page; the server is opened when all else is there."""
    from warpcontact.visualize.viewer.live import Live
    from warpcontact.visualize.viewer.page import LocalServer
    from warpcontact.visualize.viewer.replay import Replay
    from warpcontact.visualize.viewer.sources import RecordingSource, RunSource, Source

    if isinstance(target, Experiment):
        settings = target.settings
        count = min(ENVS, settings.envs) if envs is None else envs
        experiment = target.changed(envs=count)
        simulation = make_simulation(experiment.model(device=device), experiment.settings)
        varied = list(experiment.design.names)
        return Live(LocalServer(port, settings.name), simulation, settings.name, speed, varied)
    if isinstance(target, Simulation):
        varied = [name for name in target.model if target.model.varies(name)]
        return Live(LocalServer(port, "simulation"), target, "simulation", speed, varied)
    source: Source
    if isinstance(target, Recording):
        source = RecordingSource(target)
    elif isinstance(target, Run):
        source = RunSource(target.folder, target.scene)
    elif isinstance(target, str | PathLike):
        source = RunSource(target, trust=trust)
    else:
        raise TypeError(
            "target must be the folder of a run, an experiment file, a Run, Experiment, Simulation or recording, "
            f"got {type(target).__name__}"
        )
    return Replay(LocalServer(port, source.name), source, speed)
