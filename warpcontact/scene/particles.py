"""Particle contacts of a scene, and the method of ``Scene`` that adds them; it checks all input."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact.kernels import shapes as forms
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.contact.contact_evaluation import ContactModel
from warpcontact.scene.elements import ContactMaterial, check_owned, options_of
from warpcontact.scene.shapes import Shape, check_material
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits


@dataclass(frozen=True, eq=False)
class ParticleContact:
    """Contact between all pairs of spheres and capsules (particles).

    Particles are numbered in the order of ``shapes``, those of a set consecutively.
    """

    name: str
    shapes: tuple[Shape, ...]
    material: ContactMaterial
    excluded: tuple[tuple[Shape, Shape], ...]
    skin: float  # extra distance of the neighbor lists [m]
    max_neighbors: int | None  # maximum number of neighbors; None: the number that fits around a particle
    kappa: Array
    max_depth: Array
    torsion_radius: Array | None
    force_scale: Array
    enabled: Array
    color: Array | None
    visible: bool
    # Number of the first particle of each element of ``shapes``, and the total number.
    starts: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        starts = np.cumsum([0, *(shape.count for shape in self.shapes)]).tolist()
        object.__setattr__(self, "starts", tuple(starts))

    @property
    def count(self) -> int:
        """Number of particles."""
        return self.starts[-1]

    @property
    def parts(self) -> ContactModel:
        """The classes of law and friction models."""
        return self.material.parts

    @property
    def formulas(self) -> dict[str, Formula]:
        """The law and the friction models, by name of the part."""
        return self.material.formulas

    @cached_property
    def bodies(self) -> NDArray[np.int32]:
        """Body index of each particle on the device (n,)."""
        return np.concatenate([shape.body_numbers for shape in self.shapes])

    @cached_property
    def kinds(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """A kind for each particle (n,), and whether two kinds can be in contact, 0 or 1 (kinds, kinds)."""
        named = {shape for pair in self.excluded for shape in pair}
        keys = [(shape.group, shape.mask, shape if shape in named else None) for shape in self.shapes]
        number = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        example = {number[key]: shape for key, shape in zip(reversed(keys), reversed(self.shapes), strict=True)}
        allowed = np.array(
            [[example[i].may_touch(example[j]) for j in range(len(number))] for i in range(len(number))]
        )
        for one, other in self.excluded:
            i, j = (number[one.group, one.mask, one], number[other.group, other.mask, other])
            allowed[i, j] = allowed[j, i] = False
        each = [number[key] for key in keys]
        counts = [shape.count for shape in self.shapes]
        return np.repeat(np.array(each, dtype=np.int32), counts), allowed.astype(np.int32)

    def label(self, number: int) -> str:
        """Returns the label of a particle by its number: the name of its shape, with the item for a set."""
        which = int(np.searchsorted(self.starts, number, side="right")) - 1
        shape = self.shapes[which]
        return shape.name if shape.single else f"{shape.name}[{number - self.starts[which]}]"


# Default skin relative to the mean radius. A larger skin gives longer neighbor lists that are rebuilt less often.
SKIN = 0.3


@explain_keywords_of
class ParticleContacts:
    """The particle contacts of a ``Scene``."""

    particle_contacts: list[ParticleContact]
    _elements: dict[str, Any]

    def add_particle_contact(
        self,
        shapes: Shape | Sequence[Shape],
        material: ContactMaterial,
        *,
        exclude: Iterable[tuple[Shape, Shape]] = (),
        skin: float | None = None,
        max_neighbors: int | None = None,
        kappa: float = 0.5,
        max_depth: float | None = None,
        torsion_radius: float | None = None,
        force_scale: float = 1.0,
        enabled: bool = True,
        name: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> ParticleContact:
        """Adds particle contact: contact between all pairs of spheres and capsules on different bodies.

        A particle is a rigid sphere or capsule with six degrees of freedom. Particles are numbered in the given
        order. In a pair, the first particle is the one with the lower number: the normal points towards it, and
        forces are those on its body.

        Args:
            shapes: Spheres and capsules from ``add_shape``, on bodies or on sets of bodies. Two particles can be in
                contact if each is in a group of the mask of the other.
            material: Contact material. R of rolling and of the contact patch is that of the pair,
                1/R = 1/R₁ + 1/R₂.
            exclude: Pairs of ``shapes`` without contact. A set stands for all of its shapes; a set paired with itself
                has no contact among its shapes.
            skin: Extra distance of the neighbor lists, which are rebuilt when a particle has moved by half of it [m].
                Default: 0.3 mean radii. Does not change results.
            max_neighbors: Maximum number of neighbors of a particle. Default: the number of smallest particles that
                fit around it. Not limited for up to 32 particles.
            kappa: κ of the contact point K = P₂ + κ (P₁ − P₂), with the closest points P₁ and P₂ of the surfaces of
                the first and second particle.
            max_depth: Maximum penetration of a contact [m]. Default: unlimited.
            torsion_radius: Lever arm of torsional friction [m]. Default: (3π/16) √(R δ), for a sphere of radius R
                with Hertzian pressure.
            force_scale: Factor on forces and torques.
            enabled: Whether the contact is enabled.
            name: Name in parameters and sensors. Default: generated.
            color: Color of the force arrows, RGB in 0…1.
            visible: Whether the force arrows are drawn.

        Raises:
            ValueError: If a value is out of range, or a shape is not a sphere or capsule on a body.
        """
        name = checks.new_name("particle_contact", name, self._elements)
        if not isinstance(shapes, Shape | list | tuple):
            raise ValueError(f"shapes of {name!r} must be a shape or a list of them, got {checks.element(shapes)}")
        given: tuple[Shape, ...] = (shapes,) if isinstance(shapes, Shape) else tuple(shapes)
        for shape in given:
            check_owned(f"shapes of {name!r}", shape, Shape, self._elements, "add_shape")
            if shape.kind not in (forms.Sphere, forms.Capsule):
                raise ValueError(
                    f"{name}: shape {shape.name!r} is a {shape.kind.__name__}; particle contacts are of spheres and "
                    "capsules, add_shape_contact is for others"
                )
            if shape.body is None:
                raise ValueError(
                    f"{name}: shape {shape.name!r} is fixed to the world; put it on a body with "
                    "motion=wc.motions.Fixed()"
                )
        if len(set(given)) < len(given):
            twice = next(shape.name for shape in given if given.count(shape) > 1)
            raise ValueError(f"{name}: shape {twice!r} is listed more than once")
        if sum(shape.count for shape in given) < 2:
            raise ValueError(f"{name}: shapes must be at least 2, got {len(given)}")
        check_material(name, material, torsion_radius)
        if not isinstance(exclude, Iterable):
            raise ValueError(f"exclude of {name!r} must be pairs of its shapes, got {checks.element(exclude)}")
        among = frozenset(given)
        excluded = tuple(_pair(name, pair, among) for pair in exclude)
        if max_neighbors is not None:
            checks.integer(f"{name}.max_neighbors", max_neighbors)
        radii = np.concatenate([shape.sizes["radius"] for shape in given])
        contact = ParticleContact(
            name=name,
            shapes=given,
            material=material,
            excluded=excluded,
            skin=float(
                checks.numbers(
                    f"{name}.skin", SKIN * radii.mean() if skin is None else skin, (), limits("m", above=0.0)
                )
            ),
            max_neighbors=None if max_neighbors is None else int(max_neighbors),
            **options_of(name, kappa, max_depth, torsion_radius, force_scale, enabled, color, visible),
        )
        self.particle_contacts.append(contact)
        self._elements[name] = contact
        return contact


def _pair(name: str, pair: Any, shapes: frozenset[Shape]) -> tuple[Shape, Shape]:
    if not isinstance(pair, list | tuple) or len(pair) != 2 or any(shape not in shapes for shape in pair):
        several = isinstance(pair, list | tuple)
        shown = f"({', '.join(map(checks.element, pair))})" if several else checks.element(pair)
        raise ValueError(f"exclude of {name!r} must be pairs of its shapes, got {shown}")
    return pair[0], pair[1]
