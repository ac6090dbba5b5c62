"""What a machine can check of the device code: every file compiles, imports only its own kind, stays short."""

import ast
import functools
import importlib
import itertools
import pkgutil
from pathlib import Path

import pytest
import warp as wp
import warpcontact.kernels
from warpcontact.kernels import contact_force
from warpcontact.kernels.touch import Parts

import warpcontact as wc

pytestmark = pytest.mark.installed

FOLDER = Path(warpcontact.kernels.__file__).parent
FILES = sorted(FOLDER.rglob("*.py"))
MODULES = [name for _, name, _ in pkgutil.walk_packages([str(FOLDER)], "warpcontact.kernels.")]


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(FOLDER)))
def test_kernels_do_not_import_the_host(file):
    tree = ast.parse(file.read_text(encoding="utf-8"))
    imported = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "absolute imports only"
            imported.add(node.module)
            # Annotations as strings break the closures of kernel factories.
            assert node.module != "__future__"
    for name in imported:
        assert not name.startswith("warpcontact") or name.startswith("warpcontact.kernels"), name


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(FOLDER)))
def test_numbers_of_kernels_are_what_they_say(file):
    """Warp computes 1/3 of two literals in single precision, whatever it is handed to: ``wp.static`` does not."""

    def is_number(node):
        if isinstance(node, ast.UnaryOp):
            return is_number(node.operand)
        if isinstance(node, ast.BinOp):
            return is_number(node.left) and is_number(node.right)
        if isinstance(node, ast.Attribute):
            return ast.unparse(node) in ("wp.pi", "wp.e", "math.pi")
        return isinstance(node, ast.Constant) and isinstance(node.value, float)

    def computed(node):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "wp.static":
            return
        if isinstance(node, ast.BinOp) and is_number(node):
            yield ast.unparse(node)
        for inner in ast.iter_child_nodes(node):
            yield from computed(inner)

    for function in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(function, ast.FunctionDef):
            marks = map(ast.unparse, function.decorator_list)
            if any(mark.startswith(("wp.func", "wp.kernel")) for mark in marks):
                assert not list(computed(function)), function.name


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(FOLDER)))
def test_variables_of_kernels_are_no_constants(file):
    """After ``x = real(C)`` of a constant of that type Warp lets loops change C with x; ``x = C`` is a copy."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    cast = ("real", "wp.float64")
    constants = set()
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.value).startswith(
            tuple(f"wp.constant({name}(" for name in cast)
        ):
            constants |= {name.id for name in node.targets if isinstance(name, ast.Name)}
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.value, ast.Call)
            and ast.unparse(node.value.func) in cast
        ):
            assert not constants.intersection(map(ast.unparse, node.value.args)), ast.unparse(node)


def test_files_stay_short():
    host = Path(warpcontact.__file__).parent
    long = {
        str(file): count
        for folder in (host, FOLDER)
        for file in folder.rglob("*.py")
        if (count := len(file.read_text(encoding="utf-8").splitlines())) > 500
    }
    assert not long


def find_factories():
    """Every factory of kernels by precision, with further switches: whether bodies have motions, or roll."""
    for name in MODULES:
        module = importlib.import_module(name)
        for key, value in vars(module).items():
            if isinstance(value, functools._lru_cache_wrapper) and value.__module__ == name:
                names = value.__wrapped__.__code__.co_varnames[: value.__wrapped__.__code__.co_argcount]
                if names[:1] != ("real",) or not {"moves", "rolls"}.issuperset(names[1:]):
                    continue
                for switches in itertools.product((False, True), repeat=len(names) - 1):
                    label = "-".join(str(int(switch)) for switch in switches)
                    label = f"{name.removeprefix('warpcontact.kernels.')}.{key}{label and '-' + label}"
                    yield pytest.param(value, switches, id=label)


FACTORIES = list(find_factories())


@pytest.mark.parametrize("real", [wp.float32, wp.float64], ids=["float32", "float64"])
@pytest.mark.parametrize(("factory", "switches"), FACTORIES)
def test_every_kernel_compiles(factory, switches, real, device):
    made = factory(real, *switches)
    if isinstance(made, wp.Kernel):
        made.module.load(device)


@pytest.mark.parametrize("real", [wp.float32, wp.float64], ids=["float32", "float64"])
@pytest.mark.parametrize("law", wc.laws.CATALOGUE, ids=lambda law: law.__name__)
def test_every_law_compiles(law, real, device):
    contact_force.kernel(Parts(law), real).module.load(device)


@pytest.mark.parametrize("real", [wp.float32, wp.float64], ids=["float32", "float64"])
@pytest.mark.parametrize("friction", wc.frictions.CATALOGUE, ids=lambda friction: friction.__name__)
def test_every_friction_compiles(friction, real, device):
    contact_force.kernel(Parts(wc.laws.Hooke, friction), real).module.load(device)


def test_the_factories_are_found():
    assert len(FACTORIES) >= 8
