"""Opens a viewer page for a run, a recording, an experiment or a simulation."""

import importlib.util
import math
import time
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from warpcontact.experiment.experiment import Experiment
from warpcontact.experiment.observation import make_simulation
from warpcontact.experiment.run import Run
from warpcontact.experiment.user_code import Trust
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.stepping.recording import Recording
from warpcontact.stepping.simulation import Simulation

if TYPE_CHECKING:
    from warpcontact.visualize.viewer.page import ViewerThread

PORT = 8080
#: Default number of environments of an experiment that is stepped live.
ENVS = 16
# Interval at which ``Viewer.wait`` checks for Ctrl-C [s].
_POLL_INTERVAL = 0.2

Target = str | PathLike[str] | Run | Experiment | Simulation | Recording


class Viewer:
    """Page that is served until it is closed; also a context manager.

    Attributes:
        viewer_thread: Thread that draws the page and runs its commands.
        url: Address of the page.
    """

    def __init__(self, viewer_thread: "ViewerThread") -> None:
        self.viewer_thread = viewer_thread
        self.url: str = viewer_thread.server.url
        self._serves = True

    def open(self) -> None:
        """Opens the page in the default browser."""
        import webbrowser

        webbrowser.open(self.url)

    def wait(self) -> None:
        """Waits until Ctrl-C is pressed, then closes the page."""
        try:
            while self._serves:
                time.sleep(_POLL_INTERVAL)
        except KeyboardInterrupt:
            pass
        finally:
            self.close()

    def close(self) -> None:
        """Closes the page. A simulation keeps its current state and can then be stepped by the caller."""
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
    """Shows a run or a recording, or steps a simulation, on a page for a browser of this machine.

    The page is served on 127.0.0.1 only. The page of a run shows what is committed and follows a run in progress.
    The page of an experiment or a simulation steps it. Its parameters can be changed meanwhile.

    Args:
        target: Folder of a run, an experiment file, a ``Run``, an ``Experiment``, the recording returned by
            ``Simulation.run``, or a ``Simulation``, which must not be stepped elsewhere until the page is closed.
        port: Port of the page. If it is in use, the next free port is taken. 0: any free port.
        block: Whether to wait until Ctrl-C is pressed.
        open_browser: Whether to open the page in the default browser.
        speed: Simulated time per wall-clock time, from 0.001 to 1000.
        envs: Number of environments of an experiment. ``None``: that of the experiment, at most 16.
        device: Device of an experiment, as for ``Experiment.model``.
        trust: As for ``wc.open_run``, if ``target`` is a folder or file.

    Returns:
        The page; already closed if ``block``.

    Raises:
        ImportError: If viser is not installed.
        ExperimentError: If the folder contains no run, or the file no valid experiment.
        RunDataError: If committed data of the run are missing.
        ValueError: If an option is invalid, or no sensors were recorded over time.
        TypeError: If ``target`` has another type.
    """
    if importlib.util.find_spec("viser") is None:
        raise ImportError("a live view needs viser, which is not installed: pip install 'warpcontact[view]'")
    from warpcontact.visualize.viewer.page import FASTEST, SLOWEST

    if not (isinstance(speed, int | float) and math.isfinite(speed) and SLOWEST <= speed <= FASTEST):
        raise ValueError(f"speed must be from {SLOWEST:g} to {FASTEST:g}, got {speed!r}")
    if isinstance(target, str | PathLike) and not Path(target).is_dir():
        target = Experiment.from_toml(target, trust=trust)
    if envs is not None and not isinstance(target, Experiment):
        raise ValueError(
            f"envs applies to experiments only, got {envs!r}; the page of a run shows all environments"
        )
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
    """Makes the viewer thread of the page. The server is opened last, after all input has been read."""
    from warpcontact.visualize.viewer.live import Live
    from warpcontact.visualize.viewer.page import LocalServer
    from warpcontact.visualize.viewer.replay import RecordingSource, Replay, RunSource, Source

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
