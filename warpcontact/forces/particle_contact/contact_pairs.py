"""Pairs of a particle contact that are in contact, as a labeled data set; see ``Model.contact_pairs``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from warpcontact.forces.particle_contact.contact_set import ParticleContactSet
from warpcontact.kernels.particles.base import IN_CONTACT
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.model.model import DeviceModel

_AXES = ["x", "y", "z"]
_MEANINGS = {
    "gap": ("m", "signed distance, negative in overlap"),
    "point": ("m", "contact point K, world"),
    "normal": ("-", "unit normal out of the second particle, towards the first, world"),
    "normal_force": ("N", "normal force"),
    "friction_force": ("N", "friction force on the body of the first particle, world"),
    "approach_speed": ("m/s", "rate of penetration at K"),
}


def contact_pairs(parts: "Sequence[tuple[DeviceModel, int, ParticleContactSet]]") -> xr.Dataset:
    """Returns the pairs in contact at the last evaluated state.

    Args:
        parts: The models, each with the number of its first environment and its particle contact set.
    """
    columns = [_pairs_of_model(model, first, particle_set) for model, first, particle_set in parts]
    together = {name: np.concatenate([own[name] for own in columns]) for name in columns[0]}
    contact = parts[0][2].contact
    labels = np.array([contact.label(number) for number in range(contact.count)], dtype=object)
    bodies = np.array(
        [
            shape.body.name if shape.body.single else f"{shape.body.name}[{item}]"
            for shape in contact.shapes
            if shape.body is not None
            for item in range(shape.count)
        ],
        dtype=object,
    )
    result = xr.Dataset(coords={"axis": _AXES})
    for name in ("env", "shape_1", "shape_2"):
        result[name] = ("pair", together[name])
    for which in ("1", "2"):
        result[f"name_{which}"] = ("pair", labels[together[f"shape_{which}"]])
        result[f"body_{which}"] = ("pair", bodies[together[f"shape_{which}"]])
    for name, (unit, meaning) in _MEANINGS.items():
        values = together[name]
        result[name] = (("pair", "axis") if values.ndim == 2 else ("pair",), values)
        result[name].attrs.update(units=unit, long_name=meaning)
    return result


def _pairs_of_model(model: "DeviceModel", first_env: int, particle_set: ParticleContactSet) -> dict[str, Array]:
    count = particle_set.contact.count
    starts = particle_set.particles.slot_start.numpy()
    owner = np.repeat(np.arange(count), np.diff(starts))
    offset = np.arange(len(owner)) - starts[owner]
    owned, neighbors = (
        array.numpy() for array in (particle_set.neighbor_lists.owned, particle_set.neighbor_lists.neighbor)
    )
    flags = particle_set.pair_records.flags.numpy()[:, : len(owner)]
    envs, slots = np.nonzero((flags & IN_CONTACT != 0) & (offset < owned[:, owner]))
    shape_index = owner[slots]
    other = neighbors[envs, particle_set.particles.entry_start.numpy()[shape_index] + offset[slots]]
    shape_1, shape_2 = np.minimum(shape_index, other), np.maximum(shape_index, other)
    # Sort the pairs of an environment by particle numbers, independent of which particle owns the record.
    order = np.lexsort((shape_2, shape_1, envs))
    envs, slots, shape_1, shape_2 = envs[order], slots[order], shape_1[order], shape_2[order]
    records = {
        name: getattr(particle_set.pair_records, name).numpy()[envs, slots]
        for name in ("gap", "normal", "normal_force", "force", "approach_speed", "arm")
    }
    body = particle_set.contact.bodies[shape_1]
    state = model.arrays.state
    centre = state.body_position.numpy()[envs, body].astype(np.float64)
    centre += state.body_position_remainder.numpy()[envs, body]
    normal_force = records["normal_force"][:, None] * records["normal"]
    return {
        "env": envs + first_env,
        "shape_1": shape_1,
        "shape_2": shape_2,
        "gap": records["gap"],
        "point": centre + records["arm"],
        "normal": records["normal"],
        "normal_force": records["normal_force"],
        "friction_force": records["force"] - normal_force,
        "approach_speed": records["approach_speed"],
    }
