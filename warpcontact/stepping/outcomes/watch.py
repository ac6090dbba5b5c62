"""What a simulation is asked to watch: outcomes, stop conditions, events, and what becomes of failures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.outcomes.base import Condition, Outcome, Source, condition_of, source_of
from warpcontact.kernels.outcomes.source import EACH
from warpcontact.validation import checks
from warpcontact.validation.checks import limits

#: What is done with an environment that failed.
POLICIES = ("freeze", "reset", "raise")
LASTING = limits("s", at_least=0.0)
#: Names of variables that every data set of outcomes has.
RESERVED = (
    "status",
    "cause",
    "end_time",
    "resets",
    "stopped_by",
    "events_missed",
    "env",
    "item",
    "axis",
    "component",
)


@explain_keywords_of
class StopCondition:
    """A condition that stops an environment: it is held at the first state at which it holds, or has for a while.

    Args:
        of: Name of a sensor; of a set or a vector, ``items`` or ``component`` make it one number.
        component: ``"x"``, ``"y"``, ``"z"``, ``"w"`` or ``"norm"`` of a vector.
        items: ``"sum"``, ``"max"`` or ``"min"`` of the items of a set.
        above: The condition: the sensor is above this ...
        below: ... or below this; one of both.
        lasting: How long it has to hold without a break [s].

    Raises:
        ValueError: If an argument is not allowed.
    """

    source: Source
    condition: Condition
    lasting: float

    def __init__(
        self,
        of: str,
        *,
        component: str | None = None,
        items: str = EACH,
        above: float | None = None,
        below: float | None = None,
        lasting: float = 0.0,
    ) -> None:
        self.source = source_of("StopCondition", of, component, items)
        self.condition = condition_of("StopCondition", above, below)
        self.lasting = float(checks.numbers("lasting", lasting, (), LASTING))

    def __repr__(self) -> str:
        sign = "above" if self.condition.sign > 0.0 else "below"
        component = "" if self.source.component is None else f" {self.source.component}"
        return f"<StopCondition where {self.source.name}{component} is {sign} {self.condition.limit:g}>"


@explain_keywords_of
class ContactEvents:
    """When contacts are made and lost, by the times of the first states in and out of contact.

    Args:
        contacts: Names of the contacts to watch, each item of a set by itself.
        most: ContactEvents that are kept for each environment; later ones take the places of the first, and those are
            counted.

    Raises:
        ValueError: If an argument is not allowed.
    """

    contacts: tuple[str, ...]
    most: int

    def __init__(self, contacts: Sequence[str], most: int = 32) -> None:
        if isinstance(contacts, str):
            raise TypeError(
                f"ContactEvents.contacts must be a list of names of contacts, got the string {contacts!r}"
            )
        self.contacts = tuple(contacts)
        if not self.contacts or not all(isinstance(name, str) for name in self.contacts):
            raise ValueError(f"ContactEvents.contacts must be one name of a contact or more, got {contacts!r}")
        if len(set(self.contacts)) < len(self.contacts):
            raise ValueError(f"ContactEvents.contacts must be different contacts, got {list(self.contacts)}")
        self.most = checks.integer("ContactEvents.most", most)

    def __repr__(self) -> str:
        return f"<ContactEvents of {', '.join(self.contacts)}, the last {self.most}>"


@dataclass(frozen=True)
class MonitorSettings:
    """What to watch while stepping.

    Attributes:
        outcomes: By name.
        stops: Conditions by name; the first in order wins.
        events: Of which contacts; ``None``: none.
        quarantine: One of ``POLICIES``.
    """

    outcomes: Mapping[str, Outcome] = field(default_factory=dict)
    stops: Mapping[str, StopCondition] = field(default_factory=dict)
    events: ContactEvents | None = None
    quarantine: str = "freeze"

    def __post_init__(self) -> None:
        checks.choice("quarantine", self.quarantine, POLICIES)
        _check_names("outcomes", self.outcomes, Outcome, "wc.outcomes.Max('touch.normal_force')")
        _check_names(
            "stop", self.stops, StopCondition, "wc.StopCondition('ball.position', component='z', below=0.1)"
        )
        for name in self.outcomes:
            if name in RESERVED:
                raise ValueError(f"outcomes: {name!r} is the name of what every result has; choose another")
        if self.events is not None and not isinstance(self.events, ContactEvents):
            raise TypeError(f"events must be such as wc.ContactEvents(['touch']), got {self.events!r}")

    @classmethod
    def of(
        cls,
        outcomes: Mapping[str, Outcome] | None,
        stop: Mapping[str, StopCondition] | None,
        events: ContactEvents | None,
        quarantine: str,
    ) -> "MonitorSettings":
        """Returns what the arguments of a ``Simulation`` ask for.

        Raises:
            TypeError: If one is not of its type.
            ValueError: If a name or the policy is not allowed.
        """
        return cls({} if outcomes is None else outcomes, {} if stop is None else stop, events, quarantine)

    def __bool__(self) -> bool:
        """Whether anything is to be kept beside the model."""
        return bool(self.outcomes or self.stops or self.events is not None or self.quarantine == "reset")


def _check_names(what: str, table: object, kind: type, example: str) -> None:
    if not isinstance(table, Mapping):
        raise TypeError(f"{what} must be a dictionary, such as {{'name': {example}}}, got {table!r}")
    for name, one in table.items():
        checks.key(what, name)
        if not isinstance(one, kind):
            raise TypeError(f"{what}[{name!r}] must be such as {example}, got {_describe(one)}")


def _describe(value: Any) -> str:
    return f"the class {value.__name__}; call it" if isinstance(value, type) else repr(value)
