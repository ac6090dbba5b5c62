"""Time integrators, chosen by passing an object to ``Simulation``."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import warp as wp

from warpcontact.kernels import integrate
from warpcontact.kernels.motions import step


class Integrator(ABC):
    """A scheme that takes a state over one step."""

    #: Order of convergence of the state for smooth forces.
    order: int

    @abstractmethod
    def kernel(self, real: type, moves: bool = False) -> wp.Kernel:
        """Returns the kernel (work, status, dt, model, state_in, wrenches, state_out); items: bodies.

        With ``moves`` it leaves bodies that are not free to the kernels of ``motions``.
        """

    @abstractmethod
    def motions(self, real: type) -> wp.Kernel:
        """Returns the kernel of constrained bodies; items: ``members``.

        It takes (work, status, dt, model, members, state_in, wrenches, state_out).
        """

    def change_step(self, real: type, moves: bool = False) -> wp.Kernel | None:
        """Returns the kernel (work, status, change, model, wrenches, state) between unequal steps.

        It readies ``state`` for a step that is longer by ``change`` [s] than the last. ``None``: a state does not
        depend on the step that led to it. With ``moves`` it leaves bodies that are not free to the kernels of
        ``motions``.
        """
        return None


@dataclass(frozen=True)
class SemiImplicitEuler(Integrator):
    """Velocities from the forces at the state before the step, positions from the new velocities.

    First order; symplectic for conservative forces, so the energy of an elastic bounce does not drift.
    """

    order = 1

    def kernel(self, real: type, moves: bool = False) -> wp.Kernel:
        """Returns the kernel for precision ``real``."""
        return integrate.semi_implicit_euler(real, moves)

    def motions(self, real: type) -> wp.Kernel:
        """Returns the kernel of constrained bodies for precision ``real``."""
        return step.semi_implicit_euler(real)

    def change_step(self, real: type, moves: bool = False) -> wp.Kernel:
        """Returns the kernel for precision ``real``; velocities are half a step behind the positions."""
        return integrate.change_step(real, moves)


__all__ = ["Integrator", "SemiImplicitEuler"]
