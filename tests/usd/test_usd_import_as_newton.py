"""UsdPhysics stages as read by Newton: bodies, poses, masses, shapes, materials and collision pairs.

A test of an intended difference states its reason.
"""

import importlib.util
import itertools

import numpy as np
import pytest
from newton_stages import BOUND, STAGES, TOUCHING, WITH_MASS, cube, material
from physics_stages import COLLIDER, body, contact_pairs, moved, prim, stage
from scipy.spatial.transform import Rotation

import warpcontact as wc

LACKING = [name for name in ("newton", "newton_usd_schemas") if importlib.util.find_spec(name) is None]
pytestmark = [
    pytest.mark.skipif(bool(LACKING), reason=f"{' and '.join(LACKING)} not installed"),
    pytest.mark.filterwarnings("default"),  # warnings of Newton
]

# A few roundings in single precision.
SINGLE = 1e-5


class Both:
    """A stage read by both programs; lengths and masses of Newton are converted to SI units."""

    def __init__(self, tmp_path, content, *, metres=1.0, kilograms=1.0, up="Z", **options):
        import newton

        # Newton keeps the units of the stage for rigid bodies; here they are converted to SI units.
        self.metres, self.kilograms = metres, kilograms
        header = f"kilogramsPerUnit = {kilograms}\n"
        path = stage(tmp_path, content, metres=metres, up=up, header=header)
        self.builder = newton.ModelBuilder()
        found = self.builder.add_usd(str(path))
        self.body_numbers = {name.rpartition("/")[2]: i for name, i in found["path_body_map"].items()}
        self.shape_numbers = {name.rpartition("/")[2]: i for name, i in found["path_shape_map"].items()}
        self.scene = wc.Scene.from_usd(path, trusted=True, **options)
        self.types = newton.GeoType

    def pose(self, name):
        """Position of a body's origin [m] and its rotation, in Newton."""
        pose = np.array(self.builder.body_q[self.body_numbers[name]], dtype=np.float64)
        return self.metres * pose[:3], Rotation.from_quat(pose[3:])

    def centre(self, name):
        """Center of mass of a body, world [m], in Newton."""
        place, turn = self.pose(name)
        return place + turn.apply(self.metres * np.array(self.builder.body_com[self.body_numbers[name]]))

    def inertia(self, name):
        """Inertia of a body, world [kg·m²], in Newton."""
        own = np.array(self.builder.body_inertia[self.body_numbers[name]], dtype=np.float64).reshape(3, 3)
        turn = self.pose(name)[1].as_matrix()
        return self.kilograms * self.metres**2 * turn @ own @ turn.T

    def check_bodies(self, *, inertia=True):
        """Compares names, poses, masses and inertias of all bodies."""
        assert sorted(one.name for one in self.scene.bodies) == sorted(self.body_numbers)
        for one in self.scene.bodies:
            size = float(np.abs(one.position).max()) + 1.0
            np.testing.assert_allclose(one.position, self.centre(one.name), atol=SINGLE * size, err_msg=one.name)
            own = Rotation.from_quat(one.orientation).as_matrix()
            np.testing.assert_allclose(own, self.pose(one.name)[1].as_matrix(), atol=SINGLE, err_msg=one.name)
            mass = self.kilograms * self.builder.body_mass[self.body_numbers[one.name]]
            assert float(one.mass) == pytest.approx(mass, rel=SINGLE), one.name
            if inertia:
                expected = self.inertia(one.name)
                slack = SINGLE * np.trace(expected)
                np.testing.assert_allclose(own @ one.inertia @ own.T, expected, atol=slack, err_msg=one.name)

    def check_shapes(self):
        """Compares bodies, types, sizes and poses of all analytic shapes, and bodies of meshes."""
        names = [one.name for one in (*self.scene.shapes, *self.scene.surfaces)]
        assert sorted(names) == sorted(self.shape_numbers)
        for one in (*self.scene.shapes, *self.scene.surfaces):
            i = self.shape_numbers[one.name]
            carrier = self.builder.shape_body[i]
            assert carrier == (-1 if one.body is None else self.body_numbers[one.body.name]), one.name
            if one in self.scene.shapes:
                self._check_form(one, i, carrier)

    def _check_form(self, one, i, carrier):
        kind = self.types(self.builder.shape_type[i]).name
        sizes = self.metres * np.array(self.builder.shape_scale[i], dtype=np.float64)
        place, turn = np.zeros(3), Rotation.identity()
        if carrier >= 0:
            pose = np.array(self.builder.body_q[carrier], dtype=np.float64)
            place, turn = self.metres * pose[:3], Rotation.from_quat(pose[3:])
        local = np.array(self.builder.shape_transform[i], dtype=np.float64)
        place, turn = place + turn.apply(self.metres * local[:3]), turn * Rotation.from_quat(local[3:])
        form = one.form()
        expected = {
            "BOX": lambda: wc.shapes.RoundedBox(tuple(sizes.tolist())),
            "SPHERE": lambda: wc.shapes.Sphere(sizes[0]),
            "CAPSULE": lambda: wc.shapes.Capsule(sizes[0], sizes[1]),
            "CYLINDER": lambda: wc.shapes.Cylinder(sizes[0], sizes[1]),
            "CONE": lambda: wc.shapes.Cone(sizes[0], 2.0 * sizes[1]),
            "PLANE": wc.shapes.Plane,
        }[kind]()
        assert type(form) is type(expected), one.name
        for key, value in expected.parameters().items():
            assert form.parameters()[key] == pytest.approx(value, rel=SINGLE), (one.name, key)
        if kind == "CONE":  # the origin is at the base here and halfway up in Newton
            place = place - turn.apply([0.0, 0.0, sizes[1]])
        own, own_turn = one.positions[0], Rotation.from_quat(one.orientations[0])
        if one.body is not None:
            frame = Rotation.from_quat(one.body.orientation)
            own, own_turn = one.body.position + frame.apply(own), frame * own_turn
        np.testing.assert_allclose(own, place, atol=SINGLE * (1.0 + np.abs(place).max()), err_msg=one.name)
        axes = own_turn.as_matrix(), turn.as_matrix()
        if kind == "BOX":
            np.testing.assert_allclose(*axes, atol=SINGLE, err_msg=one.name)
        elif kind != "SPHERE":  # a rotation about its own axis has no effect
            np.testing.assert_allclose(axes[0][:, 2], axes[1][:, 2], atol=SINGLE, err_msg=one.name)

    def pairs(self):
        """Name pairs of colliders, by each program."""
        builder, names = self.builder, {i: name for name, i in self.shape_numbers.items()}
        apart = {tuple(sorted(pair)) for pair in builder.shape_collision_filter_pairs}
        theirs = {
            tuple(sorted((names[i], names[j])))
            for i, j in itertools.combinations(sorted(names), 2)
            if builder.shape_body[i] != builder.shape_body[j] and (i, j) not in apart
        }
        ours = {tuple(sorted(pair)) for pair in contact_pairs(self.scene)}
        return ours, theirs

    def check(self, **options):
        """Compares bodies and shapes."""
        self.check_bodies(**options)
        self.check_shapes()


