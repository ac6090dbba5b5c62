"""Page of the viewer: local web server, the thread that owns all displays, and controls of all pages."""

import contextlib
import html
import logging
import queue
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import rich
import viser
from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from warpcontact.drawing.colors import GAPS, pressure_stops
from warpcontact.drawing.drawing import Drawing
from warpcontact.validation import safe_text
from warpcontact.visualize.viewer.stage import DEEP_FRACTION, FAR_FRACTION, Stage

HOST = "127.0.0.1"
#: Host names accepted in requests of a browser.
LOCAL = (HOST, "localhost")
#: Largest number of characters shown of a name and of a message, so that the page stays readable.
MAX_NAME_LENGTH = 80
MAX_MESSAGE_LENGTH = 2000

# Logger to which the websockets library reports connection errors.
_LOGGER = logging.getLogger("websockets.server")

# WebSocket close code "policy violation" (RFC 6455, 7.4.1), for connections from foreign pages.
_REFUSED = 1008

#: Shortest time between two frames [s].
FRAME_TIME = 1.0 / 30.0
# Time between two updates while the page is not playing [s].
IDLE_TIME = 0.1
#: Range of speeds, in simulated time per wall-clock time.
SLOWEST, FASTEST = 1.0e-3, 1.0e3

# Errors caused by user input or by lack of resources: the message suffices, without a traceback.
_REPORTED_ERRORS = (ValueError, KeyError, OSError, MemoryError, RuntimeError)


class LocalServer(viser.ViserServer):
    """Serves a page on 127.0.0.1 and accepts connections of this page only.

    Args:
        port: Port number. If it is in use, the next free port is taken. 0: any free port.
        title: Title of the page.

    Raises:
        ValueError: If ``port`` is not an integer from 0 to 65535.
    """

    def __init__(self, port: int, title: str) -> None:
        if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port < 2**16:
            raise ValueError(f"port must be a whole number from 0 to {2**16 - 1}, got {port!r}")
        with _silence():
            super().__init__(host=HOST, port=port, label=shortened(title), verbose=False)
        thread = self._websock_server._server_thread.ident

        def is_reportable(record: logging.LogRecord) -> bool:
            # Browsers open connections in advance and close them unused, which is not an error.
            error = record.exc_info[1] if record.exc_info else None
            return record.thread != thread or not isinstance(error, InvalidHandshake)

        self._is_reportable = is_reportable
        _LOGGER.addFilter(is_reportable)
        self.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")

        async def check(connection: Any) -> None:
            # Pages from other sites, open in the same browser, can reach this machine as well.
            socket = self._websock_server._live_connections[connection.client_id]
            if not is_own(socket.request.headers.get("Host"), socket.request.headers.get("Origin")):
                await socket.close(_REFUSED, "connections from other pages are refused")
                # Discard messages that were sent before the close, so that they are not processed.
                with contextlib.suppress(ConnectionClosed):
                    while True:
                        await socket.recv()

        self._websock_server.on_client_connect(check)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.get_port()}"

    def request_share_url(self, verbose: bool = True) -> None:
        """Does nothing. viser would open a public tunnel on request of the page."""

    def stop(self) -> None:
        """Stops the server and closes its connections."""
        with _silence():
            super().stop()
        _LOGGER.removeFilter(self._is_reportable)


def is_own(host: str | None, origin: str | None) -> bool:
    """Returns whether the headers ``Host`` and ``Origin`` show a connection from this page or from no browser."""
    if host is None or urlsplit(f"//{host}").hostname not in LOCAL:
        return False
    return origin is None or origin == f"http://{host}"


def shortened(text: str, max_length: int = MAX_NAME_LENGTH) -> str:
    """Returns a text as one line of at most ``max_length`` characters."""
    return safe_text.truncate(safe_text.single_line(text), max_length)


def table(rows: Iterable[tuple[str, str]]) -> str:
    """Returns an HTML table of two columns with escaped, shortened texts."""
    cell = '<td style="padding:0 0.6em 0.1em 0;vertical-align:top;overflow-wrap:anywhere">'
    lines = [f"<tr>{''.join(f'{cell}{_escaped(text)}</td>' for text in row)}</tr>" for row in rows]
    return f'<table style="{_STYLE}">{"".join(lines)}</table>'


