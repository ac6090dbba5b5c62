"""Pressure on the areas of body contacts, computed from the poses of a replay when it is drawn."""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from warpcontact.drawing.replay import Replay
from warpcontact.model.build import plan_on_devices
from warpcontact.model.model import DeviceModel
from warpcontact.scene.body_contact import BodyContact
from warpcontact.scene.scene_data import SceneData
from warpcontact.storage.memory_estimate import require
from warpcontact.validation.checks import Array

#: Attributes of a recording: class of the integrator, and names of contacts that have forces nevertheless.
INTEGRATOR, COMPLIANT = "integrator", "compliant"
#: Largest difference of pressures within a triangle of a drawing, relative to the largest one of the color scale.
COLOR_STEP = 1.0 / 8.0

# Environments of the model that evaluates a replay.
_BLOCK = 64
# Elements that do not affect body contacts.
_OMITTED = ("contacts", "contact_couplings", "couplings", "shape_contacts", "particle_contacts", "force_elements")


@dataclass(frozen=True, eq=False)
class PressurePatches:
    """Area of a body contact in one record of one environment, as triangles.

    Attributes:
        name: Name of the contact.
        positions: Vertices on the reference surface, (n, 3, 3), counter-clockwise around the normals, world [m].
        normals: Unit normals of the triangles out of the second solid, (n, 3), world.
        pressures: Force per area at the vertices, (n, 3) [Pa].
    """

    name: str
    positions: Array
    normals: Array
    pressures: Array

    def refined(self, largest: float, step: float = COLOR_STEP) -> "PressurePatches":
        """Returns the area in triangles whose pressures vary by at most ``step`` times ``largest`` [Pa].

        Colors can then be interpolated, although color maps are curved.
        """
        if largest <= 0.0:
            return self
        finished, positions, normals, pressures = [], self.positions, self.normals, self.pressures
        while len(positions):
            changes = np.abs(np.roll(pressures, -1, axis=1) - pressures)
            divided = changes.max(axis=1) > step * largest
            finished.append((positions[~divided], normals[~divided], pressures[~divided]))
            edge = changes[divided].argmax(axis=1)
            positions, pressures = (_halves(values[divided], edge) for values in (positions, pressures))
            normals = np.tile(normals[divided], (2, 1))
        if not finished:
            return self
        return PressurePatches(self.name, *(np.concatenate(column) for column in zip(*finished, strict=True)))


def _halves(values: Array, edge: Array) -> Array:
    """Returns values at the vertices of both halves of triangles, (2 n, 3, …), divided at an edge (n,)."""
    rows, end = np.arange(len(values)), (edge + 1) % 3
    middle = 0.5 * (values[rows, edge] + values[rows, end])
    first, second = values.copy(), values.copy()
    first[rows, edge], second[rows, end] = middle, middle
    return np.concatenate([first, second])


