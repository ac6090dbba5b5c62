"""Names that a user writes: earlier public names, aliases, and suggestions for unknown names.

A suggestion is a known name with similar spelling, or the name in this library for a word of other codes and
papers: ``k`` in a paper or ``ke`` in Newton is ``stiffness`` here. Every "did you mean" comes from this module.

``lazy_names`` loads attributes of a package on first use. Few classes of a catalogue are used, and Warp parses the
functions of each when it is defined. Modules for files, plots and runs are not needed for a step.
"""

import difflib
import importlib
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

C = TypeVar("C")

#: Present name by earlier name: attributes of the package, methods, keywords, tables and keys of experiment files,
#: and quantities of sensors and parameters.
RENAMED = {
    # Attributes of the package.
    "Template": "ContactMaterial",
    "frictions": "friction",
    "memory": "history",
    "SmoothContact": "ShapeContact",
    "Patch": "ParametricSurface",
    "Status": "ContactStatus",
    "LineStatus": "CatenaryStatus",
    "Cause": "FailureCause",
    "Stop": "StopCondition",
    "Events": "ContactEvents",
    "StageError": "UsdError",
    "StoreError": "RunDataError",
    "plot_frictions": "plot_friction_models",
    # Attributes and methods of objects.
    "add_smooth_contact": "add_shape_contact",
    "add_mutual_contact": "add_particle_contact",
    "smooth_contacts": "shape_contacts",
    "mutual_contacts": "particle_contacts",
    "remarks": "import_warnings",
    "reading": "sensor",
    "reading_names": "sensor_names",
    "touching": "contact_pairs",
    "line_shape": "catenary_shape",
    "line_stiffness": "catenary_stiffness",
    "advice": "check",
    "step_in_frames": "step_with_callback",
    "border_edge_count": "boundary_edge_count",
    "border_loop_count": "boundary_loop_count",
    # Keywords, and tables and keys of experiment files.
    "template": "material",
    "smooth_contact": "shape_contact",
    "mutual_contact": "particle_contact",
    "readings": "sensors",
    "rim": "boundary",
    "share": "force_scale",
    "partners": "max_neighbors",
    "own": "custom_types",
    "crossing_steps": "crossing_substeps",
    "graphs": "capture_graphs",
    # Quantities of sensors.
    "restrained": "restitution_limited",
    "friction_loss": "friction_dissipation",
    "impact_loss": "impact_dissipation",
}


def present_name(name: object, known: Iterable[str]) -> str | None:
    """Returns the present name of ``name`` if it was renamed and the present name is among ``known``.

    In a name with dots, such as a sensor, the last part is the renamed one.
    """
    owner, dot, last = str(name).rpartition(".")
    new = f"{owner}{dot}{RENAMED[last]}" if last in RENAMED else None
    return new if new in set(known) else None


def explain_renamed(kind: type[C]) -> type[C]:
    """Decorates a class: access to a renamed attribute raises an ``AttributeError`` with the present name."""

    def missing(self: Any, name: str) -> Any:
        if hasattr(type(self), name):  # a property that raised
            return object.__getattribute__(self, name)
        owner = type(self).__name__
        new = RENAMED.get(name)
        if new is None or not (new in vars(self) or hasattr(type(self), new)):
            raise AttributeError(f"{owner!r} object has no attribute {name!r}", name=name, obj=self)
        raise AttributeError(f"{owner}.{name} is now {owner}.{new}")

    kind.__getattr__ = missing  # type: ignore[attr-defined]
    return kind


def explain_renamed_in(module: str, names: Iterable[str]) -> Callable[[str], Any]:
    """Returns the ``__getattr__`` of a module for access to renamed public ``names``."""
    known = frozenset(names)

    def missing(name: str) -> Any:
        if (new := present_name(name, known)) is not None:
            raise AttributeError(f"{module}.{name} is now {module}.{new}")
        raise AttributeError(f"module {module!r} has no attribute {name!r}", name=name)

    return missing


#: Accepted aliases of sensor quantities on input. Data, files and lists of names use the name on the right.
ALIASES = {"delta": "penetration"}

