"""What the short form of the benchmarks found, as numbers and as a table."""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class WorkFigures:
    """Figures of one work.

    Attributes:
        work: What was stepped.
        triangles: Of the surface.
        first_step_s: From nothing to the first step done [s], with what had to be compiled.
        env_steps_per_s: Environment-steps per second, the median of the runs.
        lowest: The least of them.
        highest: The most of them.
        runs: How many there were.
        cores_busy: How many cores were busy on average.
        frozen: Environments that turned non-finite, and cost nothing from then on.
        steps_per_s_alone: Steps per second of one environment alone.
        queries_per_s: Environments per second for which the device can do one closest-point query of every point.
        copies_per_s: Environments per second of which it can copy the state.
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
    """What ``wc.bench`` found; as text, a table.

    Attributes:
        facts: Device, driver, cores, threads, system, date.
        versions: Of Python, warpcontact, Warp and NumPy.
        envs: Number of environments.
        precision: ``"float32"`` or ``"float64"``.
        steps: Steps of a run.
        dt: Step [s].
        compiled_modules: Kernel modules that were not in Warp's cache and had to be compiled.
        works: Figures of each work.
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
        """Returns everything as plain dictionaries, lists, text and numbers, ready for JSON."""
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
                lines.append(f"  ! {work.frozen} environments turned non-finite and cost nothing from then on")
        return "\n".join(
            [
                *lines,
                "",
                "× query: times as fast as a bare closest-point query of every point in every step",
                "copies: copies of the state that take as long as a step",
                "one alone: steps of a single environment",
                "first step: to build, compile and take it; the first work compiles most of what all share",
            ]
        )
