"""Classes that a USD file may name: those of the library and custom ones passed by the caller."""

from collections.abc import Iterable, Mapping
from typing import Any

from warpcontact.kernels import friction, joints, laws
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.couplings import springs
from warpcontact.kernels.couplings.springs import Damper, Spring
from warpcontact.kernels.friction import Friction
from warpcontact.kernels.joints import Motion
from warpcontact.kernels.laws import Law
from warpcontact.kernels.shapes import shapes
from warpcontact.kernels.shapes.base import Shape

#: Classes of the library, by base class.
LIBRARY: Mapping[type[Formula], tuple[type[Any], ...]] = {
    Law: (*laws.CATALOGUE, *laws.RIGID),
    Friction: (*friction.CATALOGUE, *friction.RIGID),
    Spring: springs.SPRINGS,
    Damper: springs.DAMPERS,
    Motion: joints.CATALOGUE,
    Shape: shapes.CATALOGUE,
}
_ALL = frozenset(kind for kinds in LIBRARY.values() for kind in kinds)


def is_custom(kind: type[Formula]) -> bool:
    """Returns whether a class does not belong to the library."""
    return kind not in _ALL


class Catalogue:
    """Classes by name.

    Args:
        custom_types: Custom classes of the caller.

    Raises:
        TypeError: If one of them is not derived from a base class in ``LIBRARY``.
        ValueError: If two of them have the same name.
    """

    def __init__(self, custom_types: Iterable[type[Formula]] = ()) -> None:
        self._custom_types: dict[str, type[Formula]] = {}
        for kind in custom_types:
            if not isinstance(kind, type) or not issubclass(kind, tuple(LIBRARY)):
                raise TypeError(
                    "custom_types must be classes derived from wc.Law, wc.Friction, wc.Spring, wc.Damper, wc.Motion or "
                    f"wc.ParametricSurface, got {kind!r}"
                )
            if self._custom_types.setdefault(kind.__name__, kind) is not kind:
                raise ValueError(f"custom_types must have distinct names, got two classes named {kind.__name__!r}")

    def find(self, base: type[Formula], name: str, custom_types: bool) -> type[Formula]:
        """Returns the class with a name.

        Args:
            base: Required base class.
            name: Name of the class.
            custom_types: Whether to search the custom classes instead of the library.

        Raises:
            LookupError: If there is no such class; the message lists those that exist.
        """
        if custom_types:
            kind = self._custom_types.get(name)
            if kind is None or not issubclass(kind, base):
                raise LookupError(
                    f"{name!r} is a {base.__name__.lower()} not in the library; pass the class: custom_types=[{name}]"
                )
            return kind
        table = {kind.__name__: kind for kind in LIBRARY[base]}
        if name not in table:
            raise LookupError(f"there is no {base.__name__.lower()} {name[:80]!r}; there are: {', '.join(table)}")
        return table[name]
