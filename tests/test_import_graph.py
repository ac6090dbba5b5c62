"""The packages import each other in one direction; imports inside functions count."""

from collections import defaultdict
from pathlib import Path

import pytest
from import_graph import import_graph, package

#: Packages of the host code, lowest first. A package imports itself, packages before it, and kernels.
HOST_ORDER = [
    "validation",
    "algebra",
    "files",
    "system",
    "storage",
    "meshes",
    "scene",
    "geometry",
    "forces",
    "model",
    "unilateral",
    "stepping",
    "drawing",
    "usd",
    "building",
    "experiment",
    "analysis",
    "visualize",
    "benchmark",
    "cli",
]
#: Packages of the device code, lowest first; "types" are the modules outside of packages.
KERNEL_ORDER = [
    "lowlevel",
    "types",
    "catalogue",
    "laws",
    "friction",
    "acceptance",
    "joints",
    "narrowphase",
    "broadphase",
    "contact",
    "body_contact",
    "couplings",
    "particles",
    "integrators",
    "launch_shapes",
    "shapes",
    "manifolds",
    "nonsmooth",
    "outcomes",
    "rendering",
]
#: Largest number of modules that may import each other in a circle.
MAX_KNOT = 4


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    """The modules that each module imports."""
    return import_graph()


def upward(graph: dict[str, set[str]], order: list[str], is_device: bool) -> set[tuple[str, str]]:
    """Returns the imports of a higher package."""
    rank = {name: number for number, name in enumerate(order)}
    return {
        (module, target)
        for module, targets in graph.items()
        for target in targets
        if module.startswith("kernels.") == target.startswith("kernels.") == is_device
        and module not in ("", "__main__", "kernels")
        and rank[package(module)] < rank[package(target)]
    }


def test_host_packages_import_lower_packages_only(graph):
    assert upward(graph, HOST_ORDER, is_device=False) == set()


def test_kernel_packages_import_lower_packages_only(graph):
    assert upward(graph, KERNEL_ORDER, is_device=True) == set()


def test_kernels_do_not_import_the_host(graph):
    hosts = {
        (module, target)
        for module, targets in graph.items()
        for target in targets
        if module.startswith("kernels") and not target.startswith("kernels")
    }
    assert hosts == set()


def test_core_imports_no_family_of_force_elements(graph):
    """The core iterates over force elements; nonsmooth contact belongs to an integrator."""
    found = {
        (module, target)
        for module, targets in graph.items()
        for target in targets
        if module.startswith(("model.", "stepping.", "building."))
        and target.startswith("forces.")
        and target.count(".") > 1
    }
    assert found == {
        ("model.environments", "forces.nonsmooth.sensors"),  # hint for a sensor that requires nonsmooth contact
        ("model.environments", "forces.particle_contact.contact_pairs"),  # Model.contact_pairs
        ("stepping.integrators.moreau_jean", "forces.nonsmooth.contacts"),
        ("stepping.integrators.moreau_jean", "forces.nonsmooth.materials"),
        ("stepping.outcomes.sources", "forces.nonsmooth.sensors"),
    }


def test_no_large_knot_of_modules(graph):
    knots = [sorted(knot) for knot in strong_components(graph) if len(knot) > MAX_KNOT]
    assert knots == []


def test_modules_of_tests_and_benchmarks_have_different_names():
    """Both are imported as top-level modules, in one process."""
    tests = Path(__file__).parent
    names = {path.stem for path in (tests.parent / "benchmarks").glob("*.py")}
    assert names & {path.stem for path in tests.rglob("*.py")} == set()


def strong_components(graph: dict[str, set[str]]) -> list[set[str]]:
    """Returns the sets of modules that reach each other, by the algorithm of Kosaraju."""
    reverse: dict[str, set[str]] = defaultdict(set)
    for module, targets in graph.items():
        for target in targets:
            reverse[target].add(module)
    order: list[str] = []
    seen: set[str] = set()
    for start in list(graph):
        stack = [(start, iter(graph[start]))] if start not in seen else []
        seen.add(start)
        while stack:
            module, targets = stack[-1]
            following = next((target for target in targets if target not in seen), None)
            if following is None:
                order.append(module)
                stack.pop()
            else:
                seen.add(following)
                stack.append((following, iter(graph.get(following, ()))))
    components: list[set[str]] = []
    placed: set[str] = set()
    for root in reversed(order):
        members, pending = set(), [root] if root not in placed else []
        while pending:
            module = pending.pop()
            if module not in placed:
                placed.add(module)
                members.add(module)
                pending += reverse[module]
        components += [members] if members else []
    return components
