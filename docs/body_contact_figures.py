"""Draws the figures of body contact, ``docs/images/body_contact_*``.

python docs/body_contact_figures.py
"""

from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import warpcontact as wc

IMAGES = Path(__file__).resolve().parent / "images"
FIRST, SECOND, FORCE = "#4c78a8", "#c9ced6", "#c0392b"


def arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Draws the arrow of a force or a depth."""
    axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": FORCE, "shrinkA": 0, "shrinkB": 0})


def panel(axes: Axes, title: str) -> None:
    """Prepares a drawing without axes and with equal scales."""
    axes.set_title(title, fontsize=10)
    axes.set_aspect("equal")
    axes.set_axis_off()


def columns(figure: Figure) -> None:
    """Draws columns on a face: a flat contact, an edge on a face, and a side wall that is sunk."""
    flat, edge, strip = figure.subplots(1, 3)
    for axes in (flat, edge, strip):
        axes.fill([-2, 2, 2, -2], [0, 0, -1.2, -1.2], color=SECOND)
    panel(flat, "face on face")
    flat.fill([-1.2, 1.2, 1.2, -1.2], [-0.3, -0.3, 1.4, 1.4], color=FIRST, alpha=0.55)
    for x in np.linspace(-1.1, 1.1, 9):
        arrow(flat, (x, -0.3), (x, 0.0))
    flat.text(0.0, 0.5, "t = δ", ha="center")
    panel(edge, "edge on face")
    tip = np.array([[0.0, -0.7], [1.5, 0.8], [0.0, 2.3], [-1.5, 0.8]])
    edge.fill(*tip.T, color=FIRST, alpha=0.55)
    for x in np.linspace(-0.6, 0.6, 9):
        arrow(edge, (x, abs(x) - 0.7), (x, 0.0))
    edge.text(0.0, 0.5, "normals of the flat face", ha="center", fontsize=9)
    panel(strip, "box in a pocket: the side wall is sunk, too")
    strip.fill([-2, -1.4, -1.4, -2], [0, 0, 1.0, 1.0], color=SECOND)
    strip.fill([-1.43, 0.9, 0.9, -1.43], [-0.3, -0.3, 1.4, 1.4], color=FIRST, alpha=0.55)
    for x in np.linspace(-1.25, 0.8, 8):
        arrow(strip, (x, -0.3), (x, 0.0))
    for y in np.linspace(0.1, 0.9, 4):
        strip.plot([-1.4, 0.9], [y, y], color="black", linewidth=0.7, linestyle=":")
    strip.text(-0.2, 0.5, "t > 4 D: weight 0", ha="center", fontsize=9, backgroundcolor="#ffffffc0")


def weight(figure: Figure) -> None:
    """Plots the weight of a column over its length, and the share of the second solid over the flatness of the first."""
    left, right = figure.subplots(1, 2)
    ratio = np.linspace(0.0, 5.0, 501)
    x = np.clip((ratio - 2.0) / 2.0, 0.0, 1.0)
    left.plot(ratio, 1.0 - x * x * (3.0 - 2.0 * x), color=FIRST)
    left.set(xlabel="t/D", ylabel="weight w of a column", xlim=(0, 5), ylim=(0, 1.05))
    c = np.linspace(0.0, 1.0, 101)
    right.plot(c, c, color=FIRST)
    right.set(xlabel="c₁/(c₁ + c₂)", ylabel="share α", xlim=(0, 1), ylim=(0, 1.05))
    for at, text in (
        (0.03, "edge of the second\non a face of the first"),
        (0.97, "edge of the first\non a face of the second"),
    ):
        right.annotate(
            text, (at, at), (at, 0.55 if at < 0.5 else 0.45), ha="left" if at < 0.5 else "right", fontsize=8
        )
    for axes in (left, right):
        axes.grid(alpha=0.3)


def edge(figure: Figure) -> None:
    """Draws the path on which a face moves off an edge, and the energy that is lost."""
    axes_list = figure.subplots(1, 3)
    for axes, shift, lift, title in zip(
        axes_list,
        (0.0, 1.0, 1.0),
        (0.0, 0.0, 0.5),
        ("1 press: work ½ k δ² A", "2 slide: work 0", "3 lift: work regained ½ k δ² (A − ΔA)"),
        strict=True,
    ):
        panel(axes, title)
        axes.fill([-1.5, 1.0, 1.0, -1.5], [0, 0, -1.2, -1.2], color=SECOND)
        low = -0.25 + lift
        axes.fill(
            np.array([-1.0, 1.0, 1.0, -1.0]) + shift, [low, low, low + 1.0, low + 1.0], color=FIRST, alpha=0.55
        )
        if lift == 0.0:
            for x in np.arange(-0.9 + shift, 1.0, 0.2):
                arrow(axes, (x, low), (x, 0.0))
        axes.set(xlim=(-1.7, 2.3), ylim=(-1.3, 1.7))
    axes_list[1].annotate("ΔA", (1.5, -0.25), (1.5, -0.8), ha="center", arrowprops={"arrowstyle": "-"})


FIGURES: dict[str, tuple[Callable[[Figure], None], tuple[float, float]]] = {
    "columns": (columns, (10.0, 3.0)),
    "weight": (weight, (8.0, 2.8)),
    "edge": (edge, (10.0, 2.6)),
}


def pressure(path: Path) -> None:
    """Draws bodies at rest: the areas between them are colored by pressure."""
    scene = wc.Scene()
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    material = wc.ContactMaterial(
        law=wc.laws.ElasticFoundation(stiffness=2e6, damping=20.0),
        friction=wc.friction.CundallStrack(mu_static=0.6, mu_dynamic=0.6, stiffness=2e4, damping=80.0),
    )
    box = wc.shapes.RoundedBox((0.05, 0.05, 0.05))
    bodies = (
        ("low", box, (0.0, 0.0, 0.0485), (0.0, 0.0, 0.0)),
        ("high", box, (0.03, 0.01, 0.1475), (0.0, 0.0, 25.0)),
        ("pushed", box, (-0.2, 0.0, 0.0495), (0.0, 0.0, 0.0)),
        ("lying", wc.shapes.Cylinder(0.04, 0.06), (0.2, -0.03, 0.0385), (90.0, 0.0, 50.0)),
        ("ball", wc.shapes.Sphere(0.045), (0.14, 0.17, 0.042), (0.0, 0.0, 0.0)),
    )
    solids = {"floor": floor}
    for name, kind, position, angles in bodies:
        turned = Rotation.from_euler("xyz", angles, degrees=True).as_quat()
        body = scene.add_body(mass=1.0, inertia=(1e-3,) * 3, position=position, orientation=turned, name=name)
        solids[name] = scene.add_shape(body, kind, name=f"{name}_shape")
        below = solids["low" if name == "high" else "floor"]
        scene.add_body_contact(solids[name], below, material, name=f"{name}_contact")
    model = scene.build(envs=1, device="cpu", precision="float64")
    model["pushed.external_torque"] = (0.0, 0.25, 0.0)
    recording = wc.Simulation(model, dt=2e-4).run(1.5, every=0.5)
    wc.render(recording, path, size=(900, 480), samples=64, view_from=(-60, 22))


def main() -> None:
    """Writes the figures as SVG files, and the picture of pressures."""
    pressure(IMAGES / "body_contact_pressure.png")
    mpl.rcParams["svg.hashsalt"] = "body_contact"
    mpl.rcParams["svg.fonttype"] = "none"
    for name, (draw, size) in FIGURES.items():
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        figure.savefig(IMAGES / f"body_contact_{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
