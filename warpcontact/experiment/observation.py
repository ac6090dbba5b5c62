"""Settings of the simulation of an experiment: integrator, outcomes, stop conditions, events, recording and output."""

import inspect
from collections.abc import Callable, Iterable
from functools import cache, partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, cast

from pydantic import (
    AfterValidator,
    Field,
    PlainValidator,
    SerializeAsAny,
    ValidationInfo,
    create_model,
    model_validator,
)

from warpcontact.experiment import quantities as q
from warpcontact.experiment.catalogue import Section, user_class
from warpcontact.experiment.errors import Problems, abbreviated, key_path
from warpcontact.experiment.user_code import UserFiles
from warpcontact.forces.nonsmooth.materials import IMPACT_LAWS
from warpcontact.kernels.catalogue.names import stored_name, suggestion
from warpcontact.kernels.outcomes.base import COMPONENTS, OfContact, Outcome
from warpcontact.kernels.outcomes.source import EACH, ITEM_REDUCTIONS
from warpcontact.model.environments import Environments
from warpcontact.scene.couplings import Bushing, Catenary, SpringDamper
from warpcontact.scene.scene_data import MAX_DISTANCE, MAX_SPEED
from warpcontact.stepping import outcomes
from warpcontact.stepping.integrators import INTEGRATORS, Integrator
from warpcontact.stepping.integrators.moreau_jean import RECOVERY_TIME, SOLVERS, THETA, TOLERANCE
from warpcontact.stepping.outcomes.observer import sources_of
from warpcontact.stepping.outcomes.sources import SourceResolver
from warpcontact.stepping.outcomes.watch import LASTING, POLICIES, RESERVED, ContactEvents, StopCondition
from warpcontact.stepping.simulation import Simulation
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.validation import checks
from warpcontact.validation.checks import limits

# Default sensors of couplings.
_COUPLING_SENSORS: dict[type, tuple[str, str]] = {
    SpringDamper: ("length", "force"),
    Bushing: ("displacement", "force"),
    Catenary: ("tension_a", "tension_b"),
}

# Default number of intervals between frames.
DEFAULT_FRAMES = 100

if TYPE_CHECKING:
    from warpcontact.experiment.schema import Settings

_NUMBER = limits("-")
_Sensor = Annotated[str, AfterValidator(stored_name)]
_COMPONENT = Annotated[str | None, q.one_of(tuple(COMPONENTS))]
_ITEMS = Annotated[str, q.one_of(ITEM_REDUCTIONS)]
_LIMIT = Annotated[float | None, q.numbers((), allowed=_NUMBER)]


class IntegratorSettings(Section):
    """``[integrator]``: the time integrator. All keys but ``type`` are those of ``MoreauJean``."""

    type: Annotated[str, q.one_of(tuple(INTEGRATORS))] = "SemiImplicitEuler"
    theta: Annotated[float | None, q.numbers((), allowed=THETA)] = None
    solver: Annotated[str | None, q.one_of(tuple(SOLVERS))] = None
    iterations: int | None = Field(default=None, ge=1)
    tolerance: Annotated[float | None, q.numbers((), allowed=TOLERANCE)] = None
    recovery_time: Annotated[float | None, q.numbers((), allowed=RECOVERY_TIME)] = None
    impacts: Annotated[str | None, q.one_of(IMPACT_LAWS)] = None
    compliant: Annotated[tuple[str, ...] | None, Field(strict=False)] = None

    def make(self) -> Integrator:
        """Returns the integrator."""
        return INTEGRATORS[self.type](**self.model_dump(exclude={"type"}, exclude_none=True))

    @model_validator(mode="after")
    def _check_keys(self) -> "IntegratorSettings":
        given = list(self.model_dump(exclude={"type"}, exclude_none=True))
        if given and self.type != "MoreauJean":
            raise ValueError(f": {', '.join(given)} requires type = 'MoreauJean', got {self.type!r}")
        return self


def default_interval(settings: "Settings") -> float:
    """Returns the default time between frames [s]."""
    steps = max(1, round(settings.duration / settings.dt / DEFAULT_FRAMES))
    return float(f"{steps * settings.dt:.12g}")


