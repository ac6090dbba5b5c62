"""Engines of the comparison: one module per engine.

A module imports its engine, NumPy and ``works`` only. It has

* ``WORKS``: names of the benchmark scenes that the engine supports;
* ``PACKAGES``: packages whose versions are reported;
* ``Run(work, envs, device, threads, variant)``: a run ready to start, with ``reset()`` (return to the initial
  state), ``step(count)``, ``wait()`` (until the device is idle), ``positions()`` (centers of the bodies, ``(envs,
  bodies, 3)`` [m]) and ``notes()`` (remarks on a run, such as overflows).
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Engine:
    """Engine of the comparison.

    Attributes:
        file: Module of this package, and name of its list of requirements.
        cpu: Whether it is compared on a CPU by default.
        cuda: Whether it runs on a GPU.
        variant: Variant passed to ``Run``, such as a solver.
    """

    file: str
    cpu: bool = True
    cuda: bool = True
    variant: str = ""


ENGINES = {
    "warpcontact": Engine("warpcontact"),
    "mujoco": Engine("mujoco", cuda=False),
    "mujoco-warp": Engine("mujoco_warp", cpu=False),  # for GPUs: on a CPU slower than MuJoCo
    "newton-semi-implicit": Engine("newton", variant="semi-implicit"),
    "newton-xpbd": Engine("newton", variant="xpbd"),
}
