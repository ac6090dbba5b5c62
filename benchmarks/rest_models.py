"""Models of others whose bodies come to rest, and a common description of them.

A description is a dictionary of plain values in SI units, with quaternions (x, y, z, w):

    gravity    (3,) [m/s²]
    bodies     list of: name, position and orientation of the frame of its principal axes at its center of mass, mass, inertia (3,),
               linear_velocity and angular_velocity, world (3,)
    colliders  list of: body (number, or -1 for the world), kind, size, position, orientation in the frame of the body, friction,
               excluded (numbers of earlier colliders that it does not touch), and of a mesh vertices and faces

Sizes are those of MuJoCo: radius of a sphere; radius and half length of capsules and cylinders; half edges of boxes; semi-axes of
ellipsoids. Meshes are convex hulls of their vertices. This file needs NumPy only.
"""

import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Description = dict[str, Any]

#: Repositories, their revision and the folders of the models.
REPOSITORIES = {
    "mujoco": (
        "https://github.com/google-deepmind/mujoco",
        "a7255075b003506ff5f34b512d88e02df12a73c6",
        ("model", "test/engine/testdata"),
    ),
    "openusd": (
        "https://github.com/PixarAnimationStudios/OpenUSD",
        "c4d5d7846c9bed7c314398dfa22ac869f0e18c5e",
        ("pxr/usd/usdPhysics/examples",),
    ),
}
CONVEX = "test/engine/testdata/collision_convex"
EXAMPLES = "pxr/usd/usdPhysics/examples"


@dataclass(frozen=True)
class RestModel:
    """A model of others.

    Attributes:
        name: Name in the table.
        package: Key of ``REPOSITORIES``, or ``"newton"``: a file of the package.
        path: Path of the file.
        content: Bodies of the model.
        seconds: Time until the bodies are at rest [s].
        overlap: Whether bodies overlap at the start, so that they move apart, and impulses need a recovery time.
        compliant_dt: Time step of compliant contact [s]: 1/50 of the contact time, or as ``Simulation.check`` recommends at rest.
        contact_time: Duration of an impact in compliant contact [s]; longer if many solids of a body share its weight.
    """

    name: str
    package: str
    path: str
    content: str
    seconds: float = 4.0
    overlap: bool = False
    compliant_dt: float = 2e-4
    contact_time: float = 0.01


MODELS = (
    RestModel("box_boxmesh", "mujoco", f"{CONVEX}/box_boxmesh.xml", "mesh of a box on a box"),
    RestModel("long_box", "mujoco", f"{CONVEX}/long_box.xml", "mesh of a rod on a box", overlap=True),
    RestModel("cylinder_box", "mujoco", f"{CONVEX}/cylinder_box.xml", "disc on a box", overlap=True),
    RestModel("capsule_mesh", "mujoco", f"{CONVEX}/capsule_mesh.xml", "capsule on a mesh", overlap=True),
    RestModel(
        "stacked_boxes",
        "mujoco",
        f"{CONVEX}/stacked_boxes.xml",
        "18 meshes of boxes in a corner",
        compliant_dt=1e-4,
    ),
    RestModel("edge_edge", "mujoco", f"{CONVEX}/edge_edge.xml", "two slabs lean on each other"),
    RestModel(
        "planks",
        "mujoco",
        "test/engine/testdata/collision_driver/planks.xml",
        "six grids of 19 boxes in a stack",
        2.0,
        overlap=True,
        compliant_dt=6e-5,
        contact_time=0.02,
    ),
    RestModel("dominoes", "mujoco", "test/engine/testdata/sleep/contact.xml", "five boxes, one tips the others"),
    RestModel(
        "boxbox_duplicate", "mujoco", "test/engine/testdata/collision_box/boxbox_duplicate.xml", "box on a box"
    ),
    RestModel("orthographic", "mujoco", "test/engine/testdata/vis_visualize/orthographic.xml", "box on a plane"),
    RestModel(
        "boxes", "mujoco", "test/engine/testdata/vis_interact/boxes.xml", "three boxes on a plane", overlap=True
    ),
    RestModel("mug", "mujoco", "model/mug/mug.xml", "mug of 33 boxes and a cylinder on a plane"),
    RestModel(
        "cylinder",
        "mujoco",
        "model/replicate/cylinder.xml",
        "tubes of boxes, one leans on another",
        8.0,
        compliant_dt=5e-5,
    ),
    RestModel(
        "openusd_box_on_box", "openusd", f"{EXAMPLES}/usdPhysicsBoxOnBox.usda", "cube falls 5 m", overlap=True
    ),
    RestModel(
        "group_filtering",
        "openusd",
        f"{EXAMPLES}/usdPhysicsGroupFiltering.usda",
        "two cubes in a group",
        overlap=True,
    ),
    RestModel(
        "pair_filtering",
        "openusd",
        f"{EXAMPLES}/usdPhysicsPairFiltering.usda",
        "two cubes, a filtered pair",
        overlap=True,
    ),
    RestModel(
        "cube_cylinder", "newton", "tests/assets/cube_cylinder.usda", "mesh of a can falls on a mesh of a cube"
    ),
    RestModel("box_on_plane", "newton", "tests/assets/kamino/basics/box_on_plane.usda", "cube on a slab"),
)


