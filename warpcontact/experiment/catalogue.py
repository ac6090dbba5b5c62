"""Pydantic models of tables that are derived from classes and functions: laws, friction models, joints, meshes.

Their keys are the parameters of the classes and mesh generators, with the ranges declared there. The ``type`` or
``shape`` of a table selects its model. Classes of the library and user-defined classes are looked up in different
places, and handled in the same way afterwards.
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
from warpcontact.kernels import friction, joints, laws, shapes
from warpcontact.kernels.catalogue.device_model import ROWS, Formula, unit_vectors
from warpcontact.kernels.catalogue.names import suggestion
from warpcontact.kernels.contact.contact_evaluation import ContactModel
from warpcontact.kernels.couplings import springs
from warpcontact.validation.checks import limits

#: Generated meshes, by the name of their generator.
SHAPES: dict[str, Callable[..., meshes.Mesh]] = {
    shape.__name__: shape for shape in (meshes.grid, meshes.sinusoidal_terrain, meshes.box, meshes.icosphere)
}


class Section(BaseModel):
    """A table of the file. Unknown keys are rejected, strings are not converted to numbers, numbers must be finite."""

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
            ValueError: If a value is out of range; the message begins with the name of the key.
        """
        return SHAPES[self.shape](**self.model_dump(exclude={"shape"}), name=name)


class DeviceModelSettings(Section):
    """A law, friction model, spring, joint or shape: its class, as name or ``FILE.py:CLASS``, and its parameters."""

    model_config = ConfigDict(protected_namespaces=())  # parameters of user-defined classes can have any name

    formula: ClassVar[type[Formula]]
    type: str

    def make(self) -> Any:
        """Returns the object of the class."""
        return self.formula(**self.model_dump(exclude={"type"}, exclude_none=True))

    @model_validator(mode="after")
    def _complete(self) -> "DeviceModelSettings":
        try:
            self.make()  # the class checks combinations of parameters
        except ValueError as error:
            raise ValueError(f": {error}") from None
        except Exception as error:  # in a user-defined class
            raise ValueError(f": {describe_error(error, self.formula)}") from None
        return self


@functools.cache
def shape_model(name: str) -> type[ShapeMesh]:
    """Returns the model of the table of a generated mesh; ``name`` is one of ``SHAPES``."""
    fields: dict[str, Any] = {"shape": (Literal[name], ...)}
    for key, parameter in inspect.signature(SHAPES[name]).parameters.items():
        if key == "name":
            continue
        kind, default = parameter.annotation, parameter.default
        if get_args(kind):  # annotated as a tuple of numbers
            count = len(get_args(kind))
            whole = get_args(kind)[0] is int
            kind = Annotated[kind, q.whole_numbers(count) if whole else q.numbers((count,))]
        elif kind is float:
            kind = Annotated[float, q.numbers(())]
        fields[key] = (kind, default)
    return create_model(f"{name}_mesh", __base__=ShapeMesh, **fields)


def mesh_model(value: Any, key: str = "") -> type[FileMesh] | type[ShapeMesh]:
    """Returns the model of the table of one mesh.

    Args:
        value: The table of the file.
        key: Key of the table, for advice in messages; empty: it is an entry of a list.

    Raises:
        ValueError: If the table is invalid; the message continues the key of the mesh.
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
    """Returns the model of the table of a law, friction model, spring, joint or shape.

    Args:
        key: Key of the table, one of ``FORMULAS``.
        value: The table of the file.
        user_files: Files with user-defined classes.

    Raises:
        ValueError: If the table is invalid; the message continues the key.
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
    """Returns file and class of ``FILE.py:CLASS``; two empty strings for any other value."""
    file, _, name = given.rpartition(":") if isinstance(given, str) else ("", "", "")
    return (file, name) if file.endswith(".py") else ("", "")


@functools.cache
def settings_model(formula: type[Formula]) -> type[DeviceModelSettings]:
    """Returns the model of the table of a class.

    Raises:
        ValueError: If the name of a parameter is not allowed in a table; the message continues the key ``type``.
    """
    fields: dict[str, Any] = {}
    taken = {*dir(DeviceModelSettings), *DeviceModelSettings.__annotations__}
    for field in dataclasses.fields(formula):
        if field.name in taken or field.name.startswith("_"):
            raise ValueError(
                f": {formula.__name__} has a parameter {field.name!r}, a name that is reserved in tables"
            )
        allowed = formula.limits(field.name)
        default = ... if field.default is dataclasses.MISSING else field.default
        fields[field.name] = (
            number_type(allowed),
            Field(
                default,
                description=f"{allowed['meaning']} [{allowed['unit']}]",
                validate_default=default is not None,
            ),
        )
    model = create_model(f"{formula.__name__}_settings", __base__=DeviceModelSettings, **fields)
    model.formula = formula
    return model


def number_type(allowed: Any) -> Any:
    """Returns the pydantic type of a parameter with these limits."""
    shape = allowed["shape"]
    if shape == ():
        return Annotated[float, q.numbers((), allowed=allowed)]
    if ROWS in shape:
        return Annotated[tuple[Any, ...], q.table(shape, allowed)]
    check = unit_vectors if allowed["direction"] else None
    return Annotated[tuple[float, ...], q.numbers(shape, allowed=allowed, check=check)]


#: Base classes by the key of their table in a material, spring-damper, body or shape.
FORMULAS: dict[str, Any] = {
    **{part: laws.Law if part == "law" else friction.Friction for part in ContactModel._fields},
    "spring": springs.Spring,
    "damper": springs.Damper,
    "motion": joints.Motion,
    "form": shapes.Shape,
}
#: Classes of the library by base class: name to the module that has it.
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


# The keys of these tables depend on their content, so the model is selected before validation.
DeviceModelTable = Annotated[SerializeAsAny[DeviceModelSettings], PlainValidator(_formula)]
Mesh = Annotated[SerializeAsAny[FileMesh | ShapeMesh], PlainValidator(_mesh)]
SurfaceMesh = Annotated[SerializeAsAny[FileMesh | ShapeMesh | tuple[Mesh, ...]], PlainValidator(_meshes)]
_LISTED: TypeAdapter[tuple[FileMesh | ShapeMesh, ...]] = TypeAdapter(
    Annotated[tuple[Mesh, ...], Field(strict=False)]  # TOML has lists only
)
