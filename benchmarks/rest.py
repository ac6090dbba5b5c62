"""Compares where bodies come to rest with MuJoCo, for models and stages of others.

    python benchmarks/rest.py
    python benchmarks/rest.py --models mug planks
    python benchmarks/rest.py --checkouts PATH                  # folder with checkouts of ``REPOSITORIES``

Models of MuJoCo are converted to stages with UsdPhysics, and stages of others to MuJoCo. Both engines start from the same poses, with
the same masses and coefficients of friction, without restitution. This engine reads the stage as a user would, with
``Scene.from_usd``, and takes nonsmooth contact in steps of 2 ms, and compliant contact. It also starts at rest from MuJoCo's final poses
and holds them. MuJoCo's own result counts as reproducible if a disturbed start and other options move no corner of a body by more than
1 % of its size. Files of others are not part of this repository.
"""

import argparse
import json
import os
import subprocess
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import rest_model_stages
import rest_models
import warp as wp
from environments import CACHE, interpreter
from rest_models import MODELS, Array, Description, RestModel
from result_file import default_path, write
from scipy.spatial.transform import Rotation

import warpcontact as wc
from warpcontact.benchmark.facts import facts

NONSMOOTH_DT = 2e-3  # s
RECOVERY_TIME = 0.05  # of models that start with overlap [s]
HOLD = 1.0  # duration of runs from MuJoCo's final poses [s]
TOLERANCE = 0.01  # of the size of a body


def packaged(path: str, python: Path) -> Path:
    """Returns the path of a file of the package Newton."""
    words = [
        python,
        "-c",
        "import importlib.util as u; print(u.find_spec('newton').submodule_search_locations[0])",
    ]
    return Path(subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()) / path


def poses_of(model: wc.Model, description: Description, start: Array) -> Array:
    """Returns the poses (bodies, 7) of the frames of a description.

    Args:
        model: Model with the bodies of the description.
        description: The description.
        start: Initial orientations of the bodies of the model, (bodies, 4).
    """
    found = np.empty((len(start), 7))
    for number, body in enumerate(model.scene.bodies):
        turn = (
            Rotation.from_quat(model.sensor(f"{body.name}.orientation")[0])
            * Rotation.from_quat(start[number]).inv()
        )
        found[number, :3] = model.sensor(f"{body.name}.position")[0]
        found[number, 3:] = (turn * Rotation.from_quat(description["bodies"][number]["orientation"])).as_quat()
    return found


def settled(
    path: Path, one: RestModel, description: Description, *, nonsmooth: bool, poses: Array | None = None
) -> tuple[Array, dict[str, float]]:
    """Returns the poses of the bodies of a stage after the time of its model, the largest speed and the number of unstable steps.

    Args:
        path: The stage.
        one: Its model.
        description: Its description.
        nonsmooth: Whether contact is nonsmooth.
        poses: Poses (bodies, 7) at which bodies start at rest for ``HOLD`` seconds; ``None``: those of the stage.
    """
    scene = wc.Scene.from_usd(path, trusted=True, contact_time=one.contact_time)
    model = scene.build(device="cpu", precision="float64")
    for name in model.parameters_by_name:
        if name.endswith(".law.restitution"):
            # Contacts of MuJoCo are critically damped.
            model[name] = 0.01 if nonsmooth else np.exp(-2.0)
    start = np.array([body.orientation for body in scene.bodies])
    if poses is not None:
        set_poses(model, description, start, poses)
    dt = NONSMOOTH_DT if nonsmooth else one.compliant_dt
    # Bodies at rest in MuJoCo overlap by some micrometers, which remain.
    recovery = RECOVERY_TIME if one.overlap and poses is None else None
    method = wc.integrators.MoreauJean(recovery_time=recovery) if nonsmooth else None
    wc.Simulation(model, dt=dt, integrator=method).step(round((one.seconds if poses is None else HOLD) / dt))
    speeds = [
        np.abs(model.sensor(f"{body.name}.{key}")).max()
        for body in scene.bodies
        for key in ("linear_velocity", "angular_velocity")
    ]
    figures = {"speed": float(max(speeds))}
    if not nonsmooth:
        figures["unstable_steps"] = max(
            int(model.sensor(f"{contact.name}.unstable_steps").max()) for contact in scene.body_contacts
        )
    return poses_of(model, description, start), figures


