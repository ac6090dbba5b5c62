"""Choosing one of many environments on a page."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from warpcontact.visualize.viewer.viewer_thread import ViewerThread


class Picker:
    """What chooses an environment: its number, the next, the one before, the next of those that failed.

    Args:
        viewer_thread: What it is of.
        choose: Called with the number of another environment.

    Attributes:
        numbers: The environments that there are, in order.
        env: The number of the chosen one; ``None``: there are none.
        input: The number on the page.
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
        """Offers environments; ``marked`` are the numbers of those that failed."""
        self.numbers, self.marked = numbers, marked

    def pick(self, env: int) -> None:
        """Chooses an environment by its number; the problem is told if there is none."""
        if env not in self.numbers:
            there = f"{self.numbers.min()} to {self.numbers.max()}" if len(self.numbers) else "none yet"
            self.viewer_thread.show_problem(f"there is no environment {env}; there are {there}")
            return
        self.viewer_thread.show_problem("")
        self.env = int(env)
        self.input.value = self.env
        self.choose(self.env)

    def describe(self, text: str) -> None:
        """Writes what is known of the chosen one."""
        failed = f"{len(self.marked)} frozen" if len(self.marked) else "none frozen"
        count = len(self.numbers)
        self.viewer_thread.write(
            self._text, f"{count} environment{'' if count == 1 else 's'}, {failed}\n{text}".strip()
        )

    def _select(self, where: str) -> None:
        among = self.marked if where == "Next frozen" else self.numbers
        if not len(among):
            self.viewer_thread.show_problem(
                "no environment is frozen" if where == "Next frozen" else "there are none yet"
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
