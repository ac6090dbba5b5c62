"""Rules of device code: imports, literals, constants, length of files; every kernel compiles."""

import ast
import functools
import importlib
import itertools
import pkgutil
from pathlib import Path

import pytest
import warp as wp
import warpcontact.kernels
from warpcontact.kernels.contact import contact_force
from warpcontact.kernels.contact.contact_evaluation import ContactModel

import warpcontact as wc

FOLDER = Path(warpcontact.kernels.__file__).parent
TREES = {
    str(file.relative_to(FOLDER)): ast.parse(file.read_text(encoding="utf-8"))
    for file in sorted(FOLDER.rglob("*.py"))
}


def test_kernels_do_not_import_the_host():
    found = []
    for file, tree in TREES.items():
        for node in ast.walk(tree):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                # Absolute imports only. Annotations as strings break the closures of kernel factories.
                if node.level or node.module == "__future__":
                    found.append((file, ast.unparse(node)))
                    continue
                names = [node.module]
            found += [
                (file, name)
                for name in names
                if name.startswith("warpcontact") and not name.startswith("warpcontact.kernels")
            ]
    assert not found


def test_code_that_depends_on_the_compiler_is_in_lowlevel():
    """Native snippets, compiler options and intrinsics: ``docs/lowlevel.md``."""
    words = ("func_native", "__builtin", "__attribute__", "asm volatile", "threadIdx", "_sync(", "compiler_flags")
    found = [
        (file, word)
        for file in TREES
        if not file.startswith("lowlevel")
        for word in words
        if word in (FOLDER / file).read_text(encoding="utf-8")
    ]
    assert not found


def test_device_functions_have_no_arithmetic_on_literals():
    """Warp computes 1/3 of two literals in single precision for any result type; ``wp.static`` does not."""

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

    found = []
    for file, tree in TREES.items():
        for function in ast.walk(tree):
            if isinstance(function, ast.FunctionDef):
                marks = map(ast.unparse, function.decorator_list)
                if any(mark.startswith(("wp.func", "wp.kernel")) for mark in marks):
                    found += [(file, function.name, term) for term in computed(function)]
    assert not found


def test_kernel_variables_are_not_initialized_by_a_cast_constant():
    """After ``x = real(C)`` with a constant of that type, loops in Warp change C with x; ``x = C`` is a copy."""
    cast = ("real", "wp.float64")
    found = []
    for file, tree in TREES.items():
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
                and constants.intersection(map(ast.unparse, node.value.args))
            ):
                found.append((file, ast.unparse(node)))
    assert not found


#: Longest source file. The aim is 500.
MAX_LINES = 600


def test_source_files_are_short():
    host = Path(warpcontact.__file__).parent
    long = {
        str(file): count
        for folder in (host, FOLDER)
        for file in folder.rglob("*.py")
        if (count := len(file.read_text(encoding="utf-8").splitlines())) > MAX_LINES
    }
    assert not long


def find_factories():
    """Yields every kernel factory by precision with its switches: whether bodies have joints, and rolling."""
    for _, name, _ in pkgutil.walk_packages([str(FOLDER)], "warpcontact.kernels."):
        module = importlib.import_module(name)
        for key, value in vars(module).items():
            if isinstance(value, functools._lru_cache_wrapper) and value.__module__ == name:
                names = value.__wrapped__.__code__.co_varnames[: value.__wrapped__.__code__.co_argcount]
                if names[:1] != ("real",) or not {"has_joints", "rolls"}.issuperset(names[1:]):
                    continue
                for switches in itertools.product((False, True), repeat=len(names) - 1):
                    yield f"{name}.{key}", value, switches


PRECISIONS = [
    pytest.param(wp.float32, id="float32"),
    pytest.param(wp.float64, id="float64", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("real", PRECISIONS)
def test_every_kernel_compiles(real, device):
    found = list(find_factories())
    assert len(found) >= 50
    for name, factory, switches in found:
        made = factory(real, *switches)
        if isinstance(made, wp.Kernel):
            try:
                made.module.load(device)
            except Exception as error:
                raise AssertionError(f"{name}{switches}") from error


@pytest.mark.slow
@pytest.mark.parametrize("real", [wp.float32, wp.float64], ids=["float32", "float64"])
def test_every_law_and_friction_model_compiles(real, device):
    for law in wc.laws.CATALOGUE:
        contact_force.kernel(ContactModel(law), real).module.load(device)
    for friction in wc.friction.CATALOGUE:
        contact_force.kernel(ContactModel(wc.laws.Hooke, friction), real).module.load(device)
