"""Tables of the experiment file that follow from classes and functions: laws, friction models, motions, meshes.

Their keys are the parameters of the classes and generators, with the ranges that are declared there. What a table
says it is decides which model it is validated with; a law or friction of the library and one of a user's own are
found in different places, and from there on treated alike.
"""

import dataclasses
import functools
import inspect
import json
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, cast, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    SerializeAsAny,
    TypeAdapter,
    ValidationInfo,
    create_model,
    model_validator,
)

from warpcontact import meshes
from warpcontact.experiment import quantities as q
from warpcontact.experiment.errors import abbreviated
from warpcontact.experiment.user_code import UserFiles, describe_error
from warpcontact.kernels import friction, joints, laws
from warpcontact.kernels.catalogue.device_model import ROWS, Formula, unit_vectors
from warpcontact.kernels.catalogue.names import suggestion
from warpcontact.kernels.contact.contact_evaluation import ContactModel
from warpcontact.kernels.couplings import springs
from warpcontact.kernels.shapes import shapes
from warpcontact.validation.checks import limits

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
    unit: Annotated[str | None, q.one_of(tuple(meshes.UNITS))] = None
    prim: str | None = Field(default=None, min_length=1)
    repair: Annotated[bool | str | tuple[str, ...], q.repair] = False
    tolerance: Annotated[float, q.numbers((), allowed=limits("-", above=0.0, at_most=0.01))] = 1e-6


class ShapeMesh(Section):
    """A generated mesh."""

    shape: str

    def make(self, name: str) -> meshes.Mesh:
        """Generates the mesh.

        Raises:
            ValueError: If a value is out of range; the message begins with its name.
        """
        return SHAPES[self.shape](**self.model_dump(exclude={"shape"}), name=name)


class DeviceModelSettings(Section):
    """A law, friction or motion: its class, of the catalogue or as ``FILE.py:CLASS``, and its parameters."""

    model_config = ConfigDict(protected_namespaces=())  # a user names the parameters

    formula: ClassVar[type[Formula]]
    type: str

    def make(self) -> Any:
        """Returns the law, friction or motion."""
        return self.formula(**self.model_dump(exclude={"type"}, exclude_none=True))

    @model_validator(mode="after")
    def _complete(self) -> "DeviceModelSettings":
        try:
            self.make()  # which of its parameters go together only the formula knows
        except ValueError as error:
            raise ValueError(f": {error}") from None
        except Exception as error:  # in a user's class
            raise ValueError(f": {describe_error(error, self.formula)}") from None
        return self


@functools.cache
def shape_model(name: str) -> type[ShapeMesh]:
    """Returns the model of the tables of a mesh that is generated; ``name`` is one of ``SHAPES``."""
    fields: dict[str, Any] = {"shape": (Literal[name], ...)}
    for key, parameter in inspect.signature(SHAPES[name]).parameters.items():
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


def mesh_model(value: Any, key: str = "") -> type[FileMesh] | type[ShapeMesh]:
    """Returns the model of one mesh as it stands in the file.

    Args:
        value: What is there.
        key: Where it is alone, the key, for the advice what to write.

    Raises:
        ValueError: If there is none; the message continues the key of the mesh.
    """
    listed = f"one of {', '.join(SHAPES)}"
    if isinstance(value, str):
        write = f"shape = {value!r}, …" if value in SHAPES else f"file = {json.dumps(value, ensure_ascii=False)}"
        raise ValueError(
            f"must be a table, got {abbreviated(value)}; write {f'{key} = ' if key else ''}{{ {write} }}"
        )
    if not isinstance(value, dict):
        raise ValueError(f"must be a table{' or a list of tables' if key else ''}, got {abbreviated(value)}")
    if "file" in value:
        return FileMesh
    if "shape" not in value:
        raise ValueError(f".shape is missing: {listed}, or file: a mesh file")
    shape = value["shape"]
    if not isinstance(shape, str) or shape not in SHAPES:
        raise ValueError(f".shape must be {listed}, got {abbreviated(shape)}{suggestion(shape, SHAPES)}")
    return shape_model(shape)


def device_model_settings(key: str, value: Any, user_files: UserFiles) -> type[DeviceModelSettings]:
    """Returns the model of a law, friction or motion as it stands in the file.

    Args:
        key: Its key in a material or body.
        value: What is there.
        user_files: Where classes are that are not of the catalogue.

    Raises:
        ValueError: If there is none; the message continues the key.
    """
    catalogue = CATALOGUES[FORMULAS[key]]
    if not isinstance(value, dict):
        named = isinstance(value, str) and (value in catalogue or ".py:" in value)
        hint = f"; write {key} = {{ type = {value!r}, … }}" if named else ""
        raise ValueError(f"must be a table, got {abbreviated(value)}{hint}")
    listed = f"one of {', '.join(catalogue)}, or FILE.py:CLASS"
    if "type" not in value:
        raise ValueError(f".type is missing: {listed}")
    given = value["type"]
    if isinstance(given, str) and given in catalogue:
        return settings_model(getattr(catalogue[given], given))
    file, name = user_class(given)
    if file:
        try:
            return settings_model(user_files.find(file, name, FORMULAS[key]))
        except ValueError as error:
            raise ValueError(f".type{error}") from None
    hint = suggestion(given, catalogue)
    for base, others in CATALOGUES.items():
        if others is not catalogue and isinstance(given, str) and given in others:
            hint = f"; that is a {base.__name__.lower()}"
    raise ValueError(f".type must be {listed}, got {abbreviated(given)}{hint}")


