"""Rest positions of a model in MuJoCo; runs in MuJoCo's interpreter.

    python rest_mujoco.py MODEL OUT SECONDS

MODEL is a model of MuJoCo, or a description as JSON (see ``rest_models.py``). OUT is a JSON file with the description, and poses and
speeds of the bodies after a time.
"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
from rest_models import Array, Description, matrix

KINDS = {
    getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"): kind
    for kind in ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
}


def scalar_last(rotation: Array) -> list[float]:
    """Returns the quaternion (x, y, z, w) of a rotation matrix."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return np.roll(quaternion, -1).tolist()


class Groups:
    """Bodies of a model that are welded together: one rigid body each.

    Attributes:
        numbers: Number of the rigid body of each body of the model; -1 for the world.
        masses: Mass of each rigid body [kg].
        inertias: Its principal moments of inertia [kg·m²].
        frames: Its center of mass and principal axes (columns) in the initial state.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model = model
        self._roots = [int(b) for b in range(1, model.nbody) if model.body_weldid[b] == b]
        self.numbers = [
            self._roots.index(root) if root else -1 for root in map(int, model.body_weldid[: model.nbody])
        ]
        self._start = [data.xmat[root].reshape(3, 3).copy() for root in self._roots]
        self.masses, self.inertias, self.frames = [], [], []
        for number in range(len(self._roots)):
            mass, center = self._center(number, data)
            inertia = np.zeros((3, 3))
            for b in self._members(number):
                axes, arm = data.ximat[b].reshape(3, 3), data.xipos[b] - center
                inertia += axes @ np.diag(model.body_inertia[b]) @ axes.T
                inertia += model.body_mass[b] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
            moments, axes = np.linalg.eigh(inertia)
            self.masses.append(float(mass))
            self.inertias.append(moments.tolist())
            self.frames.append((center, axes * np.sign(np.linalg.det(axes))))

    def _members(self, number: int) -> list[int]:
        return [b for b, own in enumerate(self.numbers) if own == number]

    def _center(self, number: int, data: mujoco.MjData) -> tuple[float, Array]:
        members = self._members(number)
        masses = self._model.body_mass[members]
        return masses.sum(), masses @ data.xipos[members] / masses.sum()

    def name(self, number: int) -> str:
        """Returns the name of a rigid body, that of its outermost body."""
        return self._model.body(self._roots[number]).name or f"body_{number}"

    def poses(self, data: mujoco.MjData) -> list[list[float]]:
        """Returns the poses (rigid bodies, 7) of the frames."""
        found = []
        for number, root in enumerate(self._roots):
            turn = data.xmat[root].reshape(3, 3) @ self._start[number].T
            found.append([*self._center(number, data)[1].tolist(), *scalar_last(turn @ self.frames[number][1])])
        return found


def describe(model: mujoco.MjModel, data: mujoco.MjData, groups: Groups) -> Description:
    """Returns the description of a compiled model in its initial state, with bodies at rest."""
    bodies = [
        {
            "name": groups.name(i),
            "position": pose[:3],
            "orientation": pose[3:],
            "mass": mass,
            "inertia": moments,
            "linear_velocity": [0.0] * 3,
            "angular_velocity": [0.0] * 3,
        }
        for i, (pose, mass, moments) in enumerate(
            zip(groups.poses(data), groups.masses, groups.inertias, strict=True)
        )
    ]
    solid = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    colliders = []
    for g in solid:
        body = groups.numbers[model.geom_bodyid[g]]
        center, axes = groups.frames[body] if body >= 0 else (np.zeros(3), np.eye(3))
        one = {
            "body": body,
            "kind": KINDS[mujoco.mjtGeom(model.geom_type[g])],
            "size": model.geom_size[g].tolist(),
            "position": (axes.T @ (data.geom_xpos[g] - center)).tolist(),
            "orientation": scalar_last(axes.T @ data.geom_xmat[g].reshape(3, 3)),
            "friction": float(model.geom_friction[g, 0]),
            "excluded": [
                i
                for i, other in enumerate(solid[: len(colliders)])
                if not model.geom_contype[g] & model.geom_conaffinity[other]
                and not model.geom_contype[other] & model.geom_conaffinity[g]
            ],
        }
        if one["kind"] == "mesh":
            mesh = model.mesh(int(model.geom_dataid[g]))
            vertices, faces = int(mesh.vertadr[0]), int(mesh.faceadr[0])
            one["vertices"] = model.mesh_vert[vertices : vertices + int(mesh.vertnum[0])].tolist()
            one["faces"] = model.mesh_face[faces : faces + int(mesh.facenum[0])].tolist()
        colliders.append(one)
    return {"gravity": model.opt.gravity.tolist(), "bodies": bodies, "colliders": colliders}


def model_of(description: Description) -> mujoco.MjModel:
    """Returns the compiled model of a description. Colliders of two bodies touch all of each other, or none."""
    spec = mujoco.MjSpec()
    spec.option.gravity = description["gravity"]
    frames = []
    for one in description["bodies"]:
        body = spec.worldbody.add_body(
            name=one["name"],
            pos=one["position"],
            quat=np.roll(one["orientation"], 1),
            mass=one["mass"],
            inertia=one["inertia"],
            ipos=(0, 0, 0),
            explicitinertial=True,
        )
        body.add_freejoint()
        frames.append(body)
    for number, one in enumerate(description["colliders"]):
        parent = frames[one["body"]] if one["body"] >= 0 else spec.worldbody
        words = {
            "name": f"collider_{number}",
            "type": getattr(mujoco.mjtGeom, f"mjGEOM_{one['kind'].upper()}"),
            "pos": one["position"],
            "quat": np.roll(one["orientation"], 1),
            "friction": (one["friction"], 0.005, 0.0001),
        }
        if one["kind"] == "mesh":
            mesh = spec.add_mesh(name=f"mesh_{number}")
            mesh.uservert = np.ravel(one["vertices"])
            words["meshname"] = f"mesh_{number}"
        else:
            words["size"] = (*one["size"], 0.0, 0.0, 0.0)[:3]
        parent.add_geom(**words)
    excluded = {
        (one["body"], description["colliders"][other]["body"])
        for one in description["colliders"]
        for other in one["excluded"]
    }
    for first, second in excluded:
        spec.add_exclude(
            bodyname1=description["bodies"][first]["name"], bodyname2=description["bodies"][second]["name"]
        )
    return spec.compile()


def set_velocities(model: mujoco.MjModel, data: mujoco.MjData, description: Description) -> None:
    """Sets the initial velocities of a description in a model that was compiled from it."""
    for number, one in enumerate(description["bodies"]):
        own = slice(6 * number, 6 * number + 6)
        turn = matrix(np.array(one["orientation"]))
        # Angular velocities of MuJoCo are in the axes of the body.
        data.qvel[own] = (*one["linear_velocity"], *(turn.T @ one["angular_velocity"]))


def main() -> None:
    """Writes the description and the poses after a time."""
    source, out, seconds = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3])
    if source.suffix == ".json":
        model = model_of(json.loads(source.read_text()))
    else:
        model = mujoco.MjModel.from_xml_path(str(source))
    data = mujoco.MjData(model)
    if source.suffix == ".json":
        set_velocities(model, data, json.loads(source.read_text()))
    mujoco.mj_forward(model, data)
    groups = Groups(model, data)
    description = describe(model, data, groups)
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    report = {
        "version": mujoco.__version__,
        "description": description,
        "poses": groups.poses(data),
        "speed": float(np.abs(data.qvel).max(initial=0.0)),
        "penetration": -float(data.contact.dist.min(initial=0.0)),
    }
    out.write_text(json.dumps(report), encoding="utf-8")


if __name__ == "__main__":
    main()
