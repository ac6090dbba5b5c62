"""The shape of catenaries over time, from where their ends are: readings do not have it."""

import numpy as np

from warpcontact.checks import Array
from warpcontact.couplings.elements import Catenary
from warpcontact.scene import Scene
from warpcontact.usd.replay import Replay

# Points of a line.
COUNT = 40


def line_curve(replay: Replay, line: Catenary, place_a: Array, place_b: Array) -> Array:
    """Returns points of ``line`` (time, env, n, 3), given its ends (time, env, 3), world [m].

    Every record of every environment is solved as an environment of a scene of that line alone.
    """
    scene = Scene()
    body = scene.add_body(1.0, (1.0, 1.0, 1.0), name="body")
    end_a = scene.add_point(None, (0.0, 0.0, 0.0), name="end_a")
    scene.add_catenary(
        end_a,
        scene.add_point(body, (0.0, 0.0, 0.0)),
        length=float(line.length),
        mass_per_length=float(line.mass_per_length),
        axial_stiffness=float(line.axial_stiffness),
        floor=None if line.floor is None else float(line.floor),
        name="line",
    )
    records, envs = place_a.shape[:2]
    model = scene.build(records * envs, device="cpu", precision="float64")
    model["end_a.position"] = place_a.reshape(-1, 3)
    model["body.position"] = place_b.reshape(-1, 3)
    model["scene.gravity"] = np.tile(replay.setting("scene.gravity", replay.scene.gravity), (records, 1))
    for key in ("length", "mass_per_length", "axial_stiffness", "floor"):
        if (value := getattr(line, key)) is not None:
            model[f"line.{key}"] = np.tile(replay.setting(f"{line.name}.{key}", value), records)
    return model.line_shape("line", COUNT).reshape(records, envs, COUNT, 3)
