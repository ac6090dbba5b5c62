"""Device arrays of a model, as one object, and the base class of objects that hold device arrays."""

from dataclasses import dataclass
from typing import Any, ClassVar, NoReturn


@dataclass(eq=False)
class ModelArrays:
    """Device arrays of a model: instances of Warp structs, or single arrays.

    ``model/build.py`` declares them. Arrays are allocated with the model; those of sensors are ``None`` until a sensor
    needs them.

    Attributes:
        model: Parameters, surfaces and topology (``kernels/types.py:Model``).
        initial: Initial state (``State``).
        state: Current state (``State``).
        wrenches: Wrenches on bodies (``Wrenches``).
        end_wrenches: Wrenches of couplings and shape contacts at their ends (``EndWrenches``).
        history: History of contacts (``History``).
        contacts: Results of detection and forces of contacts (``Contacts``).
        active_contacts: Contacts that later stages process (``ActiveContacts``).
        cache: Distances cached from earlier steps (``Cache``).
        uses_face_grid: Whether queries use face grids; there is no face cache then.
        faces_read: Number of faces that a step of an environment reads, for the size of slices.
        status: Status of environments [env], ``ENV_*``.
        time: Clocks [env] [s], float64.
        zero_step: A step of 0 s [1, 1].
        active_status: The status of an active environment [1].
        guard: Limits of speed and distance, and failure causes (``kernels/acceptance/accept_step.py:Guard``).
        contact_tolerance: Gap below which contacts are closed (``storage/parameters.py:ContactTolerance``).
        positions: Positions of bodies in float64, for sensors.
        energies: Kinetic energies of bodies, for sensors.
        momenta: Angular momenta of bodies, for sensors.
    """

    model: Any
    initial: Any
    state: Any
    wrenches: Any
    end_wrenches: Any
    history: Any
    contacts: Any
    active_contacts: Any
    cache: Any
    uses_face_grid: bool
    faces_read: int
    status: Any = None
    time: Any = None
    zero_step: Any = None
    active_status: Any = None
    guard: Any = None
    contact_tolerance: Any = None
    positions: Any = None
    energies: Any = None
    momenta: Any = None


class Uncopied:
    """Base class that refuses pickling and copying; ``instead`` is the advice at the end of the message."""

    _instead: ClassVar[str]

    def __init_subclass__(cls, *, instead: str | None = None, **others: Any) -> None:
        super().__init_subclass__(**others)
        if instead is not None:
            cls._instead = instead

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        """Refuses ``pickle`` and ``copy``.

        Raises:
            TypeError: Always; the message has the advice.
        """
        raise TypeError(
            f"a {type(self).__name__} must not be pickled or copied, because it holds device arrays; "
            f"{self._instead}"
        )
