"""Benchmark scenes of nonsmooth contact with MuJoCo: small spheres under boxes, soft constraints.

    python benchmarks/hard/peer.py --work table8 --envs 4096 --threads 2 --steps 500

For each line on standard input it runs once from the initial state and prints the duration [s]. At the end of the
input it prints quality figures of a run. Contacts have the default stiffness, damping and impedance, and elliptic
cones by default, like the friction of this engine.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import mujoco
import mujoco.rollout
import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))
from hard.works import DT, EDGE, FRICTION, GRAVITY, HEIGHT, MASS, RADIUS, WORKS, Work, residual

STEPS_AT_ONCE = 100  # rollouts store every state: long ones are limited by memory bandwidth
LOOKED_AT = 8  # environments that are sampled


def model(work: Work, cone: str) -> mujoco.MjModel:
    """Returns the model of a benchmark scene."""
    spec = mujoco.MjSpec()
    spec.option.timestep = DT
    spec.option.gravity = (0.0, 0.0, -GRAVITY)
    cones = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}
    spec.option.cone = cones[cone]
    contact = {"friction": (FRICTION, 0.0, 0.0), "condim": 3}
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=(20.0, 20.0, 1.0), contype=1, conaffinity=0, **contact
    )
    for number, place in enumerate(work.start()):
        body = spec.worldbody.add_body(pos=place, mass=MASS, inertia=work.inertia, explicitinertial=True)
        body.add_freejoint()
        # The feet of a box collide only with the next lower object: bit ``number`` marks the object under box
        # ``number``.
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=(EDGE / 2, EDGE / 2, HEIGHT / 2), mass=0.0,
            contype=2 << number, conaffinity=0, **contact,
        )  # fmt: skip
        for centre in work.places:
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(RADIUS, 0, 0), pos=centre, mass=0.0,
                contype=0, conaffinity=1 << number, **contact,
            )  # fmt: skip
    return spec.compile()


class Run:
    """Run of a benchmark scene."""

    def __init__(self, work: Work, envs: int, threads: int, cone: str) -> None:
        self._model = model(work, cone)
        self._data = [mujoco.MjData(self._model) for _ in range(threads)]
        self._pool = mujoco.rollout.Rollout(nthread=threads)
        size = mujoco.mj_stateSize(self._model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self._start = np.zeros((envs, size))
        nq = self._model.nq
        self._start[:, 1 : 1 + nq] = self._model.qpos0
        for number in range(work.boxes):
            self._start[:, 1 + nq + 6 * number : 4 + nq + 6 * number] = work.velocities(envs)
        self._states = np.zeros((envs, STEPS_AT_ONCE, size))

    def run(self, steps: int) -> float:
        """Runs from the initial state; returns the duration [s]."""
        state = self._start.copy()
        begin = time.perf_counter()
        for _ in range(steps // STEPS_AT_ONCE):
            self._pool.rollout(self._model, self._data, state, nstep=STEPS_AT_ONCE, state=self._states)
            state = self._states[:, -1].copy()
        return time.perf_counter() - begin

    def quality(self, steps: int, samples: int = 20) -> dict[str, float]:
        """Returns quality figures of runs of a few environments, sampled at regular intervals."""
        m, d = self._model, self._data[0]
        residuals, iterations, deepest, speeds = [], [], 0.0, []
        for start in self._start[:LOOKED_AT]:
            mujoco.mj_resetData(m, d)
            mujoco.mj_setState(m, d, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
            for step in range(steps):
                if step % (steps // samples) == steps // samples - 1:
                    residuals.append(self._residual())
                    iterations.append(int(d.solver_niter[0]))
                else:
                    mujoco.mj_step(m, d)
                if d.ncon:
                    deepest = min(deepest, float(d.contact.dist.min()))
            speeds.append(np.abs(d.qvel).max())
        return {
            "residual_median": float(np.median(residuals)),
            "residual_worst": float(np.max(residuals)),
            "iterations_mean": float(np.mean(iterations)),
            "penetration_m": -deepest,
            "speed_at_end_m_s": float(np.max(speeds)),
        }

    def _residual(self) -> float:
        """Takes a step; returns the residual of its contacts as a rigid contact problem."""
        m, d = self._model, self._data[0]
        mujoco.mj_step1(m, d)
        mujoco.mj_step2(m, d)
        after = d.qvel.copy()
        count = d.ncon
        J = np.zeros((3 * count, m.nv))
        impulses = np.zeros((count, 3))
        force = np.zeros(6)
        for number in range(count):
            contact = d.contact[number]
            mujoco.mj_contactForce(m, d, number, force)
            impulses[number] = DT * force[:3]
            frame = contact.frame.reshape(3, 3)
            for geom, sign in ((contact.geom[0], -1.0), (contact.geom[1], 1.0)):
                at_point = np.zeros((3, m.nv))
                mujoco.mj_jac(m, d, at_point, None, contact.pos, m.geom_bodyid[geom])
                J[3 * number : 3 * number + 3] += sign * frame @ at_point
        solved = np.zeros_like(J)
        mujoco.mj_solveM(m, d, solved, J)
        W = J @ solved.T
        return residual(W, (J @ after).reshape(-1, 3), impulses, FRICTION)


def main() -> None:
    """Runs once for every line of standard input."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", choices=WORKS, default="table8")
    parser.add_argument("--envs", type=int, default=4096)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--cone", choices=("elliptic", "pyramidal"), default="elliptic")
    options = parser.parse_args()
    run = Run(WORKS[options.work], options.envs, options.threads, options.cone)
    print(json.dumps({"version": mujoco.__version__}), flush=True)
    for _ in sys.stdin:
        print(json.dumps({"seconds": run.run(options.steps)}), flush=True)
    print(json.dumps(run.quality(options.steps)), flush=True)


if __name__ == "__main__":
    main()
