"""Method of ``Scene`` that adds elements of registered families of force elements; it checks all input."""

from typing import Any

from warpcontact.scene.scene_element import SceneElement
from warpcontact.validation import checks


class ForceElements:
    """The elements of registered families of a ``Scene``."""

    force_elements: list[SceneElement]
    _elements: dict[str, Any]

    def add_force_element(self, kind: type[SceneElement], *, name: str | None = None, **arguments: Any) -> Any:
        """Adds an element of a registered family of force elements.

        Args:
            kind: Class of the element, see "Adding a force element" in ``docs/architecture.md``.
            name: Name in parameters and sensors. Default: generated.
            **arguments: The arguments that the class declares.

        Returns:
            The element, an instance of ``kind``.

        Raises:
            TypeError: If an argument does not exist, or is missing.
            ValueError: If a value is out of range; the message names it.
        """
        if not (isinstance(kind, type) and issubclass(kind, SceneElement)):
            raise TypeError(f"kind must be a class derived from SceneElement, got {kind!r}")
        name = checks.new_name(kind.prefix(), name, self._elements)
        values = kind.checked(name, arguments)
        for key, of in kind.references().items():
            target = values[key]
            if target is None and kind.is_optional(key):
                continue
            if not isinstance(target, of) or self._elements.get(target.name) is not target:
                raise ValueError(f"{name}.{key} must be {of.__name__} of this scene, got {checks.element(target)}")
        element = kind(name=name, **values)
        element.check()
        self.force_elements.append(element)
        self._elements[name] = element
        return element
