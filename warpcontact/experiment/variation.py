"""Validates ``[variation]`` against a model and returns the design of the experiment.

The random generator of each entry is seeded by the seed of the experiment and the name of the parameter, so that
adding an entry does not change the values of others.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpcontact.experiment.design import (
    ConstantEntry,
    Design,
    Entry,
    IntegerEntry,
    LinearEntry,
    ListedEntry,
    SampleColumns,
    SampledEntry,
    SphereInertia,
    ValueConversion,
)
from warpcontact.experiment.distributions import is_discrete, make_marginal, value_shape
from warpcontact.experiment.errors import Problems, key_path
from warpcontact.experiment.quantities import read_rows
from warpcontact.experiment.variation_settings import (
    CorrelationSettings,
    SolidSphere,
    VariationSettings,
    axis_of,
    grid_axes,
)
from warpcontact.kernels.catalogue.names import suggestion
from warpcontact.model.environments import Environments
from warpcontact.storage.parameters import Parameter
from warpcontact.validation.checks import Array, available_names

# Number of environments whose values are checked at a time.
CHECKED_AT_ONCE = 65536
# Keys that are allowed for an integer parameter.
_WHOLE = ("value", "values", "uniform", "linspace", "grid", "distribution")


def truncated(variation: Mapping[str, VariationSettings], envs: int) -> dict[str, VariationSettings]:
    """Returns ``variation`` for the first ``envs`` environments: further listed values are dropped."""
    return _with_values(variation, tuple, lambda values: values[:envs])


def relocate(
    variation: Mapping[str, VariationSettings], moved: Callable[[str], str]
) -> dict[str, VariationSettings]:
    """Returns ``variation`` with its file names replaced by ``moved(name)``."""
    return _with_values(variation, str, moved)


def _with_values(
    variation: Mapping[str, VariationSettings], kind: type, changed: Callable[[Any], Any]
) -> dict[str, VariationSettings]:
    """Returns ``variation`` with ``values`` replaced by ``changed(values)`` if they are of type ``kind``."""
    return {
        name: entry.model_copy(update={"values": changed(entry.values)})
        if isinstance(entry.values, kind)
        else entry
        for name, entry in variation.items()
    }


class Variation:
    """The variation of an experiment, validated entry by entry against a model.

    Args:
        variation: Settings by parameter name.
        model: Model of the scene with any number of environments; not changed.
        envs: Number of environments; ``None``: unknown, so that lists may be of any length.
        seed: Seed of the experiment.
        folder: Folder to which the names of value files are relative.
        problems: Receives the problems.
        is_invalid: Returns whether the element of a parameter name has reported problems.
    """

    def __init__(
        self,
        variation: Mapping[str, VariationSettings],
        model: Environments,
        envs: int | None,
        seed: int,
        folder: Path,
        problems: Problems,
        is_invalid: Callable[[str], bool],
    ) -> None:
        self.variation = variation
        self.model = model
        self.envs = envs or 1
        self.check_any_length = envs is None
        self.seed = seed
        self.folder = folder
        self.problems = problems
        self.is_invalid = is_invalid

    def design(self, method: str, correlation: Sequence[CorrelationSettings]) -> Design:
        """Returns the design of all valid entries.

        Args:
            method: Sampling method, one of ``sampling.METHODS``.
            correlation: Correlations between parameters.
        """
        entries: dict[str, Any] = {}
        conversions: dict[str, ValueConversion] = {}
        columns = SampleColumns(self.variation, method, self.envs, self.seed, self.problems)
        for name, settings in self.variation.items():
            parameter = self._parameter(name)
            before = len(self.problems.lines)
            entry = None if parameter is None else self._entry(parameter, settings, columns)
            if parameter is None or entry is None or len(self.problems.lines) > before:
                columns.incomplete |= {name} & columns.first.keys()
                continue
            entries[name] = entry
            if not isinstance(entry, SphereInertia):
                conversions[name] = _conversion(parameter, _shape(entry))
        for name, entry in list(entries.items()):
            if isinstance(entry, SphereInertia) and not entries.keys() >= set(entry.sources):
                del entries[name]
        sampler = columns.sampler(any_envs=self.check_any_length)
        correlated = [columns.correlation(i, entry, self.is_invalid) for i, entry in enumerate(correlation)]
        correlations = tuple(one for one in correlated if one is not None)
        design = Design(self.envs, entries, conversions, sampler, correlations)
        self._check_all(design)
        return design

    def _parameter(self, name: str) -> Parameter | None:
        if name in self.model:
            return self.model.find_parameter(name)
        if not self.is_invalid(name):
            self.problems.add(_path(name), f"is not the name of a parameter{self._hint(name)}")
        return None

    def _entry(
        self, parameter: Parameter, settings: VariationSettings, columns: SampleColumns
    ) -> Entry | SampledEntry | SphereInertia | None:
        """Returns the entry of a parameter, or ``None`` if it is invalid."""
        kind = settings.kind
        path, given = f"{_path(parameter.name)}.{kind}", getattr(settings, kind)
        if settings.solid_sphere is not None:
            return self._sphere(path, parameter, settings.solid_sphere)
        if parameter.whole and kind not in _WHOLE:
            allowed = ", ".join(_WHOLE)
            self.problems.add(path, f"gives no whole numbers; {parameter.name} takes one of {allowed}")
            return None
        if kind == "value":
            return ConstantEntry(np.array(given)) if self._check_one(path, parameter, np.array(given)) else None
        if kind == "values":
            return self._listed_entry(path, given)
        if kind == "grid":
            return self._grid_entry(path, parameter, settings)
        if kind == "distribution":
            if parameter.whole != is_discrete(given):
                allowed, number = ("discrete", "whole") if parameter.whole else ("continuous", "real")
                message = f"must be a {allowed} one, got {given['name']!r}; {parameter.name} is a {number} number"
                self.problems.add(f"{path}.name", message)
                return None
        else:
            self._check_range(path, parameter, kind, given)
        if kind == "linspace":
            first, last = np.array(given, dtype=np.float64)
            return (IntegerEntry if parameter.whole else LinearEntry)(first, last, self.envs)
        marginal, name = make_marginal(kind, given, parameter.whole), parameter.name
        return SampledEntry(marginal, value_shape(kind, given), columns.first[name], columns.numbers[name])

    def _check_range(self, path: str, parameter: Parameter, kind: str, given: Any) -> None:
        """Checks the ends of a range, so that validity does not depend on the random samples."""
        ends = np.array(given, dtype=np.float64)
        # A standard deviation and the logarithm of a value are not checked.
        count = {"normal": 1, "lognormal": 0}.get(kind, 2)
        for i, end in enumerate(ends[:count]):
            if not self._check_one(f"{path}[{i}]", parameter, end):
                return

    def _listed_entry(self, path: str, given: Any) -> ListedEntry | None:
        if isinstance(given, str):
            try:
                values = read_rows(self.folder / given)
            except ValueError as error:
                self.problems.add(path, f": {error}")
                return None
            if values.ndim == 0 or len(values) < self.envs:
                got = len(values) if values.ndim else "one number"
                self.problems.add(
                    path, f"must have at least one row for each of {self.envs} environments, got {got}"
                )
                return None
            return ListedEntry(values[: self.envs])
        values = np.array(given)[: 1 if self.check_any_length else None]
        if len(values) != self.envs:
            message = f"must have one value for each of {self.envs} environments, got {len(values)}"
            self.problems.add(path, message)
            return None
        return ListedEntry(values)

    def _grid_entry(self, path: str, parameter: Parameter, settings: VariationSettings) -> ListedEntry | None:
        values = np.array(settings.grid)
        axes = grid_axes(dict(self.variation))
        axis = axis_of(parameter.name, settings)
        if len(values) != axes[axis]:
            others = (name for name, entry in self.variation.items() if entry.group == settings.group)
            message = f"must have as many values as {next(others)!r} of the group {settings.group!r}, {axes[axis]}"
            self.problems.add(path, f"{message}, got {len(values)}")
            return None
        if not self._check(path, parameter, _conversion(parameter, values.shape[1:]).apply(values), 0):
            return None
        lengths = list(axes.values())
        # The last axis varies fastest.
        return ListedEntry(values, int(np.prod(lengths[list(axes).index(axis) + 1 :], dtype=object)))

    def _sphere(self, path: str, target: Parameter, entry: SolidSphere) -> SphereInertia | None:
        if not target.name.endswith(".inertia"):
            self.problems.add(path, "gives an inertia and can vary nothing else")
            return None
        mass = self._source(f"{path}.mass", entry.mass, target)
        radius = self._source(f"{path}.radius", entry.radius, target)
        return None if mass is None or radius is None else SphereInertia(mass, radius, target.single)

    def _source(self, path: str, source: str | float, target: Parameter) -> str | Array | None:
        """Returns the name of a varied scalar parameter, or the values (1,) or (1, items) of a constant one."""
        if not isinstance(source, str):
            return np.array([source]) if target.single else np.array([[source]])
        if source not in self.model:
            if not self.is_invalid(source):
                self.problems.add(path, f"must be a number or the name of a parameter{self._hint(source)}")
            return None
        parameter = self.model.find_parameter(source)
        fits = parameter.single or (not target.single and parameter.count == target.count)
        if parameter.tail or not fits:
            self.problems.add(path, f"must be a parameter that is one number, got {source!r}")
            return None
        return source if source in self.variation else parameter.read(1)

    def _check_all(self, design: Design) -> None:
        """Checks the values in all environments, of each parameter up to the first invalid value.

        Values that are sampled between valid ends are not computed here, which takes long for many environments.
        """
        pending = [name for name in design.names if not self._is_within(design, name)]
        for first in range(0, self.envs, CHECKED_AT_ONCE):
            if not pending:
                return
            rows = design.subset(pending).rows(first, min(first + CHECKED_AT_ONCE, self.envs))
            wrong: set[str] = set()
            # Do not report an inertia that is computed from an invalid mass or radius.
            for name in sorted(pending, key=lambda name: isinstance(design.entries[name], SphereInertia)):
                entry = design.entries[name]
                follows = isinstance(entry, SphereInertia) and not wrong.isdisjoint(entry.sources)
                if follows or not self._check(_path(name), self.model.find_parameter(name), rows[name], first):
                    wrong.add(name)
            pending = [name for name in pending if name not in wrong]

    def _is_within(self, design: Design, name: str) -> bool:
        """Whether all values of a parameter are valid, because they were checked or lie between valid ends."""
        if isinstance(design.entries[name], ConstantEntry):
            return True
        parameter, ends = self.model.find_parameter(name), design.value_range(name)
        # With a conversion, for example of a tensor, values between valid ends can be invalid.
        if ends is None or parameter.convert is not None:
            return False
        try:
            parameter.parse(ends, len(ends))
        except ValueError:
            return False
        return True

    def _check_one(self, path: str, parameter: Parameter, value: Array) -> bool:
        """Checks one value that applies to all environments; rows for several environments are invalid."""
        return self._check(path, parameter, value if parameter.single else value[None], None)

    def _check(self, path: str, parameter: Parameter, values: Array, first: int | None) -> bool:
        """Checks ``values`` of environments from ``first`` on; ``None``: one value that applies to all."""
        try:
            parameter.parse(values, 1 if first is None else len(values))
        except ValueError as error:
            message = str(error)
            if not message.startswith(parameter.name):
                message = f": {message}"
            message = message.removeprefix(parameter.name).lstrip()
            if first:
                message = re.sub(r"^\[(\d+)", lambda found: f"[{int(found[1]) + first}", message)
            self.problems.add(path, message)
            return False
        return True

    def _hint(self, name: str) -> str:
        for surface in self.model.scene.surfaces:
            if name == f"{surface.name}.mesh":
                return f": {surface.name!r} has one mesh; give it several as mesh = [{{ … }}, {{ … }}]"
        known = list(self.model)
        element, last = name.partition(".")[0], name.rpartition(".")[2]
        # The middle part is easily omitted: feet.mu instead of feet.friction.mu.
        alike = [other for other in known if other.startswith(f"{element}.") and other.endswith(f".{last}")]
        if len(alike) == 1:
            return f"; did you mean {alike[0]!r}?"
        return suggestion(name, known) or f"; {available_names(name, known)}"


def _path(name: str) -> str:
    return key_path(("variation", name))


def _shape(entry: Entry | SampledEntry) -> tuple[int, ...]:
    """Returns the shape of one value of an entry."""
    return entry.shape if isinstance(entry, SampledEntry) else entry.rows(np.zeros(1, dtype=np.intp)).shape[1:]


def _conversion(parameter: Parameter, shape: tuple[int, ...]) -> ValueConversion:
    """Returns the conversion of values with ``shape`` to those of ``parameter``."""
    # Principal moments are converted to tensors: those of three environments have the shape of one tensor.
    tensor = parameter.tail == (3, 3) and shape == (3,)
    tails = parameter.given or (parameter.tail,)
    own = shape[:1] in ((1,), (parameter.count,)) and shape[1:] in tails
    # Ambiguous values are not expanded, and are rejected when parsed.
    return ValueConversion(tensor, not parameter.single and (tensor or (shape in tails and not own)))
