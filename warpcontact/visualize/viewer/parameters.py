"""Changing parameters of an environment on a page."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from warpcontact.model.environments import Environments
from warpcontact.visualize.viewer.page import shortened
from warpcontact.visualize.viewer.values import ParameterText

if TYPE_CHECKING:
    from warpcontact.visualize.viewer.live import Live

#: Parameters that are offered at once; of the others one is chosen.
MOST = 8


class Parameters:
    """Fields of the parameters that vary, and one of any other.

    Values are taken over when Enter is pressed or the button: what is written into a field on the way there counts
    for nothing.

    Args:
        viewer_thread: What they are of.
        model: The model.
        first: Names of those that are offered at once.

    Attributes:
        fields: Text of the parameters that are offered at once, by their names.
        chosen: Name of the one that was chosen beside them.
        field: Its text.
        item: Text of the number of an item of it; empty: all of them.
    """

    def __init__(self, viewer_thread: "Live", model: Environments, first: Sequence[str]) -> None:
        self.viewer_thread = viewer_thread
        self.model = model
        self.fields: dict[str, Any] = {}
        self._known: dict[str, str] = {}
        gui = viewer_thread.server.gui
        names = list(first)[:MOST]
        if names:
            with gui.add_form("Varied parameters") as form:
                for name in names:
                    self.fields[name] = gui.add_text(shortened(name, 40), "", hint=self._hint(name))
                self.set_button = viewer_thread.button("Set", lambda: self._set_all(form))
            form.on_submit(lambda event: self._submitted(event, self._set_all))
        # Names are shown shortened, and are told apart by their number.
        self._names = {f"{i + 1}. {shortened(name, 60)}": name for i, name in enumerate(model)}
        with gui.add_form("Any parameter", expand_by_default=not names) as form_of_one:
            self.choice = viewer_thread.on_change(gui.add_dropdown("Name", list(self._names)), self._choose)
            self.item = viewer_thread.on_change(
                gui.add_text("Item", "", hint="its number from 0; empty: all"), self._show_item
            )
            self.field = gui.add_text("Value", "")
            self.set_one_button = viewer_thread.button("Set", lambda: self._set_one(form_of_one))
        form_of_one.on_submit(lambda event: self._submitted(event, self._set_one))
        self._result = gui.add_html("")
        self.chosen = next(iter(model))

    def _submitted(self, event: Any, command: Callable[[], None]) -> None:
        # By Enter on the page; what the thread submits was taken.
        if event.client is not None:
            self.viewer_thread.post(command)

    def _hint(self, name: str) -> str:
        text = ParameterText(self.model, name)
        notes = [shortened(name, 200), "" if text.unit == "-" else f"in {text.unit}"]
        notes.append("from the next reset on" if text.is_initial else "")
        return ", ".join(filter(None, notes))

    def show_env(self, env: int) -> None:
        """Shows the values of an environment."""
        for name, field in self.fields.items():
            self._write(name, field, ParameterText(self.model, name).read(env))
        self._show_one()

    def _write(self, name: str, field: Any, text: str) -> None:
        self._known[name] = field.value = text

    def _choose(self, label: str) -> None:
        self.chosen = self._names[label]
        self.item.value = ""
        self._show_one()

    def _show_item(self, text: str) -> None:
        if not text or text.isdecimal():
            self._show_one()

    def _show_one(self) -> None:
        text = ParameterText(self.model, self.chosen)
        self.item.visible = text.is_set
        self.field.hint = self._hint(self.chosen)
        env = self.viewer_thread.picker.env
        if env is not None:
            self.field.value = text.read(env, self._item(text))

    def _item(self, text: ParameterText) -> int | None:
        written = self.item.value.strip()
        if not text.is_set or not written:
            return None
        if not written.isdecimal():
            raise ValueError(f"the item of {text.name} must be its number, from 0, got {written[:40]!r}")
        return int(written)

    def _set_all(self, form: Any = None) -> None:
        """Sets those of the fields that are not as they were shown."""
        changed = {name: field.value for name, field in self.fields.items() if field.value != self._known[name]}
        self._set({name: (value, None) for name, value in changed.items()})
        self._acknowledge(form)

    def _set_one(self, form: Any = None) -> None:
        text = ParameterText(self.model, self.chosen)
        self._set({self.chosen: (self.field.value, self._item(text))})
        self._acknowledge(form)

    def _acknowledge(self, form: Any) -> None:
        """Lets the page know that what was written was taken."""
        if form is not None:
            form.submit()

    def _set(self, values: dict[str, tuple[str, int | None]]) -> None:
        """Sets parameters of the environment that is shown; what is wrong with one does not keep the others."""
        env = self.viewer_thread.picker.env
        if env is None:
            return
        done, wrong, initial = [], [], False
        for name, (value, item) in values.items():
            text = ParameterText(self.model, name)
            try:
                text.write(env, value, item)
            except (ValueError, MemoryError) as error:
                wrong.append(str(error))
                continue
            done.append(f"{name} = {text.read(env, item)}")
            initial = initial or (text.is_initial and not self.model.at_start)
            if name in self.fields:
                self._write(name, self.fields[name], text.read(env))
        if initial:
            done.append("(an initial value: it counts from the next reset on)")
        self.viewer_thread.write(self._result, f"environment {env}: {'; '.join(done)}" if done else "")
        self.viewer_thread.show_problem("\n".join(wrong))
        if done:
            self._show_one()
            self.viewer_thread.refresh()
