"""A built scene: parameters, state and memory of many environments on one device."""

from collections.abc import Collection, Iterable, Mapping, Set
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.arrays import Layout, broadcast
from warpcontact.blocks import Blocks
from warpcontact.captures import beside_captures
from warpcontact.couplings.coupling_set import CouplingSet
from warpcontact.drives import Drive
from warpcontact.environments import Environments
from warpcontact.footprint import Need
from warpcontact.groups import Group
from warpcontact.looks import look_span, look_stages, shows
from warpcontact.of_scene import MEASURES, SMOOTH, OfScene
from warpcontact.parameters import Parameter, Upload, needs_of
from warpcontact.scene import Contact, Scene
from warpcontact.schedule import Span
from warpcontact.sensors import Sensor
from warpcontact.sides import Sides

if TYPE_CHECKING:
    from warpcontact.outcomes.observer import Observer
    from warpcontact.piles.pile import Pile
    from warpcontact.smooth.contact_sets import ShapeContactSet
    from warpcontact.unilateral.hard_contacts import HardContacts

#: What is 0 of a contact that does not touch.
WITHOUT_CONTACT = ("penetration", "approach_speed", "normal_force", "friction_force", "slip_speed", "torque")


@dataclass(frozen=True)
class State:
    """State of all bodies: Warp arrays (envs, bodies) that keep their memory for the life of the model.

    Write into them (``state.body_position.assign(values)``), do not replace them.

    Attributes:
        body_position: Centre of mass, world [m], as far as the precision tells it.
        body_position_remainder: What rounding left of it [m]: the centre of mass is at the sum of both. To place a
            body to the precision it is enough to write the position.
        body_orientation: Rotation body → world, quaternion (x, y, z, w).
        body_linear_velocity: Velocity of the centre of mass, world [m/s].
        body_angular_velocity: Angular velocity, world axes [rad/s].
    """

    body_position: wp.array
    body_position_remainder: wp.array
    body_orientation: wp.array
    body_linear_velocity: wp.array
    body_angular_velocity: wp.array


@dataclass(frozen=True)
class External:
    """Forces from outside on all bodies: Warp arrays (envs, bodies), to be written between steps.

    Attributes:
        force: Force at the centre of mass, world [N].
        torque: Torque, world axes [N·m].
    """

    force: wp.array
    torque: wp.array