# Names of this library, preferred ones first: words of papers, of MuJoCo, Drake, Newton, Chrono and Bullet.
# A word may appear in several rows; the first known name is suggested.
_WORDS = """
penetration delta max_depth: depth delta overlap indentation interpenetration deformation
gap: distance dist phi separation signed_distance clearance
approach_speed delta_dot: deltadot ddelta penetration_rate penetration_speed
approach_speed delta_dot: approach_velocity normal_velocity v_n vn
normal_force tension: force fn f_n contact_force normal_load load
friction_force: friction tangential_force shear_force force_t f_t ft
slip_speed speed: slip slip_velocity sliding_velocity sliding_speed tangential_velocity tangential_speed v_t vt
point: contact_point position pos location place
normal: contact_normal direction n
status: state contact touching active
position positions: pos xyz location place translation origin com center centre
orientation: quat quaternion rotation rot attitude q
linear_velocity displacement_rate: velocity vel v lin_vel linvel speed translational_velocity
angular_velocity angle_rate: omega w ang_vel angvel spin rotational_velocity velocity vel
kinetic_energy: energy e_kin ekin
potential_energy: energy e_pot epot
torque: moment couple
external_force: force wrench applied_force xfrc_applied
external_torque: torque moment
mass: m weight
inertia: I moi inertias moments moments_of_inertia inertia_tensor diaginertia
modulus E: E E_star young youngs_modulus elastic_modulus
shear_modulus: G
stiffness modulus k1 axial_stiffness: k kn k_n ke kp spring spring_constant contact_stiffness solref
damping restitution k2: c b d kd dn c_n chi dissipation hunt_crossley_dissipation damping_coefficient dashpot zeta
damping restitution: damping_ratio relaxation_time viscosity solref solimp
restitution damping: e cor cr coefficient_of_restitution restitution_coefficient bounce bounciness
exponent: n p power hertz_exponent
mu_static mu: mu_s mus static_friction friction_static static_friction_coefficient mu_static
mu_dynamic mu: mu_d mud mu_k muk dynamic_friction kinetic_friction sliding_friction mu
mu: friction friction_coefficient coefficient_of_friction mu_dynamic
velocity_scale speed_static transition_speed: v_s vs v_d vd eps_v v_eps slip_tolerance stiction_tolerance
velocity_scale speed_static transition_speed: regularization_speed regularization_velocity slip_scale
stribeck_speed: v_s vs v_st stribeck_velocity
viscosity: viscous viscous_friction f_v fv sigma_2
stiffness: kt k_t kf ks tangential_stiffness shear_stiffness sigma_0
damping: ct c_t tangential_damping sigma_1
law: normal_law contact_law solref solimp stiffness damping restitution
friction: friction_model mu mu_s mu_d friction_coefficient
rolling: rolling_friction rolling_resistance mu_r
torsion: torsional_friction spinning_friction spin_friction drilling_friction
material: contact_material law friction rolling torsion mu stiffness damping restitution
radius: r rc sphere_radius
rest_length length: l l0 natural_length free_length initial_length rest
length: l l0 total_length
area: a
search_radius: cutoff search_distance max_distance
boundary: boundary edge edges rim
gravity: g
name: label id key title
color: colour rgb rgba
active_faces: faces groups group
mesh: geometry geom file path
dt: timestep time_step step_size stepsize step h delta_t
duration: time t t_end tend end_time total_time simulation_time
every: interval record_every sample_interval output_interval
record sensors: sensors outputs quantities names
integrator: solver method scheme
envs: num_envs n_envs nenvs n_env num_worlds nworld world_count worlds environments batch batch_size replicas n
precision: dtype real float64 double
device: cuda gpu
threads: num_threads n_threads nthreads nthread workers jobs n_jobs
seed: random_state random_seed rng
unit: units length_unit inch inches in mm cm meter meters
scale: scaling factor size
path: file filename file_name out output
tolerance: tol eps epsilon rtol
iterations: max_iterations max_iter maxiter n_iter
length: norm magnitude
pow: power
abs: fabs absolute
max: maximum fmax
min: minimum fmin
clamp: clip
acos: arccos
asin: arcsin
atan: arctan
atan2: arctan2
in: inch inches
ft: foot feet
m: meter meters metre metres
mm: millimeter millimeters millimetre millimetres
cm: centimeter centimeters centimetre centimetres
um: micron microns micrometer micrometers micrometre micrometres
"""
_GROUPS = [tuple(part.split() for part in line.split(":")) for line in _WORDS.strip().splitlines()]


