"""Unknown keywords: the message names the callable, its arguments, and the closest one."""

import inspect
from typing import Self

import numpy as np
import pytest
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.keywords import explain_keywords, keywords_of
from warpcontact.kernels.catalogue.names import closest, stored_name

import warpcontact as wc
from warpcontact.scene.elements import ContactOptions
from warpcontact.validation import checks

MODULES = (
    "compare",
    "friction",
    "integrators",
    "laws",
    "meshes",
    "motions",
    "outcomes",
    "shapes",
    "springs",
)
# Types that only the package instantiates; exceptions, enumerations and modules.
MADE_HERE = (
    *("BenchReport", "Body", "Bushing", "Catenary", "Contact", "ContactCoupling", "Health", "MeshReport", "Model"),
    *(
        "Points",
        "Recording",
        "Run",
        "Shape",
        "ShapeContact",
        "BodyContact",
        "SplitModel",
        "SpringDamper",
        "Surface",
    ),
    *("Component", "Integrator", "RepairStep", "SurfaceSamples", "check_path"),
    *("Assembly", "Diagnosis", "Equilibrium", "Event", "EventRun", "Solution"),
)


def public():
    """Returns the public functions, classes and methods by name."""
    homes = [wc, wc.unilateral, *(getattr(wc, name) for name in MODULES)]
    found = {}
    for home in homes:
        for name in home.__all__:
            value = getattr(home, name)
            skip = inspect.ismodule(value) or not callable(value) or name in MADE_HERE
            if not skip and not (inspect.isclass(value) and issubclass(value, BaseException | int | str)):
                found[f"{home.__name__}.{name}"] = value
    for kind in (wc.Scene, wc.Simulation, wc.SplitModel, wc.Experiment, wc.Run, wc.Mesh):
        for name, value in inspect.getmembers(kind, callable):
            if not name.startswith("_") and any(name in vars(base) for base in kind.__mro__[:-1]):
                found[f"{kind.__name__}.{name}"] = value
    # Its keywords are those of the given class; ``test_force_element.py`` tests their errors.
    del found["Scene.add_force_element"]
    formulas = [kind for kind in found.values() if inspect.isclass(kind) and issubclass(kind, Formula)]
    for kind in formulas:
        for name in dir(kind):
            if makes_one(kind, name):
                found[f"{kind.__name__}.{name}"] = getattr(kind, name)
    return found


def makes_one(kind, name):
    """Whether a public class method of ``kind`` returns an instance, for arguments made from its signature."""
    if name.startswith("_") or not isinstance(inspect.getattr_static(kind, name), classmethod):
        return False
    signature = inspect.signature(getattr(kind, name))
    others = any(one.kind is inspect.Parameter.VAR_KEYWORD for one in signature.parameters.values())
    return not others and signature.return_annotation in (Self, kind, kind.__name__)


def message(function, *args, **keywords):
    with pytest.raises(TypeError) as caught:
        function(*args, **keywords)
    return str(caught.value)


def test_unknown_keyword_of_every_public_callable_is_explained():
    every = public()
    assert len(every) > 200
    assert {"CundallStrack.from_overshoot", "Mindlin.from_overshoot", "Hertz.elliptic"} <= every.keys()
    wrong = {}
    for name, function in every.items():
        known = ", ".join(keywords_of(function)) or "none"
        of_object = "self" in inspect.signature(function).parameters and not inspect.isclass(function)
        try:
            text = message(function, *[None] * of_object, there_is_no_such_keyword=1)
        except Exception as error:
            text = repr(error)
        expected_start = f"{name.rpartition('.')[2]}() got an unexpected keyword argument 'there_is_no"
        if expected_start not in text or not text.endswith(f" takes {known}"):
            wrong[name] = text
    assert not wrong