class Model(Environments, OfScene):
    """Many environments of one scene on a device. Made by ``Scene.build``.

    ``model["ball.mass"]`` reads a parameter, (envs, …); ``model["ball.mass"] = values`` sets it, from one value
    or one per environment. ``model.sensor("touch.gap")`` measures the current state.

    Attributes:
        scene: The scene it was built from.
        envs: Number of environments.
        first_env: Number of the first, 0 unless they are a part, or a batch, of more.
        device: Warp device.
        precision: ``"float32"`` or ``"float64"``.
        state: The current state, arrays to share with NumPy, PyTorch or JAX without a copy.
        time: Simulated time since the last complete reset [s].
    """

    def __init__(
        self,
        scene: Scene,
        envs: int,
        device: wp.Device,
        precision: str,
        types: SimpleNamespace,
        layout: Layout,
        arrays: SimpleNamespace,
        parameters: dict[str, Parameter],
        uploads: list[Upload],
        groups: list[Group],
        couplings: list[CouplingSet],
        smooth: "list[ShapeContactSet]",
        piles: "list[Pile]",
        drives: list[Drive],
        blocks: Blocks,
        sensors: dict[str, Sensor],
        sides: dict[Contact, list[Sides]],
        meshes: list[wp.Mesh],
    ) -> None:
        self.scene = scene
        self.envs = envs
        self.device = device
        self.precision = precision
        self.types = types
        self.layout = layout
        self.arrays = arrays
        self.groups = groups
        self.couplings = couplings
        self.smooth = smooth
        self.piles = piles
        self.drives = drives
        self.blocks = blocks
        self.parameters = parameters
        self.first_env = 0
        # Goes up when a device array moves: whoever prepared launches prepares them again.
        self.revision = 0
        # Simulated time since the last complete reset [s].
        self.elapsed = 0.0
        # Whether the state is still the initial one, which then follows its parameters.
        self.untouched = True
        self.sensors = sensors
        self.sides = sides
        self._meshes = meshes  # kept alive: a kernel only holds their ids
        # Step of 0 [env, 0]: for the forces of an instant.
        self.no_step = broadcast(arrays.instant, envs)
        # Status [env] of environments that are all active: a frozen one can be measured as well.
        self.all_active = broadcast(arrays.active, envs)
        # Launches of all environments by what they are for, as of a revision.
        self._looks: tuple[int, dict[frozenset[str], list[wp.Launch]]] = (-1, {})
        # Contacts that the last simulation solves for impulses, and what it watches.
        self.hard: HardContacts | None = None
        self.observer: Observer | None = None
        # Whether any of them has a restitution.
        self.bounces = False
        # Whether forces from outside are written where they lie.
        self.handed_out = False
        self._uploads = uploads  # kept alive: broadcast arrays do not own their memory
        self.send(uploads, (upload.content() for upload in uploads))
        self._state = State(**{name: getattr(arrays.state, name) for name in types.State.vars})
        self.reset()

    @property
    def parts(self) -> tuple["Model", ...]:
        """The model itself: all its environments are on one device."""
        return (self,)

    @property
    def state(self) -> State:
        """The current state: arrays (envs, bodies)."""
        return self._state

    @property
    def external(self) -> External:
        """Forces from outside as arrays, to be written between steps without a copy.

        From the first look at them each environment has its own. To set ``<body>.external_force`` or
        ``<body>.external_torque`` afterwards writes all of its array anew.
        """
        if not self.handed_out:
            self.handed_out = True
            for quantity in ("external_force", "external_torque"):
                name = f"{self.scene.bodies[0].name}.{quantity}"
                values = self[name]
                self.assign(name, values[:, None] if self.scene.bodies[0].single else values)
        model = self.arrays.model
        return External(force=model.body_external_force, torque=model.body_external_torque)

    def _look_for_bounces(self) -> None:
        bounces = self.hard is not None and self.hard.bounces(self.parameters)
        if self.bounces != bounces:
            self.bounces = bounces
            self.revision += 1

    def attach(self, hard: "HardContacts | None", observer: "Observer | None" = None) -> None:
        """Lets contacts be those of the simulation that is to step: ``hard`` ones, or all with their forces.

        Hard ones remember nothing then: what they do may be of before a reset, or of a step of another simulation.
        The ``observer`` of what it watches likewise begins anew.

        Raises:
            ValueError: If a parameter has a value that nonsmooth contact does not allow; nothing is changed then.
        """
        if hard is not self.hard:
            if hard is not None:
                hard.check_shares(self.parameters)
            self._exchange(hard)
        if observer is not self.observer:
            self.observer = observer
            if observer is not None:
                self._observe_anew(observer)

    def check_value(self, name: str, values: NDArray[np.float64]) -> None:
        """Raises ``ValueError`` if nonsmooth contact does not allow ``values`` of parameter ``name``."""
        if self.hard is not None:
            self.hard.check_share(name, values)

    @beside_captures()
    def _observe_anew(self, observer: "Observer") -> None:
        # Steps that nobody watched may have told nothing; contacts that touch are looked at in any case.
        self._forget_touches()
        observer.restart(wp.full(self.envs, True, dtype=wp.bool, device=self.device))

    @beside_captures()
    def _exchange(self, hard: "HardContacts | None") -> None:
        if self.hard is not None:
            self.hard.let_go(self)
            for own in self.hard.sensors():
                del self.sensors[own.name]
        self.hard = self.arrays.hard = hard
        if hard is not None:
            hard.follow(self)
            self.sensors.update((own.name, own) for own in hard.sensors())
        self._look_for_bounces()
        # Nobody writes what nonsmooth contacts would do to bodies by a force.
        near, ends = self.arrays.near, self.arrays.ends
        for array in (near.force, near.torque_1, near.torque_2, ends.force, ends.torque):
            array.zero_()
        # Nor what they showed is what a contact says that does not touch.
        self._forget_touches()

    def _forget_touches(self) -> None:
        """Has all contacts say what those do that do not touch."""
        for name in WITHOUT_CONTACT:
            getattr(self.arrays.contacts, name).zero_()
        self._looks = (-1, {})

    @property
    def parameters_by_name(self) -> Mapping[str, Parameter]:
        """The parameters by their names."""
        return self.parameters

    def _is_pushed(self) -> bool:
        names = [f"{self.scene.bodies[0].name}.{quantity}" for quantity in ("external_force", "external_torque")]
        return self.handed_out or any(bool(self.parameters[name].field.values.any()) for name in names)

    def starts_from(self, parameter: Parameter) -> bool:
        """Whether ``parameter`` says where the state begins."""
        starts = [self.arrays.initial, *(drive.arrays for drive in self.drives)]
        return any(
            upload.attribute == "body_motion" or any(upload.struct is start for start in starts)
            for upload in parameter.uploads
        )

    @beside_captures()
    def restart(self, mask: NDArray[np.bool_]) -> None:
        """Puts the environments of ``mask`` (envs,) back to their initial state, with empty history."""
        from warpcontact.kernels import contact_coupling, reset

        a = self.arrays
        chosen = wp.array(mask, dtype=wp.bool, device=self.device)
        wp.launch(
            reset.environments(self.types.real),
            dim=self.envs,
            inputs=[
                chosen,
                self.body_count,
                self.contact_count,
                self.blocks.count,
                self.blocks.set_count,
                a.initial,
                a.status,
                a.guard.cause,
                a.time,
                a.state,
                a.history,
                a.cache,
                a.near,
                a.wrenches,
            ],
            device=self.device,
        )
        if a.reached is not None:
            wp.launch(
                contact_coupling.forget(self.types.real),
                dim=(self.envs, len(self.scene.contact_couplings)),
                inputs=[chosen, a.reached],
                device=self.device,
            )
        for group in self.groups:
            for formula, memory, _ in group.memories():
                wp.launch(
                    reset.memory(formula, self.types.real),
                    dim=(self.envs, group.count),
                    inputs=[chosen, memory],
                    device=self.device,
                )
        for couplings in self.couplings:
            couplings.restart(chosen, self.envs)
        for contacts in self.smooth:
            contacts.restart(chosen, self.envs)
        for pile in self.piles:
            pile.restart(chosen, self.envs)
        if self.hard is not None:
            self.hard.restart(chosen)
        if self.observer is not None:
            self.observer.restart(chosen)
        if self.moves:
            self._start_motions(chosen)

    def _start_motions(self, chosen: wp.array) -> None:
        """Takes off velocities that joints do not allow, and puts what follows a function of time to its start."""
        from warpcontact.kernels.motions import driven, project

        a, real = self.arrays, self.types.real
        shape = (self.envs, self.body_count)
        wp.launch(project.kernel(real), dim=shape, inputs=[chosen, a.model, a.state], device=self.device)
        for drive in self.drives:
            wp.launch(
                driven.start(drive.motion, real),
                dim=(self.envs, drive.count),
                inputs=[chosen, a.time, a.model, *drive.inputs, a.state],
                device=self.device,
            )

    @beside_captures()
    def look(self, needs: Set[str], own: wp.array | None = None) -> list[wp.Launch]:
        """Returns the launches that compute what sensors need, of frozen environments too.

        ``measure_all`` does the rest.

        Args:
            needs: Those of the sensors.
            own: Of which environments, see ``Span.slice``; ``None``: of all.
        """
        span = look_span(Span, self, self.envs, self.hard, needs, own)
        return look_stages(span, needs, self.no_step, self.all_active)

    @beside_captures()
    def prepare(self, needs: Set[str]) -> None:
        """Computes what sensors of the current state need, by their ``needs``; there is room to measure into."""
        if self._looks[0] != self.revision:
            self._looks = (self.revision, {})
        known, wanted = self._looks[1], frozenset(needs)
        if wanted not in known:
            known[wanted] = self.look(wanted)
        for launch in known[wanted]:
            launch.launch()
        self.measure_all(needs)

    def measure_all(self, needs: Set[str]) -> None:
        """Computes the rest of what sensors need, after the launches of ``look`` for all environments."""
        if self.hard is not None and shows(needs):
            self.hard.show(self)
        if "reactions" in needs:
            self._measure_reactions()
        if "contact_couplings" in needs:
            self._measure_contact_couplings()
        for name in SMOOTH:
            if name in needs:
                from warpcontact.smooth.measures import measure

                measure(name, self)
        if "piles" in needs:
            for pile in self.piles:
                pile.measure(self.envs, self.device)

    @beside_captures()
    def add_measures(self, names: Collection[str]) -> None:
        """Allocates those of ``MEASURES`` with ``names`` that are not there yet."""
        made = {name: MEASURES[name](self.layout, self) for name in names if getattr(self.arrays, name) is None}
        self.layout.allocate(self.envs)
        for name, arrays in made.items():
            setattr(self.arrays, name, arrays)

    def needs(self) -> list[Need]:
        """Returns what its arrays take, on the device and on the host."""
        return self.layout.needs(self.envs) + needs_of(self.parameters, self._uploads, self.envs)

    def _measure_reactions(self) -> None:
        from warpcontact.kernels.motions import driven, measures

        a, real = self.arrays, self.types.real
        for drive in self.drives:
            wp.launch(
                driven.accelerate(drive.motion, real),
                dim=(self.envs, drive.count),
                inputs=[a.time, a.model, *drive.inputs],
                outputs=[a.reactions.linear, a.reactions.angular],
                device=self.device,
            )
        inputs, shape = [a.model, a.state, a.wrenches], (self.envs, self.body_count)
        wp.launch(measures.reactions(real), dim=shape, inputs=inputs, outputs=[a.reactions], device=self.device)

    def _measure_contact_couplings(self) -> None:
        from warpcontact.kernels import contact_coupling

        a, shape = self.arrays, (self.envs, len(self.scene.contact_couplings))
        kernel = contact_coupling.measure(self.types.real)
        inputs = [a.model, a.state, a.contacts, a.coupling_contacts]
        wp.launch(kernel, dim=shape, inputs=inputs, outputs=[a.contact_couplings], device=self.device)

    def group_of(self, contact: Contact) -> tuple[Group, int]:
        """Returns the group that ``contact`` is computed in, and the index of its first item there."""
        own = [other for other in self.scene.contacts if other.code == contact.code]
        group = next(group for group in self.groups if (group.parts, group.projected) == contact.code)
        return group, sum(other.count for other in own[: own.index(contact)])

    @beside_captures()
    def send(self, uploads: Iterable[Upload], contents: Iterable[NDArray[Any]]) -> None:
        """Puts the content of each of ``uploads`` into its array on the device."""
        for upload, content in zip(uploads, contents, strict=True):
            if upload.send(content, self.envs):
                self.revision += 1
        # Steps without them do not look for them.
        if self.pushed != (pushed := self._is_pushed()):
            self.pushed = pushed
            self.revision += 1
        self._look_for_bounces()
        # What was known of distances may not hold for other radii, poses or meshes.
        cache = self.arrays.cache
        blocks = (cache.block_wake, cache.block_probe, cache.block_quiet)
        for known in (cache.set_wake, *blocks, cache.wake, cache.faces, cache.room):
            known.zero_()
        for pile in self.piles:
            pile.forget_lists()
