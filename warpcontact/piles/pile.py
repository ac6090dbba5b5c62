"""A particle contact on a device: what the step, resets and sensors need of it."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact import checks, frames
from warpcontact import elements as limits_of
from warpcontact.allocation import COUNT
from warpcontact.arrays import Layout, fixed, per_env
from warpcontact.checks import Array
from warpcontact.groups import compile_forces
from warpcontact.kernels.formula import Formula, coefficient_struct
from warpcontact.kernels.memory import memory_struct
from warpcontact.kernels.piles import force, history, lists, measures, sums
from warpcontact.kernels.piles.base import NONE, TOUCHED, TOUCHES, Form, pile_structs
from warpcontact.kernels.touch import group_structs
from warpcontact.kernels.types import FREE
from warpcontact.parameters import ClosedGap, Field, Parameter, Parameters, Upload, pack
from warpcontact.piles.elements import ParticleContact
from warpcontact.piles.room import FEW, all_pairs, owned_of, partners_around
from warpcontact.schedule import FEW_TOGETHER
from warpcontact.sensors import Sensor, shape_in
from warpcontact.smooth.elements import Shape

if TYPE_CHECKING:
    from warpcontact.scene import Scene
    from warpcontact.schedule import Span

# What a step takes of the cache of a core: of an entry, and of a shape with the records of its touches.
ENTRY_BYTES = 8
SHAPE_BYTES = 300

_RANGES = {
    "kappa": limits_of.KAPPA,
    "max_depth": limits_of.MAX_DEPTH,
    "torsion_radius": limits_of.TORSION_RADIUS,
    "force_scale": limits_of.FORCE_SCALE,
    "enabled": limits_of.ENABLED,
}
_FOR_ALL = {
    "contacts": ("contacts", "-", "number of pairs that touch"),
    "normal_force": ("normal_force", "N", "sum of the normal forces of all pairs"),
    "max_penetration": ("max_penetration", "m", "deepest penetration of a pair, 0 without contact"),
    "max_normal_force": ("max_normal_force", "N", "largest normal force of a pair"),
}
_FOR_EACH = {
    "coordination": ("coordination", "-", "number of shapes that touch each shape"),
    "force": ("force", "N", "force of the others on each shape, world"),
}


class Pile:
    """A particle contact on a device.

    Args:
        contact: The particle contact.
        scene: What it is in.
        layout: Where to declare arrays.
        parameters: Where to add parameters; those of the shapes are there.
        types: Structs of the precision.

    Attributes:
        contact: The particle contact.
        fixed: Whether its lists are those of all pairs.
        entries: Entries of all lists of an environment.
        slots: Records of an environment.
        shapes: Its shapes, lists and records on the device, and what lists are made with.
        lists: See there.
        touches: See there.
        grid: See there.
        measured: What sensors are measured into.
    """

    def __init__(
        self,
        contact: ParticleContact,
        scene: "Scene",
        layout: Layout,
        parameters: Parameters,
        types: SimpleNamespace,
    ) -> None:
        self.contact = contact
        self.real = types.real
        self._types = types
        self._parts = contact.parts
        t = pile_structs(self.real)
        self.shapes, self.lists = t.Shapes(), t.Lists()
        self._pose = {
            key: [_parameter(parameters, shape, key) for shape in contact.shapes]
            for key in ("radius", "half_length", "position", "orientation")
        }
        count = contact.count
        self.fixed = count <= FEW
        self._room = self._make_lists(layout, parameters)
        placed = any(shape.positions.any() for shape in contact.shapes)
        self._form = Form(
            placed=placed, long=any(one is not None for one in self._pose["half_length"]), fixed=self.fixed
        )
        self.touches = layout.struct(
            "piles",
            t.Touches,
            per_env(self.slots),
            records=True,
            transient=[name for name in t.Touches.vars if name not in ("entry_speed", "bits", "busy")],
            ranges=dict.fromkeys(("bits", "busy"), (0, TOUCHES | TOUCHED)),
            bits=per_env(self.slots),
            busy=per_env(count),
        )
        self._buckets = 1 << (max(16, count) - 1).bit_length()
        self.grid = self._make_grid(layout)
        self._add_shapes(layout, parameters, sum(body.count for body in scene.bodies))
        self._add_settings(parameters)
        self._add_formulas(layout, parameters)
        self.measured = layout.struct(
            "piles",
            measures.measured(self.real),
            per_env(),
            transient=True,
            coordination=per_env(count),
            force=per_env(count),
        )
        moves = self._parts.law.needs_mass and any(body.motion.kind != FREE for body in scene.bodies)
        # Of the CPU, where a slice of the environments has one thread at a time.
        self._alone = layout.device.is_cpu
        self._kernel = force.kernel(self._parts, self._form, self.real, moves, self._alone)

    @property
    def _finder(self) -> wp.Kernel:
        """The kernel that finds touches that have no force."""
        return force.kernel(self._parts, self._form, self.real, moves=False, alone=True, hard=True)

    def _make_lists(self, layout: Layout, parameters: Parameters) -> NDArray[np.int_] | None:
        """Declares the lists; returns how many partners each shape may have, ``None`` if they are all pairs."""
        contact = self.contact
        count = contact.count
        if self.fixed:
            owned, others = all_pairs(contact.bodies, *contact.kinds)
            rows = [[*own, *other] for own, other in zip(owned, others, strict=True)]
            starts, slots = (np.cumsum([0, *map(len, each)]) for each in (rows, owned))
            slot_of = {
                frozenset((shape, partner)): slots[shape] + k
                for shape, own in enumerate(owned)
                for k, partner in enumerate(own)
            }
            records = [slot_of[frozenset((shape, partner))] for shape, row in enumerate(rows) for partner in row]
            # Shared by all environments.
            for name, values in (
                ("owned", [len(own) for own in owned]),
                ("count", [len(row) for row in rows]),
                ("partner", [partner for row in rows for partner in row] or [NONE]),
                ("slot", records or [NONE]),
            ):
                parameters.upload(self.lists, name, wp.int32, _constant(values))
            room = None
        else:
            if contact.max_neighbors is None:
                room = partners_around(*self._sizes(), contact.skin).max(axis=0)
            else:
                room = np.full(count, min(contact.max_neighbors, count - 1))
            starts, slots = (np.cumsum([0, *most]) for most in (room, owned_of(room)))
            # Kept, as the history of a pair is found by them; after a checkpoint they are made again.
            ranges = {
                "owned": (0, np.diff(slots)),
                "count": (0, np.diff(starts)),
                "partner": (0, count - 1),
                "slot": (NONE, int(slots[-1]) - 1),
            }
            for name, entries in (
                ("owned", count),
                ("count", count),
                ("partner", starts[-1]),
                ("slot", starts[-1]),
            ):
                layout.array("piles", self.lists, name, wp.int32, per_env(int(entries)), ranges=ranges)
        self.entries, self.slots = int(starts[-1]), max(1, int(slots[-1]))
        layout.content("piles", self.shapes, "entry_start", starts, wp.int32)
        layout.content("piles", self.shapes, "slot_start", slots, wp.int32)
        return room

    def _make_grid(self, layout: Layout) -> Any:
        count = self.contact.count
        each = fixed(1, 1) if self.fixed else per_env(count)
        Grid = pile_structs(self.real).Grid
        counts = dict.fromkeys(("made", "missing"), COUNT)
        return layout.struct(
            "piles",
            Grid,
            each,
            transient=[name for name in Grid.vars if name not in counts],
            ranges=counts,
            stale=per_env(),
            known=per_env(),
            made=per_env(),
            missing=per_env(),
            head=fixed(1, 1) if self.fixed else per_env(self._buckets),
            key=fixed(1, 1) if self.fixed else per_env(self.entries),
        )

    def _sizes(self) -> tuple[Array, Array]:
        """Returns radii and half lengths of all shapes, (1 or envs, n) each."""
        return self._column("radius"), self._column("half_length")

    def _column(self, key: str) -> Array:
        """Returns a quantity of all shapes, (1 or envs, n, …); 0 where it is none of a shape."""
        columns = [
            np.zeros((1, shape.count)) if one is None else one.field.values[:, one.items]
            for one, shape in zip(self._pose[key], self.contact.shapes, strict=True)
        ]
        envs = max(len(column) for column in columns)
        return np.concatenate([np.broadcast_to(c, (envs, *c.shape[1:])) for c in columns], axis=1)

    def _add_shapes(self, layout: Layout, parameters: Parameters, body_count: int) -> None:
        """Adds where the shapes are and how large they are, and which bodies have them."""
        contact, shapes, vec3 = self.contact, self.shapes, self._types.vec3
        kinds, allowed = contact.kinds
        for name, numbers in (("body", contact.bodies), ("kind", kinds), ("allowed", allowed)):
            layout.content("piles", shapes, name, numbers, wp.int32)
        order = np.argsort(contact.bodies, kind="stable")
        bodies, starts = np.unique(contact.bodies[order], return_index=True)
        self._carriers = len(bodies)
        # Side by side in the order of their bodies, a shape is its own carrier.
        self._single = np.array_equal(bodies, contact.bodies)
        of_body = np.full(body_count, NONE)
        of_body[contact.bodies] = np.arange(contact.count)
        layout.content("piles", shapes, "of_body", of_body, wp.int32)
        for name, values in (
            ("carrier_body", bodies),
            ("carrier_start", [*starts, contact.count]),
            ("carrier_shape", order),
        ):
            layout.content("piles", shapes, name, values, wp.int32)

        def axes() -> Array:
            half = self._column("half_length")
            turn = self._column("orientation")
            ends = half[..., None] * np.array([0.0, 0.0, 1.0])
            return frames.placed(ends[..., None, :], np.zeros(3), turn)[..., 0, :]

        follow: dict[str, list[Upload]] = {
            "radius": [parameters.upload(shapes, "radius", self.real, self._radii)],
            "half_length": [],
            "position": [],
            "orientation": [],
        }
        follow["position"] = [parameters.upload(shapes, "offset", vec3, self._offsets)]
        if self._form.long:
            follow["half_length"] = follow["orientation"] = [parameters.upload(shapes, "axis", vec3, axes)]
        else:
            layout.array("piles", shapes, "axis", vec3, fixed(1, 1), transient=True)
        for key, uploads in follow.items():
            for one in self._pose[key]:
                if one is not None:
                    one.uploads.extend(uploads)

    def _offsets(self) -> Array:
        """Returns where the shapes are on their bodies, (1 or envs, n, 3).

        Raises:
            ValueError: If one has moved away from the centre of its body, and the kernels look for none elsewhere.
        """
        offsets = self._column("position")
        if not self._form.placed and offsets.any():
            raise ValueError(
                f"{self.contact.name}: its shapes were all at the centre of mass of their body when the model was "
                "built; give one another position in add_shape to let them be elsewhere"
            )
        return offsets

    def _radii(self) -> Array:
        """Returns the radii of all shapes, (1 or envs, n), if there is room for as many partners as they may have.

        Raises:
            ValueError: If there is not.
        """
        radius, half = self._sizes()
        if self._room is not None and self.contact.max_neighbors is None:
            needed = partners_around(radius, half, self.contact.skin)
            if (needed > self._room).any():
                shape = int((needed - self._room).max(axis=0).argmax())
                raise ValueError(
                    f"{self.contact.name}: with these radii {self.contact.label(shape)!r} may have "
                    f"{needed[:, shape].max()} partners, and there is room for {self._room[shape]}; build the "
                    "scene with the largest and smallest radii that are to come, or give add_particle_contact "
                    "max_neighbors="
                )
        return radius

    def _add_settings(self, parameters: Parameters) -> None:
        contact = self.contact
        struct = pile_structs(self.real).Settings
        # A torsion radius that is not given follows from the overlap.
        values = {key: getattr(contact, key) for key in _RANGES}
        fields = {key: Field(np.array([-1.0 if value is None else value])) for key, value in values.items()}
        fields["closed"] = Field(np.zeros(1))

        def content() -> NDArray[Any]:
            radius, half = self._sizes()
            columns = {key: field.values for key, field in fields.items()}
            columns["skin"] = np.full((1, 1), contact.skin)
            columns["cell"] = 2.0 * (radius + half).max(axis=1, keepdims=True) + contact.skin
            return pack(struct, columns)

        upload = parameters.upload(self.shapes, "settings", struct, content)
        self.closed = ClosedGap(fields["closed"], upload)
        for key in ("radius", "half_length"):
            for one in self._pose[key]:
                if one is not None:
                    one.uploads.append(upload)
        for key, allowed in _RANGES.items():
            if values[key] is not None:
                parameters.add(
                    f"{contact.name}.{key}",
                    fields[key],
                    slice(0, 1),
                    allowed,
                    [upload],
                    convert=checks.switches if key == "enabled" else None,
                )

    def _add_formulas(self, layout: Layout, parameters: Parameters) -> None:
        """Adds the parameters of law and friction models, the same for all pairs, and what these remember."""
        Coefficients, Memory = group_structs(self._parts, self.real)
        self._coefficients, self._memory, self._kept = Coefficients(), Memory(), Memory()
        for part, formula in self.contact.formulas.items():
            self._add_formula(part, formula, parameters)
            for target in (self._memory, self._kept):
                # Never looked at if the formula remembers nothing.
                shape = per_env(self.slots) if formula.memories else fixed(1, 1)
                transient = target is self._kept or not formula.memories
                struct = memory_struct(type(formula), self.real)
                layout.array("piles", target, part, struct, shape, transient=transient)

    def _add_formula(self, part: str, formula: Formula, parameters: Parameters) -> None:
        struct = coefficient_struct(type(formula), self.real)
        fields = {name: Field(np.array([float(value)])) for name, value in formula.parameters().items()}

        def content() -> NDArray[Any]:
            if not formula.device_names():
                return pack(struct, {"unused": np.zeros((1, 1))})
            values = [field.values for field in fields.values()]
            computed = formula.coefficients(dict(zip(fields, np.broadcast_arrays(*values), strict=True)))
            return pack(struct, {name: computed[name] for name in formula.device_names()})

        upload = parameters.upload(self._coefficients, part, struct, content, items=self.slots)
        for name, field in fields.items():
            full = f"{self.contact.name}.{part}.{name}"
            parameters.add(full, field, slice(0, 1), formula.limits(name), [upload])

    @property
    def bytes_near(self) -> int:
        """About what a step reads and writes of it in an environment [bytes]."""
        return ENTRY_BYTES * self.entries + SHAPE_BYTES * self.contact.count

    def compile(self, device: wp.Device) -> None:
        """Compiles the force kernel of a user's law, so that a mistake in it shows at once.

        Raises:
            TypeError: If a law or friction does not compile.
        """
        compile_forces(self._parts, lambda: self._kernel, device, self.real)

    @property
    def sums_by_body(self) -> bool:
        """Whether who integrates a body may add its touches up: of one shape, and not added as they are found."""
        return self._single and not self._alone

    def force_stages(
        self, span: "Span", state: Any, step: wp.array, status: wp.array, *, by_block: bool = False
    ) -> list[wp.Launch]:
        """Returns the launches that add what its shapes do to each other to the wrenches of ``state``.

        Arguments are those of ``schedule.force_stages``. Of hard pairs, those that find where they touch.
        """
        model = span.model.arrays.model
        count, wrenches = self.contact.count, span.model.arrays.wrenches
        shapes, lists_, touches, grid = self.shapes, self.lists, self.touches, self.grid
        launches = [] if self.fixed else self._list_stages(span, state, status)
        hard = self._is_hard(span)
        kernel = self._finder if hard else self._kernel
        inputs = [status, model, state, shapes, lists_, grid, self._memory, step, self._coefficients, touches]
        inputs += [self._kept, span.watched, wrenches]
        launches += span.prepare(kernel, count, inputs, together=FEW_TOGETHER)
        if not (self._alone or hard or by_block):
            adding = sums.add(self.real, self._single)
            inputs = [status, state, shapes, lists_, touches, wrenches]
            launches += span.prepare(adding, self._carriers, inputs, together=FEW_TOGETHER)
        return launches

    def _list_stages(self, span: "Span", state: Any, status: wp.array) -> list[wp.Launch]:
        """Returns the launches that make the lists anew where they do not hold."""
        count, buckets, real, form = self.contact.count, self._buckets, self.real, self._form
        shapes, lists_, touches, grid = self.shapes, self.lists, self.touches, self.grid
        impulses = []
        if span.hard is not None and self._is_hard(span):
            inputs = [status, shapes, lists_, grid, span.hard.number_of(self.contact), span.hard.memory]
            impulses = span.prepare(lists.carry_impulses(real), count, inputs)
        return [
            *span.prepare(lists.check(form, real), count, [status, state, shapes, grid]),
            *span.prepare(lists.clear(real), buckets, [status, grid]),
            *span.prepare(lists.fill(form, real), count, [status, buckets, state, shapes, grid]),
            *span.prepare(
                lists.gather(form, real), count, [status, buckets, state, shapes, lists_, touches, grid]
            ),
            *impulses,
            *span.prepare(
                lists.carry(self._parts, real),
                count,
                [status, shapes, lists_, touches, grid, self._kept, self._memory],
            ),
            *span.prepare(lists.join(real), count, [status, shapes, lists_, grid]),
        ]

    def accept_stages(self, span: "Span") -> list[wp.Launch]:
        """Returns the launch that remembers what an accepted step led to."""
        status = span.model.arrays.status
        inputs = [status, self.shapes, self.lists, self.touches, self._kept, self._memory]
        kernel = history.advance(self._parts, self.real, self._is_hard(span))
        return span.prepare(kernel, self.contact.count, inputs, together=FEW_TOGETHER)

    def _is_hard(self, span: "Span") -> bool:
        return span.hard is not None and not span.hard.acts(self.contact.name)

    def restart(self, chosen: wp.array, envs: int) -> None:
        """Empties what the environments of the mask ``chosen`` [env] remember."""
        inputs = [chosen, self.touches.bits, self.touches.busy, self.grid.known, self.grid.made, self.grid.missing]
        wp.launch(
            history.forget(), dim=(envs, max(self.slots, self.contact.count)), inputs=inputs, device=chosen.device
        )

    def forget_lists(self) -> None:
        """Lets all lists be made anew: they may not hold for other radii or places."""
        self.grid.known.zero_()

    def shortage(self) -> str | None:
        """Returns what is wrong if a list was too short since reset; waits for the device."""
        most = int(self.grid.missing.numpy().max(initial=0))
        if most == 0:
            return None
        return (
            f"{self.contact.name}: a shape had {most} partners more than there is room for, and their forces are "
            f"missing; give add_particle_contact a larger max_neighbors=, or a smaller skin than {self.contact.skin:g} m"
        )

    def measure(self, envs: int, device: wp.Device) -> None:
        """Measures what its sensors are, of the forces computed last."""
        inputs = [self.shapes, self.lists, self.touches]
        outputs = [self.measured]
        count = self.contact.count
        kernel = measures.shapes(self.real)
        wp.launch(kernel, dim=(envs, count), inputs=inputs, outputs=outputs, device=device)
        kernel = measures.totals(self.real)
        wp.launch(kernel, dim=envs, inputs=[count, *inputs], outputs=outputs, device=device)

    def sensors(self) -> Iterator[Sensor]:
        """Iterates over what can be measured."""
        name, count = self.contact.name, self.contact.count
        for quantity, (attribute, unit, meaning) in _FOR_ALL.items():
            array, shape = self._array(attribute), shape_in(self.measured, attribute)
            yield Sensor(f"{name}.{quantity}", unit, meaning, array, needs=("contacts", "piles"), shape=shape)
        for quantity, (attribute, unit, meaning) in _FOR_EACH.items():
            array = self._array(attribute)
            shape, needs = shape_in(self.measured, attribute), ("contacts", "piles")
            yield Sensor(f"{name}.{quantity}", unit, meaning, array, needs=needs, items=count, shape=shape)

    def _array(self, attribute: str) -> Any:
        return lambda _: getattr(self.measured, attribute)


def _constant(values: list[int]) -> Callable[[], NDArray[Any]]:
    row = np.array(values, dtype=np.int32)[None]
    return lambda: row


def _parameter(parameters: Parameters, shape: Shape, key: str) -> Parameter | None:
    """Returns a parameter of a shape, ``None`` if it has none of this name."""
    return parameters.by_name.get(f"{shape.name}.{key}")


def touches_of(pile: Pile | None, real: type) -> list[Any]:
    """Returns shapes, lists and touches of a pile, as kernels take them; of none those that are not looked at."""
    if pile is not None:
        return [pile.shapes, pile.lists, pile.touches]
    t = pile_structs(real)
    return [t.Shapes(), t.Lists(), t.Touches()]


def make_piles(scene: "Scene", layout: Layout, parameters: Parameters, types: SimpleNamespace) -> list[Pile]:
    """Declares the arrays of all particle contacts, and adds their parameters."""
    return [Pile(contact, scene, layout, parameters, types) for contact in scene.particle_contacts]
