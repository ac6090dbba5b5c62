"""One file per engine: how it does the works.

A file imports its engine, NumPy and ``works``, and nothing of other engines. It has

* ``WORKS``: names of the works that the engine can do;
* ``PACKAGES``: what to name the versions of;
* ``Run(work, envs, device, threads, variant)``: the work, ready to go, with ``reset()`` (back to the start),
  ``step(count)``, ``wait()`` (until the device has done it), ``positions()`` (centres of the bodies, ``(envs,
  bodies, 3)``) and ``notes()`` (what is worth knowing about a run, such as overflows).
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Engine:
    """One line of a comparison.

    Attributes:
        file: Module of this package that does it, and list of its requirements.
        cpu: Whether it is compared on a CPU unless asked for otherwise.
        cuda: Whether it runs on a GPU.
        variant: What ``Run`` gets to know, such as a solver.
    """

    file: str
    cpu: bool = True
    cuda: bool = True
    variant: str = ""


ENGINES = {
    "warpcontact": Engine("warpcontact"),
    "mujoco": Engine("mujoco", cuda=False),
    "mujoco-warp": Engine("mujoco_warp", cpu=False),  # made for GPUs: minutes to compile, then slower than MuJoCo
    "newton-semi-implicit": Engine("newton", variant="semi-implicit"),
    "newton-xpbd": Engine("newton", variant="xpbd"),
}
