"""Explains how a simulation launches its steps: the launch shape of each part of the model, and its reasons."""

from dataclasses import dataclass

from warpcontact.forces.launch_shape import LaunchShape


@dataclass(frozen=True)
class PartExplanation:
    """How the steps of one part of a model are launched.

    Attributes:
        device: Name of the device.
        envs: Number of environments.
        slices: Number of slices of environments.
        threads: Number of CPU threads that step the slices. 0 on a GPU.
        shape: The launch shape, with the reasons for which faster ones were rejected.
        kernels: Names of the kernels of one step, in order of their launches.
    """

    device: str
    envs: int
    slices: int
    threads: int
    shape: LaunchShape
    kernels: tuple[str, ...]

    def __str__(self) -> str:
        slices = f"{self.slices} slice{'s' * (self.slices > 1)}"
        threads = f", {self.threads} thread{'s' * (self.threads > 1)}" if self.threads else ""
        lines = [
            f"{self.device}: {self.envs} environment{'s' * (self.envs > 1)}, {slices}{threads}",
            f"  launch shape: {self.shape.name} ({self.shape.summary})",
            f"  kernels of a step: {', '.join(self.kernels)}",
        ]
        lines += [f"  not {name}: {reason}" for name, reason in self.shape.rejected.items()]
        return "\n".join(lines)


@dataclass(frozen=True)
class StepExplanation:
    """How a simulation launches its steps; ``print`` it.

    Attributes:
        parts: One explanation per part of the model.
    """

    parts: tuple[PartExplanation, ...]

    def __str__(self) -> str:
        return "\n".join(map(str, self.parts))