class ContactPressure:
    """Pressure of the visible body contacts of a replay, evaluated on access.

    Pressures are those of the law at the recorded poses, and at the recorded velocities, or at rest without them. If
    ``<contact>.normal_force`` was recorded, they are scaled to it.

    Args:
        replay: The replay.
        contacts: Contacts with forces.
    """

    def __init__(self, replay: Replay, contacts: Sequence[BodyContact]) -> None:
        self.replay = replay
        self.contacts = list(contacts)
        self._last: tuple[tuple[int, int], list[PressurePatches]] | None = None

    @classmethod
    def of(cls, replay: Replay) -> "ContactPressure":
        """Returns the pressure of the visible contacts of a replay that have forces, not impulses."""
        attrs = replay.data.attrs
        compliant = attrs.get(COMPLIANT, ())
        compliant = {compliant} if isinstance(compliant, str) else set(compliant)
        is_nonsmooth = attrs.get(INTEGRATOR) == "MoreauJean"
        return cls(
            replay,
            [
                one
                for one in replay.scene.body_contacts
                if one.visible and not one.parts.law.rigid and (not is_nonsmooth or one.name in compliant)
            ],
        )

    def at(self, record: int, row: int) -> list[PressurePatches]:
        """Returns the areas in one record of environment ``row`` of the replay, of contacts that are closed."""
        if self._last is None or self._last[0] != (record, row):
            self._last = (record, row), next(self.each([(record, row)]))
        return self._last[1]

    def each(self, keys: Iterable[tuple[int, int]]) -> Iterator[list[PressurePatches]]:
        """Yields the areas in each record and environment of ``keys``; only some of them are in memory."""
        remaining = iter(keys)
        while block := list(itertools.islice(remaining, _BLOCK)):
            yield from self._evaluate(block) if self.contacts else ([] for _ in block)

    def peak(self, records: Iterable[int], rows: Iterable[int]) -> float:
        """Returns the largest pressure in some records of environments, 0 without contact [Pa]."""
        if not self.contacts:
            return 0.0
        areas = self.each(itertools.product(records, rows))
        return max((float(one.pressures.max()) for patches in areas for one in patches), default=0.0)

    def _evaluate(self, keys: list[tuple[int, int]]) -> list[list[PressurePatches]]:
        # Imported on demand, because most scenes have no body contacts.
        from warpcontact.forces.body_contact.body_contact_set import BodyContactSet
        from warpcontact.forces.body_contact.pressure_map import pressure_map

        model = _model(self.replay, len(keys))
        _set_state(model, self.replay, keys)
        found: list[list[PressurePatches]] = [[] for _ in keys]
        sets = [one for one in model.force_elements if isinstance(one, BodyContactSet) and not one.parts.law.rigid]
        for body_contacts in sets:
            own_map = pressure_map(body_contacts, model, len(keys))
            forces = own_map.normal_force((len(keys), body_contacts.count))
            scales = np.ones_like(forces)
            shown = np.zeros(body_contacts.count, dtype=bool)
            for contact, items in body_contacts.items.items():
                shown[items] = contact.name in {one.name for one in self.contacts}
                scales[:, items] = self._scale(contact, forces[:, items], keys)
            drawn = own_map.is_main & (own_map.weights > 0.0) & (own_map.fractions > 0.0) & shown[own_map.pair]
            drawn &= scales[own_map.env, own_map.pair] > 0.0
            pressures = own_map.pressures * scales[own_map.env, own_map.pair][:, None]
            names = [contact.name for contact in body_contacts.items]
            firsts = [items.start for items in body_contacts.items.values()]
            rows = np.flatnonzero(drawn)
            contact_numbers = np.searchsorted(firsts, own_map.pair[rows], side="right") - 1
            own_keys = own_map.env[rows].astype(np.int64) * len(names) + contact_numbers
            order = np.argsort(own_keys, kind="stable")
            for own in np.split(order, np.flatnonzero(np.diff(own_keys[order])) + 1) if len(order) else []:
                number, contact_number = divmod(int(own_keys[own[0]]), len(names))
                chosen = rows[own]
                patches = PressurePatches(
                    names[contact_number], own_map.positions[chosen], own_map.normals[chosen], pressures[chosen]
                )
                found[number].append(patches)
        return found

    def _scale(self, contact: BodyContact, forces: Array, keys: list[tuple[int, int]]) -> Array:
        """Returns the ratio of recorded and computed forces, (key, pair); 1 without a recorded force."""
        recorded = self.replay.series(f"{contact.name}.normal_force")
        if recorded is None:
            return np.ones_like(forces)
        given = np.array([recorded[key] for key in keys], dtype=np.float64).reshape(forces.shape)
        known = np.isfinite(given) & (forces > 0.0)
        return np.where(known, np.maximum(given, 0.0) / np.where(known, forces, 1.0), 1.0)


# A model per scene that is alive, for views that draw one record after the other, and the parameters that were set.
_MODELS: WeakKeyDictionary[SceneData, tuple[DeviceModel, frozenset[str]]] = WeakKeyDictionary()


def _model(replay: Replay, envs: int) -> DeviceModel:
    """Returns a model of the body contacts of a scene with at least ``envs`` environments."""
    recorded = frozenset(
        str(name)
        for name, values in replay.data.data_vars.items()
        if "time" not in values.dims and "env" in values.dims
    )
    model, known = _MODELS.get(replay.scene, (None, frozenset()))
    # Parameters that were set for another recording would keep their values.
    if model is None or model.envs < envs or known != recorded:
        reduced = replay.scene.snapshot()
        for name in _OMITTED:
            setattr(reduced, name, [])
        (plan,) = plan_on_devices(reduced, "cpu", "float64")
        require(plan.memory_estimate, envs, "to draw the pressure of body contacts, ")
        model = DeviceModel(plan, envs)
        _MODELS[replay.scene] = model, recorded
    return model


def _set_state(model: DeviceModel, replay: Replay, keys: list[tuple[int, int]]) -> None:
    """Sets parameters and state of each environment to those of a record and environment of the replay."""
    # Further environments are not evaluated; they repeat the last one.
    padded = [*keys, *[keys[-1]] * (model.envs - len(keys))]
    records, rows = (np.array(column) for column in zip(*padded, strict=True))
    for name in model:
        if name in replay.data and "time" not in replay.data[name].dims and "env" in replay.data[name].dims:
            values = replay.variable(name).transpose("env", ...).values
            model[name] = values[rows]
    state = model.state
    arrays: dict[str, Any] = {
        "position": state.body_position,
        "orientation": state.body_orientation,
        "linear_velocity": state.body_linear_velocity,
        "angular_velocity": state.body_angular_velocity,
    }
    for key, array in arrays.items():
        values = array.numpy()
        for body in replay.scene.bodies:
            series = replay.series(f"{body.name}.{key}")
            own = body.items
            if series is None:
                # Velocities that were not recorded.
                values[:, own] = 0.0
            else:
                each = series[records, rows].astype(np.float64).reshape(len(records), body.count, -1)
                values[:, own] = np.where(np.isfinite(each), each, 0.0)
        array.assign(values)
    state.body_position_remainder.zero_()
