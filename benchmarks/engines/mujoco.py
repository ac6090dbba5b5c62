"""MuJoCo: environments distributed over its thread pool."""

from typing import Any

import body_contact_benchmark_scenes
import mujoco
import mujoco.rollout
import numpy as np
from benchmark_scenes import BenchmarkScene, sanity
from body_contact_benchmark_scenes import AT_REST, Bin, Rolling
from nonsmooth_benchmark_scenes import DT, FRICTION, SAMPLES, NonsmoothScene, residual

from engines import mjcf

PACKAGES = ("mujoco", "numpy")

STEPS_AT_ONCE = 100  # rollouts store every state: long ones are limited by memory bandwidth
SAMPLED_ENVS = 8  # environments in which residuals are computed


class Rollouts:
    """Common part of all runs: rollouts of a model.

    Args:
        model: The model.
        positions: Initial ``qpos``, ``(envs, nq)``.
        velocities: Initial ``qvel``, ``(envs, nv)``.
        threads: Number of threads.
    """

    def __init__(self, model: mujoco.MjModel, positions: np.ndarray, velocities: np.ndarray, threads: int) -> None:
        self._model = model
        self._data = [mujoco.MjData(model) for _ in range(threads)]
        self._pool = mujoco.rollout.Rollout(nthread=threads)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self._start = np.zeros((len(positions), size))
        self._start[:, 1 : 1 + model.nq] = positions
        self._start[:, 1 + model.nq : 1 + model.nq + model.nv] = velocities
        self._states = np.zeros((len(positions), STEPS_AT_ONCE, size))
        self.reset()

    def reset(self) -> None:
        self._state = self._start.copy()

    def step(self, count: int) -> None:
        while count:
            steps = min(count, STEPS_AT_ONCE)
            out = self._states if steps == STEPS_AT_ONCE else np.zeros_like(self._states[:, :steps])
            self._pool.rollout(self._model, self._data, self._state, nstep=steps, state=out)
            self._state = out[:, -1].copy()
            count -= steps

    def wait(self) -> None:
        pass

    def notes(self) -> dict[str, Any]:
        return {}


class Run(Rollouts):
    """Run of a benchmark scene; see the package."""

    def __init__(self, scene: BenchmarkScene, envs: int, device: str, threads: int, variant: str) -> None:
        self._scene = scene
        model = mjcf.model(scene)
        super().__init__(model, mjcf.start(scene, envs), np.zeros((envs, model.nv)), threads)

    def sanity(self, steps: int) -> dict[str, float]:
        poses = self._state[:, 1 : 1 + self._model.nq].reshape(len(self._state), self._scene.bodies, 7)
        return sanity(self._scene, poses[..., :3])


class BodyContactRun(Rollouts):
    """Run of a benchmark scene of body contact; see the package."""

    def __init__(self, scene: Bin | Rolling, envs: int, device: str, threads: int, variant: str) -> None:
        self._scene = scene
        model = mjcf.body_contact_model(scene)
        positions = mjcf.scalar_first(scene.start(envs)).reshape(envs, -1)
        super().__init__(model, positions, scene.velocities(envs).reshape(envs, -1), threads)

    def sanity(self, steps: int) -> dict[str, float]:
        self.reset()
        self.step(steps)
        before, _ = self._poses()
        self.step(AT_REST)
        after, velocities = self._poses()
        return body_contact_benchmark_scenes.sanity(
            self._scene, before, after, mjcf.world_velocities(velocities, after)
        ) | {"contacts": self._contacts()}

    def _poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns the poses (envs, bodies, 7), and the velocities (envs, bodies, 6) with angular ones in body axes."""
        bodies = len(self._scene.parts)
        first = 1 + self._model.nq
        poses = self._state[:, 1:first].reshape(-1, bodies, 7)
        return mjcf.scalar_last(poses), self._state[:, first : first + self._model.nv].reshape(-1, bodies, 6)

    def _contacts(self) -> float:
        """Returns the mean number of contacts of an environment in the final state."""
        counts = []
        for state in self._state[:SAMPLED_ENVS]:
            mujoco.mj_setState(self._model, self._data[0], state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
            mujoco.mj_forward(self._model, self._data[0])
            counts.append(self._data[0].ncon)
        return float(np.mean(counts))


class NonsmoothRun(Rollouts):
    """Run of a benchmark scene of nonsmooth contact; see the package. The variant is the friction cone."""

    def __init__(self, scene: NonsmoothScene, envs: int, device: str, threads: int, variant: str) -> None:
        model = mjcf.nonsmooth_model(scene, variant)
        velocities = np.zeros((envs, scene.boxes, 6))
        velocities[..., :3] = scene.velocities(envs)[:, None]
        positions = np.broadcast_to(model.qpos0, (envs, model.nq))
        super().__init__(model, positions, velocities.reshape(envs, -1), threads)

    def sanity(self, steps: int) -> dict[str, float]:
        m, d = self._model, self._data[0]
        residuals, iterations, deepest, speeds = [], [], 0.0, []
        every = max(steps // SAMPLES, 1)
        for start in self._start[:SAMPLED_ENVS]:
            mujoco.mj_resetData(m, d)
            mujoco.mj_setState(m, d, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
            for step in range(steps):
                if step % every == every - 1:
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