@pytest.mark.parametrize("name", STAGES)
def test_imported_bodies_and_shapes_match_newton(tmp_path, name):
    Both(tmp_path, STAGES[name]).check()


def test_imported_units_and_up_axis_match_newton(tmp_path):
    content = prim("PhysicsScene", "physics") + body(
        "one", cube("box", moved(10, 0, 0, scale=(10, 20, 30))), moved(100, 200, 300, turn=(0, 90, 0))
    )
    both = Both(tmp_path, content, metres=0.01, kilograms=0.001, up="Y")
    both.check()
    # Newton rotates gravity in single precision.
    np.testing.assert_allclose(both.scene.gravity, 0.01 * np.array(both.builder.gravity), atol=1e-5)


def test_given_mass_and_center_shift_the_inertia_unlike_newton(tmp_path):
    both = Both(
        tmp_path, body("one", "float physics:mass = 3\npoint3f physics:centerOfMass = (0.2, 0, 0)\n" + cube("box"))
    )
    both.check_bodies(inertia=False)
    # 0.5 kg·m² about the center of the cube; by the parallel axis theorem 3 · 0.2² more about the given center.
    # Newton has the same if the body has no authored mass.
    np.testing.assert_allclose(np.diag(both.inertia("one")), 0.5, rtol=SINGLE)
    np.testing.assert_allclose(np.diag(both.scene.bodies[0].inertia), (0.5, 0.62, 0.62), rtol=SINGLE)


