"""Settings of the integrator in the experiment file."""

from typing import Annotated

from pydantic import Field, model_validator

from warpcontact.experiment import quantities as q
from warpcontact.experiment.catalogue import Section
from warpcontact.forces.nonsmooth.materials import IMPACT_LAWS
from warpcontact.stepping.integrators import INTEGRATORS, Integrator
from warpcontact.stepping.integrators.moreau_jean import RECOVERY_TIME, SOLVERS, THETA, TOLERANCE


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
