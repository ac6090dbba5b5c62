"""Tables of contact materials by pair of physics materials, as argument ``material`` of ``add_body_contact``."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from warpcontact.scene.elements import ContactMaterial, Surface
from warpcontact.scene.shapes import Shape

#: A table as users give it; the key ``None`` is the default entry, and the value ``None`` stands for no contact.
GivenTable: TypeAlias = Mapping[tuple[str, str] | None, ContactMaterial | None]


@dataclass(frozen=True, eq=False)
class MaterialTable:
    """Contact materials by pair of physics materials.

    Attributes:
        entries: Contact material of each pair of names, each pair in alphabetical order; ``None``: no contact.
        has_default: Whether pairs without an entry have the contact material ``default``.
        default: Contact material of pairs without an entry; ``None``: no contact.
    """

    entries: Mapping[tuple[str, str], ContactMaterial | None]
    has_default: bool
    default: ContactMaterial | None

    def find(self, first: str | None, second: str | None) -> ContactMaterial | None:
        """Returns the contact material of two physics materials; ``None``: no contact.

        Raises:
            KeyError: If there is neither an entry nor a default.
        """
        if first is not None and second is not None:
            key = _sorted_pair(first, second)
            if key in self.entries:
                return self.entries[key]
        if not self.has_default:
            raise KeyError(first, second)
        return self.default

    def find_all(self, pairs: Iterable[tuple[Surface | Shape, Surface | Shape]]) -> list[ContactMaterial | None]:
        """Returns the contact material of each pair of solids; ``None``: no contact."""
        return [self.find(first.physics_material, second.physics_material) for first, second in pairs]

    @property
    def names(self) -> list[str]:
        """All physics materials of the table, in order."""
        return list(dict.fromkeys(name for pair in self.entries for name in pair))

    @property
    def materials(self) -> list[ContactMaterial]:
        """Its contact materials, each once."""
        values = [*self.entries.values(), self.default]
        return list({id(one): one for one in values if one is not None}.values())


def checked_table(name: str, given: GivenTable, check: Callable[[str, Any], ContactMaterial]) -> MaterialTable:
    """Returns the table of an argument.

    Args:
        name: Name of the contact.
        given: The argument.
        check: Returns the checked contact material of an entry; its arguments are the label of the entry and the entry.

    Raises:
        TypeError: If a key is neither a pair of names nor ``None``, or a value is not a contact material.
        ValueError: If the table is empty, or has two entries of one pair.
    """
    entries: dict[tuple[str, str], ContactMaterial | None] = {}
    for key, value in given.items():
        label = f"{name}.material[{key!r}]"
        material = None if value is None else check(label, value)
        if key is None:
            continue
        is_pair = isinstance(key, tuple) and len(key) == 2 and all(isinstance(one, str) and one for one in key)
        if not is_pair:
            raise TypeError(
                f"{name}.material: a key must be a pair of names of physics materials, or None for all other pairs, "
                f"got {key!r}"
            )
        pair = _sorted_pair(*key)
        if pair in entries:
            raise ValueError(f"{label} is the same pair as another entry; the order of names does not matter")
        entries[pair] = material
    table = MaterialTable(entries, None in given, given.get(None))
    if not table.materials:
        raise ValueError(f"{name}.material must have an entry that is a wc.ContactMaterial, got {dict(given)!r}")
    return table


def check_names(name: str, table: MaterialTable, used: Iterable[str | None], meaning: str) -> None:
    """Checks that all physics materials of a table occur.

    Args:
        name: Name of the element with the table.
        table: The table.
        used: Physics materials that occur.
        meaning: End of the message: "no … has this physics material".

    Raises:
        ValueError: If not; the message names those that occur.
    """
    present = {one for one in used if one is not None}
    for own in table.names:
        if own not in present:
            known = ", ".join(repr(one) for one in sorted(present)) or "none"
            raise ValueError(f"{name}.material has an entry for {own!r}, but no {meaning}; there are: {known}")


def check_pairs(
    name: str,
    table: MaterialTable,
    solids: Iterable[Surface | Shape],
    pairs: Sequence[tuple[Surface | Shape, Surface | Shape]],
) -> None:
    """Checks that a table has the contact materials of all pairs of solids, with one contact model.

    Raises:
        ValueError: If not, or if a physics material of the table is that of no solid. The message names them.
    """
    check_names(name, table, (solid.physics_material for solid in solids), "solid has this physics_material")
    found: dict[int, ContactMaterial] = {}
    for first, second in pairs:
        try:
            material = table.find(first.physics_material, second.physics_material)
        except KeyError:
            for solid in (first, second):
                if solid.physics_material is None:
                    raise ValueError(
                        f"{name}: {solid.name!r} has no physics_material, and the table of materials has no default entry, "
                        "with the key None"
                    ) from None
            missing = _sorted_pair(str(first.physics_material), str(second.physics_material))
            raise ValueError(
                f"{name}: the table of materials has no entry for the pair {missing!r}, of {first.name!r} and "
                f"{second.name!r}, and no default entry, with the key None"
            ) from None
        if material is not None:
            found[id(material)] = material
    if not found:
        raise ValueError(f"{name}: the table of materials leaves no pair of solids in contact")
    _check_same_model(name, list(found.values()))


def _check_same_model(name: str, materials: Sequence[ContactMaterial]) -> None:
    """Raises ``ValueError`` if contact materials differ by more than values of parameters."""
    models = {(one.parts, one.law.takes_area, _parameter_names(one)): one for one in materials}
    if len(models) > 1:
        first, second = (_described(one) for one in list(models.values())[:2])
        raise ValueError(
            f"{name}: the contact materials of a table must have the same classes of law and friction, and the same "
            f"parameters, got {first}, and {second}. Call add_body_contact once for each of them, with the entry None for the "
            "pairs of the other ones"
        )


def _parameter_names(material: ContactMaterial) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(formula.parameters(area=1.0)) for formula in material.formulas.values())


def _described(material: ContactMaterial) -> str:
    """Returns law and friction of a contact material with the names of their parameters, as text."""
    texts = [f"{type(one).__name__}({', '.join(one.parameters())})" for one in (material.law, material.friction)]
    return " with ".join(texts)


def _sorted_pair(first: str, second: str) -> tuple[str, str]:
    return (first, second) if first <= second else (second, first)
