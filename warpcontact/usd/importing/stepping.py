"""Solver settings of a PhysicsScene, from NewtonSceneAPI."""

from typing import Any, TypedDict

from warpcontact.usd.importing.findings import number
from warpcontact.usd.importing.schemas import is_authored, value_of


class Stepping(TypedDict):
    """Requested solver settings; ``None``: not authored.

    Attributes:
        dt: Time step [s].
        iterations: Maximum number of solver iterations per step.
    """

    dt: float | None
    iterations: int | None


#: Settings of a stage that has none.
NOTHING: Stepping = {"dt": None, "iterations": None}


def read_stepping(scene: Any, time: Any) -> Stepping:
    """Returns the authored settings of the prim of a PhysicsScene.

    Raises:
        InvalidValue: If a value is out of range.
    """
    rate, iterations = (
        scene.GetAttribute(f"newton:{name}") for name in ("timeStepsPerSecond", "maxSolverIterations")
    )
    found = NOTHING.copy()
    if is_authored(rate):
        found["dt"] = 1.0 / number(rate, time, least=1.0)
    if is_authored(iterations):
        count = int(number(iterations, time, least=-1.0))
        # -1 requests the default of the solver.
        found["iterations"] = count if count > 0 else None
    return found


def stepping_of(stage: Any) -> Stepping:
    """Returns the settings of the first PhysicsScene of a stage.

    Raises:
        InvalidValue: If a value is out of range.
    """
    from pxr import Usd, UsdPhysics

    scene = next((prim for prim in stage.Traverse() if prim.IsA(UsdPhysics.Scene)), None)
    return NOTHING if scene is None else read_stepping(scene, Usd.TimeCode.EarliestTime())


def has_gravity(scene: Any, time: Any) -> bool:
    """Returns ``newton:gravityEnabled`` of the prim of a PhysicsScene; true if not authored."""
    return bool(value_of(scene.GetAttribute("newton:gravityEnabled"), time, True))
