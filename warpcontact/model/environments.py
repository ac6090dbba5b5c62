"""What can be done with many environments of one scene, on whatever devices they are."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Set
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.catalogue.names import stored_name
from warpcontact.kernels.catalogue.renamed import explain_renamed
from warpcontact.model.health import Health
from warpcontact.model.scene_traits import SENSOR_ARRAYS
from warpcontact.model.sensor_evaluation import CONTACT_NEEDS
from warpcontact.model.sensors import Sensor
from warpcontact.scene.couplings import Catenary
from warpcontact.scene.scene import Scene
from warpcontact.stepping.requirements import stepping_memory
from warpcontact.storage.memory_estimate import MemoryEstimate, env_count_text, require, total
from warpcontact.storage.parameters import Parameter
from warpcontact.system.devices import split_evenly
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, find_entry
from warpcontact.validation.uncopyable import Uncopied

if TYPE_CHECKING:
    import xarray as xr

    from warpcontact.forces.couplings.catenaries import CatenarySet
    from warpcontact.model.model import Model, State


@explain_renamed
@explain_keywords_of
class Environments(
    Uncopied, ABC, instead="pickle or copy its scene, and build that: model.scene.build(envs=model.envs)"
):
    """Many environments of one scene, in parts side by side: the interface of ``Model`` and of ``SplitModel``.

    Attributes:
        scene: The scene they were built from.
        envs: Their number.
        first_env: Number of the first, 0 unless they are a batch of more.
        precision: ``"float32"`` or ``"float64"``.
    """

    scene: Scene
    envs: int
    first_env: int
    precision: str

    @property
    @abstractmethod
    def parts(self) -> tuple["Model", ...]:
        """The models, each on one device, that make up the environments, in their order."""

    @property
    @abstractmethod
    def state(self) -> "State":
        """The current state, where all environments are on one device: arrays (envs, bodies)."""

    def shares(self) -> Iterator[tuple["Model", slice]]:
        """Iterates over the parts, each with the environments of the whole that it has."""
        for part in self.parts:
            first = part.first_env - self.first_env
            yield part, slice(first, first + part.envs)

    def shares_of(self, envs: int) -> list[tuple["Model", int]]:
        """Returns the parts over which ``envs`` environments would be split, each with how many it would have."""
        return list(zip(self.parts, split_evenly(envs, len(self.parts)), strict=False))

    @property
    def devices(self) -> tuple[wp.Device, ...]:
        """The Warp device of each part."""
        return tuple(part.device for part in self.parts)

    # Steps and complete resets of the whole set clock and start of all parts alike.

    @property
    def time(self) -> float:
        """Simulated time since the last complete reset [s]."""
        return max(part.elapsed for part in self.parts)

    @property
    def at_start(self) -> bool:
        """Whether the state is still the initial one, which then follows its parameters."""
        return all(part.is_initial for part in self.parts)

    def __getitem__(self, name: str) -> Array:
        """Returns a copy of parameter ``name``, (envs, …). That of a state is the initial one."""
        self.find_parameter(name)
        return np.concatenate([part.parameters[name].read(part.envs) for part in self.parts])

    def __setitem__(self, name: str, value: ArrayLike) -> None:
        """Sets parameter ``name`` from one value or one per environment.

        A parameter of the state is the initial one; before the first step it sets the current one, too.

        Raises:
            KeyError: If there is no such parameter.
            ValueError: If the value is not allowed; nothing is changed then.
            MemoryError: If one value per environment takes more memory than there is; nothing is changed then.
        """
        self.assign(name, self.find_parameter(name).parse(value, self.envs))

    def assign(self, name: str, values: Array) -> None:
        """Sets parameter ``name`` from what ``Parameter.parse`` returned, (1 or envs, 1 or items, …).

        Raises:
            KeyError: If there is no such parameter.
            ValueError: If nonsmooth contact does not allow the values, or they do not fit into the precision of
                the device; nothing is changed then.
            MemoryError: If they take more memory than there is; nothing is changed then.
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
            # All of it before any is sent: that a value does not fit the device shows here.
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
        """Raises ``MemoryShortage`` if there is no room for a value of ``name`` in each environment."""

        def footprint(envs: int) -> MemoryEstimate:
            return total(
                MemoryEstimate(own, str(part.device), tuple(part.parameters[name].widening(own)))
                for part, own in self.shares_of(envs)
            )

        require(footprint, self.envs, f"for a value of {name} in each, ")

    def __contains__(self, name: object) -> bool:
        return name in self.parts[0].parameters

    def __iter__(self) -> Iterator[str]:
        """Iterates over the names of all parameters."""
        return iter(self.parts[0].parameters)

    def find_parameter(self, name: str) -> Parameter:
        """Returns what is known of parameter ``name``; the values are those of the first part.

        Raises:
            TypeError: If ``name`` is no string.
            KeyError: If there is none; the message says what may have been meant.
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
        owners = {contact.name: contact.material.formulas for contact in self.scene.contacts}
        owners |= {coupling.name: coupling.formulas for coupling in self.scene.couplings}
        owners |= {contact.name: contact.formulas for contact in self.scene.shape_contacts}
        owners |= {contact.name: contact.formulas for contact in self.scene.particle_contacts}
        for owner, formulas in owners.items():
            for part, formula in formulas.items():
                if element == f"{owner}.{part}" and quantity in formula.varying():
                    raise KeyError(
                        f"no parameter {name!r}: the {type(formula).__name__} of {owner!r} was made "
                        f"without {quantity}; it has {', '.join(formula.parameters())}"
                    )
        return find_entry("parameter", name, parameters)

    def varies(self, name: str) -> bool:
        """Whether each environment has a value of its own of parameter ``name``, be they equal or not."""
        fields = [part.parameters[name].field for part in self.parts]
        first = fields[0].values[0]
        return any(not field.shared or (field.values[0] != first).any() for field in fields)

    def reset(self, env_mask: ArrayLike | None = None) -> None:
        """Puts environments back to their initial state, with empty history.

        Args:
            env_mask: Booleans (envs,) of the environments to reset; ``None``: all.
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
        """Computes contacts and wrenches of the current state; changes neither state nor history."""
        for part in self.parts:
            part.evaluate_needs(CONTACT_NEEDS)

    def find_sensor(self, name: str) -> Sensor:
        """Returns the sensor with this name or alias; its array is that of the first part.

        Raises:
            KeyError: If there is none; the message suggests the closest name.
        """
        from warpcontact.forces.nonsmooth.contacts import sensor_hint

        hint = partial(sensor_hint, scene=self.scene)
        return find_entry("sensor", name, self.parts[0].sensors, stored_name, hint)

    def find_sensors(self, names: Iterable[str]) -> list[Sensor]:
        """Returns the sensors with these names or aliases.

        Raises:
            KeyError: If any is missing; the message names all that are.
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
        """Measures ``name`` at the current state.

        Returns:
            A new array (envs,), or (envs, item) for a set of points, with a last axis for vectors.

        Raises:
            KeyError: If there is no such sensor.
            MemoryError: If what it is measured into is more than there is.
        """
        needs = {*self.find_sensor(name).needs}
        self.ensure_sensor_arrays(needs)
        # All parts are at work before the first is waited for.
        for part in self.parts:
            part.evaluate_needs(needs)
        return self.last_value(name)

    def ensure_sensor_arrays(self, needs: Set[str]) -> None:
        """Allocates what sensors are measured into, by their ``needs``, if it is not there yet.

        Raises:
            MemoryError: If that is more than there is.
        """
        missing = [
            name
            for name in SENSOR_ARRAYS
            if name in needs and any(getattr(part.arrays, name) is None for part in self.parts)
        ]
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
        """Returns sensor ``name`` as it was computed last, in a new array."""
        if "particles" in self.find_sensor(name).needs:
            self.check_neighbor_lists()
        # On the CPU what is read is a view of memory that the next step overwrites; this copies it.
        sensor = self.find_sensor(name)
        values = [part.sensors[sensor.name].array(part.arrays).numpy() for part in self.parts]
        return sensor.finish(np.concatenate(values))

    def catenary_shape(self, name: str, count: int = 50) -> NDArray[np.float64]:
        """Returns where a catenary is at the current state, to be drawn.

        Args:
            name: Its name.
            count: Number of points, evenly along its unstretched length from end a to end b, at least 2.

        Returns:
            Places (envs, count, 3), world [m]. More of a line on the floor than it takes is drawn straight.

        Raises:
            KeyError: If there is no such catenary.
        """
        checks.integer("count", count, 2)
        self.evaluate()
        return np.concatenate([lines.shape(part, item, count) for part, lines, item in self._catenaries(name)])

    def catenary_stiffness(self, name: str) -> NDArray[np.float64]:
        """Returns the derivative of the force on end b of a catenary by the place of that end.

        Of an end that lies on the floor, as it slides there.

        Args:
            name: Its name.

        Returns:
            Symmetric matrices (envs, 3, 3), world [N/m].

        Raises:
            KeyError: If there is no such catenary.
        """
        self.evaluate()
        return np.concatenate([lines.stiffness(part, item) for part, lines, item in self._catenaries(name)])

    def _catenaries(self, name: str) -> "list[tuple[Model, CatenarySet, int]]":
        """Returns each part with the set that has the catenary, and its place there."""
        from warpcontact.forces.couplings.catenaries import CatenarySet

        find_entry("catenary", name, {one.name: one for one in self.scene.couplings if isinstance(one, Catenary)})
        return [
            (part, lines, item)
            for part in self.parts
            for lines in part.couplings
            if isinstance(lines, CatenarySet)
            for item, one in enumerate(lines.couplings)
            if one.name == name
        ]

    def failed_catenaries(self) -> dict[str, int]:
        """Returns in how many environments a catenary was without a solution since reset; of those that were."""
        counts = {}
        for one in self.scene.couplings:
            if isinstance(one, Catenary):
                failures = [lines.failures(item) for _, lines, item in self._catenaries(one.name)]
                if failed := int(np.count_nonzero(np.concatenate(failures))):
                    counts[one.name] = failed
        return counts

    def unsolved_contacts(self) -> dict[str, NDArray[np.int32]]:
        """Returns in how many steps since reset it was not found where two shapes meet, (envs,) by contact.

        Of a set, the most of any of its items.
        """
        return {
            contact.name: np.concatenate(
                [
                    own.failures(contact).max(axis=1)
                    for part in self.parts
                    for own in part.shape_contact_sets
                    if contact in own.items
                ]
            )
            for contact in self.scene.shape_contacts
        }

    def unfinished_solves(self) -> NDArray[np.int32]:
        """Returns in how many steps since reset the problem of nonsmooth contacts was not solved, (envs,)."""
        return np.concatenate(
            [
                np.zeros(part.envs, np.int32)
                if part.nonsmooth is None
                else part.nonsmooth.statistics.failures.numpy()
                for part in self.parts
            ]
        )

    def largest_residuals(self) -> NDArray[np.float64]:
        """Returns the largest residual of unsolved problems since reset or ``reset_residuals``, (envs,)."""
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
        """Returns which pairs of a particle contact touch at the current state.

        Args:
            name: Its name.

        Returns:
            A data set with one dimension, ``pair``, in the order of environments and shapes: ``env``, the numbers,
            names and bodies of both shapes (``shape_1`` < ``shape_2``, ``name_1``, ``body_1``, …), ``gap``,
            ``point`` K, ``normal`` out of the second, ``normal_force``, ``friction_force`` on the first and
            ``approach_speed``; units are in the attributes.

        Raises:
            KeyError: If there is no such particle contact.
            RuntimeError: If a list of partners was too short.
        """
        from warpcontact.forces.particle_contact.contact_pairs import contact_pairs

        find_entry("particle contact", name, {contact.name: contact for contact in self.scene.particle_contacts})
        self.evaluate()
        self.check_neighbor_lists()
        return contact_pairs(
            [
                (part, part.first_env - self.first_env, particle_set)
                for part in self.parts
                for particle_set in part.particle_contact_sets
                if particle_set.contact.name == name
            ]
        )

    def check_neighbor_lists(self) -> None:
        """Waits for the devices and looks whether all pairs of particle contacts were found.

        Raises:
            RuntimeError: If a list of partners was too short, in any environment since its reset.
        """
        for part in self.parts:
            for particle_set in part.particle_contact_sets:
                if problem := particle_set.overflow_message():
                    raise RuntimeError(problem)

    def health(self) -> Health:
        """Returns which environments are frozen, why and since when, and which are stopped.

        Raises:
            RuntimeError: If a list of partners of a particle contact was too short.
        """
        self.check_neighbor_lists()
        parts = self.parts
        return Health.of(
            np.concatenate([part.arrays.status.numpy() for part in parts]),
            np.concatenate([part.arrays.guard.cause.numpy() for part in parts]),
            np.concatenate([part.arrays.time.numpy() for part in parts]),
        )

    def memory(self) -> MemoryEstimate:
        """Returns what the environments take of memory as they are, and a simulation that steps them.

        That is the arrays of the model with what was measured so far, and a ``Simulation`` with default options;
        recordings come on top. ``print(model.memory())`` tells what for, where and how much.
        """
        stepping = stepping_memory([(part, part.envs) for part in self.parts])
        return self.memory_estimate().with_items(stepping.items)

    def memory_estimate(self) -> MemoryEstimate:
        """Returns what the model alone takes of memory."""
        return total(
            MemoryEstimate(part.envs, str(part.device), tuple(part.memory_items())) for part in self.parts
        )

    def __repr__(self) -> str:
        first = self.parts[0]
        return (
            f"<{type(self).__name__} of {env_count_text(self.envs)}: {first.body_count} bodies, "
            f"{first.contact_count + first.shape_contact_count} contacts, {self.precision} on "
            f"{', '.join(map(str, self.devices))}>"
        )
