"""Draws the packages and their imports, as computed from the source: ``docs/images/packages.svg``.

    python docs/package_graph.py

Host packages are on the left, packages of kernels on the right. A package is drawn one level above the highest package
that it imports. An arrow leads to a package that it imports; arrows that follow from others are omitted.
"""

import ast
import sys
import textwrap
from collections import defaultdict
from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from import_graph import import_graph, package  # noqa: E402

#: File of the drawing.
PICTURE = ROOT / "docs" / "images" / "packages.svg"
COLUMN, HEIGHT, LEVEL = 6.6, 0.42, 0.6  # widths, and the distance between levels, in inches
CHARACTERS = 15.5  # characters per inch of the smaller text
FILL, LINE = "#eef3f8", "#5b7083"


def package_imports(*, device: bool) -> dict[str, set[str]]:
    """Returns the packages that each package imports: packages of kernels if ``device``, else of the host."""
    edges: dict[str, set[str]] = defaultdict(set)
    for module, targets in import_graph().items():
        if module.startswith("kernels") != device or module in ("", "__main__", "kernels"):
            continue
        own = package(module)
        edges[own] |= {package(one) for one in targets if one.startswith("kernels") == device} - {own}
    return dict(edges)


def reachable(edges: dict[str, set[str]], start: str) -> set[str]:
    """Returns all packages that a package imports, directly or not."""
    found: set[str] = set()
    pending = list(edges.get(start, ()))
    while pending:
        one = pending.pop()
        if one not in found:
            found.add(one)
            pending += edges.get(one, ())
    return found


def reduced(edges: dict[str, set[str]]) -> dict[str, set[str]]:
    """Returns the transitive reduction of an acyclic graph."""
    return {
        one: {
            target
            for target in targets
            if not any(target in reachable(edges, other) for other in targets - {target})
        }
        for one, targets in edges.items()
    }


def levels(edges: dict[str, set[str]]) -> list[list[str]]:
    """Returns the packages by level, lowest first: the length of the longest chain of imports below."""
    depth: dict[str, int] = {}

    def depth_of(one: str) -> int:
        if one not in depth:
            depth[one] = 1 + max((depth_of(target) for target in edges.get(one, ())), default=-1)
        return depth[one]

    names = set(edges).union(*edges.values())
    rows: list[list[str]] = [[] for _ in range(1 + max(map(depth_of, names)))]
    for name in sorted(names):
        rows[depth[name]].append(name)
    return rows


def description() -> str:
    """Returns what is drawn, as text: the packages of each level and the arrows."""
    lines = []
    for device in (False, True):
        edges = package_imports(device=device)
        lines += [" ".join(row) for row in levels(edges)]
        lines += [
            f"{one} > {' '.join(sorted(targets))}" for one, targets in sorted(reduced(edges).items()) if targets
        ]
    return "; ".join(lines)


def purpose(folder: str, name: str) -> str:
    """Returns the first sentence of the docstring of a package."""
    file = ROOT / folder / name / "__init__.py"
    if not file.is_file():
        file = ROOT / folder / f"{name}.py"
    text = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0].partition(". ")[0].rstrip(".").replace("`", "")


def draw(picture: Path) -> None:
    """Writes the drawing as an SVG file."""
    mpl.rcParams["svg.hashsalt"] = "packages"
    mpl.rcParams["svg.fonttype"] = "none"
    columns = [("warpcontact/: host", "warpcontact", False), ("kernels/: device", "kernels", True)]
    graphs = [package_imports(device=device) for _, _, device in columns]
    tallest = max(len(levels(edges)) for edges in graphs)
    size = (2.0 * COLUMN, LEVEL * tallest + 0.4)
    figure = Figure(figsize=size)
    FigureCanvasSVG(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, size[0]), ylim=(-0.5 * LEVEL, size[1] - 0.5 * LEVEL))
    axes.set_axis_off()
    for number, ((title, folder, _), edges) in enumerate(zip(columns, graphs, strict=True)):
        middle = (number + 0.5) * COLUMN
        axes.text(
            middle, size[1] - 0.5 * LEVEL - 0.2, title, ha="center", va="center", fontsize=13, fontweight="bold"
        )
        place = {}
        for level, row in enumerate(levels(edges)):
            width = 0.97 * COLUMN / len(row)
            for index, name in enumerate(row):
                center = middle + (index - 0.5 * (len(row) - 1)) * width
                place[name] = (center, level * LEVEL, min(width - 0.15, 4.6))
        for name, (center, height, width) in place.items():
            corner = (center - 0.5 * width, height - 0.5 * HEIGHT)
            style = "round,pad=0,rounding_size=0.06"
            axes.add_patch(
                FancyBboxPatch(corner, width, HEIGHT, boxstyle=style, facecolor=FILL, edgecolor=LINE, zorder=2)
            )
            axes.text(
                center, height + 0.09, name, ha="center", va="center", fontsize=10, fontweight="bold", zorder=3
            )
            text = textwrap.shorten(purpose(folder, name), int(CHARACTERS * width), placeholder=" …")
            axes.text(center, height - 0.1, text, ha="center", va="center", fontsize=7.5, zorder=3)
            for target in sorted(reduced(edges).get(name, ())):
                ends = (center, height - 0.5 * HEIGHT), (place[target][0], place[target][1] + 0.5 * HEIGHT)
                arrow = FancyArrowPatch(
                    *ends, arrowstyle="-|>", mutation_scale=8, color=LINE, shrinkA=0, shrinkB=0
                )
                axes.add_patch(arrow)
    figure.savefig(picture, metadata={"Date": None, "Description": description()})


if __name__ == "__main__":
    draw(PICTURE)
