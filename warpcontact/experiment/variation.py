"""One value of a parameter for each environment, as ``[variation]`` asks for it.

Each entry has a random generator of its own, seeded by the experiment's seed and the name of the parameter: to add
an entry changes none of the others. Values are drawn environment after environment, so that environment i gets
the same ones however many follow it.
"""

import hashlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from warpcontact.checks import Array
from warpcontact.environments import Environments
from warpcontact.experiment.errors import Problems, key_path, suggestion
from warpcontact.experiment.schema import SolidSphere, VariationSettings
from warpcontact.parameters import Parameter

# How the two numbers or vectors a, b of an entry become rows for n environments.
_RULES: dict[str, Callable[[np.random.Generator, Array, Array, int], Array]] = {
    "uniform": lambda rng, low, high, n: low + (high - low) * rng.random((n, *low.shape)),
    "loguniform": lambda rng, low, high, n: low * (high / low) ** rng.random((n, *low.shape)),
    "normal": lambda rng, mean, deviation, n: mean + deviation * rng.standard_normal((n, *mean.shape)),
    "linspace": lambda _, first, last, n: np.linspace(first, last, n),
}


def _blocks(_: np.random.Generator, first: Array, last: Array, n: int) -> Array:
    """Returns the whole numbers from ``first`` to ``last``, each for about as many of ``n`` environments."""
    span = np.abs(last - first)
    count = np.floor(np.arange(n) * (span + 1.0) / max(n - 1, 1))
    return np.asarray(first + np.sign(last - first) * np.minimum(count, span))


# The same for parameters that are a whole number.
_WHOLE_RULES: dict[str, Callable[[np.random.Generator, Array, Array, int], Array]] = {
    "uniform": lambda rng, low, high, n: low + np.floor((high - low + 1.0) * rng.random((n, *low.shape))),
    "linspace": _blocks,
}


def generator(seed: int, name: str) -> np.random.Generator:
    """Returns the random generator of the parameter called ``name``."""
    digest = hashlib.sha256(name.encode()).digest()
    return np.random.default_rng(np.random.SeedSequence([seed, int.from_bytes(digest[:16])]))


def truncated(variation: Mapping[str, VariationSettings], envs: int) -> dict[str, VariationSettings]:
    """Returns ``variation`` for the first ``envs`` environments: listed values beyond them are left out."""
    return {
        name: entry if entry.values is None else entry.model_copy(update={"values": entry.values[:envs]})
        for name, entry in variation.items()
    }


