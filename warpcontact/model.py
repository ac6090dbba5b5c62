"""A built scene: parameters, state and memory of many environments on one device."""

import difflib
from collections.abc import Iterator, Set
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from warpcontact.arrays import allocate, broadcast
from warpcontact.blocks import Blocks
from warpcontact.checks import Array
from warpcontact.groups import Group
from warpcontact.health import Health
from warpcontact.parameters import Parameter, Upload
from warpcontact.readings import Reading
from warpcontact.scene import Contact, Scene
from warpcontact.schedule import Span, force_stages


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


class Model:
    """Many environments of one scene on a device. Made by ``Scene.build``.

    ``model["ball.mass"]`` reads a parameter, (envs, …); ``model["ball.mass"] = values`` sets it, from one value
    or one per environment. ``model.reading("touch.gap")`` measures the current state.

    Attributes:
        scene: The scene it was built from.
        envs: Number of environments.
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
        arrays: SimpleNamespace,
        parameters: dict[str, Parameter],
        uploads: list[Upload],
        groups: list[Group],
        blocks: Blocks,
        readings: dict[str, Reading],
        meshes: list[wp.Mesh],
    ) -> None:
        self.scene = scene
        self.envs = envs
        self.device = device
        self.precision = precision
        self.types = types
        self.arrays = arrays
        self.groups = groups
        self.blocks = blocks
        self.parameters = parameters
        self.body_count = len(scene.bodies)
        self.contact_count = sum(contact.count for contact in scene.contacts)
        # Whether any contact looks for crossings, or stays with what it touched.
        self.sweeps = any(contact.swept for contact in scene.contacts)
        self.follows = self.sweeps or any(contact.entry == "latched" for contact in scene.contacts)
        # Goes up when a device array moves: whoever prepared launches prepares them again.
        self.revision = 0
        # Simulated time since the last complete reset [s].
        self.time = 0.0
        # Whether the state is still the initial one, which then follows its parameters.
        self.at_start = True
        self._meshes = meshes  # kept alive: a kernel only holds their ids
        self._readings = readings
        self._instant = wp.zeros((1, 1), dtype=types.real, device=device)
        # Step of 0 [env, 0]: for the forces of an instant.
        self.no_step = broadcast(self._instant, envs)
        self._evaluation: tuple[int, list[Any]] = (-1, [])
        self._uploads = uploads  # kept alive: broadcast arrays do not own their memory
        self._send(uploads)
        self._state = State(**{name: getattr(arrays.state, name) for name in types.State.vars})
        self.reset()

    @property
    def state(self) -> State:
        """The current state: arrays (envs, bodies)."""
        return self._state

    def __getitem__(self, name: str) -> Array:
        """Returns a copy of parameter ``name``, (envs, …). That of a state is the initial one."""
        return np.array(self.find_parameter(name).read(self.envs))

    def __setitem__(self, name: str, value: ArrayLike) -> None:
        """Sets parameter ``name`` from one value or one per environment.

        A parameter of the state is the initial one; before the first step it sets the current one, too.

        Raises:
            KeyError: If there is no such parameter.
            ValueError: If the value is not allowed; nothing is changed then.
        """
        parameter = self.find_parameter(name)
        values = parameter.parse(value, self.envs)
        before = parameter.field.values.copy()
        try:
            parameter.field.assign(parameter.items, values, self.envs)
            self._send(parameter.uploads)
        except Exception:
            parameter.field.values = before
            self._send(parameter.uploads)
            raise
        if self.at_start and any(upload.struct is self.arrays.initial for upload in parameter.uploads):
            self.reset()

    def __contains__(self, name: object) -> bool:
        return name in self.parameters

    def __iter__(self) -> Iterator[str]:
        """Iterates over the names of all parameters."""
        return iter(self.parameters)

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
        from warpcontact.kernels import reset

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
                len(self.scene.contacts),
                a.initial,
                a.status,
                a.time,
                a.state,
                a.history,
                a.cache,
                a.near,
            ],
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
        if mask.all():
            self.at_start = True
            self.time = 0.0

    def evaluate(self) -> None:
        """Computes contacts and wrenches of the current state; changes neither state nor history."""
        if self._evaluation[0] != self.revision:
            everything = Span(self, 0, self.envs, cached=False, ordered=True)
            self._evaluation = (self.revision, force_stages(everything, self.arrays.state, self.no_step))
        for launch in self._evaluation[1]:
            launch.launch()

    def find_reading(self, name: str) -> Reading:
        """Returns reading ``name``.

        Raises:
            KeyError: If there is none; the message suggests the nearest name.
        """
        return _look_up("reading", name, self._readings)

    @property
    def reading_names(self) -> tuple[str, ...]:
        """Names of all readings."""
        return tuple(self._readings)

    def reading(self, name: str) -> NDArray[Any]:
        """Measures ``name`` at the current state.

        Returns:
            A new array (envs,), or (envs, item) for a set of points, with a last axis for vectors.

        Raises:
            KeyError: If there is no such reading.
        """
        reading = self.find_reading(name)
        self.prepare({*reading.needs})
        # On the CPU the values are a view of memory that the next step overwrites.
        return reading.finish(np.array(reading.array(self.arrays).numpy()))

    def prepare(self, needs: Set[str]) -> None:
        """Computes what readings of the current state need, by their ``needs``."""
        if "contacts" in needs or "points" in needs:
            self.evaluate()
        if "bodies" in needs:
            self._measure_bodies()
        if "points" in needs:
            self._measure_points()

    def _measure_bodies(self) -> None:
        from warpcontact.kernels import measures

        a, shape = self.arrays, (self.envs, self.body_count)
        if a.bodies is None:
            a.bodies = allocate(measures.Bodies, shape, self.device)
        kernel = measures.bodies(self.types.real)
        wp.launch(kernel, dim=shape, inputs=[a.model, a.state], outputs=[a.bodies], device=self.device)

    def _measure_points(self) -> None:
        from warpcontact.kernels import measures

        a, shape = self.arrays, (self.envs, self.contact_count)
        if a.points is None:
            a.points = allocate(measures.Points, shape, self.device)
        kernel = measures.points(self.types.real)
        inputs = [a.model, a.state, a.contacts]
        wp.launch(kernel, dim=shape, inputs=inputs, outputs=[a.points], device=self.device)

    def grouped_contacts(self) -> Iterator[tuple[Group, Contact, int]]:
        """Iterates over the contacts: the group each is computed in, and the index of its first item there."""
        for group in self.groups:
            first = 0
            for contact in self.scene.contacts:
                if contact.template.parts == group.parts:
                    yield group, contact, first
                    first += contact.count

    def health(self) -> Health:
        """Returns which environments are frozen."""
        return Health.of_status(self.arrays.status.numpy())

    def _send(self, uploads: list[Upload]) -> None:
        for upload in uploads:
            if upload.send():
                self.revision += 1
        # What was known of distances may not hold for other radii, poses or meshes.
        cache = self.arrays.cache
        for known in (cache.set_wake, cache.block_wake, cache.wake, cache.faces):
            known.zero_()

    def find_parameter(self, name: str) -> Parameter:
        """Returns parameter ``name``.

        Raises:
            KeyError: If there is none; the message says what may have been meant.
        """
        if name in self.parameters:
            return self.parameters[name]
        if name in self._readings:
            raise KeyError(f"{name!r} is a reading, not a parameter; use model.reading({name!r})")
        element, _, quantity = name.rpartition(".")
        for contact in self.scene.contacts:
            for part, formula in contact.template.formulas.items():
                if element == f"{contact.name}.{part}" and quantity in formula.__dataclass_fields__:
                    raise KeyError(
                        f"no parameter {name!r}: the {type(formula).__name__} of {contact.name!r} was made "
                        f"without {quantity}; it has {', '.join(formula.parameters())}"
                    )
        return _look_up("parameter", name, self.parameters)

    def __repr__(self) -> str:
        return (
            f"<Model of {self.envs} environments: {self.body_count} bodies, {self.contact_count} contacts, "
            f"{self.precision} on {self.device}>"
        )


def _look_up(kind: str, name: str, table: dict[str, Any]) -> Any:
    try:
        return table[name]
    except KeyError:
        close = difflib.get_close_matches(name, table, n=1)
        hint = f"did you mean {close[0]!r}?" if close else f"there are: {', '.join(table) or 'none'}"
        raise KeyError(f"no {kind} {name!r}; {hint}") from None
