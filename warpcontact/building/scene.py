"""``Scene``: the data of a scene, with USD import and building of models."""

import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Self

from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.scene.elements import ContactMaterial
from warpcontact.scene.scene_data import SceneData
from warpcontact.validation import checks

if TYPE_CHECKING:
    from warpcontact.building.model import Model, SplitModel
    from warpcontact.kernels.catalogue.device_model import Formula
    from warpcontact.meshes.isolation import Limits
    from warpcontact.scene.material_table import GivenTable
    from warpcontact.scene.scene_element import SceneElement


@explain_keywords_of
class Scene(SceneData):
    """Bodies, surfaces, shapes, points, contacts and couplings of one environment; ``build`` creates many of them.

    Args:
        gravity: Acceleration of gravity, world axes [m/s²].
        max_speed: Maximum speed of centers of mass [m/s]. If exceeded, the environment is quarantined.
        max_distance: Maximum distance of centers of mass from the origin [m]. If exceeded, the environment is
            quarantined.

    Attributes:
        import_warnings: Warnings about the import of a USD stage, see ``from_usd``.
        suggested_dt: Time step that the NewtonSceneAPI of the imported stage requests [s]; ``None``: none.
        suggested_iterations: Maximum number of solver iterations per step that it requests; ``None``: none.
    """

    @classmethod
    def from_usd(
        cls,
        path: str | os.PathLike[str],
        *,
        custom_types: "Iterable[type[Formula] | type[SceneElement]]" = (),
        material: "ContactMaterial | GivenTable | None" = None,
        contact_time: float = 0.01,
        samples: int | str | None = None,
        skip_unsupported: bool = False,
        trusted: bool = False,
        limits: "Limits | None" = None,
    ) -> Self:
        """Returns the scene of a USD stage: one that ``export_usd`` wrote, or any stage with UsdPhysics.

        A stage of ``export_usd`` gives the scene that was simulated, bitwise identical. From other stages, rigid
        bodies, masses, colliders, physics materials, gravity and collision groups are read and converted to SI units
        with z up; ``docs/usd.md`` describes the rules and the contacts that are created. The file is read in a
        sandboxed process, as by ``wc.load_mesh``.

        Args:
            path: A .usd, .usda, .usdc or .usdz file.
            custom_types: User-defined classes of laws, friction models, springs, motions, shapes and force elements
                that a stage of ``export_usd`` refers to. Classes of force elements that are registered by an imported
                module can be omitted.
            material: Contact material of all contacts of other stages; or a table of them, as for ``add_body_contact``, by the
                names of the physics materials that are bound to colliders. Default: from the physics materials.
            contact_time: Duration of an impact in other stages, from which the contact stiffness is computed [s].
            samples: Contact of meshes in other stages at sample points, see ``add_surface_contact``. Default: body
                contact, see ``add_body_contact``.
            skip_unsupported: Whether to skip unsupported prims, such as joints, and list them in
                ``import_warnings``. Default: they raise an error.
            trusted: Whether to read the file in this process, including referenced files outside of its folder.
            limits: Limits of memory, time and mesh size.

        Raises:
            UsdError: If the file cannot be read, is invalid, or has unsupported prims. The message lists all
                problems with their prim paths.
            ValueError: If another argument is out of range; the message names it.
        """
        from warpcontact.usd.importing.scene_from_stage import scene_from_usd

        data = scene_from_usd(
            path,
            custom_types=custom_types,
            material=material,
            contact_time=contact_time,
            samples=samples,
            skip_unsupported=skip_unsupported,
            trusted=trusted,
            limits=limits,
        )
        scene = cls()
        vars(scene).update(vars(data))
        return scene

    def build(
        self, envs: int = 1, device: str | Sequence[str] = "auto", precision: str = "float32"
    ) -> "Model | SplitModel":
        """Builds ``envs`` environments of this scene on one or several devices.

        Warns of contacts at points that ``add_body_contact`` should replace, see ``docs/body-contact.md``.

        Args:
            envs: Number of environments, at least 1.
            device: ``"cpu"``, ``"cuda:0"``, …; ``"auto"``: one GPU if available, else the CPU; ``"cuda"``: all visible
                GPUs; or a list such as ``["cuda:0", "cuda:2"]``. With several devices, the environments are split in
                order and as evenly as possible. A device may be listed more than once, ``["cpu", "cpu"]``.
            precision: ``"float32"`` or ``"float64"``.

        Returns:
            The model; a ``SplitModel`` if it is on several devices. It has a copy of the scene; later changes of this
            scene do not affect it.

        Raises:
            ValueError: If an argument is out of range or the scene has no body.
            TypeError: If a user-defined law, friction model, shape, spring or motion does not compile.
            MemoryError: If the environments do not fit into the memory of a device or the host. The message states the
                number that fits. Nothing is allocated then.
        """
        from warpcontact.building.plan import plan_model

        return plan_model(self, device, precision).build(checks.integer("envs", envs))
