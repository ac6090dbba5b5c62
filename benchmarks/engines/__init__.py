"""Engines of the comparisons: one module per engine.

A module imports its engine, NumPy and the modules of benchmark scenes only. It has

* ``PACKAGES``: packages whose versions are reported;
* ``Run(scene, envs, device, threads, variant)``, for nonsmooth contact ``NonsmoothRun``, and for body contact
  ``BodyContactRun``: a run ready to start,
  with ``reset()`` (return to the initial state), ``step(count)``, ``wait()`` (until the device is idle),
  ``sanity(steps)`` (figures that show whether a run of ``steps`` steps is physical; called after the last run) and
  ``notes()`` (remarks on a run, such as overflows).
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Engine:
    """Engine of a comparison.

    Attributes:
        file: Module of this package, and name of its list of requirements.
        cpu: Whether it is compared on a CPU by default.
        cuda: Whether it is compared on a GPU by default.
        variant: Variant passed to the run, such as a solver.
    """

    file: str
    cpu: bool = True
    cuda: bool = True
    variant: str = ""


#: Compliant contact.
ENGINES = {
    "warpcontact": Engine("warpcontact"),
    "mujoco": Engine("mujoco", cuda=False),
    "mujoco-warp": Engine("mujoco_warp", cpu=False),  # for GPUs: on a CPU slower than MuJoCo
    "newton-semi-implicit": Engine("newton", variant="semi-implicit"),
    "newton-xpbd": Engine("newton", variant="xpbd"),
}
#: Nonsmooth contact. The variants are solvers of this engine and friction cones of MuJoCo.
NONSMOOTH_ENGINES = {
    "warpcontact": Engine("warpcontact", variant="auto"),
    "warpcontact-gauss-seidel": Engine("warpcontact", cpu=False, cuda=False, variant="gauss_seidel"),
    "warpcontact-accelerated": Engine("warpcontact", cpu=False, cuda=False, variant="accelerated"),
    "mujoco-elliptic": Engine("mujoco", cuda=False, variant="elliptic"),
    "mujoco-pyramidal": Engine("mujoco", cuda=False, variant="pyramidal"),
}
#: Body contact. The variants are methods of contact and solvers.
BODY_CONTACT_ENGINES = {
    "warpcontact": Engine("warpcontact", variant="nonsmooth"),
    "warpcontact-compliant": Engine("warpcontact", variant="compliant"),
    "mujoco": Engine("mujoco", cuda=False, variant="elliptic"),
    "mujoco-warp": Engine("mujoco_warp", cpu=False),
    "newton-mesh": Engine("newton", cpu=False, variant="mesh"),
    "newton-hydroelastic": Engine("newton", cpu=False, variant="hydroelastic"),
}
