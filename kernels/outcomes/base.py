"""Base classes of outcomes: scalars per environment, reduced from sensors over time."""

import math
from collections.abc import Sequence
from numbers import Real
from typing import Any, ClassVar, NamedTuple

import warp as wp
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.catalogue.names import stored_name
from warpcontact.kernels.outcomes.source import EACH, ITEM_REDUCTIONS, MAX_SOURCES

#: Components of a vector sensor, and their indices.
COMPONENTS = {"x": 0, "y": 1, "z": 2, "w": 3, "norm": None}


class Source(NamedTuple):
    """A sensor and how its values are selected.

    Attributes:
        name: Name of the sensor.
        component: One of ``COMPONENTS``; ``None``: all components.
        items: Reduction over the items of a set, one of ``ITEM_REDUCTIONS``.
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
    """Returns the source after checking the arguments.

    Raises:
        TypeError: If ``of`` is not a string.
        ValueError: If ``component`` or ``items`` is not an allowed value.
    """
    if not isinstance(of, str):
        raise TypeError(f"{owner}.of must be the name of a sensor, such as 'touch.normal_force', got {of!r}")
    for key, value, known in (("component", component, tuple(COMPONENTS)), ("items", items, tuple(folds))):
        if value not in known and not (key == "component" and value is None):
            raise ValueError(f"{owner}.{key} must be one of {', '.join(map(repr, known))}, got {value!r}")
    return Source(stored_name(of), component, items)


def condition_of(owner: str, above: object, below: object) -> Condition:
    """Returns the condition after checking its limit.

    Raises:
        TypeError: If the limit is not a number.
        ValueError: If no limit or both limits are given, or the limit is not finite.
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
    """Reduction of a sensor over time to one number per environment, component and item.

    A subclass declares its initial memory and two device functions in float64::

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

    ``update`` returns the memory ``m`` after the value ``x`` at ``time`` [s], for the step of ``dt`` [s] that
    begins there. For a result, the current state is added with ``dt`` = 0 to a copy of the memory, because steps
    may follow. ``result`` returns the outcome.

    Args:
        of: Name of the sensor.
        component: Component of a vector: ``"x"``, ``"y"``, ``"z"``, ``"w"`` or ``"norm"``; ``None``: one result
            each.
        items: Items of a set: ``"each"``: one result each; ``"sum"``, ``"max"`` or ``"min"``: reduced at every
            instant.
        above: Limit of a ``conditional`` outcome: the condition holds above it. Exclusive with ``below``.
        below: Limit of a ``conditional`` outcome: the condition holds below it.

    Raises:
        TypeError: If ``of`` is not a string, or a limit is not a number.
        ValueError: If an argument is not allowed.
    """

    #: Initial values of the stored numbers.
    memory: ClassVar[tuple[float, ...]] = (0.0,)
    update: ClassVar[wp.Function]
    result: ClassVar[wp.Function]
    #: Whether there is a condition. ``x`` is then the distance from the limit, positive where the condition holds.
    conditional: ClassVar[bool] = False
    #: Whether ``update`` gets only the state at the end.
    at_end: ClassVar[bool] = False
    #: Description, to be followed by the name of the sensor.
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
            raise TypeError(f"{cls.__name__}.memory must be a tuple of numbers, its initial values")

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
        """Checks that the outcome is possible, given the names of the nonsmooth contacts.

        Raises:
            ValueError: If it is not.
        """

    def unit(self, of: str) -> str:
        """Returns the unit of the outcome, given that of its source."""
        return of

    def about(self) -> str:
        """Returns a description of the source."""
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
        """Description of the outcome."""
        return f"{self.meaning or type(self).__name__} {self.about()}"

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.about()}>"


@explain_keywords_of
class OfContact(Outcome, abstract=True):
    """Outcome of several sensors of one contact, ``quantities``. The argument is the name of the contact."""

    #: Sensors, each with its component.
    quantities: ClassVar[tuple[tuple[str, str | None], ...]]

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if not 1 <= len(cls.quantities) <= MAX_SOURCES:
            raise TypeError(
                f"{cls.__name__}.quantities must be 1 to {MAX_SOURCES} sensors, got {len(cls.quantities)}"
            )

    # No reduction over items, because a sum of products is not the product of sums.
    def __init__(self, contact: str) -> None:
        super().__init__(contact)
        self.contact = contact
        self.sources = tuple(Source(f"{contact}.{quantity}", component) for quantity, component in self.quantities)

    def about(self) -> str:
        """Returns a description of the source."""
        return self.contact