def message(text: str, *, is_error: bool = False) -> str:
    """Returns an HTML element with escaped lines of text; red if ``is_error``."""
    color = ";color:#d6336c" if is_error else ""
    content = html.escape(text if len(text) <= MAX_MESSAGE_LENGTH else f"{text[:MAX_MESSAGE_LENGTH]}…")
    return f'<div style="{_STYLE};white-space:pre-wrap;overflow-wrap:anywhere{color}">{content}</div>'


def gap_legend(deepest: float, far: float) -> str:
    """Returns an HTML legend of the gap colors, from penetration ``deepest`` [m] to distance ``far`` [m]."""
    colors = ", ".join(f"rgb{color}" for _, color in GAPS)
    return _legend(colors, f"−{deepest:.3g} m", "0", f"{far:.3g} m")


def pressure_legend(largest: float) -> str:
    """Returns an HTML legend of the colors of pressures, from 0 to ``largest`` [Pa]."""
    stops = [[round(255.0 * part) for part in color] for color in pressure_stops()]
    return _legend(", ".join(f"rgb{tuple(color)}" for color in stops), "0", f"{largest:.3g} Pa")


def _legend(colors: str, *marks: str) -> str:
    """Returns an HTML legend: a bar with CSS colors and marks below it."""
    bar = f"height:0.6em;border-radius:0.3em;background:linear-gradient(to right, {colors})"
    ends = "".join(f"<span>{mark}</span>" for mark in marks)
    line = f'<div style="display:flex;justify-content:space-between">{ends}</div>'
    return f'<div style="{_STYLE}"><div style="{bar}"></div>{line}</div>'


_STYLE = "margin:0 0.9em 0.5em;font-size:0.8em;line-height:1.45"


def _escaped(text: str) -> str:
    return html.escape(shortened(text))


