"""A model whose environments are split over several devices."""

from typing import NoReturn

from warpcontact.model.environments import Environments
from warpcontact.model.model import Model


class SplitModel(Environments):
    """Many environments of one scene, split over several devices. Made by ``Scene.build``.

    Parameters, sensors, resets, health and simulations are those of one ``Model`` with all environments, in one
    order; only the arrays of the state are of each part: ``model.parts[0].state``. Parts are there to be looked at
    and written to on their device; to step or reset one alone lets it run apart from the others.

    Attributes:
        scene: The scene it was built from.
        envs: Number of environments, of all parts together.
        first_env: Number of the first, 0 unless they are a batch of more.
        precision: ``"float32"`` or ``"float64"``.
        parts: The models, each on one device, in the order of the environments.
        devices: The Warp device of each part.
        time: Simulated time since the last complete reset [s].
    """

    def __init__(self, parts: list[Model]) -> None:
        self.scene = parts[0].scene
        self.precision = parts[0].precision
        self.envs = sum(part.envs for part in parts)
        self._parts = tuple(parts)
        self.first_env = 0

    @property
    def first_env(self) -> int:
        """Number of the first environment; those of the parts follow it."""
        return self.parts[0].first_env

    @first_env.setter
    def first_env(self, number: int) -> None:
        for part in self.parts:
            part.first_env = number
            number += part.envs

    @property
    def parts(self) -> tuple[Model, ...]:
        """The models, each on one device, in the order of the environments."""
        return self._parts

    @property
    def state(self) -> NoReturn:
        """There is no one state.

        Raises:
            AttributeError: Always; says where the states of the parts are.
        """
        raise AttributeError(
            f"a model split over {self._listed()} has no one state: take model.parts[0].state, …, or "
            "model.sensor('<body>.position'), which gathers all environments"
        )

    @property
    def device(self) -> NoReturn:
        """There is no one device.

        Raises:
            AttributeError: Always; says what to ask for.
        """
        raise AttributeError(f"a model split over {self._listed()} has no one device: take model.devices")

    def _listed(self) -> str:
        return ", ".join(map(str, self.devices))