def set_poses(model: wc.Model, description: Description, start: Array, poses: Array) -> None:
    """Sets poses (bodies, 7) of the frames of a description, without velocity; see ``poses_of`` for ``start``."""
    for number, body in enumerate(model.scene.bodies):
        own = Rotation.from_quat(description["bodies"][number]["orientation"])
        turn = Rotation.from_quat(poses[number, 3:]) * own.inv()
        model[f"{body.name}.position"] = poses[number, :3]
        model[f"{body.name}.orientation"] = (turn * Rotation.from_quat(start[number])).as_quat()
        model[f"{body.name}.linear_velocity"] = model[f"{body.name}.angular_velocity"] = np.zeros(3)


def compare(one: RestModel, file: Path, python: Path, folder: Path) -> dict[str, Any]:
    """Returns the figures of a model.

    Args:
        one: The model.
        file: Its file.
        python: MuJoCo's interpreter.
        folder: Folder for temporary files.
    """
    source, out = file, folder / f"{one.name}_rest.json"
    if file.suffix != ".xml":
        source = folder / f"{one.name}.json"
        described = rest_model_stages.describe(wc.Scene.from_usd(file, trusted=True))
        source.write_text(json.dumps(described), encoding="utf-8")
    script = Path(__file__).with_name("rest_mujoco.py")
    subprocess.run([python, script, source, out, str(one.seconds)], check=True)
    peer = json.loads(out.read_text(encoding="utf-8"))
    description = peer["description"]
    stage = file
    if file.suffix == ".xml":
        stage = folder / f"{one.name}.usda"
        stage.write_text(rest_model_stages.stage(description), encoding="utf-8")
    figures: dict[str, Any] = {
        "model": one.name,
        "source": f"{one.package}/{one.path}",
        "content": one.content,
        "bodies": len(description["bodies"]),
        "mujoco": {"version": peer["version"], "speed": peer["speed"], "penetration_m": peer["penetration"]},
    }
    expected = np.array(peer["poses"])
    variants = {
        name: rest_models.differences(description, np.array(poses), expected)[1]
        for name, poses in peer["variants"].items()
    }
    figures["mujoco"] |= {"variants": variants, "reproducible": max(variants.values()) < TOLERANCE}
    for name, nonsmooth in (("nonsmooth", True), ("compliant", False)):
        found, others = settled(stage, one, description, nonsmooth=nonsmooth)
        height, place = rest_models.differences(description, found, expected)
        held, _ = settled(stage, one, description, nonsmooth=nonsmooth, poses=expected)
        moved = rest_models.differences(description, held, expected)[1]
        figures[name] = {"height": height, "place": place, "held": moved, **others}
    return figures


def main() -> None:
    """Prints a table and writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [one.name for one in MODELS]
    parser.add_argument("--models", nargs="+", choices=names, default=names, metavar="MODEL")
    parser.add_argument("--checkouts", type=Path, help="folder of checkouts; by default in the cache")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder of virtual environments and models")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    warnings.simplefilter("ignore")  # about overlap at the start
    mujoco, newton = (interpreter(name, options.cache) for name in ("mujoco", "newton"))
    results = []
    print(
        f"{'model':18} {'bodies':>6}   largest difference in height (in any direction), relative to the size of the body"
    )
    with tempfile.TemporaryDirectory() as folder:
        for one in MODELS:
            if one.name not in options.models:
                continue
            if one.package == "newton":
                file = packaged(one.path, newton)
            else:
                folders = options.checkouts or options.cache / "rest_models"
                file = rest_models.checkout(one.package, folders / one.package) / one.path
            figures = compare(one, file, mujoco, Path(folder))
            results.append(figures)
            text = "   ".join(
                f"{name} {figures[name]['height']:.3%} ({figures[name]['place']:.3%}), held {figures[name]['held']:.3%}"
                for name in ("nonsmooth", "compliant")
            )
            print(
                f"{one.name:18} {figures['bodies']:6}   {text}   MuJoCo itself {max(figures['mujoco']['variants'].values()):.3%}",
                flush=True,
            )
    about = facts("cpu", os.cpu_count() or 1)
    write(options.out or default_path("rest", "cpu", about), {"about": about, "results": results})


if __name__ == "__main__":
    main()
