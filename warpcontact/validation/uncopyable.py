"""Objects that hold arrays of a device, and can be neither pickled nor copied."""

from typing import Any, ClassVar, NoReturn


class Uncopied:
    """Base of such classes. ``instead`` is what to do instead, the end of the message."""

    _instead: ClassVar[str]

    def __init_subclass__(cls, *, instead: str | None = None, **others: Any) -> None:
        super().__init_subclass__(**others)
        if instead is not None:
            cls._instead = instead

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        """Refuses ``pickle`` and ``copy``.

        Raises:
            TypeError: Always; names what to do instead.
        """
        raise TypeError(
            f"a {type(self).__name__} must not be pickled or copied, since it holds arrays of a device; "
            f"{self._instead}"
        )
