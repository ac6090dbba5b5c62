"""Classes of force elements that the scene, files, parameters or kernels could not read are refused with the reason."""

import dataclasses
import re
import sys
import textwrap
from types import ModuleType
from typing import ClassVar

import numpy as np
import pytest
import warp as wp
from magnet import Magnet, Magnets, MagnetSet

import warpcontact as wc
from warpcontact.forces import registry
from warpcontact.forces.couplings.point_pair_set import PointPairSet
from warpcontact.scene.elements import Body, Points
from warpcontact.scene.scene_element import PointPair, SceneElement

HEADER = """
import dataclasses
from typing import Annotated, Any, ClassVar, Final, Optional

import numpy as np

import warpcontact as wc
from warpcontact.scene.elements import Body, Points, Surface
from warpcontact.scene.scene_element import PointPair, SceneElement
from warpcontact.scene.shapes import Shape

class Scaled(PointPair):
    scale: float = wc.parameter("-", "factor", default=1.0)
"""


@pytest.fixture(autouse=True)
def magnet_only(monkeypatch):
    """Registers only the magnet during a test."""
    monkeypatch.setattr(registry, "_REGISTERED", {Magnet: registry._REGISTERED[Magnet]})


@pytest.fixture
def module(monkeypatch):
    """Returns a function that executes code as a module and returns the module."""

    def execute(name, code, future=False):
        made = ModuleType(name)
        monkeypatch.setitem(sys.modules, name, made)
        header = "from __future__ import annotations\n" * future
        exec(compile(header + HEADER + textwrap.dedent(code), name, "exec", dont_inherit=True), vars(made))
        return made

    return execute


NUMBER = 'wc.parameter("N", "force"'


