"""A model of one environment, built to look at: what only building tells of a scene and of a user's classes."""

import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from warpcontact import meshes
from warpcontact.environments import Environments
from warpcontact.experiment.assemble import Assembler, Loaded
from warpcontact.experiment.catalogue import FormulaSettings, own_class
from warpcontact.experiment.errors import Problems
from warpcontact.experiment.own import blame
from warpcontact.experiment.reading import Parts
from warpcontact.experiment.schema import WITH_FORMULAS
from warpcontact.kernels.formula import Formula
from warpcontact.kernels.laws import Hooke
from warpcontact.scene import Scene, Template


def trial(parts: Parts, folder: Path, loaded: Loaded, problems: Problems) -> Environments | None:
    """Returns a model of what is sound; ``None`` if there is none.

    Args:
        parts: What there is; what has a class that does not work is taken out.
        folder: Folder to which the names of mesh files are relative.
        loaded: Meshes that were read before; filled.
        problems: Receives what is wrong.
    """
    precision = parts.settings.precision if parts.settings else "float32"
    scene = Assembler(parts, folder, loaded).scene(problems)
    model, error = _built(scene, precision)
    # What the model contains works. The rest, or everything if there is none, is tried piece by piece.
    working = set() if model is None else {type(f) for c in scene.contacts for f in vars(c.template).values()}
    faults = 0
    for section, i, key, formula in list(_own_formulas(parts)):
        fault = None if type(formula) in working else _fault(key, formula, precision)
        if fault is not None:
            problems.add(f"{section}[{i}].{key}", f": {fault}")
            parts.entries[section].pop(i, None)
            faults += 1
    if faults and model is None:
        # Once more without them, so that the other problems are found, too; those of the parts are known.
        model, error = _built(Assembler(parts, folder, loaded).scene(Problems()), precision)
    if isinstance(error, ValueError):
        message = str(error)
        paths = {entry.name: path for _, path, entry in parts}
        name = message.partition(":")[0]
        problems.add(paths.get(name, "scene"), f": {message.removeprefix(name + ': ')}")
    elif error is not None:
        raise error
    return model


def _built(scene: Scene, precision: str) -> tuple[Environments | None, Exception | None]:
    """Returns a model of one environment, or why there is none."""
    if not scene.bodies:
        return None, None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the model that runs warns again
            return scene.build(1, "cpu", precision), None
    except Exception as error:
        return None, error


def _own_formulas(parts: Parts) -> Iterator[tuple[str, int, str, Formula]]:
    """Iterates over the formulas that are not of the library: section, number in it, key, formula."""
    for section in WITH_FORMULAS:
        for i, entry in parts.entries[section].items():
            for key, table in entry:
                if isinstance(table, FormulaSettings) and own_class(table.type)[0]:
                    yield section, i, key, table.make()


def _fault(key: str, formula: Formula, precision: str) -> str | None:
    """Returns why ``formula``, as ``key`` of a template, cannot be computed or compiled; ``None`` if it can."""
    cls = type(formula)
    values = {name: np.full((1, 1), value) for name, value in formula.parameters(area=1.0).items()}
    try:
        missing = set(cls.device_names()) - set(cls.coefficients(values))
    except Exception as error:
        return blame(error, cls)
    if missing:
        return f"{cls.__name__}.coefficients must return {', '.join(cls.device_names())}, got no {min(missing)}"
    scene = Scene()
    ground = scene.add_surface(meshes.grid())
    ball = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), position=(0.0, 0.0, 1.0))
    try:
        template = Template(**{"law": Hooke(stiffness=1.0), key: formula})
    except ValueError as error:
        return str(error)
    # A set, because it has areas for a formula that asks for them.
    scene.add_contact(scene.add_points(ball, [(0.0, 0.0, 0.0)], areas=[1.0]), ground, template, radius=0.1)
    _, failure = _built(scene, precision)
    if failure is None:
        return None
    # That a formula does not compile is said in full by what compiles it, in names of modules that nobody knows.
    if isinstance(failure, TypeError):
        text = str(failure).replace(f"{cls.__module__}.", "")
        return (
            text if key == "law" else re.sub(r"^law Hooke with |^In the law, .*\n", "", text, flags=re.MULTILINE)
        )
    return blame(failure, cls)
