"""Tables of the experiment file that follow from the catalogues: laws, frictions, meshes.

Their keys are the parameters of the classes and generators, with the ranges that are declared there.
"""

import dataclasses
import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Union, get_args

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, create_model, model_validator

from warpcontact import meshes
from warpcontact.checks import limits
from warpcontact.experiment import quantities as q
from warpcontact.kernels import frictions, laws
from warpcontact.kernels.formula import Formula

#: Meshes that need no file, by the name of their generator.
SHAPES: dict[str, Callable[..., meshes.Mesh]] = {
    shape.__name__: shape for shape in (meshes.grid, meshes.sinusoidal_terrain, meshes.box, meshes.icosphere)
}


class Section(BaseModel):
    """A table of the file. Unknown keys are errors, texts are no numbers, and nothing is NaN or infinite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class FileMesh(Section):
    """A mesh from a file, relative to the folder of the experiment."""

    file: str = Field(min_length=1, description="the mesh file")
    scale: Annotated[float, q.numbers((), allowed=limits("-", above=0.0))] = 1.0


class ShapeMesh(Section):
    """A generated mesh."""

    shape: str

    def make(self, name: str) -> meshes.Mesh:
        """Generates the mesh.

        Raises:
            ValueError: If a value is out of range; the message begins with its name.
        """
        return SHAPES[self.shape](**self.model_dump(exclude={"shape"}), name=name)


class FormulaSettings(Section):
    """A law or a friction: the name of its class, and its parameters."""

    formula: ClassVar[type[Formula]]
    type: str

    def make(self) -> Any:
        """Returns the law or friction."""
        return self.formula(**self.model_dump(exclude={"type"}, exclude_none=True))

    @model_validator(mode="after")
    def _complete(self) -> "FormulaSettings":
        try:
            self.make()  # which of its parameters go together only the formula knows
        except ValueError as error:
            raise ValueError(f": {error}") from None
        return self


def _shape_model(name: str, generator: Callable[..., meshes.Mesh]) -> type[ShapeMesh]:
    fields: dict[str, Any] = {"shape": (Literal[name], ...)}
    for key, parameter in inspect.signature(generator).parameters.items():
        if key == "name":
            continue
        kind, default = parameter.annotation, parameter.default
        if get_args(kind):  # a tuple of numbers
            count = len(get_args(kind))
            whole = get_args(kind)[0] is int
            kind = Annotated[kind, q.whole_numbers(count) if whole else q.numbers((count,))]
        elif kind is float:
            kind = Annotated[float, q.numbers(())]
        fields[key] = (kind, default)
    return create_model(f"{name}_mesh", __base__=ShapeMesh, **fields)


def _formula_model(formula: type[Formula]) -> type[FormulaSettings]:
    fields: dict[str, Any] = {"type": (Literal[formula.__name__], ...)}
    for field in dataclasses.fields(formula):
        allowed = formula.limits(field.name)
        default = ... if field.default is dataclasses.MISSING else field.default
        fields[field.name] = (
            Annotated[float, q.numbers((), allowed=allowed)],
            Field(default, description=f"{allowed['meaning']} [{allowed['unit']}]"),
        )
    model = create_model(f"{formula.__name__}_settings", __base__=FormulaSettings, **fields)
    model.formula = formula
    return model


FILE = "file"


def _tagged(models: dict[str, type[Section]], key: str) -> Any:
    """Returns the union of ``models``, told apart by the value of ``key``.

    Their tags are in parentheses, so that ``errors`` can tell them from keys in the place of an error.
    """

    def tag(value: Any) -> str | None:
        if isinstance(value, Section):
            return f"({getattr(value, key, FILE)})"
        if not isinstance(value, dict):
            return None
        if key == "shape" and FILE in value:
            return f"({FILE})"
        return f"({value[key]})" if isinstance(value.get(key), str) else None

    parts = tuple(Annotated[model, Tag(f"({name})")] for name, model in models.items())
    return Annotated[Union[parts], Discriminator(tag)]  # noqa: UP007  made of a tuple


LAWS: dict[str, Any] = {law.__name__: _formula_model(law) for law in laws.CATALOGUE}
FRICTIONS: dict[str, Any] = {friction.__name__: _formula_model(friction) for friction in frictions.CATALOGUE}
MESHES: dict[str, Any] = {FILE: FileMesh} | {name: _shape_model(name, make) for name, make in SHAPES.items()}

if TYPE_CHECKING:
    LawSettings = FormulaSettings
    FrictionSettings = FormulaSettings
    MeshSettings = FileMesh | ShapeMesh
else:
    LawSettings = _tagged(LAWS, "type")
    FrictionSettings = _tagged(FRICTIONS, "type")
    MeshSettings = _tagged(MESHES, "shape")