def default_sensors(model: Environments, *, with_gap: bool = False) -> list[str]:
    """Returns the default sensors: the most important ones of each element, and the kinetic energy of the scene.

    Args:
        model: The model.
        with_gap: Whether to include gaps of point contacts without contact, which require a search.
    """
    scene = model.scene
    depth = "gap" if with_gap else "penetration"
    sensors: list[tuple[str, tuple[str, ...]]]
    sensors = [(contact.name, (depth, "normal_force")) for contact in scene.contacts if contact.points.single]
    sensors += [(contact.name, ("gap", "normal_force")) for contact in scene.shape_contacts if contact.single]
    sensors += [(contact.name, ("contacts", "max_penetration")) for contact in scene.particle_contacts]
    sensors += [(contact.name, ("depth", "normal_force")) for contact in scene.body_contacts if contact.single]
    sensors += [(coupling.name, _COUPLING_SENSORS[type(coupling)]) for coupling in scene.couplings]
    sensors += [(coupling.name, ("minimum_distance", "force")) for coupling in scene.contact_couplings]
    sensors += [(element.name, element.recorded) for element in scene.force_elements]
    # For sets only sums over all items are recorded by default.
    joints = [f"{body.name}.{key}" for body in scene.bodies if body.single for key in ("angle", "displacement")]
    names = [f"{name}.{key}" for name, keys in sensors for key in keys]
    return names + [name for name in joints if name in model.sensor_names] + ["scene.kinetic_energy"]


class OutcomeSettings(Section):
    """An entry of ``[outcome]``: its class, by name or as ``FILE.py:CLASS``, and its sensor or contact."""

    outcome: ClassVar[type[Outcome]]
    type: str
    of: _Sensor = Field(min_length=1, description="the name of a sensor, or of a contact")

    def make(self) -> Outcome:
        """Returns the outcome."""
        return self.outcome(self.of, **self.model_dump(exclude={"type", "of"}, exclude_none=True))

    @model_validator(mode="after")
    def _complete(self) -> "OutcomeSettings":
        try:
            self.make()
        except (TypeError, ValueError) as error:  # for example from invalid ``above`` and ``below``
            raise ValueError(f": {error}") from None
        return self


class StopSettings(Section):
    """An entry of ``[stop]``."""

    of: _Sensor = Field(min_length=1, description="the name of a sensor")
    component: _COMPONENT = None
    items: _ITEMS = EACH
    above: _LIMIT = None
    below: _LIMIT = None
    lasting: Annotated[float, q.numbers((), allowed=LASTING)] = 0.0

    def make(self) -> StopCondition:
        """Returns the condition."""
        return StopCondition(self.of, **self.model_dump(exclude={"of"}, exclude_none=True))

    @model_validator(mode="after")
    def _one_limit(self) -> "StopSettings":
        try:
            self.make()
        except ValueError as error:
            raise ValueError(f": {error}") from None
        return self


class EventsSettings(Section):
    """``[events]``: contacts whose start and end times are recorded."""

    contacts: Annotated[tuple[str, ...], Field(strict=False)] = Field(description="a list of names of contacts")
    most: int = Field(default=32, ge=1)

    def make(self) -> ContactEvents:
        """Returns the events."""
        return ContactEvents(self.contacts, self.most)

    @model_validator(mode="after")
    def _some(self) -> "EventsSettings":
        try:
            self.make()
        except ValueError as error:
            raise ValueError(f": {error}") from None
        return self


class RecordSettings(Section):
    """``[record]``: recorded sensors and the interval between frames."""

    every: Annotated[float | None, q.time] = None
    sensors: Annotated[tuple[str, ...], Field(strict=False)] | None = None
    series: bool = True


class OutputSettings(Section):
    """``[output]``: files that are written in addition to the recording."""

    usd_envs: int = Field(default=16, ge=0)


class QuarantineSettings(Section):
    """``[quarantine]``: limits beyond which an environment fails, and the policy for failed environments."""

    policy: Annotated[str, q.one_of(POLICIES)] = "freeze"
    max_speed: Annotated[float | None, q.numbers((), allowed=MAX_SPEED)] = None
    max_distance: Annotated[float | None, q.numbers((), allowed=MAX_DISTANCE)] = None

    @property
    def limits(self) -> dict[str, float]:
        """The given limits of the scene, by name."""
        return self.model_dump(include={"max_speed", "max_distance"}, exclude_none=True)


