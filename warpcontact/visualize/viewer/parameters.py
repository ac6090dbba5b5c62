"""Fields on the page that change parameters of the selected environment."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from warpcontact.model.environments import Environments
from warpcontact.visualize.viewer.page import shortened
from warpcontact.visualize.viewer.values import ParameterText

if TYPE_CHECKING:
    from warpcontact.visualize.viewer.live import Live

#: Largest number of parameters with a permanent field; the others are chosen from a list.
MOST = 8


class Parameters:
    """Fields of the varied parameters, and one field for any parameter chosen from a list.

    A value is set when Enter or the button is pressed, not while it is typed.

    Args:
        viewer_thread: Viewer thread of the page.
        model: Model whose parameters are changed.
        first: Names of the parameters with permanent fields; the first ``MOST`` are used.

    Attributes:
        fields: Text fields of the varied parameters, by parameter name.
        chosen: Name of the parameter chosen from the list.
        field: Text field of the chosen parameter.
        item: Text field for the index of an item of the chosen parameter; empty: all items.
    """

    def __init__(self, viewer_thread: "Live", model: Environments, first: Sequence[str]) -> None:
        self.viewer_thread = viewer_thread
        self.model = model
        self.fields: dict[str, Any] = {}
        self._displayed: dict[str, str] = {}
        gui = viewer_thread.server.gui
        names = list(first)[:MOST]
        if names:
            with gui.add_form("Varied parameters") as form:
                for name in names:
                    self.fields[name] = gui.add_text(shortened(name, 40), "", hint=self._hint(name))
                self.set_button = viewer_thread.button("Set", lambda: self._set_all(form))
            form.on_submit(lambda event: self._submitted(event, self._set_all))
        # Shortened names may coincide; their number makes them unique.
        self._names = {f"{i + 1}. {shortened(name, 60)}": name for i, name in enumerate(model)}
        with gui.add_form("Any parameter", expand_by_default=not names) as form_of_one:
            self.choice = viewer_thread.on_change(gui.add_dropdown("Name", list(self._names)), self._choose)
            self.item = viewer_thread.on_change(
                gui.add_text("Item", "", hint="index from 0; empty: all"), self._show_item
            )
            self.field = gui.add_text("Value", "")
            self.set_one_button = viewer_thread.button("Set", lambda: self._set_one(form_of_one))
        form_of_one.on_submit(lambda event: self._submitted(event, self._set_one))
        self._result = gui.add_html("")
        self.chosen = next(iter(model))

    def _submitted(self, event: Any, command: Callable[[], None]) -> None:
        # Only submissions with Enter on the page. ``form.submit()`` of this thread has no client.
        if event.client is not None:
            self.viewer_thread.post(command)

    def _hint(self, name: str) -> str:
        text = ParameterText(self.model, name)
        notes = [shortened(name, 200), "" if text.unit == "-" else f"in {text.unit}"]
        notes.append("takes effect at the next reset" if text.is_initial else "")
        return ", ".join(filter(None, notes))

    def show_env(self, env: int) -> None:
        """Shows the parameter values of an environment."""
        for name, field in self.fields.items():
            self._write(name, field, ParameterText(self.model, name).read(env))
        self._show_one()

    def _write(self, name: str, field: Any, text: str) -> None:
        self._displayed[name] = field.value = text

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
            raise ValueError(f"the item of {text.name} must be its index, from 0, got {written[:40]!r}")
        return int(written)

    def _set_all(self, form: Any = None) -> None:
        """Sets the parameters whose field differs from the displayed value."""
        changed = {
            name: field.value for name, field in self.fields.items() if field.value != self._displayed[name]
        }
        self._set({name: (value, None) for name, value in changed.items()})
        self._acknowledge(form)

    def _set_one(self, form: Any = None) -> None:
        text = ParameterText(self.model, self.chosen)
        self._set({self.chosen: (self.field.value, self._item(text))})
        self._acknowledge(form)

    def _acknowledge(self, form: Any) -> None:
        """Notifies the page that the input was processed."""
        if form is not None:
            form.submit()

    def _set(self, values: dict[str, tuple[str, int | None]]) -> None:
        """Sets parameters of the selected environment. An invalid value does not prevent setting the others."""
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
            done.append("(initial value: takes effect at the next reset)")
        self.viewer_thread.write(self._result, f"environment {env}: {'; '.join(done)}" if done else "")
        self.viewer_thread.show_problem("\n".join(wrong))
        if done:
            self._show_one()
            self.viewer_thread.refresh()
