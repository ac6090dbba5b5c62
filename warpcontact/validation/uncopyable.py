"""Base class of objects that hold device arrays, and cannot be pickled or copied."""

from typing import Any, ClassVar, NoReturn


class Uncopied:
    """Base class that refuses pickling and copying; ``instead`` is the advice at the end of the message."""

    _instead: ClassVar[str]

    def __init_subclass__(cls, *, instead: str | None = None, **others: Any) -> None:
        super().__init_subclass__(**others)
        if instead is not None:
            cls._instead = instead

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        """Refuses ``pickle`` and ``copy``.

        Raises:
            TypeError: Always; the message has the advice.
        """
        raise TypeError(
            f"a {type(self).__name__} must not be pickled or copied, because it holds device arrays; "
            f"{self._instead}"
        )
