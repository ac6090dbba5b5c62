"""Bushings on a device."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from warpcontact import checks
from warpcontact import elements as limits_of
from warpcontact.arrays import per_env
from warpcontact.checks import Array
from warpcontact.couplings import elements
from warpcontact.couplings.coupling_set import CouplingSet
from warpcontact.couplings.elements import Bushing
from warpcontact.frames import inverse, product
from warpcontact.kernels.couplings import bushing
from warpcontact.parameters import Field, pack

if TYPE_CHECKING:
    from warpcontact.arrays import Layout
    from warpcontact.elements import Body
    from warpcontact.parameters import Parameters
    from warpcontact.schedule import Span

_RANGES = {
    "stiffness": elements.STIFFNESS,
    "damping": elements.DAMPING,
    "turn_stiffness": elements.TURN_STIFFNESS,
    "turn_damping": elements.TURN_DAMPING,
}


class BushingSet(CouplingSet):
    """All bushings of a scene."""

    couplings: list[Bushing]
    quantities: ClassVar[Mapping[str, tuple[str, str, str]]] = {
        "displacement": ("displacement", "m", "of the second end from the first, axes of the bushing"),
        "rotation": ("rotation", "rad", "of the second body from rest, rotation vector, axes of the bushing"),
        "force": ("force", "N", "force on the second body, axes of the bushing"),
        "torque": ("torque", "N·m", "couple on the second body, axes of the bushing"),
        "status": ("status", "-", "state of the coupling"),
    }

    @property
    def results(self) -> Any:
        """What was measured last."""
        return self._bushings

    def _make(self, layout: "Layout", parameters: "Parameters") -> None:
        t = bushing.bushing_structs(self.types.real)
        self._bushings = layout.struct("couplings", t.Bushings, per_env(self.count))
        self._owner = _Owner()
        fields = {key: Field(np.array([getattr(one, key) for one in self.couplings])) for key in _RANGES}
        enabled = Field(np.array([one.enabled for one in self.couplings]))
        orientation = Field(np.array([one.orientation for one in self.couplings]))
        # From the frame of the first body to that of the second at rest, which is how they stand in the scene.
        rest = np.array(
            [product(inverse(_orientation(one.bodies[1])), _orientation(one.bodies[0])) for one in self.couplings]
        )

        def content() -> Any:
            return pack(
                t.Settings,
                {
                    **{key: field.values for key, field in fields.items()},
                    "orientation_1": orientation.values,
                    "orientation_2": product(rest, orientation.values),
                    "enabled": enabled.values,
                },
            )

        upload = parameters.upload(self._owner, "settings", t.Settings, content)
        for item, one in enumerate(self.couplings):
            own = slice(item, item + 1)
            for key, allowed in _RANGES.items():
                parameters.add(f"{one.name}.{key}", fields[key], own, allowed, [upload], tail=(3,))
            parameters.add(
                f"{one.name}.orientation",
                orientation,
                own,
                checks.FINITE,
                [upload],
                tail=(4,),
                convert=checks.unit_quaternions,
            )
            parameters.add(
                f"{one.name}.enabled", enabled, own, limits_of.ENABLED, [upload], convert=checks.switches
            )

    def force_stages(self, span: "Span", state: Any, status: wp.array) -> list[wp.Launch]:
        """Returns the launch of the forces of its bushings."""
        a, kernel = span.model.arrays, bushing.kernel(self.types.real)
        inputs = [status, a.model, state, self.first, self._owner.settings, self._bushings, a.ends]
        return span.prepare(kernel, self.count, inputs)


class _Owner:
    """Where the array of the settings is."""

    settings: Any = None


def _orientation(body: "Body | None") -> Array:
    return np.array([0.0, 0.0, 0.0, 1.0]) if body is None else body.orientation
