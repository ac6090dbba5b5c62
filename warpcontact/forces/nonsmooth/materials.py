"""Materials of nonsmooth contacts: restitution and coefficients of friction from their contact materials."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.contact.impulse_records import record_structs
from warpcontact.kernels.friction import Friction, Frictionless
from warpcontact.kernels.laws import Law
from warpcontact.storage.parameters import DeviceField, Parameter, pack

#: Contacts with a gap below this are closed [m], by precision; above the rounding error for scenes of a few meters.
CONTACT_GAP = {wp.float32: 1.0e-6, wp.float64: 1.0e-9}
#: Laws of simultaneous impacts.
IMPACT_LAWS = ("simultaneous", "sequential")


class NamedContact(Protocol):
    """A contact of a scene, of any kind."""

    @property
    def name(self) -> str:
        """Name of the contact."""


def cone_coefficients(friction: Any) -> tuple[str, str] | None:
    """Returns the names of the static and dynamic coefficients of friction; ``None``: there is no friction."""
    return None if isinstance(friction, Frictionless) else friction.cone_coefficients()


def check_rigid(name: str, formulas: Mapping[str, Formula], remedy: str) -> None:
    """Checks that law and friction models of a contact can be used for nonsmooth contact.

    Args:
        name: Name of the contact.
        formulas: Its law and friction models, by name of the part.
        remedy: End of the message: an alternative.

    Raises:
        ValueError: If the law is adhesive, or a friction model has no coefficient. The message names the contact.
    """
    for part, formula in formulas.items():
        kind = type(formula).__name__
        if isinstance(formula, Law) and formula.pulls:
            raise ValueError(
                f"{name}.law must be a law that does not pull, got {kind} with pulls = True: rigid contact has no "
                f"tension. {remedy}"
            )
        if (
            isinstance(formula, Friction)
            and not isinstance(formula, Frictionless)
            and formula.cone_coefficients() is None
        ):
            raise ValueError(
                f"{name}.{part} is {kind}, which has no coefficient of friction for nonsmooth contact. Take a model "
                f"with mu, such as wc.friction.Coulomb. {remedy}"
            )


@dataclass(frozen=True)
class NonsmoothSource:
    """A nonsmooth contact as source of materials.

    Attributes:
        contact: The contact.
        formulas: Its law and friction models, by name of the part.
        count: Number of its materials: one per item; 1 for a particle contact.
    """

    contact: NamedContact
    formulas: Mapping[str, Formula]
    count: int

    def parameter_paths(self) -> dict[str, tuple[str, str] | None]:
        """Returns part and parameter of each entry of the material; ``None``: the entry is 0."""
        law = self.formulas["law"].parameters()
        table: dict[str, tuple[str, str] | None] = {
            "restitution": ("law", "restitution") if "restitution" in law else None
        }
        names = {"mu_static": "friction", "mu_dynamic": "friction", "rolling": "rolling", "spinning": "torsion"}
        for key, part in names.items():
            coefficients = cone_coefficients(self.formulas[part])
            table[key] = (part, coefficients[key != "mu_static"]) if coefficients else None
        # Only rigid laws have a compliance of nonsmooth contact.
        soft = self.formulas["law"].rigid and "compliance" in law
        table["compliance"] = ("law", "compliance") if soft else None
        return table

    def resolved(self, parameters: Mapping[str, Parameter]) -> dict[str, Parameter | None]:
        """Returns the parameter of each entry of the material; ``None``: the entry is 0."""
        return {
            key: None if source is None else parameters[f"{self.contact.name}.{source[0]}.{source[1]}"]
            for key, source in self.parameter_paths().items()
        }


def parameters_of(
    nonsmooth: Sequence[NonsmoothSource], parameters: Mapping[str, Parameter]
) -> Iterator[Parameter]:
    """Yields the parameters from which the materials of all contacts are computed."""
    tables = (one.resolved(parameters).values() for one in nonsmooth)
    return (parameter for table in tables for parameter in table if parameter is not None)


def material_upload(
    target: Any,
    nonsmooth: Sequence[NonsmoothSource],
    parameters: Mapping[str, Parameter],
    device: wp.Device,
    real: type,
) -> DeviceField:
    """Returns the device field ``target.material`` with the materials of all contacts."""
    struct = record_structs(real).NonsmoothMaterial
    own = [one.resolved(parameters) for one in nonsmooth]

    def content() -> NDArray[Any]:
        columns: dict[str, list[NDArray[Any]]] = {name: [] for name in struct.vars}
        resolved = [parameter for table in own for parameter in table.values() if parameter is not None]
        envs = max((len(parameter.field.values) for parameter in resolved), default=1)
        for one, table in zip(nonsmooth, own, strict=True):
            for key, parameter in table.items():
                values = np.zeros((1, 1)) if parameter is None else parameter.field.values[:, parameter.items]
                columns[key].append(np.broadcast_to(values, (envs, one.count)))
        if not nonsmooth:
            return pack(struct, {name: np.zeros((1, 1)) for name in columns})
        return pack(struct, {name: np.concatenate(parts, axis=1) for name, parts in columns.items()})

    return DeviceField(target, "material", struct, content, device)
