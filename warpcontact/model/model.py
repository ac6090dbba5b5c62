"""A built scene: parameters, state and device arrays of the environments on one device.

``Simulation`` steps it; sensors are evaluated by ``sensor_evaluation.py``.
"""

from collections.abc import Collection, Iterable, Mapping, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.contact_groups import ContactGroup
from warpcontact.forces.execution_plan import ExecutionPlan, KernelLister
from warpcontact.model.environments import Environments
from warpcontact.model.model_traits import ModelTraits
from warpcontact.model.plan import DeviceModelPlan
from warpcontact.model.sensor_evaluation import evaluation_plan, evaluation_stages
from warpcontact.scene.elements import Contact
from warpcontact.storage.allocation_plan import broadcast
from warpcontact.storage.memory_estimate import MemoryItem
from warpcontact.storage.parameters import DeviceField, Parameter, parameter_memory
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.compilation import load_ahead
from warpcontact.system.kernel_builds import is_compiled, starts_quick
from warpcontact.system.launches import launch_kernel

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.stepping.outcomes.observer import Monitor

#: Quantities of a contact that are 0 without contact.
ZERO_WITHOUT_CONTACT = ("penetration", "approach_speed", "normal_force", "friction_force", "slip_speed", "torque")


@dataclass(frozen=True)
class State:
    """State of all bodies: Warp arrays (envs, bodies) that keep their memory for the life of the model.

    Write into them (``state.body_position.assign(values)``), do not replace them.

    Attributes:
        body_position: Center of mass, world [m], rounded to the precision of the model.
        body_position_remainder: Rounding remainder [m]: the center of mass is the sum of both. To set a position to
            the precision of the model, it is sufficient to write ``body_position``.
        body_orientation: Rotation body → world, quaternion (x, y, z, w).
        body_orientation_remainder: Rounding remainder: the rotation is that of the normalized sum. Empty except in float32
            models with body contacts. To set an orientation, it is sufficient to write ``body_orientation``.
        body_linear_velocity: Velocity of the center of mass, world [m/s].
        body_angular_velocity: Angular velocity, world axes [rad/s].
    """

    body_position: wp.array
    body_position_remainder: wp.array
    body_orientation: wp.array
    body_orientation_remainder: wp.array
    body_linear_velocity: wp.array
    body_angular_velocity: wp.array


@dataclass(frozen=True)
class External:
    """External forces and torques on all bodies: Warp arrays (envs, bodies) that users write between steps.

    Attributes:
        force: Force at the center of mass, world [N].
        torque: Torque, world axes [N·m].
    """

    force: wp.array
    torque: wp.array


