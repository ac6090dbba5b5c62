"""What nonsmooth contacts take from their materials: Newton's restitution and the coefficients of Coulomb's cone."""

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

#: Gaps below this are closed [m], by precision: more than rounding leaves of bodies of a few meters.
CONTACT_GAP = {wp.float32: 1.0e-6, wp.float64: 1.0e-9}
#: Laws of multiple impacts: how contacts that are hit together bounce.
IMPACT_LAWS = ("simultaneous", "sequential")


class NamedContact(Protocol):
    """A contact of a scene, of whatever kind."""

    @property
    def name(self) -> str:
        """Its name."""


def cone_coefficients(friction: Any) -> tuple[str, str] | None:
    """Returns the names of the coefficients at rest and in motion; ``None``: there is no friction."""
    return None if isinstance(friction, Frictionless) else friction.cone_coefficients()


def check_rigid(name: str, formulas: Mapping[str, Formula], remedy: str) -> None:
    """Checks that law and friction of a contact have a meaning between rigid bodies.

    Args:
        name: Name of the contact.
        formulas: Its law and friction models by the name of their part.
        remedy: Ends the message: what to use instead.

    Raises:
        ValueError: If the law pulls, or a friction model has no coefficient of friction; names the contact.
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
    """A contact that is hard, and how many materials it has on the device.

    Attributes:
        contact: The contact.
        formulas: Its law and friction models by the name of their part.
        count: Number of its items; 1 for all pairs of a particle contact.
    """

    contact: NamedContact
    formulas: Mapping[str, Formula]
    count: int

    def parameter_paths(self) -> dict[str, tuple[str, str] | None]:
        """Returns the part and the parameter that each number of the material is taken from, ``None``: it is 0."""
        table: dict[str, tuple[str, str] | None] = {"restitution": None}
        if "restitution" in self.formulas["law"].parameters():
            table["restitution"] = ("law", "restitution")
        names = {"mu_static": "friction", "mu_dynamic": "friction", "rolling": "rolling", "spinning": "torsion"}
        for key, part in names.items():
            coefficients = cone_coefficients(self.formulas[part])
            table[key] = (part, coefficients[key != "mu_static"]) if coefficients else None
        return table

    def resolved(self, parameters: Mapping[str, Parameter]) -> dict[str, Parameter | None]:
        """Returns the parameter that each number of the material is taken from."""
        return {
            key: None if source is None else parameters[f"{self.contact.name}.{source[0]}.{source[1]}"]
            for key, source in self.parameter_paths().items()
        }


def parameters_of(
    nonsmooth: Sequence[NonsmoothSource], parameters: Mapping[str, Parameter]
) -> Iterator[Parameter]:
    """Iterates over the parameters that the materials of all contacts are taken from."""
    tables = (one.resolved(parameters).values() for one in nonsmooth)
    return (parameter for table in tables for parameter in table if parameter is not None)


def material_upload(
    target: Any,
    nonsmooth: Sequence[NonsmoothSource],
    parameters: Mapping[str, Parameter],
    device: wp.Device,
    real: type,
) -> DeviceField:
    """Returns what puts the materials of all contacts into ``target.material``."""
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