@pytest.mark.parametrize("future", [False, True], ids=["evaluated", "strings"])
@pytest.mark.parametrize(
    ("body", "message"),
    [
        # Names of fields.
        (
            "check: bool = True",
            "Rod.check must have another name: PointPair has an attribute or method check. Other",
        ),
        (
            "check: bool",
            "must not have: arguments, bodies, checked, is_optional, kind_of, parameters, prefix,",
        ),
        ("bodies: Body", "Rod.bodies must have another name: PointPair has"),
        (f"parameters: float = {NUMBER})", "Rod.parameters must have another name: SceneElement has"),
        ("recorded: tuple[str, ...] = ('force',)", "Rod.recorded must have another name: SceneElement has"),
        ("type: Points", "Rod.type must have another name; reserved in files: type, kind"),
        ("kind: bool = True", "Rod.kind must have another name; reserved in files: type, kind"),
        ("switch: bool = True", "Rod.switch must have another name: switch is a keyword of C++"),
        ("_x: bool = True", "Rod._x must have another name: ASCII letters, digits and _, starting with a letter"),
        ("höhe: bool = True", "Rod.höhe must have another name: ASCII letters"),
        # Annotations.
        (
            "x: list[Points]",
            "Rod.x must not have the annotation list[warpcontact.scene.elements.Points]; allowed are",
        ),
        ("x: type[Points]", "Rod.x must not have the annotation type["),
        ("x: Body | Surface", "bool, Body, Surface, Points, Shape, and one of these elements with | None"),
        ("x: Body | Surface | None", "Rod.x must not have the annotation"),
        ("x: bool | None = None", "Rod.x must not have the annotation bool | None"),
        ("x: Any", "Rod.x must not have the annotation Any"),
        ("x: None = None", "Rod.x must not have the annotation NoneType"),
        ("x: str = 'steel'", "Rod.x must not have the annotation str"),
        ("x: 'Pionts'", "cannot be resolved: name 'Pionts' is not defined. Define or import its names at the top"),
        ("x: dataclasses.InitVar[bool]", "Rod.x must not be an InitVar; allowed are"),
        ("x: float = 1.0", "Rod.x must be declared with wc.parameter: x: float = wc.parameter(unit, meaning)"),
        (f"x: {NUMBER})", "Rod.x must be declared as x: float = wc.parameter"),
        (f"x = {NUMBER})", "Rod.x must have an annotation: x: float = wc.parameter"),
        # Types and shapes of numbers.
        (f"x: bool = {NUMBER})", "Rod.x must be annotated with float, as a wc.parameter of shape (), got bool"),
        (f"x: int = {NUMBER})", "Rod.x must be annotated with float, as a wc.parameter of shape (), got int"),
        (f"x: float | None = {NUMBER})", "Rod.x must be annotated with float, as a wc.parameter of shape (), got"),
        (f"x: list[float] = {NUMBER}, shape=(3,))", "with tuple[float, float, float] or tuple[float, ...], as a"),
        (f"x: tuple[float, float] = {NUMBER}, shape=(2,))", "one of the shapes (), (3,), (4,), got (2,)"),
        (f"x: tuple[float, ...] = {NUMBER}, shape=(3, 3))", "one of the shapes (), (3,), (4,), got (3, 3)"),
        (f"x: tuple[float, ...] = {NUMBER}, shape=3)", "Rod.x must have one of the shapes (), (3,), (4,), got 3"),
        (f"x: tuple[float, ...] = {NUMBER}, shape=[3])", "one of the shapes (), (3,), (4,), got [3]"),
        (f"x: float = {NUMBER}, direction=True)", "Rod.x must have the shape (3,), as a direction, got ()"),
        # Defaults.
        (f"x: float = {NUMBER}, default=None)", "Rod.x must have a number as default, or none at all, got"),
        (f"x: float = {NUMBER}, default='a')", "default of Rod.x must be a number, got 'a'"),
        (f"x: float = {NUMBER}, default=-1, at_least=0.0)", "default of Rod.x must be at least 0, got -1 N"),
        (f"x: tuple[float, ...] = {NUMBER}, shape=(3,), default=(1.0,))", "default of Rod.x must be 3 numbers"),
        (f"x: tuple[float, ...] = {NUMBER}, shape=(3,), default=[1.0] * 3)", "default of Rod.x must be immutable"),
        (
            f"x: tuple[float, ...] = {NUMBER}, shape=(3,), direction=True, default=(0.0, 0.0, 0.0))",
            "default of Rod.x must be a direction, got [0.0, 0.0, 0.0]",
        ),
        ("x: bool = 1", "default of Rod.x must be True or False, got 1"),
        ("x: bool = None", "default of Rod.x must be True or False, got None"),
        ("x: Points = None", "default of Rod.x must be omitted, or the annotation Points | None, got None"),
        ("x: Points | None = 'pole'", "default of Rod.x must be None, got 'pole'"),
        ("x: list = []", "Rod: mutable default <class 'list'> for field x is not allowed; allowed are"),
        ("x: bool = dataclasses.field(default_factory=bool)", "Rod.x must not have a default_factory"),
        ("x: bool = dataclasses.field(default=True, init=False)", "Rod.x must not have init=False"),
        # Attributes and methods with the name of a field, or of the base class.
        (
            "scale = 2.0",
            "Rod.scale must have another name, or be a field with an annotation: scale is an argument",
        ),
        ("def scale(self): ...", "Rod.scale must have another name, or be a field with an annotation"),
        ("x: bool\n    x = property(bool)", "default of Rod.x must be True or False, got <property"),
        ("point_a = None", "Rod.point_a must have another name, or be a field with an annotation"),
        ("point_a: Body", "Rod.point_a must be declared as in PointPair, point_a: Points, or not at all"),
        ("point_a: Points | None = None", "Rod.point_a must be declared as in PointPair, point_a: Points, or"),
        ("point_a: ClassVar[Points]", "Rod.point_a must not be a ClassVar: it is an argument of PointPair"),
        ("name: str = 'rod'", "Rod.name must be declared as in SceneElement, name: str, or not at all"),
        ("name = 'rod'", "Rod.name must have another name, or be a field with an annotation"),
        ("recorded = 'force'", "Rod.recorded must be a tuple, as that of SceneElement, or have another name, got"),
        ("check: ClassVar[bool] = True", "Rod.check must be a method, as that of PointPair"),
        ("def parameters(self): ...", "Rod.parameters must be a class method, as that of SceneElement"),
        ("bodies = ()", "Rod.bodies must be a property, as that of PointPair"),
        ("def __init__(self, name): ...", "Rod must not define __init__"),
    ],
)
def test_class_with_invalid_declaration_is_refused(body, message, future, module):
    with pytest.raises((TypeError, ValueError), match=re.escape(message)):
        module("rods", f"class Rod(Scaled):\n    {body}", future)