def test_given_mass_scales_collider_masses_unlike_newton(tmp_path):
    parts = "".join(
        cube(name, f"float physics:mass = {mass}\n" + moved(place, 0, 0), WITH_MASS)
        for name, mass, place in (("a", 1, 1), ("b", 3, -1))
    )
    both = Both(tmp_path, body("one", "float physics:mass = 8\n" + parts))
    both.check_bodies(inertia=False)
    # 2 kg at 1.5 m and 6 kg at −0.5 m from the center of mass, the same in Newton.
    np.testing.assert_allclose(np.diag(both.scene.bodies[0].inertia), (8 / 6, 8 / 6 + 6, 8 / 6 + 6), rtol=SINGLE)
    np.testing.assert_allclose(np.diag(both.inertia("one")), (8 / 6, 8 / 6 + 8, 8 / 6 + 8), rtol=SINGLE)


def test_imported_velocity_is_in_the_transform_frame_unlike_newton(tmp_path):
    velocity = "vector3f physics:velocity = (1, 0, 0)\nvector3f physics:angularVelocity = (0, 180, 0)\n"
    for turn, same in ((0, True), (90, False)):
        folder = tmp_path / str(turn)
        folder.mkdir()
        both = Both(folder, body("one", velocity + cube("box"), moved(0, 0, 0, turn=(0, 0, turn))))
        (one,) = both.scene.bodies
        ours = [*one.linear_velocity, *one.angular_velocity]
        # UsdPhysics: "in the same space as the node's xform", whose operations are in the frame of the parent.
        np.testing.assert_allclose(ours, (1, 0, 0, 0, np.pi, 0), atol=1e-6)
        assert np.allclose(np.array(both.builder.body_qd[0]), ours, atol=1e-5) == same


def test_disabled_body_is_static_unlike_newton(tmp_path):
    both = Both(tmp_path, body("off", "bool physics:rigidBodyEnabled = 0\n" + cube("box")))
    both.check_shapes()
    assert (both.scene.bodies, list(both.body_numbers)) == ([], ["off"])


def test_imported_material_values_match_newton(tmp_path):
    values = {
        "physics_dynamicFriction": 0.4,
        "physics_staticFriction": 0.6,
        "newton_contactStiffness": 4e3,
        "newton_contactDamping": 50.0,
        "newton_rollingFriction": 0.01,
        "newton_torsionalFriction": 0.02,
    }
    ball = prim("Sphere", "ball", BOUND, "double radius = 0.1\nrel material:binding:physics = </stuff>\n")
    floor = prim("Plane", "floor", BOUND, 'uniform token axis = "Z"\nrel material:binding:physics = </stuff>\n')
    both = Both(tmp_path, material("stuff", **values) + body("one", ball) + floor)
    both.check()
    (contact,) = both.scene.shape_contacts
    law, friction = contact.material.law, contact.material.friction
    ours = {
        "mu": friction.mu_dynamic,  # Newton has one coefficient only
        "ke": law.stiffness,
        "kd": law.damping,
        "mu_rolling": contact.material.rolling.mu_dynamic * 0.1,
        "mu_torsional": contact.material.torsion.mu_dynamic * float(contact.torsion_radius),
    }
    for i in both.shape_numbers.values():
        theirs = {key: getattr(both.builder, f"shape_material_{key}")[i] for key in ours}
        assert ours == pytest.approx(theirs, rel=SINGLE)


def test_unauthored_friction_is_not_zero_unlike_newton(tmp_path):
    # Newton takes the fallback of UsdPhysics, 0, if a material gives its density only.
    ball = prim("Sphere", "ball", BOUND, "double radius = 0.1\nrel material:binding:physics = </stuff>\n")
    floor = prim("Plane", "floor", COLLIDER, 'uniform token axis = "Z"\n')
    both = Both(tmp_path, material("stuff", physics_density=500) + body("one", ball) + floor)
    assert both.builder.shape_material_mu[both.shape_numbers["ball"]] == 0.0
    # A collider without a material has 0.5 here and 1 in Newton.
    assert both.builder.shape_material_mu[both.shape_numbers["floor"]] == 1.0
    assert both.scene.shape_contacts[0].material.friction.mu_dynamic == 0.5


@pytest.mark.parametrize("name", TOUCHING)
def test_contact_pairs_match_newton(tmp_path, name):
    ours, theirs = Both(tmp_path, TOUCHING[name]).pairs()
    assert ours == theirs
