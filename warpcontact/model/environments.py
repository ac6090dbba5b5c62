"""Interface of models: parameters, sensors, resets and health of the environments of one scene, on any devices."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Set
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from warpcontact.forces.sensor import Sensor
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.catalogue.names import explain_renamed, stored_name
from warpcontact.model.health import Health
from warpcontact.model.model_traits import CONTACT_NEEDS
from warpcontact.scene.couplings import Catenary
from warpcontact.scene.scene_data import SceneData
from warpcontact.storage.memory_estimate import MemoryEstimate, env_count_text, require, total
from warpcontact.storage.model_arrays import Uncopied
from warpcontact.storage.parameters import Parameter
from warpcontact.system.devices import split_evenly
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, find_entry

if TYPE_CHECKING:
    import xarray as xr

    from warpcontact.forces.couplings.catenaries import CatenarySet
    from warpcontact.model.model import DeviceModel, State


@explain_renamed
@explain_keywords_of
class Environments(
    Uncopied, ABC, instead="pickle or copy its scene, and build that: model.scene.build(envs=model.envs)"
):
    """Environments of one scene on one or several devices: the interface of ``DeviceModel`` and ``SplitModel``.

    Attributes:
        scene: A copy of the scene they were built from.
        envs: Number of environments.
        first_env: Number of the first environment; nonzero if they are a batch of more environments.
        precision: ``"float32"`` or ``"float64"``.
    """

    scene: SceneData
    envs: int
    first_env: int
    precision: str

    @property
    @abstractmethod
    def parts(self) -> tuple["DeviceModel", ...]:
        """The models, each on one device, in the order of the environments."""

    @property
    @abstractmethod
    def state(self) -> "State":
        """The current state, if all environments are on one device: arrays (envs, bodies)."""

    def shares(self) -> Iterator[tuple["DeviceModel", slice]]:
        """Yields the parts, each with the range of its environments."""
        for part in self.parts:
            first = part.first_env - self.first_env
            yield part, slice(first, first + part.envs)

    def shares_of(self, envs: int) -> list[tuple["DeviceModel", int]]:
        """Returns the parts over which ``envs`` environments would be split, each with its number."""
        return list(zip(self.parts, split_evenly(envs, len(self.parts)), strict=False))

    @property
    def devices(self) -> tuple[wp.Device, ...]:
        """The Warp device of each part."""
        return tuple(part.device for part in self.parts)

    # Steps and complete resets set the clock and the initial flag of all parts alike.

    @property
    def time(self) -> float:
        """Simulated time since the last complete reset [s]."""
        return max(part.elapsed for part in self.parts)

    @property
    def at_start(self) -> bool:
        """Whether the state is the initial one; it then follows changes of its parameters."""
        return all(part.is_initial for part in self.parts)

    def __getitem__(self, name: str) -> Array:
        """Returns a copy of parameter ``name``, (envs, …). A parameter of the state is its initial value."""
        self.find_parameter(name)
        return np.concatenate([part.parameters[name].read(part.envs) for part in self.parts])

    def __setitem__(self, name: str, value: ArrayLike) -> None:
        """Sets parameter ``name`` from one value or one per environment.

        A parameter of the state is its initial value; before the first step, the current state follows.

        Raises:
            KeyError: If the parameter does not exist.
            ValueError: If the value is not allowed. The model is unchanged then.
            MemoryError: If one value per environment does not fit into memory. The model is unchanged then.
        """
        self.assign(name, self.find_parameter(name).parse(value, self.envs))

    def assign(self, name: str, values: Array) -> None:
        """Sets parameter ``name`` to values that ``Parameter.parse`` returned, (1 or envs, 1 or items, …).

        Raises:
            KeyError: If the parameter does not exist.
            ValueError: If nonsmooth contact does not allow the values, or they are out of range for the precision of
                the device. The model is unchanged then.
            MemoryError: If the values do not fit into memory. The model is unchanged then.
        """
        self.find_parameter(name)
        shared = len(values) == 1
        changed = [(part, part.parameters[name], own) for part, own in self.shares()]
        if not shared and any(parameter.field.shared for _, parameter, _ in changed):
            self._require_values(name)
        for part, _, _ in changed:
            part.check_value(name, values)
        before = [parameter.field.copy() for _, parameter, _ in changed]
        try:
            for part, parameter, own in changed:
                parameter.field.assign(
                    parameter.items, values if shared else values[own], part.envs, shared=shared
                )
            # Compute all contents before uploading any, because this raises errors about the precision.
            contents = [
                [device_field.content() for device_field in parameter.device_fields] for _, parameter, _ in changed
            ]
            for (part, parameter, _), content in zip(changed, contents, strict=True):
                part.upload(parameter.device_fields, content)
        except Exception:
            for (part, parameter, _), earlier in zip(changed, before, strict=True):
                parameter.field.restore(earlier)
                part.upload(
                    parameter.device_fields, [device_field.content() for device_field in parameter.device_fields]
                )
            raise
        if self.at_start and any(part.sets_initial_state(parameter) for part, parameter, _ in changed):
            self.reset()

    def _require_values(self, name: str) -> None:
        """Raises ``MemoryShortage`` if one value of ``name`` per environment does not fit into memory."""

        def footprint(envs: int) -> MemoryEstimate:
            return total(
                MemoryEstimate(own, str(part.device), tuple(part.parameters[name].widening(own)))
                for part, own in self.shares_of(envs)
            )

        require(footprint, self.envs, f"for a value of {name} in each, ")

    def __contains__(self, name: object) -> bool:
        return name in self.parts[0].parameters

    def __iter__(self) -> Iterator[str]:
        """Yields the names of all parameters."""
        return iter(self.parts[0].parameters)

    def find_parameter(self, name: str) -> Parameter:
        """Returns the parameter ``name``, with the values of the first part.

        Raises:
            TypeError: If ``name`` is not a string.
            KeyError: If the parameter does not exist; the message suggests the closest name.
        """
        if not isinstance(name, str):
            raise TypeError(
                f"name of a parameter must be a string, as in model['ball.mass'], got {name!r}; values have the "
                "environment as first axis: model['ball.mass'][3]"
            )
        parameters = self.parts[0].parameters
        if name in parameters:
            return parameters[name]
        if stored_name(name) in self.parts[0].sensors:
            raise KeyError(f"{name!r} is a sensor, not a parameter; use model.sensor({name!r})")
        element, _, quantity = name.rpartition(".")
        owners = {one.name: one.formulas for one in self.scene.elements() if hasattr(one, "formulas")}
        for owner, formulas in owners.items():
            for part, formula in formulas.items():
                if element == f"{owner}.{part}" and quantity in formula.varying():
                    raise KeyError(
                        f"no parameter {name!r}: the {type(formula).__name__} of {owner!r} was made "
                        f"without {quantity}; it has {', '.join(formula.parameters())}"
                    )
        return find_entry("parameter", name, parameters)

    def varies(self, name: str) -> bool:
        """Returns whether parameter ``name`` has separate values per environment, equal or not."""
        fields = [part.parameters[name].field for part in self.parts]
        first = fields[0].values[0]
        return any(not field.shared or (field.values[0] != first).any() for field in fields)

    def reset(self, env_mask: ArrayLike | None = None) -> None:
        """Resets environments to their initial state, with empty history.

        Args:
            env_mask: Booleans (envs,), true for environments to reset. Default: all.
        """
        if env_mask is None:
            mask = np.ones(self.envs, dtype=bool)
        else:
            mask = np.asarray(env_mask)
            if mask.dtype != bool or mask.shape != (self.envs,):
                raise ValueError(
                    f"env_mask must be {self.envs} booleans, got shape {mask.shape} of {mask.dtype} values"
                )
        for part, own in self.shares():
            if mask[own].any():
                part.reset_state(mask[own])
        if mask.all():
            for part in self.parts:
                part.is_initial = True
                part.elapsed = 0.0

    def evaluate(self) -> None:
        """Computes contacts and wrenches of the current state, without changing state or history."""
        for part in self.parts:
            part.evaluate_needs(CONTACT_NEEDS)

    def find_sensor(self, name: str) -> Sensor:
        """Returns the sensor with this name or alias; its array is that of the first part.

        Raises:
            KeyError: If the sensor does not exist; the message suggests the closest name.
        """
        from warpcontact.forces.nonsmooth.sensors import sensor_hint

        hint = partial(sensor_hint, scene=self.scene)
        return find_entry("sensor", name, self.parts[0].sensors, stored_name, hint)

    def find_sensors(self, names: Iterable[str]) -> list[Sensor]:
        """Returns the sensors with these names or aliases.

        Raises:
            KeyError: If any does not exist; the message names all of them.
        """
        found, problems = [], []
        for name in names:
            try:
                found.append(self.find_sensor(name))
            except KeyError as error:
                problems.append(error.args[0])
        if problems:
            raise KeyError(". ".join(dict.fromkeys(problems)).replace("?. ", "? "))
        return found

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of all sensors."""
        return tuple(self.parts[0].sensors)

    def sensor(self, name: str) -> NDArray[Any]:
        """Evaluates sensor ``name`` at the current state.

        Returns:
            A new array (envs,), or (envs, item) for a set of points, with a last axis for vectors.

        Raises:
            KeyError: If the sensor does not exist.
            MemoryError: If its arrays do not fit into memory.
        """
        needs = {*self.find_sensor(name).needs}
        self.ensure_sensor_arrays(needs)
        # Launch all parts before waiting for the first one, so that devices run in parallel.
        for part in self.parts:
            part.evaluate_needs(needs)
        return self.last_value(name)

    def ensure_sensor_arrays(self, needs: Set[str]) -> None:
        """Allocates the arrays for sensors with ``needs``, if they are not allocated yet.

        Raises:
            MemoryError: If the arrays do not fit into memory.
        """
        missing = {name for part in self.parts for name in part.unallocated(needs)}
        if not missing:
            return

        def footprint(envs: int) -> MemoryEstimate:
            return total(
                MemoryEstimate(own, str(part.device), tuple(part.sensor_memory(part.device, missing, own)))
                for part, own in self.shares_of(envs)
            )

        require(footprint, self.envs, "to measure them, ")
        for part in self.parts:
            part.allocate_sensor_arrays(missing)

    def last_value(self, name: str) -> NDArray[Any]:
        """Returns the last computed value of sensor ``name`` in a new array."""
        sensor = self.find_sensor(name)
        for part in self.parts:
            for element in part.force_elements:
                if not element.needs().keys().isdisjoint(sensor.needs):
                    element.check()
        # On a CPU ``numpy()`` is a view of memory that the next step overwrites; ``concatenate`` copies it.
        values = [part.sensors[sensor.name].array(part.arrays).numpy() for part in self.parts]
        return sensor.finish(np.concatenate(values))

    def catenary_shape(self, name: str, count: int = 50) -> NDArray[np.float64]:
        """Returns points on a catenary at the current state, for plotting.

        Args:
            name: Name of the catenary.
            count: Number of points, at least 2, at equal intervals of unstretched length from end a to end b.

        Returns:
            Positions (envs, count, 3), world [m]. Slack cable on the floor is drawn as a straight line.

        Raises:
            KeyError: If the catenary does not exist.
        """
        checks.integer("count", count, 2)
        self.evaluate()
        return np.concatenate([lines.shape(part, item, count) for part, lines, item in self._catenaries(name)])

    def catenary_stiffness(self, name: str) -> NDArray[np.float64]:
        """Returns the derivative of the force on end b of a catenary with respect to the position of end b.

        If end b lies on the floor, it is displaced along the floor.

        Args:
            name: Name of the catenary.

        Returns:
            Symmetric matrices (envs, 3, 3), world [N/m].

        Raises:
            KeyError: If the catenary does not exist.
        """
        self.evaluate()
        return np.concatenate([lines.stiffness(part, item) for part, lines, item in self._catenaries(name)])

    def _catenaries(self, name: str) -> "list[tuple[DeviceModel, CatenarySet, int]]":
        """Returns each part, the set that contains the catenary, and its index in the set."""
        find_entry("catenary", name, {one.name: one for one in self.scene.couplings if isinstance(one, Catenary)})
        return [
            (part, lines, item)
            for part in self.parts
            for lines in part.of_family("couplings")
            for item, one in enumerate(lines.couplings)
            if one.name == name
        ]

    def failures(self) -> dict[str, NDArray[np.int32]]:
        """Returns the number of steps since reset in which forces could not be computed, (envs,) by element."""
        parts = [
            {name: counts for element in part.force_elements for name, counts in element.failures().items()}
            for part in self.parts
        ]
        return {name: np.concatenate([own[name] for own in parts]) for name in parts[0]}

    def unsolved_contacts(self) -> dict[str, NDArray[np.int32]]:
        """Returns the number of steps since reset in which a shape contact did not converge, (envs,) by contact.

        For a set, the maximum over its items.
        """
        counts = self.failures()
        return {contact.name: counts[contact.name] for contact in self.scene.shape_contacts}

    def unfinished_solves(self) -> NDArray[np.int32]:
        """Returns the number of steps since reset in which the nonsmooth contact solver did not converge, (envs,)."""
        return np.concatenate(
            [
                np.zeros(part.envs, np.int32)
                if part.nonsmooth is None
                else part.nonsmooth.statistics.failures.numpy()
                for part in self.parts
            ]
        )

    def largest_residuals(self) -> NDArray[np.float64]:
        """Returns the largest residual of steps without convergence since reset or ``reset_residuals``, (envs,)."""
        return np.concatenate(
            [
                np.zeros(part.envs)
                if part.nonsmooth is None
                else part.nonsmooth.statistics.largest_residual.numpy().astype(np.float64)
                for part in self.parts
            ]
        )

    def reset_residuals(self) -> None:
        """Sets ``largest_residuals`` to 0."""
        for part in self.parts:
            if part.nonsmooth is not None:
                part.nonsmooth.reset_residuals()

    def contact_pairs(self, name: str) -> "xr.Dataset":
        """Returns the pairs of a particle contact that are in contact at the current state.

        Args:
            name: Name of the particle contact.

        Returns:
            A data set with one dimension, ``pair``, in the order of environments and particles: ``env``, the numbers,
            names and bodies of both particles (``shape_1`` < ``shape_2``, ``name_1``, ``body_1``, …), ``gap``,
            contact ``point``, ``normal`` out of the second particle, ``normal_force``, ``friction_force`` on the
            first one and ``approach_speed``; units are in the attributes.

        Raises:
            KeyError: If the particle contact does not exist.
            RuntimeError: If a neighbor list was too short.
        """
        from warpcontact.forces.particle_contact.contact_pairs import contact_pairs

        find_entry("particle contact", name, {contact.name: contact for contact in self.scene.particle_contacts})
        self.evaluate()
        self.check_neighbor_lists()
        return contact_pairs(
            [
                (part, part.first_env - self.first_env, particle_set)
                for part in self.parts
                for particle_set in part.of_family("particle contact")
                if particle_set.contact.name == name
            ]
        )

    def check_neighbor_lists(self) -> None:
        """Waits for the devices and checks that no neighbor list of a particle contact was too short.

        Raises:
            RuntimeError: If a neighbor list was too short in any environment since its reset.
        """
        for part in self.parts:
            for element in part.force_elements:
                element.check()

    def health(self) -> Health:
        """Returns the frozen environments with causes and times, and the stopped ones.

        Raises:
            RuntimeError: If a neighbor list of a particle contact was too short.
        """
        self.check_neighbor_lists()
        parts = self.parts
        return Health.of(
            np.concatenate([part.arrays.status.numpy() for part in parts]),
            np.concatenate([part.arrays.guard.cause.numpy() for part in parts]),
            np.concatenate([part.arrays.time.numpy() for part in parts]),
        )

    def memory_estimate(self) -> MemoryEstimate:
        """Returns the memory estimate of the model, without a simulation."""
        return total(
            MemoryEstimate(part.envs, str(part.device), tuple(part.memory_items())) for part in self.parts
        )

    def __repr__(self) -> str:
        first = self.parts[0]
        return (
            f"<{type(self).__name__} of {env_count_text(self.envs)}: {first.body_count} bodies, "
            f"{sum(element.contact_count for element in first.force_elements)} contacts, {self.precision} on "
            f"{', '.join(map(str, self.devices))}>"
        )