@pytest.mark.parametrize("future", [False, True], ids=["evaluated", "strings"])
@pytest.mark.parametrize(
    ("body", "kind", "optional"),
    [
        ("x: Points", Points, False),
        ("x: Body | None", Body, True),
        ("x: None | Body = None", Body, True),
        ("x: Optional[Body] = None", Body, True),
        ("x: Optional['Body'] = None", Body, True),
        ("x: 'Body | None' = None", Body, True),
        ("x: Annotated[Points, 'a pole']", Points, False),
        ("x: bool", bool, False),
        ("x: bool = dataclasses.field(default=True)", bool, False),
        (f"x: Annotated[float, 'load'] = {NUMBER})", float, False),
        (f"x: tuple[float, ...] = {NUMBER}, shape=(4,))", tuple[float, ...], False),
        (f"x: tuple[float, float, float] = {NUMBER}, shape=(3,))", tuple[float, float, float], False),
        (f"x: float = {NUMBER})\n    limits: ClassVar[dict] = {{}}", float, False),
        (f"x: float = {NUMBER})\n    scale: float = wc.parameter('-', 'factor', default=2.0)", float, False),
        (f"x: float = {NUMBER})\n    point_a: Points\n    recorded = ('force_a',)", float, False),
    ],
)
def test_class_with_valid_declaration_has_its_arguments(body, kind, optional, future, module):
    rod = module("rods", f"class Rod(Scaled):\n    {body}", future).Rod
    fields = {field.name: field for field in rod.arguments()}
    assert list(fields) == ["point_a", "point_b", "scale", "x"]
    assert (rod.kind_of(fields["x"]), rod.is_optional("x")) == (kind, optional)


def test_parameters_of_a_base_that_is_no_element_are_refused():
    class Mixin:
        load: float = wc.parameter("N", "load")

    with pytest.raises(TypeError, match="Mixin, a base class of Rod, must be derived from SceneElement"):

        class Rod(Mixin, PointPair):
            """A rod."""


def test_class_name_with_other_letters_is_refused():
    with pytest.raises(TypeError, match="the name of class Höhe must have ASCII letters only"):
        type("Höhe", (PointPair,), {})


@pytest.mark.parametrize(
    ("kind", "declare", "message"),
    [
        (PointPair, MagnetSet.declare, "kind must be a class derived from SceneElement or PointPair, got <class"),
        (SceneElement, MagnetSet.declare, "kind must be a class derived from SceneElement or PointPair"),
        (MagnetSet, MagnetSet.declare, "kind must be a class derived from SceneElement or PointPair"),
        ("Magnet", MagnetSet.declare, "kind must be a class derived from SceneElement or PointPair, got 'Magnet'"),
        (Magnet, None, "declare must be a function of a BuildContext and the elements, got None"),
    ],
)
def test_register_refuses_other_objects(kind, declare, message):
    with pytest.raises(TypeError, match=re.escape(message)):
        registry.register(kind, declare)
    assert list(registry.element_kinds().values()) == [Magnet]


def test_second_class_of_a_name_is_refused(module):
    other = module("other_magnets", "class Magnet(PointPair): ...").Magnet
    with pytest.raises(
        ValueError,
        match=r"Magnet must have another name: other_magnets\.Magnet cannot be registered, because magnet\.Magnet is",
    ):
        registry.register(other, MagnetSet.declare)
    nested = module("magnet", "class Coils:\n    class Magnet(PointPair): ...").Coils.Magnet
    with pytest.raises(ValueError, match=r"Magnet must have another name: magnet\.Coils\.Magnet cannot be"):
        registry.register(nested, MagnetSet.declare)
    assert registry.element_kinds() == {"Magnet": Magnet}