def stored_name(name: str) -> str:
    """Returns the name under which a sensor is stored: ``touch.penetration`` for ``touch.delta``."""
    element, _, quantity = name.partition(".")
    return f"{element}.{ALIASES[quantity]}" if quantity in ALIASES else name


def closest(name: str, known: Iterable[str]) -> str | None:
    """Returns the known name that ``name`` most likely stands for, or ``None``.

    Names with dots are compared within their element: ``touch.delta_dot`` stands for a name of ``touch``.
    """
    names = list(dict.fromkeys(known))
    # Aliases last, so that a word stands for the stored name.
    names += [
        f"{name.removesuffix(stored)}{alias}"
        for alias, stored in ALIASES.items()
        for name in names
        if name.count(".") == 1 and name.endswith(f".{stored}")
    ]
    lower = {one.lower(): one for one in reversed(names)}
    # A single letter may be a symbol, for which case matters.
    if name.lower() in lower and len(name) > 1:
        return lower[name.lower()]
    element, dot, rest = name.partition(".")
    own = [one for one in names if one.startswith(f"{element}.")] if dot else names
    owner, _, word = name.rpartition(".")
    for other in _other_words(word):
        full = f"{owner}.{other}" if owner else other
        found = full if full in names else next((one for one in own if one.rpartition(".")[2] == other), None)
        if found is not None:
            return found
    if not dot or not own:
        corrected = (f"{owner}.{other}" for other in _other_words(word)) if dot else ()
        return next(filter(None, (_alike(one, lower) for one in (*corrected, name))), None)
    rests = {one[len(element) + 1 :].lower(): one for one in reversed(own)}
    return _alike(rest, rests) or _alike(word, {one.rpartition(".")[2].lower(): one for one in reversed(own)})


def suggestion(name: object, known: Iterable[str]) -> str:
    """Returns ``"; did you mean 'mass'?"`` with the closest known name, or nothing if none is close.

    A name that was renamed gives ``"; it is now 'material'"``.
    """
    names = list(known)
    if (new := present_name(name, names)) is not None:
        return f"; it is now {new!r}"
    found = closest(str(name), names)
    return f"; did you mean {found!r}?" if found is not None else ""


def _other_words(word: str) -> Iterator[str]:
    """Iterates over the names of this library that a word may stand for, first with its given case."""
    for spelled in dict.fromkeys((word, word.lower())):
        for names, words in _GROUPS:
            if spelled in words or spelled in names:
                yield from names


def _alike(name: str, lower: dict[str, str]) -> str | None:
    """Returns the name with the most similar spelling, compared in lower case."""
    found = difflib.get_close_matches(name.lower(), lower, n=1)
    return lower[found[0]] if found else None


def lazy_names(
    module: str, homes: Mapping[str, str], catalogues: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Returns the ``__getattr__`` and ``__dir__`` of a module.

    Args:
        module: Name of the module.
        homes: Module of each name, relative to the package; with a leading dot, relative to its parent package.
        catalogues: Names of tuples, and the names of the classes in each.
    """

    def find(name: str) -> Any:
        itself = sys.modules[module]
        value: Any
        if name in homes:
            value = getattr(importlib.import_module(f".{homes[name]}", itself.__package__), name)
        elif name in catalogues:
            value = tuple(getattr(itself, one) for one in catalogues[name])
        else:
            hint = "" if name.startswith("_") else suggestion(name, [*homes, *catalogues])
            raise AttributeError(f"module {module!r} has no attribute {name!r}{hint}")
        setattr(itself, name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[module]), *homes, *catalogues})

    return find, names
