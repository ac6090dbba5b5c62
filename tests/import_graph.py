"""The imports of the package, read from its source: used by ``test_import_graph.py`` and ``docs/package_graph.py``."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import warpcontact
from warpcontact import kernels

HOST = Path(warpcontact.__file__).parent
KERNELS = Path(kernels.__file__).parent


def modules() -> dict[str, Path]:
    """Returns the file of each module, by its name below ``warpcontact``."""
    found = {}
    for root, prefix in ((HOST, ""), (KERNELS, "kernels.")):
        for path in sorted(root.rglob("*.py")):
            if root == HOST and path.is_relative_to(KERNELS):
                continue
            name = ".".join(path.relative_to(root).with_suffix("").parts).removesuffix("__init__").rstrip(".")
            found[(prefix + name).rstrip(".")] = path
    return found


def imported(tree: ast.Module) -> Iterator[str]:
    """Iterates over the names that a module imports, without those for type checkers only."""
    nodes: list[ast.AST] = [tree]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            nodes += node.orelse
        elif isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            yield from (f"{node.module}.{one.name}" for one in node.names)
        else:
            nodes += ast.iter_child_nodes(node)


def import_graph() -> dict[str, set[str]]:
    """Returns the modules that each module imports, without the package roots and the version."""
    files = modules()
    edges: dict[str, set[str]] = defaultdict(set)
    for name, path in files.items():
        for target in imported(ast.parse(path.read_text(encoding="utf-8"))):
            if target.startswith("warpcontact."):
                own = target.removeprefix("warpcontact.")
                module = own if own in files else own.rpartition(".")[0]
                if module in files and module not in ("", "_version", "kernels", name):
                    edges[name].add(module)
    return edges


def package(module: str) -> str:
    """Returns the package of a module; device code outside of packages is in "types"."""
    first, _, rest = module.partition(".")
    if first != "kernels":
        return first
    return rest.partition(".")[0] if (KERNELS / rest.partition(".")[0]).is_dir() else "types"