def outcome_model(value: Any, user_files: UserFiles) -> type[OutcomeSettings]:
    """Returns the pydantic model of the table of an outcome.

    Args:
        value: The table of the file.
        user_files: Files with user-defined classes.

    Raises:
        ValueError: If the table is invalid; the message continues the key.
    """
    listed = f"one of {', '.join(outcomes.OUTCOMES)}, or FILE.py:CLASS"
    if not isinstance(value, dict):
        hint = f"; write {{ type = {value!r}, of = … }}" if value in outcomes.OUTCOMES else ""
        raise ValueError(f"must be a table, got {abbreviated(value)}{hint}")
    if "type" not in value:
        raise ValueError(f".type is missing: {listed}")
    given = value["type"]
    if isinstance(given, str) and given in outcomes.OUTCOMES:
        return _settings_model(outcomes.OUTCOMES[given])
    file, name = user_class(given)
    if file:
        try:
            return _settings_model(user_files.find(file, name, Outcome))
        except ValueError as error:
            raise ValueError(f".type{error}") from None
    raise ValueError(f".type must be {listed}, got {abbreviated(given)}{suggestion(given, outcomes.OUTCOMES)}")


@cache
def _settings_model(outcome: type[Outcome]) -> type[OutcomeSettings]:
    """Returns the pydantic model of the tables of an outcome class."""
    fields: dict[str, Any] = {}
    if not issubclass(outcome, OfContact):
        fields = {"component": (_COMPONENT, None), "items": (_ITEMS, EACH)}
    if outcome.conditional:
        fields |= {"above": (_LIMIT, None), "below": (_LIMIT, None)}
    model = create_model(f"{outcome.__name__}_settings", __base__=OutcomeSettings, **fields)
    model.__doc__ = inspect.getdoc(outcome)
    model.outcome = outcome
    return model


def _outcome(value: Any, info: ValidationInfo) -> OutcomeSettings:
    user_files = cast(UserFiles, info.context)
    return outcome_model(value, user_files).model_validate(value, context=user_files)


OutcomeTable = Annotated[SerializeAsAny[OutcomeSettings], PlainValidator(_outcome)]


def monitor_arguments(settings: "Settings") -> dict[str, Any]:
    """Returns the outcomes, stop conditions, events and quarantine policy as arguments of ``Simulation``."""
    return {
        "outcomes": {name: one.make() for name, one in settings.outcome.items()},
        "stop": {name: one.make() for name, one in settings.stop.items()},
        "events": None if settings.events is None else settings.events.make(),
        "quarantine": settings.quarantine.policy,
    }


def make_simulation(model: Environments, settings: "Settings", threads: int | None = None) -> Simulation:
    """Returns the simulation of an experiment."""
    return Simulation(
        model,
        dt=settings.dt,
        integrator=settings.integrator.make(),
        crossing_substeps=settings.crossing_substeps,
        threads=threads,
        **monitor_arguments(settings),
    )


def check_monitors(
    model: Environments,
    integrator: Integrator,
    settings: "Settings",
    problems: Problems,
    is_invalid: Callable[[str], bool],
) -> None:
    """Checks that the sensors and contacts of outcomes, stop conditions and events exist.

    Args:
        model: A model of the scene.
        integrator: Integrator of the experiment.
        settings: The experiment.
        problems: Receives the problems.
        is_invalid: Returns whether a sensor belongs, or may belong, to an element with reported problems.
    """
    part = model.parts[0]
    resolver = SourceResolver(part, integrator.declare(part, AllocationPlan(part.device)))

    def check(path: str, names: Iterable[str], find: Callable[[], Any]) -> None:
        if any(is_invalid(name) for name in names):
            return
        try:
            find()
        except (KeyError, ValueError) as error:
            problems.add(path, error.args[0])

    for name, entry in settings.outcome.items():
        path, outcome = key_path(["outcome", name]), entry.make()
        if _is_valid_name(path, name, problems):
            check(path, [one.name for one in outcome.sources], partial(sources_of, resolver, "", outcome))
    for name, stop in settings.stop.items():
        path, source = key_path(["stop", name]), stop.make().source
        if _is_valid_name(path, name, problems):
            check(path, [source.name], partial(resolver.resolve_scalar, "", source))
    for i, name in enumerate(() if settings.events is None else settings.events.contacts):
        check(f"events.contacts[{i}]", [f"{name}.penetration"], partial(resolver.contact_indicator, "", name))


def _is_valid_name(path: str, name: str, problems: Problems) -> bool:
    """Checks the name of an outcome or a stop condition."""
    if name in RESERVED:
        problems.add(path, f": {name!r} is the name of a variable that every result has; choose another")
        return False
    try:
        checks.key("", name)
    except ValueError as error:
        problems.add(path, str(error))
        return False
    return True