def test_module_that_is_executed_again_replaces_its_class(module):
    first, second = (module("coils", "class Coil(PointPair): ...").Coil for _ in range(2))
    for kind in (first, second):
        registry.register(kind, MagnetSet.declare)
        assert registry.element_kinds()["Coil"] is kind
    registry.register(first, MagnetSet.declare)
    assert registry.element_kinds()["Coil"] is first
    assert registry.is_registered(second)


def test_classes_of_files_are_found_by_file_only(module):
    files = [module(f"{registry.FILE_MODULE}{i}_magnet", "class Magnet(PointPair): ...").Magnet for i in range(2)]
    for kind in files:
        registry.register(kind, MagnetSet.declare)
    assert all(map(registry.is_registered, files))
    assert registry.element_kinds() == {"Magnet": Magnet}


def two_points(scene):
    ball = scene.add_body(1.0, (1.0, 1.0, 1.0), position=(0.0, 0.0, 1.0), name="ball")
    return {
        "point_a": scene.add_point(None, (0.0, 0.0, 0.0), name="base"),
        "point_b": scene.add_point(ball, (0.0, 0.0, 0.0), name="pole"),
    }


@pytest.mark.parametrize("kind", [PointPair, SceneElement, Magnet.__mro__[-1]])
def test_elements_of_a_base_class_are_refused(kind):
    with pytest.raises(TypeError, match="kind must be a class derived from SceneElement or PointPair"):
        wc.Scene().add_force_element(kind)


class Rod(PointPair):
    """An element with all kinds of arguments."""

    axis: tuple[float, ...] = wc.parameter("-", "axis", shape=(3,), direction=True)
    stiffness: tuple[float, ...] = wc.parameter("N/m", "stiffness", shape=(4,), default=(1.0, 2.0, 3.0, 4.0))
    active: bool = True
    carrier: Body | None


class RodSet(PointPairSet):
    """Device data of rods, without forces."""

    family, kind, struct, transient = "rods", Rod, Magnets, ("force",)
    quantities: ClassVar = {"force": ("force", "N", "attraction")}


def rod_scene(**arguments):
    registry.register(Rod, RodSet.declare)
    scene = wc.Scene()
    scene.add_force_element(Rod, **two_points(scene), name="rod", **arguments)
    return scene


def test_omitted_element_is_the_world():
    (rod,) = rod_scene(axis=(0.0, 3.0, 4.0)).force_elements
    assert rod.carrier is None
    with pytest.raises(ValueError, match=r"rod\.axis must be a direction, got \[0\.0, 0\.0, 0\.0\]"):
        rod_scene(axis=(0.0, 0.0, 0.0))


def test_directions_are_unit_vectors_on_the_device(device):
    model = rod_scene(axis=(0.0, 3.0, 4.0)).build(2, device)
    (rods,) = model.of_family("rods")
    np.testing.assert_allclose(rods.settings.numpy()["axis"][0, 0], [0.0, 0.6, 0.8], rtol=1e-6)
    model["rod.axis"] = [[2.0, 0.0, 0.0], [0.0, 0.0, 5.0]]
    np.testing.assert_array_equal(rods.settings.numpy()["axis"][:, 0], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match=r"rod\.axis.* must be a direction"):
        model["rod.axis"] = (0.0, 0.0, 0.0)


def test_exported_stage_restores_all_kinds_of_arguments(tmp_path, monkeypatch):
    model = rod_scene(axis=(0.0, 3.0, 4.0), active=False).build(device="cpu")
    path = wc.export_usd(wc.Simulation(model, dt=1e-3).run(0.01), tmp_path / "rods.usda")
    monkeypatch.setattr(registry, "_REGISTERED", {})
    with pytest.raises(wc.UsdError, match=r"import the module that registers it, or pass the class: custom_types"):
        wc.Scene.from_usd(path)
    (rod,) = wc.Scene.from_usd(path, custom_types=[Rod]).force_elements
    assert (type(rod), rod.carrier, rod.active) == (Rod, None, False)
    np.testing.assert_array_equal(rod.axis, [0.0, 3.0, 4.0])
    np.testing.assert_array_equal(rod.stiffness, [1.0, 2.0, 3.0, 4.0])


