"""Builds a model of one environment to validate scenes and user-defined classes that only a build can check."""

import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from warpcontact import meshes
from warpcontact.building.plan import plan_model
from warpcontact.building.scene import Scene
from warpcontact.experiment.assemble import FileCache, SceneBuilder
from warpcontact.experiment.catalogue import DeviceModelSettings, user_class
from warpcontact.experiment.errors import Problems
from warpcontact.experiment.parser import ExperimentParts
from warpcontact.experiment.schema import DEVICE_MODEL_SECTIONS
from warpcontact.experiment.user_code import describe_error
from warpcontact.geometry.query_mesh import QueryMeshCache
from warpcontact.kernels import laws, shapes
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.couplings import springs
from warpcontact.kernels.joints import Motion
from warpcontact.model.environments import Environments
from warpcontact.scene.elements import ContactMaterial


def check_build(
    parts: ExperimentParts, folder: Path, file_cache: FileCache, problems: Problems
) -> Environments | None:
    """Returns a model of the valid parts of an experiment; ``None`` if it cannot be built.

    Args:
        parts: Valid parts of the experiment; entries whose user-defined class fails are removed.
        folder: Folder to which the names of mesh files are relative.
        file_cache: Meshes that were read before; new meshes and query meshes are added.
        problems: Receives the problems.
    """
    precision = parts.settings.precision if parts.settings else "float32"
    file_cache.query_meshes = {}  # those of an earlier validation may belong to other surfaces
    scene = SceneBuilder(parts, folder, file_cache).scene(problems)
    model, error = _try_build(scene, precision, file_cache.query_meshes)
    # Classes in the model are valid. Others, or all of them if the build failed, are tested one by one.
    working = set() if model is None else _classes(scene)
    faults = 0
    for section, i, key, formula in list(_user_formulas(parts)):
        fault = None if type(formula) in working else _find_fault(key, formula, precision)
        if fault is not None:
            problems.add(f"{section}[{i}].{key}", f": {fault}")
            parts.entries[section].pop(i, None)
            faults += 1
    if faults and model is None:
        # Build again without them to find other problems; those of the entries are already reported.
        scene = SceneBuilder(parts, folder, file_cache).scene(Problems())
        model, error = _try_build(scene, precision, file_cache.query_meshes)
    if isinstance(error, ValueError):
        message = str(error)
        paths = {entry.name: path for _, path, entry in parts}
        name = message.partition(":")[0]
        problems.add(paths.get(name, "scene"), f": {message.removeprefix(name + ': ')}")
    elif error is not None:
        raise error
    return model


def _try_build(
    scene: Scene, precision: str, known: QueryMeshCache | None = None
) -> tuple[Environments | None, Exception | None]:
    """Returns a model of one environment, or the error; query meshes are stored in ``known``."""
    if not scene.bodies:
        return None, None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the model of the run gives the warnings
            return plan_model(scene, "cpu", precision, known).build(1), None
    except Exception as error:
        return None, error


def _classes(scene: Scene) -> set[type[Formula]]:
    """Returns the classes of all laws, friction models, springs, shapes and joints in ``scene``."""
    formulas = [f for one in scene.elements() for f in getattr(one, "formulas", {}).values()]
    kinds = {kind for contact in scene.shape_contacts for kind in contact.kinds}
    return kinds | {type(formula) for formula in (*formulas, *(body.motion for body in scene.bodies))}


def _user_formulas(parts: ExperimentParts) -> Iterator[tuple[str, int, str, Formula]]:
    """Iterates over instances of user-defined classes: section, number of the entry, key, instance."""
    for section in DEVICE_MODEL_SECTIONS:
        for i, entry in parts.entries[section].items():
            for key, table in entry:
                if isinstance(table, DeviceModelSettings) and user_class(table.type)[0]:
                    yield section, i, key, table.make()


def _find_fault(key: str, formula: Formula, precision: str) -> str | None:
    """Returns why ``formula``, as ``key`` of its table, cannot be evaluated or compiled; ``None``: it can."""
    cls = type(formula)
    if isinstance(formula, Motion):
        scene = Scene()
        scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), motion=formula)
        _, failure = _try_build(scene, precision)
        return None if failure is None else _failure_text(failure, cls)
    if isinstance(formula, shapes.Shape):
        scene = Scene()
        ball = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0))
        both = scene.add_shape(ball, shapes.Sphere(1.0)), scene.add_shape(None, formula)
        scene.add_shape_contact(*both, ContactMaterial(law=laws.Hooke(stiffness=1.0)))
        _, failure = _try_build(scene, precision)
        return None if failure is None else _failure_text(failure, cls)
    values = {name: np.full((1, 1), value) for name, value in formula.parameters(area=1.0).items()}
    if along := isinstance(formula, springs.Spring | springs.Damper):
        values["rest_length"] = np.ones((1, 1))
    try:
        missing = set(cls.device_names()) - set(formula.coefficients(values))
    except Exception as error:
        return describe_error(error, cls)
    if missing:
        return f"{cls.__name__}.coefficients must return {', '.join(cls.device_names())}, got no {min(missing)}"
    scene = Scene()
    ball = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), position=(0.0, 0.0, 1.0))
    if along:
        ends = (scene.add_point(None, (0.0, 0.0, 0.0)), scene.add_point(ball, (0.0, 0.0, 0.0)))
        scene.add_spring_damper(*ends, **{"spring": springs.Linear(stiffness=1.0), key: formula})
    else:
        try:
            material = ContactMaterial(**{"law": laws.Hooke(stiffness=1.0), key: formula})
        except ValueError as error:
            return str(error)
        # A set of points, because it has areas, which a law may require.
        points = scene.add_points(ball, [(0.0, 0.0, 0.0)], areas=[1.0])
        scene.add_contact(points, scene.add_surface(meshes.grid()), material, radius=0.1)
    _, failure = _try_build(scene, precision)
    if failure is None:
        return None
    text = _failure_text(failure, cls)
    if key in ("law", "spring"):
        return text
    helper = "spring Linear" if along else "law Hooke"
    return re.sub(rf"^{helper} with |^In the {helper.partition(' ')[0]}, .*\n", "", text, flags=re.MULTILINE)


def _failure_text(failure: Exception, cls: type[Formula]) -> str:
    """Returns the reason, as text, why a model with an object of class ``cls`` could not be built."""
    # The message of a compile error is complete; only the generated module name is removed.
    if isinstance(failure, TypeError):
        return str(failure).replace(f"{cls.__module__}.", "")
    return describe_error(failure, cls)
