"""Rest positions of a model in MuJoCo; runs in MuJoCo's interpreter.

    python rest_mujoco.py MODEL OUT SECONDS

MODEL is a model of MuJoCo, or a description as JSON (see ``rest_models.py``). OUT is a JSON file with the description, and poses and
speeds of the bodies after a time. Poses of ``VARIANTS`` show whether MuJoCo determines them: from a disturbed start, with half of the
time step, with the other friction cone (elliptic or pyramidal), and with half of the time constant of contact.
"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
from rest_models import Array, Description, bounds, matrix

KINDS = {
    getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"): kind
    for kind in ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
}


def scalar_last(rotation: Array) -> list[float]:
    """Returns the quaternion (x, y, z, w) of a rotation matrix."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return np.roll(quaternion, -1).tolist()


#: Disturbance of the start, relative to the size of each body, and in radians.
DISTURBANCE = 1.0e-6
#: Other runs of a model.
VARIANTS = ("disturbed", "half_step", "other_cone", "half_contact_time")


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


def disturb(model: mujoco.MjModel, data: mujoco.MjData, groups: Groups, description: Description) -> None:
    """Moves and turns each body at random by ``DISTURBANCE`` of its size, and as many radians."""
    random = np.random.default_rng(0)
    for joint in range(model.njnt):
        if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
            continue
        low, high = bounds(description, groups.numbers[model.jnt_bodyid[joint]])
        start = model.jnt_qposadr[joint]
        data.qpos[start : start + 3] += DISTURBANCE * (high - low).max() * random.uniform(-1.0, 1.0, 3)
        mujoco.mju_quatIntegrate(data.qpos[start + 3 : start + 7], random.uniform(-1.0, 1.0, 3), DISTURBANCE)


def vary(model: mujoco.MjModel, name: str) -> None:
    """Applies one of ``VARIANTS`` to the options of a model."""
    if name == "other_cone":
        model.opt.cone = 1 - model.opt.cone
    if name == "half_contact_time":
        # Negative values are a stiffness. The time constant must be at least two time steps.
        model.geom_solref[:, 0] = np.where(model.geom_solref[:, 0] > 0.0, 0.5, 1.0) * model.geom_solref[:, 0]
    if name in ("half_step", "half_contact_time"):
        model.opt.timestep *= 0.5


def load(source: Path) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Returns a model and its initial state, from a model of MuJoCo or a description."""
    given = json.loads(source.read_text()) if source.suffix == ".json" else None
    model = mujoco.MjModel.from_xml_path(str(source)) if given is None else model_of(given)
    data = mujoco.MjData(model)
    if given is not None:
        set_velocities(model, data, given)
    mujoco.mj_forward(model, data)
    return model, data


def come_to_rest(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> None:
    """Steps a model for a time [s] and evaluates its final state."""
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)


def main() -> None:
    """Writes the description, and the poses after a time, of the model and of its variants."""
    source, out, seconds = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3])
    model, data = load(source)
    groups = Groups(model, data)
    description = describe(model, data, groups)
    come_to_rest(model, data, seconds)
    variants = {}
    for name in VARIANTS:
        other, state = load(source)
        vary(other, name)
        if name == "disturbed":
            disturb(other, state, groups, description)
        come_to_rest(other, state, seconds)
        variants[name] = groups.poses(state)
    report = {
        "version": mujoco.__version__,
        "description": description,
        "poses": groups.poses(data),
        "variants": variants,
        "speed": float(np.abs(data.qvel).max(initial=0.0)),
        "penetration": -float(data.contact.dist.min(initial=0.0)),
    }
    out.write_text(json.dumps(report), encoding="utf-8")


if __name__ == "__main__":
    main()