PROPOSALS = [
    (lambda: wc.laws.HuntCrossley(k=1e5), "HuntCrossley", "stiffness"),
    (lambda: wc.laws.HuntCrossley(stifness=1e5), "HuntCrossley", "stiffness"),
    (lambda: wc.laws.HuntCrossley(stiffness=1e5, cor=0.5), "HuntCrossley", "restitution"),
    (lambda: wc.laws.HuntCrossley(stiffness=1e5, dissipation=0.5), "HuntCrossley", "damping"),
    (lambda: wc.laws.KelvinVoigt(stiffness=1e5, c=10.0), "KelvinVoigt", "damping"),
    (lambda: wc.laws.HertzElastic(E=1e9), "HertzElastic", "modulus"),
    (lambda: wc.laws.HertzElastic.from_materials(1e9, 0.3, e=0.5), "HertzElastic.from_materials", "restitution"),
    (lambda: wc.laws.Hertz.from_materials(youngs_modulus=1e9), "Hertz.from_materials", "E"),
    (lambda: wc.springs.StiffnessTable.of(np.abs, [0, 1], skale=2.0), "StiffnessTable.of", "scale"),
    (lambda: wc.friction.Tanh(mu_s=0.3), "Tanh", "mu"),
    (lambda: wc.friction.CundallStrack(mu_s=0.3, kt=1e4), "CundallStrack", "mu_static' and 'stiffness"),
    (lambda: wc.ContactMaterial(stiffness=1e5, mu=0.3), "ContactMaterial", "law' and 'friction"),
    (
        lambda: wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0), rolling_friction=None),
        "ContactMaterial",
        "rolling",
    ),
    (lambda: wc.motions.Hinge(axs=(0, 0, 1)), "Hinge", "axis"),
    (lambda: wc.shapes.Sphere(r=1.0), "Sphere", "radius"),
    (lambda: wc.integrators.MoreauJean(tol=1e-6), "MoreauJean", "tolerance"),
    (lambda: wc.ContactRange(k1=1.0, efective_range=1.0), "ContactRange", "effective_range"),
    (lambda: wc.outcomes.Max("touch.gap", abov=1.0), "Max", "above"),
    (lambda: wc.StopCondition("touch.gap", belw=0.0), "StopCondition", "below"),
    (lambda: wc.Simulation(None, timestep=1e-3), "Simulation", "dt"),
    (lambda: wc.Scene(g=(0, 0, -9.81)), "Scene", "gravity"),
    (lambda: wc.Scene().add_body(m=1.0, quat=(0, 0, 0, 1)), "Scene.add_body", "mass' and 'orientation"),
    (lambda: wc.Scene().add_body(mass=1.0, velocity=(0, 0, 1)), "Scene.add_body", "linear_velocity"),
    (lambda: wc.Scene().add_body(mass=1.0, omega=(0, 0, 1)), "Scene.add_body", "angular_velocity"),
    (lambda: wc.Scene().add_surface(None, pos=(0, 0, 1)), "Scene.add_surface", "position"),
    (lambda: wc.Scene().add_contact(None, None, contact_material=None), "Scene.add_contact", "material"),
    (
        lambda: wc.Scene().add_surface_contact(None, None, None, friction=0.3),
        "Scene.add_surface_contact",
        "material",
    ),
    (lambda: wc.Scene().add_surface_contact(None, None, None, kapa=0.3), "Scene.add_surface_contact", "kappa"),
    (lambda: wc.Scene().add_spring_damper(None, None, k=1.0), "Scene.add_spring_damper", "stiffness"),
    (lambda: wc.Scene().build(num_envs=4), "Scene.build", "envs"),
    (lambda: wc.load_mesh("part.stl", inch=True), "load_mesh", "unit"),
    (lambda: wc.meshes.grid(sise=(1, 1)), "grid", "size"),
    (lambda: wc.render(None, sise=(1, 1)), "render", "size"),
    (lambda: wc.export_usd(None, "a.usda", colour_by="x"), "export_usd", "color_by"),
    (lambda: wc.Experiment.from_toml("a.toml", change=()), "Experiment.from_toml", "changes"),
    (lambda: wc.parameter("N/m", "k", abve=0.0), "parameter", "above"),
]


@pytest.mark.parametrize(("call", "called", "meant"), PROPOSALS, ids=[f"{c}-{m}" for _, c, m in PROPOSALS])
def test_unknown_keyword_suggests_the_name_of_this_library(call, called, meant):
    text = message(call)
    assert text.startswith(f"{called}() got ")
    assert f"; did you mean '{meant}'? It takes " in text