def user_class(given: Any) -> tuple[str, str]:
    """Returns file and class of ``FILE.py:CLASS``; two empty texts for anything else."""
    file, _, name = given.rpartition(":") if isinstance(given, str) else ("", "", "")
    return (file, name) if file.endswith(".py") else ("", "")


@functools.cache
def settings_model(formula: type[Formula]) -> type[DeviceModelSettings]:
    """Returns the model of the tables of a class of laws, friction models or motions.

    Raises:
        ValueError: If a parameter has a name that a table cannot have; the message continues the key ``type``.
    """
    fields: dict[str, Any] = {}
    taken = {*dir(DeviceModelSettings), *DeviceModelSettings.__annotations__}
    for field in dataclasses.fields(formula):
        if field.name in taken or field.name.startswith("_"):
            raise ValueError(f": {formula.__name__} has a parameter {field.name!r}, which no table can have")
        allowed = formula.limits(field.name)
        default = ... if field.default is dataclasses.MISSING else field.default
        fields[field.name] = (
            _kind_of(allowed),
            Field(
                default,
                description=f"{allowed['meaning']} [{allowed['unit']}]",
                validate_default=default is not None,
            ),
        )
    model = create_model(f"{formula.__name__}_settings", __base__=DeviceModelSettings, **fields)
    model.formula = formula
    return model


def _kind_of(allowed: Any) -> Any:
    """Returns the type of a parameter, from its limits."""
    shape = allowed["shape"]
    if shape == ():
        return Annotated[float, q.numbers((), allowed=allowed)]
    if ROWS in shape:
        return Annotated[tuple[Any, ...], q.table(shape, allowed)]
    check = unit_vectors if allowed["direction"] else None
    return Annotated[tuple[float, ...], q.numbers(shape, allowed=allowed, check=check)]


#: What the formulas of a material, a spring-damper, a body and a shape are, by their keys.
FORMULAS: dict[str, Any] = {
    **{part: laws.Law if part == "law" else friction.Friction for part in ContactModel._fields},
    "spring": springs.Spring,
    "damper": springs.Damper,
    "motion": joints.Motion,
    "form": shapes.Shape,
}
#: Where the classes are that come with the library, by what they are and by name.
CATALOGUES: dict[Any, dict[str, Any]] = {
    laws.Law: dict.fromkeys(laws.NAMES, laws),
    friction.Friction: dict.fromkeys(friction.NAMES, friction),
    springs.Spring: dict.fromkeys(springs.SPRING_NAMES, springs),
    springs.Damper: dict.fromkeys(springs.DAMPER_NAMES, springs),
    joints.Motion: dict.fromkeys(joints.NAMES, joints),
    shapes.Shape: dict.fromkeys(shapes.NAMES, shapes),
}


def _formula(value: Any, info: ValidationInfo) -> DeviceModelSettings:
    user_files = cast(UserFiles, info.context)
    return device_model_settings(str(info.field_name), value, user_files).model_validate(value, context=user_files)


def _mesh(value: Any) -> FileMesh | ShapeMesh:
    return mesh_model(value).model_validate(value)


def _meshes(value: Any) -> FileMesh | ShapeMesh | tuple[FileMesh | ShapeMesh, ...]:
    if not isinstance(value, list | tuple):
        return mesh_model(value, "mesh").model_validate(value)
    if not value:
        raise ValueError(f"must be a table or a list of tables, at least one, got {abbreviated(value)}")
    return _LISTED.validate_python(value)


# Which keys there are depends on what is in the table: its model is found first.
DeviceModelTable = Annotated[SerializeAsAny[DeviceModelSettings], PlainValidator(_formula)]
Mesh = Annotated[SerializeAsAny[FileMesh | ShapeMesh], PlainValidator(_mesh)]
SurfaceMesh = Annotated[SerializeAsAny[FileMesh | ShapeMesh | tuple[Mesh, ...]], PlainValidator(_meshes)]
_LISTED: TypeAdapter[tuple[FileMesh | ShapeMesh, ...]] = TypeAdapter(
    Annotated[tuple[Mesh, ...], Field(strict=False)]  # TOML has lists only
)
