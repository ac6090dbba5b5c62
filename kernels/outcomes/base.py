"""The contract of an outcome: a few numbers that sum up a sensor over time."""

import math
from collections.abc import Sequence
from numbers import Real
from typing import Any, ClassVar, NamedTuple

import warp as wp
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.catalogue.names import stored_name
from warpcontact.kernels.outcomes.source import EACH, ITEM_REDUCTIONS, MAX_SOURCES

#: What may be taken of a sensor that is a vector, and which of its numbers that is.
COMPONENTS = {"x": 0, "y": 1, "z": 2, "w": 3, "norm": None}


class Source(NamedTuple):
    """A sensor as it is looked at.

    Attributes:
        name: Its name.
        component: One of ``COMPONENTS``; ``None``: all of it.
        items: What becomes of the items of a set, one of ``ITEM_REDUCTIONS``.
    """

    name: str
    component: str | None = None
    items: str = EACH


class Condition(NamedTuple):
    """x > ``limit`` with ``sign`` 1, x < ``limit`` with −1: ``sign`` (x − ``limit``) > 0."""

    limit: float
    sign: float


def source_of(
    owner: str, of: object, component: object, items: object, folds: Sequence[str] = ITEM_REDUCTIONS
) -> Source:
    """Checks what a user says of a source.

    Raises:
        TypeError: If ``of`` is no text.
        ValueError: If ``component`` or ``items`` is not one of what there is.
    """
    if not isinstance(of, str):
        raise TypeError(f"{owner}.of must be the name of a sensor, such as 'touch.normal_force', got {of!r}")
    for key, value, known in (("component", component, tuple(COMPONENTS)), ("items", items, tuple(folds))):
        if value not in known and not (key == "component" and value is None):
            raise ValueError(f"{owner}.{key} must be one of {', '.join(map(repr, known))}, got {value!r}")
    return Source(stored_name(of), component, items)


def condition_of(owner: str, above: object, below: object) -> Condition:
    """Checks the one limit that a condition has.

    Raises:
        TypeError: If it is no number.
        ValueError: If there are none or two, or it is not finite.
    """
    if (above is None) == (below is None):
        got = "neither" if above is None else f"above={above!r} and below={below!r}"
        raise ValueError(f"{owner} takes either above or below, got {got}")
    key, value = ("below", below) if above is None else ("above", above)
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{owner}.{key} must be a number, got {value!r}")
    if not math.isfinite(value):
        raise ValueError(f"{owner}.{key} must be finite, got {value}")
    return Condition(float(value), 1.0 if above is not None else -1.0)


@explain_keywords_of
class Outcome:
    """A sensor summed up over time, by a few numbers that are kept for each environment.

    A subclass says what it starts from, and has two device functions in float64::

        class MeanSquare(wc.Outcome):
            \"\"\"Mean of the squares over time.\"\"\"

            memory = (0.0, 0.0)

            @wp.func
            def update(m: Any, x: Any, time: Any, dt: Any):
                m[0] += x * x * dt
                m[1] += dt
                return m

            @wp.func
            def result(m: Any, time: Any):
                return m[0] / m[1]

    ``update`` returns the memory ``m`` after ``x`` was seen at ``time`` [s], for the step of ``dt`` [s] that
    begins there. The last state of all is seen with ``dt`` = 0 whenever results are asked for, and then forgotten,
    as steps may follow. ``result`` returns the outcome.

    Args:
        of: Name of the sensor.
        component: Of a vector: ``"x"``, ``"y"``, ``"z"``, ``"w"`` or ``"norm"``; ``None``: each has a result.
        items: Of a set: ``"each"`` item has a result, or the ``"sum"``, ``"max"`` or ``"min"`` of them all at
            every instant is looked at.
        above: With a ``conditional`` outcome: where the sensor is above this ...
        below: ... or below this; one of both.

    Raises:
        ValueError: If an argument is not allowed.
    """

    #: Numbers that are kept, and what they are at the start.
    memory: ClassVar[tuple[float, ...]] = (0.0,)
    update: ClassVar[wp.Function]
    result: ClassVar[wp.Function]
    #: Whether there is a condition: ``x`` is then by how much it holds, above 0 where it does.
    conditional: ClassVar[bool] = False
    #: Whether the state at the end is all that counts; ``update`` sees no other.
    at_end: ClassVar[bool] = False
    #: What it is, before the name of the sensor.
    meaning: ClassVar[str] = ""

    sources: tuple[Source, ...]
    condition: Condition

    def __init_subclass__(cls, *, abstract: bool = False, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if abstract:
            return
        for name in ("update", "result"):
            if not isinstance(getattr(cls, name, None), wp.Function):
                raise TypeError(f"{cls.__name__}.{name} must be a device function: decorate it with @wp.func")
        memory = cls.memory
        if not isinstance(memory, tuple) or not memory or not all(isinstance(one, Real) for one in memory):
            raise TypeError(f"{cls.__name__}.memory must be a tuple of numbers, what is kept at the start")

    def __init__(
        self,
        of: str,
        *,
        component: str | None = None,
        items: str = EACH,
        above: float | None = None,
        below: float | None = None,
    ) -> None:
        owner = type(self).__name__
        self.sources = (source_of(owner, of, component, items),)
        if self.conditional:
            self.condition = condition_of(owner, above, below)
        elif above is not None or below is not None:
            raise ValueError(f"{owner} has no condition, and takes neither above nor below")
        else:
            self.condition = Condition(0.0, 1.0)

    def check(self, nonsmooth: frozenset[str]) -> None:
        """Checks that it can be had of a scene, given the names of the contacts that are hard.

        Raises:
            ValueError: If not.
        """

    def unit(self, of: str) -> str:
        """Returns its unit, given that of its source."""
        return of

    def about(self) -> str:
        """Returns what it is of, in words."""
        of = self.sources[0]
        text = of.name if of.component is None else f"{of.name} {of.component}"
        if of.items != EACH:
            text = f"{of.items} of all items of {text}"
        if self.conditional:
            sign = "above" if self.condition.sign > 0.0 else "below"
            text += f" {sign} {self.condition.limit:g}"
        return text

    @property
    def long_name(self) -> str:
        """What it is, in words."""
        return f"{self.meaning or type(self).__name__} {self.about()}"

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.about()}>"


@explain_keywords_of
class OfContact(Outcome, abstract=True):
    """An outcome of several sensors of one contact, ``quantities``; the argument is the name of the contact."""

    #: Sensors, each with its component.
    quantities: ClassVar[tuple[tuple[str, str | None], ...]]

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if not 1 <= len(cls.quantities) <= MAX_SOURCES:
            raise TypeError(
                f"{cls.__name__}.quantities must be 1 to {MAX_SOURCES} sensors, got {len(cls.quantities)}"
            )

    # No items: sums of products are not products of sums.
    def __init__(self, contact: str) -> None:
        super().__init__(contact)
        self.contact = contact
        self.sources = tuple(Source(f"{contact}.{quantity}", component) for quantity, component in self.quantities)

    def about(self) -> str:
        """Returns what it is of, in words."""
        return self.contact
