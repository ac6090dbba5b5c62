"""Tables ``[[force_element]]``: elements of registered families of force elements (``forces/registry.py``).

The ``type`` of a table is the name of a registered class, or ``FILE.py:CLASS``, whose file registers it. The keys are
the arguments that the class declares: numbers, booleans and names of other elements.
"""

import dataclasses
from typing import Annotated, Any, ClassVar, cast

from pydantic import ConfigDict, Field, PlainValidator, SerializeAsAny, ValidationInfo, create_model

from warpcontact.experiment import quantities as q
from warpcontact.experiment.catalogue import Section, number_type, user_class
from warpcontact.experiment.errors import abbreviated
from warpcontact.experiment.user_code import UserFiles
from warpcontact.forces.registry import element_kinds, is_registered
from warpcontact.kernels.catalogue.names import suggestion
from warpcontact.scene.elements import Body, Points, Surface
from warpcontact.scene.scene_element import SceneElement
from warpcontact.scene.shapes import Shape

#: Reference to another element, by its class: word for messages, and sections that can contain the element.
REFERENCES: dict[type, tuple[str, tuple[str, ...]]] = {
    Body: ("body", ("body", "bodies")),
    Points: ("point", ("point", "points")),
    Surface: ("surface", ("surface",)),
    Shape: ("shape", ("shape",)),
}


class ForceElementSettings(Section):
    """``[[force_element]]``: an element of a registered family of force elements."""

    model_config = ConfigDict(protected_namespaces=())  # arguments of user-defined classes can have any name

    kind: ClassVar[type[SceneElement]]
    type: str
    name: Annotated[str, q.element_name]

    @property
    def references(self) -> dict[str, tuple[str, tuple[str, ...]]]:
        """Keys whose value is the name of another element: word for messages and sections."""
        return {key: REFERENCES[of] for key, of in self.kind.references().items()}


def force_element_model(value: Any, user_files: UserFiles) -> type[ForceElementSettings]:
    """Returns the pydantic model of a table ``[[force_element]]``.

    Args:
        value: The table of the file.
        user_files: Files with user-defined classes.

    Raises:
        ValueError: If the table is invalid; the message continues the key of the table.
    """
    kinds = element_kinds()
    listed = " or ".join([*([f"one of {', '.join(kinds)}"] if kinds else []), "FILE.py:CLASS"])
    if not isinstance(value, dict):
        raise ValueError(f" must be a table, got {abbreviated(value)}")
    if "type" not in value:
        raise ValueError(f".type is missing: {listed}")
    given = value["type"]
    if isinstance(given, str) and given in kinds:
        return _settings_model(kinds[given])
    file, name = user_class(given)
    if not file:
        raise ValueError(f".type must be {listed}, got {abbreviated(given)}{suggestion(given, kinds)}")
    try:
        kind = user_files.find(file, name, SceneElement)
    except ValueError as error:
        raise ValueError(f".type{error}") from None
    if not is_registered(kind):
        raise ValueError(
            f".type: {name} in {file} is not registered; call register of warpcontact.forces.registry"
        )
    return _settings_model(kind)


def _settings_model(kind: type[SceneElement]) -> type[ForceElementSettings]:
    """Returns the pydantic model of the tables of a class."""
    fields: dict[str, Any] = {}
    for field in kind.arguments():
        if hasattr(ForceElementSettings, field.name):
            raise ValueError(f".type: {kind.__name__} has an argument {field.name!r}, which is reserved in tables")
        default = ... if field.default is dataclasses.MISSING else field.default
        of = kind.kind_of(field)
        if of in REFERENCES:
            optional = kind.is_optional(field.name)
            omitted, text = (None, str | None) if optional else (default, str)
            fields[field.name] = (text, Field(omitted, description=f"the name of a {REFERENCES[of][0]}"))
        elif of is bool:
            fields[field.name] = (bool, default)
        else:
            limits = field.metadata
            meaning = f"{limits['meaning']} [{limits['unit']}]"
            fields[field.name] = (number_type(limits), Field(default, description=meaning))
    model = create_model(f"{kind.__name__}_settings", __base__=ForceElementSettings, **fields)
    model.kind = kind
    return model


def _force_element(value: Any, info: ValidationInfo) -> ForceElementSettings:
    user_files = cast(UserFiles, info.context)
    return force_element_model(value, user_files).model_validate(value, context=user_files)


ForceElementTable = Annotated[SerializeAsAny[ForceElementSettings], PlainValidator(_force_element)]
