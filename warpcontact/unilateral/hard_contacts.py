"""Nonsmooth contacts of a model on its device: the rows of a step, what is remembered, and what the step launches."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.allocation import COUNT, SWITCH, Allowed
from warpcontact.arrays import Layout, per_env
from warpcontact.captures import beside_captures
from warpcontact.checks import similar
from warpcontact.footprint import Need
from warpcontact.groups import Group, by_code
from warpcontact.kernels.smooth.records import contact_structs
from warpcontact.kernels.types import MODE_OPEN, MODE_SLIP
from warpcontact.kernels.unilateral import collect, impulses, remember, rest, sequence
from warpcontact.kernels.unilateral.records import record_structs
from warpcontact.kernels.unilateral.rows import moving_struct, row_structs
from warpcontact.parameters import Parameter
from warpcontact.piles.elements import ParticleContact
from warpcontact.piles.pile import Pile
from warpcontact.scene import Contact, Scene
from warpcontact.sensors import Sensor
from warpcontact.smooth.elements import ShapeContact
from warpcontact.status import ContactMode
from warpcontact.unilateral.materials import CLOSED, Hard, material_upload, parameters_of

if TYPE_CHECKING:
    from warpcontact.draft import PartDraft
    from warpcontact.model import Model
    from warpcontact.schedule import Span
    from warpcontact.smooth.contact_sets import ShapeContactSet


PURPOSE = "nonsmooth contacts"


@dataclass
class _List:
    """Which of the items of some arrays are hard.

    Attributes:
        first: Number of the contact of the first item.
        numbers: The items that are hard.
        items: These, on the device.
    """

    first: int
    numbers: NDArray[np.int_]
    items: Any = None

    @property
    def count(self) -> int:
        """Number of items that are hard."""
        return len(self.numbers)


class HardContacts:
    """What stepping nonsmooth contacts takes beside a model.

    Contacts are numbered: those with meshes as they lie on the device, then smooth ones, then the records of pairs
    of particle contacts that are hard. Materials likewise, but one for all pairs of a particle contact.

    Args:
        model: The model, or what is drawn up of it.
        compliant: Names of the contacts that are not hard, beside those of contact couplings.
        scratch: For each solver, by its name, what returns the struct of what it keeps of a row, by precision and
            whether anything opposes rolling or spinning.
        tolerance: Of a solve.
        recovery: Share of an overlap that is taken back in a second [1/s].
        layout: Where to declare arrays.
        sequential: Whether impacts come one after the other.

    Attributes:
        compliant: Names of the contacts that are not hard.
        tolerance: Of a solve.
        recovery: Share of an overlap that is taken back in a second [1/s].
        watched: Whether every step is looked at, so that none is left out.
        capacity: Most rows of an environment.
        middle: State at half a step.
        rows: The closed contacts of a step.
        moving: The bodies under impulses.
        outcome: How the last solve went.
        change: What impulses have changed of these.
        hits: What impacts one after the other work in; ``None``: they are simultaneous.
        restraint: How far restitution was lowered in the last step.
        memory: Of each contact, from the last step in which it was closed.
        account: Of each environment, since reset.
        shown: What sensors show.
        reactions: Mean wrenches of the last step on the bodies.
        material: [env, material].
    """

    def __init__(
        self,
        model: "Model | PartDraft",
        compliant: Collection[str],
        scratch: Mapping[str, Callable[[type, bool], Any]],
        tolerance: float,
        recovery: float,
        layout: Layout,
        sequential: bool = False,
    ) -> None:
        t = model.types
        scene: Scene = model.scene
        forces = [contact.name for contact in scene.contacts if contact.facing is not None]
        self.compliant = frozenset([*compliant, *forces])
        self.tolerance, self.recovery = tolerance, recovery
        self.watched = False
        self._real = t.real
        self._contacts = t.Contacts
        self._device = layout.device
        rows, records = row_structs(t.real), record_structs(t.real)
        contacts = [contact for group in by_code(scene.contacts) for contact in group]
        starts = np.cumsum([0] + [contact.count for contact in contacts]).tolist()
        meshes = {contact: _items(start, contact.count) for contact, start in zip(contacts, starts, strict=False)}
        self._blocks_of = {
            contact: _items(*model.blocks.of_contacts(own.start, contact.count)) for contact, own in meshes.items()
        }
        self._mesh = self._list(0, meshes, layout)
        self._mesh_blocks = self._list(0, self._blocks_of, layout)
        # What sensors show of single contacts.
        self._shown: dict[Contact | ShapeContact, slice] = dict(meshes.items())
        self._smooth: list[tuple[ShapeContactSet, _List]] = []
        for one in model.smooth:
            first = starts[-1] + one.first
            self._shown |= {
                contact: slice(first + own.start, first + own.stop) for contact, own in one.items.items()
            }
            self._smooth.append((one, self._list(first, one.items, layout)))
        count = starts[-1] + model.smooth_count
        known = count
        self._number_of: dict[ParticleContact, int] = {}
        self._piles: list[tuple[Pile, int]] = []  # those that are hard, with their material
        for pile in model.piles:
            if not self.acts(pile.contact.name):
                self._piles.append((pile, count + len(self._piles)))
                self._number_of[pile.contact] = known
                known += pile.slots
        self.capacity = self._mesh.count + sum(own.count for _, own in self._smooth)
        self.capacity += sum(pile.slots for pile, _ in self._piles)
        everything = (*self._shown, *self._number_of)
        self._hard = [contact for contact in everything if not self.acts(contact.name)]

        bodies, each_row = per_env(model.body_count), per_env(max(1, self.capacity))
        self.middle = layout.struct(PURPOSE, t.State, bodies, transient=True)
        made = {
            "rows": (rows.Row, each_row),
            "moving": (moving_struct(t.real, model.moves), bodies),
            "change": (impulses.change_struct(t.real), bodies),
            "memory": (records.Memory, per_env(max(1, known))),
        }
        self.rows = self.moving = self.change = self.memory = None
        remembered: dict[str, Allowed] = {"memory.mode": (MODE_OPEN, MODE_SLIP), "memory.stamp": COUNT}
        for name, (struct, shape) in made.items():
            layout.array(PURPOSE, self, name, struct, shape, transient=name != "memory", ranges=remembered)
        self._scratch = SimpleNamespace()
        for name, make in scratch.items():
            setattr(self._scratch, name, None)
            layout.array(PURPOSE, self._scratch, name, make(t.real, self.rolls), each_row, transient=True)
        self.hits: Any = None
        if sequential:
            layout.array(PURPOSE, self, "hits", sequence.scratch(t.real), each_row, transient=True)
        solved = {"count": (0, self.capacity), "iterations": COUNT, "converged": SWITCH}
        self.outcome = layout.struct(PURPOSE, rows.Outcome, per_env(), transient=("slack",), ranges=solved)
        self.restraint = layout.struct(PURPOSE, records.Restraint, per_env(), transient=True)
        counts = dict.fromkeys(("step", "failures", "restitution_limited"), COUNT)
        self.account = layout.struct(PURPOSE, records.Account, per_env(), transient=("calm",), ranges=counts)
        self.shown = layout.struct(PURPOSE, records.Shown, per_env(max(1, count)), transient=True)
        self.reactions = layout.struct(PURPOSE, t.Wrenches, bodies)
        self.material: Any = None
        self._bodies, self._step = 0, None
        self._upload: Any = None
        self._materials = [
            Hard(one, one.material.formulas, own.stop - own.start) for one, own in self._shown.items()
        ]
        self._materials += [Hard(one, one.formulas, 1) for one in self._number_of]

    def _list(self, first: int, items: Mapping[Any, slice], layout: Layout) -> _List:
        """Declares the list of those of ``items``, by contact, that are hard."""
        hard = [np.arange(own.start, own.stop) for contact, own in items.items() if not self.acts(contact.name)]
        numbers = np.concatenate([np.zeros(0, np.int64), *hard])
        made = _List(first, numbers)
        # No array is empty.
        layout.content(PURPOSE, made, "items", numbers if len(numbers) else [0], wp.int32)
        return made

    def material_need(self, parameters: Mapping[str, Parameter], envs: int, varied: Collection[str]) -> Need:
        """Returns what the materials of ``envs`` environments take; ``varied`` are to have a value in each."""
        upload = self._upload or material_upload(self, self._materials, parameters, self._device, self._real)
        fields = {id(parameters[name].field) for name in varied}
        own = any(
            id(source.field) in fields or not source.field.shared
            for source in parameters_of(self._materials, parameters)
        )
        return Need(PURPOSE, str(self._device), *upload.size(envs, own))

    def begin(self, model: "Model", step: wp.array) -> None:
        """Takes what is allocated: the model, and the length of a step [env, 0] [s]."""
        self.check_shares(model.parameters)
        self._bodies, self._step = model.body_count, step
        self._upload = material_upload(self, self._materials, model.parameters, model.device, self._real)

    def follow(self, model: "Model") -> None:
        """Lets restitution and coefficients of friction follow their parameters; no contact remembers anything.

        Losses and counts go on.
        """
        for parameter in parameters_of(self._materials, model.parameters):
            if self._upload not in parameter.uploads:
                parameter.uploads.append(self._upload)
        model.send([self._upload], [self._upload.content()])
        self._close_at(model, CLOSED[self._real])
        self._forget(wp.full(model.envs, True, dtype=wp.bool, device=model.device), everything=False)
        self._leave_laws(model)

    def let_go(self, model: "Model") -> None:
        """Follows the parameters no longer."""
        self._leave_laws(model)
        self._close_at(model, 0.0)
        for parameter in parameters_of(self._materials, model.parameters):
            if self._upload in parameter.uploads:
                parameter.uploads.remove(self._upload)

    def _close_at(self, model: "Model", gap: float) -> None:
        """Sets the gap below which the nonsmooth contacts are closed [m]."""
        closed = [(model.arrays.closed, self._mesh.numbers)] if self._mesh.count else []
        closed += [(one.closed, own.numbers) for one, own in self._smooth if own.count]
        closed += [(pile.closed, np.arange(1)) for pile, _ in self._piles]
        for one, items in closed:
            one.assign(items, gap)
        model.send([one.upload for one, _ in closed], [one.upload.content() for one, _ in closed])

    def _leave_laws(self, model: "Model") -> None:
        """Lets laws and friction models of nonsmooth contacts begin anew should they act again: none has been going on."""
        history, contacts = model.arrays.history, model.arrays.contacts
        if self._mesh.count:
            hard = self._mesh.items.numpy()
            for array, nothing in ((history.entry_speed, -1.0), (contacts.approach_speed, 0.0)):
                values = array.numpy()
                values[:, hard] = nothing
                array.assign(values)

    @property
    def scratch(self) -> dict[str, Any]:
        """What each solver, by its name, works in [env, row]."""
        return vars(self._scratch)

    def acts(self, name: str) -> bool:
        """Whether the contact ``name`` acts by the force of its law."""
        return name in self.compliant

    def number_of(self, contact: ParticleContact) -> int:
        """Returns the number of the first record of a particle contact that is hard."""
        return self._number_of[contact]

    @property
    def names(self) -> frozenset[str]:
        """Names of the contacts that are hard."""
        return frozenset(contact.name for contact in self._hard)

    @property
    def rolls(self) -> bool:
        """Whether anything opposes rolling or spinning of a nonsmooth contact."""
        return any(contact.material.parts.rolls or contact.material.parts.twists for contact in self._hard)

    def bounces(self, parameters: Mapping[str, Parameter]) -> bool:
        """Whether any nonsmooth contact has a restitution now: impacts may then bring energy."""
        names = [f"{one.name}.law.restitution" for one in self._hard]
        return any(bool(parameters[name].field.values.any()) for name in names if name in parameters)

    def check_shares(self, parameters: Mapping[str, Parameter]) -> None:
        """Checks that no nonsmooth contact has the share 0: it would act in spite of that.

        Raises:
            ValueError: If one has; names the contact.
        """
        for one in self._hard:
            own = parameters.get(f"{one.name}.force_scale")
            if own is not None:
                self.check_share(own.name, own.values)

    def check_share(self, name: str, values: NDArray[np.float64]) -> None:
        """Raises the same error if ``values`` of parameter ``name`` are shares of a nonsmooth contact with a 0."""
        element, _, quantity = name.rpartition(".")
        if quantity == "force_scale" and element in self.names and not values.all():
            raise ValueError(
                f"{name} must be greater than 0, got 0: rigid contact has no force to scale. Set "
                f"{element}.enabled to 0 to switch it off"
            )

    def compliant_blocks(self, group: Group) -> list[tuple[int, int]]:
        """Returns the blocks of the contacts of ``group`` that are not hard: the first and their number."""
        last = group.first_block + group.block_count
        return self.compliant_items(
            {contact: own for contact, own in self._blocks_of.items() if group.first_block <= own.start < last}
        )

    def compliant_items(self, items: Mapping[Any, slice]) -> list[tuple[int, int]]:
        """Returns where those of ``items``, by contact, are that are not hard: the first and how many follow."""
        return _runs(own for contact, own in items.items() if self.acts(contact.name))

    def collect_stages(self, span: "Span") -> list[wp.Launch]:
        """Returns the launches that list the closed contacts of the middle of the step."""
        a, real = span.model.arrays, self._real
        outputs = [self.recovery, self.material, self.memory, self.account, self.rows, self.outcome]
        launches = []
        if self._mesh.count:
            blocks = self._mesh_blocks
            inputs = [a.status, a.model, self.middle, a.contacts, a.near, blocks.items, blocks.count]
            launches += span.prepare(collect.mesh(real), 1, [*inputs, *outputs])
        for one, own in self._smooth:
            if own.count:
                inputs = [a.status, self.middle, own.first, own.items, own.count, one.members, one.settings]
                launches += span.prepare(collect.smooth(real, one.curved), 1, [*inputs, one.smooth, *outputs])
        for pile, material in self._piles:
            contact = pile.contact
            inputs = [a.status, self.middle, contact.count, pile.shapes, pile.lists, pile.touches]
            inputs += [self._number_of[contact], material]
            launches += span.prepare(collect.pile(real), 1, [*inputs, *outputs])
        return launches

    def rest_stages(self, span: "Span", step: wp.array) -> list[wp.Launch]:
        """Returns the launch that leaves environments at rest out of a step, none where that may be wrong.

        Only contacts with surfaces do the same in every step in which nothing moves.
        """
        model = span.model
        others = model.moves or model.drives or model.couplings or model.smooth or model.piles or model.follows
        if self.watched or others or any(self.compliant_blocks(group) for group in model.groups):
            return []
        inputs = [model.arrays.status, step, model.arrays.time, self.account]
        return span.prepare(rest.kernel(self._real), 1, inputs)

    @beside_captures()
    def wake(self) -> None:
        """Lets no environment rest: something may have been changed from outside."""
        self.account.calm.zero_()

    @beside_captures()
    def forget_residuals(self) -> None:
        """Sets the largest residuals of unsolved problems to 0."""
        self.account.largest_residual.zero_()

    def accept_stages(self, span: "Span", step: wp.array) -> list[wp.Launch]:
        """Returns the launch that remembers what an accepted step led to; ``step`` [env, 0] [s]."""
        inputs = [span.model.arrays.status, step, self.tolerance, span.model.body_count]
        inputs += [self.middle, self.rows, self.moving]
        inputs += [self.outcome, self.restraint, self.memory, self.account, self.reactions]
        return span.prepare(remember.kernel(self._real, span.model.moves, self.rolls), 1, inputs)

    def restart(self, chosen: wp.array) -> None:
        """Empties what the environments of the mask ``chosen`` [env] remember."""
        self._forget(chosen, everything=True)

    def _forget(self, chosen: wp.array, everything: bool) -> None:
        inputs = [chosen, int(everything), self._bodies, self.outcome, self.account, self.reactions]
        wp.launch(remember.forget(self._real), dim=len(chosen), inputs=inputs, device=self._device)

    def show_stages(self, span: "Span", status: wp.array) -> list[wp.Launch]:
        """Returns the launches that put the last step where sensors of contacts look, but for those of piles.

        ``status`` [env] says which environments are active.
        """
        a, real = span.model.arrays, self._real
        targets = [(self._mesh, remember.read(real, self._contacts), a.contacts)]
        for one, own in self._smooth:
            targets.append((own, remember.read(real, contact_structs(real).Smooth), one.smooth))
        launches = []
        for own, kernel, target in targets:
            inputs = [status, self._step, own.first, own.items, self.memory, self.account, target, self.shown]
            launches += span.prepare(kernel, own.count, inputs)
        return launches

    def show(self, model: "Model") -> None:
        """Puts the last step where sensors look; forces are the mean over it."""
        from warpcontact.schedule import Span

        a, device, real = model.arrays, self._device, self._real
        for launch in self.show_stages(Span(model, model.envs, cached=False, ordered=True), model.all_active):
            launch.launch()
        known = [self.memory, self.account]
        for pile, _ in self._piles:
            inputs = [self._step, self._number_of[pile.contact], pile.shapes, pile.lists, *known, pile.touches]
            shape = (model.envs, pile.contact.count)
            wp.launch(remember.read_pile(real), dim=shape, inputs=inputs, device=device)
        shape = (model.envs, model.body_count)
        wp.launch(remember.push(real), dim=shape, inputs=[self.reactions, a.wrenches], device=device)

    def sensors(self) -> Iterator[Sensor]:
        """Iterates over what can be measured of nonsmooth contacts."""
        for contact, numbers in self._shown.items():
            if self.acts(contact.name):
                continue
            if isinstance(contact, ShapeContact):
                single, on = contact.single, "the body of its first shape"
            else:
                single, on = contact.points.single, "the point's body"
            own: int | slice = numbers.start if single else numbers
            several = 0 if single else contact.count
            name, array = f"{contact.name}.impulse", _shown("impulse", own)
            text = f"impulse of the last step on {on}, world"
            yield Sensor(name, "N·s", text, array, needs=("contacts",), items=several, shape=(3,))
            name, array = f"{contact.name}.mode", _shown("mode", own)
            text = "whether it stuck or slipped in the last step"
            yield Sensor(name, "-", text, array, needs=("contacts",), items=several, codes=ContactMode)
        for key, (part, attribute, unit, meaning) in OF_SCENE.items():
            yield Sensor(f"scene.{key}", unit, meaning, _of_scene(part, attribute))


# name: (struct, array, unit, what it is)
OF_SCENE = {
    "closed_contacts": ("outcome", "count", "-", "nonsmooth contacts that were closed in the last step"),
    "solve_residual": ("outcome", "residual", "-", "what is left of the contact problem of the last step"),
    "solve_iterations": ("outcome", "iterations", "-", "iterations of its solver"),
    "solve_converged": ("outcome", "converged", "-", "1: to its tolerance"),
    "solve_failures": ("account", "failures", "-", "steps that were not solved to it, since reset"),
    "restitution_limited": (
        "account",
        "restitution_limited",
        "-",
        "steps in which restitution was lowered to bring no energy",
    ),
    "friction_dissipation": (
        "account",
        "friction_dissipation",
        "J",
        "energy that friction of nonsmooth contacts took, since reset",
    ),
    "impact_dissipation": (
        "account",
        "impact_dissipation",
        "J",
        "energy that impacts of nonsmooth contacts took, since reset",
    ),
}


def is_of_hard_contact(name: str) -> bool:
    """Whether a sensor is one of nonsmooth contacts alone, by its name."""
    element, _, quantity = name.rpartition(".")
    return quantity in OF_SCENE if element == "scene" else quantity in ("impulse", "mode")


def sensor_hint(name: str, known: Collection[str], scene: Scene) -> str:
    """Returns the end of a message about an unknown sensor: the integrator that has it, or similar names."""
    element = name.rpartition(".")[0]
    contacts = {contact.name for contact in scene.contacts} | {contact.name for contact in scene.shape_contacts}
    if is_of_hard_contact(name) and (element == "scene" or element in contacts):
        return "; only nonsmooth contact has it, with the integrator MoreauJean"
    return similar(name, known)


def _shown(attribute: str, own: int | slice) -> Any:
    return lambda arrays: getattr(arrays.hard.shown, attribute)[:, own]


def _of_scene(part: str, attribute: str) -> Any:
    return lambda arrays: getattr(getattr(arrays.hard, part), attribute)


def _items(first: int, count: int) -> slice:
    return slice(first, first + count)


def _runs(ranges: Iterable[slice]) -> list[tuple[int, int]]:
    """Returns what lies side by side of some ranges in order, as the first and how many."""
    runs: list[tuple[int, int]] = []
    for own in ranges:
        if runs and sum(runs[-1]) == own.start:
            runs[-1] = (runs[-1][0], own.stop - runs[-1][0])
        else:
            runs.append((own.start, own.stop - own.start))
    return runs
