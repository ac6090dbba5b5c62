"""What goes on behind a page: one thread owns all that is shown, and takes what is done on the page in order."""

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

#: Time from picture to picture, at the least [s].
FRAME_TIME = 1.0 / 30.0
# Of what nobody plays there is no picture; how often it is looked whether there is anything new [s].
IDLE_TIME = 0.1
#: Speeds that a page offers, of simulated time to that on the wall.
SLOWEST, FASTEST = 1.0e-3, 1.0e3

# What a user may do wrong, or a machine lack: its message says all there is to say.
_REPORTED_ERRORS = (ValueError, KeyError, OSError, MemoryError, RuntimeError)


class ViewerThread(ABC):
    """A page and the thread behind it.

    Everything that is shown belongs to the thread. What happens on the page is put into a queue, which it empties
    between two pictures, so that nothing on the page waits for it.

    Args:
        server: The server of the page.
        speed: Simulated time to that on the wall.

    Attributes:
        server: The server of the page.
        stage: What is drawn.
        speed: Simulated time to that on the wall.
        playing: Whether time goes on.
        problem: What went wrong last; empty: nothing.
        pictures: How often it was looked what there is to show.
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
        """Puts everything on the page and begins."""
        self.add_panel()
        self._thread.start()

    def close(self) -> None:
        """Ends the thread, then the server."""
        self._ended.set()
        self.post(lambda: None)
        if self._thread.is_alive():
            self._thread.join()
        self.server.stop()

    def post(self, command: Callable[[], None]) -> None:
        """Lets the thread do something, after what it was asked before."""
        self._commands.put(command)

    @abstractmethod
    def add_panel(self) -> None:
        """Puts all that can be read and done on the page."""

    @abstractmethod
    def begin(self) -> None:
        """Does what is to be done first."""

    @abstractmethod
    def tick(self, seconds: float) -> None:
        """Goes on by so much time on the wall [s], and shows what there is."""

    @abstractmethod
    def current_drawing(self) -> tuple[Drawing, int] | None:
        """Returns what is seen, and the record of it; ``None``: nothing."""

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
        """Takes commands until the next picture is due."""
        while not self._ended.is_set():
            remaining = last + period - time.monotonic()
            try:
                command = self._commands.get(timeout=remaining) if remaining > 0.0 else self._commands.get_nowait()
            except queue.Empty:
                return
            self.run_guarded(command)
            if not self.playing:
                period = FRAME_TIME  # to show what it did

    def run_guarded(self, work: Callable[[], None]) -> None:
        """Does ``work``; what goes wrong stops the time and is told on the page."""
        try:
            work()
        except _REPORTED_ERRORS as error:
            self.fail(str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error))
        except Exception as error:
            traceback.print_exc()
            self.fail(f"{type(error).__name__}: {error}")

    def fail(self, text: str) -> None:
        """Stops the time and tells why."""
        self.pause()
        self.show_problem(text)

    def show_problem(self, text: str) -> None:
        """Says on the page what is wrong; empty: nothing."""
        self.problem = text
        self._problem_text.content = message(text, bad=True) if text else ""

    # What both pages have.

    def on_change(self, handle: Any, command: Callable[[Any], None]) -> Any:
        """Lets the thread do ``command`` with the value of an input, when somebody changes it; returns it."""

        def changed(event: Any) -> None:
            # What the thread itself writes into an input is known to it.
            if threading.current_thread() is not self._thread:
                value = event.target.value
                self.post(lambda: command(value))

        handle.on_update(changed)
        return handle

    def button(self, label: str, command: Callable[[], None], **options: Any) -> Any:
        """Adds a button that lets the thread do ``command``."""
        handle = self.server.gui.add_button(label, **options)
        handle.on_click(lambda _: self.post(command))
        return handle

    def add_time(self) -> None:
        """Adds what starts and stops the time."""
        gui = self.server.gui
        self._status = gui.add_html("")
        self._problem_text = gui.add_html("")
        self.play_button = self.button("Play", self.toggle)
        self.speed_input = self.on_change(
            gui.add_text("Speed", f"{self.speed:g}", hint="simulated time to that on the wall"), self._set_speed
        )

    def _set_speed(self, text: str) -> None:
        try:
            speed = float(text)
        except ValueError:
            return  # not yet written to the end
        if SLOWEST <= speed <= FASTEST:
            self.speed = speed
            self.show_problem("")
        else:
            self.show_problem(f"the speed must be from {SLOWEST:g} to {FASTEST:g}, got {speed:g}")

    def add_display_options(self) -> None:
        """Adds what chooses how things look."""
        gui = self.server.gui
        with gui.add_folder("Look"):
            self.forces_input = self.on_change(
                gui.add_checkbox("Forces", self.stage.forces, hint="arrows of contact forces"),
                lambda on: self._set_display_option("forces", on),
            )
            self.length_input = self.on_change(
                gui.add_slider("Arrows", 0.1, 20.0, 0.1, 1.0, hint="their length, of that of the largest force"),
                lambda length: self._set_display_option("length", length),
            )
            self.gaps_input = self.on_change(
                gui.add_checkbox(
                    "Gaps", self.stage.gaps, hint="red: inside, pale: in touch, blue: away, grey: unknown"
                ),
                lambda on: self._set_display_option("gaps", on),
            )
            self._gap_legend = gui.add_html("")
            self.follow_input = self.on_change(
                gui.add_checkbox("Follow", self.stage.following, hint="the camera moves with the bodies"),
                lambda on: self._set_display_option("following", on),
            )
            self.button("Look at the bodies", self._frame_bodies)

    def _set_display_option(self, name: str, value: Any) -> None:
        setattr(self.stage, name, value)
        self.redraw()

    def _frame_bodies(self) -> None:
        seen = self.current_drawing()
        if seen is not None:
            self.stage.frame_bodies(*seen)

    def draw(self, drawing: Drawing, record: int, force_scale: float) -> None:
        """Draws a record of a drawing, and says what its colours mean; arguments as of ``Stage.show``."""
        self.stage.show(drawing, record, force_scale)
        legend = ""
        if self.stage.gaps and any(contact.gaps is not None for contact in drawing.contact_forces):
            legend = gap_legend(DEEP * drawing.size, FAR * drawing.size)
        self._gap_legend.content = legend

    @abstractmethod
    def redraw(self) -> None:
        """Draws what there is once more."""

    def toggle(self) -> None:
        """Plays, or stops."""
        if self.playing:
            self.pause()
        else:
            self.play()

    def play(self) -> None:
        """Lets time go on."""
        self.show_problem("")
        self.playing = True
        self.play_button.label = "Pause"

    def pause(self) -> None:
        """Stops the time."""
        self.playing = False
        self.play_button.label = "Play"

    def write(self, handle: Any, text: str) -> None:
        """Writes text on the page, if it is another."""
        handle.content = message(text) if text else ""

    def write_table(self, handle: Any, rows: list[tuple[str, str]]) -> None:
        """Writes a table on the page, if it is another."""
        handle.content = table(rows) if rows else ""

    def show_status(self, text: str) -> None:
        """Writes where things stand."""
        self.write(self._status, text)