_silenced = threading.Lock()


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Suppresses the printed output of viser; the command line prints the address of the page itself."""
    console = rich.get_console()
    with _silenced:
        before, console.quiet = console.quiet, True
        try:
            yield
        finally:
            console.quiet = before


class ViewerThread(ABC):
    """Page with the thread that serves it.

    Only this thread writes to the page. Commands from the page are put into a queue, which the thread empties
    between two frames, so that callbacks of the page return immediately.

    Args:
        server: Server of the page.
        speed: Simulated time per wall-clock time.

    Attributes:
        server: Server of the page.
        stage: Three-dimensional scene of the page.
        speed: Simulated time per wall-clock time.
        playing: Whether time advances.
        problem: Last problem shown; empty if there is none.
        frames: Number of updates so far.
    """

    def __init__(self, server: LocalServer, speed: float) -> None:
        self.server = server
        self.stage = Stage(server)
        self.speed = speed
        self.playing = False
        self.problem = ""
        self.frames = 0
        self._commands: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="warpcontact view", daemon=True)

    def start(self) -> None:
        """Adds the controls to the page and starts the thread."""
        self.add_panel()
        self._thread.start()

    def close(self) -> None:
        """Stops the thread, then the server."""
        self._ended.set()
        self.post(lambda: None)
        if self._thread.is_alive():
            self._thread.join()
        self.server.stop()

    def post(self, command: Callable[[], None]) -> None:
        """Queues a command for execution by the thread."""
        self._commands.put(command)

    @abstractmethod
    def add_panel(self) -> None:
        """Adds all controls and displays to the page."""

    @abstractmethod
    def begin(self) -> None:
        """Runs once at the start of the thread."""

    @abstractmethod
    def tick(self, seconds: float) -> None:
        """Advances by ``seconds`` of wall-clock time and updates the page."""

    @abstractmethod
    def current_drawing(self) -> tuple[Drawing, int] | None:
        """Returns the drawing shown and the index of its record, or ``None``."""

    def _run(self) -> None:
        self.run_guarded(self.begin)
        last = time.monotonic()
        while not self._ended.is_set():
            self._take_commands(FRAME_TIME if self.playing else IDLE_TIME, last)
            now = time.monotonic()
            seconds, last = now - last, now
            self.run_guarded(lambda: self.tick(seconds))  # noqa: B023
            self.frames += 1

    def _take_commands(self, period: float, last: float) -> None:
        """Executes queued commands until the next frame is due."""
        while not self._ended.is_set():
            remaining = last + period - time.monotonic()
            try:
                command = self._commands.get(timeout=remaining) if remaining > 0.0 else self._commands.get_nowait()
            except queue.Empty:
                return
            self.run_guarded(command)
            if not self.playing:
                period = FRAME_TIME  # show the result of the command without the idle delay

    def run_guarded(self, work: Callable[[], None]) -> None:
        """Calls ``work``. An exception stops the time and is shown on the page."""
        try:
            work()
        except _REPORTED_ERRORS as error:
            self.fail(str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error))
        except Exception as error:
            traceback.print_exc()
            self.fail(f"{type(error).__name__}: {error}")

    def fail(self, text: str) -> None:
        """Stops the time and shows the reason."""
        self.pause()
        self.show_problem(text)

    def show_problem(self, text: str) -> None:
        """Shows a problem on the page; empty: removes it."""
        self.problem = text
        self._problem_text.content = message(text, is_error=True) if text else ""

    # Controls of both pages.

    def on_change(self, handle: Any, command: Callable[[Any], None]) -> Any:
        """Queues ``command`` with the value of an input whenever the user changes it; returns the input."""

        def changed(event: Any) -> None:
            # Ignore changes made by the thread itself.
            if threading.current_thread() is not self._thread:
                value = event.target.value
                self.post(lambda: command(value))

        handle.on_update(changed)
        return handle

    def button(self, label: str, command: Callable[[], None], **options: Any) -> Any:
        """Adds a button that queues ``command``."""
        handle = self.server.gui.add_button(label, **options)
        handle.on_click(lambda _: self.post(command))
        return handle

    def add_time(self) -> None:
        """Adds the status, the play button and the speed field."""
        gui = self.server.gui
        self._status = gui.add_html("")
        self._problem_text = gui.add_html("")
        self.play_button = self.button("Play", self.toggle)
        self.speed_input = self.on_change(
            gui.add_text("Speed", f"{self.speed:g}", hint="simulated time per wall-clock time"), self._set_speed
        )

    def _set_speed(self, text: str) -> None:
        try:
            speed = float(text)
        except ValueError:
            return  # incomplete input
        if SLOWEST <= speed <= FASTEST:
            self.speed = speed
            self.show_problem("")
        else:
            self.show_problem(f"the speed must be from {SLOWEST:g} to {FASTEST:g}, got {speed:g}")

    def add_display_options(self) -> None:
        """Adds the display options: forces, gaps, camera."""
        gui = self.server.gui
        with gui.add_folder("Display"):
            self.forces_input = self.on_change(
                gui.add_checkbox("Forces", self.stage.forces, hint="arrows of contact forces"),
                self._show_forces,
            )
            self.length_input = self.on_change(
                gui.add_slider("Arrows", 0.1, 20.0, 0.1, 1.0, hint="factor on the arrow length"),
                self._scale_arrows,
            )
            self.gaps_input = self.on_change(
                gui.add_checkbox(
                    "Gaps", self.stage.gaps, hint="red: inside, pale: in contact, blue: separated, gray: unknown"
                ),
                self._show_gaps,
            )
            self._gap_legend = gui.add_html("")
            self.pressure_input = self.on_change(
                gui.add_checkbox(
                    "Pressure",
                    self.stage.pressure,
                    hint="areas of body contacts, colored by pressure; the first time compiles kernels",
                ),
                self._show_pressure,
            )
            self._pressure_legend = gui.add_html("")
            self.follow_input = self.on_change(
                gui.add_checkbox("Follow", self.stage.following, hint="the camera moves with the bodies"),
                self._follow_bodies,
            )
            self.button("Frame the bodies", self._frame_bodies)

    def _show_forces(self, on: bool) -> None:
        self.stage.forces = on
        self.redraw()

    def _scale_arrows(self, length: float) -> None:
        self.stage.length = length
        self.redraw()

    def _show_gaps(self, on: bool) -> None:
        self.stage.gaps = on
        self.redraw()

    def _show_pressure(self, on: bool) -> None:
        self.stage.pressure = on
        self.redraw()

    def _follow_bodies(self, on: bool) -> None:
        self.stage.following = on
        self.redraw()

    def _frame_bodies(self) -> None:
        current = self.current_drawing()
        if current is not None:
            self.stage.frame_bodies(*current)

    def draw(self, drawing: Drawing, record: int, force_scale: float) -> None:
        """Draws a record of a drawing and updates the legend of its colors; arguments as for ``Stage.show``."""
        self.stage.show(drawing, record, force_scale)
        legend = ""
        if self.stage.gaps and any(contact.gaps is not None for contact in drawing.contact_forces):
            legend = gap_legend(DEEP_FRACTION * drawing.size, FAR_FRACTION * drawing.size)
        self._gap_legend.content = legend
        largest = self.stage.largest_pressure
        self._pressure_legend.content = pressure_legend(largest) if self.stage.pressure and largest > 0.0 else ""

    @abstractmethod
    def redraw(self) -> None:
        """Draws the current record or state again."""

    def toggle(self) -> None:
        """Starts the time if it is stopped, and stops it otherwise."""
        if self.playing:
            self.pause()
        else:
            self.play()

    def play(self) -> None:
        """Starts the time."""
        self.show_problem("")
        self.playing = True
        self.play_button.label = "Pause"

    def pause(self) -> None:
        """Stops the time."""
        self.playing = False
        self.play_button.label = "Play"

    def write(self, handle: Any, text: str) -> None:
        """Writes text on the page."""
        handle.content = message(text) if text else ""

    def write_table(self, handle: Any, rows: list[tuple[str, str]]) -> None:
        """Writes a table on the page."""
        handle.content = table(rows) if rows else ""

    def show_status(self, text: str) -> None:
        """Writes the status text."""
        self.write(self._status, text)


class EnvironmentSelector:
    """Panel that selects an environment: by number, previous, next, or next frozen.

    Args:
        viewer_thread: Viewer thread of the page.
        choose: Called with the number of the selected environment.

    Attributes:
        numbers: Numbers of the available environments, ascending.
        marked: Numbers of the frozen environments, ascending.
        env: Number of the selected environment; ``None`` if there are no environments yet.
        input: Number field on the page.
    """

    def __init__(self, viewer_thread: "ViewerThread", choose: Callable[[int], None]) -> None:
        self.viewer_thread = viewer_thread
        self.choose = choose
        self.numbers: NDArray[np.int_] = np.zeros(0, dtype=np.int_)
        self.marked: NDArray[np.int_] = np.zeros(0, dtype=np.int_)
        self.env: int | None = None
        gui = viewer_thread.server.gui
        with gui.add_folder("Environment"):
            self.input = viewer_thread.on_change(gui.add_number("Number", 0, step=1), self.pick)
            self._step_buttons = gui.add_button_group("Go to", ("Previous", "Next", "Next frozen"))
            self._step_buttons.on_click(lambda event: viewer_thread.post(lambda: self._select(event.target.value)))
            self._text = gui.add_html("")

    def set_environments(self, numbers: NDArray[np.int_], marked: NDArray[np.int_]) -> None:
        """Sets the numbers of the available and (``marked``) of the frozen environments."""
        self.numbers, self.marked = numbers, marked

    def pick(self, env: int) -> None:
        """Selects an environment by its number; shows a problem on the page if it does not exist."""
        if env not in self.numbers:
            available = f"{self.numbers.min()} to {self.numbers.max()}" if len(self.numbers) else "none yet"
            self.viewer_thread.show_problem(f"there is no environment {env}; there are {available}")
            return
        self.viewer_thread.show_problem("")
        self.env = int(env)
        self.input.value = self.env
        self.choose(self.env)

    def describe(self, text: str) -> None:
        """Writes the number of environments and ``text``, the state of the selected one."""
        failed = f"{len(self.marked)} frozen" if len(self.marked) else "none frozen"
        count = len(self.numbers)
        self.viewer_thread.write(
            self._text, f"{count} environment{'' if count == 1 else 's'}, {failed}\n{text}".strip()
        )

    def _select(self, where: str) -> None:
        among = self.marked if where == "Next frozen" else self.numbers
        if not len(among):
            self.viewer_thread.show_problem(
                "no environment is frozen" if where == "Next frozen" else "there are no environments yet"
            )
            return
        if self.env is None:
            self.pick(int(among[0]))
        elif where == "Previous":
            before = among[among < self.env]
            self.pick(int(before[-1] if len(before) else among[-1]))
        else:
            after = among[among > self.env]
            self.pick(int(after[0] if len(after) else among[0]))
