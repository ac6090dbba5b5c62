"""Selection of one environment on the page of the viewer."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from warpcontact.visualize.viewer.viewer_thread import ViewerThread


class Picker:
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
