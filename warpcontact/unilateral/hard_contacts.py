"""Hard contacts of a model on its device: the rows of a step, what is remembered, and what the step launches."""

from collections.abc import Callable, Collection, Iterator, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpcontact.arrays import Layout, fixed, per_env
from warpcontact.groups import Group, by_code
from warpcontact.kernels.unilateral import collect, impulses, remember
from warpcontact.kernels.unilateral.records import record_structs
from warpcontact.kernels.unilateral.rows import row_structs
from warpcontact.readings import Reading
from warpcontact.scene import Contact, Scene
from warpcontact.status import ContactMode
from warpcontact.unilateral.materials import Hard, material_upload

if TYPE_CHECKING:
    from warpcontact.draft import PartDraft
    from warpcontact.model import Model
    from warpcontact.schedule import Span


class HardContacts:
    """What stepping hard contacts takes beside a model.

    Contacts are numbered: those with meshes as they lie on the device, then smooth ones, then the records of pairs
    of mutual contacts.

    Args:
        model: The model, or what is drawn up of it.
        compliant: Names of the contacts that are not hard.
        scratch: Returns the struct of arrays [env, row] that the solver works in, by precision and whether
            anything opposes rolling or spinning.
        layout: Where to declare arrays.

    Attributes:
        compliant: Names of the contacts that are not hard.
        capacity: Most rows of an environment.
        middle: State at half a step.
        rows: The closed contacts of a step.
        moving: The bodies under impulses.
        outcome: How the last solve went.
        scratch: What the solver works in, of rows.
        change: Likewise, of bodies.
        restraint: How far restitution was lowered in the last step.
        memory: Of each contact, from the last step in which it was closed.
        account: Of each environment, since reset.
        shown: What readings show.
        reactions: Mean wrenches of the last step on the bodies.
        material: [env, contact], of a mutual contact one for all pairs.
    """

    def __init__(
        self,
        model: "Model | PartDraft",
        compliant: Collection[str],
        scratch: Callable[[type, bool], Any],
        layout: Layout,
    ) -> None:
        t = model.types
        scene: Scene = model.scene
        self.compliant = frozenset(compliant)
        self._real = t.real
        self._device = layout.device
        rows, records = row_structs(t.real), record_structs(t.real)
        contacts = [contact for group in by_code(scene.contacts) for contact in group]
        starts = np.cumsum([0] + [contact.count for contact in contacts]).tolist()
        self._items = {
            contact: slice(start, start + contact.count) for contact, start in zip(contacts, starts, strict=False)
        }
        self._blocks_of = {
            contact: model.blocks.of_contacts(items.start, contact.count) for contact, items in self._items.items()
        }
        hard = [contact for contact in contacts if contact.name not in self.compliant]
        blocks = [np.arange(first, first + count) for first, count in (self._blocks_of[one] for one in hard)]
        self._numbers = np.concatenate([np.zeros(0, np.int32), *(_range(self._items[one]) for one in hard)])
        self._block_numbers = np.concatenate([np.zeros(0, np.int32), *blocks])
        self._hard = hard
        self._contact_count = starts[-1]
        self.capacity = len(self._numbers)
        known = starts[-1]

        bodies, each_row, each = per_env(model.body_count), per_env(max(1, self.capacity)), per_env(max(1, known))
        purpose = "hard contacts"
        self.middle = layout.struct(purpose, t.State, bodies)
        apart = ("by_force", "across") if not model.moves else ("inverse_mass",)
        nothing = fixed(1, 1)
        self.moving = layout.struct(purpose, rows.Moving, bodies, records=True, **dict.fromkeys(apart, nothing))
        self.rows = layout.struct(purpose, rows.Rows, each_row, records=True)
        self.scratch = layout.struct(purpose, scratch(t.real, self.rolls), each_row, records=True)
        self.change = layout.struct(purpose, impulses.change_struct(t.real), bodies, records=True)
        self.outcome = layout.struct(purpose, rows.Outcome, per_env())
        self.restraint = layout.struct(purpose, records.Restraint, per_env())
        self.memory = layout.struct(purpose, records.Memory, each, records=True)
        self.account = layout.struct(purpose, records.Account, per_env())
        self.shown = layout.struct(purpose, records.Shown, each)
        self.reactions = layout.struct(purpose, t.Wrenches, bodies)
        self._lists = SimpleNamespace(blocks=None, numbers=None)
        layout.content(purpose, self._lists, "blocks", _filled(self._block_numbers), wp.int32)
        layout.content(purpose, self._lists, "numbers", _filled(self._numbers), wp.int32)
        self.material: Any = None
        self._bodies, self._step = 0, None
        self._materials = [Hard(contact, contact.template.formulas, contact.count) for contact in contacts]

    def begin(self, model: "Model", step: wp.array) -> None:
        """Readies what is allocated: restitution and coefficients of friction follow their parameters from now on.

        Args:
            model: The model.
            step: Length of a step [env, 0] [s].
        """
        self._bodies, self._step = model.body_count, step
        upload = material_upload(self, self._materials, model.parameters, model.device, self._real)
        model.send([upload], [upload.content()])
        self.restart(wp.full(model.envs, True, dtype=wp.bool, device=model.device))

    @property
    def rolls(self) -> bool:
        """Whether anything opposes rolling or spinning of a hard contact."""
        return any(contact.template.parts.rolls or contact.template.parts.twists for contact in self._hard)

    @property
    def bounces(self) -> bool:
        """Whether there are restitution and friction, which may bring energy together, or several restitutions."""
        return any("restitution" in one.template.law.parameters() for one in self._hard)

    def compliant_blocks(self, group: Group) -> list[tuple[int, int]]:
        """Returns the blocks of the contacts of ``group`` that are not hard: the first and their number."""
        ranges: list[tuple[int, int]] = []
        for contact, (first, count) in self._blocks_of.items():
            inside = group.first_block <= first < group.first_block + group.block_count
            if not inside or contact.name not in self.compliant:
                continue
            if ranges and sum(ranges[-1]) == first:
                ranges[-1] = (ranges[-1][0], ranges[-1][1] + count)
            else:
                ranges.append((first, count))
        return ranges

    def collect_stages(self, span: "Span") -> list[wp.Launch]:
        """Returns the launches that list the closed contacts of the middle of the step."""
        a = span.model.arrays
        if not len(self._numbers):
            return []
        inputs = [a.status, a.model, self.middle, a.contacts, a.near]
        inputs += [self._lists.blocks, len(self._block_numbers), self.material, self.memory, self.account]
        return span.prepare(collect.mesh(self._real), 1, [*inputs, self.rows, self.outcome])

    def accept_stages(self, span: "Span", step: wp.array) -> list[wp.Launch]:
        """Returns the launch that remembers what an accepted step led to; ``step`` [env, 0] [s]."""
        inputs = [span.model.arrays.status, step, span.model.body_count, self.middle, self.rows, self.moving]
        inputs += [self.outcome, self.restraint, self.memory, self.account, self.reactions]
        return span.prepare(remember.kernel(self._real), 1, inputs)

    def restart(self, chosen: wp.array) -> None:
        """Empties what the environments of the mask ``chosen`` [env] remember."""
        inputs = [chosen, self._bodies, self.outcome, self.account, self.reactions]
        wp.launch(remember.forget(self._real), dim=len(chosen), inputs=inputs, device=self._device)

    def show(self, model: "Model") -> None:
        """Puts the last step where readings look; forces are the mean over it."""
        a, device = model.arrays, self._device
        if len(self._numbers):
            inputs = [self._step, self._lists.numbers, self.memory, self.account, a.contacts, self.shown]
            shape = (model.envs, len(self._numbers))
            wp.launch(remember.read(self._real), dim=shape, inputs=inputs, device=device)
        shape = (model.envs, model.body_count)
        inputs = [self.reactions, a.wrenches]
        wp.launch(remember.push(self._real), dim=shape, inputs=inputs, device=device)

    def readings(self) -> Iterator[Reading]:
        """Iterates over what can be measured of hard contacts."""
        yield from hard_readings(self._items, self.compliant)


