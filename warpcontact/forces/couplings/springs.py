"""Device data of spring-dampers."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.couplings.coupling_set import CouplingSet
from warpcontact.forces.couplings.step_warnings import spring_warnings
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.couplings import spring
from warpcontact.kernels.couplings.spring import SpringModel
from warpcontact.kernels.couplings.springs import Undamped
from warpcontact.kernels.couplings.springs.base import rows_of
from warpcontact.scene import couplings as elements
from warpcontact.scene import elements as limits_of
from warpcontact.scene.couplings import SpringDamper
from warpcontact.storage.allocation_plan import per_env
from warpcontact.storage.parameters import Field, pack
from warpcontact.storage.state_storage import SWITCH
from warpcontact.system.compilation import load
from warpcontact.validation.custom_law_errors import explain_compile_errors, has_user_code

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.storage.allocation_plan import AllocationPlan
    from warpcontact.storage.parameters import Parameters


_RANGES = {
    "rest_length": elements.LENGTH,
    "break_force": elements.BREAK_FORCE,
    "tension_only": limits_of.ENABLED,
    "enabled": limits_of.ENABLED,
}


class SpringSet(CouplingSet):
    """Device data of spring-dampers with the same classes of spring and damper."""

    couplings: list[SpringDamper]
    quantities: ClassVar[Mapping[str, tuple[str, str, str]]] = {
        "length": ("length", "m", "distance of the ends"),
        "rate": ("rate", "m/s", "rate of change of the length"),
        "force": ("force", "N", "force, positive in tension"),
        "status": ("status", "-", "state of the coupling"),
    }

    @staticmethod
    def key(coupling: SpringDamper) -> SpringModel:
        """Returns the classes of spring and damper."""
        return SpringModel(type(coupling.spring), type(coupling.damper))

    @property
    def parts(self) -> SpringModel:
        """The classes of spring and damper."""
        return self.key(self.couplings[0])

    @property
    def results(self) -> Any:
        """Results of the last evaluation."""
        return self._springs

    def _make(self, layout: "AllocationPlan", parameters: "Parameters") -> None:
        t = spring.spring_structs(self.types.real)
        self._springs = layout.struct(
            "couplings",
            t.Springs,
            per_env(self.count),
            transient=("length", "rate", "force", "status", "direction"),
            ranges={"broken": SWITCH},
        )
        self._coefficients = spring.coefficient_structs(self.parts, self.types.real)()
        rest = self._add_settings(parameters, self._coefficients, t.Settings, _RANGES)["rest_length"]
        self._tables = []
        for part in self.parts._fields:
            self._tables.append(self._add_tables(layout, part))
            self._add_formula(parameters, part, rest)
        self.kernel = spring.kernel(self.parts, self.types.real)

    def _add_tables(self, layout: "AllocationPlan", part: str) -> Any:
        owner = spring.spring_structs(self.types.real).Tables()
        rows, first = [np.zeros((0, 4))], [0]
        for one in self.couplings:
            formula = getattr(one, part)
            if (field := formula.table_field()) is not None:
                rows.append(rows_of(getattr(formula, field.name)))
            first.append(sum(map(len, rows)))
        vec4 = {wp.float32: wp.vec4f, wp.float64: wp.vec4d}[self.types.real]
        layout.constant("couplings", owner, "rows", np.concatenate(rows), vec4)
        layout.constant("couplings", owner, "first", first, wp.int32)
        return owner

    def _add_formula(self, parameters: "Parameters", part: str, rest: Field) -> None:
        """Adds the parameters of one part and the device field of its coefficients."""
        real = self.types.real
        formulas = [getattr(one, part) for one in self.couplings]
        struct = coefficient_struct(type(formulas[0]), real)
        fields = [
            {name: Field(np.array([float(value)])) for name, value in formula.parameters().items()}
            for formula in formulas
        ]

        def content() -> NDArray[Any]:
            names = formulas[0].device_names()
            if not names:
                return pack(struct, {"unused": np.zeros((1, len(formulas)))})
            columns: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
            for item, (formula, own) in enumerate(zip(formulas, fields, strict=True)):
                values = {name: field.values for name, field in own.items()}
                if formula.derives():
                    values["rest_length"] = rest.values[:, item : item + 1]
                computed = formula.coefficients(
                    dict(zip(values, np.broadcast_arrays(*values.values()), strict=True))
                )
                for name in names:
                    columns[name].append(computed[name])
            envs = max(len(column) for own in columns.values() for column in own)
            return pack(
                struct,
                {
                    name: np.concatenate([np.broadcast_to(column, (envs, 1)) for column in own], axis=1)
                    for name, own in columns.items()
                },
            )

        device_field = parameters.device_field(self._coefficients, part, struct, content)
        for one, formula, own in zip(self.couplings, formulas, fields, strict=True):
            plain = one.plain_spring if part == "spring" else one.plain_damper
            for name, field in own.items():
                label = f"{one.name}.{name}" if plain else f"{one.name}.{part}.{name}"
                parameters.add(label, field, slice(0, 1), formula.limits(name), [device_field])
            if formula.derives():
                parameters.by_name[f"{one.name}.rest_length"].device_fields.append(device_field)

    def force_launches(
        self, plan: "ExecutionPlan", state: Any, step: wp.array, status: wp.array, *, by_cluster: bool = False
    ) -> list[wp.Launch]:
        """Returns the launch that computes the forces of the spring-dampers."""
        a = plan.model.arrays
        spring_tables, damper_tables = self._tables
        return plan.prepare(
            self.kernel,
            self.count,
            status=status,
            model=a.model,
            state=state,
            first=self.first,
            coefficients=self._coefficients,
            spring_tables=spring_tables,
            damper_tables=damper_tables,
            springs=self._springs,
            ends=a.end_wrenches,
        )

    def accept_launches(self, plan: "ExecutionPlan", dt: "StepLength", state_in: Any) -> list[wp.Launch]:
        """Returns the launch that stores which springs broke, and their directions."""
        a, kernel = plan.model.arrays, spring.accept(self.types.real)
        return plan.prepare(kernel, self.count, status=a.status, springs=self._springs)

    def advice(self, model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None") -> list[str]:
        """Returns the warnings about the step length."""
        return [sentence for one in self.couplings for sentence in spring_warnings(model, one, dt)]

    def reset_state(self, chosen: wp.array) -> None:
        """Clears the broken flags and directions in the environments of the mask ``chosen`` [env]."""
        kernel, device = spring.reset(self.types.real), chosen.device
        wp.launch(kernel, dim=(len(chosen), self.count), inputs=[chosen, self._springs], device=device)

    def compile(self, device: wp.Device) -> None:
        """Compiles the force kernel if it has user-defined formulas, to report errors early.

        Raises:
            TypeError: If a formula does not compile.
        """
        if not has_user_code(self.parts):
            return
        stretch = spring.spring_structs(self.types.real).Stretch
        present = {part: formula for part, formula in self.parts._asdict().items() if formula is not Undamped}
        constants = (
            "\nWrite constants and initial values of variables in the precision of the simulation: "
            "type(s.length)(1.5)."
        )
        results = "\nThe force is a number in the precision of the simulation."
        with explain_compile_errors(present, self.types.real, lambda _: ("s", stretch), constants, results):
            load(self.kernel, device)
