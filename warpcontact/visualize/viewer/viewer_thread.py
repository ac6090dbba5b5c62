"""Base of the viewer pages: one thread owns all displays and executes the commands of the page in order."""

import queue
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from warpcontact.drawing.drawing import Drawing
from warpcontact.visualize.viewer.page import LocalServer, gap_legend, message, table
from warpcontact.visualize.viewer.stage import DEEP, FAR, Stage

#: Shortest time between two pictures [s].
FRAME_TIME = 1.0 / 30.0
# Time between two updates while the page is not playing [s].
IDLE_TIME = 0.1
#: Range of speeds, in simulated time per wall-clock time.
SLOWEST, FASTEST = 1.0e-3, 1.0e3

# Errors caused by user input or by lack of resources: the message suffices, without a traceback.
_REPORTED_ERRORS = (ValueError, KeyError, OSError, MemoryError, RuntimeError)


class ViewerThread(ABC):
    """Page with the thread that serves it.

    Only this thread writes to the page. Commands from the page are put into a queue, which the thread empties
    between two pictures, so that callbacks of the page return immediately.

    Args:
        server: Server of the page.
        speed: Simulated time per wall-clock time.

    Attributes:
        server: Server of the page.
        stage: Three-dimensional scene of the page.
        speed: Simulated time per wall-clock time.
        playing: Whether time advances.
        problem: Last problem shown; empty if there is none.
        pictures: Number of updates so far.
    """

    def __init__(self, server: LocalServer, speed: float) -> None:
        self.server = server
        self.stage = Stage(server)
        self.speed = speed
        self.playing = False
        self.problem = ""
        self.pictures = 0
        self._commands: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="warpcontact view", daemon=True)
        self._shown: dict[int, str] = {}

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
            self.pictures += 1

    def _take_commands(self, period: float, last: float) -> None:
        """Executes queued commands until the next picture is due."""
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
        self._problem_text.content = message(text, bad=True) if text else ""

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
                lambda on: self._set_display_option("forces", on),
            )
            self.length_input = self.on_change(
                gui.add_slider("Arrows", 0.1, 20.0, 0.1, 1.0, hint="factor on the arrow length"),
                lambda length: self._set_display_option("length", length),
            )
            self.gaps_input = self.on_change(
                gui.add_checkbox(
                    "Gaps", self.stage.gaps, hint="red: inside, pale: in contact, blue: separated, gray: unknown"
                ),
                lambda on: self._set_display_option("gaps", on),
            )
            self._gap_legend = gui.add_html("")
            self.follow_input = self.on_change(
                gui.add_checkbox("Follow", self.stage.following, hint="the camera moves with the bodies"),
                lambda on: self._set_display_option("following", on),
            )
            self.button("Frame the bodies", self._frame_bodies)

    def _set_display_option(self, name: str, value: Any) -> None:
        setattr(self.stage, name, value)
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
            legend = gap_legend(DEEP * drawing.size, FAR * drawing.size)
        self._gap_legend.content = legend

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