def hard_readings(items: dict[Contact, slice], compliant: Collection[str]) -> Iterator[Reading]:
    """Iterates over what can be measured of hard contacts, given their numbers."""
    for contact, numbers in items.items():
        if contact.name in compliant:
            continue
        own: int | slice = numbers.start if contact.points.single else numbers
        several = 0 if contact.points.single else contact.count
        text = "impulse of the last step on the point's body, world"
        array = _shown("impulse", own)
        yield Reading(f"{contact.name}.impulse", "N·s", text, array, needs=("contacts",), items=several)
        text = "whether it stuck or slipped in the last step"
        array = _shown("mode", own)
        yield Reading(
            f"{contact.name}.mode", "-", text, array, needs=("contacts",), items=several, codes=ContactMode
        )
    for name, (part, attribute, unit, meaning) in OF_SCENE.items():
        yield Reading(f"scene.{name}", unit, meaning, _of_scene(part, attribute))


# name: (struct, array, unit, what it is)
OF_SCENE = {
    "closed_contacts": ("outcome", "count", "-", "hard contacts that were closed in the last step"),
    "solve_residual": ("outcome", "residual", "-", "what is left of the contact problem of the last step"),
    "solve_iterations": ("outcome", "iterations", "-", "iterations of its solver"),
    "solve_converged": ("outcome", "converged", "-", "1: to its tolerance"),
    "solve_failures": ("account", "failures", "-", "steps that were not solved to it, since reset"),
    "restrained": ("account", "restrained", "-", "steps in which restitution was lowered to bring no energy"),
    "friction_loss": ("account", "friction_loss", "J", "energy that friction of hard contacts took, since reset"),
    "impact_loss": ("account", "impact_loss", "J", "energy that impacts of hard contacts took, since reset"),
}


def _shown(attribute: str, own: int | slice) -> Any:
    return lambda arrays: getattr(arrays.hard.shown, attribute)[:, own]


def _of_scene(part: str, attribute: str) -> Any:
    return lambda arrays: getattr(getattr(arrays.hard, part), attribute)


def _range(items: slice) -> np.ndarray[Any, np.dtype[np.int32]]:
    return np.arange(items.start, items.stop, dtype=np.int32)


def _filled(numbers: Sequence[int] | np.ndarray[Any, Any]) -> Any:
    """Returns ``numbers``, one of them at least: no array is empty."""
    return numbers if len(numbers) else [0]
