"""Settings of monitors: outcomes, stop conditions, contact events and the quarantine policy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.outcomes.base import Condition, Outcome, Source, condition_of, source_of
from warpcontact.kernels.outcomes.source import EACH
from warpcontact.validation import checks
from warpcontact.validation.checks import limits

#: Policies for failed environments.
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
    """A condition that stops an environment at the first state at which it holds, or has held for ``lasting``.

    Args:
        of: Name of a sensor. A vector requires ``component``, a sensor with several items ``items``.
        component: ``"x"``, ``"y"``, ``"z"``, ``"w"`` or ``"norm"`` of a vector.
        items: Reduction over items: ``"sum"``, ``"max"`` or ``"min"``.
        above: The condition holds if the sensor is above this value. Give either ``above`` or ``below``.
        below: The condition holds if the sensor is below this value.
        lasting: Time for which it must hold without interruption [s]. Default: 0.

    Raises:
        ValueError: If an argument is out of range.
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
    """Start and end times of contacts: the times of the first states in and out of contact.

    Args:
        contacts: Names of the contacts. The items of a set are recorded separately.
        most: Maximum number of stored events per environment. Later events overwrite the oldest ones, which are
            counted in ``events_missed``.

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
            raise ValueError(f"ContactEvents.contacts must be one or more names of contacts, got {contacts!r}")
        if len(set(self.contacts)) < len(self.contacts):
            raise ValueError(f"ContactEvents.contacts must be different contacts, got {list(self.contacts)}")
        self.most = checks.integer("ContactEvents.most", most)

    def __repr__(self) -> str:
        return f"<ContactEvents of {', '.join(self.contacts)}, the last {self.most}>"


@dataclass(frozen=True)
class MonitorSettings:
    """Monitor settings of a simulation.

    Attributes:
        outcomes: Outcomes by name.
        stops: Stop conditions by name. If several hold, the first one is reported.
        events: Contacts whose events are recorded. ``None``: none.
        quarantine: Policy for failed environments, one of ``POLICIES``.
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
                raise ValueError(f"outcomes: {name!r} is a reserved name; choose another")
        if self.events is not None and not isinstance(self.events, ContactEvents):
            raise TypeError(f"events must be like wc.ContactEvents(['touch']), got {self.events!r}")

    @classmethod
    def of(
        cls,
        outcomes: Mapping[str, Outcome] | None,
        stop: Mapping[str, StopCondition] | None,
        events: ContactEvents | None,
        quarantine: str,
    ) -> "MonitorSettings":
        """Returns the settings for arguments of ``Simulation``.

        Raises:
            TypeError: If an argument has the wrong type.
            ValueError: If a name or the policy is not allowed.
        """
        return cls({} if outcomes is None else outcomes, {} if stop is None else stop, events, quarantine)

    def __bool__(self) -> bool:
        """Returns whether a ``Monitor`` is needed."""
        return bool(self.outcomes or self.stops or self.events is not None or self.quarantine == "reset")


def _check_names(what: str, table: object, kind: type, example: str) -> None:
    if not isinstance(table, Mapping):
        raise TypeError(f"{what} must be a dictionary, such as {{'name': {example}}}, got {table!r}")
    for name, one in table.items():
        checks.key(what, name)
        if not isinstance(one, kind):
            raise TypeError(f"{what}[{name!r}] must be like {example}, got {_describe(one)}")


def _describe(value: Any) -> str:
    return f"the class {value.__name__}; call it" if isinstance(value, type) else repr(value)