class Draw:
    """The values of all varied parameters.

    Args:
        variation: What varies.
        model: Environments of the same scene, of any number of environments; it is not changed.
        envs: Number of environments; ``None``: unknown, so that lists may be of any length.
        seed: Seed of the experiment.
        unsound: Tells of the name of a parameter whether its element has problems of its own.

    Attributes:
        values: Values (envs, …) by the name of the parameter, in the order of the experiment.
        problems: What is wrong with the others.
    """

    def __init__(
        self,
        variation: Mapping[str, VariationSettings],
        model: Environments,
        envs: int | None,
        seed: int,
        problems: Problems,
        unsound: Callable[[str], bool],
    ) -> None:
        self.model = model
        self.envs = envs or 1
        self.any_length = envs is None
        self.seed = seed
        self.problems = problems
        self.unsound = unsound
        self.values: dict[str, Array] = {}
        # What is computed from other parameters comes after them.
        for derived in (False, True):
            for name, entry in variation.items():
                if (entry.solid_sphere is not None) == derived:
                    self._draw(name, entry)
        self.values = {name: self.values[name] for name in variation if name in self.values}

    def _draw(self, name: str, entry: VariationSettings) -> None:
        path = key_path(("variation", name))
        if name not in self.model:
            if not self.unsound(name):
                self.problems.add(path, f"is not the name of a parameter{self._hint(name)}")
            return
        parameter = self.model.find_parameter(name)
        kind, problems_before = entry.kind, len(self.problems.lines)
        if entry.solid_sphere is not None:
            values = self._solid_sphere(f"{path}.{kind}", parameter, entry.solid_sphere)
        elif entry.value is not None:
            values = self._same(f"{path}.{kind}", parameter, entry.value)
        elif entry.values is not None:
            values = np.array(entry.values)
            if self.any_length:
                values = values[:1]
            if len(values) != self.envs:
                message = f"must have one value for each of {self.envs} environments, got {len(values)}"
                self.problems.add(f"{path}.{kind}", message)
        else:
            values = self._from_two(f"{path}.{kind}", parameter, kind, getattr(entry, kind))
        if values is None or len(self.problems.lines) > problems_before:
            return
        if parameter.tail == (3, 3) and values.shape[1:] == (3,):
            # Principal moments as tensors: those of three environments would pass for one tensor.
            values = values[:, :, None] * np.eye(3)
        if self._check(path, parameter, values, self.envs):
            self.values[name] = values

    def _same(self, path: str, parameter: Parameter, value: Any) -> Array | None:
        """Returns one value, repeated for all environments."""
        values = np.array(value)
        # As if there were one environment: what has a row for each of several is no one value.
        if not self._check(path, parameter, values if parameter.single else values[None], 1):
            return None
        return np.repeat(values[None], self.envs, axis=0)

    def _from_two(self, path: str, parameter: Parameter, kind: str, pair: Any) -> Array | None:
        rules = _WHOLE_RULES if parameter.whole else _RULES
        if kind not in rules:
            allowed = ", ".join(("value", "values", *rules))
            self.problems.add(path, f"gives no whole numbers; {parameter.name} takes one of {allowed}")
            return None
        first, second = np.array(pair, dtype=np.float64)
        # The ends first: whether a draw lies outside of the range is a matter of luck.
        ends = 1 if kind == "normal" else 2
        for i, end in enumerate((first, second)[:ends]):
            if not self._check(f"{path}[{i}]", parameter, end if parameter.single else end[None], 1):
                break
        return rules[kind](generator(self.seed, parameter.name), first, second, self.envs)

    def _solid_sphere(self, path: str, target: Parameter, entry: SolidSphere) -> Array | None:
        if not target.name.endswith(".inertia"):
            self.problems.add(path, "gives an inertia and can vary nothing else")
            return None
        mass = self._source(f"{path}.mass", entry.mass, target)
        radius = self._source(f"{path}.radius", entry.radius, target)
        if mass is None or radius is None:
            return None
        moment = 0.4 * mass * radius**2
        if target.single:
            return np.repeat(np.broadcast_to(moment, self.envs)[:, None], 3, axis=1)
        return np.broadcast_to(moment, (self.envs, target.count))[..., None, None] * np.eye(3)

    def _source(self, path: str, source: str | float, target: Parameter) -> Array | None:
        """Returns the values of a scalar parameter, or of a number, (1,) or (envs,).

        For a ``target`` with items (1 or envs, 1 or items).
        """
        if not isinstance(source, str):
            return np.array([source]) if target.single else np.array([[source]])
        if source not in self.model:
            if not self.unsound(source):
                self.problems.add(path, f"must be a number or the name of a parameter{self._hint(source)}")
            return None
        parameter = self.model.find_parameter(source)
        fits = parameter.single or (not target.single and parameter.count == target.count)
        if parameter.tail or not fits:
            self.problems.add(path, f"must be a parameter that is one number, got {source!r}")
            return None
        values = self.values.get(source, parameter.read(1))
        return values[:, None] if values.ndim == 1 and not target.single else values

    def _check(self, path: str, parameter: Parameter, values: Array, envs: int) -> bool:
        try:
            parameter.parse(values, envs)
        except ValueError as error:
            message = str(error)
            if not message.startswith(parameter.name):
                message = f": {message}"
            self.problems.add(path, message.removeprefix(parameter.name).lstrip())
            return False
        return True

    def _hint(self, name: str) -> str:
        for surface in self.model.scene.surfaces:
            if name == f"{surface.name}.mesh":
                return f": {surface.name!r} has one mesh; give it several as mesh = [{{ … }}, {{ … }}]"
        known = list(self.model)
        element, last = name.partition(".")[0], name.rpartition(".")[2]
        # The part in between is what one forgets: feet.mu for feet.friction.mu.
        alike = [other for other in known if other.startswith(f"{element}.") and other.endswith(f".{last}")]
        if len(alike) == 1:
            return f"; did you mean {alike[0]!r}?"
        own = [other for other in known if other.startswith(f"{element}.")]
        return suggestion(name, known) or f"; there are: {', '.join(own or known)}"