class DeviceModel(Environments, ModelTraits):
    """Environments of one scene on one device. Users get the subclass ``Model``.

    Args:
        plan: Plan of the model. It can be used once, because its arrays become those of the model.
        envs: Number of environments.

    Attributes:
        scene: A copy of the scene it was built from.
        envs: Number of environments.
        first_env: Number of the first environment; nonzero if they are a part, or a batch, of more environments.
        device: Warp device.
        precision: ``"float32"`` or ``"float64"``.
        state: The current state; arrays can be shared with NumPy, PyTorch or JAX without a copy.
        time: Simulated time since the last complete reset [s].
    """

    @shared_capture_lock()
    def __init__(self, plan: DeviceModelPlan, envs: int) -> None:
        plan.allocate(envs)
        self.scene = plan.scene
        self.envs = envs
        self.device = plan.device
        self.precision = plan.precision
        self.types = plan.types
        self.layout = plan.layout
        self.arrays = plan.arrays
        self.force_elements = plan.force_elements
        self.groups = plan.groups
        self.clusters = plan.clusters
        self.parameters = plan.parameters.by_name
        self.first_env = 0
        # Incremented when a device array is reallocated: prepared launches must then be rebuilt.
        self.revision = 0
        # Simulated time since the last complete reset [s].
        self.elapsed = 0.0
        # Whether the state is the initial one; it then follows changes of its parameters.
        self.is_initial = True
        self.sensors = plan.sensors
        self.side_regions = plan.side_regions
        self._meshes = plan.meshes  # kept alive: a kernel only holds their ids
        # Step lengths of 0 s [env, 0], for instantaneous forces.
        self.zero_step = broadcast(self.arrays.zero_step, envs)
        # Status [env] with all environments active, so that sensors of frozen environments can be evaluated.
        self.active_status = broadcast(self.arrays.active_status, envs)
        # Launches of evaluations of all environments, by needs, with their revision.
        self._evaluations: tuple[int, dict[frozenset[str], list[wp.Launch]]] = (-1, {})
        # Nonsmooth contacts and monitor of the simulation that stepped last.
        self.nonsmooth: NonsmoothContacts | None = None
        self.monitor: Monitor | None = None
        # Whether a nonsmooth contact has a nonzero restitution or compliance.
        self.has_restitution = self.has_compliance = False
        # Whether the user has access to the arrays of external forces.
        self.external_exposed = False
        self._device_fields = plan.parameters.device_fields  # kept alive: broadcast arrays do not own their memory
        self.upload(self._device_fields, (device_field.content() for device_field in self._device_fields))
        self._state = State(**{name: getattr(self.arrays.state, name) for name in self.types.State.vars})
        self._load_ahead()
        self.reset()

    @property
    def parts(self) -> tuple[Self, ...]:
        """The model itself, because all its environments are on one device."""
        return (self,)

    @property
    def state(self) -> State:
        """The current state: arrays (envs, bodies)."""
        return self._state

    @property
    def external(self) -> External:
        """External forces as arrays that can be written between steps without a copy.

        The first access allocates separate values for each environment. Setting ``<body>.external_force`` or
        ``<body>.external_torque`` afterwards overwrites the whole array.
        """
        if not self.external_exposed:
            self.external_exposed = True
            for quantity in ("external_force", "external_torque"):
                name = f"{self.scene.bodies[0].name}.{quantity}"
                values = self[name]
                self.assign(name, values[:, None] if self.scene.bodies[0].single else values)
        model = self.arrays.model
        return External(force=model.body_external_force, torque=model.body_external_torque)

    def _update_nonsmooth_flags(self) -> None:
        nonsmooth = self.nonsmooth
        has_restitution = nonsmooth is not None and nonsmooth.has_restitution(self.parameters)
        has_compliance = nonsmooth is not None and nonsmooth.has_compliance(self.parameters)
        if (self.has_restitution, self.has_compliance) != (has_restitution, has_compliance):
            self.has_restitution, self.has_compliance = has_restitution, has_compliance
            self.revision += 1

    def attach_simulation(self, nonsmooth: "NonsmoothContacts | None", monitor: "Monitor | None" = None) -> None:
        """Attaches the nonsmooth contacts and the monitor of the simulation that will step; ``None``: none.

        A newly attached simulation starts without warm starts and with restarted outcomes, because they may be
        older than a reset or a step of another simulation.

        Raises:
            ValueError: If a parameter has a value that nonsmooth contact does not allow. The model is unchanged then.
        """
        if nonsmooth is not self.nonsmooth:
            if nonsmooth is not None:
                nonsmooth.check_shares(self.parameters)
            self._set_nonsmooth(nonsmooth)
        if monitor is not self.monitor:
            self.monitor = monitor
            if monitor is not None:
                self._restart_monitor(monitor)

    def check_value(self, name: str, values: NDArray[np.float64]) -> None:
        """Raises ``ValueError`` if nonsmooth contact does not allow ``values`` of parameter ``name``."""
        if self.nonsmooth is not None:
            self.nonsmooth.check_share(name, values)

    @shared_capture_lock()
    def _restart_monitor(self, monitor: "Monitor") -> None:
        # Without a monitor, steps may not have written contact outputs. Active contacts are always evaluated.
        self._clear_contact_values()
        monitor.reset_state(wp.full(self.envs, True, dtype=wp.bool, device=self.device))

    @shared_capture_lock()
    def _set_nonsmooth(self, nonsmooth: "NonsmoothContacts | None") -> None:
        if self.nonsmooth is not None:
            self.nonsmooth.deactivate(self)
            for own in self.nonsmooth.sensors():
                del self.sensors[own.name]
        self.nonsmooth = nonsmooth
        if nonsmooth is not None:
            nonsmooth.activate(self)
            self.sensors.update((own.name, own) for own in nonsmooth.sensors())
        self._update_nonsmooth_flags()
        # Force kernels do not write the entries of nonsmooth contacts.
        active_contacts, end_wrenches = self.arrays.active_contacts, self.arrays.end_wrenches
        for array in (
            active_contacts.force,
            active_contacts.torque_1,
            active_contacts.torque_2,
            end_wrenches.force,
            end_wrenches.torque,
        ):
            array.zero_()
        # Outputs of nonsmooth contacts that are open remain otherwise.
        self._clear_contact_values()

    def _clear_contact_values(self) -> None:
        """Sets the outputs of all contacts to those of open contacts."""
        for name in ZERO_WITHOUT_CONTACT:
            getattr(self.arrays.contacts, name).zero_()
        self._evaluations = (-1, {})

    @property
    def parameters_by_name(self) -> Mapping[str, Parameter]:
        """The parameters by their names."""
        return self.parameters

    def _has_external_force(self) -> bool:
        names = [f"{self.scene.bodies[0].name}.{quantity}" for quantity in ("external_force", "external_torque")]
        return self.external_exposed or any(bool(self.parameters[name].field.values.any()) for name in names)

    def sets_initial_state(self, parameter: Parameter) -> bool:
        """Returns whether ``parameter`` is part of the initial state."""
        return any(
            device_field.struct is self.arrays.initial
            or any(
                one.sets_initial_state(device_field.struct, device_field.attribute) for one in self.force_elements
            )
            for device_field in parameter.device_fields
        )

    @shared_capture_lock()
    def reset_state(self, mask: NDArray[np.bool_]) -> None:
        """Resets the environments of ``mask`` (envs,) to their initial state, with empty history."""
        from warpcontact.kernels.acceptance import reset

        a = self.arrays
        chosen = wp.array(mask, dtype=wp.bool, device=self.device)
        launch_kernel(
            reset.environments(self.types.real),
            self.envs,
            device=self.device,
            mask=chosen,
            bodies=self.body_count,
            contacts=self.contact_count,
            clusters=self.clusters.count,
            sets=self.clusters.set_count,
            initial=a.initial,
            status=a.status,
            cause=a.guard.cause,
            time=a.time,
            state=a.state,
            history=a.history,
            cache=a.cache,
            active_contacts=a.active_contacts,
            wrenches=a.wrenches,
        )
        for element in self.force_elements:
            element.reset_state(chosen)
        if self.nonsmooth is not None:
            self.nonsmooth.reset_state(chosen)
        if self.monitor is not None:
            self.monitor.reset_state(chosen)

    def _load_ahead(self) -> None:
        """Begins to compile contact detection in another thread, if the kernel cache is cold.

        Meanwhile this thread compiles the kernel of the first reset. Each thread also compiles a header.
        """
        from warpcontact.kernels.acceptance import reset

        if starts_quick(self.device) and not is_compiled(reset.environments(self.types.real)):
            plan = KernelLister(self, self.envs, uses_cache=True, ordered_sum=True)
            for element in self.force_elements:
                kernels = element.detection_launches(plan, self.arrays.state, self.active_status)
                # The last one takes longest.
                load_ahead(reversed(kernels), self.device)

    @shared_capture_lock()
    def evaluation_launches(self, needs: Set[str], own: wp.array | None = None) -> list[wp.Launch]:
        """Returns the launches that compute the quantities in ``needs``, also of frozen environments.

        Some needs require ``evaluate_remaining_needs`` afterwards.

        Args:
            needs: Needs of the sensors.
            own: Range of environments, see ``ExecutionPlan.slice``. ``None``: all.
        """
        plan = evaluation_plan(ExecutionPlan, self, self.envs, self.nonsmooth, needs, own)
        return evaluation_stages(plan, needs, self.zero_step, self.active_status)

    @shared_capture_lock()
    def evaluate_needs(self, needs: Set[str]) -> None:
        """Computes the quantities in ``needs`` for the current state; their arrays must be allocated."""
        if self._evaluations[0] != self.revision:
            self._evaluations = (self.revision, {})
        cached, requested = self._evaluations[1], frozenset(needs)
        if requested not in cached:
            cached[requested] = self.evaluation_launches(requested)
        for launch in cached[requested]:
            launch.launch()
        self.evaluate_remaining_needs(needs)

    def evaluate_remaining_needs(self, needs: Set[str]) -> None:
        """Computes the rest of ``needs``, after ``evaluation_launches`` ran for all environments."""
        if self.nonsmooth is not None and self.needs_contacts(needs):
            self.nonsmooth.show(self)
        for element in self.force_elements:
            element.measure(self, needs)

    @shared_capture_lock()
    def allocate_sensor_arrays(self, needs: Collection[str]) -> None:
        """Allocates those arrays of sensors with ``needs`` that are not allocated yet."""
        declared = self.declare_sensor_arrays(self.layout, self.unallocated(needs))
        self.layout.allocate(self.envs)
        for table, name, arrays in declared:
            table[name] = arrays

    def memory_items(self) -> list[MemoryItem]:
        """Returns the memory of the arrays, on the device and on the host."""
        return self.layout.memory_items(self.envs) + parameter_memory(
            self.parameters, self._device_fields, self.envs
        )

    def group_of(self, contact: Contact) -> tuple[ContactGroup, int]:
        """Returns the contact group of ``contact``, and the index of its first item in the group."""
        own = [other for other in self.scene.contacts if other.code == contact.code]
        group = next(group for group in self.groups if group.code == contact.code)
        return group, sum(other.count for other in own[: own.index(contact)])

    @shared_capture_lock()
    def upload(self, device_fields: Iterable[DeviceField], contents: Iterable[NDArray[Any]]) -> None:
        """Copies the content of each of ``device_fields`` to its array on the device."""
        for device_field, content in zip(device_fields, contents, strict=True):
            if device_field.upload(content, self.envs):
                self.revision += 1
        # Launches without external forces do not read them, so they must be rebuilt.
        if self.has_external_forces != (pushed := self._has_external_force()):
            self.has_external_forces = pushed
            self.revision += 1
        self._update_nonsmooth_flags()
        # Cached distances may be invalid after changes of radii, poses or meshes.
        cache = self.arrays.cache
        clusters = (cache.cluster_safe_travel, cache.cluster_probe_travel, cache.cluster_inactive)
        for cached in (cache.set_safe_travel, *clusters, cache.safe_travel, cache.face_count, cache.clearance):
            cached.zero_()
        for element in self.force_elements:
            element.invalidate_caches()
