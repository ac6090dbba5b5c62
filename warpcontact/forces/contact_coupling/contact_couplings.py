"""Contact couplings by their contacts, which share parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from warpcontact.scene.elements import Contact
from warpcontact.storage.parameters import Field

if TYPE_CHECKING:
    from warpcontact.scene.contact_coupling import ContactCoupling

# Law parameter → name in the coupling. Parameters of friction models keep their names.
_OF_LAW = {"k1": "k1", "k2": "k2", "ramp": "damping_ramp"}


@dataclass(frozen=True)
class ContactCouplings:
    """All contact couplings, in the device order of their contacts.

    Attributes:
        all: The couplings.
        of: Coupling of each contact that belongs to one.
        contacts: All contacts of the scene in device order.
    """

    all: tuple["ContactCoupling", ...]
    of: Mapping[Contact, "ContactCoupling"]
    contacts: Sequence[Contact]

    @classmethod
    def order(cls, couplings: Sequence["ContactCoupling"], contacts: Sequence[Contact]) -> "ContactCouplings":
        """Returns ``couplings`` in the order of their ``contacts``."""
        of = {contact: coupling for coupling in couplings for contact in coupling.contacts}
        return cls(tuple(dict.fromkeys(of[contact] for contact in contacts if contact in of)), of, contacts)

    def range_of_contacts(self, contacts: Sequence[Contact]) -> tuple[int, int]:
        """Returns the index of the first coupling and the number of couplings of consecutive ``contacts``."""
        found = list(dict.fromkeys(self.of[contact] for contact in contacts if contact in self.of))
        return (self.all.index(found[0]) if found else 0), len(found)

    def share(self, fields: Mapping[Contact, dict[str, Field]]) -> set[Field]:
        """Makes the contacts of a coupling share one field per parameter, except the area; returns these fields."""
        shared: dict[tuple[ContactCoupling, str], Field] = {}
        for contact, own in fields.items():
            if contact not in self.of:
                continue
            for name, field in own.items():
                if name != "area":
                    first = Field(field.values[0, :1])
                    own[name] = shared.setdefault((self.of[contact], name), first)
        return set(shared.values())

    def aliases(self, contact: Contact, part: str, name: str) -> list[str]:
        """Returns the alternative names of a parameter of law or friction model of ``contact``."""
        coupling = self.of.get(contact)
        if coupling is None or contact is not coupling.contacts[0]:
            return []
        if part == "law":
            return [f"{coupling.name}.{_OF_LAW[name]}"] if name in _OF_LAW else []
        return [f"{coupling.name}.{part}.{name}"]