def checkout(package: str, folder: Path) -> Path:
    """Returns a folder with the models of a repository, which are fetched at first use."""
    repository, revision, paths = REPOSITORIES[package]
    if not all((folder / path).is_dir() for path in paths):
        folder.mkdir(parents=True, exist_ok=True)
        for words in (
            ["init", "-q"],
            ["fetch", "-q", "--depth", "1", "--filter=blob:none", repository, revision],
            ["checkout", "-q", "FETCH_HEAD", "--", *paths],
        ):
            subprocess.run(["git", "-C", folder, *words], check=True)
    return folder


def matrix(quaternion: Array) -> Array:
    """Returns the rotation matrices (…, 3, 3) of quaternions (…, 4)."""
    x, y, z, w = np.moveaxis(np.asarray(quaternion) / np.linalg.norm(quaternion, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def bounds(description: Description, body: int) -> tuple[Array, Array]:
    """Returns the lower and upper corner of the bounding box of a body in its frame, (3,) each [m]."""
    points = []
    for one in description["colliders"]:
        if one["body"] != body:
            continue
        size = one["size"]
        if one["kind"] == "mesh":
            corners = np.array(one["vertices"])
        else:
            half = {
                "sphere": [size[0]] * 3,
                "capsule": [size[0], size[0], size[0] + size[1]],
                "cylinder": [size[0], size[0], size[1]],
            }.get(one["kind"], size)
            corners = np.stack(np.meshgrid(*([-1, 1],) * 3), axis=-1).reshape(-1, 3) * half
        points.append(corners @ matrix(one["orientation"]).T + one["position"])
    every = np.concatenate(points)
    return every.min(axis=0), every.max(axis=0)


def differences(description: Description, found: Array, expected: Array) -> tuple[float, float]:
    """Returns the largest difference of two sets of poses, relative to the size of each body: in height, and in any direction.

    The size is the largest edge of the bounding box of the body; compared are its corners.

    Args:
        description: Description of the model.
        found: Poses (bodies, 7).
        expected: Poses to compare with, (bodies, 7).
    """
    up = -np.array(description["gravity"]) / np.linalg.norm(description["gravity"])
    heights, distances = [], []
    for number in range(len(description["bodies"])):
        low, high = bounds(description, number)
        corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
        places = [corners @ matrix(pose[3:]).T + pose[:3] for pose in (found[number], expected[number])]
        apart = (places[0] - places[1]) / (high - low).max()
        heights.append(np.abs(apart @ up).max())
        distances.append(np.linalg.norm(apart, axis=1).max())
    return float(max(heights)), float(max(distances))