def test_unknown_keyword_without_a_close_one_lists_the_arguments():
    with pytest.raises(TypeError) as caught:
        wc.friction.Tanh(mu=0.3, quux=1)
    assert str(caught.value) == ("Tanh() got an unexpected keyword argument 'quux'; it takes mu, velocity_scale")


def test_decorated_functions_keep_signature_name_and_documentation():
    def plain(a: float, *, b: int = 2) -> str:
        """Returns both as text."""
        return f"{a} {b}"

    decorated = explain_keywords(plain)
    assert inspect.signature(decorated) == inspect.signature(plain)
    assert (decorated.__name__, decorated.__doc__) == (plain.__name__, plain.__doc__)
    assert decorated(1.0, b=3) == "1.0 3"
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'a'"):
        decorated(b=3)
    parameters = inspect.signature(wc.laws.HuntCrossley).parameters
    assert list(parameters)[:2] == ["stiffness", "exponent"]


def test_surface_contact_accepts_the_options_of_a_contact():
    own = {"points", "surface", "material", "name"}
    assert set(ContactOptions.__annotations__) == set(keywords_of(wc.Scene.add_contact)) - own


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (
            lambda: wc.Scene().add_body(mass=1),
            "Scene.add_body() missing 1 required positional argument: 'inertia'",
        ),
        (
            wc.friction.Tanh,
            "Tanh() missing 1 required keyword-only argument: 'mu'",
        ),
        (lambda: wc.Scene().add_body(*range(9)), "Scene.add_body() takes from 3 to 7 positional arguments but 10"),
    ],
)
def test_wrong_number_of_arguments_names_the_called_class(call, expected):
    with pytest.raises(TypeError) as caught:
        call()
    assert str(caught.value).startswith(expected)


def test_type_error_inside_a_function_is_unchanged():
    scene = wc.Scene()
    point = scene.add_point(scene.add_body(1.0, (1.0, 1.0, 1.0)), (0, 0, 0))
    with pytest.raises(TypeError, match=r"^material of 'contact' must be a wc\.ContactMaterial, got None$"):
        scene.add_contact(point, scene.add_surface(wc.meshes.grid()), material=None)


def test_unknown_units_and_modules_get_a_suggestion():
    with pytest.raises(ValueError, match=r"unit must be one of m, .*, got 'inch'; did you mean 'in'\?"):
        wc.load_mesh("part.stl", unit="inch")
    with pytest.raises(
        ValueError, match=r"search must be one of 'whole', 'active', got 'activ'; did you mean 'active'\?"
    ):
        checks.choice("search", "activ", ("whole", "active"))
    with pytest.raises(AttributeError, match=r"has no attribute 'HuntCrosley'; did you mean 'HuntCrossley'\?"):
        _ = wc.laws.HuntCrosley
    with pytest.raises(AttributeError, match=r"has no attribute 'Scenes'; did you mean 'Scene'\?"):
        _ = wc.Scenes


WORDS = [
    ("ball.velocity", ["ball.linear_velocity", "ball.position", "cube.angular_velocity"], "ball.linear_velocity"),
    ("touch.delta_dot", ["touch.status", "touch.approach_speed"], "touch.approach_speed"),
    ("touch.gapp", ["touch.gap", "other.gap"], "touch.gap"),
    # A common element name is not a similarity.
    ("touch.zzz", ["touch.gap", "touch.torque"], None),
    ("tuch.k", ["touch.law.stiffness", "ball.mass"], "touch.law.stiffness"),
    ("Mass", ["mass"], "mass"),
    ("e", ["E", "restitution"], "restitution"),
    ("E", ["modulus", "restitution"], "modulus"),
    ("omega", ["mass", "angular_velocity"], "angular_velocity"),
    ("solref", ["law", "friction"], "law"),
    ("quux", ["mass"], None),
    ("anything", [], None),
]


@pytest.mark.parametrize(("word", "known", "meant"), WORDS, ids=[word for word, _, _ in WORDS])
def test_closest_name_is_similar_or_a_synonym(word, known, meant):
    assert closest(word, known) == meant


def test_stored_names_differ_for_aliases_of_sensors_only():
    assert stored_name("touch.delta") == "touch.penetration"
    assert [stored_name(name) for name in ("touch.gap", "touch.law.delta", "delta", "")] == [
        *("touch.gap", "touch.law.delta", "delta", ""),
    ]
