"""Results of ``wc.bench``, as numbers and as a table."""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class WorkFigures:
    """Results of one scene.

    Attributes:
        work: Name of the scene.
        triangles: Number of triangles of the surface.
        first_step_s: Time to build, compile and take the first step [s].
        env_steps_per_s: Environment steps per second, the median of the runs.
        lowest: Smallest value of the runs.
        highest: Largest value of the runs.
        runs: Number of runs.
        cores_busy: Average number of busy cores.
        frozen: Number of environments that became non-finite; they take no time afterwards.
        steps_per_s_alone: Steps per second of a single environment.
        queries_per_s: Rate of closest-point queries for all points of an environment, in environments per second.
        copies_per_s: Rate of copies of the state, in environments per second.
    """

    work: str
    triangles: int
    first_step_s: float
    env_steps_per_s: float
    lowest: float
    highest: float
    runs: int
    cores_busy: float
    frozen: int
    steps_per_s_alone: float
    queries_per_s: float
    copies_per_s: float


@dataclass(frozen=True)
class BenchReport:
    """Results of ``wc.bench``; as text, a table.

    Attributes:
        facts: Device, driver, cores, threads, system, date.
        versions: Versions of Python, warpcontact, Warp and NumPy.
        envs: Number of environments.
        precision: ``"float32"`` or ``"float64"``.
        steps: Number of steps of a run.
        dt: Time step [s].
        compiled_modules: Kernel modules that were not in Warp's cache and had to be compiled.
        works: Results of each scene.
    """

    facts: dict[str, str | int]
    versions: dict[str, str]
    envs: int
    precision: str
    steps: int
    dt: float
    compiled_modules: int
    works: tuple[WorkFigures, ...]

    def to_dict(self) -> dict[str, Any]:
        """Returns all results as dictionaries, lists, strings and numbers for JSON."""
        return asdict(self) | {"works": [asdict(work) for work in self.works]}

    def __str__(self) -> str:
        about, have = self.facts, self.versions
        driver = f", driver {about['driver']}" if "driver" in about else ""
        host = f" on {about['processor']}" if "processor" in about else ""
        made = f"kernel modules compiled: {self.compiled_modules or 'none'}"
        lines = [
            f"{about['device']}{driver}{host}: {about['cores']} cores, {about['threads']} threads, "
            f"{about['system']}",
            f"warpcontact {have['warpcontact']}, Warp {have['warp-lang']}, NumPy {have['numpy']}, "
            f"Python {have['python']}, {about['date']}",
            f"{self.envs} environments in {self.precision} on {self.works[0].triangles} triangles, "
            f"{self.steps} steps of {self.dt:g} s from rest through contact; {made}",
            "",
            f"{'':17} {'env-steps/s':>11}  {'lowest … highest':>19} {'cores':>6} {'× query':>8} {'copies':>7} "
            f"{'one alone':>12} {'first step':>11}",
        ]
        for work in self.works:
            spread = f"{work.lowest:.2e} … {work.highest:.2e}"
            lines.append(
                f"{work.work:17} {work.env_steps_per_s:11.2e}  {spread:>19} {work.cores_busy:6.2f} "
                f"{work.env_steps_per_s / work.queries_per_s:8.2f} "
                f"{work.copies_per_s / work.env_steps_per_s:7.1f} "
                f"{work.steps_per_s_alone:8.2e} /s {work.first_step_s:9.2f} s"
            )
            if work.frozen:
                lines.append(f"  ! {work.frozen} environments became non-finite and take no time afterwards")
        return "\n".join(
            [
                *lines,
                "",
                "× query: speed relative to a bare closest-point query for every point in every step",
                "copies: number of copies of the state in the time of a step",
                "one alone: steps of a single environment",
                "first step: time to build, compile and step; the first scene compiles most of the shared kernels",
            ]
        )
