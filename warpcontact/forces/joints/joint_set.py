"""Joints of bodies to the world, and prescribed motion, as a force element. Kernels: ``kernels/joints``."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpcontact.forces.force_element import BuildContext, ForceElement, Need
from warpcontact.forces.joints.joint_data import add_motions
from warpcontact.forces.sensor import Sensor, shape_in
from warpcontact.kernels.joints import Motion, driven, step
from warpcontact.kernels.joints.measures import Coordinates, Reactions, coordinates, reactions
from warpcontact.kernels.types import BALL, FREE, HINGE, PLANAR, SLIDER, TIME_FUNCTION
from warpcontact.scene.elements import Body
from warpcontact.storage.allocation_plan import SENSOR_PURPOSE, AllocationPlan, per_env
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.system.launches import launch_kernel

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
    from warpcontact.model.model import DeviceModel

_STRUCTS = {"reactions": Reactions, "coordinates": Coordinates}
# name: (need, unit, meaning)
_REVOLUTE = {
    "angle": ("coordinates", "rad", "angle from the initial pose about the axis, −π to π"),
    "angle_rate": ("coordinates", "rad/s", "angular velocity about the axis"),
}
_PRISMATIC = {
    "displacement": ("coordinates", "m", "displacement from the initial position along the axis"),
    "displacement_rate": ("coordinates", "m/s", "velocity along the axis"),
}
# Arrays of the sensors whose names differ from them.
_ARRAYS = {"reaction_force": "force", "reaction_torque": "torque"}


class JointSet(ForceElement):
    """All bodies of a model that are not free: those with joints, and those with prescribed motion.

    Args:
        context: The model; its bodies are declared.

    Attributes:
        prescribed_motions: Bodies with prescribed motion, by class of motion.
        constrained: Indices of the bodies with joints.
    """

    family = "joints"

    def __init__(self, context: BuildContext) -> None:
        super().__init__()
        bodies = context.scene.bodies
        self._bodies = [body for body in bodies if body.motion.kind != FREE]
        self._body_count = sum(body.count for body in bodies)
        self._arrays, self._real = context.arrays, context.types.real
        kinds = np.repeat([body.motion.kind for body in bodies], [body.count for body in bodies])
        numbers = np.flatnonzero((kinds != FREE) & (kinds != TIME_FUNCTION))
        self._constrained_count = len(numbers)
        self.constrained: Any = None
        context.layout.constant("state", self, "constrained", numbers, wp.int32)
        self.prescribed_motions = add_motions(
            context.scene, context.arrays.model, context.layout, context.parameters
        )

    def compile(self, device: wp.Device) -> None:
        """Compiles user-defined motions, to report errors early.

        Raises:
            TypeError: If a motion does not compile.
        """
        for motion_set in self.prescribed_motions:
            motion_set.compile(device, self._real)

    def motion_launches(
        self, plan: "ExecutionPlan", positions: Iterable[tuple[wp.array, tuple[float, float], Any]]
    ) -> list[wp.Launch]:
        """Returns the launches that set the bodies with prescribed motion."""
        a, positions, launches = plan.model.arrays, list(positions), []
        for motion_set in self.prescribed_motions:
            for length, span, state in positions:
                launches += plan.prepare(
                    driven.follow(motion_set.motion, self._real),
                    motion_set.count,
                    status=a.status,
                    step=length,
                    time=a.time,
                    model=a.model,
                    guard=a.guard,
                    first=span[0],
                    last=span[1],
                    wrenches=a.wrenches,
                    state_out=state,
                    **motion_set.inputs,
                )
        return launches

    def integration_launches(
        self, plan: "ExecutionPlan", dt: "StepLength", state_in: Any, state_out: Any
    ) -> list[wp.Launch]:
        """Returns the launches that step the bodies with joints, then those with prescribed motion."""
        a = plan.model.arrays
        launches = plan.prepare(
            step.semi_implicit_euler(self._real),
            self._constrained_count,
            status=a.status,
            step=dt.real,
            model=a.model,
            guard=a.guard,
            members=self.constrained,
            state_in=state_in,
            wrenches=a.wrenches,
            state_out=state_out,
        )
        return launches + self.motion_launches(plan, [(dt.clock, (0.0, 1.0), state_out)])

    def change_launches(self, plan: "ExecutionPlan", change: wp.array, state: Any) -> list[wp.Launch]:
        """Returns the launches that adapt velocities to a change of the step length [env, 0] [s]."""
        a, real = plan.model.arrays, self._real
        inputs = {"status": a.status, "change": change, "model": a.model, "state": state}
        launches = plan.prepare(
            step.change_step(real),
            self._constrained_count,
            members=self.constrained,
            wrenches=a.wrenches,
            **inputs,
        )
        for motion_set in self.prescribed_motions:
            kernel = driven.change_step(motion_set.motion, real)
            launches += plan.prepare(kernel, motion_set.count, time=a.time, **motion_set.inputs, **inputs)
        return launches

    def reset_state(self, chosen: wp.array) -> None:
        """Projects initial velocities onto the joints, and sets bodies with prescribed motion to their start."""
        a, real, envs = self._arrays, self._real, len(chosen)
        kernel, shape = step.project_velocities(real), (envs, self._body_count)
        wp.launch(kernel, dim=shape, inputs=[chosen, a.model, a.state], device=chosen.device)
        for motion_set in self.prescribed_motions:
            launch_kernel(
                driven.start(motion_set.motion, real),
                (envs, motion_set.count),
                device=chosen.device,
                mask=chosen,
                time=a.time,
                model=a.model,
                state=a.state,
                **motion_set.inputs,
            )

    def sets_initial_state(self, struct: Any, attribute: str) -> bool:
        """Returns whether an array belongs to a joint or a prescribed motion, which sets initial poses."""
        return attribute == "body_motion" or any(struct is one.arrays for one in self.prescribed_motions)

    def needs(self) -> Mapping[str, Need]:
        """Returns the needs of reactions and joint coordinates."""
        return {
            name: Need(self._declare(struct), by_slice=name == "coordinates") for name, struct in _STRUCTS.items()
        }

    def _declare(self, struct: Any) -> Callable[[AllocationPlan], Any]:
        return lambda layout: layout.struct(SENSOR_PURPOSE, struct, per_env(self._body_count))

    def sensor_launches(
        self, plan: "ExecutionPlan", needs: Collection[str], state: Any, status: wp.array
    ) -> list[wp.Launch]:
        """Returns the launch that computes joint coordinates."""
        if "coordinates" not in needs:
            return []
        return plan.prepare(
            coordinates(self._real),
            self._body_count,
            status=status,
            model=plan.model.arrays.model,
            state=state,
            measured=self.measures.get("coordinates"),
        )

    def measure(self, model: "DeviceModel", needs: Collection[str]) -> None:
        """Computes reaction forces from the last evaluated wrenches."""
        if "reactions" not in needs:
            return
        a, measured = model.arrays, self.measures["reactions"]
        for motion_set in self.prescribed_motions:
            launch_kernel(
                driven.accelerate(motion_set.motion, self._real),
                (model.envs, motion_set.count),
                device=model.device,
                time=a.time,
                model=a.model,
                linear=measured.linear,
                angular=measured.angular,
                **motion_set.inputs,
            )
        inputs, shape = [a.model, a.state, a.wrenches], (model.envs, self._body_count)
        wp.launch(reactions(self._real), dim=shape, inputs=inputs, outputs=[measured], device=model.device)

    def sensors(self) -> Iterator[Sensor]:
        """Yields the sensors of the bodies."""
        for body in self._bodies:
            own, several = (body.index, 0) if body.single else (body.items, body.count)
            for key, (need, unit, meaning) in _sensors_of(body.motion).items():
                attribute = _ARRAYS.get(key, key)
                needs = ("wrenches", need) if need == "reactions" else (need,)
                array, shape = self._column(need, attribute, own), shape_in(_STRUCTS[need], attribute)
                name = f"{body.name}.{key}"
                yield Sensor(name, unit, meaning, array, needs=needs, items=several, shape=shape)

    def _column(self, need: str, attribute: str, own: int | slice) -> Callable[[ModelArrays], wp.array]:
        return lambda _: getattr(self.measures[need], attribute)[:, own]


def _sensors_of(motion: Motion) -> dict[str, tuple[str, str, str]]:
    """Returns the sensors of a body with this motion: (need, unit, meaning) by name."""
    place = "anchor" if motion.kind in (HINGE, BALL) else "center of mass"
    table = {
        "reaction_force": ("reactions", "N", f"force of the joint on the body at its {place}, world"),
        "reaction_torque": ("reactions", "N·m", f"moment of the joint about the {place}, world axes"),
    }
    if motion.kind in (HINGE, PLANAR):
        table |= _REVOLUTE
    return table | _PRISMATIC if motion.kind == SLIDER else table


def declare(context: BuildContext, elements: Sequence[Body]) -> list[ForceElement]:
    """Declares joints and prescribed motions of a model."""
    return [JointSet(context)]
