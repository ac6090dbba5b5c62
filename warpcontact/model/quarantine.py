"""Quarantine: limits whose violation makes an environment fail, and the policies for failed environments.

Kernels freeze a failed environment at its last valid state (``kernels/acceptance/accept_step.py``). The policies
"reset" and "raise" are applied here, on the host.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.acceptance import accept_step
from warpcontact.kernels.types import ENV_FROZEN, NO_CAUSE, TOO_FAR
from warpcontact.scene.scene_data import MAX_DISTANCE, MAX_SPEED, SceneData
from warpcontact.scene.status import FailureCause
from warpcontact.storage.allocation_plan import AllocationPlan, per_env
from warpcontact.storage.parameters import Field, Parameters, pack

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments
    from warpcontact.stepping.outcomes.observer import Monitor

#: Number of steps between checks for failed environments. In steps, so that results do not depend on the machine.
CADENCE = 64


def add_guard(scene: SceneData, layout: AllocationPlan, parameters: Parameters, real: type) -> Any:
    """Returns the struct of limits of speed and distance; declares its arrays and parameters."""
    guard_functions = accept_step.guard(real)
    guard = guard_functions.Guard()
    layout.array("state", guard, "cause", wp.int32, per_env(), ranges={"cause": (NO_CAUSE, TOO_FAR)})
    speed, distance = Field(np.array([scene.max_speed])), Field(np.array([scene.max_distance]))
    largest = float(np.finfo(wp.dtype_to_numpy(real)).max)

    def squares() -> dict[str, NDArray[np.float64]]:
        with np.errstate(over="ignore"):
            of = {"speed": speed.values**2, "distance": distance.values**2}
        # A limit whose square exceeds the device precision is never reached.
        return {key: np.where(values > largest, np.inf, values) for key, values in of.items()}

    device_fields = [
        parameters.device_field(
            guard, "limits", guard_functions.Limits, lambda: pack(guard_functions.Limits, squares())
        ),
        parameters.device_field(
            guard, "suspect", real, lambda: np.minimum(largest, np.minimum(*squares().values()))
        ),
    ]
    parameters.add("scene.max_speed", speed, slice(0, 1), MAX_SPEED, device_fields)
    parameters.add("scene.max_distance", distance, slice(0, 1), MAX_DISTANCE, device_fields)
    return guard


class QuarantineError(RuntimeError):
    """Raised if an environment failed and the quarantine policy is ``"raise"``.

    Attributes:
        env: Number of the environment.
        time: Its clock, the time of its last valid state [s].
        cause: Cause of the failure.
        count: Number of failed environments.
    """

    def __init__(self, env: int, time: float, cause: FailureCause, count: int) -> None:
        self.env, self.time, self.cause, self.count = env, time, cause, count
        others = f", and {count - 1} more" if count > 1 else ""
        super().__init__(f"environment {env} failed at {time:g} s: {cause.name}{others}")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.env, self.time, self.cause, self.count)


def raise_failed(model: "Environments") -> None:
    """Raises an error for the frozen environment with the earliest clock (the lowest number if several).

    Raises:
        QuarantineError: If any environment is frozen.
    """
    status = np.concatenate([part.arrays.status.numpy() for part in model.parts])
    failed = np.flatnonzero(status == ENV_FROZEN)
    if not len(failed):
        return
    time = np.concatenate([part.arrays.time.numpy() for part in model.parts])
    cause = np.concatenate([part.arrays.guard.cause.numpy() for part in model.parts])
    first = int(failed[time[failed].argmin()])
    raise QuarantineError(
        model.first_env + first, float(time[first]), FailureCause(int(cause[first])), len(failed)
    )


def reset_failed(model: "Environments", monitors: "list[Monitor]") -> None:
    """Resets failed environments to their initial state, with empty history and outcomes, and counts the resets."""
    for part, monitor in zip(model.parts, monitors, strict=True):
        failed = part.arrays.status.numpy() == ENV_FROZEN
        if failed.any():
            resets = monitor.resets.numpy().copy()
            part.reset_state(failed)
            resets[failed] += 1
            monitor.resets.assign(resets)
