"""Warning about pairs of solids that several body contacts have, so that their forces act several times."""

import itertools
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from warpcontact.scene.body_contact import BodyContact, Solid
    from warpcontact.scene.scene_data import SceneData

# Number of contacts with common pairs that a warning names.
_NAMED = 3


def repeated_pair_warnings(scene: "SceneData") -> list[str]:
    """Returns a warning about the pairs of solids that are in contact by two or more enabled body contacts of a scene, if any."""
    contacts = [contact for contact in scene.body_contacts if contact.enabled]
    if len(contacts) < 2:
        return []
    of_pair: dict[frozenset[Solid], list[BodyContact]] = {}
    for contact in contacts:
        for pair in contact.pairs:
            of_pair.setdefault(frozenset(pair), []).append(contact)
    common: dict[tuple[BodyContact, BodyContact], list[frozenset[Solid]]] = {}
    for solids, both in of_pair.items():
        for two in itertools.combinations(both, 2):
            common.setdefault(two, []).append(solids)
    if not common:
        return []
    named = [_described(*two, pairs) for two, pairs in itertools.islice(common.items(), _NAMED)]
    more = f"; and {len(common) - _NAMED} more" if len(common) > _NAMED else ""
    return [
        f"{'; '.join(named)}{more}. Each contact acts, so that the forces of compliant ones add up, and nonsmooth ones "
        "have each point twice. Remove one of them, leave the pair out of one by exclude=, or use one contact with a table of "
        "materials"
    ]


def _described(first: "BodyContact", second: "BodyContact", pairs: "list[frozenset[Solid]]") -> str:
    """Returns the text that names two contacts and the first of their common pairs."""
    one, other = next(pair for pair in first.pairs if frozenset(pair) == pairs[0])
    more = f", and {len(pairs) - 1} more" if len(pairs) > 1 else ""
    return f"body contacts {first.name!r} and {second.name!r} have the same pair {one.name!r} and {other.name!r}{more}"