@pytest.mark.parametrize("carrier", [{}, {"carrier": "ball"}])
def test_experiment_file_may_omit_an_optional_element(carrier):
    registry.register(Rod, RodSet.declare)
    rod = {"type": "Rod", "name": "rod", "point_a": "base", "point_b": "pole", "axis": [0.0, 3.0, 4.0], **carrier}
    content = {
        "duration": 0.01,
        "dt": 1e-3,
        "body": [{"name": "ball", "mass": 1.0, "inertia": [1.0, 1.0, 1.0]}],
        "point": [
            {"name": "base", "position": [0.0, 0.0, -1.0]},
            {"name": "pole", "body": "ball", "position": [0.0, 0.0, 0.0]},
        ],
        "force_element": [rod],
    }
    (element,) = wc.Experiment.from_dict(content).scene().force_elements
    assert getattr(element.carrier, "name", None) == carrier.get("carrier")


@wp.struct
class Flat:
    """A struct with an array of one dimension."""

    force: wp.array(dtype=wp.float64)


class Polar(Magnet):
    """A magnet with another parameter."""

    angle: float = wc.parameter("rad", "angle", default=0.0)


class Labelled(Magnet):
    """A magnet that records an unknown sensor."""

    recorded = ("forces",)


@pytest.mark.parametrize(
    ("change", "element", "message"),
    [
        ({"kind": Rod}, Magnet, "Set.kind must be the registered class, Magnet, or a base of it with the same"),
        ({}, Polar, "Set.kind must be the registered class, Polar, or a base of it with the same parameters, got"),
        (
            {"struct": None},
            Magnet,
            "Set.struct must be a wp.struct of arrays [env, element], wp.array2d, got None",
        ),
        ({"struct": Flat}, Magnet, "Set.struct must be a wp.struct of arrays [env, element], wp.array2d"),
        (
            {"transient": "force"},
            Magnet,
            "Set.transient must be a tuple of names of arrays of struct: force, peak",
        ),
        ({"transient": ("forces",)}, Magnet, "Set.transient must be a tuple of names of arrays of struct: force"),
        ({"quantities": {"pull": ("pull", "N", "pull")}}, Magnet, "with names of arrays of struct: force, peak"),
        ({"quantities": {"pull": "force"}}, Magnet, "Set.quantities must be a dictionary from a name to (array"),
        ({"quantities": {"force_a": ("force", "N", "pull")}}, Magnet, "without force_a and force_b, sensors that"),
        (
            {"quantities": None},
            Magnet,
            "Set.quantities must be a dictionary from a name to (array, unit, meaning)",
        ),
        ({"family": "couplings"}, Magnet, "Set.family must be a name other than joints, mesh contact, contact"),
        ({"family": "measures"}, Magnet, "Set.family must be a name other than joints, mesh contact, contact"),
        ({"family": None}, Magnet, "particle contact, measures, got None"),
        ({}, Labelled, "Labelled.recorded must be sensors: force, peak, force_a, force_b, got 'forces'"),
    ],
)
def test_device_data_with_invalid_attribute_is_refused(change, element, message, device):
    made = type("Set", (MagnetSet,), change)
    registry.register(element, made.declare)
    scene = wc.Scene()
    scene.add_force_element(element, **two_points(scene), strength=1.0)
    with pytest.raises((TypeError, ValueError), match=re.escape(message)):
        scene.build(device=device)


def test_family_that_declares_no_list_is_refused(device):
    registry.register(Magnet, lambda context, elements: None)
    scene = wc.Scene()
    scene.add_force_element(Magnet, **two_points(scene), strength=1.0)
    with pytest.raises(TypeError, match="declare of magnet must return a list of ForceElement, got None"):
        scene.build(device=device)


def test_elements_are_frozen_and_compared_by_identity():
    scene = wc.Scene()
    magnet = scene.add_force_element(Magnet, **two_points(scene), strength=1.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        magnet.strength = 2.0
    assert magnet != dataclasses.replace(magnet)
