"""Explains how a simulation launches its steps: the launch shape of each part of the model, and its reasons."""

from collections.abc import Sequence
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
        files: File of each of these kernels.
        present_shape: Launch shape of the steps until the kernels of ``shape`` are compiled in the background.
        present_kernels: Names of the kernels of one step of it.
        present_files: File of each of these kernels.
    """

    device: str
    envs: int
    slices: int
    threads: int
    shape: LaunchShape
    kernels: tuple[str, ...]
    files: tuple[str, ...]
    present_shape: LaunchShape
    present_kernels: tuple[str, ...]
    present_files: tuple[str, ...]

    def __str__(self) -> str:
        slices = f"{self.slices} slice{'s' * (self.slices > 1)}"
        threads = f", {self.threads} thread{'s' * (self.threads > 1)}" if self.threads else ""
        lines = [
            f"{self.device}: {self.envs} environment{'s' * (self.envs > 1)}, {slices}{threads}",
            f"  launch shape: {self.shape.name} ({self.shape.summary})",
            "  kernels of a step:",
            *_kernel_lines(self.kernels, self.files),
        ]
        if self.present_kernels != self.kernels:
            lines += ["  until these are compiled:", *_kernel_lines(self.present_kernels, self.present_files)]
        lines += [f"  not {name}: {reason}" for name, reason in self.shape.rejected.items()]
        return "\n".join(lines)


def _kernel_lines(kernels: Sequence[str], files: Sequence[str]) -> list[str]:
    return [f"    {kernel} ({file})" for kernel, file in zip(kernels, files, strict=True)]


@dataclass(frozen=True)
class StepExplanation:
    """How a simulation launches its steps; ``print`` it.

    Attributes:
        parts: One explanation per part of the model.
        uses_quick_builds: Whether present steps use quick builds of kernels, which run slower.
        compiled: Number of kernels that were compiled in the background.
        requested: Number of kernels to compile in the background. 0: all kernels have release builds, or steps were
            not prepared yet.
        errors: Kernels that could not be compiled in the background, with reasons; empty if there are none.
    """

    parts: tuple[PartExplanation, ...]
    uses_quick_builds: bool = False
    compiled: int = 0
    requested: int = 0
    errors: str = ""

    def __str__(self) -> str:
        lines = list(map(str, self.parts))
        if self.uses_quick_builds:
            lines.append("present steps use quick builds of kernels")
        if self.requested:
            lines.append(f"compiled in the background: {self.compiled} of {self.requested} kernels")
        if self.errors:
            lines.append(f"not compiled in the background: {self.errors}")
        return "\n".join(lines)
